//! The main job: light, then materials.

use super::decisions::{choose_matte, choose_rooms, report_materials, report_matte};
use super::missing_light::add_missing_light;
use super::painted::settle_paint;
use super::{Light, SolveOptions, Switch, observe, reconstruct_light};
use crate::Result;
use crate::brdf::{F0, Reflectance};
use crate::highlight::{
    Candidate, SelectOptions, Tabulation, gather_evidence, roughness_levels, select_points,
};
use crate::image::{Plane, RgbPlane, Wrap};
use crate::inverse::{
    AlbedoEstimate, DIVISION_GAIN, DiffuseShading, GroupFit, Materials, Places, Unmixing,
    choose_model, estimate_albedo, fit_groups, specular_image,
};
use crate::observed::{Surface, coverage};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::solution::Solution;
use crate::specular::{Reflector, WIDE, WideLobes};
use crate::texture::{Texels, fill_uncovered};
use crate::trace::Hit;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f32::consts::{FRAC_1_PI, PI};
use std::time::Instant;

/// Roughness of a class without evidence anywhere: matte, as most indoor surfaces without visible
/// highlights are.
const ROUGHNESS_PRIOR: f32 = 0.8;

/// Points per class that tell whether its highlights can be observed.
const PILOT: usize = 1500;

/// A reconstruction and what is known about it.
pub struct Solved {
    /// The textures.
    pub solution: Solution,
    /// Roughness fits per class.
    pub fits: Vec<GroupFit>,
    /// Rays traced in all.
    pub rays: u64,
}

/// Reconstructs materials and light of a scene.
///
/// # Errors
/// Unusable options, unreadable or unusable images and labels.
pub fn reconstruct(scene: &Scene, options: &SolveOptions, progress: &Progress) -> Result<Solved> {
    options.validate()?;
    let surface = observe(scene, options, progress)?;
    let mut light = reconstruct_light(&surface, options, progress);
    let lit = surface.lit(&light.field, &light.emitters);
    let labels = surface.texels.scatter(&surface.labels, 0);
    let normals = |t: u32, p: Vec3| surface.normals_at(t, p);
    let label_at = |t: u32, p: Vec3| surface.nearest(&labels, t, p);
    let class = |t: u32, p: Vec3| (!light.emissive[t as usize]).then(|| label_at(t, p));

    let evidence = progress.stage("highlights", 0, |_| {
        let select = SelectOptions {
            stride: 3,
            even: options.evidence_points,
            highlights: options.evidence_points,
            seed: options.seed,
        };
        select_points(&lit, &surface.views, &normals, &class, &select)
    });
    let (evidence, matte) = progress.stage("specular samples", evidence.len() as u64, |p| {
        let levels = roughness_levels(options.roughness_levels);
        let tabulation = Tabulation {
            levels: &levels,
            rays_per_lobe: options.evidence_rays,
        };
        let gather = |some: &[Candidate]| {
            gather_evidence(
                &lit,
                &surface.observer(),
                some,
                &normals,
                tabulation,
                options.seed,
                p,
            )
        };
        // a few points per class tell whether the others can add anything
        let (pilot, rest) = divided(&evidence, PILOT);
        let begin = Instant::now();
        let mut all = gather(&pilot);
        let seconds = begin.elapsed().as_secs_f64();
        let matte = choose_matte(&all, options);
        let mut rest: Vec<Candidate> = rest
            .into_iter()
            .filter(|c| !matte.contains(&c.class))
            .collect();
        if let Some(budget) = &options.budget {
            let keep = budget.evidence(pilot.len(), seconds, all.rays, rest.len(), progress);
            let all = rest.len().max(1);
            rest = rest
                .into_iter()
                .enumerate()
                .filter(|(i, _)| (i + 1) * keep / all > i * keep / all)
                .map(|(_, c)| c)
                .collect();
        }
        all.append(gather(&rest));
        (all, matte)
    });
    report_matte(scene, &matte, options, progress);
    let (model, fits, scores) = progress.stage("roughness", 1, |_| match options.reflectance {
        Some(model) => (model, fit_groups(&evidence, model), Vec::new()),
        None => choose_model(&evidence),
    });
    let list: Vec<String> = scores
        .iter()
        .map(|(m, s)| format!("{m:?} {:.3} %", 100.0 * s))
        .collect();
    let why = match options.reflectance {
        Some(_) => "--reflectance".to_owned(),
        None => format!(
            "the simplest of those that explain the views; disagreement {}",
            list.join(", ")
        ),
    };
    progress.decide(
        "reflection model",
        format!("{model:?}"),
        why,
        options.reflectance.is_some(),
    );
    let irradiance_at = |t: u32, p: Vec3| {
        let size = Vec2::new(
            light.irradiance.width as f32,
            light.irradiance.height as f32,
        );
        light
            .irradiance
            .bilinear(surface.uv_at(t, p) * size, Wrap::Clamp)
    };
    let rooms = rooms_of(&surface, options, progress);
    let places = Places {
        irradiance: &irradiance_at,
        room: &|t, p| surface.nearest(&rooms, t, p),
    };
    let materials = progress.stage("materials", 1, |_| match options.divide {
        Switch::Off => Materials::undivided(fits),
        Switch::Auto => Materials::find(&evidence, fits, model, &places, DIVISION_GAIN),
        Switch::On => Materials::find(&evidence, fits, model, &places, f64::NEG_INFINITY),
    });
    report_materials(scene, &materials, options, progress);
    let roughness_of_texel: Vec<f32> = first_albedo(&surface, &light)
        .into_par_iter()
        .enumerate()
        .map(|(i, colour)| {
            let colour = (surface.fusion.views[i] > 0).then_some(colour);
            let room = rooms.data[surface.texels.cell[i] as usize];
            materials
                .roughness(
                    surface.labels[i],
                    room,
                    colour,
                    surface.texels.position(&surface.scene.mesh, i),
                )
                .map_or(ROUGHNESS_PRIOR, |r| r.0)
        })
        .collect();
    let roughness_plane = filled(&surface.texels, &roughness_of_texel);
    let roughness_at = |t: u32, p: Vec3| surface.nearest(&roughness_plane, t, p);

    let mut rays = light.rays + evidence.rays;
    let lobes = WideLobes::new(model);
    let even_light = |t: u32, p: Vec3, n_v: f32| {
        let roughness = roughness_at(t, p);
        let wide = match options.matte {
            Switch::Auto => roughness > WIDE && matte.contains(&label_at(t, p)),
            Switch::On => roughness >= 0.5,
            Switch::Off => false,
        };
        wide.then(|| irradiance_at(t, p) * (FRAC_1_PI * lobes.response(n_v, roughness)))
    };
    let specular_rays = match &options.budget {
        Some(budget) => {
            budget.specular_rays(traced_pixels(&surface, &normals, &even_light), progress)
        }
        None => options.specular_rays,
    };
    let reflector = Reflector {
        lit: &lit,
        rays_per_lobe: specular_rays,
        emitter_samples: specular_rays.div_ceil(2),
        model,
        seed: options.seed ^ 0x51ec,
    };
    let specular: Vec<_> = progress.stage("specular images", surface.views.len() as u64, |p| {
        surface
            .views
            .iter()
            .enumerate()
            .map(|(i, v)| {
                let (image, traced) =
                    specular_image(&reflector, v, i, &normals, &roughness_at, &even_light);
                rays += traced;
                p.advance(1);
                image
            })
            .collect()
    });
    let roughness = |i: usize| roughness_of_texel[i];
    let mut albedo = progress.stage("albedo", surface.texels.len() as u64, |p| {
        let shading = DiffuseShading {
            model,
            roughness: &roughness,
        };
        let (observer, orientation) = (surface.observer(), &surface.orientation);
        estimate_albedo(
            &observer,
            &specular,
            orientation,
            &surface.texels,
            &light.irradiance,
            &shading,
            p,
        )
    });
    if options.edges != Switch::Off
        && options
            .budget
            .as_ref()
            .is_none_or(|b| b.allows_edges(progress))
    {
        rays += solve_edges(
            &surface,
            &light,
            &specular,
            (model, &lobes, &roughness),
            &mut albedo,
            progress,
        );
    }
    if options.missing_light != Switch::Off {
        let (change, traced) = progress.stage("missing light", 0, |p| {
            add_missing_light(
                &surface,
                &mut light,
                &mut albedo,
                (model, &lobes, &roughness),
                options.seed,
                p,
            )
        });
        rays += traced;
        progress.note(format!(
            "light that no camera looks along (specular reflections, far sides) changes the irradiance by {:+.1} % on average",
            100.0 * change
        ));
    }
    let mut errors = albedo_errors(&surface, &light, &albedo);
    if options.painted != Switch::Off {
        progress.stage("paint", 0, |p| {
            settle_paint(&surface, &mut light, &mut albedo, &mut errors, options, p)
        });
    }
    let solution = assemble(
        &surface,
        &light,
        (&albedo, &errors),
        &materials,
        model,
        labels,
        rooms,
    );
    Ok(Solved {
        solution,
        fits: materials.fits().cloned().collect(),
        rays,
    })
}

/// Solves for the albedo of texels without a clean look; returns the rays traced.
fn solve_edges(
    surface: &Surface,
    light: &Light,
    specular: &[RgbPlane],
    (model, lobes, roughness): (Reflectance, &WideLobes, &(dyn Fn(usize) -> f32 + Sync)),
    albedo: &mut AlbedoEstimate,
    progress: &Progress,
) -> u64 {
    let irradiance = |i: usize| {
        surface
            .texels
            .lookup(&surface.scene.mesh, &light.irradiance, i)
    };
    let specular_guess =
        |i: usize, n_v: f32| irradiance(i) * (FRAC_1_PI * lobes.response(n_v, roughness(i)));
    let unmixing = Unmixing {
        observer: surface.observer(),
        orientation: &surface.orientation,
        tracer: &surface.tracer,
        field: &light.field,
        texels: &surface.texels,
        labels: &surface.labels,
        irradiance: &irradiance,
        specular,
        specular_guess: &specular_guess,
        shading: DiffuseShading { model, roughness },
    };
    let report = progress.stage("albedo at edges", 0, |_| unmixing.solve(albedo));
    progress.note(format!(
        "{} pixels at edges tell of {} texels that no view sees clean (misfit {:.2})",
        report.pixels, report.texels, report.misfit
    ));
    report.rays
}

/// Pixels of all views that need specular rays, counted at every fourth row and column.
fn traced_pixels(
    surface: &Surface,
    normals: &dyn Fn(u32, Vec3) -> (Vec3, Vec3),
    known: &dyn Fn(u32, Vec3, f32) -> Option<Vec3>,
) -> usize {
    const STEP: usize = 4;
    let mut count = 0;
    for b in surface.views.iter().map(|v| &v.buffer) {
        for y in (0..b.triangle.height).step_by(STEP) {
            for x in (0..b.triangle.width).step_by(STEP) {
                let t = b.triangle[(x, y)];
                if t == Hit::MISS {
                    continue;
                }
                let position = b.position(x, y);
                let n_v = normals(t, position)
                    .0
                    .dot((b.camera.position - position).normalize_or_zero());
                count += usize::from(known(t, position, n_v).is_none());
            }
        }
    }
    count * STEP * STEP
}

/// About `few` candidates of every class, evenly drawn, and the others.
fn divided(candidates: &[Candidate], few: usize) -> (Vec<Candidate>, Vec<Candidate>) {
    let mut size: BTreeMap<u16, usize> = BTreeMap::new();
    candidates
        .iter()
        .for_each(|c| *size.entry(c.class).or_default() += 1);
    let mut at: BTreeMap<u16, usize> = BTreeMap::new();
    candidates.iter().copied().partition(|c| {
        let k = at.entry(c.class).or_default();
        *k += 1;
        (*k - 1).is_multiple_of(size[&c.class].div_ceil(few))
    })
}

fn assemble(
    surface: &Surface,
    light: &Light,
    (albedo, errors): (&AlbedoEstimate, &[f32]),
    materials: &Materials,
    reflectance: Reflectance,
    labels: Plane<u16>,
    rooms: Plane<u16>,
) -> Solution {
    let texels = &surface.texels;
    let roughness: Vec<(f32, f32)> = (0..texels.len())
        .into_par_iter()
        .map(|i| {
            let colour = albedo.error[i].is_finite().then_some(albedo.value[i]);
            materials
                .roughness(
                    surface.labels[i],
                    rooms.data[texels.cell[i] as usize],
                    colour,
                    surface.texels.position(&surface.scene.mesh, i),
                )
                .unwrap_or((ROUGHNESS_PRIOR, 1e4))
        })
        .collect();
    // unseen texels have a value where their class says what to expect
    let observed: Vec<bool> = albedo
        .error
        .iter()
        .zip(&albedo.value)
        .map(|(e, a)| e.is_finite() || *a != Vec3::ZERO)
        .collect();
    let value: Vec<Vec3> = albedo
        .value
        .iter()
        .map(|a| a.clamp(Vec3::ZERO, Vec3::ONE))
        .collect();
    let albedo_plane = fill_uncovered(
        &texels.scatter(&value, Vec3::ZERO),
        &texels.scatter(&observed, false),
    );
    let confidence: Vec<Vec2> = errors
        .iter()
        .zip(&roughness)
        .map(|(e, r)| Vec2::new(e.min(1e4), r.1))
        .collect();
    let emission: Vec<Vec3> = (0..texels.len())
        .map(|i| {
            if light.emissive[texels.point[i].triangle as usize] {
                light.radiance.data[texels.cell[i] as usize]
            } else {
                Vec3::ZERO
            }
        })
        .collect();
    let size = surface.sizes.roughness;
    let r = filled(texels, &roughness.iter().map(|r| r.0).collect::<Vec<f32>>());
    let scale = Vec2::new(r.width as f32, r.height as f32) / size as f32;
    let at = |i: usize| Vec2::new((i % size) as f32 + 0.5, (i / size) as f32 + 0.5) * scale;
    let data = (0..size * size)
        .into_par_iter()
        .map(|i| r.bilinear(at(i), Wrap::Clamp))
        .collect();
    let roughness = Plane {
        width: size,
        height: size,
        data,
    };
    Solution {
        mesh: surface.oriented_mesh(),
        origin: surface.scene.origin,
        albedo: albedo_plane,
        roughness,
        irradiance: light.irradiance.clone(),
        radiance: light.radiance.clone(),
        emission: texels.scatter(&emission, Vec3::ZERO),
        confidence: texels.scatter(&confidence, Vec2::splat(1e4)),
        irradiance_error: Some(light.texels.scatter(&light.error, 0.0)),
        rooms,
        labels,
        environment: light.field.environment.map().clone(),
        reflectance,
    }
}

/// A value per covered texel as a texture, filled outside charts.
fn filled(texels: &Texels, values: &[f32]) -> Plane<f32> {
    fill_uncovered(&texels.scatter(values, 0.0), &coverage(texels))
}

/// A first guess of the albedo of every covered texel: of what it reflects, a dielectric's share at
/// normal incidence is specular.
fn first_albedo(surface: &Surface, light: &Light) -> Vec<Vec3> {
    let albedo = |i: usize| {
        let e = surface
            .texels
            .lookup(&surface.scene.mesh, &light.irradiance, i);
        surface.fusion.radiance[i] * PI / e.max(Vec3::splat(1e-12)) - F0 as f32
    };
    (0..surface.texels.len())
        .into_par_iter()
        .map(albedo)
        .collect()
}

/// Standard error of the albedo per covered texel, with what irradiance and geometry contribute.
fn albedo_errors(surface: &Surface, light: &Light, albedo: &AlbedoEstimate) -> Vec<f32> {
    let (texels, mesh) = (&surface.texels, &surface.scene.mesh);
    // beyond the charts of the irradiance texture nothing is known of its error
    let noise = light.texels.scatter(&light.error, 1.0);
    let size = Vec2::new(noise.width as f32, noise.height as f32);
    let irradiance_error = |i: usize| {
        let p = texels.point[i];
        noise
            .nearest(mesh.uv(p.triangle as usize, p.u, p.v) * size)
            .clamp(0.0, 1.0)
    };
    let footprint = |i: usize| {
        let side = texels
            .texel_area(mesh, texels.point[i].triangle as usize)
            .sqrt();
        albedo.footprint[i] / side.max(f32::MIN_POSITIVE)
    };
    let reflects = |i: usize| !light.emissive[texels.point[i].triangle as usize];
    crate::inverse::albedo_error(
        albedo,
        texels,
        &surface.labels,
        irradiance_error,
        footprint,
        reflects,
    )
}

/// Room ids per texel: the scene's own grid, or the rooms found in the mesh.
fn rooms_of(surface: &Surface, options: &SolveOptions, progress: &Progress) -> Plane<u16> {
    let scene = surface.scene;
    let Some(grid) = choose_rooms(scene, &surface.tracer, options, progress) else {
        return surface.texels.scatter(&vec![1; surface.texels.len()], 0);
    };
    let rooms: Vec<u16> = (0..surface.texels.len())
        .map(|i| {
            let p = surface.texels.point[i];
            let (_, face_normal) = surface.normals(p.triangle as usize, p.u, p.v);
            grid.room_of_surface(surface.texels.position(&scene.mesh, i), face_normal)
        })
        .collect();
    surface.texels.scatter(&rooms, 0)
}
