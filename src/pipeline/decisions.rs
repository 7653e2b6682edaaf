//! Model only what a scene requires: each choice is made from evidence, says why, and can be forced.

use super::{SolveOptions, Switch};
use crate::gbuffer::{ObservedView, Observer, Orientation};
use crate::geometry::Mesh;
use crate::lighting::Environment;
use crate::progress::Progress;
use crate::sampling::{Discrete, KeyedRng};
use crate::scene::{RoomGrid, Scene};
use crate::trace::Tracer;

/// Sides of the textures, texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Albedo, radiance, emission, labels.
    pub albedo: usize,
    /// Roughness.
    pub roughness: usize,
    /// Irradiance.
    pub irradiance: usize,
}

/// Surface points that are asked how sharply the photographs see them.
const POINTS: usize = 20_000;
/// Share of the seen surface on which a texel is no larger than the sharpest pixel.
const RESOLVED: f64 = 0.9;
/// Sizes are multiples of this.
const STEP: usize = 64;

/// Texture sizes: as given, or as sharp as the photographs and no sharper.
pub(super) fn choose_sizes(observer: &Observer, orientation: &Orientation, options: &SolveOptions, progress: &Progress) -> Sizes {
    let given = [options.albedo_size, options.roughness_size, options.irradiance_size];
    let fit = [options.fit.albedo, options.fit.roughness, options.fit.irradiance];
    let supported = if fit.contains(&true) { supported_side(observer, orientation, options.seed) } else { None };
    let mut sides = given;
    for (i, (name, flag)) in
        [("albedo", "albedo-size"), ("roughness", "roughness-size"), ("irradiance", "irradiance-size")].into_iter().enumerate()
    {
        let what = format!("{name} texture");
        match supported {
            Some(needed) if fit[i] => {
                sides[i] = given[i].min(needed);
                let why = format!(
                    "at {needed}² a texel is as small as the sharpest pixel on {:.0} % of the seen surface; at most {}² allowed",
                    100.0 * RESOLVED,
                    given[i]
                );
                progress.decide(&what, format!("{0}²", sides[i]), why, false);
            }
            None if fit[i] => progress.decide(&what, format!("{0}²", given[i]), "no view sees the surface clearly", false),
            _ => progress.decide(&what, format!("{0}²", given[i]), format!("--{flag} or --fit-textures"), true),
        }
    }
    Sizes { albedo: sides[0], roughness: sides[1], irradiance: sides[2] }
}

/// Side of a texture whose texels are as small as the sharpest clean look at them on [`RESOLVED`] of the seen surface; `None` if
/// nothing is seen.
fn supported_side(observer: &Observer, orientation: &Orientation, seed: u64) -> Option<usize> {
    let mesh: &Mesh = observer.mesh;
    let areas: Vec<f64> =
        (0..mesh.triangles.len()).map(|t| f64::from(mesh.area(t))).map(|a| if a.is_finite() { a } else { 0.0 }).collect();
    let table = Discrete::new(&areas)?;
    let mut needed: Vec<f64> = crate::parallel::map_chunks(POINTS, 500, |range| {
        let mut seen = Vec::new();
        range
            .filter_map(|i| point_needs(observer, orientation, &table, KeyedRng::new(seed ^ 0xf007, i as u64), &mut seen))
            .collect::<Vec<f64>>()
    })
    .into_iter()
    .flatten()
    .collect();
    needed.sort_by(f64::total_cmp);
    let side = *needed.get((RESOLVED * needed.len() as f64) as usize)?;
    Some(((side / STEP as f64).ceil().clamp(1.0, 256.0) as usize) * STEP)
}

/// The texture side that one random surface point asks for; `None` where no view sees it clearly.
fn point_needs(
    observer: &Observer,
    orientation: &Orientation,
    table: &Discrete,
    mut rng: KeyedRng,
    seen: &mut Vec<crate::gbuffer::Observation>,
) -> Option<f64> {
    let mesh = observer.mesh;
    let t = table.sample(rng.next_f32()).0;
    let [u, v] = crate::sampling::square_to_triangle([rng.next_f32(), rng.next_f32()]);
    observer.observe(mesh.position(t, u, v), mesh.face_normal(t) * orientation.sign(t), seen);
    let sharpest = seen.iter().filter(|o| o.clean).map(|o| o.footprint).fold(f32::INFINITY, f32::min);
    let [a, b, c] = mesh.corner_uvs(t);
    let atlas = 0.5 * f64::from((b - a).perp_dot(c - a).abs());
    let metres = (f64::from(mesh.area(t)) / atlas).sqrt();
    (sharpest.is_finite() && sharpest > 0.0 && metres.is_finite()).then(|| metres / f64::from(sharpest))
}

/// The environment that the views see past all geometry, unless it is black or forbidden.
pub(super) fn choose_environment(views: &[ObservedView], options: &SolveOptions, progress: &Progress) -> Environment {
    let what = "environment";
    if options.environment == Switch::Off {
        progress.decide(what, "none", "--environment off", true);
        return Environment::black();
    }
    let environment = Environment::observe(views);
    if environment.is_black() {
        progress.decide(what, "none", "no ray of any view escapes the geometry, or only into darkness", false);
    } else {
        let share = 100.0 * environment.seen_share();
        progress.decide(what, "used", format!("views see past the geometry in {share:.1} % of directions"), false);
    }
    environment
}

/// Says which surfaces emit.
pub(super) fn report_emission(emissive: &[bool], known: &[bool], options: &SolveOptions, progress: &Progress) {
    let count = |marks: &[bool]| marks.iter().filter(|e| **e).count();
    let (all, declared) = (count(emissive), count(known));
    if options.emission == Switch::Off {
        progress.decide("emission", "none", "--emission off", true);
    } else if all == 0 {
        progress.decide("emission", "none", "no surface sends out more light than white would reflect there", false);
    } else {
        let why = format!("{declared} of kind light, {} send out more than white would reflect there", all - declared.min(all));
        progress.decide("emission", format!("{all} triangles"), why, false);
    }
}

/// The rooms of the scene, or `None` if it counts as one.
pub(super) fn choose_rooms(scene: &Scene, tracer: &dyn Tracer, options: &SolveOptions, progress: &Progress) -> Option<RoomGrid> {
    if options.rooms == Switch::Off {
        progress.decide("rooms", "one", "--rooms off", true);
        return None;
    }
    let grid = scene.rooms.clone().unwrap_or_else(|| crate::scene::find_rooms(scene, tracer));
    let why = match (&scene.rooms, grid.count()) {
        (Some(_), _) => "rooms_path of the scene",
        (None, 0 | 1) => "walls enclose one free floor",
        (None, _) => "walls divide the free floor",
    };
    progress.decide("rooms", grid.count().to_string(), why, false);
    Some(grid)
}
