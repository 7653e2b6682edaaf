//! The method of TexIR as published, for comparison: texture-based light of one view a texel, a
//! uniform bake of irradiance, and three stages of gradient descent on textures (supplement, Secs.
//! A to C; method §7). unbake's own method is elsewhere; nothing of it is used here but geometry
//! and rays.
//!
//! Not reproduced, since they are faults of a rasteriser and not of the method: positions read off
//! a panorama (W4), faces sampled at their edges (W9), the depth buffer's precision (W10).

//!
//! Beside it the systems that the paper compares with, under the same light: each is a
//! `strategy::Strategy` of its own (`invrender`, `nvdiffrec`, `neilf`), and NeILF's own light a
//! `strategy::Lighting` (`incident_light`); texture-space differentiable path tracing (`tsdr`)
//! needs no light texture but that of lamps.

mod descent;
mod hybrid;
mod incident_light;
mod invrender;
mod learned_texture;
mod lobe;
mod neilf;
mod nvdiffrec;
mod options;
mod paths;
mod pixels;
mod place;
mod reflection;
mod stages;
mod strategy;
mod tbl;
mod tsdr;

pub use options::{
    Correction, PublishedOptions, PublishedStage, PublishedStrategy, PublishedValues,
};
pub use stages::Sides;
pub use tbl::one_view_per_texel;

use crate::core::brdf::Material;
use crate::core::image::{Plane, RgbPlane};
use crate::core::progress::Progress;
use crate::core::sampling::hash_u64;
use crate::core::texture::{Texels, fill_uncovered};
use crate::lights::Emitters;
use crate::observed::Surface;
use crate::radiance::{Environment, LightField, SurfaceRadiance};
use descent::descend;
use glam::{Vec2, Vec3};
use hybrid::Hybrid;
use incident_light::IncidentLight;
use invrender::InvRender;
use learned_texture::MipTexture;
use neilf::Neilf;
use nvdiffrec::NvDiffRec;
use paths::PathScene;
use pixels::{Pixel, PixelGrid, training_pixels};
use place::Place;
use reflection::{Reflector, virtual_highlights};
use stages::{Training, optimise};
use std::collections::BTreeMap;
use strategy::{Compared, Lighting, Loss, Moment, Strategy, Visit};
use tsdr::Tsdr;

/// Median luminance to which the published scenes are exposed: ln(1 + x) of the losses depends on
/// it (derived: method §7.1 multiplies by 2⁵, which brings its rooms near this).
const MEDIAN: f32 = 0.5;

/// Every so many texels tell the light sampler what they see of lamps: a few thousand of a draft's
/// do (derived: it learns by cells of a metre).
const PROBE_STEP: usize = 16;

/// What the published method starts from.
pub struct PublishedInput<'a> {
    /// Geometry and photographs.
    pub surface: &'a Surface<'a>,
    /// The light texture.
    pub tbl: &'a RgbPlane,
    /// The light texture as rays meet it.
    pub field: &'a LightField,
    /// The irradiance texture.
    pub irradiance: &'a RgbPlane,
    /// Rooms on the atlas.
    pub rooms: &'a Plane<u16>,
    /// Key of all randomness.
    pub seed: u64,
}

/// What was learned, on the atlas.
pub struct LearnedMaterials {
    /// Albedo, linear RGB.
    pub albedo: RgbPlane,
    /// Roughness R.
    pub roughness: Plane<f32>,
    /// Emitted radiance, where it is learned.
    pub emission: Option<RgbPlane>,
    /// Rays traced.
    pub rays: u64,
}

/// What the paper makes of surfaces on synthetic scenes before it scores (cited: method §7.1).
const CEILING: Material = Material {
    albedo: Vec3::splat(0.9),
    roughness: 0.8,
};
const LAMP: Material = Material {
    albedo: Vec3::splat(0.8),
    roughness: 1.0,
};

/// Learns materials from what the views show.
#[must_use]
pub fn learn(
    input: &PublishedInput,
    options: &PublishedOptions,
    sides: Sides,
    progress: &Progress,
) -> LearnedMaterials {
    let mut learned = learn_unprocessed(input, options, sides, progress);
    if options.post_process {
        let surface = input.surface;
        let lamps = surface.scene.classes.iter().filter(|c| c.is_light);
        let mut set = BTreeMap::new();
        set.extend(lamps.map(|c| (c.id, LAMP)));
        set.extend(
            classes_named(surface, "ceiling")
                .iter()
                .map(|c| (*c, CEILING)),
        );
        let labels = surface.texels.scatter(&surface.labels, 0);
        let set_at = |i: usize, side: usize| {
            let texel = Vec2::new((i % side) as f32 + 0.5, (i / side) as f32 + 0.5);
            let label = labels.nearest(texel * (labels.width as f32 / side as f32));
            set.get(label).copied()
        };
        set_materials(&mut learned, set_at);
    }
    learned
}

/// Sets texels to materials, where `at(texel, side of the texture)` has one.
fn set_materials(learned: &mut LearnedMaterials, at: impl Fn(usize, usize) -> Option<Material>) {
    let side = learned.albedo.width;
    for (i, albedo) in learned.albedo.data.iter_mut().enumerate() {
        *albedo = at(i, side).map_or(*albedo, |m| m.albedo);
    }
    let side = learned.roughness.width;
    for (i, roughness) in learned.roughness.data.iter_mut().enumerate() {
        *roughness = at(i, side).map_or(*roughness, |m| m.roughness);
    }
}

fn learn_unprocessed(
    input: &PublishedInput,
    options: &PublishedOptions,
    sides: Sides,
    progress: &Progress,
) -> LearnedMaterials {
    let surface = input.surface;
    let median = tbl::median_luminance(surface);
    // a power of two, as the published exposures are
    let exposure = (MEDIAN / median).log2().round().exp2();
    if options.strategy == PublishedStrategy::Tsdr {
        return learn_by_paths(input, options, [median, exposure], sides, progress);
    }
    let mut views = progress.stage("training pixels", 1, |_| {
        training_pixels(surface, input.rooms, options.face_pixels)
    });
    let texir = options.strategy == PublishedStrategy::Texir;
    let highlights = texir.then(|| all_highlights(input, &views, median, progress));
    for pixel in views.iter_mut().flat_map(|v| &mut v.pixels) {
        pixel.radiance *= exposure;
    }
    let texels = &input.irradiance.data;
    let irradiance = MipTexture::new(
        input.irradiance.width,
        texels.iter().map(|e| (*e * exposure).to_array()).collect(),
    );
    let hybrid = Hybrid {
        irradiance: &irradiance,
        reflector: Reflector {
            tracer: &surface.tracer,
            field: input.field,
            corrected: options.corrects(Correction::W1),
        },
        exposure,
        independent: options.corrects(Correction::W2),
        light_samples: options.light_samples,
        loss: Loss::Absolute,
    };
    let Some(highlights) = highlights else {
        views.iter_mut().for_each(PixelGrid::find_contrasts);
        return learn_compared(input, options, &views, hybrid, sides, progress);
    };
    let training = Training {
        views: &views,
        highlights: &highlights,
        hybrid,
        ceilings: &classes_named(surface, "ceiling"),
        options,
        seed: input.seed,
    };
    let learned = optimise(&training, sides, progress);
    LearnedMaterials {
        albedo: learned.albedo.plane(|a| Vec3::from(*a)),
        roughness: learned.roughness.plane(|r| r[0]),
        emission: None,
        rays: learned.rays,
    }
}

/// Trains a compared system and reads its materials off at the texels of the albedo's size.
fn learn_compared(
    input: &PublishedInput,
    options: &PublishedOptions,
    views: &[PixelGrid],
    hybrid: Hybrid<'_>,
    sides: Sides,
    progress: &Progress,
) -> LearnedMaterials {
    let (lo, hi) = input.surface.scene.mesh.bounds();
    let (place, handicapped) = (Place::of_box(lo, hi), options.handicapped);
    let seed = hash_u64(input.seed, 0x9ee5);
    let mut hybrid = Hybrid {
        // the comparison's NVDIFFREC squares (method §7.2)
        loss: if handicapped && options.strategy == PublishedStrategy::Nvdiffrec {
            Loss::Squared
        } else {
            Loss::Absolute
        },
        ..hybrid
    };
    let mut own;
    let light: &mut dyn Lighting = if options.strategy == PublishedStrategy::NeilfStar {
        own = IncidentLight::new(place, Loss::Absolute, handicapped, hash_u64(seed, 1));
        &mut own
    } else {
        &mut hybrid
    };
    let mut strategy: Box<dyn Strategy> = match options.strategy {
        PublishedStrategy::Invrender => Box::new(InvRender::new(place, handicapped, seed)),
        PublishedStrategy::Nvdiffrec => Box::new(NvDiffRec::new(place, handicapped, seed)),
        _ => Box::new(Neilf::new(place, handicapped, seed)),
    };
    let mut compared = Compared {
        views,
        strategy: strategy.as_mut(),
        light,
        visit: visit(options),
        now: Moment {
            epochs: options.epochs,
            ..Moment::default()
        },
        rays: 0,
    };
    let steps = u64::from(options.epochs) * views.len() as u64;
    let key = |epoch| hash_u64(seed, hash_u64(2, u64::from(epoch)));
    progress.stage("materials", steps, |p| {
        descend(&mut compared, options.epochs, views.len(), key, p);
    });
    let rays = compared.rays;
    progress.stage("materials at texels", 1, |_| {
        read_off(strategy.as_mut(), input.surface, sides.albedo, rays)
    })
}

/// Differentiable path tracing from the lamps of the light texture.
fn learn_by_paths(
    input: &PublishedInput,
    options: &PublishedOptions,
    [median, exposure]: [f32; 2],
    sides: Sides,
    progress: &Progress,
) -> LearnedMaterials {
    let (surface, mesh) = (input.surface, &input.surface.scene.mesh);
    let lit = tbl::lights_only(input.tbl, median);
    let mut shining = vec![false; mesh.triangles.len()];
    let texels = &surface.texels;
    for i in (0..texels.len()).filter(|&i| texels.interior[i]) {
        let light = lit.data[texels.cell[i] as usize];
        shining[texels.point[i].triangle as usize] |= light != Vec3::ZERO;
    }
    let emissive: Vec<bool> = texels
        .point
        .iter()
        .map(|p| shining[p.triangle as usize])
        .collect();
    let lamps = LightField::new(
        mesh,
        &surface.orientation,
        SurfaceRadiance {
            radiance: lit.map(|l| *l * exposure),
            emissive: texels.scatter(&emissive, false),
            emissive_triangles: &shining,
            back: Vec::new(),
        },
        Environment::black(),
    );
    let probes: Vec<(Vec3, Vec3)> = (0..texels.len())
        .step_by(PROBE_STEP)
        .map(|i| {
            let point = texels.point[i];
            let (_, face) = surface.normals(point.triangle as usize, point.u, point.v);
            (texels.position(mesh, i), face)
        })
        .collect();
    let scene = PathScene {
        mesh,
        orientation: &surface.orientation,
        tracer: &surface.tracer,
        lamps: &lamps,
        emitters: &Emitters::new(mesh, &lamps, &surface.tracer, &probes),
        sky: &Environment::from_map(input.field.environment.map().map(|l| *l * exposure)),
        offset: surface.offset,
    };
    let mut tsdr = Tsdr::new(surface, scene, exposure, options.visit_pixels, sides);
    let (epochs, views) = (options.epochs, surface.views.len());
    let key = |epoch| hash_u64(input.seed, hash_u64(0x75d, u64::from(epoch)));
    let steps = u64::from(epochs) * views as u64;
    progress.stage("differentiable paths", steps, |p| {
        descend(&mut tsdr, epochs, views, key, p);
    });
    let gain = tsdr.textures.gain.plane(|g| Vec3::from(*g));
    let own = Texels::rasterize(mesh, gain.width, gain.height);
    let emitted: Vec<Vec3> = (0..own.len())
        .map(|i| {
            let (p, t) = (own.point[i], own.point[i].triangle as usize);
            if shining[t] {
                gain.data[own.cell[i] as usize] * lamps.emitted(t, p.u, p.v) / exposure
            } else {
                Vec3::ZERO
            }
        })
        .collect();
    LearnedMaterials {
        albedo: tsdr.textures.albedo.plane(|a| Vec3::from(*a)),
        roughness: tsdr.textures.roughness.plane(|r| r[0]),
        emission: Some(own.scatter(&emitted, Vec3::ZERO)),
        rays: tsdr.rays(),
    }
}

/// What a visit looks at: batches of some pixels, or, in the paper's comparison, a whole view.
fn visit(options: &PublishedOptions) -> Visit {
    /// Pixels of a step: InvRender's own; fewer than NeILF's 8,192, for more steps in as much time
    /// (derived: a step costs in proportion).
    const BATCH: usize = 1024;
    Visit {
        pixels: options.visit_pixels,
        batch: if options.handicapped {
            options.visit_pixels
        } else {
            BATCH
        },
    }
}

/// Materials of the texels of an atlas of `side`².
fn read_off(
    strategy: &mut dyn Strategy,
    surface: &Surface,
    side: usize,
    rays: u64,
) -> LearnedMaterials {
    let texels = Texels::rasterize(&surface.scene.mesh, side, side);
    let points: Vec<Pixel> = (0..texels.len())
        .map(|i| texel_pixel(surface, &texels, i))
        .collect();
    let materials = strategy.materials(&points);
    let covered = texels.scatter(&vec![true; texels.len()], false);
    let albedo: Vec<Vec3> = materials.iter().map(|m: &Material| m.albedo).collect();
    let roughness: Vec<f32> = materials.iter().map(|m| m.roughness).collect();
    LearnedMaterials {
        albedo: fill_uncovered(&texels.scatter(&albedo, Vec3::ZERO), &covered),
        roughness: fill_uncovered(&texels.scatter(&roughness, 0.0), &covered),
        emission: None,
        rays,
    }
}

/// A texel's place on the surface, as a pixel that shows nothing.
fn texel_pixel(surface: &Surface, texels: &Texels, i: usize) -> Pixel {
    let (mesh, point) = (&surface.scene.mesh, texels.point[i]);
    let (normal, _) = surface.normals(point.triangle as usize, point.u, point.v);
    Pixel {
        position: texels.position(mesh, i),
        normal,
        to_camera: normal,
        uv: mesh.uv(point.triangle as usize, point.u, point.v),
        footprint: 0.0,
        radiance: Vec3::ZERO,
        contrast: 0.0,
        class: 0,
        room: 0,
        cell: 0,
    }
}

/// Which pixels of every view are virtual highlights.
fn all_highlights(
    input: &PublishedInput,
    views: &[PixelGrid],
    median: f32,
    progress: &Progress,
) -> Vec<Vec<bool>> {
    let surface = input.surface;
    let lights = LightField::new(
        &surface.scene.mesh,
        &surface.orientation,
        SurfaceRadiance::reflected(tbl::lights_only(input.tbl, median)),
        Environment::from_map(tbl::lights_only(input.field.environment.map(), median)),
    );
    let mirror = Reflector {
        tracer: &surface.tracer,
        field: &lights,
        corrected: false,
    };
    let eroded = classes_named(surface, "floor");
    let highlights: Vec<Vec<bool>> =
        progress.stage("virtual highlights", views.len() as u64, |p| {
            let of = |grid: &PixelGrid| {
                let found = virtual_highlights(mirror, grid, &eroded);
                p.advance(1);
                found
            };
            views.iter().map(of).collect()
        });
    let lit: usize = highlights.iter().flatten().filter(|l| **l).count();
    let all: usize = views.iter().map(|v| v.pixels.len()).sum();
    progress.note(format!(
        "{:.2} % of the training pixels are virtual highlights",
        100.0 * lit as f64 / all.max(1) as f64
    ));
    highlights
}

/// Classes whose name contains a word.
fn classes_named(surface: &Surface, word: &str) -> Vec<u16> {
    let classes = surface.scene.classes.iter();
    classes
        .filter(|c| c.name.to_lowercase().contains(word))
        .map(|c| c.id)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn materials_are_set_where_there_are_some_on_textures_of_any_size() {
        let mut learned = LearnedMaterials {
            albedo: Plane::filled(2, 2, Vec3::splat(0.1)),
            roughness: Plane::filled(4, 4, 0.1),
            emission: None,
            rays: 0,
        };
        // the lower half is ceiling
        set_materials(&mut learned, |i, side| {
            (i / side >= side / 2).then_some(CEILING)
        });
        let albedo: Vec<f32> = learned.albedo.data.iter().map(|a| a.x).collect();
        assert_eq!(albedo, [0.1, 0.1, 0.9, 0.9]);
        assert_eq!(learned.roughness.data[7..9], [0.1, 0.8]);
    }
}
