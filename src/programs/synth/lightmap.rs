//! Irradiance at texels of the apartment: the diffuse light that all of its photographs show.
//!
//! What a wall receives does not depend on who looks at it. It is sampled once per texel by the
//! path tracer, filtered over the surface ([`LightmapTexels`]), and shown by every view: less noise
//! from fewer paths than sampling and filtering each picture, and no view contradicts another.
//! (Filtered by themselves, pictures disagreed by 2 % about surfaces whose roughness changes them
//! by 0.5 %.) Texels are about as large as pixels seen from the middle of a room, so shadows stay
//! nearly as sharp as the camera can tell.

use super::atlas::Atlas;
use super::model::BURIED;
use crate::core::geometry::Mesh;
use crate::core::image::{RgbPlane, Wrap};
use crate::core::progress::Progress;
use crate::render::{IndirectCache, LightmapSampling, LightmapTexels, PathTracer, buried};
use glam::Vec3;
use std::f32::consts::TAU;

/// Paths per texel in each of the parts whose scatter tells their noise, at effort 1.
const SAMPLES: f32 = 3.0;
/// Squared differences in variances at which texels part: sooner than those of irradiance textures,
/// for light that seeps away where things touch is missing in every photograph alike.
const PARTING: f32 = 6.0;
/// Distance in metres at which texels are as large as pixels.
const DISTANCE: f32 = 2.5;
/// Texels that must lie between two charts, so that a bilinear look-up never meets another chart's
/// light.
const GAP: f32 = 3.0;
/// Largest side in texels: bounds memory and time where a texture holds many rooms.
const LARGEST: f32 = 4096.0;

/// Irradiance over the atlas of a mesh.
pub struct Lightmap<'a> {
    mesh: &'a Mesh,
    plane: RgbPlane,
}

impl IndirectCache for Lightmap<'_> {
    fn irradiance(&self, triangle: usize, u: f32, v: f32) -> Vec3 {
        self.plane.bilinear(
            self.mesh.uv(triangle, u, v) * self.plane.width as f32,
            Wrap::Clamp,
        )
    }
}

/// How finely a lightmap is baked.
#[derive(Clone, Copy, Debug)]
pub struct LightmapQuality {
    /// Texels along each side.
    pub side: usize,
    /// Factor on the paths per texel.
    pub effort: f32,
}

/// Side of the lightmap for panoramas of `width` pixels.
#[must_use]
pub fn side(atlas: &Atlas, width: usize) -> usize {
    let wanted = width as f32 / (TAU * DISTANCE * atlas.density);
    let apart = GAP / atlas.gap() as f32;
    let largest = (LARGEST / atlas.side as f32).max(apart);
    (atlas.side as f32 * wanted.clamp(apart, largest)).ceil() as usize
}

impl<'a> Lightmap<'a> {
    /// Bakes a map with the renderer itself; indirect light comes from `cache`.
    #[must_use]
    pub fn bake(
        renderer: &PathTracer<'a>,
        cache: &dyn IndirectCache,
        quality: LightmapQuality,
        progress: &Progress,
    ) -> Self {
        let (mesh, tracer) = (renderer.mesh(), renderer.tracer());
        let LightmapQuality { side, effort } = quality;
        let texels = LightmapTexels::new(mesh, side);
        // what lies under and inside of things must not darken the border of what can be seen
        let hidden = buried(texels.points(), BURIED, tracer);
        let sampling = LightmapSampling {
            paths_per_part: (SAMPLES * effort).round().max(2.0) as u32,
            parting: Some(PARTING),
        };
        let plane = texels
            .without(&hidden)
            .bake(renderer, Some(cache), sampling, progress);
        Self { mesh, plane }
    }
}

#[cfg(test)]
mod tests {
    use super::super::charts::{Builder, Finish};
    use super::super::{
        SurfaceIrradiance, SynthOptions, Textured, apartment::Apartment, sky, views,
    };
    use super::*;
    use crate::core::geometry::{Camera, Projection};
    use crate::core::image::Plane;
    use crate::core::math::luminance;
    use crate::core::trace::EmbreeTracer;
    use crate::render::{Environment, KnownLight, PathTracerOptions};
    use glam::Vec4;
    use std::f32::consts::PI;

    /// The share of a class's diffuse light that the map adds or loses against paths followed to
    /// their end, over a panorama.
    #[test]
    fn photographs_with_shared_light_are_as_bright_as_with_every_path_followed() {
        let options = SynthOptions {
            rooms: 1,
            texture: 512,
            ..SynthOptions::default()
        };
        let apartment = Apartment::new(&options);
        let atlas = Atlas::pack(&apartment.charts, options.texture).expect("fits");
        let mesh = atlas.mesh(&apartment.charts);
        let texture = atlas.paint(&apartment.charts, &apartment.paints);
        let tracer = EmbreeTracer::new(&mesh).expect("embree");
        let surfaces = Textured::new(&mesh, &apartment.charts, &texture);
        let sky = sky();
        let settings = PathTracerOptions {
            samples: 192,
            ..PathTracerOptions::default()
        };
        let renderer = PathTracer::new(&mesh, &tracer, &surfaces, &sky, settings);
        let silent = Progress::silent();
        let cache = SurfaceIrradiance::new(&mesh).bake(&mesh, &tracer, &renderer, 0.25, &silent);
        let map = Lightmap::bake(
            &renderer,
            &cache,
            LightmapQuality {
                side: side(&atlas, 256),
                effort: 0.5,
            },
            &silent,
        );
        let (mut shared, mut followed) = ([0.0f64; 64], [0.0f64; 64]);
        let mut pixels = [0usize; 64];
        for (key, view) in views::place(&apartment, &options)
            .expect("views")
            .into_iter()
            .take(4)
            .enumerate()
        {
            let camera = Camera {
                projection: Projection::Equirectangular,
                width: 64,
                height: 32,
                ..view.camera
            };
            let known = KnownLight {
                first: Some(&map),
                later: Some(&map),
            };
            let with = renderer.render_with(&camera, key as u64, known, &silent);
            let without = renderer.render(&camera, 100 + key as u64, &silent);
            for i in 0..with.label.data.len() {
                let class = usize::from(with.label.data[i]);
                shared[class] += f64::from(luminance(with.diffuse.data[i]));
                followed[class] += f64::from(luminance(without.diffuse.data[i]));
                pixels[class] += 1;
            }
        }
        let mut compared = 0;
        for class in (1..64).filter(|&c| pixels[c] > 100) {
            let ratio = shared[class] / followed[class];
            eprintln!("class {class}: {ratio:.4} over {} pixels", pixels[class]);
            assert!(
                (ratio - 1.0).abs() < 0.03,
                "class {class}: {ratio} over {} pixels",
                pixels[class]
            );
            compared += 1;
        }
        assert!(compared >= 6, "{compared} classes");
    }

    /// Under an even sky every side of a box receives π times its radiance, up to the very border
    /// of its chart.
    #[test]
    fn even_light_is_baked_evenly_up_to_the_edges() {
        struct Even;
        impl Environment for Even {
            fn radiance(&self, _: Vec3) -> Vec3 {
                Vec3::new(1.0, 2.0, 3.0)
            }
        }
        let mut b = Builder::new();
        b.cuboid(
            Vec3::ZERO,
            Vec3::new(0.5, 0.8, 0.3),
            true,
            Finish {
                material: 0,
                class: 1,
                emission: Vec3::ZERO,
                metallic: 0.0,
                transmission: 0.0,
            },
        );
        let atlas = Atlas::pack(&b.charts, 128).expect("fits");
        let mesh = atlas.mesh(&b.charts);
        let texture = Plane::filled(128, 128, Vec4::splat(0.5));
        let tracer = EmbreeTracer::new(&mesh).expect("embree");
        let surfaces = Textured::new(&mesh, &b.charts, &texture);
        let renderer = PathTracer::new(
            &mesh,
            &tracer,
            &surfaces,
            &Even,
            PathTracerOptions::default(),
        );
        let silent = Progress::silent();
        let cache = SurfaceIrradiance::new(&mesh);
        for side in [128, 64] {
            let quality = LightmapQuality { side, effort: 1.0 };
            let map = Lightmap::bake(&renderer, &cache, quality, &silent);
            let (mut sum, mut count) = (Vec3::ZERO, 0.0);
            for triangle in 0..mesh.triangles.len() {
                for [u, v] in [
                    [0.3, 0.3],
                    [0.0, 0.0],
                    [1.0, 0.0],
                    [0.0, 1.0],
                    [0.5, 0.5],
                    [0.0, 0.2],
                ] {
                    let got = map.irradiance(triangle, u, v) / (PI * Vec3::new(1.0, 2.0, 3.0));
                    // half the directions are drawn through the openings, whose noise is 1 %; a dark
                    // border would lack half its light
                    assert!(
                        (got - 1.0).abs().max_element() < 0.05,
                        "{side}: {got} at {u} {v} of {triangle}"
                    );
                    (sum, count) = (sum + got, count + 1.0);
                }
            }
            let mean = sum / count;
            assert!((mean - 1.0).abs().max_element() < 2e-3, "{side}: {mean}");
        }
    }
}
