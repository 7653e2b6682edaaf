//! The rows of `bench tables`: what they hold, and as text, JSON and comma-separated values.

use crate::core::memory::gibibytes;
use crate::error::{Error, Result};
use crate::scene::Scene;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::path::Path;

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
    /// Flags of `eval`.
    #[serde(default)]
    pub eval_flags: String,
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

impl TableRow {
    /// Whether both are of the same reconstruction.
    pub(super) fn is_of_the_run_of(&self, other: &Self) -> bool {
        self.method == other.method
            && self.table == other.table
            && self.condition == other.condition
            && self.is_as(other)
    }

    /// Whether both are of the same scene, under the same damage, by the same flags: then one run
    /// tells of both, whatever tables they are in.
    pub(super) fn is_as(&self, other: &Self) -> bool {
        let damaged = |row: &Self| {
            let damaged = row.table == "labels" && row.condition != "clean";
            damaged.then(|| row.condition.clone())
        };
        self.scene == other.scene
            && self.flags == other.flags
            && self.eval_flags == other.eval_flags
            && damaged(self) == damaged(other)
    }
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
                gibibytes(row.peak_bytes)
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
}

/// A score, or a dash where there is none.
pub(super) fn decibels(score: Option<f64>) -> String {
    score.map_or_else(|| "--".to_owned(), |v| format!("{v:.2}"))
}

/// The folder's name: what people call a scene.
pub(super) fn scene_name(scene: &Scene) -> String {
    let named = scene.folder.canonicalize().ok();
    named
        .as_deref()
        .and_then(Path::file_name)
        .map_or("scene".into(), |n| n.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_run_tells_of_all_rows_that_ask_for_the_same() {
        let of = |table: &str, condition: &str, flags: &str| TableRow {
            table: table.into(),
            condition: condition.into(),
            flags: flags.into(),
            ..TableRow::default()
        };
        let clean = of("methods", "", "--a");
        assert!(
            clean.is_as(&of("lighting", "IrT", "--a"))
                && clean.is_as(&of("labels", "clean", "--a"))
        );
        assert!(!clean.is_as(&of("methods", "", "--b")));
        assert!(!clean.is_as(&of("labels", "labels-64", "--a")));
        assert!(!of("labels", "labels-16", "--a").is_as(&of("labels", "labels-64", "--a")));
        let elsewhere = TableRow {
            scene: "other".into(),
            ..clean.clone()
        };
        assert!(!clean.is_as(&elsewhere));
        assert!(!clean.is_of_the_run_of(&of("lighting", "IrT", "--a")));
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
