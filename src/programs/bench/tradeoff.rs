//! `unbake bench tradeoff`: what accuracy costs, preset by preset and knob by knob.
//!
//! Every point is a reconstruction in a process of its own, scored against ground truth. From the
//! preset `standard` one knob at a time is turned and each approximation is left out; the knobs
//! that save most time for the least loss are then turned together, one after another: the best
//! path. A point is marked as Pareto-optimal if no faster one has as high a mean of the three PSNRs
//! (albedo, roughness, novel views).

use super::child::{Outcome, Runner};
use super::fixture::relative_errors;
use super::irt_error::reference;
use super::plot::{Chart, Series, svg};
use super::{BenchScene, Reference};
use crate::Result;
use crate::core::formats::read_rgb;
use crate::core::image::Wrap;
use crate::core::memory::gibibytes;
use crate::core::progress::Progress;
use crate::core::texture::Texels;
use crate::pipeline::SolveOptions;
use crate::programs::report::{Machine, SceneSummary, Versions, machine};
use crate::scene::Scene;
use glam::{Vec2, Vec3};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// Presets, fastest first.
pub const PRESETS: [&str; 3] = ["draft", "standard", "high"];

/// Flags of `unbake solve` that trade time for accuracy, each with the values tried besides the
/// preset's own.
pub const KNOBS: &[(&str, &[&str])] = &[
    ("photo-reduction", &["2"]),
    ("irradiance-rays", &["16", "32", "64", "256"]),
    ("emitter-samples", &["16", "32", "128"]),
    ("irradiance-error", &["0.05", "0.005"]),
    ("irradiance-size", &["256", "512", "2048"]),
    ("albedo-size", &["512", "1024", "4096"]),
    ("evidence-points", &["300", "600", "2400"]),
    ("evidence-rays", &["16", "64", "128"]),
    ("roughness-levels", &["9", "35"]),
    ("specular-rays", &["1", "2", "8", "16"]),
];

/// The values of a quick run: the cheaper half of the knobs that matter most.
const QUICK: &[(&str, &[&str])] = &[
    ("photo-reduction", &["2"]),
    ("irradiance-rays", &["16"]),
    ("irradiance-size", &["512"]),
    ("albedo-size", &["1024"]),
    ("evidence-points", &["300"]),
    ("specular-rays", &["1"]),
];

/// Flags with their values.
type Flags = &'static [(&'static str, &'static str)];

/// Approximations and refinements, and the flags that do without them.
pub const APPROXIMATIONS: &[(&str, Flags)] = &[
    (
        "samples where they are wanted",
        &[("irradiance-rounds", "1")],
    ),
    ("irradiance filter", &[("irradiance-filter", "off")]),
    ("prefiltered lookups", &[("prefilter", "off")]),
    ("a coarse table of responses", &[("roughness-levels", "72")]),
    ("albedo at edges", &[("edges", "off")]),
    ("missing light", &[("missing-light", "off")]),
    ("colours of painted classes", &[("painted", "off")]),
];

/// Decisions that leave out what the scene does not require, and the flags that model it all the
/// same.
pub const NEEDS: &[(&str, Flags)] = &[
    ("even light for matte classes", &[("matte", "off")]),
    (
        "several roughness values per class",
        &[("divide-classes", "off")],
    ),
    (
        "textures fitted to the photographs",
        &[("fit-textures", "off")],
    ),
    (
        "any such decision",
        &[("matte", "off"), ("fit-textures", "off")],
    ),
];

/// What counts as time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Clock {
    /// Seconds on the wall.
    #[default]
    Wall,
    /// Processor seconds over threads: for a machine with other work to do.
    Processor,
}

/// What `unbake bench tradeoff` can be told.
#[derive(clap::Args, Clone, Debug)]
pub struct TradeoffBench {
    /// Only the presets, one value of the main knobs, the approximations and the path.
    #[arg(long)]
    pub quick: bool,
    /// Only the standard preset with and without each decision about what the scene requires.
    #[arg(long, alias = "needs", conflicts_with = "quick")]
    pub ablations: bool,
    /// What counts as time in plot and ranking.
    #[arg(long, value_enum, default_value = "wall")]
    pub clock: Clock,
    /// Texels at which irradiance is compared with a reference.
    #[arg(long, value_name = "N", default_value_t = 500)]
    pub reference_texels: usize,
}

/// One reconstruction.
#[derive(Clone, Debug, Serialize)]
pub struct TradePoint {
    /// Preset.
    pub preset: String,
    /// Flags turned besides it.
    pub knobs: BTreeMap<String, String>,
    /// `preset`, `knob`, `without` (an approximation switched off) or `path`.
    pub kind: String,
    /// The approximation that this point does without.
    pub without: Option<String>,
    /// Cost and quality.
    #[serde(flatten)]
    pub outcome: Outcome,
    /// √(Σ‖E−E'‖²/Σ‖E'‖²) of the irradiance texture, looked up at the reference's texels. The
    /// reference is of the light that views show: missing light counts as error.
    pub irradiance_rmse: f64,
    /// Whether no faster point has as high a mean PSNR.
    pub pareto: bool,
}

/// Everything `unbake bench tradeoff` measures.
#[derive(Clone, Debug, Serialize)]
pub struct TradeoffReport {
    /// The points in the order they were run.
    pub points: Vec<TradePoint>,
    /// What counts as time.
    pub clock: Clock,
    /// What `pareto` compares.
    pub pareto_measure: String,
    /// The irradiance reference.
    pub reference: Reference,
    /// Versions.
    pub versions: Versions,
    /// The machine.
    pub machine: Machine,
    /// The scene.
    pub scene: SceneSummary,
}

/// Runs the sweep; `each` sees the report after every point, so that a later failure loses nothing.
///
/// # Errors
/// An unusable scene or a reconstruction that fails.
pub fn bench_tradeoff(
    scene: &Scene,
    runner: &Runner,
    bench: &TradeoffBench,
    options: &SolveOptions,
    progress: &Progress,
    each: &mut dyn FnMut(&TradeoffReport) -> Result<()>,
) -> Result<TradeoffReport> {
    let (reference, places) = irradiance_reference(scene, bench, options, progress)?;
    let mut report = TradeoffReport {
        points: Vec::new(),
        clock: bench.clock,
        pareto_measure:
            "time against the mean of albedo, roughness (FIPT protocol) and novel-view PSNR"
                .to_owned(),
        reference,
        versions: Versions::current(),
        machine: machine(),
        scene: SceneSummary::of(scene),
    };
    let plan = Plan::of(bench);
    progress.stage("reconstructions", plan.steps() as u64, |p| {
        let mut sweep = Sweep {
            runner,
            places: &places,
            progress: p,
            report: &mut report,
            each,
        };
        for point in plan.given() {
            sweep.run(point)?;
        }
        // two changes at least: one alone has been measured
        for n in 2..=plan.knobs.len() {
            let path = best_path(&sweep.report.points, bench.clock);
            if path.len() < n {
                break;
            }
            sweep.run(Planned::standard("path", path[..n].iter().cloned()))?;
        }
        Ok::<(), crate::Error>(())
    })?;
    Ok(report)
}

/// What a run of the benchmark tries.
struct Plan {
    presets: &'static [&'static str],
    knobs: &'static [(&'static str, &'static [&'static str])],
    left_out: Vec<&'static (&'static str, Flags)>,
}

impl Plan {
    fn of(bench: &TradeoffBench) -> Self {
        let (presets, knobs): (&[&str], _) = match (bench.ablations, bench.quick) {
            (true, _) => (&["standard"], &[][..]),
            (false, true) => (&PRESETS, QUICK),
            (false, false) => (&PRESETS, KNOBS),
        };
        let left_out = APPROXIMATIONS
            .iter()
            .filter(|_| !bench.ablations)
            .chain(NEEDS)
            .collect();
        Self {
            presets,
            knobs,
            left_out,
        }
    }

    /// Reconstructions at most, the best path's included.
    fn steps(&self) -> usize {
        let turned: usize = self.knobs.iter().map(|k| k.1.len()).sum();
        self.presets.len() + turned + self.left_out.len() + self.knobs.len()
    }

    /// The points that do not depend on what others show: presets, single knobs, what is left out.
    fn given(&self) -> Vec<Planned> {
        let mut points = Vec::new();
        for preset in self.presets {
            points.push(Planned {
                preset: (*preset).to_owned(),
                ..Planned::standard("preset", [])
            });
        }
        for (knob, values) in self.knobs {
            for value in *values {
                let turned = ((*knob).to_owned(), (*value).to_owned());
                points.push(Planned::standard("knob", [turned]));
            }
        }
        for (name, flags) in &self.left_out {
            let flags = flags
                .iter()
                .map(|(k, v)| ((*k).to_owned(), (*v).to_owned()));
            points.push(Planned {
                without: Some((*name).to_owned()),
                ..Planned::standard("without", flags)
            });
        }
        points
    }
}

/// A reconstruction to run: the fields of its [`TradePoint`].
struct Planned {
    kind: &'static str,
    preset: String,
    without: Option<String>,
    knobs: BTreeMap<String, String>,
}

impl Planned {
    /// From the preset `standard` with some flags.
    fn standard(kind: &'static str, knobs: impl IntoIterator<Item = (String, String)>) -> Self {
        Self {
            kind,
            preset: "standard".to_owned(),
            without: None,
            knobs: knobs.into_iter().collect(),
        }
    }

    fn flags(&self) -> Vec<String> {
        let mut flags = vec!["--quality".to_owned(), self.preset.clone()];
        for (k, v) in &self.knobs {
            flags.extend([format!("--{k}"), v.clone()]);
        }
        flags
    }
}

/// Runs planned points one after another into a report.
struct Sweep<'a> {
    runner: &'a Runner,
    /// Atlas coordinates of the reference's texels.
    places: &'a [Vec2],
    progress: &'a Progress,
    report: &'a mut TradeoffReport,
    /// Sees the report after every point.
    each: &'a mut dyn FnMut(&TradeoffReport) -> Result<()>,
}

impl Sweep<'_> {
    fn run(&mut self, planned: Planned) -> Result<()> {
        let report = &mut *self.report;
        let name = format!("point-{:03}", report.points.len());
        let (outcome, irradiance_rmse) = self.runner.run(&name, &planned.flags(), |out| {
            irradiance_error(out, self.places, &report.reference.value)
        })?;
        let point = TradePoint {
            preset: planned.preset,
            knobs: planned.knobs,
            kind: planned.kind.to_owned(),
            without: planned.without,
            outcome,
            irradiance_rmse,
            pareto: false,
        };
        self.progress.note(point.line(report.clock));
        report.points.push(point);
        mark_pareto(&mut report.points, report.clock);
        self.progress.advance(1);
        (self.each)(report)
    }
}

/// The reference irradiance and the atlas coordinates of its texels.
fn irradiance_reference(
    scene: &Scene,
    bench: &TradeoffBench,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<(Reference, Vec<Vec2>)> {
    let ground = BenchScene::prepare(scene, options, progress)?;
    let texels = &ground.light.texels;
    let reference = progress.stage("reference", 2 * bench.reference_texels as u64, |p| {
        reference(&ground, texels, bench.reference_texels, p)
    });
    let places = reference.ids.iter().map(|&i| centre(texels, i)).collect();
    Ok((reference, places))
}

fn centre(texels: &Texels, i: usize) -> Vec2 {
    let c = texels.cell[i] as usize;
    Vec2::new(
        (c % texels.width) as f32 + 0.5,
        (c / texels.width) as f32 + 0.5,
    ) / Vec2::new(texels.width as f32, texels.height as f32)
}

fn irradiance_error(out: &Path, places: &[Vec2], reference: &[Vec3]) -> Result<f64> {
    let plane = read_rgb(out.join("irradiance.exr"))?;
    let size = Vec2::new(plane.width as f32, plane.height as f32);
    let value: Vec<Vec3> = places
        .iter()
        .map(|&uv| plane.bilinear(uv * size, Wrap::Clamp))
        .collect();
    Ok(relative_errors(&value, reference).0)
}

impl TradePoint {
    /// Mean of the PSNRs there are.
    fn quality(&self) -> f64 {
        let o = &self.outcome;
        let all: Vec<f64> = [o.albedo_psnr, o.roughness_psnr, o.novel_psnr]
            .into_iter()
            .flatten()
            .collect();
        if all.is_empty() {
            0.0
        } else {
            all.iter().sum::<f64>() / all.len() as f64
        }
    }

    fn time(&self, clock: Clock) -> f64 {
        match clock {
            Clock::Wall => self.outcome.seconds,
            Clock::Processor => self.outcome.cpu_seconds / self.outcome.threads.max(1) as f64,
        }
    }

    fn name(&self) -> String {
        let knobs: Vec<String> = self.knobs.iter().map(|(k, v)| format!("{k} {v}")).collect();
        match &self.without {
            Some(name) => format!("{}, without {name}", self.preset),
            None if knobs.is_empty() => self.preset.clone(),
            None => format!("{}, {}", self.preset, knobs.join(", ")),
        }
    }

    fn line(&self, clock: Clock) -> String {
        let o = &self.outcome;
        let db = |v: Option<f64>| v.map_or("   --".to_owned(), |v| format!("{v:5.2}"));
        format!(
            "{}{:52} {:7.1} s {:5.2} GiB  albedo {}  roughness {}  novel {} dB  irradiance {:5.2} %",
            if self.pareto { "*" } else { " " },
            self.name(),
            self.time(clock),
            gibibytes(o.peak_bytes),
            db(o.albedo_psnr),
            db(o.roughness_psnr),
            db(o.novel_psnr),
            100.0 * self.irradiance_rmse
        )
    }
}

fn mark_pareto(points: &mut [TradePoint], clock: Clock) {
    let all: Vec<(f64, f64)> = points
        .iter()
        .map(|p| (p.time(clock), p.quality()))
        .collect();
    for (i, p) in points.iter_mut().enumerate() {
        let (s, q) = all[i];
        p.pareto = !all
            .iter()
            .enumerate()
            .any(|(j, &(t, r))| j != i && t <= s && r >= q && (t < s || r > q));
    }
}

/// Changes that save time, the one with the least loss of quality per second saved first; one value
/// per knob.
fn best_path(points: &[TradePoint], clock: Clock) -> Vec<(String, String)> {
    let Some(base) = points
        .iter()
        .find(|p| p.kind == "preset" && p.preset == "standard")
    else {
        return Vec::new();
    };
    let mut changes: Vec<(f64, &TradePoint)> = points
        .iter()
        .filter(|p| p.kind == "knob" && p.time(clock) < base.time(clock))
        .map(|p| {
            (
                (base.quality() - p.quality()) / (base.time(clock) - p.time(clock)),
                p,
            )
        })
        .collect();
    changes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut path: Vec<(String, String)> = Vec::new();
    for (_, p) in changes {
        for (k, v) in &p.knobs {
            if !path.iter().any(|(known, _)| known == k) {
                path.push((k.clone(), v.clone()));
            }
        }
    }
    path
}

impl TradeoffReport {
    /// The table of the terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        let m = &self.machine;
        // writing to a string cannot fail
        let _ = writeln!(
            out,
            "{}: {} views, {} threads of {}; irradiance against {} samples at {} texels; * = Pareto-optimal ({})",
            self.scene.name,
            self.scene.training_views,
            m.threads,
            m.cpu,
            self.reference.samples,
            self.reference.texels,
            self.pareto_measure
        );
        for p in &self.points {
            let _ = writeln!(out, "{}", p.line(self.clock));
        }
        let Some(base) = self.standard() else {
            return out;
        };
        for p in self.points.iter().filter(|p| p.kind == "without") {
            let _ = writeln!(
                out,
                "  {:52} saves {:+.1} s, {:+.2} GiB; costs {:+.2} dB in the mean of the PSNRs, {:+.2} points of irradiance error",
                p.without.as_deref().unwrap_or_default(),
                p.time(self.clock) - base.time(self.clock),
                gibibytes(p.outcome.peak_bytes) - gibibytes(base.outcome.peak_bytes),
                p.quality() - base.quality(),
                100.0 * (base.irradiance_rmse - p.irradiance_rmse)
            );
        }
        out
    }

    /// The point that everything is turned from.
    fn standard(&self) -> Option<&TradePoint> {
        self.points
            .iter()
            .find(|p| p.kind == "preset" && p.preset == "standard")
    }

    /// Every quality and memory against time, with the Pareto front as a line.
    ///
    /// # Errors
    /// The drawing library failing.
    pub fn plot(&self) -> Result<String> {
        let charts: Vec<Chart> = QUANTITIES.iter().map(|q| self.chart(q)).collect();
        svg(&charts)
    }

    /// One quantity against time.
    fn chart(&self, quantity: &Quantity) -> Chart {
        let place = |p: &TradePoint| (p.time(self.clock), (quantity.value)(p));
        let of = |keep: &dyn Fn(&TradePoint) -> bool| {
            let mut points: Vec<_> = self.points.iter().filter(|p| keep(p)).map(place).collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            points
        };
        let series = |name: &str, line, points| Series {
            name: name.to_owned(),
            points,
            line,
        };
        let mut all = vec![
            series("presets", false, of(&|p| p.kind == "preset")),
            series("one knob", false, of(&|p| p.kind == "knob")),
            series("best path", false, of(&|p| p.kind == "path")),
            series("Pareto front", true, of(&|p| p.pareto)),
        ];
        // each approximation's own line: from the preset with it to the same without it
        for p in self.points.iter().filter(|p| p.kind == "without") {
            let name = format!("without {}", p.without.as_deref().unwrap_or_default());
            let ends = self.standard().into_iter().chain([p]).map(place).collect();
            all.push(series(&name, true, ends));
        }
        let x = match self.clock {
            Clock::Wall => "seconds",
            Clock::Processor => "processor seconds per thread",
        };
        Chart {
            title: format!("{}: {}", self.scene.name, quantity.name),
            x: x.to_owned(),
            y: quantity.name.to_owned(),
            log_x: true,
            log_y: quantity.log,
            series: all,
        }
    }
}

/// What is drawn against time.
struct Quantity {
    name: &'static str,
    value: fn(&TradePoint) -> f64,
    /// Whether its axis is logarithmic.
    log: bool,
}

const QUANTITIES: [Quantity; 6] = [
    Quantity {
        name: "albedo PSNR, dB",
        value: |p| p.outcome.albedo_psnr.unwrap_or(f64::NAN),
        log: false,
    },
    Quantity {
        name: "roughness PSNR (FIPT), dB",
        value: |p| p.outcome.roughness_psnr.unwrap_or(f64::NAN),
        log: false,
    },
    Quantity {
        name: "novel-view PSNR, dB",
        value: |p| p.outcome.novel_psnr.unwrap_or(f64::NAN),
        log: false,
    },
    Quantity {
        name: "irradiance relative RMSE, %",
        value: |p| 100.0 * p.irradiance_rmse,
        log: true,
    },
    Quantity {
        name: "mean PSNR, dB",
        value: TradePoint::quality,
        log: false,
    },
    Quantity {
        name: "peak memory, GiB",
        value: |p| gibibytes(p.outcome.peak_bytes),
        log: false,
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    fn point(kind: &str, knob: Option<(&str, &str)>, seconds: f64, psnr: f64) -> TradePoint {
        TradePoint {
            preset: "standard".into(),
            knobs: knob
                .into_iter()
                .map(|(k, v)| (k.to_owned(), v.to_owned()))
                .collect(),
            kind: kind.into(),
            without: None,
            outcome: Outcome {
                seconds,
                novel_psnr: Some(psnr),
                ..Outcome::default()
            },
            irradiance_rmse: 0.01,
            pareto: false,
        }
    }

    #[test]
    fn only_points_that_nothing_beats_are_pareto_optimal() {
        let mut points = vec![
            point("knob", None, 1.0, 20.0),
            point("knob", None, 2.0, 19.0),
            point("knob", None, 3.0, 30.0),
        ];
        mark_pareto(&mut points, Clock::Wall);
        assert_eq!(
            points.iter().map(|p| p.pareto).collect::<Vec<_>>(),
            [true, false, true]
        );
    }

    #[test]
    fn the_best_path_begins_with_the_cheapest_saving_and_takes_one_value_per_knob() {
        let points = [
            point("preset", None, 100.0, 30.0),
            point("knob", Some(("a", "1")), 50.0, 29.0),
            point("knob", Some(("b", "1")), 90.0, 29.9),
            point("knob", Some(("b", "2")), 80.0, 29.9),
            point("knob", Some(("c", "1")), 120.0, 31.0),
        ];
        let path = best_path(&points, Clock::Wall);
        assert_eq!(
            path,
            [
                ("b".to_owned(), "2".to_owned()),
                ("a".to_owned(), "1".to_owned())
            ]
        );
    }
}
