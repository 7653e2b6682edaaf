//! The last stages, of photographs and scans alike: rooms are balanced, light that nobody saw is added,
//! paint is found, errors are stated and the textures assembled. Called by `solve` and `delight`
//! once there is an albedo.

use super::albedo::albedo_errors;
use super::assemble::assemble;
use super::clipped_light::{ClippedLights, FoundLight};
use super::doubt::Doubt;
use super::energy_balance::{Balanced, balance_rooms};
use super::findings::{doubt_of_infinite, findings, spread_of_looks};
use super::metals::metal_texels;
use super::missing_light::add_missing_light;
use super::painted::{Estimate, settle_palettes};
use super::panes::show_panes;
use super::room_levels::{PooledLevels, pool_room_levels};
use super::solved::Solved;
use super::{Light, Roughness, SolveOptions};
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::switch::Switch;
use crate::inverse::{
    AlbedoEstimate, Ground, Metal, StatedErrors, TexelReflectance, settle_contradicted,
};
use crate::observed::Surface;
use crate::verdict::{Findings, MissingLight};

/// What is estimated before it is settled what it all amounts to.
pub(super) struct Estimated<'a> {
    pub(super) albedo: AlbedoEstimate,
    pub(super) roughness: &'a Roughness,
    /// Light beyond the photographs' ceiling that was found.
    pub(super) clipped_light: Option<ClippedLights>,
    /// What is against the result besides what its own texels tell.
    pub(super) doubts: Vec<Doubt>,
    /// Rays traced so far.
    pub(super) rays: u64,
}

/// Light and albedo are balanced, completed and painted; then errors and textures follow.
pub(super) fn settle(
    surface: &Surface,
    mut light: Light,
    estimated: Estimated<'_>,
    options: &SolveOptions,
    progress: &Progress,
) -> Solved {
    let Estimated {
        mut albedo,
        roughness,
        clipped_light,
        doubts,
        mut rays,
    } = estimated;
    let clipped = clipped_light.as_ref().map(|c| c.missing);
    let mut lights = clipped_light.map_or_else(Vec::new, |c| c.lights);
    forget_lit(&mut albedo, &lights);
    let metals = metal_texels(surface, &light, &roughness.metals);
    forget_clear(surface, &metals, &mut albedo);
    let rooms = roughness.texel_rooms(&surface.texels);
    let mut short = progress.stage("energy balance", 0, |p| {
        balance_rooms(surface, &mut light, &mut albedo, &rooms, options, p)
    });
    if let Some(short) = &mut short {
        forget_lit(&mut albedo, &short.lamps);
        lights.append(&mut short.lamps);
    }
    if options.emission == Switch::Off {
        lights.iter_mut().for_each(|light| light.emits = false);
    }
    rays += unseen_light(
        surface,
        &mut light,
        &mut albedo,
        &roughness.reflectance,
        options,
        progress,
    );
    let levels = (short.as_ref())
        .map(|_| keep_room_levels(surface, &mut light, &mut albedo, &rooms))
        .unwrap_or_default();
    let spread = spread_of_looks(&albedo);
    settle_hidden(surface, &mut albedo, &rooms, &levels);
    let StatedErrors {
        error: mut errors,
        unexplained,
    } = progress.stage("stated errors", 1, |_| {
        stated_errors(surface, &light, &albedo, short.as_ref())
    });
    let estimate = Estimate {
        albedo: &mut albedo,
        errors: &mut errors,
        rooms: &rooms,
    };
    progress.stage("paint", 0, |p| {
        settle_palettes(surface, &mut light, estimate, options, p);
    });
    show_metals(&metals, &mut albedo, &mut errors);
    show_panes(surface, &mut albedo, &mut errors);
    let mut findings = progress.stage("findings", 1, |_| {
        findings(surface, &light, &albedo, &errors, &spread)
    });
    findings.unexplained = f64::from(unexplained);
    add_doubts(&mut findings, doubts);
    if clipped.is_none() {
        (findings.others).extend(doubt_of_infinite(&surface.shortfalls));
    }
    findings.light_missing = MissingLight::both(clipped, short.map(|s: Balanced| s.missing));
    let model_error = findings.model_error() as f32; // what no texel knows of by itself
    add_error(&mut errors, |_| model_error);
    let solution = progress.stage("textures", 1, |_| {
        assemble(surface, &light, roughness, &albedo, &errors, &lights)
    });
    Solved {
        solution,
        fits: roughness.materials.fits().cloned().collect(),
        rays,
        findings,
    }
}

/// The albedo's errors, those of the lamps that a room lacked included.
fn stated_errors(
    surface: &Surface,
    light: &Light,
    albedo: &AlbedoEstimate,
    short: Option<&Balanced>,
) -> StatedErrors {
    let mut stated = albedo_errors(surface, light, albedo);
    if let Some(short) = short {
        add_error(&mut stated.error, |i| short.cast_error[i]);
    }
    stated
}

/// What metals and panes show is no diffuse light.
fn forget_clear(surface: &Surface, metals: &[(u32, &Metal)], albedo: &mut AlbedoEstimate) {
    metals.iter().for_each(|m| albedo.forget(m.0 as usize));
    let panes = surface.panes.texels(&surface.texels);
    panes.for_each(|(i, _)| albedo.forget(i));
}

/// Gives the texels of metals what these reflect.
fn show_metals(metals: &[(u32, &Metal)], albedo: &mut AlbedoEstimate, errors: &mut [f32]) {
    for &(i, metal) in metals {
        let i = i as usize;
        (albedo.value[i], albedo.error[i]) = (metal.f0, metal.f0_error);
        errors[i] = metal.f0_error;
    }
}

/// Adds light that no camera looks along, unless the options say no; the rays traced.
fn unseen_light(
    surface: &Surface,
    light: &mut Light,
    albedo: &mut AlbedoEstimate,
    reflectance: &TexelReflectance,
    options: &SolveOptions,
    progress: &Progress,
) -> u64 {
    if options.missing_light == Switch::Off {
        return 0;
    }
    let added = progress.stage("missing light", 0, |p| {
        add_missing_light(surface, light, albedo, reflectance, options.seed, p)
    });
    progress.note(format!(
        "light that no camera looks along (specular reflections, far sides) changes the \
         irradiance by {:+.1} % on average",
        100.0 * added.change
    ));
    added.rays
}

/// Lets what was added to a room whose level its paint told take the place of what that asked for.
fn keep_room_levels(
    surface: &Surface,
    light: &mut Light,
    albedo: &mut AlbedoEstimate,
    rooms: &[u16],
) -> PooledLevels {
    let found = albedo.value.clone();
    pool_room_levels(surface, light, albedo, &found, rooms)
}

/// Surface before which something stands that the mesh lacks takes what its class is like: nearby, for
/// boards and tiles differ, but not as far as rooms share a paint, for then it is their light that does.
fn settle_hidden(
    surface: &Surface,
    albedo: &mut AlbedoEstimate,
    rooms: &[u16],
    levels: &PooledLevels,
) {
    let contradicted: Vec<u32> = (0..surface.texels.len() as u32)
        .filter(|&i| surface.contradictions.contradicted(i as usize))
        .collect();
    let ground = Ground {
        texels: &surface.texels,
        mesh: &surface.scene.mesh,
        labels: &surface.labels,
        rooms,
    };
    let nearby = |i: usize| {
        let common = levels.common.get(&(surface.labels[i], rooms[i]));
        1.0 - common.copied().unwrap_or(0.0)
    };
    settle_contradicted(&ground, &contradicted, &nearby, albedo);
}

/// Adds what is against the result besides what its own texels tell.
fn add_doubts(findings: &mut Findings, doubts: Vec<Doubt>) {
    let mean = findings.mean_albedo;
    let reasons = doubts.into_iter().map(|d| d.reason(mean));
    findings.others.extend(reasons);
}

/// Adds an independent error to every texel's.
fn add_error(errors: &mut [f32], error: impl Fn(usize) -> f32 + Sync + Send) {
    let errors = errors.par_iter_mut().enumerate();
    errors.for_each(|(i, e)| *e = e.hypot(error(i)));
}

/// What a clipped light hides of its surface is unknown: lamps, and what the sun shines on.
fn forget_lit(albedo: &mut AlbedoEstimate, lights: &[FoundLight]) {
    for &i in lights.iter().flat_map(|l| &l.texels) {
        albedo.forget(i as usize);
    }
}
