//! `unbake bench light`: irradiance against path-traced truth, and what its rays meet.
//!
//! The truth is the scene's own: albedo and roughness of `gt/` fused on the atlas like radiance
//! (what no view sees clean takes its class's median), lamps and sky in their photographed
//! radiance, paths with as many bounces as the photographs were rendered with. E of the first bake
//! is compared at points of the surface by class; the radiance that its rays find is compared ray
//! by ray, by the kind of surface they meet: where the errors come from. Called by `unbake bench`.

use super::BenchScene;
use crate::Result;
use crate::core::brdf::Reflectance;
use crate::core::geometry::{Camera, Lens, Projection};
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::{Frame, luminance};
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::sampling::{KeyedRng, square_to_cosine_hemisphere};
use crate::core::stats::median_colours;
use crate::core::texture::{Texels, fill_uncovered};
use crate::core::trace::{EmbreeTracer, Hit, Ray, Tracer};
use crate::error::Error;
use crate::gbuffer::Observer;
use crate::irradiance::{Estimator, IrradianceOptions};
use crate::observed::fuse_radiance;
use crate::pipeline::SolveOptions;
use crate::programs::evaluate::true_materials;
use crate::render::EditableScene;
use crate::render::path_tracer::{IrradiancePoint, PathTracer, PathTracerOptions};
use crate::scene::Scene;
use crate::solution::Solution;
use glam::{Mat3, Vec2, Vec3};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// What `unbake bench light` can be told.
#[derive(clap::Args, Clone, Debug)]
pub struct LightBench {
    /// Points of the surface at which irradiance is compared.
    #[arg(long, value_name = "N", default_value_t = 2000)]
    pub points: usize,
    /// Paths per point.
    #[arg(long, value_name = "N", default_value_t = 512)]
    pub paths: u32,
    /// Rays per point whose finds are compared one by one.
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub rays: usize,
    /// Bounces of a path at most: those of the renderer that made the photographs.
    #[arg(long, value_name = "N", default_value_t = 12)]
    pub bounces: u32,
    /// The reflection model of the true materials.
    #[arg(long, value_enum, default_value = "burley")]
    pub model: Reflectance,
    /// Also compare the irradiance of this reconstruction.
    #[arg(long, value_name = "OUT")]
    pub result: Option<std::path::PathBuf>,
}

/// Irradiance of a class, relative to the truth.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ClassLevel {
    /// Class name.
    pub class: String,
    /// Points.
    pub points: usize,
    /// Sum of the first bake's E over sum of the true E.
    pub mean: f64,
    /// Median of E over the true E, first bake.
    pub median: f64,
    /// Quartiles of it.
    pub quartiles: [f64; 2],
    /// Median for the reconstruction's E, if one was given.
    pub result: Option<f64>,
}

/// What rays meet.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Met {
    /// Class of the receivers.
    pub receiver: String,
    /// Kind or class of what is met.
    pub met: String,
    /// Share of the receivers' rays.
    pub share: f64,
    /// What the light field finds there, as a share of the receivers' true irradiance.
    pub found: f64,
    /// What a path tracer finds there, likewise.
    pub truth: f64,
}

/// What `unbake bench light` measures.
#[derive(Clone, Debug, Serialize)]
pub struct LightReport {
    /// Irradiance by class of the receiver.
    pub classes: Vec<ClassLevel>,
    /// What rays meet, by kind.
    pub kinds: Vec<Met>,
    /// What rays meet, by class.
    pub targets: Vec<Met>,
}

impl LightReport {
    /// Tables for the terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::from("E/E_true      points   mean  median  quartiles      result\n");
        for c in &self.classes {
            let result = c.result.map_or(String::new(), |r| format!("{r:6.3}"));
            let _ = writeln!(
                out,
                "{:20} {:5} {:6.3} {:6.3}  {:.3} {:.3}  {result}",
                c.class, c.points, c.mean, c.median, c.quartiles[0], c.quartiles[1]
            );
        }
        for (title, rows) in [("kind", &self.kinds), ("class", &self.targets)] {
            let _ = writeln!(
                out,
                "\nreceiver             {title} met               rays   found   truth   error  (of the receiver's true E)"
            );
            for m in rows {
                let _ = writeln!(
                    out,
                    "{:20} {:22} {:5.1} % {:5.1} % {:5.1} % {:+5.1} %",
                    m.receiver,
                    m.met,
                    100.0 * m.share,
                    100.0 * m.found,
                    100.0 * m.truth,
                    100.0 * (m.found - m.truth)
                );
            }
        }
        out
    }
}

/// Runs the measurement.
///
/// # Errors
/// An unusable scene, or one without ground truth.
pub fn bench_light(
    scene: &Scene,
    bench: &LightBench,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<LightReport> {
    let ground = BenchScene::prepare(scene, options, progress)?;
    let truth = true_solution(&ground, bench.model, progress)?;
    let world = EditableScene::new(&truth);
    let tracer = EmbreeTracer::new(&truth.mesh)?;
    let paths = PathTracerOptions {
        samples: bench.paths,
        max_bounces: bench.bounces,
        seed: options.seed ^ 0x11f7,
        ..PathTracerOptions::default()
    };
    let paths = PathTracer::new(world.mesh(), &tracer, &world, &world, paths);
    let surface = &ground.surface;
    let side = (surface.sizes.irradiance / 2).max(1);
    let texels = Texels::rasterize(&scene.mesh, side, side);
    let seen = surface.seen(&texels);
    let emits = |i: usize| ground.light.emissive[texels.point[i].triangle as usize];
    let counts = |i: usize| seen[i] && texels.interior[i] && !emits(i);
    let ids = ground.sample(&texels, counts, bench.points);
    let bake = IrradianceOptions {
        estimator: Estimator::Mis,
        rays: 1024,
        emitter_samples: 256,
        seed: options.seed ^ 0x11f8,
        drawn: [0, 0],
    };
    let baked = ground.bake_some(&texels, &ids, &bake, progress).value;
    let points: Vec<IrradiancePoint> = ids
        .iter()
        .map(|&i| surface.receiver(&texels, i))
        .map(|r| IrradiancePoint {
            position: r.position,
            face_normal: r.face_normal,
            normal: r.normal,
        })
        .collect();
    let real = progress.stage("true irradiance", points.len() as u64, |p| {
        paths.irradiance(&points, bench.paths, 1, p)
    });
    let name = |label: u16| scene.class_name(label);
    let labels = surface.texels.scatter(&surface.labels, 0);
    let all: Vec<u32> = (0..surface.texels.len() as u32).collect();
    let owner = surface.texels.scatter(&all, u32::MAX);
    let class_at = |(&i, p): (&usize, &IrradiancePoint)| {
        name(surface.nearest(&labels, texels.point[i].triangle, p.position))
    };
    let receivers: Vec<String> = ids.iter().zip(&points).map(class_at).collect();
    let ended = match &bench.result {
        Some(folder) => {
            let plane = Solution::load(folder)?.irradiance;
            let at = |&i: &usize| texels.lookup(&scene.mesh, &plane, i);
            Some(ids.iter().map(at).collect::<Vec<Vec3>>())
        }
        None => None,
    };
    let rays = Rays {
        ground: &ground,
        paths: &paths,
        labels: &labels,
        owner: &owner,
        name: &name,
    };
    let finds = progress.stage("what rays meet", points.len() as u64, |p| {
        rays.follow(&points, bench.rays, p)
    });
    Ok(LightReport {
        classes: levels(&receivers, &baked, &real, ended.as_deref()),
        kinds: met(&receivers, &finds, |f| f.kind.to_owned()),
        targets: met(&receivers, &finds, |f| f.class.clone()),
    })
}

/// The scene's true materials on the atlas, with its lamps and sky as photographed.
fn true_solution(ground: &BenchScene, model: Reflectance, progress: &Progress) -> Result<Solution> {
    let (surface, light) = (&ground.surface, &ground.light);
    let scene = surface.scene;
    let texels = &surface.texels;
    let mut views = surface.views.clone();
    let mut rough = surface.views.clone();
    for ((view, a), r) in scene.train_views().zip(&mut views).zip(&mut rough) {
        let truth = true_materials(scene, view)?.ok_or_else(|| {
            let folder = scene.folder.join("gt");
            Error::input(
                folder,
                format!("has no albedo and roughness of view {}: without truth there is nothing to compare with", view.stem),
            )
        })?;
        a.radiance = truth.albedo;
        r.radiance = truth.roughness.map(|r| Vec3::splat(*r));
    }
    let fused = |views| {
        let observer = Observer {
            mesh: &scene.mesh,
            views,
        };
        fuse_radiance(&observer, &surface.orientation, texels, progress).radiance
    };
    let albedo = completed(ground, fused(&views));
    let roughness = completed(ground, fused(&rough)).map(|r| r.x);
    let mesh = surface.oriented_mesh();
    let stated = stated_emission(scene)?;
    let emission: Vec<Vec3> = (0..texels.len())
        .map(|i| {
            if !light.emissive[texels.point[i].triangle as usize] {
                return Vec3::ZERO;
            }
            let seen = light.radiance.data[texels.cell[i] as usize];
            stated.get(&surface.labels[i]).copied().unwrap_or(seen)
        })
        .collect();
    Ok(Solution {
        portals: Vec::new(),
        lamps: Vec::new(),
        mesh,
        origin: scene.origin,
        albedo,
        roughness,
        irradiance: light.irradiance.clone(),
        radiance: light.radiance.clone(),
        emission: texels.scatter(&emission, Vec3::ZERO),
        confidence: Plane::filled(1, 1, Vec2::ZERO),
        metallic: None,
        transmission: None,
        irradiance_error: None,
        camera_masks: Vec::new(),
        rooms: Plane::filled(1, 1, 1),
        labels: texels.scatter(&surface.labels, 0),
        environment: light.field.environment.map().clone(),
        reflectance: model,
    })
}

/// Emitted radiance per class, where `gt/materials.json` states it.
fn stated_emission(scene: &Scene) -> Result<BTreeMap<u16, Vec3>> {
    #[derive(serde::Deserialize)]
    struct Stated {
        id: u16,
        emission: Option<[f32; 3]>,
    }
    let file = scene.folder.join("gt").join("materials.json");
    let Ok(text) = std::fs::read_to_string(&file) else {
        return Ok(BTreeMap::new());
    };
    let all: BTreeMap<String, Stated> = serde_json::from_str(&text).map_err(|e| {
        let expected = "expected one object per material with \"id\" and, for lamps, \"emission\"";
        Error::input(file, format!("{e}; {expected}"))
    })?;
    let emission = |m: Stated| Some((m.id, Vec3::from_array(m.emission?)));
    Ok(all.into_values().filter_map(emission).collect())
}

/// Values of texels that views see clean, the median of their class elsewhere.
fn completed(ground: &BenchScene, mut value: Vec<Vec3>) -> RgbPlane {
    let surface = &ground.surface;
    let clean = &surface.fusion.clean;
    let known = (0..value.len()).filter(|&i| clean[i]);
    let usual = median_colours(known.map(|i| (surface.labels[i], value[i])));
    for i in (0..value.len()).filter(|&i| !clean[i]) {
        let own = usual.get(&surface.labels[i]);
        value[i] = own.copied().unwrap_or(Vec3::splat(0.5));
    }
    let texels = &surface.texels;
    let known = texels.scatter(&vec![true; value.len()], false);
    fill_uncovered(&texels.scatter(&value, Vec3::ZERO), &known)
}

/// One ray's find.
struct Find {
    receiver: usize,
    kind: &'static str,
    class: String,
    found: f32,
    truth: f32,
}

/// Rays from the points, and what both transports find along them.
struct Rays<'a> {
    ground: &'a BenchScene<'a>,
    paths: &'a PathTracer<'a>,
    labels: &'a Plane<u16>,
    /// Index of the covered texel at each place of the atlas.
    owner: &'a Plane<u32>,
    name: &'a (dyn Fn(u16) -> String + Sync),
}

impl Rays<'_> {
    fn follow(&self, points: &[IrradiancePoint], count: usize, progress: &Progress) -> Vec<Find> {
        let surface = &self.ground.surface;
        let clean = surface.texels.scatter(&surface.fusion.clean, false);
        let seen: Vec<bool> = surface.fusion.views.iter().map(|v| *v > 0).collect();
        let seen = surface.texels.scatter(&seen, false);
        let of_point = |k: usize| -> Vec<Find> {
            let point = &points[k];
            let mut rng = KeyedRng::new(self.ground.options.seed, k as u64);
            let frame = Frame::from_normal(point.normal);
            let finds = (0..count).filter_map(|_| {
                let u = [rng.next_f32(), rng.next_f32()];
                let direction = frame.world_from_local(square_to_cosine_hemisphere(u));
                let above = direction.dot(point.face_normal) > 0.0;
                above.then(|| self.find(k, point, direction, [&clean, &seen]))
            });
            let finds = finds.collect();
            progress.advance(1);
            finds
        };
        (0..points.len())
            .into_par_iter()
            .flat_map_iter(of_point)
            .collect()
    }

    fn find(
        &self,
        receiver: usize,
        point: &IrradiancePoint,
        direction: Vec3,
        [clean, seen]: [&Plane<bool>; 2],
    ) -> Find {
        let (surface, light) = (&self.ground.surface, &self.ground.light);
        let origin = point.position + point.face_normal * surface.offset;
        let mut hit = [Hit::miss()];
        let ray = Ray::new(origin, direction, f32::INFINITY);
        surface.tracer.closest(&[ray], &mut hit);
        let [hit] = hit;
        let found = luminance(light.field.arriving(&hit, direction, 0.0));
        if !hit.is_hit() {
            let kind = "outside";
            return Find {
                receiver,
                kind,
                class: kind.into(),
                found,
                truth: found,
            };
        }
        let t = hit.triangle as usize;
        let place = surface.scene.mesh.position(t, hit.u, hit.v);
        let behind = light.field.outward_normal(t).dot(direction) > 0.0;
        let at = |plane: &Plane<bool>| surface.nearest(plane, hit.triangle, place);
        let foreign = {
            let owner = surface.nearest(self.owner, hit.triangle, place) as usize;
            let owned = owner < surface.texels.len() && {
                let o = surface.texels.point[owner].triangle as usize;
                let facing = light
                    .field
                    .outward_normal(o)
                    .dot(light.field.outward_normal(t));
                let away = surface
                    .texels
                    .position(&surface.scene.mesh, owner)
                    .distance(place);
                let side = surface.texels.texel_area(&surface.scene.mesh, t).sqrt();
                facing > 0.5 && away < 4.0 * side
            };
            !owned
        };
        let kind = match (light.field.is_emissive(t), behind) {
            (true, _) => "lamp",
            (_, true) if surface.back[t] != Vec3::ZERO => "far side, seen",
            (_, true) => "far side, unseen",
            _ if foreign => "another's texel",
            _ if at(clean) => "seen clean",
            _ if at(seen) => "seen at edges",
            _ => "unseen",
        };
        Find {
            receiver,
            kind,
            class: (self.name)(surface.nearest(self.labels, hit.triangle, place)),
            found,
            truth: luminance(self.true_radiance(origin, direction, receiver)),
        }
    }

    /// Radiance along a ray by the path tracer.
    fn true_radiance(&self, origin: Vec3, direction: Vec3, key: usize) -> Vec3 {
        let frame = Frame::from_normal(-direction);
        let [right, up] = [Vec3::X, Vec3::Y].map(|axis| frame.world_from_local(axis));
        let camera = Camera {
            projection: Projection::Pinhole(Lens::centred(1, 1, 0.01)),
            width: 1,
            height: 1,
            world_from_camera: Mat3::from_cols(right, up, -direction),
            position: origin,
        };
        let frame = self.paths.render(&camera, key as u64, &Progress::silent());
        frame.radiance().data[0]
    }
}

fn levels(
    receivers: &[String],
    baked: &[Vec3],
    real: &[Vec3],
    ended: Option<&[Vec3]>,
) -> Vec<ClassLevel> {
    let mut classes: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (k, name) in receivers.iter().enumerate() {
        if luminance(real[k]) > 0.0 {
            classes.entry(name).or_default().push(k);
            classes.entry("(all)").or_default().push(k);
        }
    }
    let ratios = |values: &[Vec3], of: &[usize]| -> Vec<f64> {
        let ratio = |&k: &usize| f64::from(luminance(values[k]) / luminance(real[k]));
        let mut all: Vec<f64> = of.iter().map(ratio).collect();
        all.sort_by(f64::total_cmp);
        all
    };
    let sum = |values: &[Vec3], of: &[usize]| -> f64 {
        of.iter().map(|&k| f64::from(luminance(values[k]))).sum()
    };
    let level = |(class, of): (&str, Vec<usize>)| {
        let all = ratios(baked, &of);
        ClassLevel {
            class: class.to_owned(),
            points: of.len(),
            mean: sum(baked, &of) / sum(real, &of),
            median: all[all.len() / 2],
            quartiles: [all[all.len() / 4], all[all.len() * 3 / 4]],
            result: ended.map(|e| ratios(e, &of)[of.len() / 2]),
        }
    };
    classes.into_iter().map(level).collect()
}

fn met(receivers: &[String], finds: &[Find], of: impl Fn(&Find) -> String) -> Vec<Met> {
    let mut groups: BTreeMap<(&str, String), (usize, f64, f64)> = BTreeMap::new();
    let mut whole: BTreeMap<&str, (usize, f64)> = BTreeMap::new();
    for f in finds {
        for receiver in [receivers[f.receiver].as_str(), "(all)"] {
            let g = groups.entry((receiver, of(f))).or_default();
            *g = (g.0 + 1, g.1 + f64::from(f.found), g.2 + f64::from(f.truth));
            let w = whole.entry(receiver).or_default();
            *w = (w.0 + 1, w.1 + f64::from(f.truth));
        }
    }
    groups
        .into_iter()
        .map(|((receiver, met), (n, found, truth))| {
            let (all, light) = whole[receiver];
            Met {
                receiver: receiver.to_owned(),
                met,
                share: n as f64 / all as f64,
                found: found / light,
                truth: truth / light,
            }
        })
        .filter(|m| m.share > 0.002 || m.found.max(m.truth) > 0.002)
        .collect()
}
