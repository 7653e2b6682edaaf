//! `unbake relight`.

use crate::cli::context::Context;
use crate::cli::frames::{FrameSource, report};
use crate::cli::inputs::read_solution;
use crate::core::image::RgbPlane;
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::programs::export::FrameWriter;
use crate::render::live::{LightEdit, factors_of, light_groups, open_or_build};
use crate::render::{
    EditableScene, Exposure, LampChange, Lighting, NamedCamera, PathTracedScene, TraceSettings,
    daylight, mean_luminance,
};
use crate::solution::{Lamp, Solution};
use glam::{DVec3, Vec3};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// `unbake relight`.
pub(crate) fn relight(
    out: &Path,
    places: &FrameSource,
    lights: Option<&Path>,
    against: Option<&Path>,
    list: bool,
    context: &Context,
) -> Result<()> {
    let options = &context.config.relight;
    let progress = &context.progress;
    let settings = options.tracing(context.seed())?;
    let solution = read_solution(out, progress)?;
    if list {
        return list_lamps(&solution.lamps, context);
    }
    let lighting = changed_light(&solution.lamps, lights, context)?;
    let cameras = places.frames(out, &options.frames, &solution, context)?;
    let (folder, _lock) = places.folder(out, "relight")?;
    let relit = Relit {
        solution: &solution,
        lighting,
        settings,
        progress,
        operator: options.preview.then_some(out),
    };
    if let Some(truth) = against {
        let truth = read_solution(truth, progress)?;
        return compare_relit(&relit, &truth, &cameras, &folder, context);
    }
    let mut writer = FrameWriter::new(&folder, options.frames.exposure, !options.frames.no_exr)?;
    let seconds = if options.day > 0 {
        relit.day(&cameras[0], options.day, &mut writer)?
    } else {
        relit.views(&cameras, &mut writer)?
    };
    report(&writer, &options.frames, &folder, &seconds, context)
}

/// A solution under changed light, and how it is rendered.
struct Relit<'a> {
    solution: &'a Solution,
    lighting: Lighting,
    settings: TraceSettings,
    progress: &'a Progress,
    /// Folder of the light operator that previews are made by; `None` for none.
    operator: Option<&'a Path>,
}

impl<'a> Relit<'a> {
    /// The solution with its light changed.
    fn world(&self) -> Result<EditableScene<'a>> {
        self.lighting.world(self.solution)
    }

    /// Renders `count` hours of a day from one camera; returns the seconds of each.
    fn day(
        &self,
        camera: &NamedCamera,
        count: usize,
        writer: &mut FrameWriter,
    ) -> Result<Vec<f64>> {
        let level = match mean_luminance(&self.solution.environment) {
            l if l > 0.0 => l,
            _ => 1.0,
        };
        let lamps = &self.solution.lamps;
        let all: Vec<u32> = lamps.iter().flat_map(|g| g.triangles.clone()).collect();
        let mut seconds = Vec::new();
        // noon decides the exposure: the sweep shows how dark the night is
        for i in (0..count).map(|i| (i + count / 2) % count) {
            let (sky, lamps) = daylight(24.0 * i as f32 / count as f32, level);
            let mut world = self.world()?;
            world.set_environment(sky);
            world.scale_emission(&all, Vec3::splat(lamps));
            let stage = PathTracedScene::new(&world)?;
            let clock = Instant::now();
            let name = format!("{i:04}");
            let hour = NamedCamera {
                name: name.clone(),
                camera: camera.camera,
            };
            stage.render(
                &[hour],
                &self.settings,
                self.progress,
                |_, _| Ok(()),
                |_, image| {
                    seconds.push(clock.elapsed().as_secs_f64());
                    writer.write(&name, image)
                },
            )?;
        }
        writer.sort();
        Ok(seconds)
    }

    /// Writes previews of the cameras' pictures by the light operator in `folder`.
    fn previews(
        &self,
        folder: &Path,
        cameras: &[NamedCamera],
        stage: &PathTracedScene<'_, '_>,
        writer: &mut FrameWriter,
    ) -> Result<()> {
        let groups = light_groups(self.solution);
        let Some(lights) = factors_of(&self.world()?, self.solution, &groups) else {
            self.progress.note(
                "no preview: lamps that move or are added and other panoramas are path traced alone",
            );
            return Ok(());
        };
        // a lamp that moves would stand in the operator's way: there is none here
        let tracer = stage.tracer();
        let live = open_or_build(self.solution, Some(folder), tracer, self.progress);
        let clock = Instant::now();
        let answer = live.answer(&LightEdit {
            lights,
            ..LightEdit::default()
        });
        let irradiance = live.irradiance_map(self.solution, &answer);
        stage.preview(
            cameras,
            &irradiance,
            &self.settings,
            self.progress,
            |i, image| writer.preview(&cameras[i].name, image),
        )?;
        let (seconds, error) = (clock.elapsed().as_secs_f64(), live.error());
        self.progress.note(format!(
            "previews of {} views after {seconds:.1} s; irradiance of random edits lies within {:.1} % of the path tracer's at half of the surface, {:.1} % RMS ({:.0} dB)",
            cameras.len(),
            100.0 * error.median,
            100.0 * error.relative,
            error.decibels()
        ));
        Ok(())
    }

    /// Renders and writes the cameras' pictures, a preview of each first; returns the seconds of
    /// each.
    fn views(&self, cameras: &[NamedCamera], writer: &mut FrameWriter) -> Result<Vec<f64>> {
        let world = self.world()?;
        let stage = self
            .progress
            .stage("preparing", 1, |_| PathTracedScene::new(&world))?;
        if let Some(folder) = self.operator {
            self.previews(folder, cameras, &stage, writer)?;
        }
        let mut seconds = Vec::new();
        let mut clock = Instant::now();
        let shared = std::cell::RefCell::new(writer);
        stage.render(
            cameras,
            &self.settings,
            self.progress,
            |i, image| shared.borrow_mut().preview(&cameras[i].name, image),
            |i, image| {
                seconds.push(clock.elapsed().as_secs_f64());
                shared.borrow_mut().write(&cameras[i].name, image)?;
                clock = Instant::now();
                Ok(())
            },
        )?;
        Ok(seconds)
    }

    /// Renders cameras given relative to `origin`.
    fn images(&self, cameras: &[NamedCamera], origin: DVec3) -> Result<Vec<RgbPlane>> {
        let world = self.world()?;
        let stage = PathTracedScene::new(&world)?;
        let shift = (origin - self.solution.origin).as_vec3();
        let mut placed = cameras.to_vec();
        for view in &mut placed {
            view.camera.position += shift;
        }
        let mut images = Vec::new();
        stage.render(
            &placed,
            &self.settings,
            self.progress,
            |_, _| Ok(()),
            |_, image| {
                images.push(image.clone());
                Ok(())
            },
        )?;
        Ok(images)
    }
}

/// Relights the truth as a solution is, and scores the solution's pictures against the truth's.
fn compare_relit(
    relit: &Relit<'_>,
    truth: &Solution,
    cameras: &[NamedCamera],
    folder: &Path,
    context: &Context,
) -> Result<()> {
    let options = &context.config.relight;
    let origin = relit.solution.origin;
    let mut lighting = relit.lighting.clone();
    lighting.by_place(&relit.solution.lamps);
    let relit_truth = Relit {
        solution: truth,
        lighting,
        settings: options.tracing(context.seed() + 1)?,
        progress: relit.progress,
        operator: None,
    };
    let ours = relit.images(cameras, origin)?;
    let truth = relit_truth.images(cameras, origin)?;
    let factor = match truth.first() {
        Some(first) => options.frames.exposure.factor(first),
        None => 1.0,
    };
    for (name, images) in [("ours", &ours), ("truth", &truth)] {
        let mut writer = FrameWriter::new(
            &folder.join(name),
            Exposure::Stops(factor.log2()),
            !options.frames.no_exr,
        )?;
        for (c, image) in cameras.iter().zip(images) {
            writer.write(&c.name, image)?;
        }
    }
    let scores: Vec<f64> = ours
        .iter()
        .zip(&truth)
        .map(|(a, b)| display_psnr(a, b, factor))
        .collect();
    report_scores(cameras, &scores, factor, folder, context)
}

/// The PSNR of each camera and their mean.
fn report_scores(
    cameras: &[NamedCamera],
    scores: &[f64],
    factor: f32,
    folder: &Path,
    context: &Context,
) -> Result<()> {
    let mean = scores.iter().filter(|s| s.is_finite()).sum::<f64>() / scores.len().max(1) as f64;
    let mut text = String::new();
    let mut listed = Vec::new();
    for (c, psnr) in cameras.iter().zip(scores) {
        text.push_str(&format!("{:24} {psnr:6.2} dB\n", c.name));
        listed.push(json!({"camera": c.name, "psnr": psnr}));
    }
    text.push_str(&format!(
        "mean {mean:.2} dB of clamp(x · 2^{:.2})^(1/2.2) against the truth, in {}\n",
        factor.log2(),
        folder.display()
    ));
    context.result(
        &text,
        &json!({"folder": folder, "scores": listed, "psnr": mean}),
    )
}

/// PSNR of clamp(x · factor)^(1/2.2), peak 1.
fn display_psnr(a: &RgbPlane, b: &RgbPlane, factor: f32) -> f64 {
    let shown = |c: &Vec3| {
        (*c * factor)
            .clamp(Vec3::ZERO, Vec3::ONE)
            .powf(1.0 / 2.2)
            .as_dvec3()
    };
    let sum: f64 = a
        .data
        .iter()
        .zip(&b.data)
        .map(|(a, b)| (shown(a) - shown(b)).length_squared())
        .sum();
    -10.0 * (sum / (3 * a.data.len().max(1)) as f64).max(1e-12).log10()
}

/// The lighting file with the flags' changes after it.
fn changed_light(groups: &[Lamp], lights: Option<&Path>, context: &Context) -> Result<Lighting> {
    let options = &context.config.relight;
    let mut lighting = lights.map_or_else(|| Ok(Lighting::default()), Lighting::read)?;
    if !(options.lamps.is_finite() && options.lamps >= 0.0) {
        return Err(Error::Usage(format!(
            "--lamps {}: light is finite and not negative",
            options.lamps
        )));
    }
    lighting.lamps.push(LampChange {
        scale: Some(options.lamps),
        ..LampChange::default()
    });
    for name in options
        .off
        .split(',')
        .map(str::trim)
        .filter(|n| !n.is_empty())
    {
        let group = match name {
            "all" => None,
            n => match n.parse::<usize>() {
                Ok(id) if groups.iter().any(|g| g.id == id) => Some(id),
                _ => {
                    let message = format!(
                        "--off {n}: expected \"all\" or numbers from 1 to {}; see --list-lamps",
                        groups.len()
                    );
                    return Err(Error::Usage(message));
                }
            },
        };
        lighting.lamps.push(LampChange {
            group,
            off: true,
            ..LampChange::default()
        });
    }
    match options.environment.as_str() {
        "keep" => {}
        "off" => lighting.environment.off = true,
        text => {
            let numbers: Vec<f32> = text
                .split(',')
                .filter_map(|x| x.trim().parse().ok())
                .collect();
            match numbers.as_slice() {
                [r, g, b] if numbers.iter().all(|v| v.is_finite() && *v >= 0.0) => {
                    lighting.environment.constant = Some([*r, *g, *b]);
                    lighting.environment.file = None;
                }
                _ => lighting.environment.file = Some(PathBuf::from(text)),
            }
        }
    }
    Ok(lighting)
}

fn list_lamps(groups: &[Lamp], context: &Context) -> Result<()> {
    let mut text =
        String::from("lamp     x m     y m     z m   area m²      power   radiance (r g b)\n");
    for g in groups {
        let [x, y, z] = g.centre;
        let [r, gr, b] = g.radiance;
        text.push_str(&format!(
            "{:4} {x:7.2} {y:7.2} {z:7.2} {:9.4} {:10.4}   {r:.3} {gr:.3} {b:.3}\n",
            g.id,
            g.area,
            g.strength()
        ));
    }
    if groups.is_empty() {
        text = "no lamp: nothing in this solution emits\n".into();
    }
    context.result(&text, &json!({"lamps": groups}))
}
