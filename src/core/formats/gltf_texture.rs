//! Where a glTF material samples a texture: which set of texture coordinates, moved by
//! `KHR_texture_transform`, and how the texture goes on beyond its borders. Called by `gltf` and
//! `gltf_material`.

use glam::Vec2;
use serde::Deserialize;

/// How a texture goes on beyond its borders, as the document has it.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Sampler {
    wrap_s: Option<u32>,
    wrap_t: Option<u32>,
    mag_filter: Option<u32>,
}

/// A texture as a material names it.
#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct TextureInfo {
    /// Its number.
    pub index: Option<usize>,
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
pub struct UvSource {
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

impl TextureInfo {
    /// The texture coordinates it is sampled at.
    pub(super) fn uv_source(&self) -> UvSource {
        let Some(t) = &self.extensions.transform else {
            return UvSource {
                set: self.tex_coord,
                ..UvSource::default()
            };
        };
        UvSource {
            set: t.tex_coord.unwrap_or(self.tex_coord),
            offset: t.offset,
            turn: [t.rotation.cos(), t.rotation.sin()],
            scale: t.scale,
        }
    }
}

impl UvSource {
    /// Scaled, then turned counter-clockwise as seen with v down, then moved.
    #[must_use]
    pub fn sampled_at(&self, uv: [f64; 2]) -> Vec2 {
        let [u, v] = [uv[0] * self.scale[0], uv[1] * self.scale[1]];
        let [c, s] = self.turn;
        Vec2::new(
            (u * c + v * s + self.offset[0]) as f32,
            (v * c - u * s + self.offset[1]) as f32,
        )
    }
}

/// How a texture goes on beyond its border.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Border {
    /// Again from the other side.
    Repeat,
    /// Again mirrored.
    Mirror,
    /// The border's own value.
    Clamp,
}

/// A texture: a picture, how it goes on, and what lies between its texels.
#[derive(Clone, Debug)]
pub struct GltfTexture {
    /// Number of the picture.
    pub image: usize,
    /// Beyond the sides, beyond top and bottom.
    pub border: [Border; 2],
    /// Whether each texel is a square of one value; else values lie between texels, too.
    pub nearest: bool,
}

impl GltfTexture {
    /// Of a picture; without a sampler it repeats.
    pub(super) fn new(image: usize, sampler: Option<&Sampler>) -> Self {
        let border = |wrap: Option<u32>| match wrap {
            Some(33071) => Border::Clamp,
            Some(33648) => Border::Mirror,
            _ => Border::Repeat,
        };
        let border = [
            border(sampler.and_then(|s| s.wrap_s)),
            border(sampler.and_then(|s| s.wrap_t)),
        ];
        Self {
            image,
            border,
            nearest: sampler.and_then(|s| s.mag_filter) == Some(9728),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_scaled_turned_and_moved_in_this_order() {
        let text = r#"{"index": 0, "texCoord": 2,
            "extensions": {"KHR_texture_transform":
                {"offset": [0.25, 1.0], "rotation": 1.5707963267948966, "scale": [0.5, 2.0], "texCoord": 1}}}"#;
        let texture: TextureInfo = serde_json::from_str(text).expect("texture");
        let source = texture.uv_source();
        assert_eq!(source.set, 1);
        // (1, 0) → (0.5, 0) → a quarter turn with v down → (0, −0.5)
        let at = source.sampled_at([1.0, 0.0]);
        assert!((at - Vec2::new(0.25, 0.5)).length() < 1e-6, "{at}");
        let plain: TextureInfo = serde_json::from_str("{}").expect("texture");
        assert_eq!(plain.uv_source(), UvSource::default());
    }
}
