//! `unbake relight`.

use crate::cli::context::Context;
use crate::cli::frames::{Places, report, traced};
use crate::cli::inputs::read_solution;
use crate::error::{Error, Result};
use crate::export::FrameWriter;
use crate::geometry::Camera;
use crate::image::RgbPlane;
use crate::render::{
    Adaptive, Exposure, LampChange, Lighting, NamedCamera, Noise, PathTracerOptions, Stage,
    TraceSettings, World, daylight, mean_luminance,
};
use crate::solution::{Lamp, Solution};
use glam::Vec3;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// `unbake relight`.
pub(crate) fn relight(
    out: &Path,
    places: &Places,
    lights: Option<&Path>,
    against: Option<&Path>,
    list: bool,
    context: &Context,
) -> Result<()> {
    let options = context.config.relight.clone();
    let progress = &context.progress;
    if options.samples < 2
        || options.max_samples < options.samples
        || options.error.is_nan()
        || options.error < 0.0
    {
        return Err(Error::Usage(
            "--samples must be at least 2, --max-samples not less, --error not negative".into(),
        ));
    }
    let solution = read_solution(out, progress)?;
    let groups = solution.lamps.clone();
    if list {
        return list_lamps(&groups, context);
    }
    let lighting = changed_light(&groups, lights, context)?;
    let cameras = places.frames(&options.frames, &solution, context)?;
    let folder = places.to.clone().unwrap_or_else(|| out.join("relight"));
    if let Some(truth) = against {
        let truth = read_solution(truth, progress)?;
        return compare_relit([&solution, &truth], &cameras, &lighting, &folder, context);
    }
    let mut writer = FrameWriter::new(&folder, options.frames.exposure, !options.frames.no_exr)?;
    let settings = TraceSettings {
        tracer: PathTracerOptions {
            seed: context.seed(),
            ..PathTracerOptions::default()
        },
        goal: Adaptive {
            first: options.samples,
            most: options.max_samples,
            error: options.error,
            noise: Noise::Reflected,
        },
        denoise: !options.no_denoise,
    };
    let mut seconds = Vec::new();
    if options.day > 0 {
        let level = match mean_luminance(&solution.environment) {
            l if l > 0.0 => l,
            _ => 1.0,
        };
        let camera = &cameras[0];
        // noon decides the exposure: the sweep shows how dark the night is
        let order = |i: usize| (i + options.day / 2) % options.day;
        for i in (0..options.day).map(order) {
            let (sky, lamps) = daylight(24.0 * i as f32 / options.day as f32, level);
            let mut world = World::new(&solution);
            lighting.apply(&mut world, &groups)?;
            world.set_environment(sky);
            let all: Vec<u32> = groups.iter().flat_map(|g| g.triangles.clone()).collect();
            world.scale_emission(&all, Vec3::splat(lamps));
            let stage = Stage::new(&mut world)?;
            let clock = Instant::now();
            let name = format!("{i:04}");
            stage.render(
                &[(name.clone(), camera.camera)],
                &settings,
                progress,
                |_, _| Ok(()),
                |_, image| {
                    seconds.push(clock.elapsed().as_secs_f64());
                    writer.write(&name, image)
                },
            )?;
        }
        writer.sort();
    } else {
        let mut world = World::new(&solution);
        lighting.apply(&mut world, &groups)?;
        let stage = progress.stage("preparing", 1, |_| Stage::new(&mut world))?;
        let mut clock = Instant::now();
        let shared = std::cell::RefCell::new(&mut writer);
        stage.render(
            &traced(&cameras),
            &settings,
            progress,
            |i, image| shared.borrow_mut().preview(&cameras[i].name, image),
            |i, image| {
                seconds.push(clock.elapsed().as_secs_f64());
                shared.borrow_mut().write(&cameras[i].name, image)?;
                clock = Instant::now();
                Ok(())
            },
        )?;
    }
    report(&writer, &options.frames, &folder, &seconds, context)
}

/// Relights a solution and the truth in the same way and scores the one against the other.
fn compare_relit(
    solutions: [&Solution; 2],
    cameras: &[NamedCamera],
    lighting: &Lighting,
    folder: &Path,
    context: &Context,
) -> Result<()> {
    let options = &context.config.relight;
    let own = &solutions[0].lamps;
    let mut images: [Vec<RgbPlane>; 2] = [Vec::new(), Vec::new()];
    for (k, solution) in solutions.iter().enumerate() {
        let groups = &solution.lamps;
        let mut lighting = lighting.clone();
        if k == 1 {
            lighting.by_place(own);
        }
        let mut world = World::new(solution);
        lighting.apply(&mut world, groups)?;
        let stage = Stage::new(&mut world)?;
        let settings = TraceSettings {
            tracer: PathTracerOptions {
                seed: context.seed() + k as u64,
                ..PathTracerOptions::default()
            },
            goal: Adaptive {
                first: options.samples,
                most: options.max_samples,
                error: options.error,
                noise: Noise::Reflected,
            },
            denoise: !options.no_denoise,
        };
        let shift = (solutions[0].origin - solution.origin).as_vec3();
        let placed: Vec<(String, Camera)> = cameras
            .iter()
            .map(|c| {
                (
                    c.name.clone(),
                    Camera {
                        position: c.camera.position + shift,
                        ..c.camera
                    },
                )
            })
            .collect();
        let list = &mut images[k];
        stage.render(
            &placed,
            &settings,
            &context.progress,
            |_, _| Ok(()),
            |_, image| {
                list.push(image.clone());
                Ok(())
            },
        )?;
    }
    let [ours, truth] = images;
    let factor = match truth.first() {
        Some(first) => options.frames.exposure.factor(first),
        None => 1.0,
    };
    let mut scores = Vec::new();
    for (name, stops) in [("ours", &ours), ("truth", &truth)] {
        let mut writer = FrameWriter::new(
            &folder.join(name),
            Exposure::Stops(factor.log2()),
            !options.frames.no_exr,
        )?;
        for (c, image) in cameras.iter().zip(stops) {
            writer.write(&c.name, image)?;
        }
    }
    let mut text = String::new();
    for ((c, a), b) in cameras.iter().zip(&ours).zip(&truth) {
        let psnr = display_psnr(a, b, factor);
        text.push_str(&format!("{:24} {psnr:6.2} dB\n", c.name));
        scores.push(json!({"camera": c.name, "psnr": psnr}));
    }
    let mean = scores
        .iter()
        .filter_map(|s| s["psnr"].as_f64())
        .sum::<f64>()
        / scores.len().max(1) as f64;
    text.push_str(&format!(
        "mean {mean:.2} dB of clamp(x · 2^{:.2})^(1/2.2) against the truth, in {}\n",
        factor.log2(),
        folder.display()
    ));
    context.result(
        &text,
        &json!({"folder": folder, "scores": scores, "psnr": mean}),
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
    let mut text = String::from(
        "lamp     x       y       z  metres   area m²      power   radiance (r g b)\n",
    );
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
