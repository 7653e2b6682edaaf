//! Bytes ⇄ types: images of every format the program reads and writes, and files that appear whole
//! or not at all.
//!
//! Readers return what is in the file, NaN included: the scene judges. Writers refuse values that
//! are not finite.

mod aside_folder;
mod curve;
mod depth;
mod eight_bit;
mod encoding;
mod exif_exposure;
mod exr_header;
mod glb;
pub mod gltf;
mod gltf_accessor;
mod gltf_bytes;
mod gltf_compressed;
mod gltf_document;
mod gltf_material;
mod gltf_numbers;
mod gltf_scene;
mod gltf_texture;
mod hdr;
mod icc;
mod image_format;
mod image_io;
mod input;
mod jpeg_header;
mod ktx2;
pub mod obj;
mod panorama;
mod photograph;
mod picture;
pub mod ply;
mod ply_ascii;
mod png_io;
pub mod polygon;
mod probe;
mod raw_mesh;
mod read_mesh;
mod read_texture;
mod surface_look;
mod text;
mod whole;

#[cfg(test)]
mod display_tests;
#[cfg(test)]
mod tests;

pub use aside_folder::AsideFolder;
pub use depth::read_depth;
pub use exif_exposure::exif_exposure;
pub use glb::{GlbWriter, LIGHTMAP, glb_of};
pub use gltf_material::{Alpha, GltfMaterial, TextureUse, Textured};
pub use gltf_scene::{GltfFile, GltfLight, GltfLightKind, Piece, RawAttribute};
pub use gltf_texture::{Border, GltfTexture, UvSource};
pub use image_format::{ImageFormat, ImageInfo};
pub use image_io::{
    Marked, read_plane, read_rgb, read_two_channels, write_plane_float, write_plane_half,
    write_rgb_float, write_rgb_half, write_two_channels_float, write_two_channels_half,
};
pub use input::{MOST_DATA, MOST_TEXT, open_regular, read_input, read_input_text, without_mark};
pub use ktx2::{Rgb8, Transfer, encode_ktx2};
pub use panorama::read_panorama;
pub use photograph::{
    ImageAccount, Photograph, image_account, read_display_photograph, read_ldr, read_photograph,
};
pub use picture::{
    Picture8, decode_rgba8, encode_grey8, encode_grey16, encode_rgb8, encode_webp8,
    srgb8_from_linear,
};
pub use png_io::{read_labels, read_mask, write_png_rgb8, write_png8, write_png16};
pub use probe::{generation_mark, image_info};
pub use raw_mesh::{NameKind, Oddities, RawMesh, SurfaceNames};
pub use read_mesh::read_mesh;
pub use read_texture::{Texture, read_texture};
pub use surface_look::{Look, TextureSource};
pub use text::{grouped, number_and_unit};
pub use whole::{Aside, atomic_write, remove_if_there, sync};

use crate::{Error, Result};
use std::path::Path;

/// Pixels an image may have: 16,384².
pub const MAX_PIXELS: usize = 1 << 28;

/// OpenImageIO's version; loads the library at the first call.
#[must_use]
pub fn version() -> String {
    crate::ffi::oiio::version()
        .unwrap_or_else(|e| format!("unusable: {}", e.lines().next().unwrap_or_default()))
}

/// Judges a size stated by a file before anything is allocated for it.
fn checked_size(path: &Path, width: i64, height: i64) -> Result<(usize, usize)> {
    let fine = width > 0
        && height > 0
        && width
            .checked_mul(height)
            .is_some_and(|n| n <= MAX_PIXELS as i64);
    if fine {
        return Ok((width as usize, height as usize));
    }
    Err(Error::input(
        path,
        format!(
            "its header states {width} × {height} pixels; expected at least 1 × 1 and at most {MAX_PIXELS} in all (16,384²): \
             the file is damaged, or should be scaled down"
        ),
    ))
}

/// A zeroed buffer for pixels, or an error where memory does not suffice.
fn pixel_buffer<T: bytemuck::Zeroable + Clone>(path: &Path, count: usize) -> Result<Vec<T>> {
    let mut data = Vec::new();
    data.try_reserve_exact(count).map_err(|e| {
        Error::Failed(format!(
            "{}: no memory for its {count} values: {e}",
            path.display()
        ))
    })?;
    data.resize(count, T::zeroed());
    Ok(data)
}
