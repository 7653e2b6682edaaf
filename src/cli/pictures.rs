//! The verbs that make pictures of a solution: render and relight.

use super::Context;
use super::verbs::read_scene;
use crate::edit::{EDITED, EDITS, EditList, apply_to_folder, load_edited};
use crate::error::{Error, Result};
use crate::export::{ExportOptions, FrameWriter};
use crate::geometry::Camera;
use crate::image::RgbPlane;
use crate::progress::Progress;
use crate::render::{
    Adaptive, Exposure, FrameOptions, HybridOptions, HybridRenderer, LampChange, LampGroup,
    Lighting, NamedCamera, Noise, PathTracerOptions, Renderer, Stage, TraceSettings, ViewRenderer,
    World, cameras_of_scene, daylight, lamp_groups, mean_luminance, read_cameras, viewpoints,
};
use crate::solution::Solution;
use crate::trace::EmbreeTracer;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Where cameras come from and where frames go.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Places {
    /// Cameras to render from: a JSON file like a scene's transforms.json.
    #[arg(long, value_name = "FILE")]
    pub cameras: Option<PathBuf>,
    /// Scene whose views to render, or to take a path's cameras from.
    #[arg(long, value_name = "SCENE", conflicts_with = "cameras")]
    pub scene: Option<PathBuf>,
    /// Folder for the frames [default: a folder in OUT named after the verb].
    #[arg(long, value_name = "FOLDER")]
    pub to: Option<PathBuf>,
}

/// Options of `unbake export`: the formats, and the cameras that go with them.
#[derive(clap::Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ExportVerb {
    /// Formats.
    #[command(flatten)]
    pub formats: ExportOptions,
    /// Cameras.
    #[command(flatten)]
    pub frames: FrameOptions,
}

impl Places {
    fn frames(
        &self,
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
                let scene = read_scene(scene, context)?;
                cameras_of_scene(&scene, options.split.split(), solution.origin)
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
}

/// A solution with its edits applied, if it has any.
pub fn read_solution(out: &Path, progress: &Progress) -> Result<Solution> {
    progress.note(format!("reading {}", out.display()));
    load_edited(out, progress)
}

fn traced(cameras: &[NamedCamera]) -> Vec<(String, Camera)> {
    cameras.iter().map(|c| (c.name.clone(), c.camera)).collect()
}

/// `unbake render`.
pub fn render(out: &Path, places: &Places, context: &Context) -> Result<()> {
    let options = context.config.render.clone();
    let progress = &context.progress;
    if options.supersampling == 0 || options.supersampling > 16 || options.samples == 0 {
        return Err(Error::Usage(
            "--supersampling must be from 1 to 16, and --samples at least 1".into(),
        ));
    }
    let solution = read_solution(out, progress)?;
    let cameras = places.frames(&options.frames, &solution, context)?;
    let folder = places.to.clone().unwrap_or_else(|| out.join("render"));
    let mut writer = FrameWriter::new(&folder, options.frames.exposure, !options.frames.no_exr)?;
    let mut seconds = Vec::new();
    let mut clock = Instant::now();
    match options.renderer {
        Renderer::Hybrid => {
            let hybrid = HybridOptions {
                supersampling: options.supersampling,
                denoise: !options.no_denoise,
                seed: context.seed(),
                ..HybridOptions::default()
            };
            let renderer =
                progress.stage("preparing", 1, |_| HybridRenderer::new(&solution, hybrid))?;
            progress.stage("rendering", cameras.len() as u64, |p| -> Result<()> {
                for c in &cameras {
                    clock = Instant::now();
                    let view = renderer.render(&c.camera)?;
                    seconds.push(clock.elapsed().as_secs_f64());
                    writer.write(&c.name, &options.show.of(view))?;
                    p.advance(1);
                }
                Ok(())
            })?;
        }
        Renderer::Path => {
            let mut world = World::new(&solution);
            let stage = progress.stage("preparing", 1, |_| Stage::new(&mut world))?;
            let tracer = PathTracerOptions {
                seed: context.seed(),
                lambertian: options.diffuse_only,
                flat: options.flat,
                ..PathTracerOptions::default()
            };
            let goal = Adaptive {
                first: options.samples,
                most: options.samples,
                error: 0.0,
                noise: Noise::Reflected,
            };
            let settings = TraceSettings {
                tracer,
                goal,
                denoise: !options.no_denoise,
            };
            clock = Instant::now();
            stage.render(
                &traced(&cameras),
                &settings,
                progress,
                |_, _| Ok(()),
                |i, image| {
                    seconds.push(clock.elapsed().as_secs_f64());
                    writer.write(&cameras[i].name, image)?;
                    clock = Instant::now();
                    Ok(())
                },
            )?;
        }
    }
    report(&writer, &options.frames, &folder, &seconds, context)
}

/// `unbake edit`.
pub fn edit(
    out: &Path,
    edits: Option<&Path>,
    scene: Option<&Path>,
    clear: bool,
    context: &Context,
) -> Result<()> {
    let list = out.join(EDITS);
    if clear {
        for (path, removed) in [
            (&list, std::fs::remove_file(&list)),
            (&out.join(EDITED), std::fs::remove_dir_all(out.join(EDITED))),
        ] {
            if let Err(e) = removed
                && e.kind() != std::io::ErrorKind::NotFound
            {
                return Err(Error::io(path, e));
            }
        }
        return context.result(
            &format!("{}: no edits any more\n", out.display()),
            &json!({"out": out, "edits": 0}),
        );
    }
    let before = std::fs::read(&list).ok();
    if let Some(file) = edits {
        let mut taken = EditList::read(file)?;
        if taken.anchor(file)? {
            taken.save(&list)?;
        } else {
            let text = std::fs::read(file).map_err(|e| Error::io(file, e))?;
            crate::formats::atomic_write(&list, &text)?;
        }
    } else if !list.is_file() {
        return Err(Error::Usage(format!(
            "{} does not exist: give the edits with --edits FILE",
            list.display()
        )));
    }
    let done = apply_list(out, &list, scene, context);
    if done.is_err() && edits.is_some() {
        // a list that cannot be applied must not stand in the way of the next `render`
        match before {
            Some(bytes) => crate::formats::atomic_write(&list, &bytes)?,
            None => std::fs::remove_file(&list).map_err(|e| Error::io(&list, e))?,
        }
    }
    done
}

fn apply_list(out: &Path, list: &Path, scene: Option<&Path>, context: &Context) -> Result<()> {
    let classes: Vec<(u16, String)> = match scene {
        Some(path) => read_scene(path, context)?
            .classes
            .into_iter()
            .map(|c| (c.id, c.name))
            .collect(),
        None => Vec::new(),
    };
    // names are turned into ids once, so that the list can be applied where the scene is not at
    // hand
    let mut resolved = EditList::read(list)?;
    if resolved.name_classes(&classes) {
        resolved.save(list)?;
    }
    let clock = Instant::now();
    let edited = apply_to_folder(out, &classes, context.seed(), &context.progress)?;
    let mut text = String::new();
    for (i, n) in edited.texels.iter().enumerate() {
        text.push_str(&format!("edit {i}: {n} texels\n"));
    }
    let bounces: Vec<String> = edited
        .bounces
        .iter()
        .map(|b| format!("{:.2} %", 100.0 * b))
        .collect();
    text.push_str(&format!(
        "light followed over {} bounces (change of irradiance {}), {:.1} s\n{}\n",
        bounces.len(),
        bounces.join(", "),
        clock.elapsed().as_secs_f64(),
        out.join(EDITED).display()
    ));
    context.result(
        &text,
        &json!({"out": out, "texels": edited.texels, "bounces": edited.bounces}),
    )
}

/// `unbake export`.
pub fn export(out: &Path, places: &Places, context: &Context) -> Result<()> {
    let options = &context.config.export;
    let solution = read_solution(out, &context.progress)?;
    let cameras = places.frames(&options.frames, &solution, context)?;
    let folder = places.to.clone().unwrap_or_else(|| out.join("export"));
    let files = context.progress.stage("exporting", 1, |_| {
        crate::export::export(&folder, &solution, &cameras, &options.formats)
    })?;
    let text = format!("{}: {}\n", folder.display(), files.join(" "));
    context.result(&text, &json!({"folder": folder, "files": files}))
}

/// `unbake relight`.
pub fn relight(
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
    let groups = lamp_groups(&World::new(&solution), solution.origin);
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
    let own = lamp_groups(&World::new(solutions[0]), solutions[0].origin);
    let mut images: [Vec<RgbPlane>; 2] = [Vec::new(), Vec::new()];
    for (k, solution) in solutions.iter().enumerate() {
        let groups = lamp_groups(&World::new(solution), solution.origin);
        let mut lighting = lighting.clone();
        if k == 1 {
            lighting.by_place(&own);
        }
        let mut world = World::new(solution);
        lighting.apply(&mut world, &groups)?;
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
fn changed_light(
    groups: &[LampGroup],
    lights: Option<&Path>,
    context: &Context,
) -> Result<Lighting> {
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

fn list_lamps(groups: &[LampGroup], context: &Context) -> Result<()> {
    let mut text = String::from(
        "lamp     x       y       z  metres   area m²      power   radiance (r g b)\n",
    );
    for g in groups {
        let [x, y, z] = g.position;
        let [r, gr, b] = g.radiance;
        text.push_str(&format!(
            "{:4} {x:7.2} {y:7.2} {z:7.2} {:9.4} {:10.4}   {r:.3} {gr:.3} {b:.3}\n",
            g.id, g.area, g.power
        ));
    }
    if groups.is_empty() {
        text = "no lamp: nothing in this solution emits\n".into();
    }
    context.result(&text, &json!({"lamps": groups}))
}

fn report(
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
