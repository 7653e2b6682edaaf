//! The light follows an edit.
//!
//! Light transport is linear, so only the *change* is followed: an edited texel sends out ΔL = (A'
//! − A)·E/π more than before; gathered everywhere this gives ΔE, of which every texel reflects
//! A'·ΔE/π, and so on until a bounce changes less than half a hundredth of the irradiance. What the
//! photographs told about the unchanged light is kept to the bit, and the noise of the re-bake is
//! that of the change alone. Specular reflection is not stored: renderers trace it against the
//! changed radiance.

use crate::Result;
use crate::gbuffer::Orientation;
use crate::image::{Plane, RgbPlane, Wrap};
use crate::irradiance::{Bake, Estimator, IrtOptions, Receiver, bake_irradiance};
use crate::lights::{Emitters, LitScene};
use crate::progress::Progress;
use crate::radiance::{Environment, LightField};
use crate::solution::Solution;
use crate::texture::{Texels, fill_uncovered};
use crate::trace::EmbreeTracer;
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
    let mut out = Bounces::default();
    if before.albedo.data == edited.albedo.data {
        return Ok(out);
    }
    let mesh = before.mesh.clone();
    let texels = Texels::rasterize(&mesh, before.radiance.width, before.radiance.height);
    let uvs: Vec<Vec2> = texels
        .point
        .iter()
        .map(|p| mesh.uv(p.triangle as usize, p.u, p.v))
        .collect();
    let look = |plane: &RgbPlane, uv: Vec2| {
        plane.bilinear(
            uv * Vec2::new(plane.width as f32, plane.height as f32),
            Wrap::Clamp,
        )
    };
    let emits: Vec<bool> = uvs
        .iter()
        .map(|uv| {
            let e = &before.emission;
            *e.nearest(*uv * Vec2::new(e.width as f32, e.height as f32)) != Vec3::ZERO
        })
        .collect();
    let mut change: Vec<Vec3> = (0..texels.len())
        .map(|i| {
            if emits[i] {
                return Vec3::ZERO;
            }
            let delta = look(&edited.albedo, uvs[i]) - look(&before.albedo, uvs[i]);
            // never below black: what is left is at least the specular part
            (delta * look(&before.irradiance, uvs[i]) * FRAC_1_PI)
                .max(-before.radiance.data[texels.cell[i] as usize])
        })
        .collect();
    let tracer = EmbreeTracer::new(&mesh)?;
    let orientation = Orientation::of_winding(mesh.triangles.len());
    let side = SIDE.min(before.irradiance.width.max(before.irradiance.height));
    let receivers = Texels::rasterize(&mesh, side, side);
    let covered = receivers.scatter(&vec![true; receivers.len()], false);
    let full = texels.scatter(&vec![true; texels.len()], false);
    let (lo, hi) = mesh.bounds();
    let mut total = Plane::filled(side, side, Vec3::ZERO);
    let mut radiance = change.clone();
    let whole: DVec3 = receivers
        .point
        .iter()
        .map(|p| look(&before.irradiance, mesh.uv(p.triangle as usize, p.u, p.v)).as_dvec3())
        .sum();
    for bounce in 0..MOST {
        let plane = fill_uncovered(&texels.scatter(&change, Vec3::ZERO), &full);
        let none = plane.map(|_| false);
        let dark = vec![false; mesh.triangles.len()];
        let field = LightField::new(
            &mesh,
            &orientation,
            plane,
            &none,
            &dark,
            Vec::new(),
            Environment::black(),
        );
        let emitters = Emitters::new(&mesh, &field, &tracer, &[]);
        let bake = Bake::from(LitScene {
            mesh: &mesh,
            tracer: &tracer,
            field: &field,
            emitters: &emitters,
            offset: (hi - lo).length() * 1e-5,
        });
        let options = IrtOptions {
            estimator: Estimator::Cosine,
            rays: if bounce == 0 { RAYS } else { RAYS / 4 },
            emitter_samples: 0,
            seed: seed ^ (0xed17 + bounce as u64),
            ..IrtOptions::default()
        };
        let receiver = |i: usize| {
            let p = receivers.point[i];
            let t = p.triangle as usize;
            Receiver {
                position: receivers.position(&mesh, i),
                normal: mesh.shading_normal(t, p.u, p.v),
                face_normal: mesh.face_normal(t),
                key: u64::from(receivers.cell[i]),
            }
        };
        let baked = progress.stage("bounced light", receivers.len() as u64, |p| {
            bake_irradiance(&bake, receivers.len(), receiver, &options, p)
        });
        out.rays += baked.rays;
        let changed: DVec3 = baked.value.iter().map(|e| e.abs().as_dvec3()).sum();
        let plane = fill_uncovered(&receivers.scatter(&baked.value, Vec3::ZERO), &covered);
        total
            .data
            .iter_mut()
            .zip(&plane.data)
            .for_each(|(t, d)| *t += *d);
        let relative = (changed / whole.max(DVec3::splat(1e-30))).max_element();
        out.changes.push(relative);
        for i in 0..texels.len() {
            change[i] = if emits[i] {
                Vec3::ZERO
            } else {
                look(&edited.albedo, uvs[i]) * look(&plane, uvs[i]) * FRAC_1_PI
            };
            radiance[i] += change[i];
        }
        if relative < DONE {
            break;
        }
    }
    for (i, cell) in texels.cell.iter().enumerate() {
        let l = &mut edited.radiance.data[*cell as usize];
        *l = (*l + radiance[i]).max(Vec3::ZERO);
    }
    edited.radiance = fill_uncovered(&edited.radiance, &full);
    let (w, h) = (edited.irradiance.width, edited.irradiance.height);
    for (i, e) in edited.irradiance.data.iter_mut().enumerate() {
        let uv =
            Vec2::new((i % w) as f32 + 0.5, (i / w) as f32 + 0.5) / Vec2::new(w as f32, h as f32);
        *e = (*e + look(&total, uv)).max(Vec3::ZERO);
    }
    Ok(out)
}
