//! What a glTF material says of a surface: colour, roughness, metal, light of its own, and where
//! nothing is. Called by `gltf`, which takes the base colour, and `gltf_scene`, which takes all.

use super::gltf_texture::{TextureInfo, UvSource};
use serde::Deserialize;

/// A factor and a texture that multiplies it.
#[derive(Clone, Debug, PartialEq)]
pub struct Textured<T> {
    /// Factor; linear where it is a colour.
    pub factor: T,
    /// Texture and where it is sampled.
    pub texture: Option<TextureUse>,
}

/// A texture as a material uses it.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureUse {
    /// Number of the texture.
    pub texture: usize,
    /// Where it is sampled.
    pub uv: UvSource,
}

/// How alpha is understood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alpha {
    /// Not at all.
    Opaque,
    /// Nothing is there where it is below this.
    Mask(f32),
    /// The share of light that a surface stops.
    Blend,
}

/// A material.
#[derive(Clone, Debug, PartialEq)]
pub struct GltfMaterial {
    /// Base colour, linear, with alpha.
    pub base: Textured<[f32; 4]>,
    /// Metal (blue channel) and roughness (green channel).
    pub metal_roughness: Textured<[f32; 2]>,
    /// Emitted radiance, in the file's unit (cd/m² by the standard).
    pub emissive: Textured<[f32; 3]>,
    /// How alpha is understood.
    pub alpha: Alpha,
    /// Share of light that goes straight through (`KHR_materials_transmission`).
    pub transmission: f32,
    /// Whether the back is a surface, too.
    pub double_sided: bool,
}

impl Default for GltfMaterial {
    fn default() -> Self {
        Self::from(&MaterialJson::default())
    }
}

/// The material's JSON.
#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct MaterialJson {
    pub(super) name: Option<String>,
    pbr_metallic_roughness: Pbr,
    emissive_factor: [f32; 3],
    emissive_texture: Option<TextureInfo>,
    alpha_mode: String,
    alpha_cutoff: f32,
    double_sided: bool,
    extensions: Extensions,
}

#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Pbr {
    base_color_factor: [f32; 4],
    base_color_texture: Option<TextureInfo>,
    metallic_factor: f32,
    roughness_factor: f32,
    metallic_roughness_texture: Option<TextureInfo>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Extensions {
    #[serde(rename = "KHR_materials_emissive_strength")]
    strength: Option<Strength>,
    #[serde(rename = "KHR_materials_transmission")]
    transmission: Option<Transmission>,
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    specular_glossiness: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
struct Strength {
    #[serde(rename = "emissiveStrength", default = "one")]
    strength: f32,
}

#[derive(Deserialize)]
struct Transmission {
    #[serde(rename = "transmissionFactor", default)]
    factor: f32,
}

fn one() -> f32 {
    1.0
}

impl Default for MaterialJson {
    fn default() -> Self {
        Self {
            name: None,
            pbr_metallic_roughness: Pbr::default(),
            emissive_factor: [0.0; 3],
            emissive_texture: None,
            alpha_mode: String::new(),
            alpha_cutoff: 0.5,
            double_sided: false,
            extensions: Extensions::default(),
        }
    }
}

impl Default for Pbr {
    fn default() -> Self {
        Self {
            base_color_factor: [1.0; 4],
            base_color_texture: None,
            metallic_factor: 1.0,
            roughness_factor: 1.0,
            metallic_roughness_texture: None,
        }
    }
}

impl MaterialJson {
    /// Where the base colour is sampled; without a texture, where its coordinates would be.
    pub(super) fn base_uv(&self) -> UvSource {
        let texture = self.pbr_metallic_roughness.base_color_texture.as_ref();
        texture.map_or_else(UvSource::default, TextureInfo::uv_source)
    }

    /// Whether its colours stand in an extension that is not read.
    pub(super) fn is_specular_glossiness(&self) -> bool {
        self.extensions.specular_glossiness.is_some()
    }

    /// What of it is no number that a surface can have.
    pub(super) fn fault(&self) -> Option<&'static str> {
        let pbr = &self.pbr_metallic_roughness;
        let share = |v: &[f32]| v.iter().all(|x| (0.0..=1.0).contains(x));
        let strength = self
            .extensions
            .strength
            .as_ref()
            .map_or(1.0, |s| s.strength);
        let light = |v: f32| v.is_finite() && v >= 0.0;
        if !share(&pbr.base_color_factor) {
            return Some("baseColorFactor");
        }
        if !share(&[pbr.metallic_factor, pbr.roughness_factor]) {
            return Some("metallicFactor or roughnessFactor");
        }
        if !self.emissive_factor.iter().all(|e| light(*e)) || !light(strength) {
            return Some("emissiveFactor or emissiveStrength");
        }
        None
    }
}

impl From<&MaterialJson> for GltfMaterial {
    fn from(m: &MaterialJson) -> Self {
        let pbr = &m.pbr_metallic_roughness;
        let used = |info: &Option<TextureInfo>| {
            let info = info.as_ref()?;
            Some(TextureUse {
                texture: info.index?,
                uv: info.uv_source(),
            })
        };
        let strength = m.extensions.strength.as_ref().map_or(1.0, |s| s.strength);
        Self {
            base: Textured {
                factor: pbr.base_color_factor,
                texture: used(&pbr.base_color_texture),
            },
            metal_roughness: Textured {
                factor: [pbr.metallic_factor, pbr.roughness_factor],
                texture: used(&pbr.metallic_roughness_texture),
            },
            emissive: Textured {
                factor: m.emissive_factor.map(|e| e * strength),
                texture: used(&m.emissive_texture),
            },
            alpha: match m.alpha_mode.as_str() {
                "MASK" => Alpha::Mask(m.alpha_cutoff),
                "BLEND" => Alpha::Blend,
                _ => Alpha::Opaque,
            },
            transmission: m
                .extensions
                .transmission
                .as_ref()
                .map_or(0.0, |t| t.factor.clamp(0.0, 1.0)),
            double_sided: m.double_sided,
        }
    }
}
