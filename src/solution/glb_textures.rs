//! The textures of `scene.glb`: base colour, occlusion-roughness-metallic, and what shines, lets light
//! through or is baked, reduced to the largest side and encoded as PNG, WebP or KTX2.

use super::Solution;
use crate::core::formats::{
    Rgb8, Transfer, encode_grey16, encode_ktx2, encode_rgb8, encode_webp8, srgb8_from_linear,
};
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, RgbPlane};
use crate::core::texture::{AtlasReduction, Texel, fitted};
use crate::error::Result;
use glam::Vec2;

/// How textures are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TextureFormat {
    /// PNG, which all programs read.
    #[default]
    Png,
    /// Lossless WebP (`EXT_texture_webp`, required).
    WebP,
    /// KTX2 of UASTC blocks with all smaller copies (`KHR_texture_basisu`, required): what graphics
    /// cards keep compressed.
    Ktx2,
}

impl TextureFormat {
    /// Type of its bytes.
    pub(super) fn mime(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::WebP => "image/webp",
            Self::Ktx2 => "image/ktx2",
        }
    }

    /// The extension of glTF that allows it, where it needs one.
    pub(super) fn extension(self) -> Option<&'static str> {
        match self {
            Self::Png => None,
            Self::WebP => Some("EXT_texture_webp"),
            Self::Ktx2 => Some("KHR_texture_basisu"),
        }
    }
}

/// How a plane becomes the bytes of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TexturePacking {
    /// Largest side, texels; larger planes are halved until they fit, chart by chart.
    pub largest: usize,
    /// How it is stored.
    pub format: TextureFormat,
}

/// Which textures a file has.
pub(super) struct WantedTextures<'a> {
    pub packing: TexturePacking,
    /// The irradiance.
    pub lightmap: bool,
    /// Textures that need not be encoded again.
    pub encoded: &'a [NamedImage],
}

/// A texture, encoded.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedImage {
    /// What engines call it: `BaseColor`, `ORM`, `Emissive`, `Lightmap`.
    pub name: &'static str,
    /// The bytes of its file.
    pub bytes: Vec<u8>,
}

/// The textures of a file, encoded.
pub(super) struct Pictures {
    /// In the order of their numbers.
    pub images: Vec<NamedImage>,
    /// What the emissive texture is to be multiplied by, if the scene emits; its number is 2.
    pub strength: Option<f32>,
    /// What the lightmap is to be multiplied by, if there is one; it comes last.
    pub lightmap: Option<f32>,
    /// The number of the share of transmitted light, if there are panes.
    pub transmission: Option<usize>,
}

/// The textures that do not depend on light, for [`super::GlbOptions::encoded`] of many files.
///
/// # Errors
/// A texture cannot be encoded.
pub fn material_textures(solution: &Solution, packing: TexturePacking) -> Result<Vec<NamedImage>> {
    let named = |name: &'static str, bytes: Vec<u8>| NamedImage { name, bytes };
    Ok(vec![
        named("BaseColor", base_colour(solution, packing)?),
        named("ORM", occlusion_roughness_metallic(solution, packing)?),
    ])
}

/// The textures of `scene.glb` as PNG files: `BaseColor` (sRGB), `ORM` (occlusion, roughness, metal);
/// where the scene emits, `Emissive` (sRGB, as a share of its maximum) and, where it has panes,
/// `Transmission` (share of transmitted light); where 8 bits would show as bands, `Roughness` with 16.
///
/// # Errors
/// A texture cannot be encoded.
pub fn png_textures(solution: &Solution, max_texture: usize) -> Result<Vec<NamedImage>> {
    let wanted = WantedTextures {
        packing: TexturePacking {
            largest: max_texture,
            format: TextureFormat::Png,
        },
        lightmap: false,
        encoded: &[],
    };
    let mut images = encode_pictures(solution, &wanted)?.images;
    let roughness = fitted(&solution.mesh, &solution.roughness, max_texture);
    if has_bands(&roughness) {
        let word = |r: &f32| (r.clamp(0.0, 1.0) * 65_535.0 + 0.5) as u16;
        let words: Vec<u16> = roughness.data.iter().map(word).collect();
        images.push(NamedImage {
            name: "Roughness",
            bytes: encode_grey16(roughness.width, roughness.height, &words)?,
        });
    }
    Ok(images)
}

/// Encodes the textures side by side.
pub(super) fn encode_pictures(
    solution: &Solution,
    wanted: &WantedTextures<'_>,
) -> Result<Pictures> {
    let packing = wanted.packing;
    let atlas = Atlas::of(&solution.mesh, packing);
    let strength = peak(&solution.emission);
    let (base, (orm, emissive)) = crate::core::parallel::join(
        || known("BaseColor", wanted).unwrap_or_else(|| base_colour(solution, packing)),
        || {
            crate::core::parallel::join(
                || {
                    known("ORM", wanted)
                        .unwrap_or_else(|| occlusion_roughness_metallic(solution, packing))
                },
                || {
                    strength
                        .map(|s| atlas.light(&solution.emission, s))
                        .transpose()
                },
            )
        },
    );
    let named = |name: &'static str, bytes: Vec<u8>| NamedImage { name, bytes };
    let mut images = vec![named("BaseColor", base?), named("ORM", orm?)];
    images.extend(emissive?.map(|e| named("Emissive", e)));
    let mut transmission = None;
    if let Some(share) = &solution.transmission {
        transmission = Some(images.len());
        let bytes = atlas.picture(share, Transfer::Linear, |t| [byte(*t); 3])?;
        images.push(named("Transmission", bytes));
    }
    let lightmap = peak(&solution.irradiance).filter(|_| wanted.lightmap);
    if let Some(peak) = lightmap {
        let bytes = atlas.light(&solution.irradiance, peak)?;
        images.push(named("Lightmap", bytes));
    }
    Ok(Pictures {
        images,
        strength,
        lightmap,
        transmission,
    })
}

/// Whether a share in 8 bits has bands: most steps from a texel to the next in its row, where there is
/// one, are shorter than those of 8 bits.
fn has_bands(share: &Plane<f32>) -> bool {
    let (mut fine, mut coarse) = (0usize, 0usize);
    for row in share.data.chunks_exact(share.width.max(1)) {
        for step in row.windows(2).map(|w| (w[1] - w[0]).abs()) {
            fine += usize::from(step > 0.0 && step < 1.0 / 255.0);
            coarse += usize::from(step >= 1.0 / 255.0);
        }
    }
    fine > coarse
}

/// A texture that is encoded already.
fn known(name: &str, wanted: &WantedTextures<'_>) -> Option<Result<Vec<u8>>> {
    let image = wanted.encoded.iter().find(|i| i.name == name);
    image.map(|i| Ok(i.bytes.clone()))
}

fn base_colour(solution: &Solution, packing: TexturePacking) -> Result<Vec<u8>> {
    Atlas::of(&solution.mesh, packing).picture(&solution.albedo, Transfer::Srgb, |v| {
        v.to_array().map(srgb8_from_linear)
    })
}

/// A share in 8 bits, linear.
fn byte(x: f32) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

fn occlusion_roughness_metallic(solution: &Solution, packing: TexturePacking) -> Result<Vec<u8>> {
    let roughness = &solution.roughness;
    let atlas = Atlas::of(&solution.mesh, packing);
    let Some(metallic) = &solution.metallic else {
        return atlas.picture(roughness, Transfer::Linear, |r| [255, byte(*r), 0]);
    };
    // the finer of the two decides the size
    let (width, height) = (
        roughness.width.max(metallic.width),
        roughness.height.max(metallic.height),
    );
    let [roughness, metallic] = [roughness, metallic].map(|p| p.resampled(width, height));
    let both = Plane {
        width,
        height,
        data: (roughness.data.iter().zip(&metallic.data))
            .map(|(r, m)| Vec2::new(*r, *m))
            .collect(),
    };
    atlas.picture(&both, Transfer::Linear, |v| [255, byte(v.x), byte(v.y)])
}

/// The textures of a mesh on their way into a file.
struct Atlas<'a> {
    mesh: &'a Mesh,
    packing: TexturePacking,
}

impl<'a> Atlas<'a> {
    fn of(mesh: &'a Mesh, packing: TexturePacking) -> Self {
        Self { mesh, packing }
    }

    /// Light as a share of its peak.
    fn light(&self, light: &RgbPlane, peak: f32) -> Result<Vec<u8>> {
        self.picture(light, Transfer::Srgb, |v| {
            (*v / peak).to_array().map(srgb8_from_linear)
        })
    }

    /// A plane as a texture; `bytes` are a texel's, on the curve that `transfer` names.
    fn picture<T: Texel>(
        &self,
        plane: &Plane<T>,
        transfer: Transfer,
        bytes: impl Fn(&T) -> [u8; 3],
    ) -> Result<Vec<u8>> {
        let plane = fitted(self.mesh, plane, self.packing.largest);
        let rgb = |p: &Plane<T>| p.data.iter().flat_map(&bytes).collect::<Vec<u8>>();
        match self.packing.format {
            TextureFormat::Png => encode_rgb8(plane.width, plane.height, &rgb(&plane)),
            TextureFormat::WebP => encode_webp8(plane.width, plane.height, &rgb(&plane)),
            TextureFormat::Ktx2 => {
                let levels = self.levels(&in_blocks(&plane)).into_iter();
                let levels = levels.map(|level| Rgb8 {
                    rgb: rgb(&level),
                    width: level.width,
                    height: level.height,
                });
                encode_ktx2(&levels.collect::<Vec<_>>(), transfer)
            }
        }
    }

    /// The plane and its halves, down to a single texel.
    fn levels<T: Texel>(&self, plane: &Plane<T>) -> Vec<Plane<T>> {
        let reduction = AtlasReduction::new(self.mesh, plane.width, plane.height);
        let mut out = vec![plane.clone()];
        let (mut width, mut height) = (plane.width, plane.height);
        while width.max(height) > 1 {
            (width, height) = ((width / 2).max(1), (height / 2).max(1));
            out.push(reduction.reduced(plane, width, height));
        }
        out
    }
}

/// The plane with sides that are multiples of four, as `KHR_texture_basisu` wants them: itself, or a
/// little finer.
fn in_blocks<T: Texel>(plane: &Plane<T>) -> Plane<T> {
    let size = [plane.width, plane.height].map(|n| n.next_multiple_of(4));
    if size == [plane.width, plane.height] {
        return plane.clone();
    }
    plane.resampled(size[0], size[1])
}

/// The largest finite channel of the emission, if anything emits.
fn peak(emission: &RgbPlane) -> Option<f32> {
    let max = emission
        .data
        .iter()
        .flat_map(|v| v.to_array())
        .filter(|v| v.is_finite())
        .fold(0.0, f32::max);
    (max > 0.0).then_some(max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solution::tests::small_solution;
    use crate::solution::{GlbOptions, scene_glb};
    use glam::Vec3;
    use serde_json::{Value, json};

    /// Each texture has all its smaller copies, and is said to be colour or numbers as it is.
    #[test]
    fn ktx2_textures_say_what_they_are_and_have_all_levels() {
        let mut solution = small_solution();
        solution.albedo = Plane::filled(18, 6, Vec3::new(0.2, 0.4, 0.6));
        let options = GlbOptions {
            textures: TextureFormat::Ktx2,
            lightmap: true,
            ..GlbOptions::default()
        };
        let bytes = scene_glb(&solution, &options).expect("writes");
        let glb = gltf::binary::Glb::from_slice(&bytes).expect("container");
        let root: Value = serde_json::from_slice(&glb.json).expect("JSON");
        assert_eq!(root["extensionsRequired"], json!(["KHR_texture_basisu"]));
        let binary = glb.bin.as_ref().expect("binary");
        let texture = &root["textures"][1]["extensions"]["KHR_texture_basisu"];
        assert_eq!(texture["source"], 1);
        // the albedo has become one of whole blocks
        let expected = [
            ("BaseColor", [20, 8], true),
            ("ORM", [32, 32], false),
            ("Emissive", [8, 8], true),
            ("Lightmap", [8, 8], true),
        ];
        let images = root["images"].as_array().expect("images");
        assert_eq!(images.len(), expected.len());
        for (image, (name, size, colour)) in images.iter().zip(expected) {
            assert_eq!(
                (&image["name"], &image["mimeType"]),
                (&json!(name), &json!("image/ktx2"))
            );
            let view = &root["bufferViews"][image["bufferView"].as_u64().expect("a view") as usize];
            let number = |key: &str| view[key].as_u64().expect("a number") as usize;
            let first = number("byteOffset");
            let file = ktx2::Reader::new(&binary[first..first + number("byteLength")]).expect(name);
            let header = file.header();
            assert_eq!([header.pixel_width, header.pixel_height], size, "{name}");
            let all = 32 - size[0].max(size[1]).leading_zeros();
            assert_eq!(header.level_count, all, "{name}");
            let curve = match colour {
                true => ktx2::TransferFunction::SRGB,
                false => ktx2::TransferFunction::Linear,
            };
            assert_eq!(file.transfer_function(), Some(curve), "{name}");
        }
    }

    #[test]
    fn roughness_that_8_bits_would_band_has_16() {
        let mut solution = small_solution();
        let ramp = |scale: f32| Plane {
            width: 64,
            height: 4,
            data: (0..256).map(|i| 0.3 + scale * (i % 64) as f32).collect(),
        };
        let found = |solution: &Solution| {
            let images = png_textures(solution, 64).expect("encodes");
            images.into_iter().find(|i| i.name == "Roughness")
        };
        // a step of 8 bits each, and one for every ten
        solution.roughness = ramp(1.0 / 255.0 + 1e-5);
        assert_eq!(found(&solution), None);
        solution.roughness = Plane::filled(64, 4, 0.3);
        assert_eq!(found(&solution), None, "no steps at all");
        solution.roughness = ramp(0.1 / 255.0);
        let image = found(&solution).expect("bands");
        let mut reader = png::Decoder::new(std::io::Cursor::new(&image.bytes))
            .read_info()
            .expect("valid");
        assert_eq!(reader.info().bit_depth, png::BitDepth::Sixteen);
        let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
        reader.next_frame(&mut bytes).expect("pixels");
        for (pair, r) in bytes
            .as_chunks::<2>()
            .0
            .iter()
            .zip(&solution.roughness.data)
        {
            assert!((f32::from(u16::from_be_bytes(*pair)) / 65_535.0 - r).abs() < 1e-5);
        }
    }

    /// A copy half the size has the mean of the light, not of the numbers on the curve.
    #[test]
    fn smaller_copies_are_means_of_light() {
        let board = |i: usize| Vec3::splat(f32::from((i % 8 + i / 8).is_multiple_of(2)));
        let plane = Plane {
            width: 8,
            height: 8,
            data: (0..64).map(board).collect(),
        };
        let packing = TexturePacking {
            largest: 8,
            format: TextureFormat::Ktx2,
        };
        let mut solution = small_solution();
        solution.albedo = plane;
        let bytes = base_colour(&solution, packing).expect("encodes");
        let file = ktx2::Reader::new(bytes.as_slice()).expect("valid");
        let level = file.levels().nth(1).expect("a second level");
        let grey = srgb8_from_linear(0.5);
        assert!(grey > 180, "{grey}");
        let expected = crate::ffi::basis::uastc_blocks(4, 4, &[grey; 48]);
        assert_eq!(Some(level.data), expected.as_deref());
    }
}
