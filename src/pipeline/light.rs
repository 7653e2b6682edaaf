//! Lighting stages: TBL, environment, emitters, IrT.
//!
//! Irradiance is baked twice. A coarse bake tells which texels send out more than they can reflect
//! (emitters) and what surfaces no camera sees send out (the class's albedo times their
//! irradiance); the full bake then uses both.

use super::decisions::{choose_environment, report_emission};
use super::hidden_faces::{FirstLight, dark_faces};
use super::known_lights::{adopt_subtexel_triangles, known_lights};
use super::light_basis::{bake, emitters_of};
use super::segments::{LightSoFar, find_segments};
use super::texel_radiance::{
    KnownFaces, filled_radiance, first_radiance, lit, texture_of, trusted_radiance,
};
use super::time_budget::{samples_for, split_samples};
use super::{SolveOptions, Switch};
use crate::core::geometry::{Mesh, clusters};
use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::stats::median_colours;
use crate::core::texture::Texels;
use crate::irradiance::{
    Irradiance, IrradianceOptions, NirfOptions, Receiver, SUB_ESTIMATES, SampleBudget, Surfel,
    bake_surface, spread,
};
use crate::lights::{EmissionEvidence, Emitters, LitScene, detect_emissive};
use crate::observed::Surface;
use crate::radiance::{Environment, LightField, SurfaceRadiance};
use crate::solution::lamp_gap;
use glam::Vec3;
use std::collections::BTreeSet;
use std::f32::consts::{FRAC_1_PI, PI};
use std::time::Instant;

/// Side of the coarse irradiance texture relative to the full one.
const COARSE: usize = 4;

/// How much brighter than expected a texel seen only at edges may be before its radiance counts as
/// a mixture with a brighter surface.
const MIXTURE_LIMIT: f32 = 1.5;

/// The reconstructed light of a scene.
pub struct Light {
    /// The segment of each texel in the place of its class, where no photograph has labels.
    pub segments: Option<Vec<u16>>,
    /// Radiance along rays.
    pub field: LightField,
    /// Emitters to sample.
    pub emitters: Emitters,
    /// Emitting triangles.
    pub emissive: Vec<bool>,
    /// Fused radiance, unseen texels predicted, filled outside charts.
    pub radiance: RgbPlane,
    /// Covered texels of the irradiance texture.
    pub texels: Texels,
    /// Irradiance texture, filled outside charts.
    pub irradiance: RgbPlane,
    /// Relative standard error per covered irradiance texel.
    pub error: Vec<f32>,
    /// Rays traced.
    pub rays: u64,
}

/// Importance of a texel whose centre lies outside its chart by up to one texel: the share of its
/// interpolation weight that lies inside is at most a half, a sixth on average.
const BORDER: f32 = 0.25;

/// Reconstructs the light from the fused observations.
#[must_use]
pub fn reconstruct_light(surface: &Surface, options: &SolveOptions, progress: &Progress) -> Light {
    let mesh = &surface.scene.mesh;
    let environment = choose_environment(surface, options, progress);
    let lamps = known_lights(surface, options);
    let Lamps { known, coarse } = shining_lamps(surface, lamps, &environment, options, progress);
    let emissive = emissive_by(surface, &coarse.irradiance, &known, options);
    report_emission(&emissive, &known.lamps, options, progress);
    let so_far = LightSoFar {
        irradiance: &coarse.irradiance,
        emissive: &emissive,
    };
    let segments = find_segments(surface, so_far, options, progress);
    let labels = segments.as_ref().unwrap_or(&surface.labels);

    // surfaces nobody sees send out their class's albedo times their irradiance
    let radiance = progress.stage("radiance nobody sees", 1, |_| {
        let predicted = complete_radiance(surface, labels, &known, so_far);
        filled_radiance(surface, &predicted, &vec![true; predicted.len()])
    });
    let (field, emitters) = progress.stage("lights to sample", 1, |_| {
        let seen_from = &coarse.texels;
        light_field(
            surface,
            &radiance,
            &emissive,
            environment,
            seen_from,
            options,
        )
    });
    let seen = &surface.fusion.views;
    let unseen = seen.iter().filter(|v| **v == 0).count();
    progress.note(format!(
        "{} groups of emitters and openings to sample; {:.1} % of texels unseen by any view",
        emitters.lamp_count(),
        100.0 * unseen as f64 / seen.len().max(1) as f64
    ));
    let side = surface.sizes.irradiance;
    let texels = Texels::rasterize(mesh, side, side);
    let options = with_samples(options, &coarse, texels.len(), progress);
    let baked = options.checkpoints.reuse("irradiance", progress, || {
        bake_irradiance_texels(surface, &field, &emitters, &texels, &options, progress)
    });
    let irradiance = texture_of(&texels, &baked.value);
    Light {
        segments,
        field,
        emitters,
        emissive,
        radiance,
        texels,
        irradiance,
        error: baked.error,
        rays: coarse.bake.rays + baked.rays,
    }
}

/// What is known of lamps, and the light as a coarse bake shows it then.
struct Lamps {
    known: KnownFaces,
    coarse: CoarseLight,
}

/// Those of `lamps` that shine, hidden ones as far as the photographs do not deny it.
fn shining_lamps(
    surface: &Surface,
    lamps: Vec<bool>,
    environment: &Environment,
    options: &SolveOptions,
    progress: &Progress,
) -> Lamps {
    let mesh = &surface.scene.mesh;
    let faces = |lamps: Vec<bool>, dark: Vec<bool>| KnownFaces {
        lamps: adopt_subtexel_triangles(mesh, &surface.texels, lamps),
        dark,
    };
    let light = |known: &KnownFaces, sent: &[Vec3]| {
        coarse_light(surface, known, sent, environment.clone(), options, progress)
    };
    let known = faces(lamps.clone(), Vec::new());
    let sent = trusted_radiance(surface, &known.lamps);
    let coarse = light(&known, &sent);
    let seen = FirstLight {
        sent: &sent,
        texels: &coarse.texels,
        irradiance: &coarse.irradiance,
        options: &coarse_samples(options),
    };
    let Some(found) = dark_faces(surface, &lamps, seen) else {
        return Lamps { known, coarse };
    };
    let name = |c: &u16| surface.scene.class_name(*c);
    let names: Vec<String> = found.classes.iter().map(name).collect();
    progress.note(format!(
        "faces of {} that no view shows clearly are dark: what they would light is not lit",
        names.join(", ")
    ));
    let shining = lamps.iter().zip(&found.triangles);
    let known = faces(
        shining.map(|(l, dark)| *l && !dark).collect(),
        found.triangles,
    );
    let coarse = light(&known, &trusted_radiance(surface, &known.lamps));
    Lamps { known, coarse }
}

/// Rays and emitter samples of a coarse bake.
fn coarse_samples(options: &SolveOptions) -> IrradianceOptions {
    IrradianceOptions {
        rays: 64,
        emitter_samples: 16,
        seed: options.seed ^ 1,
        ..IrradianceOptions::default()
    }
}

/// The light as a coarse bake shows it: as observed, from known lamps only.
struct CoarseLight {
    /// Texels of the coarse texture.
    texels: Texels,
    bake: Irradiance,
    /// The bake as a texture, filled outside charts.
    irradiance: RgbPlane,
    /// Rays and emitter samples per texel.
    samples: u32,
    /// How long the bake took.
    seconds: f64,
}

fn coarse_light(
    surface: &Surface,
    known: &KnownFaces,
    sent: &[Vec3],
    environment: Environment,
    options: &SolveOptions,
    progress: &Progress,
) -> CoarseLight {
    let lamps = &known.lamps;
    let radiance = first_radiance(surface, sent, known);
    let texels = coarse_texels(surface);
    let (field, emitters) = progress.stage("lights to sample", 1, |_| {
        light_field(surface, &radiance, lamps, environment, &texels, options)
    });
    let coarse = coarse_samples(options);
    let begin = Instant::now();
    let bake = progress.stage("emitters", texels.len() as u64, |p| {
        let lit = surface.lit(&field, &emitters);
        bake(surface, lit, &texels, &coarse, p)
    });
    CoarseLight {
        seconds: begin.elapsed().as_secs_f64(),
        irradiance: texture_of(&texels, &bake.value),
        samples: coarse.rays + coarse.emitter_samples,
        texels,
        bake,
    }
}

/// Triangles that send out light: known lamps and, if the options let it be decided, those that
/// send out more than they can reflect of the coarse irradiance.
fn emissive_by(
    surface: &Surface,
    irradiance: &RgbPlane,
    known: &KnownFaces,
    options: &SolveOptions,
) -> Vec<bool> {
    if options.emission == Switch::Off {
        return known.lamps.clone();
    }
    let mut found = emitting_triangles(surface, irradiance, &known.lamps);
    for (emits, dark) in found.iter_mut().zip(&known.dark) {
        *emits &= !dark;
    }
    adopt_subtexel_triangles(&surface.scene.mesh, &surface.texels, found)
}

/// The options with the samples that a budget or a target error asks for at `count` texels, by what
/// the coarse bake cost and how it scatters.
fn with_samples(
    options: &SolveOptions,
    coarse: &CoarseLight,
    count: usize,
    progress: &Progress,
) -> SolveOptions {
    let rounds = if options.irradiance_filter {
        options.irradiance_rounds
    } else {
        0
    };
    let (rays, seconds) = (coarse.bake.rays, coarse.seconds);
    let chosen = match (&options.budget, options.target_error) {
        (Some(b), _) => Some(b.irradiance_samples(count, rays, seconds, rounds, progress)),
        (None, Some(target)) => {
            let error = unfiltered_error(&coarse.bake);
            Some((samples_for(target, error, coarse.samples, progress), rounds))
        }
        (None, None) => None,
    };
    let mut options = options.clone();
    if let Some((samples, rounds)) = chosen {
        [options.irradiance_rays, options.emitter_samples] = split_samples(samples);
        options.irradiance_rounds = rounds.max(1);
    }
    options
}

/// Relative error of a bake by how its parts scatter: √(Σ variance of their mean/Σ mean²).
fn unfiltered_error(bake: &Irradiance) -> f32 {
    let (mut error, mut energy) = (0.0f64, 0.0f64);
    for parts in &bake.parts {
        let (mean, variance) = spread(&parts.map(luminance));
        let square = f64::from(mean).powi(2);
        error += f64::from(variance) * square / SUB_ESTIMATES as f64;
        energy += square;
    }
    if energy > 0.0 {
        (error / energy).sqrt() as f32
    } else {
        0.0
    }
}

/// The irradiance of `texels` as the options ask for it: the last and longest step of
/// [`reconstruct_light`].
#[must_use]
pub fn bake_irradiance_texels(
    surface: &Surface,
    field: &LightField,
    emitters: &Emitters,
    texels: &Texels,
    options: &SolveOptions,
    progress: &Progress,
) -> Irradiance {
    if let Some(epochs) = options.nirf {
        let training = NirfOptions::of_run(epochs, options.seed);
        let lit = surface.lit(field, emitters);
        return super::neural::field_at_texels(surface, lit, texels, &training, progress);
    }
    let budget = SampleBudget {
        estimator: options.irradiance_estimator,
        samples: [options.irradiance_rays, options.emitter_samples],
        target: options.irradiance_error,
        rounds: options.irradiance_rounds,
        filter: options.irradiance_filter,
        seed: options.seed,
    };
    let bake = surface.lit(field, emitters).into();
    let (patches, importance) = (patches(surface, texels), importance(surface, texels));
    let receiver = |i: usize| surface.receiver(texels, i);
    progress.stage("irradiance", texels.len() as u64, |p| {
        bake_surface(&bake, &patches, receiver, &importance, &budget, p)
    })
}

/// What an error of each texel's irradiance counts: nothing where no view sees it, little where
/// only interpolation within the chart reaches it.
fn importance(surface: &Surface, texels: &Texels) -> Vec<f32> {
    let seen = surface.seen(texels);
    let of = |(seen, interior): (&bool, &bool)| match (seen, interior) {
        (false, _) => 0.0,
        (true, true) => 1.0,
        (true, false) => BORDER,
    };
    seen.iter().zip(&texels.interior).map(of).collect()
}

/// The texels as pieces of surface, each on the side of a wall from which its light comes.
#[must_use]
pub fn patches(surface: &Surface, texels: &Texels) -> Vec<Surfel> {
    let mesh = &surface.scene.mesh;
    let patch = |i: usize| {
        let Receiver {
            position, normal, ..
        } = surface.receiver(texels, i);
        Surfel {
            position,
            normal,
            size: texels.area(mesh, i).sqrt(),
        }
    };
    (0..texels.len()).into_par_iter().map(patch).collect()
}

impl Surface<'_> {
    /// The scene as rays meet it, in the light of `field` and `emitters`.
    #[must_use]
    pub fn lit<'b>(&'b self, field: &'b LightField, emitters: &'b Emitters) -> LitScene<'b> {
        LitScene {
            mesh: &self.scene.mesh,
            tracer: &self.tracer,
            field,
            emitters,
            offset: self.offset,
        }
    }

    /// Whether some view sees the place of each texel of `texels`.
    #[must_use]
    pub fn seen(&self, texels: &Texels) -> Vec<bool> {
        let observed: Vec<bool> = self.fusion.views.iter().map(|v| *v > 0).collect();
        let plane = self.texels.scatter(&observed, false);
        let place = |c: u32| {
            let (x, y) = (c as usize % texels.width, c as usize / texels.width);
            let at = |k: usize, from: usize, to: usize| ((2 * k + 1) * to / (2 * from)).min(to - 1);
            plane[(
                at(x, texels.width, plane.width),
                at(y, texels.height, plane.height),
            )]
        };
        texels.cell.iter().map(|&c| place(c)).collect()
    }

    /// Texel `i` as a receiver of light: its rays start at its ray point, its key is its place in
    /// the texture.
    #[must_use]
    pub fn receiver(&self, texels: &Texels, i: usize) -> Receiver {
        let t = texels.point[i].triangle as usize;
        let (u, v) = texels.ray_point(i);
        let (normal, face_normal) = self.normals(t, u, v);
        Receiver {
            position: self.scene.mesh.position(t, u, v),
            normal,
            face_normal,
            key: u64::from(texels.cell[i]),
        }
    }
}

/// Covered texels of the coarse irradiance texture.
pub(super) fn coarse_texels(surface: &Surface) -> Texels {
    let side = (surface.sizes.irradiance / COARSE).max(1);
    Texels::rasterize(&surface.scene.mesh, side, side)
}

pub(super) fn light_field(
    surface: &Surface,
    radiance: &RgbPlane,
    emissive: &[bool],
    environment: Environment,
    receivers: &Texels,
    options: &SolveOptions,
) -> (LightField, Emitters) {
    let mesh = &surface.scene.mesh;
    let emitting: Vec<bool> = surface
        .texels
        .point
        .iter()
        .map(|p| emissive[p.triangle as usize])
        .collect();
    let mut field = LightField::new(
        mesh,
        &surface.orientation,
        SurfaceRadiance {
            radiance: radiance.clone(),
            emissive: surface.texels.scatter(&emitting, false),
            emissive_triangles: emissive,
            back: surface.back.clone(),
        },
        environment,
    );
    field.prefilter = options.prefilter;
    let emitters = emitters_of(surface, &field, receivers);
    (field, emitters)
}

/// Emitting triangles by evidence: what they send out in every clean view is more than a white
/// surface could reflect there.
fn emitting_triangles(surface: &Surface, irradiance: &RgbPlane, known: &[bool]) -> Vec<bool> {
    let texels: Vec<EmissionEvidence> = (0..surface.texels.len())
        .into_par_iter()
        .map(|i| EmissionEvidence {
            triangle: surface.texels.point[i].triangle,
            label: surface.labels[i],
            floor: if surface.fusion.floor[i].is_finite() {
                surface.fusion.floor[i]
            } else {
                0.0
            },
            white: luminance(surface.texels.lookup(&surface.scene.mesh, irradiance, i)) * FRAC_1_PI,
            observed: surface.fusion.views[i] > 0,
        })
        .collect();
    let emissive = detect_emissive(surface.scene.mesh.triangles.len(), &texels, known);
    let (mut sure, mut label) = (known.to_vec(), vec![0u16; emissive.len()]);
    for (i, p) in surface.texels.point.iter().enumerate() {
        label[p.triangle as usize] = surface.labels[i];
        sure[p.triangle as usize] |= surface.fusion.clean[i];
    }
    remove_edge_halos(&surface.scene.mesh, emissive, &sure, &label)
}

/// Takes out triangles of another class than the lamp they lie at unless they are `sure`: what only
/// pixels at edges see shows the lamp.
fn remove_edge_halos(
    mesh: &Mesh,
    mut emissive: Vec<bool>,
    sure: &[bool],
    label: &[u16],
) -> Vec<bool> {
    let found: Vec<u32> = (0..emissive.len() as u32)
        .filter(|&t| emissive[t as usize])
        .collect();
    for lamp in clusters(mesh, &found, lamp_gap(mesh)) {
        let classes: BTreeSet<u16> = lamp
            .iter()
            .filter(|&&t| sure[t as usize])
            .map(|&t| label[t as usize])
            .collect();
        let halo = |t: &&u32| {
            !sure[**t as usize] && !classes.is_empty() && !classes.contains(&label[**t as usize])
        };
        lamp.iter()
            .filter(halo)
            .for_each(|&t| emissive[t as usize] = false);
    }
    emissive
}

/// Radiance of every texel: as observed; the median albedo of its class times its irradiance where
/// nobody sees it; and where only pixels at edges see it, no more than a little above that.
fn complete_radiance(
    surface: &Surface,
    labels: &[u16],
    faces: &KnownFaces,
    light: LightSoFar<'_>,
) -> Vec<Vec3> {
    let LightSoFar {
        irradiance,
        emissive,
    } = light;
    let trusted = trusted_radiance(surface, emissive);
    let stride = (surface.texels.len() / 400_000).max(1);
    let known = (0..surface.texels.len())
        .step_by(stride)
        .filter(|&i| surface.fusion.clean[i] && !lit(surface, emissive, i))
        .filter(|&i| !faces.is_dark(surface, i));
    let albedo = median_colours(known.map(|i| {
        let e = surface.texels.lookup(&surface.scene.mesh, irradiance, i);
        let a = surface.fusion.radiance[i] * PI / e.max(Vec3::splat(1e-12));
        (
            labels[i],
            Vec3::from_array(a.to_array().map(|v| v.min(1.0))),
        )
    }));
    (0..surface.texels.len())
        .into_par_iter()
        .map(|i| {
            let grazed = faces.is_dark(surface, i);
            if surface.fusion.clean[i] && !grazed || lit(surface, emissive, i) {
                return trusted[i];
            }
            let a = albedo.get(&labels[i]).copied().unwrap_or(Vec3::splat(0.5));
            let expected =
                a * surface.texels.lookup(&surface.scene.mesh, irradiance, i) * FRAC_1_PI;
            let seen = surface.fusion.radiance[i];
            let usable = surface.fusion.views[i] > 0
                && !grazed
                && luminance(seen) < MIXTURE_LIMIT * luminance(expected);
            if usable { seen } else { expected }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observed::surface_tests::{box_scene, unseen};
    use glam::Vec2;

    /// What nobody sees sends out its class's share of what it receives: all of it at most,
    /// whatever glints its class shows elsewhere, and nothing in the dark.
    #[test]
    fn unseen_texels_do_not_invent_light() {
        let scene = box_scene();
        let mut surface = unseen(&scene, 96);
        let wall = |i: usize| surface.texels.point[i].triangle as usize / 2;
        let walls: Vec<usize> = (0..surface.texels.len()).map(wall).collect();
        // light that falls off across every wall, and next to none on the last
        let received: Vec<Vec3> = (0..walls.len())
            .map(|i| {
                Vec3::splat(
                    (1 + surface.texels.cell[i] % 96) as f32
                        * if walls[i] == 5 { 1e-6 } else { 1.0 },
                )
            })
            .collect();
        let irradiance = texture_of(&surface.texels, &received);
        let white: Vec<Vec3> = (0..walls.len())
            .map(|i| surface.texels.lookup(&scene.mesh, &irradiance, i) * FRAC_1_PI)
            .collect();
        let colour = Vec3::new(0.4, 0.2, 0.6);
        let faces = KnownFaces {
            lamps: vec![false; 12],
            dark: Vec::new(),
        };
        for (i, &w) in walls.iter().enumerate() {
            // every third texel is seen clean, another third at edges only
            let (clean, edge) = (i % 3 == 0, i % 3 == 1);
            let (radiance, clean, views) = match w {
                // matte paint, of which the last wall is painted too
                0 | 4 => (colour * white[i], clean, u8::from(clean)),
                // a highlight on all of the class that is seen
                1 => (9.0 * white[i], clean, u8::from(clean)),
                // seen at edges, mixed with something brighter, or a little brighter itself
                2 => (
                    if clean { colour } else { 40.0 * colour } * white[i],
                    clean,
                    u8::from(clean || edge),
                ),
                3 => (
                    if clean { colour } else { 1.2 * colour } * white[i],
                    clean,
                    u8::from(clean || edge),
                ),
                _ => (Vec3::ZERO, false, 0),
            };
            (surface.fusion.radiance[i], surface.fusion.peak[i]) = (radiance, radiance);
            (surface.fusion.clean[i], surface.fusion.views[i]) = (clean, views);
        }
        surface.labels = walls
            .iter()
            .map(|w| if *w == 5 { 1 } else { 1 + *w as u16 })
            .collect();
        let light = LightSoFar {
            irradiance: &irradiance,
            emissive: &[false; 12],
        };
        let filled = complete_radiance(&surface, &surface.labels, &faces, light);
        let near = |a: Vec3, b: Vec3| (a - b).abs().max_element() <= 1e-4 * b.max_element();
        let mut checked = [0; 6];
        for (i, &w) in walls.iter().enumerate() {
            let (f, got) = (&surface.fusion, filled[i]);
            assert!(
                f.clean[i] || got.cmple(white[i] * 1.0001).all(),
                "wall {w}, texel {i}: {got} of {}",
                white[i]
            );
            let expected = match w {
                _ if f.clean[i] => f.radiance[i],
                1 => white[i],
                3 if f.views[i] > 0 => f.radiance[i],
                _ => colour * white[i],
            };
            assert!(
                near(got, expected),
                "wall {w}, texel {i}: {got} for {expected}"
            );
            checked[w] += u32::from(!f.clean[i]);
        }
        assert!(checked.iter().all(|n| *n > 100), "{checked:?}");
        // without any clean look at a class: half of what it receives
        surface.fusion.clean.fill(false);
        surface.fusion.views.fill(0);
        let light = LightSoFar {
            irradiance: &irradiance,
            emissive: &[false; 12],
        };
        let filled = complete_radiance(&surface, &surface.labels, &faces, light);
        assert!(filled.iter().zip(&white).all(|(l, w)| near(*l, 0.5 * *w)));
    }

    #[test]
    fn a_lamp_does_not_make_its_frame_shine() {
        // a lamp, its frame, another facet of the lamp, and a lamp of its own far away
        let corners = |x: f32| {
            [
                Vec3::new(x, 0.0, 0.0),
                Vec3::new(x + 0.1, 0.0, 0.0),
                Vec3::new(x, 0.1, 0.0),
            ]
        };
        let positions: Vec<Vec3> = [0.0, 0.1, -0.1, 90.0]
            .into_iter()
            .flat_map(corners)
            .collect();
        let mesh = Mesh {
            normals: vec![Vec3::Z; positions.len()],
            uvs: vec![Vec2::ZERO; positions.len()],
            triangles: (0..4).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            positions,
        };
        let sure = [true, false, false, false];
        assert_eq!(
            remove_edge_halos(&mesh, vec![true; 4], &sure, &[30, 27, 30, 27]),
            [true, false, true, true]
        );
        assert_eq!(
            remove_edge_halos(&mesh, vec![true; 4], &[true; 4], &[30, 27, 30, 27]),
            [true; 4],
            "seen clean"
        );
    }
}
