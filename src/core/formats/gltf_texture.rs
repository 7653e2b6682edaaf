//! A glTF material's name and colour, and where it samples its base colour: which set of texture coordinates,
//! moved by `KHR_texture_transform`. Called by `gltf`.

use glam::{Vec2, Vec3};
use serde::Deserialize;

/// A material, as far as its name and texture coordinates go.
#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Material {
    pub name: Option<String>,
    pbr_metallic_roughness: Textures,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Textures {
    base_color_texture: TextureInfo,
    base_color_factor: Option<[f32; 4]>,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct TextureInfo {
    /// Absent in materials without a picture.
    index: Option<usize>,
    tex_coord: u32,
    extensions: Extensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Extensions {
    #[serde(rename = "KHR_texture_transform")]
    transform: Option<Transform>,
}

#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Transform {
    offset: [f64; 2],
    rotation: f64,
    scale: [f64; 2],
    tex_coord: Option<u32>,
}

impl Default for Transform {
    fn default() -> Self {
        Self {
            offset: [0.0; 2],
            rotation: 0.0,
            scale: [1.0; 2],
            tex_coord: None,
        }
    }
}

/// A set of texture coordinates and the affine map to where the texture is sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UvSource {
    /// The n of `TEXCOORD_n`.
    pub set: u32,
    offset: [f64; 2],
    /// Cosine and sine of the turn.
    turn: [f64; 2],
    scale: [f64; 2],
}

impl Default for UvSource {
    fn default() -> Self {
        Self {
            set: 0,
            offset: [0.0; 2],
            turn: [1.0, 0.0],
            scale: [1.0; 2],
        }
    }
}

impl Material {
    /// The texture of the base colour.
    pub(super) fn texture(&self) -> Option<usize> {
        self.pbr_metallic_roughness.base_color_texture.index
    }

    /// What the base colour's texture is multiplied with, linear RGB.
    pub(super) fn factor(&self) -> Vec3 {
        let [r, g, b, _] = self
            .pbr_metallic_roughness
            .base_color_factor
            .unwrap_or([1.0; 4]);
        Vec3::new(r, g, b)
    }

    /// The texture coordinates of the base colour.
    pub(super) fn uv_source(&self) -> UvSource {
        let info = &self.pbr_metallic_roughness.base_color_texture;
        let Some(t) = &info.extensions.transform else {
            return UvSource {
                set: info.tex_coord,
                ..UvSource::default()
            };
        };
        UvSource {
            set: t.tex_coord.unwrap_or(info.tex_coord),
            offset: t.offset,
            turn: [t.rotation.cos(), t.rotation.sin()],
            scale: t.scale,
        }
    }
}

impl UvSource {
    /// Scaled, then turned counter-clockwise as seen with v down, then moved.
    pub(super) fn sampled_at(&self, uv: [f64; 2]) -> Vec2 {
        let [u, v] = [uv[0] * self.scale[0], uv[1] * self.scale[1]];
        let [c, s] = self.turn;
        Vec2::new(
            (u * c + v * s + self.offset[0]) as f32,
            (v * c - u * s + self.offset[1]) as f32,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_scaled_turned_and_moved_in_this_order() {
        let text = r#"{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 2,
            "extensions": {"KHR_texture_transform":
                {"offset": [0.25, 1.0], "rotation": 1.5707963267948966, "scale": [0.5, 2.0], "texCoord": 1}}}}}"#;
        let material: Material = serde_json::from_str(text).expect("material");
        let source = material.uv_source();
        assert_eq!(source.set, 1);
        // (1, 0) → (0.5, 0) → a quarter turn with v down → (0, −0.5)
        let at = source.sampled_at([1.0, 0.0]);
        assert!((at - Vec2::new(0.25, 0.5)).length() < 1e-6, "{at}");
        let plain: Material = serde_json::from_str("{}").expect("material");
        assert_eq!(plain.uv_source(), UvSource::default());
    }
}
