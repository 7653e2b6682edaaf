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
        [] => "an empty file".into(),
        h => match other_format(h) {
            Some(other) => format!("{} ({})", other.name, other.way_out),
            None => "something else".into(),
        },
    };
    Err(Error::input(
        path,
        format!("not an image: expected OpenEXR, Radiance HDR, PNG or JPEG, found {found}"),
    ))
}

/// Whether a file that begins like this is WebP, which is read as a texture only.
pub(super) fn is_webp(head: &[u8]) -> bool {
    head.starts_with(b"RIFF") && head.get(8..12) == Some(b"WEBP")
}

/// A format that is not read.
struct OtherFormat {
    name: &'static str,
    way_out: &'static str,
}

/// The format of a file that begins like this, if people come with such files.
fn other_format(head: &[u8]) -> Option<OtherFormat> {
    const CONVERT: &str = "convert it to PNG, as by `magick IN OUT.png`";
    const LINEAR: &str = "convert it to OpenEXR, as by `oiiotool IN -o OUT.exr`";
    const DEVELOP: &str = "develop it to linear OpenEXR, or convert it to 16-bit PNG";
    let starts = |with: &[u8]| head.starts_with(with);
    // boxes of ISO media: a length, "ftyp" and the brand
    let brand = (head.get(4..8) == Some(b"ftyp")).then(|| head.get(8..12).unwrap_or_default());
    let (name, way_out) = match brand {
        Some(b"avif" | b"avis") => ("an AVIF picture", CONVERT),
        Some(b"crx ") => ("a camera raw file", DEVELOP),
        Some(b"heic" | b"heix" | b"hevc" | b"hevx" | b"heim" | b"heis" | b"mif1" | b"msf1") => (
            "a HEIC picture",
            "convert it to PNG, as by `heif-convert IN.heic OUT.png`",
        ),
        Some(_) => (
            "a video, or a picture in its container",
            "extract its frames as PNG, as by `ffmpeg -i IN %04d.png`",
        ),
        None if starts(b"version https://git-lfs") => ("a Git LFS pointer", "run `git lfs pull`"),
        None if is_webp(head) => ("a WebP picture", CONVERT),
        None if starts(&[0xff, 0x0a]) || head.get(4..8) == Some(b"JXL ") => (
            "a JPEG XL picture",
            "convert it to PNG, as by `djxl IN OUT.png`",
        ),
        None if starts(&[0xff, 0x4f, 0xff, 0x51]) || head.get(4..8) == Some(b"jP  ") => {
            ("a JPEG 2000 picture", CONVERT)
        }
        None if starts(b"\xabKTX") => (
            "a KTX2 texture",
            "convert it to PNG; in glTF, `gltf-transform png` makes PNG of all",
        ),
        None if starts(b"DDS ") => ("a DDS texture", CONVERT),
        None if starts(b"BM") => ("a BMP picture", CONVERT),
        None if starts(b"GIF8") => ("a GIF picture", CONVERT),
        None if starts(b"PF\n") || starts(b"Pf\n") => ("a PFM image", LINEAR),
        None if starts(b"II") || starts(b"MM") => ("a TIFF or camera raw file", DEVELOP),
        None => return None,
    };
    Some(OtherFormat { name, way_out })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_that_are_not_read_are_named_with_a_way_out() {
        let dir = tempfile::tempdir().expect("temp");
        let path = dir.path().join("photo.jpg");
        let told = |bytes: &[u8]| {
            std::fs::write(&path, bytes).expect("file");
            sniff(&path).expect_err("refused").to_string()
        };
        for (bytes, name) in [
            (&b"\0\0\0\x18ftypheic\0\0\0\0"[..], "HEIC"),
            (b"\0\0\0\x20ftypavif\0\0\0\0", "AVIF"),
            (b"RIFF\x10\0\0\0WEBPVP8 ", "WebP"),
            (b"\xff\x0a\xfa\x1f", "JPEG XL"),
            (b"\0\0\0\x0cJXL \r\n\x87\n", "JPEG XL"),
            (b"\0\0\0\x0cjP  \r\n\x87\n", "JPEG 2000"),
            (b"BM\x36\0", "BMP"),
            (b"PF\n2 2\n-1.0\n", "PFM"),
        ] {
            let said = told(bytes);
            assert!(said.contains(name) && said.contains("as by `"), "{said}");
        }
        assert!(told(b"hello").contains("something else"));
        assert!(told(b"").contains("empty"));
    }
}
