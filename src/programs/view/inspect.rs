//! What is known about one point of a surface: its values at full precision, their standard errors,
//! and the photographs that see it.

use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::math::srgb_from_linear;
use crate::core::trace::{Ray, Tracer};
use crate::scene::Scene;
use crate::solution::Solution;
use glam::{Vec2, Vec3};
use serde_json::{Value, json};
use std::f32::consts::FRAC_1_PI;

/// Observations listed, the nearest first.
const OBSERVATIONS: usize = 8;
/// A standard error from which on a texel counts as unobserved.
pub const UNOBSERVED: f32 = 100.0;

/// A linear colour as `#rrggbb` in sRGB.
#[must_use]
pub fn hex(colour: Vec3) -> String {
    let [r, g, b] = colour
        .to_array()
        .map(|x| (srgb_from_linear(x.clamp(0.0, 1.0)) * 255.0 + 0.5) as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn at<T>(plane: &Plane<T>, uv: Vec2) -> Vec2 {
    uv * Vec2::new(plane.width as f32, plane.height as f32)
}

/// The values of all textures at an atlas coordinate.
#[must_use]
pub fn values(solution: &Solution, uv: Vec2) -> Value {
    let uv = uv.clamp(Vec2::ZERO, Vec2::ONE);
    let rgb = |p: &RgbPlane| p.bilinear(at(p, uv), Wrap::Clamp).to_array();
    let s = solution;
    let albedo = s.albedo.bilinear(at(&s.albedo, uv), Wrap::Clamp);
    let metallic = s.metal_at(uv);
    let transmission = s.transmission_at(uv);
    let diffuse = albedo * ((1.0 - metallic) * (1.0 - transmission));
    let error = *s.confidence.nearest(at(&s.confidence, uv));
    let stated = |e: f32| {
        if e < UNOBSERVED {
            json!(e)
        } else {
            Value::Null
        }
    };
    json!({
        "label": *s.labels.nearest(at(&s.labels, uv)),
        "room": *s.rooms.nearest(at(&s.rooms, uv)),
        "albedo": albedo.to_array(),
        "albedo_srgb": hex(albedo),
        "albedo_error": stated(error.x),
        "roughness": *s.roughness.nearest(at(&s.roughness, uv)),
        "roughness_error": stated(error.y),
        "irradiance": rgb(&s.irradiance),
        "radiance": rgb(&s.radiance),
        "emission": s.emission.nearest(at(&s.emission, uv)).to_array(),
        "metallic": metallic,
        "transmission": transmission,
        "diffuse": (diffuse * s.irradiance.bilinear(at(&s.irradiance, uv), Wrap::Clamp) * FRAC_1_PI).to_array(),
    })
}

/// The training and held-out views that see `point`, with what their photographs show there.
///
/// `photograph` gives the pixels of a view, or nothing where they cannot be read.
#[must_use]
pub fn observations(
    scene: &Scene,
    tracer: &dyn Tracer,
    point: Vec3,
    photograph: &dyn Fn(usize) -> Option<std::sync::Arc<RgbPlane>>,
) -> Value {
    let mut candidates = Vec::new();
    let mut rays = Vec::new();
    for (i, view) in scene.views.iter().enumerate() {
        let to = point - view.camera.position;
        let distance = to.length();
        if let Some(pixel) = view.camera.project(point).filter(|_| distance > 1e-6) {
            candidates.push((i, distance, pixel));
            // the surface itself must not count: stop a little before it
            rays.push(Ray::new(
                view.camera.position,
                to / distance,
                distance * 0.998 - 1e-4,
            ));
        }
    }
    let mut hidden = vec![0u8; rays.len()];
    tracer.occluded(&rays, &mut hidden);
    let mut seen: Vec<_> = candidates
        .into_iter()
        .zip(hidden)
        .filter(|(_, h)| *h == 0)
        .map(|(c, _)| c)
        .collect();
    seen.sort_by(|a, b| a.1.total_cmp(&b.1));
    let list: Vec<Value> = seen
        .iter()
        .take(OBSERVATIONS)
        .map(|&(i, distance, pixel)| {
            let view = &scene.views[i];
            let radiance = photograph(i).map(|p| p.nearest(pixel).to_array());
            json!({
                "camera": i,
                "stem": view.stem,
                "held_out": view.split == crate::scene::Split::Test,
                "distance": distance,
                "pixel": [pixel.x, pixel.y],
                "radiance": radiance,
            })
        })
        .collect();
    json!({"views": scene.views.len(), "seeing": seen.len(), "nearest": list})
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::{Camera, Projection};
    use crate::core::trace::BruteForce;
    use crate::scene::{Split, View};
    use crate::solution::tests::small_solution;
    use glam::Mat3;
    use std::sync::Arc;

    #[test]
    fn values_are_those_of_the_textures() {
        let solution = small_solution();
        let v = values(&solution, Vec2::new(4.5 / 16.0, 2.5 / 16.0));
        let expected = solution.albedo[(4, 2)];
        assert!((v["albedo"][0].as_f64().expect("number") - f64::from(expected.x)).abs() < 1e-6);
        assert_eq!(v["label"], solution.labels[(4, 2)]);
        assert_eq!(v["roughness_error"], Value::Null, "1e4 means unobserved");
        assert_eq!(v["albedo_srgb"], hex(expected));
        assert!(
            values(&solution, Vec2::new(-3.0, 7.0))["room"].is_u64(),
            "outside the atlas is clamped"
        );
        assert_eq!(hex(Vec3::new(1.0, 0.0, 0.5)), "#ff00bc");
    }

    #[test]
    fn only_views_with_a_free_line_of_sight_count() {
        let solution = small_solution();
        let view = |stem: &str, position: Vec3| View {
            stem: stem.into(),
            camera: Camera {
                projection: Projection::Equirectangular,
                width: 8,
                height: 4,
                world_from_camera: Mat3::IDENTITY,
                position,
            },
            image_path: "none.exr".into(),
            label_path: None,
            mask_path: None,
            exposure_ev: 0.0,
            split: Split::Train,
            colour_space: None,
            account: Default::default(),
        };
        // the mesh is a square at height 0.1: from below it is hidden by nothing, from above
        // neither; a point above is hidden from below
        let views = vec![
            view("above", Vec3::new(0.0, 2.0, 0.5)),
            view("below", Vec3::new(0.0, -1.0, 0.5)),
        ];
        let scene = Scene::from_parts(
            "x".into(),
            solution.origin,
            solution.mesh.clone(),
            Vec::new(),
            views,
        );
        let tracer = BruteForce::new(&solution.mesh);
        let photograph =
            |i: usize| (i == 0).then(|| Arc::new(Plane::filled(8, 4, Vec3::splat(3.0))));
        let on_surface = observations(&scene, &tracer, Vec3::new(0.2, 0.1, 0.4), &photograph);
        assert_eq!(on_surface["seeing"], 2);
        assert_eq!(on_surface["nearest"][1]["radiance"][0], 3.0);
        assert_eq!(on_surface["nearest"][0]["radiance"], Value::Null);
        let above = observations(&scene, &tracer, Vec3::new(0.2, 0.5, 0.4), &photograph);
        assert_eq!(
            (
                above["seeing"].as_u64(),
                above["nearest"][0]["stem"].as_str()
            ),
            (Some(1), Some("above"))
        );
    }
}
