//! Which format an image file has, by its first bytes, and what its header states.

use super::{exr_header, open_regular};
use crate::ffi::oiio::Sample;
use crate::{Error, Result};
use std::ffi::CStr;
use std::io::Read;
use std::path::Path;

/// Image formats the program knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// OpenEXR.
    Exr,
    /// Radiance HDR.
    Hdr,
    /// PNG.
    Png,
    /// JPEG.
    Jpeg,
}

impl ImageFormat {
    /// Whether values are scene-linear radiance rather than display-referred.
    #[must_use]
    pub fn is_linear(self) -> bool {
        matches!(self, Self::Exr | Self::Hdr)
    }

    /// OpenImageIO's name of the reader.
    pub(super) fn reader(self) -> &'static CStr {
        match self {
            Self::Exr => c"openexr",
            Self::Hdr => c"hdr",
            Self::Png => c"png",
            Self::Jpeg => c"jpeg",
        }
    }
}

/// What a file says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageInfo {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Channels.
    pub channels: usize,
    /// File format.
    pub format: ImageFormat,
    /// How samples are stored.
    pub sample: Sample,
}

/// Tells the format by the first bytes; errors name what was found instead.
pub(super) fn sniff(path: &Path) -> Result<ImageFormat> {
    let mut head = Vec::new();
    open_regular(path)?
        .take(32)
        .read_to_end(&mut head)
        .map_err(|e| Error::input(path, format!("cannot be read: {e}")))?;
    let found = match head.as_slice() {
        h if h.starts_with(&exr_header::MAGIC) => return Ok(ImageFormat::Exr),
        h if h.starts_with(b"#?") => return Ok(ImageFormat::Hdr),
        h if h.starts_with(b"\x89PNG") => return Ok(ImageFormat::Png),
        [0xff, 0xd8, 0xff, ..] => return Ok(ImageFormat::Jpeg),
        [] => "an empty file",
        h if h.starts_with(b"version https://git-lfs") => "a Git LFS pointer (run `git lfs pull`)",
        h if h.starts_with(b"\xabKTX") => "a KTX2 texture (gltf-transform png makes PNG of it)",
        h if h.starts_with(b"DDS ") => "a DDS texture (convert it to PNG)",
        h if h.starts_with(b"BM") => "a BMP picture (convert it to PNG)",
        h if h.starts_with(b"RIFF") && h.get(8..12) == Some(b"WEBP") => {
            "a WebP picture (convert it to PNG)"
        }
        h if h.get(4..8) == Some(b"ftyp") => "an AVIF or HEIC picture (convert it to PNG)",
        h if h.starts_with(b"II") || h.starts_with(b"MM") => "a TIFF or camera raw file",
        _ => "something else",
    };
    Err(Error::input(
        path,
        format!("not an image: expected OpenEXR, Radiance HDR, PNG or JPEG, found {found}"),
    ))
}
