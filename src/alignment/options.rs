//! What `check` and `solve` do about alignment.

use super::apply::{apply, refine_poses};
use super::evidence::{EvidenceSize, gather_sizes};
use super::refine::{RefinedPose, refine};
use super::score::Ground;
use super::verdict::{Alignment, assess};
use crate::Result;
use crate::core::switch::Switch;
use crate::core::trace::EmbreeTracer;
use crate::scene::Scene;
use crate::verdict::AlignmentVerdict;

/// What is done about photographs and mesh that do not fit.
#[derive(clap::Args, Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
#[command(next_help_heading = "Alignment")]
pub struct AlignmentOptions {
    /// Solve although photographs and mesh do not fit.
    #[arg(long)]
    pub force: bool,
    /// Apply the correction that the test of alignment finds (units, axes, order of the matrix,
    /// turn, shift, scale, mirrored pixels).
    #[arg(long)]
    pub fix_alignment: bool,
    /// Turn and move cameras until their photographs agree on what the surface shows; only poses that
    /// are wrong visibly and beyond chance are changed, the others stay to the bit. Auto looks at
    /// low resolution first.
    #[arg(long, value_enum, default_value_t = Self::default().refine_poses)]
    pub refine_poses: Switch,
}

impl Default for AlignmentOptions {
    fn default() -> Self {
        Self {
            force: false,
            fix_alignment: false,
            refine_poses: Switch::Auto,
        }
    }
}

/// Tests the alignment of a scene and, if asked to, corrects it.
///
/// # Errors
/// Images, labels or masks that cannot be read; a mesh that Embree refuses.
pub fn align(scene: &mut Scene, options: &AlignmentOptions) -> Result<Alignment> {
    let tracer = EmbreeTracer::new(&scene.mesh)?;
    let mut found = assess(scene, &tracer)?;
    let wrong = found.verdict == AlignmentVerdict::Misaligned;
    if let (true, true, Some(c)) = (options.fix_alignment, wrong, &found.correction) {
        apply(scene, c, found.corrected_distance);
        found.fixed = true;
    }
    let fits = found.fixed || found.verdict != AlignmentVerdict::Misaligned;
    if options.refine_poses != Switch::Off && fits {
        found.refined = refined(scene, options.refine_poses)?;
        refine_poses(scene, &found.refined);
    }
    Ok(found)
}

/// The poses to change. A first look at low resolution settles whether there is anything to do.
fn refined(scene: &Scene, switch: Switch) -> Result<Vec<RefinedPose>> {
    let tracer = EmbreeTracer::new(&scene.mesh)?;
    let ground = Ground {
        mesh: &scene.mesh,
        tracer: &tracer,
    };
    let hasty = switch == Switch::Auto;
    if hasty {
        let coarse = gather_sizes(scene, usize::MAX, &[EvidenceSize::COARSE])?;
        if refine(&ground, &coarse, hasty).is_empty() {
            return Ok(Vec::new());
        }
    }
    let views = gather_sizes(scene, usize::MAX, &EvidenceSize::REFINING)?;
    Ok(refine(&ground, &views, hasty))
}
