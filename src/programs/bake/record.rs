//! `bake.json`: what was baked, how, and how far it is to be trusted.

use super::layout::Layout;
use super::options::BakeOptions;
use super::output::Shown;
use crate::core::formats::atomic_write;
use crate::error::{Error, Result};
use serde::Serialize;
use std::path::Path;

/// Its name.
pub const BAKE: &str = "bake.json";

/// What it holds.
#[derive(Clone, Debug, Serialize)]
pub struct BakeRecord {
    /// Version of the program.
    pub unbake: String,
    /// The file that was baked.
    pub scene: String,
    /// What was asked for.
    pub options: BakeOptions,
    /// Key of all random numbers.
    pub seed: u64,
    /// Triangles that were traced, every copy of a mesh counted.
    pub triangles: usize,
    /// Lights without extent, suns of the panorama among them.
    pub lights: usize,
    /// Where surfaces lie on the lightmap.
    pub layout: Layout,
    /// Paths per texel.
    pub samples: u32,
    /// Time of the whole, seconds.
    pub seconds: f64,
    /// Root mean square error over the mean irradiance, by area, as the filter expects it, its bias
    /// included.
    pub error: f32,
    /// The same without bias, as two halves of the samples differ from their mean.
    pub error_of_halves: f32,
    /// Mean irradiance by area, linear RGB, in the file's unit (lux by the standard).
    pub mean_irradiance: [f32; 3],
    /// Root mean square difference between both sides of the cuts between charts, in the unit of the
    /// irradiance.
    pub step_at_seams: f32,
    /// The same before the seams were joined.
    pub step_at_seams_before: f32,
    /// The lightmap in `scene.glb`.
    pub picture: Shown,
    /// What of the file the light does not know.
    pub notes: Vec<String>,
}

impl BakeRecord {
    /// Writes it into a folder.
    pub(super) fn write(&self, out: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)
            .map_err(|e| Error::Failed(format!("{BAKE} cannot be written: {e}")))?;
        atomic_write(out.join(BAKE), format!("{text}\n").as_bytes())
    }
}
