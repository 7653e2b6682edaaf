//! The pictures of `bench tables` side by side, as the paper's figures have them: a folder with a page and a picture per row and kind,
//! which keeps what is there already.

use super::table_rows::{TableRow, TablesReport, decibels, scene_name};
use crate::core::formats::{atomic_write, read_plane, read_rgb};
use crate::core::memory::gibibytes;
use crate::error::{Error, Result};
use crate::programs::evaluate::true_materials;
use crate::programs::report::{
    Picture, QUALITY, colour, display_gain, encode_jpeg, exposed, grey, head, shrunk,
};
use crate::scene::{Scene, Split, View};
use maud::{DOCTYPE, Markup, html};
use std::path::{Path, PathBuf};

/// Largest width of a picture.
const WIDTH: usize = 640;
/// Names of the pictures' kinds, in their order.
const KINDS: [&str; 3] = ["view", "albedo", "roughness"];

const STYLE: &str = ":root{color-scheme:light dark}body{font:15px/1.4 system-ui,sans-serif;margin:1rem}table{border-collapse:collapse}\
th,td{padding:.2rem .5rem;text-align:right;vertical-align:middle}th:first-child,td:first-child{text-align:left}\
tr+tr td{border-top:1px solid #8886}td:not(:first-child){white-space:nowrap}img{width:min(18rem,18vw);display:block}.none{color:#888}";

/// Where the page and its pictures go.
pub(super) struct TablePage<'a> {
    /// The folder; made if need be.
    pub folder: &'a Path,
}

impl TablePage<'_> {
    /// Keeps what a scored reconstruction shows of the scene's first held-out view.
    ///
    /// # Errors
    /// Images of the evaluation that cannot be read, or pictures that cannot be written.
    pub(super) fn keep(&self, scene: &Scene, row: &TableRow, out: &Path) -> Result<()> {
        let Some(view) = shown(scene) else {
            return Ok(());
        };
        let gain = display_gain(&scene.load_radiance(view)?);
        let image = |kind: &str| out.join("eval").join(format!("{}.{kind}.exr", view.stem));
        let pictures = [
            exposed(&shrunk(&read_rgb(image("render"))?, WIDTH), gain),
            colour(&shrunk(&read_rgb(image("albedo"))?, WIDTH)),
            grey(&shrunk(&read_plane(image("roughness"))?, WIDTH)),
        ];
        self.write_pictures(&key(row), &pictures)
    }

    /// Keeps the photograph and the true materials of the scene's first held-out view.
    ///
    /// # Errors
    /// As [`Self::keep`].
    pub(super) fn keep_truth(&self, scene: &Scene) -> Result<()> {
        let Some(view) = shown(scene) else {
            return Ok(());
        };
        let photograph = scene.load_radiance(view)?;
        let gain = display_gain(&photograph);
        let mut pictures = vec![exposed(&shrunk(&photograph, WIDTH), gain)];
        if let Some(truth) = true_materials(scene, view)? {
            pictures.push(colour(&shrunk(&truth.albedo, WIDTH)));
            pictures.push(grey(&shrunk(&truth.roughness, WIDTH)));
        }
        self.write_pictures(&format!("{}-truth", slug(&scene_name(scene))), &pictures)
    }

    fn write_pictures(&self, key: &str, pictures: &[Picture]) -> Result<()> {
        let folder = self.folder.join("pictures");
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        for (kind, picture) in KINDS.iter().zip(pictures) {
            let path = self.folder.join(file(key, kind));
            atomic_write(path, &encode_jpeg(picture, QUALITY)?)?;
        }
        Ok(())
    }

    /// Writes the page of all rows, with the pictures that are there.
    ///
    /// # Errors
    /// A page that cannot be written.
    pub(super) fn write(&self, report: &TablesReport) -> Result<()> {
        let scenes = distinct(report.rows.iter().map(|r| r.scene.as_str()));
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                (head("unbake bench tables", STYLE))
                body {
                    h1 { "The paper’s tables" }
                    p { "Pictures: the first held-out view at the photograph’s exposure, albedo in sRGB, roughness as grey (black 0, white 1)." }
                    @for scene in scenes { (self.scene_section(scene, report)) }
                }
            }
        };
        atomic_write(
            self.folder.join("index.html"),
            page.into_string().as_bytes(),
        )
    }

    fn scene_section(&self, scene: &str, report: &TablesReport) -> Markup {
        let rows: Vec<&TableRow> = report.rows.iter().filter(|r| r.scene == scene).collect();
        let tables = distinct(rows.iter().map(|r| r.table.as_str()));
        let heads = ["", "albedo", "roughness", "views", "SSIM", "time", "memory"];
        html! {
            h2 { (scene) }
            @for table in tables {
                h3 { (table) }
                table {
                    thead { tr { @for head in heads.iter().chain(&KINDS) { th { (head) } } } }
                    tbody {
                        tr {
                            td { "photograph, truth" }
                            @for _ in 1..heads.len() { td {} }
                            (self.cells(&format!("{}-truth", slug(scene))))
                        }
                        @for row in rows.iter().filter(|r| r.table == table) { (self.row(row)) }
                    }
                }
            }
        }
    }

    fn row(&self, row: &TableRow) -> Markup {
        let name = match row.condition.as_str() {
            "" => row.method.name().to_owned(),
            condition => format!("{}, {condition}", row.method.name()),
        };
        html! {
            tr {
                td { (name) }
                @for value in [row.albedo_psnr, row.roughness_psnr, row.nvs_psnr] { td { (decibels(value)) } }
                td { (row.nvs_ssim.map_or_else(|| "–".into(), |s| format!("{s:.4}"))) }
                td { (format!("{:.0} s", row.seconds)) }
                td { (format!("{:.2} GiB", gibibytes(row.peak_bytes))) }
                (self.cells(&key(row)))
            }
        }
    }

    fn cells(&self, key: &str) -> Markup {
        html! {
            @for kind in KINDS {
                @let source = file(key, kind);
                td {
                    @if self.folder.join(&source).exists() { img src=(source.display()) alt={ (key) " " (kind) } loading="lazy"; }
                    @else { span .none { "–" } }
                }
            }
        }
    }
}

/// Each name once, in the order of their first: a resumed run comes back to a scene and a table.
fn distinct<'a>(names: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut out = Vec::new();
    for name in names {
        if !out.contains(&name) {
            out.push(name);
        }
    }
    out
}

/// The view that the page shows: the first held out, else the first.
fn shown(scene: &Scene) -> Option<&View> {
    let held_out = scene.views.iter().find(|v| v.split == Split::Test);
    held_out.or_else(|| scene.views.first())
}

/// A picture's file, relative to the page.
fn file(key: &str, kind: &str) -> PathBuf {
    Path::new("pictures").join(format!("{key}-{kind}.jpg"))
}

/// What tells a row's pictures from all others'.
fn key(row: &TableRow) -> String {
    slug(&format!(
        "{}-{}-{}-{}",
        row.scene,
        row.table,
        row.method.name(),
        row.condition
    ))
}

/// Letters and digits, all else as hyphens.
fn slug(text: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
    text.chars().map(plain).collect()
}

#[cfg(test)]
mod tests {
    use super::super::table_rows::Method;
    use super::*;

    #[test]
    fn a_name_that_comes_back_stands_once() {
        assert_eq!(distinct(["a", "b", "a"].into_iter()), ["a", "b"]);
    }

    #[test]
    fn the_page_shows_the_pictures_that_are_there() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let page = TablePage {
            folder: folder.path(),
        };
        let row = |method, condition: &str| TableRow {
            table: "methods".into(),
            method,
            scene: "a room".into(),
            condition: condition.into(),
            albedo_psnr: Some(20.25),
            ..TableRow::default()
        };
        let report = TablesReport {
            rows: vec![row(Method::Paper, ""), row(Method::Neilf, "as <compared>")],
        };
        let grey = Picture {
            width: 8,
            height: 4,
            rgb: vec![128; 96],
        };
        let pictures = [grey.clone(), grey.clone(), grey];
        page.write_pictures(&key(&report.rows[1]), &pictures)
            .expect("writes");
        page.write(&report).expect("writes");
        let text = std::fs::read_to_string(folder.path().join("index.html")).expect("reads");
        let sources: Vec<&str> = text
            .split("src=\"")
            .skip(1)
            .filter_map(|s| s.split('"').next())
            .collect();
        assert_eq!(sources.len(), 3, "{sources:?}");
        for source in sources {
            assert!(folder.path().join(source).is_file(), "{source}");
        }
        assert!(text.contains("as &lt;compared&gt;") && text.contains("20.25"));
    }
}
