//! How good a reconstruction is: re-rendering, novel views and, where a scene has ground truth,
//! materials.
//!
//! This is the only module that reads a scene's `gt/` folder. Every material figure is given under
//! three published protocols side by side (see [`protocol`]); nothing is overwritten before
//! scoring.

mod calibration;
mod emission;
mod found;
mod gains;
mod image_scores;
mod metals;
mod options;
mod panes;
pub mod protocol;
mod scores;
mod table;
mod truth;

pub use calibration::{Calibration, CalibrationBin, Calibrations};
pub use emission::EmissionScores;
pub use gains::GainScores;
pub use image_scores::ImageScores;
pub use metals::MetalScores;
pub use options::EvalOptions;
pub use panes::PaneScores;
pub use scores::{ClassScores, Evaluation, MaterialScores, Protocols, SplitScores, ViewScores};
pub use table::terminal_table;
pub use truth::GroundTruth;
use truth::has_true_materials;
pub(crate) use truth::true_materials;

use crate::core::formats::{AsideFolder, write_plane_half, write_rgb_half};
use crate::core::image::{Plane, RgbPlane};
use crate::core::metrics::{masked_mse, masked_ssim, psnr};
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::render::{RenderedView, ViewRenderer};
use crate::scene::{Scene, Split, View};
use emission::EmissionTruth;
use gains::GainFit;
use protocol::{
    box_average, clipped, display, least_squares_albedo, material_mask, quantised, tone_mapped,
    working_size,
};
use scores::{Accumulator, ClassTally};
use std::path::Path;

/// A view that has just been scored, for whoever collects pictures.
pub struct ViewOutcome<'a> {
    /// The scene's view.
    pub view: &'a View,
    /// Working radiance of the photograph (exposure applied).
    pub photograph: &'a RgbPlane,
    /// Its re-rendering.
    pub rendered: &'a RenderedView,
    /// Its scores.
    pub scores: &'a ViewScores,
    /// Ground truth, if the scene has it.
    pub truth: Option<&'a GroundTruth>,
}

/// Renders and scores the held-out views (and, if asked or if there are no others, the training
/// views).
///
/// With `folder` (the output folder of `solve`) writes `eval/metrics.json` and
/// `eval/<stem>.{render,albedo,roughness}.exr`; files of an earlier evaluation are replaced only
/// when all new ones are complete.
///
/// # Errors
/// If a photograph, its labels or its truth cannot be read or do not fit, or `folder` cannot be
/// written to.
pub fn evaluate(
    scene: &Scene,
    renderer: &dyn ViewRenderer,
    options: &EvalOptions,
    folder: Option<&Path>,
    progress: &Progress,
    each: &mut dyn FnMut(&ViewOutcome<'_>),
) -> Result<Evaluation> {
    options.validate()?;
    let views = scored_views(scene, options, progress)?;
    note_missing_truth(scene, &views, progress);
    let mut scoring = Scoring {
        scene,
        renderer,
        options,
        aside: folder
            .map(|f| AsideFolder::new(&f.join("eval")))
            .transpose()?,
        files: Vec::new(),
        test: Accumulator::new(scene),
        train: Accumulator::new(scene),
    };
    progress.stage("evaluation", views.len() as u64, |progress| {
        for view in &views {
            scoring.view(view, each)?;
            progress.advance(1);
        }
        Ok::<(), Error>(())
    })?;
    let Scoring {
        aside,
        mut files,
        test,
        train,
        ..
    } = scoring;
    let (test, train) = (test.finish(), train.finish());
    let scored = || [&test, &train].into_iter().flatten();
    let known = protocol::Known {
        metals: scored().any(|s| s.metals.is_some()),
        panes: scored().any(|s| s.panes.is_some()),
    };
    let evaluation = Evaluation {
        protocols: protocol::descriptions(options, known),
        novel_views: test.as_ref().map(|t| t.gains.clone()),
        test,
        train,
    };
    if let (Some(folder), Some(aside)) = (folder, &aside) {
        let json = serde_json::to_vec_pretty(&evaluation)
            .map_err(|e| Error::Failed(format!("metrics.json: {e}")))?;
        let path = aside.path().join("metrics.json");
        std::fs::write(&path, json).map_err(|e| Error::io(&path, e))?;
        files.push("metrics.json".into());
        aside.publish(&folder.join("eval"), &files)?;
    }
    Ok(evaluation)
}

/// The held-out views, and the training views if asked or if there are no others.
fn scored_views<'a>(
    scene: &'a Scene,
    options: &EvalOptions,
    progress: &Progress,
) -> Result<Vec<&'a View>> {
    let holds_out = scene.views.iter().any(|v| v.split == Split::Test);
    if !holds_out {
        progress.note("the scene holds out no view: the training views are scored, which says nothing about novel views");
    }
    let is_test = |v: &&View| v.split == Split::Test;
    let held_out = scene.views.iter().filter(is_test).count();
    let most = options.views.unwrap_or(held_out).min(held_out);
    let mut passed = 0;
    let views: Vec<&View> = scene
        .views
        .iter()
        .filter(|v| {
            if !is_test(v) {
                return options.train || !holds_out;
            }
            passed += 1;
            // where i·most/n passes a whole number, the first view included
            (passed - 1) * most % held_out < most
        })
        .collect();
    if views.is_empty() {
        return Err(Error::input(
            &scene.folder,
            "has no views to evaluate; add frames to transforms.json",
        ));
    }
    Ok(views)
}

/// Says which views are left out of the materials' scores, where others have a truth.
fn note_missing_truth(scene: &Scene, views: &[&View], progress: &Progress) {
    let truth = scene.folder.join("gt");
    if !["albedo", "roughness"]
        .iter()
        .any(|k| truth.join(k).is_dir())
    {
        return;
    }
    let missing: Vec<&str> = views
        .iter()
        .filter(|v| !has_true_materials(scene, v))
        .map(|v| v.stem.as_str())
        .collect();
    if let Some(first) = missing.first() {
        progress.note(format!(
            "{} of {} views are not scored by their materials: gt/albedo/{first}.exr or gt/roughness/{first}.exr is missing",
            missing.len(),
            views.len()
        ));
    }
}

/// An evaluation under way.
struct Scoring<'a> {
    scene: &'a Scene,
    renderer: &'a dyn ViewRenderer,
    options: &'a EvalOptions,
    /// Where files are written until all are complete.
    aside: Option<AsideFolder>,
    /// Their names.
    files: Vec<String>,
    /// Scores of the held-out and of the training views.
    test: Accumulator,
    train: Accumulator,
}

impl Scoring<'_> {
    /// Renders, writes and scores a view.
    fn view(&mut self, view: &View, each: &mut dyn FnMut(&ViewOutcome<'_>)) -> Result<()> {
        let (photograph, valid) = photograph(self.scene, view)?;
        let classes = labels_of(self.scene, view)?;
        let rendered = match &classes {
            Some(classes) => self.renderer.render_classes(&view.camera, classes)?,
            None => self.renderer.render(&view.camera)?,
        };
        if let Some(aside) = &self.aside {
            self.files
                .extend(write_view(aside.path(), &view.stem, &rendered)?);
        }
        let truth = true_materials(self.scene, view)?;
        let accumulator = if view.split == Split::Test {
            &mut self.test
        } else {
            &mut self.train
        };
        let truth = truth.as_ref();
        let reprojected = self.renderer.reproject(&view.camera)?;
        let images = Images {
            photograph: &photograph,
            valid: &valid,
            reprojected: reprojected.as_ref(),
        };
        let mut scores = score_rendering(view, &images, &rendered, self.options, accumulator)?;
        let labels = classes.unwrap_or_else(|| rendered.labels.clone());
        if let Some(emission) =
            EmissionTruth::of(self.scene, view, &photograph, &labels, &accumulator.lights)?
        {
            accumulator.emission.add(&emission, &rendered, scores.gain);
        }
        if let Some(truth) = truth {
            score_materials(
                &labels,
                &rendered,
                truth,
                self.options,
                accumulator,
                &mut scores,
            );
        }
        each(&ViewOutcome {
            view,
            photograph: &photograph,
            rendered: &rendered,
            scores: &scores,
            truth,
        });
        accumulator.views.push(scores);
        Ok(())
    }
}

/// The working radiance of a view and which of its pixels count.
///
/// # Errors
/// If the image or its mask cannot be read or does not fit the view.
pub fn photograph(scene: &Scene, view: &View) -> Result<(RgbPlane, Plane<bool>)> {
    let image = scene.load_radiance(view)?;
    let valid = scene
        .load_mask(view)?
        .unwrap_or_else(|| Plane::filled(image.width, image.height, true));
    Ok((image, valid))
}

/// The value of `plane` under pixel (x, y) of an image of another resolution and the same aspect.
fn nearest_of<'a, T, U>(plane: &'a Plane<T>, image: &Plane<U>, x: usize, y: usize) -> &'a T {
    let column = (2 * x + 1) * plane.width / (2 * image.width);
    let row = (2 * y + 1) * plane.height / (2 * image.height);
    &plane[(column.min(plane.width - 1), row.min(plane.height - 1))]
}

fn write_view(folder: &Path, stem: &str, rendered: &RenderedView) -> Result<[String; 3]> {
    let names = ["render", "albedo", "roughness"].map(|kind| format!("{stem}.{kind}.exr"));
    write_rgb_half(folder.join(&names[0]), &rendered.radiance)?;
    write_rgb_half(folder.join(&names[1]), &rendered.albedo)?;
    write_plane_half(folder.join(&names[2]), &rendered.roughness)?;
    Ok(names)
}

/// What a re-rendering is compared with.
struct Images<'a> {
    photograph: &'a RgbPlane,
    /// Pixels of the photograph that count.
    valid: &'a Plane<bool>,
    /// The fused radiance seen through the camera, where the renderer holds any.
    reprojected: Option<&'a RgbPlane>,
}

fn score_rendering(
    view: &View,
    images: &Images<'_>,
    rendered: &RenderedView,
    options: &EvalOptions,
    accumulator: &mut Accumulator,
) -> Result<ViewScores> {
    let (photograph, counted) = at_working_size(images.photograph, images.valid);
    let gain = options.exposure.exp2();
    let b = tone_mapped(&photograph, gain);
    let shown = |image: &RgbPlane| display(&at_working_size(image, images.valid).0, gain);
    let a = shown(&rendered.radiance);
    let Some(fit) = GainFit::of(&a, &b, &counted) else {
        return Err(Error::input(
            &view.image_path,
            "has no valid pixel to compare with; check the image and its mask",
        ));
    };
    let a = clipped(&a);
    let ssim = masked_ssim(&a, &b, &counted);
    let ceiling = images
        .reprojected
        .and_then(|r| GainFit::of(&shown(r), &b, &counted));
    accumulator.rendering.add(fit.as_is, ssim);
    accumulator.gains.add(&fit, ceiling.as_ref());
    Ok(ViewScores {
        stem: view.stem.clone(),
        psnr: psnr(fit.as_is),
        ssim: ssim.unwrap_or(1.0),
        mse: fit.as_is,
        gain: fit.gain,
        psnr_gain: psnr(fit.per_view),
        ceiling_psnr_gain: ceiling.map(|c| psnr(c.per_view)),
        nonfinite_pixels: rendered
            .radiance
            .data
            .iter()
            .filter(|v| !v.is_finite())
            .count(),
        ..ViewScores::default()
    })
}

/// An image's valid pixels averaged to the size of comparison, and where there were any.
fn at_working_size(image: &RgbPlane, valid: &Plane<bool>) -> (RgbPlane, Plane<bool>) {
    let (w, h) = working_size(image.width, image.height);
    box_average(image, valid, w, h)
}

/// The re-rendering and the photograph as the image scores compare them, and the pixels that count.
#[must_use]
pub fn comparable(
    photograph: &RgbPlane,
    valid: &Plane<bool>,
    rendering: &RgbPlane,
    exposure: f32,
) -> (RgbPlane, RgbPlane, Plane<bool>) {
    let (photo_small, counted) = at_working_size(photograph, valid);
    let (render_small, _) = at_working_size(rendering, valid);
    let gain = exposure.exp2();
    (
        tone_mapped(&render_small, gain),
        tone_mapped(&photo_small, gain),
        counted,
    )
}

/// The scene's class ids at the frame's size; none where it labels nothing.
fn labels_of(scene: &Scene, view: &View) -> Result<Option<Plane<u16>>> {
    let Some(file) = scene.load_labels(view)? else {
        return Ok(None);
    };
    let (width, height) = (view.camera.width, view.camera.height);
    let frame: Plane<()> = Plane::filled(width, height, ());
    let data = (0..width * height)
        .map(|i| *nearest_of(&file, &frame, i % width, i / width))
        .collect();
    Ok(Some(Plane {
        width,
        height,
        data,
    }))
}

fn score_materials(
    labels: &Plane<u16>,
    rendered: &RenderedView,
    truth: &GroundTruth,
    options: &EvalOptions,
    accumulator: &mut Accumulator,
    scores: &mut ViewScores,
) {
    let mask = material_mask(labels, truth, &accumulator.lights);
    let Some(linear) = masked_mse(&rendered.albedo, &truth.albedo, &mask) else {
        return; // a view of lamps and sky only says nothing about materials
    };
    let bits = |p: &RgbPlane| {
        if options.quantise {
            p.map(|v| v.map(quantised))
        } else {
            p.clone()
        }
    };
    let fipt_roughness = |p: &Plane<f32>| {
        p.map(|r| {
            let clamped = r.clamp(0.2, 1.0);
            if options.quantise {
                quantised(clamped)
            } else {
                clamped
            }
        })
    };
    let (scaled, scale) = least_squares_albedo(&rendered.albedo, &truth.albedo, &mask);
    let materials = accumulator.materials.get_or_insert_default();
    let albedo = [
        (
            &mut materials.albedo.linear,
            rendered.albedo.clone(),
            truth.albedo.clone(),
        ),
        (
            &mut materials.albedo.fipt,
            bits(&rendered.albedo),
            bits(&truth.albedo),
        ),
        (&mut materials.albedo.texir, scaled, truth.albedo.clone()),
    ];
    let mut albedo_mse = [linear; 3];
    for (slot, (tally, prediction, reference)) in albedo_mse.iter_mut().zip(albedo) {
        *slot = masked_mse(&prediction, &reference, &mask).unwrap_or(linear);
        tally.add(*slot, masked_ssim(&prediction, &reference, &mask));
    }
    let roughness = [
        (
            &mut materials.roughness.linear,
            rendered.roughness.clone(),
            truth.roughness.clone(),
        ),
        (
            &mut materials.roughness.fipt,
            fipt_roughness(&rendered.roughness),
            fipt_roughness(&truth.roughness),
        ),
    ];
    let mut roughness_mse = [0.0; 2];
    for (slot, (tally, prediction, reference)) in roughness_mse.iter_mut().zip(roughness) {
        *slot = masked_mse(&prediction, &reference, &mask).unwrap_or(0.0);
        tally.add(*slot, masked_ssim(&prediction, &reference, &mask));
    }
    scores.albedo_psnr = Some(psnr(albedo_mse[0]));
    scores.albedo_psnr_texir = Some(psnr(albedo_mse[2]));
    scores.albedo_scale = Some(scale);
    scores.roughness_psnr = Some(psnr(roughness_mse[0]));
    scores.roughness_psnr_fipt = Some(psnr(roughness_mse[1]));
    let tally: &mut ClassTally = &mut accumulator.classes;
    tally.add(labels, &mask, rendered, truth);
    accumulator.calibration.add(&mask, rendered, truth);
    accumulator.metals.add(&mask, rendered, truth);
    accumulator.panes.add(&mask, rendered, truth);
}

#[cfg(test)]
mod tests;
