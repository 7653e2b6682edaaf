//! What an image file's header states, whatever its format.

use super::image_format::{ImageFormat, ImageInfo, sniff};
use super::{hdr, image_io, png_io};
use crate::Result;
use crate::ffi::oiio::Sample;
use std::path::Path;

/// The mark of the set of files that an OpenEXR or PNG file of this program belongs to, if it has
/// one (see [`super::Marked`]).
///
/// # Errors
/// The file cannot be read.
pub fn generation_mark(path: &Path) -> Result<Option<String>> {
    match sniff(path)? {
        ImageFormat::Png => png_io::mark(path),
        ImageFormat::Exr => {
            let parts = image_io::exr_parts(path)?;
            let mark = parts[0].text(image_io::GENERATION);
            Ok(mark.map(str::to_owned))
        }
        _ => Ok(None),
    }
}

/// Size, channels and format of an image, from its header alone.
///
/// # Errors
/// If the file cannot be read or its header is damaged.
pub fn image_info(path: impl AsRef<Path>) -> Result<ImageInfo> {
    let path = path.as_ref();
    match sniff(path)? {
        ImageFormat::Png => png_io::info(path),
        ImageFormat::Hdr => {
            let header = hdr::header(path)?;
            Ok(ImageInfo {
                width: header.width,
                height: header.height,
                channels: 3,
                format: ImageFormat::Hdr,
                sample: Sample::Other,
            })
        }
        format => {
            let image = image_io::open(path, format)?;
            let (w, h, c) = image.size();
            Ok(ImageInfo {
                width: w as usize,
                height: h as usize,
                channels: c as usize,
                format,
                sample: image.sample(),
            })
        }
    }
}
