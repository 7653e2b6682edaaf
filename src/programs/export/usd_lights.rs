//! The light of `scene.usda`: lamps as `RectLight`, `DiskLight` and `SphereLight` of UsdLux, the
//! environment as a `DomeLight`.
//!
//! Without `inputs:normalize`, a light of UsdLux emits the radiance `intensity · 2^exposure · color`
//! (UsdLux, LightAPI); a flat one lies in its x-y plane and shines along −z. The dome's panorama is
//! that of OpenEXR, whose middle is +z; the middle of ours is −z: the dome is turned by half.

use super::area_light::{AreaLight, LightShape};
use crate::solution::PunctualLight;
use glam::{DVec3, Quat, Vec3};
use std::f64::consts::PI;
use std::fmt::Write;

/// Appends a lamp.
pub(super) fn lamp_prim(s: &mut String, light: &AreaLight) {
    let kind = match light.shape {
        LightShape::Rectangle(_) => "RectLight",
        LightShape::Disk(_) => "DiskLight",
        LightShape::Sphere(_) => "SphereLight",
    };
    let _ = writeln!(
        s,
        "    def {kind} \"{}\"\n    {{",
        light.name.replace(' ', "_")
    );
    let _ = match light.shape {
        LightShape::Rectangle([width, height]) => writeln!(
            s,
            "        float inputs:width = {width}\n        float inputs:height = {height}"
        ),
        LightShape::Disk(radius) | LightShape::Sphere(radius) => {
            writeln!(s, "        float inputs:radius = {radius}")
        }
    };
    let brightest = light.radiance.max_element();
    let colour = light.radiance / brightest.max(f32::MIN_POSITIVE);
    let _ = writeln!(
        s,
        "        float inputs:intensity = {brightest}\n        color3f inputs:color = ({}, {}, {})\n        bool inputs:normalize = 0",
        colour.x, colour.y, colour.z
    );
    // rows are the images of the axes: USD multiplies row vectors
    let (m, p) = (light.axes, light.position);
    let row = |v: glam::Vec3| format!("({}, {}, {}, 0)", v.x, v.y, v.z);
    let _ = writeln!(
        s,
        "        matrix4d xformOp:transform = ( {}, {}, {}, ({}, {}, {}, 1) )\n        uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }}\n",
        row(m.x_axis),
        row(m.y_axis),
        row(m.z_axis),
        p.x,
        p.y,
        p.z
    );
}

/// Radius of a light without extent, metres: renderers that know surfaces alone show it as this.
const POINT: f64 = 0.01;

/// Appends a light without extent as the prim `name`; `origin` is what its file's places are relative to.
/// A small sphere of radiance L sends out the intensity π r² · L.
pub(super) fn point_prim(s: &mut String, name: &str, light: &PunctualLight, origin: DVec3) {
    let schemas = match light.cone {
        Some(_) => " (\n        prepend apiSchemas = [\"ShapingAPI\"]\n    )",
        None => "",
    };
    let c = light.colour;
    let _ = writeln!(
        s,
        "    def SphereLight \"{name}\"{schemas}\n    {{\n        bool treatAsPoint = 1\n        float inputs:radius = {POINT}\n        \
         float inputs:intensity = {}\n        color3f inputs:color = ({}, {}, {})\n        bool inputs:normalize = 0",
        light.intensity / (PI * POINT * POINT),
        c[0],
        c[1],
        c[2]
    );
    let p = DVec3::from_array(light.position) - origin;
    let _ = writeln!(
        s,
        "        double3 xformOp:translate = ({}, {}, {})",
        p.x, p.y, p.z
    );
    let Some(cone) = light.cone else {
        s.push_str("        uniform token[] xformOpOrder = [\"xformOp:translate\"]\n    }\n\n");
        return;
    };
    // it shines along −z; its light falls within the share `softness` of the cone
    let [inner, outer] = cone.angles;
    let turn = Quat::from_rotation_arc(Vec3::NEG_Z, DVec3::from_array(cone.direction).as_vec3());
    let _ = writeln!(
        s,
        "        float inputs:shaping:cone:angle = {}\n        float inputs:shaping:cone:softness = {}\n        \
         quatf xformOp:orient = ({}, {}, {}, {})\n        \
         uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:orient\"]\n    }}\n",
        outer.to_degrees(),
        1.0 - inner / outer.max(f64::MIN_POSITIVE),
        turn.w,
        turn.x,
        turn.y,
        turn.z
    );
}

/// Appends the light from outside: the panorama `file`.
pub(super) fn dome_prim(s: &mut String, file: &str) {
    let _ = writeln!(
        s,
        "    def DomeLight \"environment\"\n    {{\n        float inputs:intensity = 1\n        asset inputs:texture:file = @./{file}@\n        \
         token inputs:texture:format = \"latlong\"\n        float xformOp:rotateY = 180\n        \
         uniform token[] xformOpOrder = [\"xformOp:rotateY\"]\n    }}\n"
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::math::luminance;
    use crate::programs::export::area_light::{area_lights, tests::fan};
    use crate::solution::Solution;
    use crate::solution::SpotCone;
    use glam::{Mat3, Vec3};
    use std::f32::consts::{FRAC_PI_2, PI, TAU};

    /// The number or tuple after `key = ` in a text.
    fn numbers(text: &str, key: &str) -> Vec<f32> {
        let line = text.lines().find(|l| l.contains(key)).expect(key);
        let (_, value) = line.split_once("= ").expect("a value");
        value
            .split(|c: char| "(), ".contains(c))
            .filter_map(|n| n.parse().ok())
            .collect()
    }

    /// Power of a light as UsdLux defines its quantities.
    fn power(text: &str) -> Vec3 {
        let one = |key: &str| numbers(text, key)[0];
        let area = match text.split_whitespace().nth(1).expect("a kind") {
            "RectLight" => one("inputs:width") * one("inputs:height"),
            "DiskLight" => PI * one("inputs:radius").powi(2),
            "SphereLight" => 4.0 * PI * one("inputs:radius").powi(2),
            other => panic!("{other}"),
        };
        PI * area * one("inputs:intensity") * Vec3::from_slice(&numbers(text, "inputs:color"))
    }

    fn written(solution: &Solution) -> String {
        let mut text = String::new();
        for light in area_lights(solution) {
            lamp_prim(&mut text, &light);
        }
        text
    }

    /// A lamp's power is π times the integral of its radiance over its area: what the file says has
    /// the same.
    #[test]
    fn the_power_in_the_file_is_the_lamps() {
        let panel = [(-0.5, -0.2), (0.5, -0.2), (0.5, 0.2), (-0.5, 0.2)];
        let solution = fan(&panel.map(|(x, z)| Vec3::new(x, 1.0, z)));
        let lamp = &solution.lamps[0];
        // L = (8, 4, 2) over 0.4 m²
        let expected = PI * 0.4 * Vec3::new(8.0, 4.0, 2.0);
        assert!(
            (Vec3::from_array(lamp.power) - expected)
                .abs()
                .max_element()
                < 1e-4
        );
        let got = power(&written(&solution));
        assert!((got / expected - 1.0).abs().max_element() < 1e-5, "{got}");
        assert!(luminance(got) > 0.0);
    }

    /// −z of the transform is where the lamp's triangles face.
    #[test]
    fn a_ceiling_lamp_shines_down() {
        // clockwise from above
        let panel = [(-0.5, -0.2), (0.5, -0.2), (0.5, 0.2), (-0.5, 0.2)];
        let solution = fan(&panel.map(|(x, z)| Vec3::new(x, 1.0, z)));
        let m = numbers(&written(&solution), "xformOp:transform");
        assert_eq!(m.len(), 16);
        let shines = -Vec3::from_slice(&m[8..11]);
        let faces = solution.mesh.face_normal(0);
        assert!((shines - faces).length() < 1e-6, "{shines} {faces}");
        let at = Vec3::from_slice(&m[12..15]);
        assert!((at - Vec3::Y).dot(faces) > 0.0 && (at - Vec3::Y).length() < 0.02);
    }

    /// The direction of every place of the panorama, by OpenEXR's definition turned by the dome's
    /// rotation, is the one our environments have.
    #[test]
    fn the_dome_is_turned_as_the_environment_is() {
        let mut text = String::new();
        dome_prim(&mut text, "a.exr");
        let turn = numbers(&text, "xformOp:rotateY")[0].to_radians();
        let map = crate::core::image::Plane {
            width: 8,
            height: 4,
            data: (0..32).map(|i| Vec3::new(i as f32, 0.0, 0.0)).collect(),
        };
        let ours = crate::radiance::Environment::from_map(map.clone());
        for (i, value) in map.data.iter().enumerate() {
            let longitude = PI - TAU * ((i % 8) as f32 + 0.5) / 8.0;
            let latitude = FRAC_PI_2 - PI * ((i / 8) as f32 + 0.5) / 4.0;
            let direction = Mat3::from_rotation_y(turn)
                * Vec3::new(
                    latitude.cos() * longitude.sin(),
                    latitude.sin(),
                    latitude.cos() * longitude.cos(),
                );
            let found = ours.radiance(direction);
            assert!((found - *value).length() < 1e-3, "{i}: {found} {value}");
        }
    }

    /// A spot's intensity is π r² times its sphere's radiance, it stands relative to the origin, and −z of
    /// its rotation is where it shines.
    #[test]
    fn a_spot_keeps_its_intensity_place_and_cone() {
        let light = PunctualLight {
            name: "spot".into(),
            colour: [1.0, 0.5, 0.25],
            intensity: 3.0,
            position: [11.0, 2.0, 5.0],
            cone: Some(SpotCone {
                direction: [0.0, -0.6, 0.8],
                angles: [15.0f64.to_radians(), 30.0f64.to_radians()],
            }),
        };
        let mut text = String::new();
        point_prim(&mut text, "spot", &light, DVec3::new(10.0, 0.0, 5.0));
        let radius = numbers(&text, "inputs:radius")[0];
        let intensity = numbers(&text, "inputs:intensity")[0] * PI * radius * radius;
        assert!((intensity - 3.0).abs() < 1e-4, "{intensity}");
        assert_eq!(numbers(&text, "xformOp:translate"), [1.0, 2.0, 0.0]);
        assert!((numbers(&text, "cone:angle")[0] - 30.0).abs() < 1e-4);
        assert!((numbers(&text, "cone:softness")[0] - 0.5).abs() < 1e-6);
        let q = numbers(&text, "xformOp:orient");
        let shines = Quat::from_xyzw(q[1], q[2], q[3], q[0]) * Vec3::NEG_Z;
        assert!(
            (shines - Vec3::new(0.0, -0.6, 0.8)).length() < 1e-6,
            "{shines}"
        );
    }
}
