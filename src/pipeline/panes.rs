//! Stage "panes": photographs look through what is clear, and in the end it is in the textures.

use super::SolveOptions;
use super::decisions::report_panes;
use crate::Result;
use crate::core::progress::Progress;
use crate::core::switch::Switch;
use crate::core::trace::EmbreeTracer;
use crate::gbuffer::{ObservedView, Observer};
use crate::inverse::AlbedoEstimate;
use crate::observed::{Panes, Surface, find_panes};
use crate::scene::Scene;

/// What photographs look through, and the rays for which it is not there.
pub(super) struct Cleared {
    pub(super) tracer: EmbreeTracer,
    pub(super) panes: Panes,
}

/// Finds panes and lets the views look through them.
pub(super) fn clear_panes(
    scene: &Scene,
    whole: EmbreeTracer,
    views: &mut [ObservedView],
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Cleared> {
    let (mesh, classes) = (&scene.mesh, scene.mesh_classes.as_ref());
    let mut panes = Panes::default();
    if options.panes != Switch::Off {
        panes = progress.stage("panes", 1, |_| {
            find_panes(&Observer { mesh, views }, &whole, classes)
        });
        report_panes(scene, &panes, progress);
    }
    if panes.is_empty() {
        return Ok(Cleared {
            tracer: whole,
            panes,
        });
    }
    let tracer = panes.cleared(mesh)?;
    for view in views {
        panes.look_through(view, &whole, &tracer, scene);
    }
    Ok(Cleared { tracer, panes })
}

/// Gives the texels of panes what these let through.
pub(super) fn show_panes(surface: &Surface, albedo: &mut AlbedoEstimate, errors: &mut [f32]) {
    for (i, pane) in surface.panes.texels(&surface.texels) {
        (albedo.value[i], albedo.error[i]) = (pane.tint, pane.tint_error);
        errors[i] = pane.tint_error;
    }
}
