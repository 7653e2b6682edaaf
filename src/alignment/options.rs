//! What `check` and `solve` do about alignment.

use super::apply::{apply, refine_poses};
use super::evidence::{EvidenceSize, gather, gather_sizes};
use super::refine::refine;
use super::score::Ground;
use super::verdict::{Alignment, MOST_VIEWS, assess_views};
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
    let mut tracer = EmbreeTracer::new(&scene.mesh)?;
    let mut seen = gather(scene, MOST_VIEWS, EvidenceSize::COARSE)?;
    let mut found = assess_views(scene, &tracer, &seen);
    let wrong = found.verdict == AlignmentVerdict::Misaligned;
    let refines = options.refine_poses != Switch::Off;
    if let (true, true, Some(c)) = (options.fix_alignment, wrong, &found.correction) {
        apply(scene, c, found.corrected_distance);
        found.fixed = true;
        if refines {
            tracer = EmbreeTracer::new(&scene.mesh)?;
        }
    }
    let fits = found.fixed || found.verdict != AlignmentVerdict::Misaligned;
    if refines && fits {
        // the test may have seen some of the views only, or all before they were corrected
        if found.fixed || seen.len() < scene.train_views().count() {
            seen = gather(scene, usize::MAX, EvidenceSize::COARSE)?;
        }
        let ground = Ground {
            mesh: &scene.mesh,
            tracer: &tracer,
        };
        let finer = || gather_sizes(scene, usize::MAX, &EvidenceSize::FINER);
        let hasty = options.refine_poses == Switch::Auto;
        found.refined = refine(&ground, &seen, finer, hasty)?;
        refine_poses(scene, &found.refined);
    }
    Ok(found)
}
