//! Round trips, and files that are damaged, hostile or not what they claim to be.

use super::*;
use crate::core::image::{Plane, RgbPlane};
use glam::{Vec2, Vec3};
use std::path::PathBuf;

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("temporary folder")
}

/// Colours that exercise sign, range and precision.
fn picture(width: usize, height: usize) -> RgbPlane {
    let value = |i: usize| {
        Vec3::new(
            i as f32 * 0.37 + 1e-3,
            (i as f32 * 1.7).sin(),
            60000.0 / (1.0 + i as f32),
        )
    };
    Plane {
        width,
        height,
        data: (0..width * height).map(value).collect(),
    }
}

/// Names of everything in a folder.
fn names(dir: &Path) -> Vec<String> {
    let mut all: Vec<String> = std::fs::read_dir(dir)
        .expect("folder")
        .map(|e| e.expect("entry").file_name().to_string_lossy().into_owned())
        .collect();
    all.sort();
    all
}

/// The message of an input error; anything else fails the test.
fn refused<T>(result: Result<T>) -> String {
    let error = result.err().expect("must be refused");
    assert_eq!(error.exit_code(), 2, "{error}");
    error.to_string()
}

#[test]
fn half_and_float_round_trips_keep_every_bit_they_can() {
    let (dir, image) = (folder(), picture(37, 21));
    let (half, float) = (dir.path().join("half.exr"), dir.path().join("float.exr"));
    assert_eq!(write_rgb_half(&half, &image).expect("written"), 0);
    write_rgb_float(&float, &image).expect("written");
    assert_eq!(read_rgb(&float).expect("read"), image);
    let rounded = image.map(|v| v.map(|x| half::f16::from_f32(x).to_f32()));
    assert_eq!(read_rgb(&half).expect("read"), rounded);
    assert_eq!(
        names(dir.path()),
        ["float.exr", "half.exr"],
        "nothing else is left behind"
    );
    let info = image_info(&half).expect("info");
    assert_eq!(
        (info.width, info.height, info.channels, info.format),
        (37, 21, 3, ImageFormat::Exr)
    );
    assert_eq!(info.sample, crate::ffi::oiio::Sample::Half);
}

#[test]
fn one_and_two_channels_round_trip() {
    let dir = folder();
    let path = dir.path().join("a.exr");
    let plane = Plane {
        width: 5,
        height: 4,
        data: (0..20).map(|i| i as f32 * 0.125).collect(),
    };
    write_plane_half(&path, &plane).expect("written");
    assert_eq!(read_plane(&path).expect("read"), plane);
    assert_eq!(
        read_rgb(&path).expect("read"),
        plane.map(|&v| Vec3::splat(v)),
        "grey serves as all three"
    );
    write_plane_float(&path, &plane).expect("replaced");
    assert_eq!(read_plane(&path).expect("read"), plane);
    let two = plane.map(|&v| Vec2::new(v, 1e4));
    write_two_channels_half(&path, &two).expect("written");
    assert_eq!(read_two_channels(&path).expect("read"), two);
    write_two_channels_float(&path, &two).expect("written");
    assert_eq!(read_two_channels(&path).expect("read"), two);
    assert!(
        refused(read_two_channels({
            write_plane_half(&path, &plane).expect("written");
            &path
        }))
        .contains("one channel")
    );
}

#[test]
fn writing_twice_gives_the_same_bytes() {
    let (dir, image) = (folder(), picture(64, 64));
    let (a, b) = (dir.path().join("a.exr"), dir.path().join("b.exr"));
    write_rgb_half(&a, &image).expect("written");
    write_rgb_half(&b, &image).expect("written");
    assert!(std::fs::read(a).expect("a") == std::fs::read(b).expect("b"));
}

#[test]
fn half_precision_clamps_and_counts() {
    let dir = folder();
    let path = dir.path().join("bright.exr");
    let plane = Plane {
        width: 4,
        height: 1,
        data: vec![65504.0, 65505.0, -1e9, 1.0],
    };
    assert_eq!(write_plane_half(&path, &plane).expect("written"), 2);
    assert_eq!(
        read_plane(&path).expect("read").data,
        [65504.0, 65504.0, -65504.0, 1.0]
    );
}

#[test]
fn values_that_are_not_finite_are_never_written() {
    let dir = folder();
    let path = dir.path().join("nan.exr");
    let mut image = picture(8, 4);
    write_rgb_half(&path, &image).expect("written");
    let before = std::fs::read(&path).expect("bytes");
    image.data[19].y = f32::NAN;
    image.data[30].x = f32::INFINITY;
    for result in [
        write_rgb_half(&path, &image).map(|_| ()),
        write_rgb_float(&path, &image),
    ] {
        let error = result.expect_err("refused");
        assert_eq!(error.exit_code(), 1);
        let message = error.to_string();
        assert!(
            message.contains("2 of 96") && message.contains("channel G at column 3, row 2"),
            "{message}"
        );
    }
    assert!(
        std::fs::read(&path).expect("bytes") == before,
        "the older file must survive"
    );
    assert_eq!(names(dir.path()), ["nan.exr"]);
}

#[test]
fn reading_returns_nan_as_stored() {
    let dir = folder();
    let path = dir.path().join("nan.exr");
    let bits = [f32::NAN, f32::INFINITY, 1.0];
    crate::ffi::oiio::write(
        &path,
        (3, 1),
        &[c"Y"],
        crate::ffi::oiio::Samples::Float(&bits),
        "",
    )
    .expect("written");
    let read = read_plane(&path).expect("read");
    assert!(read.data[0].is_nan() && read.data[1] == f32::INFINITY && read.data[2] == 1.0);
}

#[test]
fn channels_are_picked_by_name() {
    let dir = folder();
    let path = dir.path().join("layers.exr");
    let write = |names: &[&std::ffi::CStr]| {
        let values: Vec<f32> = (0..names.len()).map(|c| c as f32).collect();
        crate::ffi::oiio::write(
            &path,
            (1, 1),
            names,
            crate::ffi::oiio::Samples::Float(&values),
            "",
        )
        .expect("written");
        read_photograph(&path, None).map(|p| p.pixels.data[0])
    };
    assert_eq!(
        write(&[c"R", c"G", c"B", c"A"]).expect("rgba"),
        Vec3::new(0.0, 1.0, 2.0)
    );
    assert_eq!(
        write(&[c"Z", c"B", c"G", c"R"]).expect("shuffled"),
        Vec3::new(3.0, 2.0, 1.0)
    );
    assert_eq!(
        write(&[c"depth.Z", c"combined.R", c"combined.G", c"combined.B"]).expect("layer"),
        Vec3::new(1.0, 2.0, 3.0)
    );
    assert_eq!(
        write(&[c"Y", c"A"]).expect("grey and alpha"),
        Vec3::splat(0.0)
    );
    let message = refused(write(&[c"a.R", c"a.G", c"a.B", c"b.R", c"b.G", c"b.B"]));
    assert!(
        message.contains("a.R") && message.contains("one layer"),
        "{message}"
    );
}

#[test]
fn every_truncation_of_an_exr_is_refused() {
    let dir = folder();
    let (whole, cut) = (dir.path().join("whole.exr"), dir.path().join("cut.exr"));
    write_rgb_half(&whole, &picture(200, 150)).expect("written");
    let bytes = std::fs::read(&whole).expect("bytes");
    let ends = (0..400).step_by(13).chain([
        bytes.len() / 3,
        bytes.len() / 2,
        bytes.len() * 9 / 10,
        bytes.len() - 1,
    ]);
    for n in ends {
        std::fs::write(&cut, &bytes[..n]).expect("cut");
        let message = refused(read_rgb(&cut));
        assert!(message.contains("cut.exr"), "{n} bytes: {message}");
    }
}

#[test]
fn huge_sizes_in_headers_are_refused_before_anything_is_allocated() {
    let dir = folder();
    let path = dir.path().join("huge.exr");
    write_rgb_half(&path, &picture(16, 16)).expect("written");
    let good = std::fs::read(&path).expect("bytes");
    let at = good
        .windows(21)
        .position(|w| w == b"dataWindow\0box2i\0\x10\0\0\0")
        .expect("attribute")
        + 21;
    for corner in [i32::MAX, 1 << 20, -1, i32::MIN] {
        let mut bytes = good.clone();
        bytes[at + 8..at + 12].copy_from_slice(&corner.to_le_bytes());
        bytes[at + 12..at + 16].copy_from_slice(&corner.to_le_bytes());
        std::fs::write(&path, bytes).expect("hostile");
        let message = refused(read_rgb(&path));
        assert!(
            message.contains("its header states") && message.contains("at most"),
            "{message}"
        );
    }
    let hdr = dir.path().join("huge.hdr");
    for size in [
        "-Y 2000000000 +X 2000000000",
        "-Y 0 +X 10",
        "-Y 100000 +X 100000",
        "nonsense",
    ] {
        std::fs::write(
            &hdr,
            format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n{size}\nabcd"),
        )
        .expect("hostile");
        refused(read_rgb(&hdr));
    }
    let png = dir.path().join("huge.png");
    write_png16(&png, &Plane::filled(4, 4, 7u16)).expect("written");
    let mut bytes = std::fs::read(&png).expect("bytes");
    bytes[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
    let crc = crc32(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&crc.to_be_bytes());
    std::fs::write(&png, bytes).expect("hostile");
    let message = refused(read_labels(&png));
    assert!(message.contains("2147483647"), "{message}");
}

/// The checksum of PNG chunks (ISO 3309), bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &b| {
        (0..8).fold(crc ^ u32::from(b), |c, _| {
            if c & 1 == 1 {
                c >> 1 ^ 0xedb8_8320
            } else {
                c >> 1
            }
        })
    })
}

#[test]
fn flipped_bytes_never_panic() {
    let dir = folder();
    let path = dir.path().join("flip.exr");
    write_rgb_half(&path, &picture(40, 30)).expect("written");
    let good = std::fs::read(&path).expect("bytes");
    for i in (0..good.len()).step_by(1 + good.len() / 150) {
        let mut bytes = good.clone();
        bytes[i] ^= 0xff;
        std::fs::write(&path, &bytes).expect("damaged");
        // A flipped pixel may go unnoticed; whatever else is an input error.
        if let Err(e) = read_rgb(&path) {
            assert_eq!(e.exit_code(), 2, "byte {i}: {e}");
        }
    }
}

#[test]
fn files_that_are_not_images_say_what_they_are() {
    let dir = folder();
    let path = dir.path().join("x.exr");
    assert!(refused(read_rgb(&path)).contains("no such file"));
    let cases: [(&[u8], &str); 4] = [
        (b"", "empty"),
        (
            b"version https://git-lfs.github.com/spec/v1\n",
            "git lfs pull",
        ),
        (b"II*\0junk", "TIFF"),
        (b"\x89PNG\r\n\x1a\n", "--ldr"),
    ];
    for (bytes, expected) in cases {
        std::fs::write(&path, bytes).expect("file");
        let message = refused(read_rgb(&path));
        assert!(message.contains(expected), "{message}");
    }
    refused(read_rgb(dir.path()));
}

#[test]
fn radiance_files_are_read_and_cut_ones_refused() {
    let dir = folder();
    let path: PathBuf = dir.path().join("flat.hdr");
    // Old uncompressed pixels: mantissas times 2^(exponent − 136).
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n".to_vec();
    let header = bytes.len();
    for i in 0..6u8 {
        bytes.extend([64 + i, 32, 200, 130]);
    }
    std::fs::write(&path, &bytes).expect("file");
    let image = read_rgb(&path).expect("read");
    assert_eq!((image.width, image.height), (3, 2));
    let unit = 2f32.powi(130 - 136);
    for (i, p) in image.data.iter().enumerate() {
        // Some decoders place the value in the middle of its step.
        let expected = Vec3::new(64.0 + i as f32, 32.0, 200.0) * unit;
        assert!(
            (*p - expected).abs().max_element() <= 0.51 * unit,
            "{p} is not {expected}"
        );
    }
    std::fs::write(&path, &bytes[..header + 9]).expect("cut");
    refused(read_rgb(&path));
}

#[test]
fn labels_of_every_depth_come_back_as_ids() {
    let dir = folder();
    let path = dir.path().join("labels.png");
    let ids = Plane {
        width: 7,
        height: 5,
        data: (0..35).map(|i| i * 1873).collect::<Vec<u16>>(),
    };
    write_png16(&path, &ids).expect("written");
    assert_eq!(read_labels(&path).expect("read"), ids);
    write_png8(&path, &ids.map(|&v| v as u8)).expect("written");
    assert_eq!(read_labels(&path).expect("read"), ids.map(|&v| v & 255));
    for (bits, depth) in [
        (1, png::BitDepth::One),
        (2, png::BitDepth::Two),
        (4, png::BitDepth::Four),
    ] {
        let line = (7 * bits as usize).div_ceil(8);
        let mut packed = vec![0u8; line * 5];
        let value = |i: usize| (i * 5 + i / 7) as u8 & ((1u16 << bits) - 1) as u8;
        for i in 0..35 {
            let (x, y) = (i % 7, i / 7);
            packed[y * line + x * bits as usize / 8] |= value(i) << (8 - bits - x as u8 * bits % 8);
        }
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, 7, 5);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(depth);
        encoder.set_palette(vec![9; 3 << bits]);
        encoder
            .write_header()
            .expect("header")
            .write_image_data(&packed)
            .expect("data");
        std::fs::write(&path, file).expect("file");
        let read = read_labels(&path).expect("palette");
        assert_eq!(
            read.data,
            (0..35).map(|i| value(i).into()).collect::<Vec<u16>>(),
            "{bits} bits"
        );
    }
    write_png_rgb8(&path, 1, 1, &[1, 2, 3]).expect("written");
    assert!(refused(read_labels(&path)).contains("greyscale"));
}

#[test]
fn cut_pngs_are_refused() {
    let dir = folder();
    let path = dir.path().join("labels.png");
    write_png16(
        &path,
        &Plane {
            width: 50,
            height: 50,
            data: (0..2500).map(|i| i * 7).collect(),
        },
    )
    .expect("written");
    let bytes = std::fs::read(&path).expect("bytes");
    for n in [0, 7, 20, 40, bytes.len() / 2, bytes.len() - 20] {
        std::fs::write(&path, &bytes[..n]).expect("cut");
        refused(read_labels(&path));
    }
}

#[test]
fn display_referred_pictures_are_linearised() {
    let dir = folder();
    let path = dir.path().join("photo.png");
    write_png_rgb8(&path, 2, 1, &[0, 128, 255, 64, 64, 64]).expect("written");
    let image = read_ldr(&path).expect("read");
    let expected = crate::core::math::linear_from_srgb(128.0 / 255.0);
    assert_eq!(image.data[0], Vec3::new(0.0, expected, 1.0));
    write_png16(
        &path,
        &Plane {
            width: 1,
            height: 1,
            data: vec![32768],
        },
    )
    .expect("written");
    assert_eq!(
        read_ldr(&path).expect("read").data[0],
        Vec3::splat(crate::core::math::linear_from_srgb(32768.0 / 65535.0))
    );
    let exr = dir.path().join("a.exr");
    write_rgb_half(&exr, &picture(2, 2)).expect("written");
    assert!(refused(read_ldr(&exr)).contains("--ldr"));
}

/// A 3 × 2 greyscale JPEG of value 128 throughout (made with Pillow: `Image.new('L', (3, 2), 128)`,
/// quality 95).
const GREY_JPEG: &str = "ffd8ffe000104a46494600010100000100010000ffdb00430002010101010102010101020202020204030202020205040403040605060606\
     05060606070908060709070606080b08090a0a0a0a0a06080b0c0b0a0c090a0a0affc0000b080002000301011100ffc4001f000001050101\
     0101010100000000000000000102030405060708090a0bffc400b5100002010303020403050504040000017d010203000411051221314106\
     13516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728292a3435363738393a434445464748494a535455\
     565758595a636465666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9ba\
     c2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9faffda0008010100003f002bffd9";

#[test]
fn jpeg_photographs_are_linearised() {
    let dir = folder();
    let path = dir.path().join("photo.jpg");
    let byte = |i: usize| u8::from_str_radix(&GREY_JPEG[i..i + 2], 16).expect("hexadecimal");
    let bytes: Vec<u8> = (0..GREY_JPEG.len()).step_by(2).map(byte).collect();
    std::fs::write(&path, &bytes).expect("file");
    let info = image_info(&path).expect("info");
    assert_eq!(
        (info.width, info.height, info.channels, info.format),
        (3, 2, 1, ImageFormat::Jpeg)
    );
    let image = read_ldr(&path).expect("read");
    let expected = Vec3::splat(crate::core::math::linear_from_srgb(128.0 / 255.0));
    assert!(
        image.data.len() == 6
            && image
                .data
                .iter()
                .all(|p| (*p - expected).abs().max_element() < 1e-6),
        "{image:?}"
    );
    assert!(refused(read_rgb(&path)).contains("--ldr"));
    for n in [4, 30, 300] {
        std::fs::write(&path, &bytes[..n]).expect("cut");
        refused(read_ldr(&path));
    }
}

#[test]
fn a_file_appears_whole_or_not_at_all() {
    let dir = folder();
    let path = dir.path().join("report.json");
    atomic_write(&path, b"one").expect("written");
    atomic_write(&path, b"two").expect("replaced");
    assert_eq!(std::fs::read(&path).expect("read"), b"two");
    let aside = Aside::new(&path).expect("aside");
    std::fs::write(aside.path(), b"half of thr").expect("written");
    drop(aside);
    assert_eq!(std::fs::read(&path).expect("read"), b"two");
    assert_eq!(names(dir.path()), ["report.json"]);
    let error =
        atomic_write(dir.path().join("absent/report.json"), b"x").expect_err("no such folder");
    assert_eq!(error.exit_code(), 1);
    assert!(
        atomic_write(dir.path(), b"x").is_err(),
        "a folder is in the way"
    );
}

#[test]
fn the_library_says_its_version() {
    let version = version();
    assert!(
        version.starts_with("2.") || version.starts_with("3."),
        "{version}"
    );
}

#[test]
fn greyscale_saved_as_rgb_is_read_as_ids_and_colours_are_refused() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("ids.png");
    write_png_rgb8(&path, 2, 1, &[3, 3, 3, 250, 250, 250]).expect("written");
    assert_eq!(read_labels(&path).expect("ids").data, [3, 250]);
    write_png_rgb8(&path, 2, 1, &[3, 3, 3, 250, 250, 249]).expect("written");
    let refused = read_labels(&path).expect_err("colours are no ids");
    assert!(refused.to_string().contains("one channel"), "{refused}");
}

/// The sheet of tests/files/README.md, in every packing: positions, normals, texture coordinates.
#[test]
fn packed_gltf_reads_as_what_was_packed() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/files/gltf");
    // metres and texture coordinates within a step of the quantisation of 4 m or [0, 3]
    let files = [
        ("quantized", 1.0),
        ("meshopt-high", 1.0),
        ("draco-edgebreaker", 1.0),
        ("draco-sequential", 1.0),
        ("gltfpack-c", 3.0),
        ("gltfpack-cc-vpf-vtf", 3.0),
    ];
    for (name, repeats) in files {
        let mesh = read_mesh(&folder.join(format!("{name}.glb"))).expect(name);
        assert_eq!(
            (mesh.positions.len(), mesh.triangles.len()),
            (25, 32),
            "{name}"
        );
        for (i, p) in mesh.positions.iter().enumerate() {
            let [x, y, z] = (*p - glam::DVec3::new(1.0, 2.0, 3.0)).to_array();
            assert!((y - 0.25 * x * x).abs() < 2e-3, "{name}: {p}");
            let upright = glam::DVec3::new(-0.5 * x, 1.0, 0.0).normalize().as_vec3();
            assert!(
                mesh.normals[i].dot(upright) > 0.999,
                "{name}: {}",
                mesh.normals[i]
            );
            let uv = Vec2::new(x as f32 + 2.0, z as f32 + 2.0) * (repeats / 4.0);
            assert!(
                (mesh.uvs[i] - uv).length() < 3e-3,
                "{name}: {} {uv}",
                mesh.uvs[i]
            );
        }
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            let area = (b - a).cross(c - a);
            assert!((area.y - 1.0).abs() < 5e-3, "{name}: {area}");
        }
    }
}

/// The copies of tests/files/README.md: every sheet where its turn and its place put it.
#[test]
fn copies_written_by_other_programs_are_where_they_belong() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/files/gltf");
    for name in ["instanced", "gltfpack-mi-c"] {
        let mesh = read_mesh(&folder.join(format!("{name}.glb"))).expect(name);
        assert_eq!(
            (mesh.positions.len(), mesh.triangles.len()),
            (6 * 25, 6 * 32),
            "{name}"
        );
        let mut found = [0; 6];
        for p in &mesh.positions {
            let k = (p.x / 10.0).round() as usize;
            found[k] += 1;
            let back = glam::DQuat::from_rotation_y(-0.5 * k as f64)
                * (*p - glam::DVec3::new(10.0 * k as f64, k as f64, 0.0));
            let [x, y, _] = (back / (1.0 + 0.125 * k as f64)).to_array();
            assert!((y - 0.25 * x * x).abs() < 4e-3, "{name}: copy {k}, {p}");
        }
        assert_eq!(found, [25; 6], "{name}");
    }
}

#[test]
fn every_byte_of_packed_gltf_may_be_damaged() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/files/gltf");
    for name in ["meshopt-high", "draco-edgebreaker", "draco-sequential"] {
        let path = folder.join(format!("{name}.glb"));
        let whole = std::fs::read(&path).expect("file");
        for at in 0..whole.len() {
            for flip in [0x01, 0x80] {
                let mut damaged = whole.clone();
                damaged[at] ^= flip;
                let _ = gltf::mesh_from_gltf(&damaged, &path);
            }
        }
    }
}
