//! Reads the pictures that a mesh is painted with, wherever its file has them. Called by
//! `scene::scan`.

use super::image_format::{ImageFormat, is_webp, sniff};
use super::{
    GltfFile, MOST_DATA, TextureSource, decode_rgba8, open_regular, read_display_photograph,
    read_input, read_photograph,
};
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::colour::ColourSpace;
use crate::core::math::linear_from_srgb;
use crate::{Error, Result};
use glam::Vec3;
use std::io::{Read, Write};
use std::path::Path;

/// A picture on its way to the surface.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Linear Rec. 709.
    pub pixels: RgbPlane,
    /// Whether it was made for a display: 8-bit sRGB, whose brightest values are lower bounds.
    pub encoded: bool,
}

/// Reads a picture of the mesh at `mesh`.
///
/// # Errors
/// If it is missing, damaged, or of a format that is not read: PNG, JPEG, WebP, OpenEXR and Radiance
/// HDR are.
pub fn read_texture(mesh: &Path, source: &TextureSource) -> Result<Texture> {
    match source {
        TextureSource::File(path) => read_texture_file(path),
        TextureSource::Embedded(image) => {
            let bytes = read_input(mesh, MOST_DATA)?;
            let bytes = GltfFile::open(&bytes, mesh)?
                .image_bytes(*image)?
                .into_owned();
            embedded(&bytes).map_err(|e| Error::input(mesh, format!("image {image}: {e}")))
        }
        TextureSource::Unusable(why) => Err(Error::input(mesh, why.clone())),
    }
}

/// The picture in the bytes of a file; what is said of it has no name of a file.
fn embedded(bytes: &[u8]) -> std::result::Result<Texture, String> {
    if is_webp(bytes) {
        return of_webp(bytes);
    }
    let mut file = tempfile::NamedTempFile::new().map_err(|e| e.to_string())?;
    file.write_all(bytes).map_err(|e| e.to_string())?;
    let name = file.path().display().to_string();
    read_texture_file(file.path()).map_err(|e| {
        let said = e.to_string().replace(&format!("{name}: "), "");
        said.replace(&name, "the picture")
    })
}

fn of_webp(bytes: &[u8]) -> std::result::Result<Texture, String> {
    let picture = decode_rgba8(bytes)?;
    let curve: [f32; 256] = std::array::from_fn(|v| linear_from_srgb(v as f32 / 255.0));
    let colour = |p: &[u8; 4]| {
        let [r, g, b, _] = p.map(|v| curve[usize::from(v)]);
        Vec3::new(r, g, b)
    };
    let pixels = picture.rgba.iter().map(colour).collect();
    let pixels = Plane::from_data(picture.width, picture.height, pixels);
    Ok(Texture {
        pixels: pixels.ok_or("fewer pixels than its header states; export it again")?,
        encoded: true,
    })
}

fn read_texture_file(path: &Path) -> Result<Texture> {
    let mut head = Vec::new();
    let cannot = |e| Error::input(path, format!("cannot be read: {e}"));
    (open_regular(path)?.take(12).read_to_end(&mut head)).map_err(cannot)?;
    if is_webp(&head) {
        let bytes = read_input(path, MOST_DATA)?;
        return of_webp(&bytes).map_err(|e| Error::input(path, e));
    }
    let encoded = matches!(sniff(path)?, ImageFormat::Png | ImageFormat::Jpeg);
    let pixels = match encoded {
        // glTF 2.0, section 3.8.2: what pictures say of their colours is ignored
        true => read_display_photograph(path, Some(ColourSpace::Srgb))?.pixels,
        false => read_photograph(path, None)?.pixels,
    };
    Ok(Texture { pixels, encoded })
}

#[cfg(test)]
mod tests {
    use super::super::{encode_rgb8, encode_webp8};
    use super::*;

    #[test]
    fn webp_is_read_like_png_from_a_file_and_from_within() {
        let rgb: Vec<u8> = (0..7 * 5 * 3).map(|i| (i * 29 % 256) as u8).collect();
        let webp = encode_webp8(7, 5, &rgb).expect("encodes");
        let png = embedded(&encode_rgb8(7, 5, &rgb).expect("encodes")).expect("reads");
        let within = embedded(&webp).expect("reads");
        assert!(within.encoded && within.pixels.data == png.pixels.data);
        let dir = tempfile::tempdir().expect("folder");
        let file = dir.path().join("t.webp");
        std::fs::write(&file, webp).expect("written");
        let read = read_texture(Path::new("m.obj"), &TextureSource::File(file));
        assert_eq!(read.expect("reads").pixels.data, png.pixels.data);
    }

    #[test]
    fn refusals_name_formats_and_no_file_of_our_own() {
        for (bytes, format) in [
            (&b"\xabKTX 20\xbb\r\n\x1a\n____"[..], "KTX2"),
            (b"\0\0\0\x1cftypavif____", "AVIF"),
            (b"DDS |___________", "DDS"),
            (b"RIFF____WEBPjunk", "cut short"),
            (b"\x89PNG\r\n\x1a\n____", "cut short"),
        ] {
            let e = embedded(bytes).map(|_| ()).expect_err(format);
            assert!(e.contains(format) && !e.contains(".tmp"), "{e}");
        }
        let why = TextureSource::Unusable("its picture is elsewhere".into());
        let e = read_texture(Path::new("m.obj"), &why).map(|_| ());
        assert_eq!(
            e.expect_err("unusable").to_string(),
            "m.obj: its picture is elsewhere"
        );
    }
}
