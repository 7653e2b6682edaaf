//! Model only what a scene requires: each choice is made from evidence, says why, and can be
//! forced.

use super::time_budget::Workload;
use super::{Quality, SolveOptions, Switch};
use crate::core::brdf::Reflectance;
use crate::core::geometry::Mesh;
use crate::core::image::RgbPlane;
use crate::core::progress::Progress;
use crate::core::sampling::{Discrete, KeyedRng};
use crate::core::trace::{Hit, Tracer};
use crate::gbuffer::{ObservedView, Observer, Orientation};
use crate::highlight::Evidence;
use crate::inverse::{ClassPalette, Materials, Metal, choose_model, fit_groups};
use crate::observed::{Pane, Panes, Surface, TextureSizes};
use crate::radiance::Environment;
use crate::scene::{RoomGrid, Scene};
use crate::specular::WIDE;
use glam::Vec3;
use std::collections::BTreeSet;
use std::time::Instant;

/// Surface points that are asked how sharply the photographs see them.
const POINTS: usize = 20_000;
/// Share of the seen surface on which a texel is no larger than the sharpest pixel: the half that
/// is seen best needs no finer ones (measured on a synthetic room: at twice the side, held-out
/// albedo −0.1 dB and views +0.1 dB; at half of it −0.3 and −0.7 dB).
const RESOLVED: f64 = 0.5;
const RESOLVED_HIGH: f64 = 0.9;
/// Sizes are multiples of this.
const STEP: usize = 64;

/// Texture sizes: as given, or as sharp as the photographs and no sharper, and within the budget if
/// there is one.
pub(super) fn choose_sizes(
    observer: &Observer,
    orientation: &Orientation,
    options: &SolveOptions,
    progress: &Progress,
) -> TextureSizes {
    let asked = Asked::textures(options);
    let supported = Supported::of(observer, orientation, options);
    let [albedo, roughness, irradiance] = asked.each_ref().map(|a| a.side(&supported));
    let sizes = TextureSizes {
        albedo,
        roughness,
        irradiance,
    };
    for (a, side) in asked.iter().zip([albedo, roughness, irradiance]) {
        a.report(side, &supported, progress);
    }
    let Some(budget) = &options.budget else {
        return sizes;
    };
    let work = workload(observer, &supported, options);
    let cheaper = budget.sizes(sizes, &work, progress);
    let keep = |i: usize, size: usize, lower: usize| if asked[i].fit { lower } else { size };
    TextureSizes {
        albedo: keep(0, sizes.albedo, cheaper.albedo),
        roughness: keep(1, sizes.roughness, cheaper.roughness),
        irradiance: keep(2, sizes.irradiance, cheaper.irradiance),
    }
}

/// What the options ask of a texture's size.
struct Asked {
    name: &'static str,
    flag: &'static str,
    /// Its side, or the largest allowed if it is to fit.
    given: usize,
    /// Whether it is to be no sharper than the photographs.
    fit: bool,
}

impl Asked {
    /// Albedo, roughness, irradiance.
    fn textures(options: &SolveOptions) -> [Self; 3] {
        [
            Self {
                name: "albedo",
                flag: "albedo-size",
                given: options.albedo_size,
                fit: options.fit.albedo,
            },
            Self {
                name: "roughness",
                flag: "roughness-size",
                given: options.roughness_size,
                fit: options.fit.roughness,
            },
            Self {
                name: "irradiance",
                flag: "irradiance-size",
                given: options.irradiance_size,
                fit: options.fit.irradiance,
            },
        ]
    }

    fn side(&self, supported: &Supported) -> usize {
        match supported.side {
            Some(needed) if self.fit => self.given.min(needed),
            _ => self.given,
        }
    }

    fn report(&self, side: usize, supported: &Supported, progress: &Progress) {
        let why = match supported.side {
            Some(needed) if self.fit => format!(
                "at {needed}² a texel is as small as the sharpest pixel on {:.0} % of the seen surface; at most {}² allowed",
                100.0 * supported.share,
                self.given
            ),
            None if self.fit => "no view sees the surface clearly".to_owned(),
            _ => format!("--{} or --fit-textures", self.flag),
        };
        let what = format!("{} texture", self.name);
        progress.decide(&what, format!("{side}²"), why, !self.fit);
    }
}

/// How sharp a texture the photographs support.
struct Supported {
    /// Its side; `None` if nothing is seen, or nothing asks.
    side: Option<usize>,
    /// Share of the seen surface on which its texels are no larger than the sharpest pixel.
    share: f64,
    /// Seconds that asking took, per point.
    lookup: f64,
}

impl Supported {
    fn of(observer: &Observer, orientation: &Orientation, options: &SolveOptions) -> Self {
        let begin = Instant::now();
        let fit = [
            options.fit.albedo,
            options.fit.roughness,
            options.fit.irradiance,
        ];
        let share = if options.quality == Quality::High {
            RESOLVED_HIGH
        } else {
            RESOLVED
        };
        let side = if fit.contains(&true) || options.budget.is_some() {
            supported_side(observer, orientation, share, options.seed)
        } else {
            None
        };
        Self {
            side,
            share,
            lookup: begin.elapsed().as_secs_f64() / POINTS as f64,
        }
    }
}

/// What a reconstruction from these views costs by.
fn workload(observer: &Observer, supported: &Supported, options: &SolveOptions) -> Workload {
    let pixels: usize = observer.views.iter().map(|v| v.radiance.data.len()).sum();
    Workload {
        covered: observer.mesh.covered_share(),
        lookup: supported.lookup,
        pixels: pixels as f64,
        edge_pixels: if options.edges == Switch::Off {
            0.0
        } else {
            edge_pixels(observer) as f64
        },
        report_pixels: report_pixels(observer),
    }
}

/// Pixels that show a surface and are not clean.
fn edge_pixels(observer: &Observer) -> usize {
    let of = |v: &ObservedView| {
        v.clean
            .data
            .iter()
            .zip(&v.buffer.triangle.data)
            .filter(|(clean, t)| !**clean && **t != Hit::MISS)
            .count()
    };
    observer.views.iter().map(of).sum()
}

/// Pixels that a report of these views renders: up to six views of up to 768 columns.
fn report_pixels(observer: &Observer) -> f64 {
    let pixels = |v: &ObservedView| {
        let (w, h) = (v.radiance.width as f64, v.radiance.height as f64);
        w * h * (768.0 / w).min(1.0).powi(2)
    };
    observer.views.iter().take(6).map(pixels).sum()
}

/// Side of a texture whose texels are as small as the sharpest clean look at them on a share
/// `resolved` of the seen surface; `None` if nothing is seen.
fn supported_side(
    observer: &Observer,
    orientation: &Orientation,
    resolved: f64,
    seed: u64,
) -> Option<usize> {
    let mesh: &Mesh = observer.mesh;
    let areas: Vec<f64> = (0..mesh.triangles.len())
        .map(|t| f64::from(mesh.area(t)))
        .map(|a| if a.is_finite() { a } else { 0.0 })
        .collect();
    let table = Discrete::new(&areas)?;
    let mut needed: Vec<f64> = crate::core::parallel::map_chunks(POINTS, 500, |range| {
        let mut seen = Vec::new();
        range
            .filter_map(|i| {
                required_resolution(
                    observer,
                    orientation,
                    &table,
                    KeyedRng::new(seed ^ 0xf007, i as u64),
                    &mut seen,
                )
            })
            .collect::<Vec<f64>>()
    })
    .into_iter()
    .flatten()
    .collect();
    needed.sort_by(f64::total_cmp);
    let side = *needed.get((resolved * needed.len() as f64) as usize)?;
    Some(((side / STEP as f64).ceil().clamp(1.0, 256.0) as usize) * STEP)
}

/// The texture side that one random surface point asks for; `None` where no view sees it clearly.
fn required_resolution(
    observer: &Observer,
    orientation: &Orientation,
    table: &Discrete,
    mut rng: KeyedRng,
    seen: &mut Vec<crate::gbuffer::Observation>,
) -> Option<f64> {
    let mesh = observer.mesh;
    let t = table.sample(rng.next_f32()).0;
    let [u, v] = crate::core::sampling::square_to_triangle([rng.next_f32(), rng.next_f32()]);
    observer.observe(
        mesh.position(t, u, v),
        mesh.face_normal(t) * orientation.sign(t),
        seen,
    );
    let sharpest = seen
        .iter()
        .filter(|o| o.clean)
        .map(|o| o.footprint)
        .fold(f32::INFINITY, f32::min);
    let metres = (f64::from(mesh.area(t)) / f64::from(mesh.chart_area(t))).sqrt();
    (sharpest.is_finite() && sharpest > 0.0 && metres.is_finite())
        .then(|| metres / f64::from(sharpest))
}

/// The environment that the views see past all geometry, unless it is black or forbidden.
pub(super) fn choose_environment(
    surface: &Surface,
    options: &SolveOptions,
    progress: &Progress,
) -> Environment {
    let what = "environment";
    if options.environment == Switch::Off {
        progress.decide(what, "none", "--environment off", true);
        return Environment::black();
    }
    if surface.ambient != Vec3::ZERO {
        progress.decide(
            what,
            "the surface's mean radiance",
            "nobody looked through the holes of the scan: behind them lies more of the room",
            false,
        );
        return Environment::from_map(RgbPlane::filled(2, 1, surface.ambient));
    }
    let environment = Environment::observe(&surface.views);
    if environment.is_black() {
        progress.decide(
            what,
            "none",
            "no ray of any view escapes the geometry, or only into darkness",
            false,
        );
    } else {
        let share = 100.0 * environment.seen_share();
        progress.decide(
            what,
            "used",
            format!("views see past the geometry in {share:.1} % of directions"),
            false,
        );
    }
    environment
}

/// Says which surfaces emit.
pub(super) fn report_emission(
    emissive: &[bool],
    known: &[bool],
    options: &SolveOptions,
    progress: &Progress,
) {
    let count = |marks: &[bool]| marks.iter().filter(|e| **e).count();
    let (all, declared) = (count(emissive), count(known));
    if options.emission == Switch::Off {
        progress.decide("emission", "none", "--emission off", true);
    } else if all == 0 {
        progress.decide(
            "emission",
            "none",
            "no surface sends out more light than white would reflect there",
            false,
        );
    } else {
        let why = format!(
            "{declared} of kind light, {} send out more than white would reflect there",
            all - declared.min(all)
        );
        progress.decide("emission", format!("{all} triangles"), why, false);
    }
}

/// Standard errors of the roughness by which a class must lie above [`WIDE`] to count as matte.
const CERTAIN: f32 = 3.0;

/// Classes whose lobes a few points show to be too wide for highlights, under the model that suits
/// those points.
pub(super) fn choose_matte(pilot: &Evidence, options: &SolveOptions) -> BTreeSet<u16> {
    if options.matte == Switch::Off {
        return BTreeSet::new();
    }
    let fits = match options.reflectance {
        Some(model) => fit_groups(pilot, model),
        None => choose_model(pilot).1,
    };
    fits.iter()
        .filter(|f| f.points > 0 && f.roughness - CERTAIN * f.error > WIDE)
        .map(|f| f.class)
        .collect()
}

/// Says which classes go without specular rays.
pub(super) fn report_matte(
    scene: &Scene,
    matte: &BTreeSet<u16>,
    options: &SolveOptions,
    progress: &Progress,
) {
    let what = "specular rays";
    match options.matte {
        Switch::Off => progress.decide(what, "for all classes", "--matte off", true),
        Switch::On => progress.decide(what, "for roughness below 0.5", "--matte on", true),
        Switch::Auto if matte.is_empty() => {
            progress.decide(
                what,
                "for all classes",
                "no class is certain to have lobes too wide for highlights",
                false,
            );
        }
        Switch::Auto => {
            let names: BTreeSet<String> = matte.iter().map(|c| scene.class_name(*c)).collect();
            let list = names.into_iter().collect::<Vec<_>>().join(", ");
            let why = format!(
                "their roughness exceeds {WIDE} by {CERTAIN} standard errors: no highlight can be observed"
            );
            progress.decide(what, format!("for all classes but {list}"), why, false);
        }
    }
}

/// Says which reflection model explains the views, with the disagreement of each.
pub(super) fn report_model(
    model: Reflectance,
    scores: &[(Reflectance, f64)],
    options: &SolveOptions,
    progress: &Progress,
) {
    let list: Vec<String> = scores
        .iter()
        .map(|(m, s)| format!("{m:?} {:.3} %", 100.0 * s))
        .collect();
    let forced = options.reflectance.is_some();
    let why = if forced {
        "--reflectance".to_owned()
    } else {
        format!(
            "the simplest of those that explain the views; disagreement {}",
            list.join(", ")
        )
    };
    progress.decide("reflection model", format!("{model:?}"), why, forced);
}

/// Says which classes are metal.
pub(super) fn report_metals(scene: &Scene, metals: &[Metal], progress: &Progress) {
    let what = "metals";
    if metals.is_empty() {
        let why = "no class is explained better without a diffuse part";
        progress.decide(what, "none", why, false);
    } else {
        let one = |m: &Metal| {
            format!(
                "{} (F0 {:.2} {:.2} {:.2} ± {:.2}, roughness {:.2} ± {:.2})",
                scene.class_name(m.fit.class),
                m.f0.x,
                m.f0.y,
                m.f0.z,
                m.f0_error,
                m.fit.roughness,
                m.fit.error
            )
        };
        let list: Vec<String> = metals.iter().map(one).collect();
        let why = format!(
            "views are explained better by a coloured lobe alone: {}",
            list.join("; ")
        );
        progress.decide(what, format!("{} classes", metals.len()), why, false);
    }
}

/// Says which surfaces photographs look through.
pub(super) fn report_panes(scene: &Scene, panes: &Panes, progress: &Progress) {
    let what = "panes";
    if panes.is_empty() {
        let why = "no surface shows what lies behind it";
        return progress.decide(what, "none", why, false);
    }
    let one = |p: &Pane| {
        format!(
            "{} (a face lets {:.2} {:.2} {:.2} ± {:.2} through)",
            scene.class_name(p.class),
            p.tint.x,
            p.tint.y,
            p.tint.z,
            p.tint_error
        )
    };
    let list: Vec<String> = panes.panes.iter().map(one).collect();
    let why = format!(
        "views of them are foretold better by what lies behind: {}",
        list.join("; ")
    );
    progress.decide(what, format!("{} surfaces", list.len()), why, false);
}

/// Says which classes have more than one roughness.
pub(super) fn report_materials(
    scene: &Scene,
    materials: &Materials,
    options: &SolveOptions,
    progress: &Progress,
) {
    if options.divide == Switch::Off {
        progress.decide("roughness", "one per class", "--divide-classes off", true);
        return;
    }
    let by_colour = materials
        .by_colour()
        .map(|(id, [a, b])| format!("{} by colour ({a:.2}, {b:.2})", scene.class_name(id)));
    let by_room = materials.by_room().map(|(id, rooms)| {
        let values: Vec<String> = rooms
            .iter()
            .map(|(room, r)| format!("room {room}: {r:.2}"))
            .collect();
        format!("{} by room ({})", scene.class_name(id), values.join(", "))
    });
    let by_place = materials
        .by_place()
        .map(|(id, [a, b])| format!("{} by place ({a:.2} to {b:.2})", scene.class_name(id)));
    let list: Vec<String> = by_colour.chain(by_room).chain(by_place).collect();
    if list.is_empty() {
        let why = "neither by room nor by colour nor by place do several values explain held-out views better than one";
        progress.decide("roughness", "one per class", why, false);
    } else {
        let why = format!(
            "held-out views are explained better so: {}",
            list.join("; ")
        );
        progress.decide(
            "roughness",
            format!("one per class, several in {}", list.len()),
            why,
            false,
        );
    }
}

/// Says which classes are painted.
pub(super) fn report_paint(
    scene: &Scene,
    paints: &[ClassPalette],
    options: &SolveOptions,
    progress: &Progress,
) {
    let list: Vec<String> = paints
        .iter()
        .map(|p| match p.colours.len() {
            1 => scene.class_name(p.class),
            n => format!("{} ({n} colours)", scene.class_name(p.class)),
        })
        .collect();
    let forced = options.painted == Switch::On;
    let why = if forced {
        "--painted on"
    } else {
        "their flat surface shows no texture, and few colours explain nearly all of it"
    };
    if list.is_empty() {
        progress.decide(
            "painted in few colours",
            "no class",
            "all show texture, or too many colours",
            forced,
        );
    } else {
        progress.decide("painted in few colours", list.join(", "), why, forced);
    }
}

/// The rooms of the scene, or `None` if it counts as one.
pub(super) fn choose_rooms(
    scene: &Scene,
    tracer: &dyn Tracer,
    options: &SolveOptions,
    progress: &Progress,
) -> Option<RoomGrid> {
    if options.rooms == Switch::Off {
        progress.decide("rooms", "one", "--rooms off", true);
        return None;
    }
    let grid = scene
        .rooms
        .clone()
        .unwrap_or_else(|| crate::scene::find_rooms(scene, tracer));
    let why = match (&scene.rooms, grid.count()) {
        (Some(_), _) => "rooms_path of the scene",
        (None, 0 | 1) => "walls enclose one free floor",
        (None, _) => "walls divide the free floor",
    };
    progress.decide("rooms", grid.count().to_string(), why, false);
    Some(grid)
}
