//! The light follows an edit.
//!
//! Light transport is linear, so only the *change* is followed: an edited texel sends out ΔL = (A'
//! − A)·E/π more than before; gathered everywhere this gives ΔE, of which every texel reflects
//! A'·ΔE/π, and so on until a bounce changes less than half a hundredth of the irradiance. What the
//! photographs told about the unchanged light is kept to the bit, and the noise of the re-bake is
//! that of the change alone. Specular reflection is not stored: renderers trace it against the
//! changed radiance; so what a metal sends on of a change is left out.

use crate::Result;
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::progress::Progress;
use crate::core::texture::{Texels, fill_uncovered};
use crate::core::trace::EmbreeTracer;
use crate::gbuffer::Orientation;
use crate::irradiance::{Bake, Estimator, IrradianceOptions, Receiver, bake_irradiance};
use crate::lights::{Emitters, LitScene};
use crate::radiance::{Environment, LightField, SurfaceRadiance};
use crate::solution::Solution;
use glam::{DVec3, Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Bounces at most.
const MOST: usize = 8;
/// A bounce that changes the irradiance of the most affected channel by less, relative to its mean,
/// is the last: with walls that reflect half of the light, what is left out then is as much again.
const DONE: f64 = 0.005;
/// Largest side of the texture on which changes are gathered: they are smooth.
const SIDE: usize = 1024;
/// Rays per texel of the first bounce; later ones carry less.
const RAYS: u32 = 64;

/// What [`follow_light`] did.
#[derive(Clone, Debug, Default)]
pub struct Bounces {
    /// Per bounce: sum of |ΔE| relative to the sum of E, of the channel where it is largest.
    pub changes: Vec<f64>,
    /// Rays traced.
    pub rays: u64,
}

/// Updates irradiance and radiance of `edited`, whose albedo differs from that of `before`.
///
/// # Errors
/// Embree cannot be used.
pub fn follow_light(
    before: &Solution,
    edited: &mut Solution,
    seed: u64,
    progress: &Progress,
) -> Result<Bounces> {
    if before.albedo.data == edited.albedo.data {
        return Ok(Bounces::default());
    }
    let sources = Sources::of(before);
    let change = follow(before, &sources, &edited.albedo, seed, progress)?;
    sources.add(&change, edited);
    Ok(change.bounces)
}

/// The value of a texture at `uv`.
fn look(plane: &RgbPlane, uv: Vec2) -> Vec3 {
    plane.bilinear(
        uv * Vec2::new(plane.width as f32, plane.height as f32),
        Wrap::Clamp,
    )
}

/// The texels of the radiance texture: what sends out changed light.
struct Sources {
    texels: Texels,
    /// Cells of the texture that are covered by texels.
    covered: Plane<bool>,
    /// Per texel, its place in the atlas.
    uvs: Vec<Vec2>,
    /// Per texel, whether it emits: an edit does not change that.
    emits: Vec<bool>,
    /// Per texel, the share that is no metal: all that reflects diffusely.
    diffuse: Vec<f32>,
}

impl Sources {
    fn of(before: &Solution) -> Self {
        let mesh = &before.mesh;
        let texels = Texels::rasterize(mesh, before.radiance.width, before.radiance.height);
        let uvs: Vec<Vec2> = texels
            .point
            .iter()
            .map(|p| mesh.uv(p.triangle as usize, p.u, p.v))
            .collect();
        let e = &before.emission;
        let size = Vec2::new(e.width as f32, e.height as f32);
        let emits = uvs
            .iter()
            .map(|uv| *e.nearest(*uv * size) != Vec3::ZERO)
            .collect();
        Self {
            covered: texels.scatter(&vec![true; texels.len()], false),
            diffuse: uvs.iter().map(|uv| 1.0 - before.metal_at(*uv)).collect(),
            texels,
            uvs,
            emits,
        }
    }

    /// What texel `i` sends out more than before under unchanged irradiance: (A' − A)·E/π.
    fn first_change(&self, before: &Solution, albedo: &RgbPlane, i: usize) -> Vec3 {
        if self.emits[i] {
            return Vec3::ZERO;
        }
        let uv = self.uvs[i];
        let delta = (look(albedo, uv) - look(&before.albedo, uv)) * self.diffuse[i];
        // never below black: what is left is at least the specular part
        (delta * look(&before.irradiance, uv) * FRAC_1_PI)
            .max(-before.radiance.data[self.texels.cell[i] as usize])
    }

    /// What texel `i` reflects of a change of irradiance: A'·ΔE/π.
    fn reflected(&self, albedo: &RgbPlane, irradiance: &RgbPlane, i: usize) -> Vec3 {
        if self.emits[i] {
            Vec3::ZERO
        } else {
            let albedo = look(albedo, self.uvs[i]) * self.diffuse[i];
            albedo * look(irradiance, self.uvs[i]) * FRAC_1_PI
        }
    }

    /// Adds a change to the radiance and irradiance of a solution.
    fn add(&self, change: &Change, to: &mut Solution) {
        for (cell, more) in self.texels.cell.iter().zip(&change.radiance) {
            let l = &mut to.radiance.data[*cell as usize];
            *l = (*l + *more).max(Vec3::ZERO);
        }
        to.radiance = fill_uncovered(&to.radiance, &self.covered);
        let (w, h) = (to.irradiance.width, to.irradiance.height);
        for (i, e) in to.irradiance.data.iter_mut().enumerate() {
            let uv = Vec2::new((i % w) as f32 + 0.5, (i / w) as f32 + 0.5)
                / Vec2::new(w as f32, h as f32);
            *e = (*e + look(&change.irradiance, uv)).max(Vec3::ZERO);
        }
    }
}

/// What an edit changes in the light, all bounces together.
struct Change {
    /// Per texel of [`Sources`].
    radiance: Vec<Vec3>,
    irradiance: RgbPlane,
    bounces: Bounces,
}

/// Gathers changed light on a texture of irradiance.
struct Gathering<'a> {
    mesh: &'a Mesh,
    tracer: EmbreeTracer,
    orientation: Orientation,
    receivers: Texels,
    /// Cells of the texture that are covered by receivers.
    covered: Plane<bool>,
    /// How far rays start off the surface, metres.
    offset: f32,
}

/// The irradiance of one bounce.
struct Gathered {
    plane: RgbPlane,
    /// Sum over the receivers of |ΔE|.
    sum: DVec3,
    rays: u64,
}

impl<'a> Gathering<'a> {
    fn new(before: &'a Solution) -> Result<Self> {
        let mesh = &before.mesh;
        let side = SIDE.min(before.irradiance.width.max(before.irradiance.height));
        let receivers = Texels::rasterize(mesh, side, side);
        let (lo, hi) = mesh.bounds();
        Ok(Self {
            mesh,
            tracer: EmbreeTracer::new(mesh)?,
            orientation: Orientation::of_winding(mesh.triangles.len()),
            covered: receivers.scatter(&vec![true; receivers.len()], false),
            receivers,
            offset: (hi - lo).length() * 1e-5,
        })
    }

    /// Sum over the receivers of a texture of irradiance.
    fn sum(&self, irradiance: &RgbPlane) -> DVec3 {
        self.receivers
            .point
            .iter()
            .map(|p| look(irradiance, self.mesh.uv(p.triangle as usize, p.u, p.v)).as_dvec3())
            .sum()
    }

    fn receiver(&self, i: usize) -> Receiver {
        let p = self.receivers.point[i];
        let t = p.triangle as usize;
        Receiver {
            position: self.receivers.position(self.mesh, i),
            normal: self.mesh.shading_normal(t, p.u, p.v),
            face_normal: self.mesh.face_normal(t),
            key: u64::from(self.receivers.cell[i]),
        }
    }

    /// The irradiance that surfaces of the given radiance cause.
    fn gather(
        &self,
        radiance: RgbPlane,
        options: &IrradianceOptions,
        progress: &Progress,
    ) -> Gathered {
        let field = LightField::new(
            self.mesh,
            &self.orientation,
            SurfaceRadiance::reflected(radiance),
            Environment::black(),
        );
        let emitters = Emitters::new(self.mesh, &field, &self.tracer, &[]);
        let bake = Bake::from(LitScene {
            mesh: self.mesh,
            tracer: &self.tracer,
            field: &field,
            emitters: &emitters,
            offset: self.offset,
        });
        let count = self.receivers.len();
        let baked = progress.stage("bounced light", count as u64, |p| {
            bake_irradiance(&bake, count, |i| self.receiver(i), options, p)
        });
        Gathered {
            sum: baked.value.iter().map(|e| e.abs().as_dvec3()).sum(),
            plane: fill_uncovered(
                &self.receivers.scatter(&baked.value, Vec3::ZERO),
                &self.covered,
            ),
            rays: baked.rays,
        }
    }
}

/// Follows the change from bounce to bounce until it no longer matters.
fn follow(
    before: &Solution,
    sources: &Sources,
    albedo: &RgbPlane,
    seed: u64,
    progress: &Progress,
) -> Result<Change> {
    let gathering = Gathering::new(before)?;
    let whole = gathering.sum(&before.irradiance);
    let mut change: Vec<Vec3> = (0..sources.texels.len())
        .map(|i| sources.first_change(before, albedo, i))
        .collect();
    let (w, h) = (gathering.receivers.width, gathering.receivers.height);
    let mut total = Change {
        radiance: change.clone(),
        irradiance: Plane::filled(w, h, Vec3::ZERO),
        bounces: Bounces::default(),
    };
    for bounce in 0..MOST {
        let options = IrradianceOptions {
            estimator: Estimator::Cosine,
            rays: if bounce == 0 { RAYS } else { RAYS / 4 },
            emitter_samples: 0,
            seed: seed ^ (0xed17 + bounce as u64),
            ..IrradianceOptions::default()
        };
        let sent = fill_uncovered(
            &sources.texels.scatter(&change, Vec3::ZERO),
            &sources.covered,
        );
        let gathered = gathering.gather(sent, &options, progress);
        total.bounces.rays += gathered.rays;
        for (sum, more) in total.irradiance.data.iter_mut().zip(&gathered.plane.data) {
            *sum += *more;
        }
        let relative = (gathered.sum / whole.max(DVec3::splat(1e-30))).max_element();
        total.bounces.changes.push(relative);
        for (i, sum) in total.radiance.iter_mut().enumerate() {
            change[i] = sources.reflected(albedo, &gathered.plane, i);
            *sum += change[i];
        }
        if relative < DONE {
            break;
        }
    }
    Ok(total)
}
