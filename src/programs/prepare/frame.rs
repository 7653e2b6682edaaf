//! One frame of the scene folder: photograph, labels, mask and depth, resampled where the lens is
//! none the solver models. Called by `write`.

use super::capture::{Depth, Mask, Shot};
use super::folder::{SceneFolder, extension};
use super::labels::LabelSource;
use super::lens::Lens;
use super::lens::Optics;
use crate::core::formats::{self, Photograph, srgb8_from_linear};
use crate::core::image::Plane;
use crate::core::math::colour::ColourSpace;
use crate::error::{Error, Result};
use glam::DVec2;
use serde_json::{Map, Value, json};
use std::path::Path;

/// Writes frames into a folder under construction.
pub struct FrameWriter<'a> {
    /// The folder.
    pub folder: &'a SceneFolder,
    /// Where labels come from that no file holds.
    pub labels: Option<&'a LabelSource>,
    /// Links to photographs instead of copies.
    pub link: bool,
}

impl FrameWriter<'_> {
    /// Writes a frame's files; its entry of `transforms.json`.
    ///
    /// # Errors
    /// A file that is missing, damaged or of another size than the capture says.
    pub fn write(&self, shot: &Shot) -> Result<Value> {
        let info = formats::image_info(&shot.image)?;
        let size = [info.width, info.height];
        if let Some([w, h]) = shot.size.filter(|s| *s != size) {
            return Err(Error::input(
                &shot.image,
                format!(
                    "is {}x{}, the capture's camera file says {w}x{h}; take the images the cameras were solved for",
                    size[0], size[1]
                ),
            ));
        }
        let mut entry = Map::new();
        let (optics, size) = match &shot.optics {
            Optics::Distorted(lens) => {
                self.resampled(shot, lens, info.format.is_linear(), &mut entry)?
            }
            optics => {
                self.as_it_is(shot, size, &mut entry)?;
                (optics.clone(), size)
            }
        };
        if let (None, Some(source)) = (&shot.labels, self.labels) {
            let name = format!("labels/{}.png", shot.stem);
            let ids = source.render(&shot.world_from_camera, &optics, size);
            formats::write_png16(self.folder.at(&name), &ids)?;
            entry.insert("label_path".into(), json!(name));
        }
        if let Some(ev) = shot.exposure_ev {
            entry.insert("exposure_ev".into(), json!(ev));
        }
        optics_keys(&optics, size, &mut entry);
        let rows = shot.world_from_camera.transpose().to_cols_array_2d();
        entry.insert("transform_matrix".into(), json!(rows));
        Ok(Value::Object(entry))
    }

    fn as_it_is(
        &self,
        shot: &Shot,
        size: [usize; 2],
        entry: &mut Map<String, Value>,
    ) -> Result<()> {
        let take = |path: &Path, folder: &str, key: &str, entry: &mut Map<String, Value>| {
            let name = format!("{folder}/{}.{}", shot.stem, extension(path));
            self.folder
                .take(path, &name, self.link && key == "file_path")?;
            entry.insert(key.into(), json!(name));
            Ok(())
        };
        take(&shot.image, "images", "file_path", entry)?;
        if let Some(space) = &shot.color_space {
            entry.insert("color_space".into(), json!(space));
        }
        if let Some(path) = &shot.labels {
            take(path, "labels", "label_path", entry)?;
        }
        match &shot.mask {
            Some(Mask::File(path)) => take(path, "masks", "mask_path", entry)?,
            Some(Mask::Alpha(path)) => {
                if let Some(kept) = alpha_mask(path)? {
                    let name = format!("masks/{}.png", shot.stem);
                    let mask = kept.map(|k| if *k { u8::MAX } else { 0 });
                    formats::write_png8(self.folder.at(&name), &mask)?;
                    entry.insert("mask_path".into(), json!(name));
                }
            }
            None => {}
        }
        if let Some(depth) = &shot.depth {
            if extension(&depth.path) == "exr" && !depth.along_axis {
                return take(&depth.path, "depth", "depth_file_path", entry);
            }
            let name = format!("depth/{}.exr", shot.stem);
            let metres = metres(depth, &shot.optics, size)?;
            formats::write_plane_float(self.folder.at(&name), &metres)?;
            entry.insert("depth_file_path".into(), json!(name));
        }
        Ok(())
    }

    /// Photograph, mask and labels without distortion; their projection and size.
    fn resampled(
        &self,
        shot: &Shot,
        lens: &Lens,
        linear: bool,
        entry: &mut Map<String, Value>,
    ) -> Result<(Optics, [usize; 2])> {
        let space = shot.color_space.as_deref().and_then(ColourSpace::named);
        let photograph = match linear {
            true => formats::read_photograph(&shot.image, space)?,
            false => formats::read_display_photograph(&shot.image, space)?,
        };
        if let Some(i) = photograph.pixels.data.iter().position(|p| !p.is_finite()) {
            let (x, y) = (i % photograph.pixels.width, i / photograph.pixels.width);
            return Err(Error::input(
                &shot.image,
                format!(
                    "pixel (column {x}, row {y}) is NaN or infinite, which undoing the lens would spread; mend the image"
                ),
            ));
        }
        let from = [photograph.pixels.width, photograph.pixels.height];
        let target = lens.target(from);
        let image = target.resample(lens, &photograph.pixels);
        let name = format!(
            "images/{}.{}",
            shot.stem,
            if linear { "exr" } else { "png" }
        );
        if linear {
            self.folder.write_radiance(&name, &image)?;
        } else {
            let rgb: Vec<u8> = image
                .data
                .iter()
                .flat_map(|v| v.to_array().map(srgb8_from_linear))
                .collect();
            formats::write_png_rgb8(self.folder.at(&name), image.width, image.height, &rgb)?;
        }
        entry.insert("file_path".into(), json!(name));
        let given = given_mask(shot, &photograph)?;
        let mask = target.mask(lens, from, given.as_ref());
        if mask.data.contains(&0) {
            let name = format!("masks/{}.png", shot.stem);
            formats::write_png8(self.folder.at(&name), &mask)?;
            entry.insert("mask_path".into(), json!(name));
        }
        if let Some(path) = &shot.labels {
            let ids = target.labels(lens, from, &formats::read_labels(path)?);
            let name = format!("labels/{}.png", shot.stem);
            formats::write_png16(self.folder.at(&name), &ids)?;
            entry.insert("label_path".into(), json!(name));
        }
        Ok((target.optics.clone(), target.size))
    }
}

/// The pixels that a photograph's mask keeps, or where it has none those that its alpha covers.
fn given_mask(shot: &Shot, photograph: &Photograph) -> Result<Option<Plane<bool>>> {
    match &shot.mask {
        Some(Mask::File(path)) => formats::read_mask(path).map(Some),
        Some(Mask::Alpha(path)) => alpha_mask(path),
        None => Ok(photograph.covered()),
    }
}

/// The pixels that the alpha of a PNG does not hide; `None` where it hides nothing.
fn alpha_mask(path: &Path) -> Result<Option<Plane<bool>>> {
    let alpha = formats::read_display_photograph(path, None)?.alpha;
    let kept = alpha.map(|alpha| alpha.map(|a| *a > 0.0));
    Ok(kept.filter(|kept| kept.data.contains(&false)))
}

/// Depth in metres along the ray.
pub(super) fn metres(depth: &Depth, optics: &Optics, size: [usize; 2]) -> Result<Plane<f32>> {
    let mut plane = match extension(&depth.path).as_str() {
        "exr" => formats::read_depth(&depth.path)?,
        _ => formats::read_labels(&depth.path)?
            .map(|&v| (f64::from(v) * depth.metres_per_step) as f32),
    };
    if let (true, Optics::Perspective(p)) = (depth.along_axis, optics) {
        let scale = DVec2::new(
            size[0] as f64 / plane.width as f64,
            size[1] as f64 / plane.height as f64,
        );
        for y in 0..plane.height {
            for x in 0..plane.width {
                let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5) * scale;
                let on_plane = (pixel - DVec2::from(p.centre)) / DVec2::from(p.focal);
                plane[(x, y)] *= on_plane.extend(1.0).length() as f32;
            }
        }
    }
    Ok(plane)
}

fn optics_keys(optics: &Optics, size: [usize; 2], entry: &mut Map<String, Value>) {
    entry.insert("w".into(), json!(size[0]));
    entry.insert("h".into(), json!(size[1]));
    let Optics::Perspective(p) = optics else {
        entry.insert("camera_model".into(), json!("EQUIRECTANGULAR"));
        return;
    };
    let plain = p.radial == [0.0; 2] && p.tangential == [0.0; 2];
    entry.insert(
        "camera_model".into(),
        json!(if plain { "PINHOLE" } else { "OPENCV" }),
    );
    let mut keys = vec![
        ("fl_x", p.focal[0]),
        ("fl_y", p.focal[1]),
        ("cx", p.centre[0]),
        ("cy", p.centre[1]),
    ];
    if !plain {
        keys.extend([
            ("k1", p.radial[0]),
            ("k2", p.radial[1]),
            ("p1", p.tangential[0]),
            ("p2", p.tangential[1]),
        ]);
    }
    for (key, value) in keys {
        entry.insert(key.into(), json!(value));
    }
}
