//! `unbake bench tables`: the paper's tables on scenes with truth. Every row is a reconstruction in
//! a process of its own: unbake's method, the published one (`solve --quality paper`) and the
//! systems it is compared with (`--strategy`), with and without the comparison's faults; the
//! published one's stages left out, its light replaced, its weaknesses corrected one by one; ours
//! and the published one under wrong labels.

use super::child::{Outcome, Runner, Workplace};
use super::damage::{CONDITIONS, Damage, write_damaged};
use super::table_page::TablePage;
use crate::core::formats::atomic_write;
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::scene::Scene;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// What `unbake bench tables` can be told.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct TablesBench {
    /// Smaller textures, 256 hemisphere rays and 10 to 20 epochs: a look at the order of things.
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

/// Who reconstructs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// unbake's own method.
    #[default]
    Unbake,
    /// The published method.
    Paper,
    /// A sparse code of materials.
    Invrender,
    /// A hash grid.
    Nvdiffrec,
    /// A network of sines.
    Neilf,
    /// The same with its own light.
    NeilfStar,
    /// Differentiable path tracing.
    Tsdr,
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

    /// What a table calls it.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Unbake => "unbake",
            Self::Paper => "paper",
            Self::Invrender => "invrender",
            Self::Nvdiffrec => "nvdiffrec",
            Self::Neilf => "neilf",
            Self::NeilfStar => "neilf_star",
            Self::Tsdr => "tsdr",
        }
    }

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

    /// Epochs, and pixels of a visit, of a quick look: about as much time for each.
    fn quick_flags(self) -> &'static [&'static str] {
        match self {
            Self::Unbake => &[],
            Self::Paper => &["--epochs", "10"],
            Self::Invrender => &["--epochs", "20", "--visit-pixels", "4096"],
            Self::Nvdiffrec => &["--epochs", "20", "--visit-pixels", "16384"],
            Self::Neilf => &["--epochs", "10", "--visit-pixels", "4096"],
            Self::NeilfStar => &["--epochs", "10", "--visit-pixels", "1024"],
            Self::Tsdr => &["--epochs", "20", "--visit-pixels", "8192"],
        }
    }
}

/// One reconstruction.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct TableRow {
    /// `methods`, `stages`, `lighting`, `corrections` or `labels`.
    pub table: String,
    /// Who reconstructs.
    pub method: Method,
    /// Name of the scene.
    pub scene: String,
    /// What differs from the method as it is; empty if nothing does.
    pub condition: String,
    /// Flags of `solve`.
    pub flags: String,
    /// Albedo PSNR of held-out views, no alignment, dB.
    pub albedo_psnr: Option<f64>,
    /// Roughness PSNR of held-out views, FIPT's protocol, dB.
    pub roughness_psnr: Option<f64>,
    /// PSNR of held-out views, dB.
    pub nvs_psnr: Option<f64>,
    /// SSIM of held-out views.
    pub nvs_ssim: Option<f64>,
    /// Mean squared error of held-out views.
    pub nvs_mse: Option<f64>,
    /// Wall time of `solve`.
    pub seconds: f64,
    /// Its largest resident size.
    pub peak_bytes: u64,
}

/// All rows.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct TablesReport {
    /// In the order they were run.
    pub rows: Vec<TableRow>,
}

impl TablesReport {
    /// The rows of an earlier run.
    ///
    /// # Errors
    /// A file that cannot be read or holds something else.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
        serde_json::from_slice(&bytes).map_err(|e| {
            Error::input(
                path,
                format!("holds no rows of `bench tables` ({e}); name another file"),
            )
        })
    }

    /// The tables as text.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        let mut table = ("", "");
        for row in &self.rows {
            if table != (row.table.as_str(), row.scene.as_str()) {
                table = (&row.table, &row.scene);
                // writing to a string cannot fail
                let _ = writeln!(
                    out,
                    "{}, {}: albedo, roughness (FIPT), views in dB; seconds; GiB",
                    row.table, row.scene
                );
            }
            let _ = writeln!(
                out,
                "  {:10} {:24} {:>5}  {:>5}  {:>5}  {:8.1}  {:5.2}",
                row.method.name(),
                row.condition,
                decibels(row.albedo_psnr),
                decibels(row.roughness_psnr),
                decibels(row.nvs_psnr),
                row.seconds,
                row.peak_bytes as f64 / (1u64 << 30) as f64
            );
        }
        out
    }

    /// The rows as comma-separated values (RFC 4180) below their names; what was not scored is empty.
    #[must_use]
    pub fn csv(&self) -> String {
        let mut out = String::from(
            "table,method,scene,condition,flags,albedo_psnr,roughness_psnr,nvs_psnr,nvs_ssim,nvs_mse,seconds,peak_bytes\r\n",
        );
        let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
        let number = |x: Option<f64>| x.map_or_else(String::new, |x| x.to_string());
        for r in &self.rows {
            let cells = [
                quoted(&r.table),
                r.method.name().into(),
                quoted(&r.scene),
                quoted(&r.condition),
                quoted(&r.flags),
                number(r.albedo_psnr),
                number(r.roughness_psnr),
                number(r.nvs_psnr),
                number(r.nvs_ssim),
                number(r.nvs_mse),
                r.seconds.to_string(),
                r.peak_bytes.to_string(),
            ];
            out += &cells.join(",");
            out += "\r\n";
        }
        out
    }

    /// Writes what is asked for beside the JSON file.
    fn write(&self, bench: &TablesBench) -> Result<()> {
        if let Some(path) = &bench.csv {
            atomic_write(path, self.csv().as_bytes())?;
        }
        if let Some(folder) = &bench.page {
            TablePage { folder }.write(self)?;
        }
        Ok(())
    }
}

/// A score, or a dash where there is none.
pub(super) fn decibels(score: Option<f64>) -> String {
    score.map_or_else(|| "--".to_owned(), |v| format!("{v:.2}"))
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
                quick.extend(["--irradiance-rays", "256"]);
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

    fn wanted(&self, bench: &TablesBench) -> bool {
        let named = [self.table, self.method.name(), &self.condition];
        bench.rows.is_empty()
            || bench
                .rows
                .iter()
                .any(|w| named.iter().any(|n| n.contains(w.as_str())))
    }
}

/// Every row, in the order of the tables.
fn plan() -> Vec<Planned> {
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
        paper("lighting", "NIrF of 200 epochs", &["--nirf", "200"]),
        paper("lighting", "emitters sampled", &["--correct", "w5"]),
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
        if matches!(damage, Damage::LabelSquares(_)) {
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
    let rows: Vec<Planned> = plan().into_iter().filter(|r| r.wanted(bench)).collect();
    let steps = (rows.len() * scenes.len()) as u64;
    progress.stage("rows", steps, |p| {
        for scene in scenes {
            let name = scene_name(scene);
            if let Some(folder) = &bench.page {
                TablePage { folder }.keep_truth(scene)?;
            }
            for planned in &rows {
                let flags = planned.all_flags(bench);
                let known = |r: &TableRow| {
                    (&r.table, &r.scene, &r.condition, &r.flags)
                        == (
                            &planned.table.to_owned(),
                            &name,
                            &planned.condition,
                            &flags.join(" "),
                        )
                        && r.method == planned.method
                };
                if !report.rows.iter().any(known) {
                    let run = format!("{name}-{}", report.rows.len());
                    let page = bench.page.as_deref();
                    let outcome = run_row(scene, planned, &flags, &work.within(&run), page)?;
                    report.rows.push(row(planned, &name, &flags, &outcome));
                    report.write(bench)?;
                    each(&report)?;
                }
                p.advance(1);
            }
        }
        report.write(bench)
    })?;
    Ok(report)
}

/// The folder's name: what people call a scene.
pub(super) fn scene_name(scene: &Scene) -> String {
    let named = scene.folder.canonicalize().ok();
    named
        .as_deref()
        .and_then(Path::file_name)
        .map_or("scene".into(), |n| n.to_string_lossy().into_owned())
}

/// One reconstruction of the scene, or of its damaged copy.
fn run_row(
    scene: &Scene,
    planned: &Planned,
    flags: &[String],
    work: &Workplace,
    page: Option<&Path>,
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
    let named = row(planned, &scene_name(scene), flags, &Outcome::default());
    let outcome = runner.run("out", flags, |out| match page {
        Some(folder) => TablePage { folder }.keep(scene, &named, out),
        None => Ok(()),
    });
    if !work.keep && copy.exists() {
        std::fs::remove_dir_all(&copy).map_err(|e| Error::io(&copy, e))?;
    }
    Ok(outcome?.0)
}

fn row(planned: &Planned, scene: &str, flags: &[String], outcome: &Outcome) -> TableRow {
    TableRow {
        table: planned.table.to_owned(),
        method: planned.method,
        scene: scene.to_owned(),
        condition: planned.condition.clone(),
        flags: flags.join(" "),
        albedo_psnr: outcome.albedo_psnr,
        roughness_psnr: outcome.roughness_psnr,
        nvs_psnr: outcome.novel_psnr,
        nvs_ssim: outcome.novel_ssim,
        // the PSNR is that of the mean squared error, of peak 1
        nvs_mse: outcome.novel_psnr.map(|p| 10f64.powf(-0.1 * p)),
        seconds: outcome.seconds,
        peak_bytes: outcome.peak_bytes,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_choose_rows_and_no_two_rows_are_the_same() {
        let all = plan();
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

    #[test]
    fn rows_come_back_from_their_file() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("rows.json");
        let report = TablesReport {
            rows: vec![TableRow {
                table: "methods".into(),
                method: Method::Paper,
                scene: "s".into(),
                albedo_psnr: Some(20.25),
                ..TableRow::default()
            }],
        };
        std::fs::write(&path, serde_json::to_vec(&report).expect("JSON")).expect("writes");
        let back = TablesReport::read(&path).expect("reads");
        assert_eq!(back.text(), report.text());
        assert!(report.text().contains("20.25"));
        let csv = report.csv();
        assert_eq!(csv.lines().count(), 2);
        let cells = csv.lines().map(|l| l.split(',').count());
        assert_eq!(cells.collect::<Vec<_>>(), [12, 12], "{csv}");
        assert!(
            csv.contains("\"methods\",paper,\"s\",\"\",\"\",20.25,,"),
            "{csv}"
        );
        std::fs::write(&path, "[1]").expect("writes");
        let error = TablesReport::read(&path).expect_err("no rows").to_string();
        assert!(error.contains("rows.json") && error.contains("name another file"));
    }
}
