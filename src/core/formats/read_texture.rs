//! Reads the pictures that a mesh is painted with, wherever its file has them. Called by
//! `scene::scan`.

use super::image_format::{ImageFormat, sniff};
use super::{
    GltfFile, MOST_DATA, TextureSource, read_display_photograph, read_input, read_photograph,
};
use crate::core::image::RgbPlane;
use crate::core::math::colour::ColourSpace;
use crate::{Error, Result};
use std::io::Write;
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
/// If it is missing, damaged, or of a format that is not read: PNG, JPEG, OpenEXR and Radiance HDR
/// are.
pub fn read_texture(mesh: &Path, source: &TextureSource) -> Result<Texture> {
    match source {
        TextureSource::File(path) => read_texture_file(path),
        TextureSource::Embedded(image) => {
            let bytes = read_input(mesh, MOST_DATA)?;
            let bytes = GltfFile::open(&bytes, mesh)?
                .image_bytes(*image)?
                .into_owned();
            let failed = |e| Error::io(std::env::temp_dir(), e);
            let mut file = tempfile::NamedTempFile::new().map_err(failed)?;
            file.write_all(&bytes).map_err(failed)?;
            read_texture_file(file.path())
                .map_err(|e| Error::input(mesh, format!("image {image}: {e}")))
        }
    }
}

fn read_texture_file(path: &Path) -> Result<Texture> {
    let encoded = matches!(sniff(path)?, ImageFormat::Png | ImageFormat::Jpeg);
    let pixels = match encoded {
        // glTF 2.0, section 3.8.2: what pictures say of their colours is ignored
        true => read_display_photograph(path, Some(ColourSpace::Srgb))?.pixels,
        false => read_photograph(path, None)?.pixels,
    };
    Ok(Texture { pixels, encoded })
}
