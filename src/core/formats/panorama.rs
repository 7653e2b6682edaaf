//! Panoramas as light from outside: what `--environment` and lighting files name.

use super::image_format::{ImageFormat, sniff};
use super::photograph::read_photograph;
use crate::core::image::RgbPlane;
use crate::error::{Error, Result};
use glam::Vec3;
use std::path::Path;

/// Reads an equirectangular panorama of scene-linear radiance (width : height = 2 : 1) by the rules
/// of photographs: parts, layers and primaries of OpenEXR, exposure and XYZE of Radiance HDR.
/// Negative values, which resampling leaves, are 0.
///
/// # Errors
/// The file cannot be read, is display-referred, has another shape, or pixels that are not finite.
pub fn read_panorama(path: &Path) -> Result<RgbPlane> {
    if !matches!(sniff(path)?, ImageFormat::Exr | ImageFormat::Hdr) {
        return Err(Error::input(
            path,
            "a picture for screens, which ends at white, where light from outside is expected; give a panorama in OpenEXR or Radiance HDR",
        ));
    }
    let mut panorama = read_photograph(path, None)?.pixels;
    let (width, height) = (panorama.width, panorama.height);
    if width != 2 * height {
        return Err(Error::input(
            path,
            format!(
                "is {width}x{height}; expected an equirectangular panorama, twice as wide as high. Convert a cube or a mirror ball first"
            ),
        ));
    }
    if let Some(i) = panorama.data.iter().position(|p| !p.is_finite()) {
        return Err(Error::input(
            path,
            format!(
                "pixel (column {}, row {}) is NaN or infinite; expected finite radiance. Save it anew, or paint over the sun",
                i % width,
                i / width
            ),
        ));
    }
    panorama
        .data
        .iter_mut()
        .for_each(|p| *p = p.max(Vec3::ZERO));
    Ok(panorama)
}

#[cfg(test)]
mod tests {
    use super::super::write_rgb_float;
    use super::*;
    use crate::core::image::Plane;

    #[test]
    fn only_finite_light_of_the_right_shape_is_taken() {
        let dir = tempfile::tempdir().expect("temp");
        let file = dir.path().join("sky.exr");
        let sky = |width, height, value: f32| {
            write_rgb_float(&file, &Plane::filled(width, height, Vec3::splat(value)))
                .expect("written");
            read_panorama(&file)
        };
        assert_eq!(sky(8, 4, 2.5).expect("read").data, [Vec3::splat(2.5); 32]);
        assert_eq!(sky(8, 4, -0.5).expect("read").data, [Vec3::ZERO; 32]);
        let refused = |r: Result<RgbPlane>| r.expect_err("refused").to_string();
        assert!(refused(sky(8, 8, 1.0)).contains("twice as wide"));
        std::fs::write(&file, b"\x89PNG\r\n\x1a\n").expect("written");
        assert!(refused(read_panorama(&file)).contains("for screens"));
    }
}
