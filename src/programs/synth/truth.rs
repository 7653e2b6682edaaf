//! The truth of an apartment in the form of a solution: what a perfect reconstruction would be, for
//! comparison under changed light. No solver reads it.

use super::{Built, SynthOptions, sky};
use crate::core::image::{Plane, RgbPlane};
use crate::core::progress::Progress;
use crate::core::texture::{Texels, fill_uncovered};
use crate::error::Result;
use crate::render::Environment;
use crate::solution::{Solution, find_lamps};
use glam::{DVec3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Width of the sky as a panorama.
const SKY: usize = 1024;

/// The apartment of `options` with its true materials, lamps and sky; irradiance and radiance are
/// left black (the path tracer needs neither).
///
/// # Errors
/// Options out of range.
pub fn true_solution(options: &SynthOptions) -> Result<Solution> {
    options.validate()?;
    Ok(Built::new(options, &Progress::silent())?.solution())
}

impl Built {
    /// The truth as a solution, black in irradiance and radiance.
    pub(super) fn solution(&self) -> Solution {
        let side = self.texture.width;
        let finishes: Vec<_> = self
            .apartment
            .charts
            .iter()
            .flat_map(|c| std::iter::repeat_n(c.finish, c.triangles.len()))
            .collect();
        let texels = Texels::rasterize(&self.mesh, side, side);
        let covered = texels.scatter(&vec![true; texels.len()], false);
        let emitted: Vec<Vec3> = texels
            .point
            .iter()
            .map(|p| finishes[p.triangle as usize].emission)
            .collect();
        let labels: Vec<u16> = texels
            .point
            .iter()
            .map(|p| finishes[p.triangle as usize].class)
            .collect();
        let texture = &self.texture;
        let black = || Plane::filled(4, 4, Vec3::ZERO);
        let emission = texels.scatter(&emitted, Vec3::ZERO);
        Solution {
            lamps: find_lamps(&self.mesh, &emission, DVec3::ZERO),
            portals: Vec::new(),
            mesh: self.mesh.clone(),
            origin: DVec3::ZERO,
            albedo: fill_uncovered(&texture.map(|t| t.truncate()), &covered),
            roughness: fill_uncovered(&texture.map(|t| t.w), &covered),
            irradiance: black(),
            radiance: black(),
            emission,
            confidence: Plane::filled(4, 4, Vec2::ZERO),
            metallic: self.metallic.as_ref().map(|m| fill_uncovered(m, &covered)),
            transmission: self
                .transmission
                .as_ref()
                .map(|t| fill_uncovered(t, &covered)),
            irradiance_error: None,
            camera_masks: Vec::new(),
            labels: texels.scatter(&labels, 0),
            rooms: Plane::filled(4, 4, 0),
            reflectance: crate::core::brdf::Reflectance::Paper,
            environment: panorama(&sky()),
        }
    }
}

fn panorama(sky: &dyn Environment) -> RgbPlane {
    let (w, h) = (SKY, SKY / 2);
    let at = |i: usize| {
        let lambda = TAU * ((i % w) as f32 + 0.5) / w as f32 - PI;
        let theta = PI * ((i / w) as f32 + 0.5) / h as f32;
        sky.radiance(Vec3::new(
            lambda.sin() * theta.sin(),
            theta.cos(),
            -lambda.cos() * theta.sin(),
        ))
    };
    Plane {
        width: w,
        height: h,
        data: (0..w * h).map(at).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::catalogue;
    use super::*;
    use crate::core::geometry::{Camera, Projection};
    use crate::core::trace::EmbreeTracer;
    use crate::render::{Adaptive, Noise};
    use crate::render::{
        EditableScene, NamedCamera, PathTracedScene, PathTracer, PathTracerOptions, TraceSettings,
    };

    /// The same pictures come from the apartment's own model and from its truth as a solution:
    /// textures, lamps and sky survive.
    #[test]
    fn the_truth_renders_like_the_apartment() {
        compare(SynthOptions {
            rooms: 1,
            texture: 512,
            ..SynthOptions::default()
        });
    }

    #[test]
    fn the_truth_of_metal_renders_like_the_apartment() {
        let options = SynthOptions {
            rooms: 3,
            texture: 1024,
            fittings: true,
            ..SynthOptions::default()
        };
        let truth = true_solution(&options).expect("valid");
        let metallic = truth.metallic.as_ref().expect("metal");
        assert_eq!(metallic.width, truth.albedo.width);
        let texels = Texels::rasterize(&truth.mesh, metallic.width, metallic.height);
        for &cell in &texels.cell {
            let (class, m) = (
                truth.labels.data[cell as usize],
                metallic.data[cell as usize],
            );
            assert_eq!(m, catalogue::metallic(class), "class {class}");
        }
        compare(options);
    }

    #[test]
    fn the_truth_of_panes_renders_like_the_apartment() {
        let options = SynthOptions {
            rooms: 2,
            texture: 1024,
            panes: true,
            ..SynthOptions::default()
        };
        let truth = true_solution(&options).expect("valid");
        let transmission = truth.transmission.as_ref().expect("panes");
        let texels = Texels::rasterize(&truth.mesh, transmission.width, transmission.height);
        let mut panes = std::collections::BTreeSet::new();
        for &cell in &texels.cell {
            let class = truth.labels.data[cell as usize];
            let t = transmission.data[cell as usize];
            assert_eq!(t, catalogue::transmission(class), "class {class}");
            if t > 0.0 {
                panes.insert(class);
            }
        }
        assert!(panes.iter().eq(&catalogue::PANES));
        compare(options);
    }

    fn compare(options: SynthOptions) {
        let truth = true_solution(&options).expect("valid");
        let built = Built::new(&options, &Progress::silent()).expect("fits");
        let (apartment, mesh) = (&built.apartment, &built.mesh);
        let tracer = EmbreeTracer::new(mesh).expect("embree");
        let surfaces = super::super::Textured::new(mesh, &apartment.charts, &built.texture);
        let sky = sky();
        let settings = PathTracerOptions {
            samples: 64,
            ..PathTracerOptions::default()
        };
        let view = super::super::views::place(apartment, &options)
            .expect("views")
            .remove(0);
        let camera = Camera {
            projection: Projection::Equirectangular,
            width: 32,
            height: 16,
            ..view.camera
        };
        let own = PathTracer::new(mesh, &tracer, &surfaces, &sky, settings)
            .render(&camera, 0, &Progress::silent())
            .radiance();
        let world = EditableScene::new(&truth);
        assert!(!truth.lamps.is_empty());
        let stage = PathTracedScene::new(&world).expect("embree");
        let goal = Adaptive {
            first: 64,
            most: 64,
            error: 0.0,
            noise: Noise::Reflected,
        };
        let mut image = None;
        let view = NamedCamera {
            name: "x".into(),
            camera,
        };
        stage
            .render(
                &[view],
                &TraceSettings {
                    tracer: settings,
                    goal,
                    denoise: false,
                },
                &Progress::silent(),
                |_, _| Ok(()),
                |_, i| {
                    image = Some(i.clone());
                    Ok(())
                },
            )
            .expect("renders");
        let image = image.expect("one frame");
        // lamps themselves are thousands of times brighter: what counts is the light they send
        let mean = |p: &RgbPlane| {
            p.data
                .iter()
                .map(|c| f64::from(c.min(Vec3::ONE).element_sum()))
                .sum::<f64>()
        };
        let (a, b) = (mean(&own), mean(&image));
        assert!((a / b - 1.0).abs() < 0.03, "{a} against {b}");
    }
}
