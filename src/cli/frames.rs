//! Where frames come from and go to: the options that all verbs share that make pictures.

use super::camera_files::files_of_cameras;
use super::context::Context;
use super::inputs::read_solved_scene;
use crate::Result;
use crate::core::lock::OutputLock;
use crate::core::trace::EmbreeTracer;
use crate::programs::export::FrameWriter;
use crate::programs::run::{keep_inputs, keep_results};
use crate::render::{FrameOptions, NamedCamera, cameras_of_scene, read_cameras, viewpoints};
use crate::solution::Solution;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Where cameras come from and where frames go.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct FrameSource {
    /// Cameras to render from: a JSON file like a scene's transforms.json.
    #[arg(long, value_name = "FILE")]
    pub cameras: Option<PathBuf>,
    /// Scene whose views to render, or to take a path's cameras from.
    #[arg(long, value_name = "SCENE", conflicts_with = "cameras")]
    pub scene: Option<PathBuf>,
    /// Folder for the files [default: a folder in OUT named after the verb].
    #[arg(long, short = 'o', visible_alias = "out", value_name = "FOLDER")]
    pub to: Option<PathBuf>,
}

impl FrameSource {
    /// The cameras to render the solution in `out` from; a scene's with what `solve` corrected.
    pub(super) fn frames(
        &self,
        out: &Path,
        options: &FrameOptions,
        solution: &Solution,
        context: &Context,
    ) -> Result<Vec<NamedCamera>> {
        let given = match (&self.cameras, &self.scene) {
            (Some(file), _) => {
                let size = (options.width > 0).then(|| [options.width, (options.width / 2).max(1)]);
                read_cameras(file, solution.origin, size)?.cameras
            }
            (None, Some(scene)) => {
                let scene = read_solved_scene(scene, out, context)?;
                cameras_of_scene(&scene, options.views.split(), solution.origin)
            }
            (None, None) => {
                context.progress.note(
                    "no --cameras and no --scene: two views that show much of the scene are chosen",
                );
                let (w, h) = (
                    if options.width > 0 {
                        options.width
                    } else {
                        960
                    },
                    options.height,
                );
                let h = if h > 0 { h } else { (w * 9 / 16).max(1) };
                viewpoints(&solution.mesh, &EmbreeTracer::new(&solution.mesh)?, 2, w, h)
            }
        };
        options.frames(given)
    }

    /// The folder for a verb's files, with the right to write there.
    pub(super) fn folder(&self, out: &Path, verb: &str) -> Result<(PathBuf, OutputLock)> {
        let folder = self.to.clone().unwrap_or_else(|| out.join(verb));
        // the solution's own files are read as well
        keep_inputs(&folder, out, &[])?;
        keep_results(&folder)?;
        for list in self.cameras.iter().chain(&self.scene) {
            let list = match list.is_dir() {
                true => list.join("transforms.json"),
                false => list.clone(),
            };
            keep_inputs(&folder, out, &files_of_cameras(&list))?;
        }
        let lock = OutputLock::acquire(&folder, &[])?;
        Ok((folder, lock))
    }
}

/// Prints what was rendered, and makes the film.
pub(super) fn report(
    writer: &FrameWriter,
    options: &FrameOptions,
    folder: &Path,
    seconds: &[f64],
    context: &Context,
) -> Result<()> {
    let film = writer.film(options.video, options.fps)?;
    let total: f64 = seconds.iter().sum();
    let mean = total / seconds.len().max(1) as f64;
    let stops = writer.stops().unwrap_or(0.0);
    let film_text = film
        .as_ref()
        .map_or(String::new(), |f| format!("film: {}\n", f.display()));
    let text = format!(
        "{} frames in {:.2} s ({mean:.2} s each), pictures at {stops:+.2} stops\n{}\n{film_text}",
        seconds.len(),
        total,
        folder.display()
    );
    context.result(
        &text,
        &json!({"folder": folder, "seconds": seconds, "stops": stops, "film": film}),
    )
}
