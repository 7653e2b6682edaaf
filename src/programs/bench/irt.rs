//! `unbake bench irt`: how fast irradiance is computed, and how accurate it is for its time.

use super::irt_error::{ladders, pipeline_point, reference, seconds_to_reach, target_point};
use super::plot::{Chart, Series, svg};
use super::{
    BenchScene, ErrorPoint, Growth, NirfReport, OidnReport, Rates, Reference, growth, irt_nirf,
    irt_oidn, irt_rates, timed,
};
use crate::Result;
use crate::core::memory::gibibytes;
use crate::core::progress::Progress;
use crate::ffi::oidn::Denoiser;
use crate::pipeline::SolveOptions;
use crate::programs::report::{Machine, SceneSummary, Versions, machine, peak_bytes};
use crate::scene::Scene;
use serde::Serialize;
use std::fmt::Write as _;

/// Rays of the paper's irradiance texture: 1024² texels × 2048.
const PAPER_RAYS: f64 = 1024.0 * 1024.0 * 2048.0;
/// What the paper reports for it on its graphics card.
const PAPER_SECONDS: f64 = 600.0;

/// What `unbake bench irt` can be told.
#[derive(clap::Args, Clone, Debug)]
pub struct IrtBench {
    /// Texels at which errors are taken.
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub reference_texels: usize,
    /// Repetitions of each rate measurement; medians are reported.
    #[arg(long, value_name = "N", default_value_t = 15)]
    pub repetitions: usize,
    /// Longer ladders of sample counts, the pipeline at five sample counts, and meshes of up to 10
    /// million triangles.
    #[arg(long)]
    pub full: bool,
    /// Leave out growth with texels, triangles and threads.
    #[arg(long)]
    pub no_growth: bool,
    /// Stop after the rays per second.
    #[arg(long)]
    pub rates_only: bool,
    /// Write the mesh and the rays of the closest-hit measurement to a folder as raw arrays, for
    /// comparison with other programs.
    #[arg(long, value_name = "FOLDER")]
    pub export_rays: Option<std::path::PathBuf>,
    /// Also bake as `solve --target-error RATIO` would and say which error that reaches; may be
    /// given several times.
    #[arg(long, value_name = "RATIO")]
    pub target_error: Vec<f32>,
    /// Train the paper's neural irradiance field for so many epochs (the paper: 2000) and add its
    /// error and time.
    #[arg(long, value_name = "EPOCHS", num_args = 0..=1, default_missing_value = "40", require_equals = true)]
    pub nirf: Option<u32>,
    /// Library of Open Image Denoise 2 to compare our filter with; without this, OIDN_LIBRARY or
    /// one that the system finds, if any.
    #[arg(long, value_name = "FILE", conflicts_with = "rates_only")]
    pub oidn: Option<std::path::PathBuf>,
}

/// Everything `unbake bench irt` measures.
#[derive(Clone, Debug, Serialize)]
pub struct IrtReport {
    /// End-to-end closest-hit rays/s of the cosine estimator as a share of the bare Embree loop's
    /// over the same rays.
    pub bare_ratio_closest: f64,
    /// The same of a bake by emitter samples (almost only occlusion rays); absent without emitters.
    pub bare_ratio_occlusion: Option<f64>,
    /// How many times sooner than `uniform` at 2048 rays the best of our curves reaches that bake's
    /// error.
    pub speedup_equal_rmse: Option<f64>,
    /// The curve that does, `mis` or `pipeline`.
    pub speedup_curve: Option<String>,
    /// How many times sooner than `uniform` the best of our curves reaches an error of 1 %; absent
    /// where `uniform` does not with 16,384 rays.
    pub speedup_one_percent: Option<f64>,
    /// Seconds of the pipeline's irradiance at the default size, filter included.
    pub seconds_1024: Option<f64>,
    /// Its √(Σ‖E−E'‖²/Σ‖E'‖²).
    pub relative_rmse_1024: Option<f64>,
    /// Its median ‖E−E'‖/‖E'‖.
    pub median_relative_error_1024: Option<f64>,
    /// Its rays per covered texel.
    pub rays_per_texel: Option<f64>,
    /// Side of that texture.
    pub irradiance_size: usize,
    /// Its covered texels.
    pub covered_texels: usize,
    /// Error, seconds and rays of `uniform` at 2048.
    pub uniform_2048: Option<ErrorPoint>,
    /// Seconds the paper's 2.147 G rays would take at the uniform estimator's end-to-end rate.
    pub paper_budget_seconds: f64,
    /// Threads used.
    pub threads: usize,
    /// Embree's version.
    pub embree: String,
    /// Versions.
    pub versions: Versions,
    /// The machine.
    pub machine: Machine,
    /// The scene.
    pub scene: SceneSummary,
    /// Lamps found.
    pub lamps: usize,
    /// Rays per second.
    pub rates: Rates,
    /// The reference.
    pub reference: Option<Reference>,
    /// Error against time.
    pub points: Vec<ErrorPoint>,
    /// The neural irradiance field, where it was asked for.
    pub nirf: Option<NirfReport>,
    /// The comparison with Open Image Denoise; absent if only rates were measured.
    pub oidn: Option<OidnReport>,
    /// Growth with texels, triangles and threads.
    pub growth: Growth,
    /// Seconds of the whole benchmark.
    pub seconds: f64,
    /// Largest resident size of the process.
    pub peak_bytes: u64,
}

/// Runs the benchmark.
///
/// # Errors
/// An unusable scene, no memory for a larger mesh, or a denoiser that was asked for and cannot be
/// used.
pub fn bench_irt(
    scene: &Scene,
    bench: &IrtBench,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<IrtReport> {
    let (report, seconds) = timed(|| measure(scene, bench, options, progress));
    report.map(|r| IrtReport {
        seconds,
        peak_bytes: peak_bytes(),
        ..r
    })
}

fn measure(
    scene: &Scene,
    bench: &IrtBench,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<IrtReport> {
    // before the long run: a library that was asked for and is not there
    let denoiser = if bench.rates_only {
        None
    } else {
        Some(irt_oidn::open(bench.oidn.as_deref())?)
    };
    let ground = BenchScene::prepare(scene, options, progress)?;
    let rays = if bench.full { 2_000_000 } else { 500_000 };
    let rates = progress.stage("rays per second", 4, |p| {
        let export = bench.export_rays.as_deref();
        irt_rates::measure(&ground, rays, bench.repetitions, export, p)
    })?;
    let Some(denoiser) = denoiser else {
        return Ok(rates_alone(scene, &ground, options, rates));
    };
    let errors = errors_against_time(&ground, bench, denoiser, progress)?;
    let growth = if bench.no_growth {
        Growth::default()
    } else {
        grow(&ground, bench, &errors.ours, progress)?
    };
    let uniform_2048 = errors
        .points
        .iter()
        .find(|p| p.curve == "uniform" && p.rays == 2048)
        .cloned();
    let best = uniform_2048
        .as_ref()
        .and_then(|u| sooner(&errors.points, u.seconds, u.relative_rmse));
    let one_percent = seconds_to_reach(&curve(&errors.points, "uniform"), 0.01)
        .and_then(|seconds| sooner(&errors.points, seconds, 0.01));
    Ok(IrtReport {
        speedup_equal_rmse: best.as_ref().map(|b| b.times),
        speedup_curve: best.map(|b| b.curve),
        speedup_one_percent: one_percent.map(|b| b.times),
        seconds_1024: Some(errors.ours.seconds),
        relative_rmse_1024: Some(errors.ours.relative_rmse),
        median_relative_error_1024: Some(errors.ours.median_relative_error),
        rays_per_texel: Some(errors.ours.rays_per_texel),
        uniform_2048,
        reference: Some(errors.reference),
        points: errors.points,
        nirf: errors.nirf,
        oidn: Some(errors.oidn),
        growth,
        ..rates_alone(scene, &ground, options, rates)
    })
}

/// Error against time of all that is compared.
struct Errors {
    reference: Reference,
    /// The points of all curves.
    points: Vec<ErrorPoint>,
    /// The pipeline's at its default samples, also among the points.
    ours: ErrorPoint,
    nirf: Option<NirfReport>,
    oidn: OidnReport,
}

fn errors_against_time(
    ground: &BenchScene,
    bench: &IrtBench,
    denoiser: std::result::Result<Denoiser, String>,
    progress: &Progress,
) -> Result<Errors> {
    let texels = &ground.light.texels;
    let reference = progress.stage("reference", 2 * bench.reference_texels as u64, |p| {
        reference(ground, texels, bench.reference_texels, p)
    });
    let runs = if bench.full { 8192 } else { 4096 };
    let mut points = progress.stage("error against time", 0, |p| {
        ladders(ground, texels, &reference, runs, bench.full, p)
    });
    let (r, e) = (
        ground.options.irradiance_rays,
        ground.options.emitter_samples,
    );
    let part = |n: u32| [(r / n).max(2), (e / n).max(1)];
    let others: &[[u32; 2]] = if bench.full {
        &[part(8), part(4), [2 * r, 2 * e], [4 * r, 4 * e]]
    } else {
        &[part(10), part(8), part(6), part(4)]
    };
    let ours = pipeline_point(ground, texels, &reference, [r, e], progress);
    for &o in others {
        points.push(pipeline_point(ground, texels, &reference, o, progress));
    }
    points.push(ours.clone());
    let oidn = match denoiser {
        Ok(denoiser) => {
            let samples = [part(4), [r, e]];
            let (more, oidn) =
                irt_oidn::measure(ground, &reference, &denoiser, &samples, progress)?;
            points.extend(more);
            oidn
        }
        Err(why) => OidnReport::Missing(why),
    };
    points.extend(
        bench
            .target_error
            .iter()
            .map(|&target| target_point(ground, &reference, target, progress)),
    );
    let nirf = bench.nirf.map(|epochs| {
        progress.stage("neural irradiance field", u64::from(epochs), |p| {
            irt_nirf::measure(ground, texels, &reference, epochs, p)
        })
    });
    points.extend(nirf.iter().flat_map(|n| n.checkpoints.iter().cloned()));
    Ok(Errors {
        reference,
        points,
        ours,
        nirf,
        oidn,
    })
}

fn curve<'a>(points: &'a [ErrorPoint], name: &str) -> Vec<&'a ErrorPoint> {
    points.iter().filter(|p| p.curve == name).collect()
}

/// The best of our curves at some error.
struct Sooner {
    /// How many times sooner it gets there.
    times: f64,
    curve: String,
}

/// How many times sooner than in `seconds` the best of our curves reaches an error.
fn sooner(points: &[ErrorPoint], seconds: f64, error: f64) -> Option<Sooner> {
    ["mis", "pipeline"]
        .iter()
        .filter_map(|&name| {
            Some(Sooner {
                times: seconds / seconds_to_reach(&curve(points, name), error)?,
                curve: name.to_owned(),
            })
        })
        .max_by(|a, b| a.times.total_cmp(&b.times))
}

/// The report with nothing but rays per second.
fn rates_alone(
    scene: &Scene,
    ground: &BenchScene,
    options: &SolveOptions,
    rates: Rates,
) -> IrtReport {
    IrtReport {
        bare_ratio_closest: rates.closest,
        bare_ratio_occlusion: rates.occlusion,
        speedup_equal_rmse: None,
        speedup_curve: None,
        speedup_one_percent: None,
        seconds_1024: None,
        relative_rmse_1024: None,
        median_relative_error_1024: None,
        rays_per_texel: None,
        irradiance_size: options.irradiance_size,
        covered_texels: ground.light.texels.len(),
        uniform_2048: None,
        paper_budget_seconds: PAPER_RAYS / rates.estimators[0].rays_per_second,
        threads: rayon::current_num_threads(),
        embree: crate::core::trace::embree_version(),
        versions: Versions::current(),
        machine: machine(),
        scene: SceneSummary::of(scene),
        lamps: ground.light.emitters.lamp_count(),
        rates,
        reference: None,
        points: Vec::new(),
        nirf: None,
        oidn: None,
        growth: Growth::default(),
        seconds: 0.0,
        peak_bytes: 0,
    }
}

fn grow(
    ground: &BenchScene,
    bench: &IrtBench,
    ours: &ErrorPoint,
    progress: &Progress,
) -> Result<Growth> {
    let texels = &ground.light.texels;
    let side = ground.options.irradiance_size;
    let mut sizes = growth::with_texels(ground, &[side / 4, side / 2], progress);
    sizes.push(super::TextureGrowth {
        side,
        texels: texels.len(),
        rays: (ours.rays_per_texel * texels.len() as f64) as u64,
        seconds: ours.seconds,
        texels_per_second: texels.len() as f64 / ours.seconds,
    });
    let most = if bench.full { 11_000_000 } else { 2_500_000 };
    let triangles = progress.stage("growth with triangles", 0, |p| {
        growth::with_triangles(ground, texels, most, p)
    })?;
    let threads = progress.stage("growth with threads", 0, |_| {
        growth::with_threads(ground, texels, bench.repetitions)
    })?;
    Ok(Growth {
        texels: sizes,
        triangles,
        threads,
    })
}

impl IrtReport {
    /// The table of the terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        // writing to a string cannot fail
        let _ = self.write(&mut out);
        out
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        writeln!(
            out,
            "{}: {} triangles, {} lamps, {} of {}² texels covered; {} threads of {}; Embree {}",
            self.scene.name,
            self.scene.triangles,
            self.lamps,
            self.covered_texels,
            self.irradiance_size,
            self.threads,
            self.machine.cpu,
            self.embree
        )?;
        writeln!(
            out,
            "\nRays per second, end to end, beside a bare Embree loop over the same rays (medians of {}):",
            self.rates.repetitions
        )?;
        writeln!(
            out,
            "  {:28} {:>10} {:>10} {:>9} {:>9} {:>7}",
            "", "closest", "occlusion", "Mray/s", "bare", "share"
        )?;
        for r in &self.rates.estimators {
            let total = (r.closest_rays + r.occlusion_rays) as f64;
            writeln!(
                out,
                "  {:28} {:>10} {:>10} {:>9.2} {:>9.2} {:>6.1}%",
                r.name,
                r.closest_rays,
                r.occlusion_rays,
                r.rays_per_second * 1e-6,
                total / r.bare_seconds * 1e-6,
                100.0 * r.bare_ratio
            )?;
        }
        for b in &self.rates.batches {
            writeln!(
                out,
                "  {:28} {:>21} {:>9.2} {:>9.2} {:>6.1}%",
                format!("batch call, {}", b.name),
                b.rays,
                b.rays_per_second * 1e-6,
                b.bare_rays_per_second * 1e-6,
                100.0 * b.bare_ratio
            )?;
        }
        writeln!(
            out,
            "  the paper's {:.3} G rays at the uniform rate: {:.0} s (paper: about {:.0} s)",
            PAPER_RAYS * 1e-9,
            self.paper_budget_seconds,
            PAPER_SECONDS
        )?;
        if let Some(reference) = &self.reference {
            self.write_errors(out, reference)?;
        }
        self.write_growth(out)?;
        writeln!(
            out,
            "\nwhole benchmark: {:.0} s, {:.2} GiB at most",
            self.seconds,
            gibibytes(self.peak_bytes)
        )
    }

    fn write_errors(&self, out: &mut String, r: &Reference) -> std::fmt::Result {
        writeln!(
            out,
            "\nError at {} seen texels against {} samples (a uniform bake of as many rays: {:.2} % apart, {:+.2} % in the mean):",
            r.texels,
            r.samples,
            100.0 * r.uniform_relative_rmse,
            100.0 * r.uniform_mean_difference
        )?;
        writeln!(
            out,
            "  {:14} {:>12} {:>11} {:>10} {:>10} {:>10}",
            "", "rays + lamps", "rays/texel", "seconds", "rel. RMSE", "median"
        )?;
        for p in &self.points {
            writeln!(
                out,
                "  {:14} {:>12} {:>11.0} {:>9.2}{} {:>9.2}% {:>9.2}%",
                p.curve,
                if p.rays == 0 {
                    "as chosen".to_owned()
                } else {
                    format!("{} + {}", p.rays, p.emitter_samples)
                },
                p.rays_per_texel,
                p.seconds,
                if p.measured_whole { " " } else { "~" },
                100.0 * p.relative_rmse,
                100.0 * p.median_relative_error
            )?;
        }
        writeln!(
            out,
            "  seconds for the whole texture; ~ = scaled up from a part; the pipeline's include its filter"
        )?;
        if let (Some(s), Some(curve), Some(u)) = (
            self.speedup_equal_rmse,
            &self.speedup_curve,
            &self.uniform_2048,
        ) {
            writeln!(
                out,
                "  {curve} reaches the error of uniform 2048 ({:.2} %, {:.0} s) {s:.0} times sooner",
                100.0 * u.relative_rmse,
                u.seconds
            )?;
        }
        if let Some(s) = self.speedup_one_percent {
            writeln!(out, "  1 % is reached {s:.0} times sooner than by uniform")?;
        }
        if let Some(oidn) = &self.oidn {
            writeln!(out, "  {}", oidn.line())?;
        }
        if let Some(n) = &self.nirf {
            writeln!(
                out,
                "  nirf: {} epochs in {:.0} s ({:.0} s of them rays); the paper's 2000 would take {:.0} s (scaled up); whole texture \
                 read out in {:.0} s (scaled up)",
                n.epochs,
                n.ray_seconds + n.step_seconds,
                n.ray_seconds,
                n.seconds_2000,
                n.readout_seconds
            )?;
        }
        Ok(())
    }

    fn write_growth(&self, out: &mut String) -> std::fmt::Result {
        let g = &self.growth;
        if g.texels.is_empty() {
            return Ok(());
        }
        writeln!(out, "\nGrowth of the pipeline's bake with the texture:")?;
        for t in &g.texels {
            writeln!(
                out,
                "  {:>5}²: {:>8} texels, {:>7.2} s, {:>9.0} texels/s, {:.1} M rays",
                t.side,
                t.texels,
                t.seconds,
                t.texels_per_second,
                t.rays as f64 * 1e-6
            )?;
        }
        writeln!(
            out,
            "Growth of tracing with the mesh (the same rays; Mray/s):"
        )?;
        for t in &g.triangles {
            writeln!(
                out,
                "  {:>9} triangles: closest {:>6.2} (bare {:>6.2}), occlusion {:>6.2}; built in {:.2} s",
                t.triangles,
                t.closest_per_second * 1e-6,
                t.bare_closest_per_second * 1e-6,
                t.occluded_per_second * 1e-6,
                t.build_seconds
            )?;
        }
        writeln!(out, "Growth with threads (cosine bake, end to end):")?;
        for t in &g.threads {
            writeln!(
                out,
                "  {:>3}: {:>6.2} Mray/s, {:.2} times one",
                t.threads,
                t.rays_per_second * 1e-6,
                t.speedup
            )?;
        }
        Ok(())
    }

    /// Error against time, shares of the bare loop, and growth, as SVG.
    ///
    /// # Errors
    /// The drawing library failing.
    pub fn plot(&self) -> Result<String> {
        let mut charts = vec![self.error_chart()];
        if !self.growth.texels.is_empty() {
            charts.extend(self.growth_charts());
        }
        svg(&charts)
    }

    fn error_chart(&self) -> Chart {
        let mut names: Vec<&str> = Vec::new();
        for p in &self.points {
            if !names.contains(&p.curve.as_str()) {
                names.push(&p.curve);
            }
        }
        let points = |name: &str| {
            curve(&self.points, name)
                .iter()
                .map(|p| (p.seconds, 100.0 * p.relative_rmse))
                .collect()
        };
        log_chart(
            &format!(
                "{}: irradiance {}², {} threads",
                self.scene.name, self.irradiance_size, self.threads
            ),
            "seconds for the whole texture",
            "relative RMSE, %",
            names.iter().map(|n| line(n, points(n))).collect(),
        )
    }

    fn growth_charts(&self) -> [Chart; 3] {
        let g = &self.growth;
        let rates = |rate: fn(&super::TriangleGrowth) -> f64| {
            g.triangles
                .iter()
                .map(|t| (t.triangles as f64, rate(t) * 1e-6))
                .collect()
        };
        let texels = g
            .texels
            .iter()
            .map(|t| (t.texels as f64, t.seconds))
            .collect();
        let threads = g
            .threads
            .iter()
            .map(|t| (t.threads as f64, t.rays_per_second * 1e-6))
            .collect();
        [
            log_chart(
                "Growth with triangles: the same rays",
                "triangles",
                "Mray/s",
                vec![
                    line("closest hit", rates(|t| t.closest_per_second)),
                    line("bare closest hit", rates(|t| t.bare_closest_per_second)),
                    line("occlusion", rates(|t| t.occluded_per_second)),
                ],
            ),
            log_chart(
                "Growth with texels: the pipeline's bake",
                "covered texels",
                "seconds",
                vec![line("bake", texels)],
            ),
            log_chart(
                "Growth with threads: cosine bake",
                "threads",
                "Mray/s",
                vec![line("cosine", threads)],
            ),
        ]
    }
}

fn line(name: &str, points: Vec<(f64, f64)>) -> Series {
    Series {
        name: name.to_owned(),
        points,
        line: true,
    }
}

fn log_chart(title: &str, x: &str, y: &str, series: Vec<Series>) -> Chart {
    Chart {
        title: title.to_owned(),
        x: x.to_owned(),
        y: y.to_owned(),
        log_x: true,
        log_y: true,
        series,
    }
}
