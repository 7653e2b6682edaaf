//! Photographs for displays: what PNG and JPEG say of their values, and files that lost some.

use super::*;
use crate::core::image::Plane;
use crate::core::math::colour::{ColourSpace, DISPLAY_P3};
use crate::core::math::linear_from_srgb;
use glam::Vec3;
use std::path::PathBuf;

/// A PNG of two pixels a row, in the given form.
fn png_file(
    path: &Path,
    color: png::ColorType,
    bytes: &[u8],
    set: impl FnOnce(&mut png::Info<'static>),
) {
    let rows = bytes.len() / (2 * color.samples());
    let mut info = png::Info::with_size(2, rows as u32);
    info.color_type = color;
    info.bit_depth = png::BitDepth::Eight;
    set(&mut info);
    let mut file = Vec::new();
    let encoder = png::Encoder::with_info(&mut file, info).expect("a header");
    let mut writer = encoder.write_header().expect("written");
    writer.write_image_data(bytes).expect("pixels");
    writer.finish().expect("the end");
    std::fs::write(path, file).expect("file");
}

fn temporary(name: &str) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join(name);
    (dir, path)
}

fn refused<T>(result: Result<T>) -> String {
    let error = result.err().expect("must be refused");
    assert_eq!(error.exit_code(), 2, "{error}");
    error.to_string()
}

#[test]
fn transparency_of_png_is_kept_and_colours_are_not_weighted_with_it() {
    let (_dir, path) = temporary("a.png");
    let rgba = [200, 200, 200, 255, 200, 200, 200, 0];
    png_file(&path, png::ColorType::Rgba, &rgba, |_| {});
    let read = read_display_photograph(&path, None).expect("read");
    assert_eq!(read.alpha.expect("alpha").data, [1.0, 0.0]);
    assert_eq!(read.pixels.data[0], read.pixels.data[1]);
    assert!(image_account(&path, None).expect("account").has_alpha);
    // the colour that stands for nothing, in 16 bits as the chunk has it
    let rgb = [1, 2, 3, 50, 60, 70];
    png_file(&path, png::ColorType::Rgb, &rgb, |i| {
        i.trns = Some(vec![0, 1, 0, 2, 0, 3].into());
    });
    let read = read_display_photograph(&path, None).expect("read");
    assert_eq!(read.alpha.expect("alpha").data, [0.0, 1.0]);
    assert!(image_account(&path, None).expect("account").has_alpha);
    // nobody filled it
    png_file(&path, png::ColorType::GrayscaleAlpha, &[9, 0, 8, 0], |_| {});
    assert!(
        read_display_photograph(&path, None)
            .expect("read")
            .alpha
            .is_none()
    );
}

#[test]
fn chunks_of_png_say_how_light_is_encoded() {
    let (_dir, path) = temporary("a.png");
    let bytes = [128, 128, 128, 255, 0, 0];
    let first = |space| {
        let read = read_display_photograph(&path, space).expect("read");
        read.pixels.data[0].x
    };
    let (raw, srgb) = (128.0 / 255.0, linear_from_srgb(128.0 / 255.0));
    png_file(&path, png::ColorType::Rgb, &bytes, |i| {
        i.source_gamma = Some(png::ScaledFloat::new(1.0));
    });
    assert_eq!(first(None), raw, "gAMA 1");
    assert_eq!(
        first(Some(ColourSpace::Srgb)),
        srgb,
        "the scene goes before"
    );
    let account = image_account(&path, None).expect("account");
    assert_eq!(account.transfer, "linear");
    assert!(account.converted.is_some_and(|c| c.contains("gAMA")));
    png_file(&path, png::ColorType::Rgb, &bytes, |i| {
        i.source_gamma = Some(png::ScaledFloat::new(0.45455));
    });
    assert_eq!(first(None), srgb, "gAMA 1/2.2");
    assert_eq!(image_account(&path, None).expect("account").converted, None);
    png_file(&path, png::ColorType::Rgb, &bytes, |_| {});
    assert_eq!(first(Some(ColourSpace::Rec709)), raw, "the scene alone");
}

#[test]
fn profiles_of_png_and_jpeg_bring_their_primaries() {
    let red = DISPLAY_P3.rec709_from_rgb(None).as_mat3() * Vec3::X;
    assert!(
        red.x > 1.2 && red.y < 0.0,
        "Rec. 709 has no such red: {red}"
    );
    let (_dir, path) = temporary("a.png");
    let bytes = [255, 0, 0, 255, 255, 255];
    png_file(&path, png::ColorType::Rgb, &bytes, |i| {
        i.icc_profile = Some(icc::tests::display_p3().into());
    });
    let read = read_display_photograph(&path, None).expect("read").pixels;
    assert!((read.data[0] - red).length() < 2e-3, "{}", read.data[0]);
    assert!((read.data[1] - Vec3::ONE).length() < 1e-5, "white");
    let within = read_ldr(&path).expect("read").data[0];
    assert!((within - Vec3::X).length() < 1e-6, "{within}");
    let (_dir, path) = temporary("a.jpg");
    let mut file = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut file, 95);
    encoder
        .add_icc_profile(&icc::tests::display_p3())
        .expect("a profile");
    let flat = [255, 0, 0].repeat(64);
    encoder
        .encode(&flat, 8, 8, jpeg_encoder::ColorType::Rgb)
        .expect("encoded");
    std::fs::write(&path, file).expect("file");
    let read = read_display_photograph(&path, None).expect("read").pixels;
    assert!((read.data[0] - red).length() < 0.03, "{}", read.data[0]);
    let account = image_account(&path, None).expect("account");
    assert!(
        account.primaries == "Display P3" && account.converted.is_some(),
        "{account:?}"
    );
    let plain = read_display_photograph(&path, Some(ColourSpace::Srgb)).expect("read");
    assert!((plain.pixels.data[0] - Vec3::X).length() < 0.03);
}

/// Noise of 64 × 64 pixels, whose JPEG has data in every block.
fn noise(progressive: bool) -> Vec<u8> {
    let mut state = 1u32;
    let bytes: Vec<u8> = (0..3 * 64 * 64)
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        })
        .collect();
    let mut file = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut file, 90);
    encoder.set_progressive(progressive);
    encoder
        .encode(&bytes, 64, 64, jpeg_encoder::ColorType::Rgb)
        .expect("encoded");
    file
}

#[test]
fn jpegs_that_lost_data_are_refused_and_those_that_lost_their_last_marker_are_not() {
    let (_dir, path) = temporary("a.jpg");
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).expect("file");
        read_ldr(&path)
    };
    for progressive in [false, true] {
        let whole = noise(progressive);
        let n = whole.len();
        let pixels = read(&whole).expect("whole");
        let mut trailing = whole.clone();
        trailing.extend([0; 500]);
        assert_eq!(read(&trailing).expect("bytes behind it"), pixels);
        for kept in [n * 3 / 10, n * 6 / 10, n - 100] {
            assert!(
                refused(read(&whole[..kept])).contains("cut short"),
                "{kept}"
            );
            let mut zeroed = whole.clone();
            zeroed[kept..].fill(0);
            assert!(refused(read(&zeroed)).contains("cut short"), "{kept}");
        }
        let mut damaged = whole.clone();
        damaged[n / 2..n / 2 + 40].fill(0);
        assert!(refused(read(&damaged)).contains("cut short"));
        assert!(decode_rgba8(&damaged).is_err(), "as a picture in memory");
    }
    let whole = noise(false);
    let pixels = read(&whole).expect("whole");
    let without = read(&whole[..whole.len() - 2]).expect("all pixels are there");
    assert_eq!(without, pixels);
}

#[test]
fn masks_are_judged_by_the_colours_of_their_palette() {
    let (_dir, path) = temporary("mask.png");
    let palette = |i: &mut png::Info<'static>, p: &[u8], t: Option<Vec<u8>>| {
        i.palette = Some(p.to_vec().into());
        i.trns = t.map(Into::into);
    };
    let kept = || read_mask(&path).expect("mask").data;
    png_file(&path, png::ColorType::Indexed, &[0, 1], |i| {
        palette(i, &[255, 255, 255, 0, 0, 0], None);
    });
    assert_eq!(kept(), [true, false], "white first");
    png_file(&path, png::ColorType::Indexed, &[0, 1], |i| {
        palette(i, &[255; 6], Some(vec![0, 255]));
    });
    assert_eq!(kept(), [false, true], "transparent first");
    write_png8(
        &path,
        &Plane {
            width: 2,
            height: 1,
            data: vec![0, 1],
        },
    )
    .expect("written");
    assert_eq!(kept(), [false, true], "greyscale");
}

#[test]
fn labels_of_a_grey_palette_are_its_greys_and_of_a_coloured_one_its_indices() {
    let (_dir, path) = temporary("labels.png");
    let ids = |palette: &[u8]| {
        png_file(&path, png::ColorType::Indexed, &[0, 2, 1, 0], |i| {
            i.palette = Some(palette.to_vec().into());
        });
        read_labels(&path).expect("labels").data
    };
    assert_eq!(ids(&[7, 7, 7, 3, 3, 3, 21, 21, 21]), [7, 21, 3, 7]);
    assert_eq!(ids(&[0, 0, 0, 128, 0, 0, 0, 128, 0]), [0, 2, 1, 0]);
    // nothing told apart: no greyscale image has such a palette
    assert_eq!(ids(&[9; 9]), [0, 2, 1, 0]);
}
