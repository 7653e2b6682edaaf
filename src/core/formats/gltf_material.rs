//! What a glTF material says of a surface: colour, roughness, metal, light of its own, and where
//! nothing is. Called by `gltf`, which takes the base colour, and `gltf_scene`, which takes all.

use super::gltf_texture::{TextureInfo, UvSource};
use serde::Deserialize;
use std::collections::BTreeMap;

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
    /// Share of light that goes straight through (`KHR_materials_transmission`; red channel).
    pub transmission: Textured<f32>,
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
    specular_glossiness: Option<SpecularGlossiness>,
    /// What is not read.
    #[serde(flatten)]
    others: BTreeMap<String, serde_json::Value>,
}

/// What of the extension is colour without gloss.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct SpecularGlossiness {
    #[serde(default = "opaque_white")]
    diffuse_factor: [f32; 4],
    diffuse_texture: Option<TextureInfo>,
}

fn opaque_white() -> [f32; 4] {
    [1.0; 4]
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
    #[serde(rename = "transmissionTexture")]
    texture: Option<TextureInfo>,
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
    /// What a surface of it looks like: its base colour (diffuse colour, where that is how the file
    /// has it), or the light that it sends out itself. Scans without lighting are written so: black
    /// with their picture as light.
    pub(super) fn paint(&self) -> Textured<[f32; 4]> {
        let GltfMaterial { base, emissive, .. } = GltfMaterial::from(self);
        let base = match &self.extensions.specular_glossiness {
            // (a picture of the fallback is more than a factor)
            Some(s) if s.diffuse_texture.is_some() || base.texture.is_none() => Textured {
                factor: s.diffuse_factor,
                texture: TextureInfo::used(s.diffuse_texture.as_ref()),
            },
            _ => base,
        };
        let light = emissive.factor.iter().any(|e| *e > 0.0);
        let black = base.factor[..3].iter().all(|c| *c == 0.0);
        let unstated = base.texture.is_none() && base.factor == [1.0; 4];
        if light && (black || unstated && emissive.texture.is_some()) {
            let [r, g, b] = emissive.factor;
            return Textured {
                factor: [r, g, b, 1.0],
                texture: emissive.texture,
            };
        }
        base
    }

    /// Whether its colours stand in an extension of which only the diffuse one is read, and only by
    /// `paint`.
    pub(super) fn is_specular_glossiness(&self) -> bool {
        self.extensions.specular_glossiness.is_some()
    }

    /// Extensions of it that change how it reflects and are not read.
    pub(super) fn unread(&self) -> impl Iterator<Item = &str> {
        let names = self.extensions.others.keys().map(String::as_str);
        names.filter(|n| n.starts_with("KHR_materials_"))
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

impl TextureInfo {
    /// A texture as a material uses it, if it names one.
    fn used(info: Option<&Self>) -> Option<TextureUse> {
        let info = info?;
        Some(TextureUse {
            texture: info.index?,
            uv: info.uv_source(),
        })
    }
}

impl From<&MaterialJson> for GltfMaterial {
    fn from(m: &MaterialJson) -> Self {
        let pbr = &m.pbr_metallic_roughness;
        let used = |info: &Option<TextureInfo>| TextureInfo::used(info.as_ref());
        let strength = m.extensions.strength.as_ref().map_or(1.0, |s| s.strength);
        let through = m.extensions.transmission.as_ref();
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
            transmission: Textured {
                factor: through.map_or(0.0, |t| t.factor.clamp(0.0, 1.0)),
                texture: through.and_then(|t| used(&t.texture)),
            },
            double_sided: m.double_sided,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paint(json: &str) -> (Option<usize>, [f32; 4]) {
        let material: MaterialJson = serde_json::from_str(json).expect(json);
        let paint = material.paint();
        (paint.texture.map(|t| t.texture), paint.factor)
    }

    #[test]
    fn the_picture_is_found_wherever_a_material_has_it() {
        let pbr = r#""pbrMetallicRoughness":{"baseColorTexture":{"index":3}}"#;
        let light = r#""emissiveFactor":[1,0.5,1],"emissiveTexture":{"index":4}"#;
        assert_eq!(paint(&format!("{{{pbr}}}")), (Some(3), [1.0; 4]));
        // a lamp's picture adds to its own colour
        assert_eq!(paint(&format!("{{{pbr},{light}}}")), (Some(3), [1.0; 4]));
        let sent_out = (Some(4), [1.0, 0.5, 1.0, 1.0]);
        assert_eq!(paint(&format!("{{{light}}}")), sent_out);
        let black = r#""pbrMetallicRoughness":{"baseColorFactor":[0,0,0,1]}"#;
        assert_eq!(paint(&format!("{{{black},{light}}}")), sent_out);
        assert_eq!(paint(&format!("{{{black}}}")), (None, [0.0, 0.0, 0.0, 1.0]));
        // a picture of light that the factor turns off
        assert_eq!(
            paint(r#"{"emissiveTexture":{"index":4}}"#),
            (None, [1.0; 4])
        );
        let gloss = r#""extensions":{"KHR_materials_pbrSpecularGlossiness":{"diffuseFactor":[0.5,1,1,1],"diffuseTexture":{"index":5}}}"#;
        assert_eq!(
            paint(&format!("{{{gloss},{pbr}}}")),
            (Some(5), [0.5, 1.0, 1.0, 1.0])
        );
    }
}
