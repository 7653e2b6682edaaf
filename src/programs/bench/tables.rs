//! `unbake bench tables`: the paper's tables on scenes with truth. Every row is a reconstruction in
//! a process of its own: unbake's method, the published one (`solve --quality paper`) and the
//! systems it is compared with (`--strategy`), with and without the comparison's faults; the
//! published one's stages left out, its light replaced, its weaknesses corrected one by one; ours
//! and the published one under wrong labels.

use super::child::{Outcome, Runner, Workplace};
use super::damage::{CONDITIONS, Damage, write_damaged};
use super::table_page::TablePage;
use super::table_rows::{Method, TableRow, TablesReport, scene_name};
use crate::core::formats::atomic_write;
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::programs::evaluate::EvalOptions;
use crate::scene::Scene;
use std::path::{Path, PathBuf};

/// What `unbake bench tables` can be told.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct TablesBench {
    /// Smaller textures and cubes, 256 hemisphere rays, 10 to 20 epochs, two sizes of wrong labels, three
    /// held-out views of single rays: a look at the order of things in a quarter of an hour.
    #[arg(long)]
    pub quick: bool,
    /// Only rows whose table, method or condition holds one of these words, separated by commas.
    #[arg(long, value_name = "WORDS", value_delimiter = ',')]
    pub rows: Vec<String>,
    /// Also write the rows as comma-separated values.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Also write a page with the pictures of all rows side by side into a folder, which keeps those that are there.
    #[arg(long, value_name = "FOLDER")]
    pub page: Option<PathBuf>,
    /// Flags for every `unbake solve`, as one string.
    #[arg(
        long,
        value_name = "FLAGS",
        default_value = "",
        allow_hyphen_values = true
    )]
    pub solve_flags: String,
}

impl Method {
    /// The systems that the published method is compared with.
    const COMPARED: [Self; 5] = [
        Self::Invrender,
        Self::Nvdiffrec,
        Self::Neilf,
        Self::NeilfStar,
        Self::Tsdr,
    ];

    /// The flags of `solve` that choose it.
    fn flags(self) -> &'static [&'static str] {
        match self {
            Self::Unbake => &[],
            Self::Paper => &["--quality", "paper"],
            Self::Invrender => &["--quality", "paper", "--strategy", "invrender"],
            Self::Nvdiffrec => &["--quality", "paper", "--strategy", "nvdiffrec"],
            Self::Neilf => &["--quality", "paper", "--strategy", "neilf"],
            Self::NeilfStar => &["--quality", "paper", "--strategy", "neilf-star"],
            Self::Tsdr => &["--quality", "paper", "--strategy", "tsdr"],
        }
    }

    /// Epochs, and pixels of a visit, of a quick look: about as much time for each (measured on the
    /// scenes of docs/lab/published.md).
    fn quick_flags(self) -> &'static [&'static str] {
        match self {
            Self::Unbake => &[],
            Self::Paper => &["--epochs", "10"],
            Self::Invrender => &["--epochs", "20", "--visit-pixels", "256"],
            Self::Nvdiffrec => &["--epochs", "20", "--visit-pixels", "1024"],
            Self::Neilf => &["--epochs", "10", "--visit-pixels", "256"],
            Self::NeilfStar => &["--epochs", "10", "--visit-pixels", "64"],
            Self::Tsdr => &["--epochs", "20", "--visit-pixels", "1024"],
        }
    }
}

/// Writes what is asked for beside the JSON file.
fn write(report: &TablesReport, bench: &TablesBench) -> Result<()> {
    if let Some(path) = &bench.csv {
        atomic_write(path, report.csv().as_bytes())?;
    }
    if let Some(folder) = &bench.page {
        TablePage { folder }.write(report)?;
    }
    Ok(())
}

/// A row to run.
struct Planned {
    table: &'static str,
    method: Method,
    condition: String,
    flags: Vec<&'static str>,
    damage: Damage,
}

impl Planned {
    fn new(table: &'static str, method: Method, condition: &str, flags: &[&'static str]) -> Self {
        Self {
            table,
            method,
            condition: condition.to_owned(),
            flags: flags.to_vec(),
            damage: Damage::Clean,
        }
    }

    /// All `solve` flags of the row.
    fn all_flags(&self, bench: &TablesBench) -> Vec<String> {
        let given: Vec<&str> = bench.solve_flags.split_whitespace().collect();
        let mut quick: Vec<&str> = Vec::new();
        if bench.quick {
            quick.extend(["--albedo-size", "512", "--roughness-size", "512"]);
            quick.extend(["--irradiance-size", "256"]);
            quick.extend(self.method.quick_flags());
            if self.method != Method::Unbake {
                quick.extend(["--irradiance-rays", "256", "--face-pixels", "24"]);
            }
        }
        let mut all: Vec<&str> = self.method.flags().to_vec();
        // pairs of flag and value, but for those that the user gives
        all.extend(
            quick
                .chunks(2)
                .filter(|pair| !given.contains(&pair[0]))
                .flatten(),
        );
        all.extend(&self.flags);
        all.extend(given);
        all.into_iter().map(str::to_owned).collect()
    }

    /// The row of a scene before it is run.
    fn row(&self, scene: &str, flags: &[String], bench: &TablesBench) -> TableRow {
        TableRow {
            table: self.table.to_owned(),
            method: self.method,
            scene: scene.to_owned(),
            condition: self.condition.clone(),
            flags: flags.join(" "),
            eval_flags: if bench.quick {
                QUICK_EVAL.words()
            } else {
                String::new()
            },
            ..TableRow::default()
        }
    }

    fn wanted(&self, bench: &TablesBench) -> bool {
        let named = [self.table, self.method.name(), &self.condition];
        bench.rows.is_empty()
            || bench
                .rows
                .iter()
                .any(|w| named.iter().any(|n| n.contains(w.as_str())))
    }
}

/// How a quick look is scored.
struct QuickEval {
    views: usize,
    supersampling: u32,
}

const QUICK_EVAL: QuickEval = QuickEval {
    views: 3,
    supersampling: 1,
};

impl QuickEval {
    fn words(&self) -> String {
        format!(
            "--views {} --supersampling {}",
            self.views, self.supersampling
        )
    }
}

impl TablesBench {
    /// How rows are scored, `given` otherwise.
    #[must_use]
    pub fn evaluation(&self, given: &EvalOptions) -> EvalOptions {
        if !self.quick {
            return given.clone();
        }
        EvalOptions {
            views: Some(QUICK_EVAL.views),
            supersampling: Some(QUICK_EVAL.supersampling),
            no_report: true,
            ..given.clone()
        }
    }
}

/// Every row, in the order of the tables. `quick`: the sizes of wrong labels between which the
/// published table breaks, and fewer epochs of the neural field.
fn plan(quick: bool) -> Vec<Planned> {
    let paper = |table, condition: &str, flags: &[&'static str]| {
        Planned::new(table, Method::Paper, condition, flags)
    };
    let mut rows = vec![
        Planned::new("methods", Method::Unbake, "", &[]),
        paper("methods", "", &[]),
        paper("methods", "code's values", &["--published-values", "code"]),
        paper("methods", "post-processed", &["--post-process"]),
    ];
    for method in Method::COMPARED {
        rows.push(Planned::new("methods", method, "", &[]));
    }
    for method in [Method::Invrender, Method::Nvdiffrec, Method::Neilf] {
        let flags = &["--handicapped"];
        rows.push(Planned::new("methods", method, "as compared", flags));
    }
    rows.extend([
        paper("stages", "baseline: III alone", &["--stages", "iii"]),
        paper("stages", "without I", &["--stages", "ii,iii"]),
        paper("stages", "without II", &["--stages", "i,iii"]),
        paper("stages", "without III", &["--stages", "i,ii"]),
        paper(
            "lighting",
            "TBL, 16 rays a step",
            &["--light-samples", "16"],
        ),
        paper(
            "lighting",
            "NIrF",
            &["--nirf", if quick { "60" } else { "2000" }],
        ),
        paper("lighting", "IrT", &[]),
        paper("lighting", "IrT, emitters sampled", &["--correct", "w5"]),
    ]);
    for w in ["w1", "w2", "w3", "w5", "w6", "w7", "w8"] {
        rows.push(paper("corrections", w, &["--correct", w]));
    }
    rows.push(paper(
        "corrections",
        "all",
        &["--correct", "w1,w2,w3,w5,w6,w7,w8"],
    ));
    for (name, damage) in CONDITIONS {
        let in_table = match damage {
            Damage::Clean => true,
            Damage::LabelSquares(side) => !quick || [64, 256].contains(side),
            _ => false,
        };
        if in_table {
            for method in [Method::Unbake, Method::Paper] {
                rows.push(Planned {
                    damage: *damage,
                    ..Planned::new("labels", method, name, &[])
                });
            }
        }
    }
    rows
}

/// Runs the rows that `found` lacks; `each` sees the report after every one.
///
/// # Errors
/// A scene that cannot be copied, or a reconstruction that fails.
pub fn bench_tables(
    scenes: &[Scene],
    bench: &TablesBench,
    work: &Workplace,
    found: TablesReport,
    progress: &Progress,
    each: &mut dyn FnMut(&TablesReport) -> Result<()>,
) -> Result<TablesReport> {
    let mut report = found;
    std::fs::create_dir_all(&work.folder).map_err(|e| Error::io(&work.folder, e))?;
    let rows: Vec<Planned> = plan(bench.quick)
        .into_iter()
        .filter(|r| r.wanted(bench))
        .collect();
    let steps = (rows.len() * scenes.len()) as u64;
    progress.stage("rows", steps, |p| {
        for scene in scenes {
            let name = scene_name(scene);
            if let Some(folder) = &bench.page {
                TablePage { folder }.keep_truth(scene)?;
            }
            for planned in &rows {
                let flags = planned.all_flags(bench);
                let row = planned.row(&name, &flags, bench);
                if report.rows.iter().any(|r| r.is_of_the_run_of(&row)) {
                    // an earlier run, or one that was interrupted, has it
                } else if let Some(same) = report.rows.iter().find(|r| r.is_as(&row)) {
                    let row = TableRow {
                        table: row.table,
                        condition: row.condition,
                        ..same.clone()
                    };
                    report.rows.push(row);
                    each(&report)?;
                } else {
                    let run = work.within(&format!("{name}-{}", report.rows.len()));
                    let outcome = run_row(scene, planned, &flags, &run, |out| match &bench.page {
                        Some(folder) => TablePage { folder }.keep(scene, &row, out),
                        None => Ok(()),
                    })?;
                    report.rows.push(scored(row, &outcome));
                    write(&report, bench)?;
                    each(&report)?;
                }
                p.advance(1);
            }
        }
        write(&report, bench)
    })?;
    Ok(report)
}

/// One reconstruction of the scene, or of its damaged copy; `look` sees its scored result.
fn run_row(
    scene: &Scene,
    planned: &Planned,
    flags: &[String],
    work: &Workplace,
    look: impl FnOnce(&Path) -> Result<()>,
) -> Result<Outcome> {
    let copy = work.folder.with_extension("scene");
    let source = if planned.damage == Damage::Clean {
        scene.folder.clone()
    } else {
        // the same squares in every run
        write_damaged(scene, planned.damage, 0, &copy)?;
        copy.clone()
    };
    let runner: Runner = work.runner(&source)?;
    let outcome = runner.run("out", flags, look);
    if !work.keep && copy.exists() {
        std::fs::remove_dir_all(&copy).map_err(|e| Error::io(&copy, e))?;
    }
    Ok(outcome?.0)
}

/// The row with what its run cost and gave.
fn scored(row: TableRow, outcome: &Outcome) -> TableRow {
    TableRow {
        albedo_psnr: outcome.albedo_psnr,
        roughness_psnr: outcome.roughness_psnr,
        nvs_psnr: outcome.novel_psnr,
        nvs_ssim: outcome.novel_ssim,
        // the PSNR is that of the mean squared error, of peak 1
        nvs_mse: outcome.novel_psnr.map(|p| 10f64.powf(-0.1 * p)),
        seconds: outcome.seconds,
        peak_bytes: outcome.peak_bytes,
        ..row
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_choose_rows_and_no_two_rows_are_the_same() {
        let all = plan(false);
        let of = |words: &[&str]| {
            let bench = TablesBench {
                rows: words.iter().map(|w| (*w).to_owned()).collect(),
                ..TablesBench::default()
            };
            all.iter().filter(|r| r.wanted(&bench)).count()
        };
        assert_eq!(of(&[]), all.len());
        assert_eq!(of(&["stages"]), 4);
        assert_eq!(of(&["methods"]), 12);
        assert_eq!(of(&["lighting"]), 4);
        assert_eq!(of(&["neilf"]), 3);
        assert_eq!(of(&["labels-16"]), 2);
        let own = TablesBench {
            quick: true,
            solve_flags: "--epochs 3".into(),
            ..TablesBench::default()
        };
        let flags = all[1].all_flags(&own);
        assert_eq!(flags.iter().filter(|f| *f == "--epochs").count(), 1);
        assert!(
            flags.ends_with(&["--epochs".into(), "3".into()]),
            "{flags:?}"
        );
        let quick = TablesBench {
            quick: true,
            ..TablesBench::default()
        };
        let mut seen: Vec<_> = all
            .iter()
            .map(|r| (r.table, r.condition.clone(), r.all_flags(&quick)))
            .collect();
        seen.sort();
        seen.dedup();
        assert_eq!(seen.len(), all.len());
    }
}
