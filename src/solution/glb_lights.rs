//! Lights of a glTF file beside the emissive texture: lights without extent
//! (`KHR_lights_punctual`), and surfaces that only shine, which a changed lighting adds or moves.

use crate::core::geometry::Mesh;
use glam::{DQuat, DVec3, Vec3};
use serde_json::{Value, json};

/// A light of `KHR_lights_punctual`.
#[derive(Clone, Debug, PartialEq)]
pub struct PunctualLight {
    /// Name.
    pub name: String,
    /// Colour, largest channel 1.
    pub colour: [f64; 3],
    /// Radiant intensity per steradian in the images' units.
    pub intensity: f64,
    /// Place in file coordinates.
    pub position: [f64; 3],
    /// The cone of a spot; `None` = it shines everywhere alike.
    pub cone: Option<SpotCone>,
}

/// Where a spot shines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpotCone {
    /// Unit axis.
    pub direction: [f64; 3],
    /// Angles to the axis at which its light begins to fall and at which it has ended, radians.
    pub angles: [f64; 2],
}

/// A surface that shines and reflects nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct LuminousPart {
    /// Name.
    pub name: String,
    /// Geometry, relative to the solution's origin.
    pub mesh: Mesh,
    /// Emitted radiance.
    pub radiance: Vec3,
}

impl LuminousPart {
    /// A black material that emits.
    pub(super) fn material(&self) -> Value {
        let strength = self.radiance.max_element();
        let colour = self.radiance / strength.max(f32::MIN_POSITIVE);
        json!({
            "name": self.name,
            "pbrMetallicRoughness": {"baseColorFactor": [0.0, 0.0, 0.0, 1.0], "metallicFactor": 0.0},
            "emissiveFactor": colour.clamp(Vec3::ZERO, Vec3::ONE).as_dvec3().to_array(),
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": f64::from(strength)}},
        })
    }
}

/// Adds a node per light beside the scene's.
pub(super) fn add_lights(root: &mut Value, lights: &[PunctualLight]) {
    if lights.is_empty() {
        return;
    }
    let kinds: Vec<Value> = lights.iter().map(kind).collect();
    let surfaces = root["nodes"].as_array().cloned().unwrap_or_default();
    let first = surfaces.len();
    let roots: Vec<usize> = std::iter::once(0)
        .chain(first..first + lights.len())
        .collect();
    let lamps = lights.iter().enumerate().map(node);
    root["scenes"][0]["nodes"] = json!(roots);
    root["nodes"] = json!(surfaces.into_iter().chain(lamps).collect::<Vec<Value>>());
    root["extensions"] = json!({"KHR_lights_punctual": {"lights": kinds}});
}

fn kind(light: &PunctualLight) -> Value {
    let mut kind = json!({
        "type": "point",
        "name": light.name,
        "color": light.colour,
        "intensity": light.intensity,
    });
    if let Some(SpotCone {
        angles: [inner, outer],
        ..
    }) = light.cone
    {
        // the format wants 0 ≤ inner < outer ≤ a right angle
        let outer = outer.min(std::f64::consts::FRAC_PI_2);
        let inner = inner.clamp(0.0, outer * (1.0 - 1e-6));
        kind["type"] = json!("spot");
        kind["spot"] = json!({"innerConeAngle": inner, "outerConeAngle": outer});
    }
    kind
}

fn node((i, light): (usize, &PunctualLight)) -> Value {
    let mut node = json!({
        "name": light.name,
        "translation": light.position,
        "extensions": {"KHR_lights_punctual": {"light": i}},
    });
    if let Some(cone) = light.cone {
        // spots shine along −z
        let axis = DVec3::from_array(cone.direction).normalize_or(DVec3::NEG_Y);
        let turn = DQuat::from_rotation_arc(DVec3::NEG_Z, axis).normalize();
        node["rotation"] = json!(turn.to_array());
    }
    node
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spot_is_turned_to_where_it_shines() {
        let direction = DVec3::new(1.0, -2.0, 0.5).normalize();
        let light = PunctualLight {
            name: "spot".into(),
            colour: [1.0; 3],
            intensity: 2.0,
            position: [1.0, 2.0, 3.0],
            cone: Some(SpotCone {
                direction: direction.to_array(),
                angles: [0.5, 0.5],
            }),
        };
        let mut root = json!({"nodes": [{"name": "scene"}], "scenes": [{"nodes": [0]}]});
        add_lights(&mut root, &[light]);
        assert_eq!(root["scenes"][0]["nodes"], json!([0, 1]));
        let r = root["nodes"][1]["rotation"].as_array().expect("turned");
        let r: Vec<f64> = r.iter().filter_map(Value::as_f64).collect();
        let shines = DQuat::from_slice(&r) * DVec3::NEG_Z;
        assert!((shines - direction).length() < 1e-9, "{shines}");
        let spot = &root["extensions"]["KHR_lights_punctual"]["lights"][0]["spot"];
        let angle = |key: &str| spot[key].as_f64().expect("an angle");
        assert!(angle("innerConeAngle") < angle("outerConeAngle"));
    }
}
