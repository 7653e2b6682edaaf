//! What an image file's header states, whatever its format.

use super::image_format::{ImageFormat, ImageInfo, sniff};
use super::{image_io, png_io};
use crate::Result;
use std::path::Path;

/// Size, channels and format of an image, from its header alone.
///
/// # Errors
/// If the file cannot be read or its header is damaged.
pub fn image_info(path: impl AsRef<Path>) -> Result<ImageInfo> {
    let path = path.as_ref();
    match sniff(path)? {
        ImageFormat::Png => png_io::info(path),
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
