//! `unbake export`: a solution in the formats of other programs.

use super::{punctual_lights, write_mitsuba, write_usd};
use crate::core::geometry::{Camera, Projection};
use crate::error::{Error, Result};
use crate::render::NamedCamera;
use crate::solution::{AsideFolder, GlbOptions, Solution, scene_glb};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;

/// A format to export to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// glTF 2.0, binary.
    Glb,
    /// USD, text, with PNG textures.
    Usd,
    /// Mitsuba 3 scene.
    Mitsuba,
}

/// Options of `unbake export`.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
#[command(next_help_heading = "Export")]
pub struct ExportOptions {
    /// Formats to write, separated by commas.
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["glb", "usd", "mitsuba"])]
    pub format: Vec<Format>,
    /// Largest side of an embedded glTF texture, texels.
    #[arg(long, value_name = "TEXELS", default_value_t = Self::default().max_texture)]
    pub max_texture: usize,
    /// Add the lamps to the glTF file as KHR_lights_punctual, for engines that do not light by
    /// emissive surfaces.
    #[arg(long)]
    pub punctual_lights: bool,
    /// Add the irradiance to the glTF file as a lightmap on the second texture set (named in the
    /// material's extras).
    #[arg(long)]
    pub lightmap: bool,
    /// Store the glTF file's textures as lossless WebP (EXT_texture_webp) instead of PNG.
    #[arg(long)]
    pub webp: bool,
    /// Mitsuba: leave out specular reflection, so that its rendering must equal `unbake render
    /// --renderer path --diffuse-only --flat`.
    #[arg(long)]
    pub mitsuba_diffuse: bool,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self {
            format: vec![Format::Glb, Format::Usd, Format::Mitsuba],
            max_texture: 4096,
            punctual_lights: false,
            lightmap: false,
            webp: false,
            mitsuba_diffuse: false,
        }
    }
}

/// Writes the wanted formats and `cameras.json` into `folder`, all or nothing; returns the file
/// names.
///
/// # Errors
/// A file cannot be written.
pub fn export(
    folder: &Path,
    solution: &Solution,
    cameras: &[NamedCamera],
    options: &ExportOptions,
) -> Result<Vec<String>> {
    if options.max_texture == 0 {
        return Err(Error::Usage("--max-texture must be at least 1".into()));
    }
    let aside = AsideFolder::new(folder)?;
    let mut files = Vec::new();
    for format in &options.format {
        match format {
            Format::Glb => {
                let glb = GlbOptions {
                    max_texture: options.max_texture,
                    lights: if options.punctual_lights {
                        punctual_lights(solution)
                    } else {
                        Vec::new()
                    },
                    lightmap: options.lightmap,
                    webp: options.webp,
                };
                let path = aside.path().join("scene.glb");
                std::fs::write(&path, scene_glb(solution, &glb)?)
                    .map_err(|e| Error::io(&path, e))?;
                files.push("scene.glb".to_owned());
            }
            Format::Usd => files.extend(write_usd(aside.path(), solution)?),
            Format::Mitsuba => files.extend(write_mitsuba(
                aside.path(),
                solution,
                cameras,
                options.mitsuba_diffuse,
            )?),
        }
    }
    let path = aside.path().join("cameras.json");
    let text = format!("{:#}\n", camera_file(cameras, solution.origin));
    std::fs::write(&path, text).map_err(|e| Error::io(&path, e))?;
    files.push("cameras.json".into());
    files.sort();
    files.dedup();
    aside.publish(folder, &files)?;
    Ok(files)
}

/// Cameras in the form of `transforms.json`, in the coordinates of the scene's file.
#[must_use]
pub fn camera_file(cameras: &[NamedCamera], origin: DVec3) -> Value {
    let frame = |c: &NamedCamera| {
        let Camera {
            width,
            height,
            world_from_camera: m,
            position,
            ..
        } = c.camera;
        let p = position.as_dvec3() + origin;
        let row = |k: usize| {
            [
                f64::from(m.x_axis[k]),
                f64::from(m.y_axis[k]),
                f64::from(m.z_axis[k]),
                p[k],
            ]
        };
        let mut out = json!({
            "file_path": format!("{}.exr", c.name),
            "w": width,
            "h": height,
            "camera_model": "EQUIRECTANGULAR",
            "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
        });
        if let Projection::Pinhole(l) = c.camera.projection {
            out["camera_model"] = json!("OPENCV");
            for (key, value) in [
                ("fl_x", l.fl_x),
                ("fl_y", l.fl_y),
                ("cx", l.cx),
                ("cy", l.cy),
                ("k1", l.k[0]),
                ("k2", l.k[1]),
                ("p1", l.p[0]),
                ("p2", l.p[1]),
            ] {
                out[key] = json!(value);
            }
        }
        out
    };
    json!({"frames": cameras.iter().map(frame).collect::<Vec<Value>>()})
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::trace::EmbreeTracer;
    use crate::render::{read_cameras, viewpoints};
    use crate::solution::tests::small_solution;

    #[test]
    fn everything_is_written_and_the_cameras_read_back() {
        let folder = tempfile::tempdir().expect("temp");
        let mut solution = small_solution();
        for p in solution.mesh.positions.clone() {
            solution.mesh.positions.push(p + glam::Vec3::Y * 2.0);
            solution.mesh.normals.push(glam::Vec3::NEG_Y);
            solution.mesh.uvs.push(glam::Vec2::ZERO);
        }
        solution.mesh.triangles.extend([[4, 5, 6], [4, 6, 7]]);
        let tracer = EmbreeTracer::new(&solution.mesh).expect("embree");
        let cameras = viewpoints(&solution.mesh, &tracer, 2, 64, 48);
        assert!(!cameras.is_empty());
        let files = export(
            folder.path(),
            &solution,
            &cameras,
            &ExportOptions::default(),
        )
        .expect("exports");
        for name in ["scene.glb", "scene.usda", "mitsuba.xml", "cameras.json"] {
            assert!(
                files.iter().any(|f| f == name) && folder.path().join(name).is_file(),
                "{name}"
            );
        }
        let back = read_cameras(&folder.path().join("cameras.json"), solution.origin, None)
            .expect("reads")
            .cameras;
        for (a, b) in back.iter().zip(&cameras) {
            assert_eq!(
                (a.name.as_str(), a.camera.projection),
                (b.name.as_str(), b.camera.projection)
            );
            assert!((a.camera.position - b.camera.position).length() < 1e-5);
        }
    }
}
