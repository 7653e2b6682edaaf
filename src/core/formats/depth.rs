//! Depth images of OpenEXR, as renderers and tools write them: alone, beside colours, in a layer or
//! a part of its own.

use super::exr_header::ExrPart;
use super::image_format::{ImageFormat, sniff};
use super::image_io::{exr_parts, open_part, read_channel};
use super::read_plane;
use crate::core::image::Plane;
use crate::error::{Error, Result};
use std::path::Path;

/// Reads the channel of depth: the one that is called so in any part or layer, else the only one, or
/// one of three that are alike.
///
/// # Errors
/// The file cannot be read or is damaged, or nothing tells which of its channels is depth.
pub fn read_depth(path: &Path) -> Result<Plane<f32>> {
    if sniff(path)? != ImageFormat::Exr {
        return read_plane(path);
    }
    let parts = exr_parts(path)?;
    let has_depth = |part: &ExrPart| part.channels.iter().any(|c| is_depth(&c.name));
    // a part may be named instead of its channels
    let by_name = parts.iter().position(has_depth).or_else(|| {
        let is_named = |p: &ExrPart| p.name.as_deref().is_some_and(is_depth);
        parts.iter().position(is_named)
    });
    let mut image = open_part(path, ImageFormat::Exr, by_name.unwrap_or(0))?;
    let names: Vec<String> = (0..image.size().2 as usize)
        .map(|c| image.channel_name(c))
        .collect();
    if let Some(c) = names.iter().position(|n| is_depth(n)) {
        return read_channel(path, &mut image, c);
    }
    let is_alpha =
        |n: &String| n.eq_ignore_ascii_case("a") || n.to_ascii_lowercase().ends_with(".a");
    let values: Vec<usize> = (0..names.len()).filter(|c| !is_alpha(&names[*c])).collect();
    let unknown = || {
        Error::input(
            path,
            format!(
                "channels {}: which of them is depth? Name it Z, or save it alone",
                names.join(", ")
            ),
        )
    };
    let (first, rest) = values.split_first().ok_or_else(unknown)?;
    let plane = read_channel(path, &mut image, *first)?;
    for other in rest {
        if read_channel(path, &mut image, *other)?.data != plane.data {
            return Err(unknown());
        }
    }
    Ok(plane)
}

/// Whether a channel (layer.channel) or part is called depth. "N.Z" and "P.Z" are components of
/// vectors.
fn is_depth(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    let mut components = name.rsplit('.');
    let last = components.next().unwrap_or_default();
    let alone = components.next().is_none();
    name.contains("depth") || alone && ["z", "distance"].contains(&last)
}

#[cfg(test)]
mod tests {
    use super::super::{write_plane_float, write_rgb_float};
    use super::*;
    use glam::Vec3;

    #[test]
    fn depth_is_known_by_its_name() {
        for name in ["Z", "z", "depth", "ViewLayer.Depth.Z", "depth.V", "Depth"] {
            assert!(is_depth(name), "{name}");
        }
        for name in ["R", "N.Z", "Position.Z", "ViewLayer.Combined.B", "A", "Y"] {
            assert!(!is_depth(name), "{name}");
        }
    }

    #[test]
    fn one_channel_or_three_alike_are_depth_and_colours_are_not() {
        let dir = tempfile::tempdir().expect("temp");
        let file = dir.path().join("d.exr");
        let metres = Plane::filled(3, 2, 1.5f32);
        write_plane_float(&file, &metres).expect("written");
        assert_eq!(read_depth(&file).expect("one"), metres);
        write_rgb_float(&file, &metres.map(|d| Vec3::splat(*d))).expect("written");
        assert_eq!(read_depth(&file).expect("alike"), metres);
        write_rgb_float(&file, &metres.map(|d| Vec3::new(*d, 0.5, 0.25))).expect("written");
        let refused = read_depth(&file).expect_err("colours").to_string();
        assert!(refused.contains("which of them is depth"), "{refused}");
    }
}
