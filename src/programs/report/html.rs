//! `report.html`: one self-contained page with the figures, pictures and plots of a run.
//!
//! Style, script and pictures are embedded; nothing is fetched. The page follows the reader's light
//! or dark preference and works without the script (the comparison slider then stands at the
//! middle). The markup is written with `maud`, which escapes every text it is given.

use super::jpeg::{Picture, QUALITY, encode_jpeg};
use super::pictures::{CONFIDENCE_RANGE, Captioned, ERROR_RANGE, ViewPictures, inferno};
use super::record::{RunRecord, StageRecord};
use crate::Result;
use crate::core::formats::grouped;
use crate::core::memory::written_bytes;
use crate::core::parallel::prelude::*;
use crate::programs::evaluate::{Evaluation, GainScores, ImageScores, MaterialScores, SplitScores};
use crate::scene::Split;
use crate::solution::Lamp;
use crate::verdict::{Level, Verdict};
use base64::prelude::{BASE64_STANDARD, Engine};
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Lights in the page's table, of the most powerful.
const LIGHTS_SHOWN: usize = 20;

/// What the page is made from.
pub struct Page<'a> {
    /// The run.
    pub record: &'a RunRecord,
    /// Scores, if it has been evaluated.
    pub evaluation: Option<&'a Evaluation>,
    /// Views with their pictures.
    pub views: &'a [ViewPictures],
    /// Textures.
    pub atlas: &'a [Captioned],
    /// The list of `lights.json`.
    pub lights: &'a [Lamp],
    /// Exposure of the radiance pictures, stops.
    pub exposure: f32,
}

/// Large counts in words people compare: "61.4 M".
fn short(n: u64) -> String {
    let x = n as f64;
    match n {
        0..10_000 => grouped(n),
        10_000..1_000_000 => format!("{:.0} k", x / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} M", x / 1e6),
        _ => format!("{:.2} G", x / 1e9),
    }
}

fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 60.0 => format!("{s:.1} s"),
        s if s < 3600.0 => format!("{} min {:02} s", s as u64 / 60, s as u64 % 60),
        s => format!("{} h {:02} min", s as u64 / 3600, s as u64 % 3600 / 60),
    }
}

fn decibels(x: f64) -> String {
    format!("{x:.2} dB")
}

/// A number, or a dash where there is none.
fn or_dash(x: Option<f64>, decimals: usize) -> String {
    x.map_or_else(|| "–".to_owned(), |x| format!("{x:.decimals$}"))
}

/// The head of a page that fetches nothing.
#[must_use]
pub fn head(title: &str, style: &str) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta name="viewport" content="width=device-width, initial-scale=1";
            title { (title) }
            link rel="icon" href="data:,";
            style { (PreEscaped(style)) }
        }
    }
}

/// The page as HTML.
///
/// # Errors
/// If a picture cannot be encoded (sides of 0 or beyond 65,535 pixels).
pub fn page(p: &Page<'_>) -> Result<String> {
    let r = p.record;
    let sections = [
        ("evaluation", "Evaluation", p.evaluation.is_some()),
        ("views", "Views", !p.views.is_empty()),
        ("maps", "Maps", !p.atlas.is_empty()),
        ("lights", "Lights", !p.lights.is_empty()),
        (
            "decisions",
            "Decisions",
            !r.notes.is_empty() || !r.decisions.is_empty(),
        ),
        ("stages", "Stages", !r.stages.is_empty()),
        ("run", "Run", true),
    ];
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("{}: unbake report", r.scene.name), include_str!("page.css")))
            body {
                main {
                    header {
                        h1 { (r.scene.name) }
                        (made_from(r))
                        nav {
                            @for (id, title, _) in sections.iter().filter(|s| s.2) {
                                a href={ "#" (id) } { (title) }
                            }
                        }
                    }
                    @if let Some(findings) = &r.findings { (verdict_section(&findings.verdict())) }
                    (summary(p))
                    @if let Some(evaluation) = p.evaluation { (evaluation_section(evaluation)) }
                    (views_section(p)?)
                    (maps_section(p)?)
                    (lights_section(p.lights))
                    (decisions_section(r))
                    (stages_section(&r.stages))
                    (run_section(r))
                    (footer(r))
                }
                dialog { img alt=""; p { span {} span { "← → Esc" } } }
                script { (PreEscaped(include_str!("page.js"))) }
            }
        }
    };
    Ok(markup.into_string())
}

/// The verdict and its reasons, heaviest first.
fn verdict_section(verdict: &Verdict) -> Markup {
    let class = match verdict.level {
        Level::Good => "verdict good",
        Level::Limited => "verdict limited",
        Level::Untrusted => "verdict untrusted",
    };
    html! {
        section class=(class) {
            h2 { "Verdict: " (verdict.level) }
            p { "Expected error of the albedo: " (format!("{:.3}", verdict.expected_error)) "." }
            ul {
                @for r in &verdict.reasons {
                    li {
                        b { (format!("{:.3}", r.weight)) } " " (r.what)
                        @if !r.place.is_empty() { " " small { "(" (r.place) ")" } }
                    }
                }
            }
        }
    }
}

/// The lights of `lights.json`, by the numbers that `relight` and the viewer use.
fn lights_section(lights: &[Lamp]) -> Markup {
    if lights.is_empty() {
        return html! {};
    }
    let all: f32 = lights.iter().map(Lamp::strength).sum();
    let cells = |l: &Lamp| {
        let [x, y, z] = l.centre;
        let [r, g, b] = l.radiance;
        let known = match (l.clipped, l.standard_error) {
            (true, e) if e > 0.0 => format!("estimated, ± {:.0} %", 100.0 * e),
            (true, _) => "estimated".into(),
            (false, _) => "photographed".into(),
        };
        [
            l.id.to_string(),
            l.kind.to_string(),
            format!("{x:.2} {y:.2} {z:.2}"),
            format!("{:.4}", l.area),
            format!("{:.1} %", 100.0 * l.strength() / all.max(f32::MIN_POSITIVE)),
            format!("{r:.3} {g:.3} {b:.3}"),
            known,
        ]
    };
    let named = [
        "id",
        "kind",
        "centre x y z (m)",
        "area (m²)",
        "share of the power",
        "radiance r g b",
        "its radiance",
    ];
    html! {
        section #lights {
            h2 { "Lights" }
            (command("unbake relight OUT --list-lamps"))
            table {
                (heads(&named))
                tbody { @for l in lights.iter().take(LIGHTS_SHOWN) { (row(&cells(l))) } }
            }
            @if lights.len() > LIGHTS_SHOWN {
                p { "The " (LIGHTS_SHOWN) " most powerful of " (lights.len()) "; all are in " code { "lights.json" } "." }
            }
        }
    }
}

fn made_from(r: &RunRecord) -> Markup {
    let [width, height] = r.scene.image_size;
    html! {
        p {
            "Reconstructed by unbake " (r.versions.unbake) " from " (r.scene.training_views)
            " photographs of " (width) " × " (height) " pixels and a mesh of "
            (grouped(r.scene.triangles as u64)) " triangles."
        }
    }
}

fn footer(r: &RunRecord) -> Markup {
    html! {
        footer {
            "unbake " (r.versions.unbake) " · Embree " (r.versions.embree)
            " · OpenImageIO " (r.versions.openimageio)
        }
    }
}

fn tile(main: bool, value: &str, label: &str) -> Markup {
    html! { div.tile.main[main] { b { (value) } span { (label) } } }
}

fn summary(p: &Page<'_>) -> Markup {
    let r = p.record;
    let threads = format!("processor time, {} threads", r.machine.threads);
    let views = format!("{} + {}", r.scene.training_views, r.scene.held_out_views);
    html! {
        div.tiles {
            (score_tiles(p))
            (tile(false, &duration(r.wall_seconds), "wall time"))
            (tile(false, &duration(r.cpu_seconds), &threads))
            (tile(false, &written_bytes(r.peak_bytes), "peak memory"))
            @if r.rays > 0 { (tile(false, &short(r.rays), "rays traced")) }
            (tile(false, &views, "training + held-out views"))
        }
    }
}

/// The scores of an evaluation or, without one, of the views that are shown.
fn score_tiles(p: &Page<'_>) -> Markup {
    let scored = p.evaluation.and_then(|e| {
        let test = e.test.as_ref().map(|t| ("novel views", t));
        test.or(e.train.as_ref().map(|t| ("re-rendering", t)))
    });
    let shown = [
        (Split::Test, "novel views shown"),
        (Split::Train, "training views shown"),
    ]
    .map(|(split, label)| {
        let of_split = p.views.iter().filter(|v| v.split == split);
        let scores: Vec<f64> = of_split.map(|v| v.psnr).collect();
        (scores.iter().sum::<f64>() / scores.len() as f64, label)
    });
    html! {
        @if let Some((label, split)) = scored {
            (tile(true, &decibels(split.rendering.psnr_of_mean_mse), label))
            @if let Some(m) = &split.materials {
                @let albedo = decibels(m.albedo.linear.psnr_of_mean_mse);
                @let roughness = decibels(m.roughness.fipt.psnr_of_mean_mse);
                (tile(true, &albedo, "albedo, no alignment"))
                (tile(true, &roughness, "roughness, FIPT protocol"))
            }
        } @else {
            @for (mean, label) in shown.iter().filter(|s| s.0.is_finite()) {
                (tile(true, &decibels(*mean), label))
            }
        }
    }
}

fn evaluation_section(evaluation: &Evaluation) -> Markup {
    html! {
        section #evaluation {
            h2 { "Evaluation" }
            (command("unbake eval OUT --scene SCENE"))
            @if let Some(split) = &evaluation.test {
                (split_tables("Held-out views", "novel views", split))
            }
            @if let Some(split) = &evaluation.train {
                (split_tables("Training views", "re-rendering", split))
            }
            details {
                summary { "What the figures mean" }
                ul.notes { @for line in &evaluation.protocols { li { (line) } } }
            }
        }
    }
}

/// The command whose result a section shows.
fn command(text: &str) -> Markup {
    html! { p.command { "from " code { (text) } } }
}

/// A row of table heads.
fn heads(names: &[&str]) -> Markup {
    html! { thead { tr { @for name in names { th { (name) } } } } }
}

/// A row of cells.
fn row(cells: &[String]) -> Markup {
    html! { tr { @for cell in cells { td { (cell) } } } }
}

fn split_tables(title: &str, kind: &str, split: &SplitScores) -> Markup {
    let scores = ["", "PSNR of mean MSE", "mean PSNR", "SSIM", "MSE"];
    html! {
        h3 { (title) " " small { (split.views.len()) " images" } }
        div.wrap {
            table {
                (heads(&scores))
                tbody {
                    (score_row(kind, &split.rendering))
                    (gain_rows(&split.gains))
                    @if let Some(m) = &split.materials {
                        (score_row("albedo, linear (no alignment)", &m.albedo.linear))
                        (score_row("albedo, FIPT", &m.albedo.fipt))
                        (score_row("albedo, TexIR (one scale per view)", &m.albedo.texir))
                        (score_row("roughness, linear", &m.roughness.linear))
                        (score_row("roughness, FIPT (clamped to [0.2, 1])", &m.roughness.fipt))
                    }
                }
            }
        }
        @if let Some(e) = &split.emission {
            p.remark {
                (format!(
                    "Emission: IoU {:.3}, log-L2 {:.4}, {:.3} of the true power where both emit ({:.3} with one gain per view).",
                    e.iou, e.log_l2, e.power_ratio, e.power_ratio_gained
                ))
            }
        }
        @if let Some(m) = &split.materials { (class_table(m)) (calibration_section(m)) }
        (view_table(split))
    }
}

/// The same with fitted gains, and the ceiling.
fn gain_rows(g: &GainScores) -> Markup {
    let ceiling = "ceiling: the fused radiance re-projected";
    let rows = [
        (
            "… with one gain per view".to_owned(),
            Some(g.psnr_gain_per_view),
        ),
        (
            "… and per channel".to_owned(),
            Some(g.psnr_gain_per_channel),
        ),
        (ceiling.to_owned(), g.ceiling_reprojected_psnr_as_is),
        (
            format!("{ceiling}, one gain per view"),
            g.ceiling_reprojected_psnr,
        ),
    ];
    html! {
        @for (name, psnr) in rows {
            @if let Some(psnr) = psnr { (row(&[name, decibels(psnr)])) }
        }
    }
}

fn score_row(name: &str, s: &ImageScores) -> Markup {
    row(&[
        name.to_owned(),
        decibels(s.psnr_of_mean_mse),
        decibels(s.mean_psnr),
        format!("{:.4}", s.ssim),
        format!("{:.5}", s.mse),
    ])
}

fn view_table(split: &SplitScores) -> Markup {
    let names = [
        "view",
        "PSNR",
        "SSIM",
        "albedo",
        "albedo, TexIR",
        "its scale",
        "roughness",
        "roughness, FIPT",
    ];
    html! {
        details {
            summary { "Every view" }
            div.wrap {
                table {
                    (heads(&names))
                    tbody {
                        @for v in &split.views {
                            (row(&[
                                v.stem.clone(),
                                format!("{:.2}", v.psnr),
                                format!("{:.4}", v.ssim),
                                or_dash(v.albedo_psnr, 2),
                                or_dash(v.albedo_psnr_texir, 2),
                                or_dash(v.albedo_scale, 3),
                                or_dash(v.roughness_psnr, 2),
                                or_dash(v.roughness_psnr_fipt, 2),
                            ]))
                        }
                    }
                }
            }
        }
    }
}

fn class_table(m: &MaterialScores) -> Markup {
    let names = [
        "class",
        "pixels",
        "albedo",
        "roughness",
        "median |ΔR|",
        "bias of R",
        "true R",
    ];
    let median = m.roughness_median_absolute_error;
    html! {
        details open {
            summary { "Every class" }
            div.wrap {
                table {
                    (heads(&names))
                    tbody {
                        @for c in &m.classes {
                            (row(&[
                                c.name.clone(),
                                grouped(c.pixels),
                                decibels(c.albedo_psnr),
                                decibels(c.roughness_psnr),
                                format!("{:.3}", c.roughness_median_absolute_error),
                                format!("{:+.3}", c.roughness_bias),
                                format!("{:.3}", c.roughness_truth),
                            ]))
                        }
                    }
                }
            }
            p.remark { "Median of |ΔR| over all pixels: " (format!("{median:.3}")) "." }
        }
    }
}

/// Does the stated standard error explain the actual one?
fn calibration_section(m: &MaterialScores) -> Markup {
    let both = [
        ("albedo", &m.calibration.albedo),
        ("roughness", &m.calibration.roughness),
    ];
    html! {
        details open {
            summary { "Stated against actual error" }
            div.wrap { @for (name, c) in both { (super::calibration::plot(name, c)) } }
            @for (name, c) in both {
                p.remark {
                    (format!(
                        "{name}: stated {:.4}, actual {:.4}; {:.0} % of the pixels within one \
                         stated standard error (68 % if Gaussian), {:.0} % within two (95 %); {} \
                         pixels stated as unobserved.",
                        c.all.stated,
                        c.all.actual,
                        100.0 * c.all.within_1,
                        100.0 * c.all.within_2,
                        grouped(c.unobserved)
                    ))
                }
            }
        }
    }
}

fn data_url(picture: &Picture) -> Result<String> {
    let bytes = encode_jpeg(picture, QUALITY)?;
    Ok(format!(
        "data:image/jpeg;base64,{}",
        BASE64_STANDARD.encode(bytes)
    ))
}

fn figure(captioned: &Captioned) -> Result<Markup> {
    let (picture, caption) = (&captioned.picture, &captioned.caption);
    Ok(html! {
        figure {
            button type="button" aria-label={ "enlarge " (caption) } {
                img src=(data_url(picture)?) alt=(caption) width=(picture.width)
                    height=(picture.height);
            }
            figcaption { (caption) }
        }
    })
}

fn views_section(p: &Page<'_>) -> Result<Markup> {
    if p.views.is_empty() {
        return Ok(html! {});
    }
    let views: Vec<Markup> = p
        .views
        .par_iter()
        .map(view_section)
        .collect::<Result<_>>()?;
    Ok(html! {
        section #views {
            h2 { "Views" }
            p.remark {
                (format!("Photographs are shown in sRGB at {:+.1} EV", p.exposure))
                ", roughness as grey from 0 to 1; errors are mean absolute differences of the \
                 channels (of re-renderings after clamp(x^(1/2.2))): 0"
                (scale_bar())
                (format!("{ERROR_RANGE:.1}"))
                ". Drag across a comparison; click a picture to enlarge it."
            }
            @for split in [Split::Test, Split::Train] {
                @for (_, section) in p.views.iter().zip(&views).filter(|(v, _)| v.split == split) {
                    (section)
                }
            }
        }
    })
}

fn view_section(view: &ViewPictures) -> Result<Markup> {
    let kind = match view.split {
        Split::Test => "held out",
        Split::Train => "training",
    };
    let scores = format!("{kind} · {:.2} dB · SSIM {:.4}", view.psnr, view.ssim);
    Ok(html! {
        section {
            h3 { "View " (view.stem) " " small { (scores) } }
            @if let [photograph, rendering, ..] = &view.pictures[..] {
                (comparison(&photograph.picture, &rendering.picture)?)
            }
            div.figures.views {
                @for captioned in view.pictures.iter().skip(2) { (figure(captioned)?) }
            }
        }
    })
}

/// A photograph over its re-rendering, with a slider between them.
fn comparison(photograph: &Picture, rendering: &Picture) -> Result<Markup> {
    let (w, h) = (photograph.width, photograph.height);
    Ok(html! {
        div.compare {
            img src=(data_url(rendering)?) alt="re-rendering" width=(w) height=(h)
                style="height:auto";
            img.top src=(data_url(photograph)?) alt="photograph" width=(w) height=(h)
                style="height:auto";
            div.rule {}
            span.tag style="left:.5rem" { "photograph" }
            span.tag style="right:.5rem" { "re-rendering" }
            input type="range" min="0" max="100" value="50" step="0.1"
                aria-label="photograph against re-rendering";
        }
    })
}

fn maps_section(p: &Page<'_>) -> Result<Markup> {
    if p.atlas.is_empty() {
        return Ok(html! {});
    }
    let maps: Vec<Markup> = p.atlas.par_iter().map(figure).collect::<Result<_>>()?;
    Ok(html! {
        section #maps {
            h2 { "Maps on the atlas" }
            p.remark {
                "Sizes are those of the files. Standard errors on a logarithmic scale, "
                (CONFIDENCE_RANGE.0) (scale_bar()) (CONFIDENCE_RANGE.1) "; grey is unobserved."
            }
            div.figures.maps { @for map in &maps { (map) } }
        }
    })
}

/// The colour scale of error maps as a CSS gradient.
fn scale_bar() -> Markup {
    let stops: Vec<String> = (0..=8)
        .map(|i| {
            let [r, g, b] = inferno(i as f32 / 8.0);
            format!("rgb({r} {g} {b})")
        })
        .collect();
    html! {
        span.scale style={ "background:linear-gradient(90deg," (stops.join(",")) ")" } {}
    }
}

fn decisions_section(r: &RunRecord) -> Markup {
    if r.notes.is_empty() && r.decisions.is_empty() {
        return html! {};
    }
    html! {
        section #decisions {
            h2 { "What the program decided and noticed" }
            @if !r.decisions.is_empty() {
                div.wrap.reasons {
                    table {
                        (heads(&["what", "decided", "why"]))
                        tbody {
                            @for d in &r.decisions {
                                tr {
                                    td { (d.what) }
                                    td { (d.decided) }
                                    td { @if d.forced { "forced: " } (d.why) }
                                }
                            }
                        }
                    }
                }
            }
            ul.notes { @for note in &r.notes { li { (note) } } }
        }
    }
}

fn stages_section(stages: &[StageRecord]) -> Markup {
    if stages.is_empty() {
        return html! {};
    }
    let longest = stages.iter().map(|s| s.wall_seconds).fold(1e-9, f64::max);
    let names = [
        "stage",
        "wall",
        "processor",
        "cores busy",
        "rays",
        "rays/s",
        "",
    ];
    html! {
        section #stages {
            h2 { "Stages" }
            (command("unbake solve SCENE -o OUT"))
            div.wrap {
                table {
                    (heads(&names))
                    tbody { @for s in stages { (stage_row(s, longest)) } }
                }
            }
        }
    }
}

fn stage_row(s: &StageRecord, longest: f64) -> Markup {
    let traced = s.rays > 0;
    let rays = traced.then(|| short(s.rays));
    let speed =
        (traced && s.wall_seconds > 0.0).then(|| short((s.rays as f64 / s.wall_seconds) as u64));
    let indent = format!("padding-left:{:.1}rem", 0.8 + 1.1 * s.depth as f64);
    let label = format!("{:.1} seconds", s.wall_seconds);
    let width = format!("{:.2}", 100.0 * s.wall_seconds / longest);
    html! {
        tr {
            td style=(indent) { (s.name) }
            td { (duration(s.wall_seconds)) }
            td { (duration(s.cpu_seconds)) }
            td { (format!("{:.1}", s.cpu_seconds / s.wall_seconds.max(1e-9))) }
            td { (rays.as_deref().unwrap_or("–")) }
            td { (speed.as_deref().unwrap_or("–")) }
            td.bar {
                svg viewBox="0 0 100 10" preserveAspectRatio="none" role="img" aria-label=(label) {
                    rect.wall width=(width) height="10" rx=".6" {}
                }
            }
        }
    }
}

/// The arguments as a line that a shell would take.
fn command_line(arguments: &[String]) -> String {
    let quoted: Vec<String> = arguments
        .iter()
        .map(|a| {
            if a.contains(char::is_whitespace) || a.is_empty() {
                format!("'{a}'")
            } else {
                a.clone()
            }
        })
        .collect();
    format!("unbake {}", quoted.join(" "))
}

fn run_section(r: &RunRecord) -> Markup {
    let rows = [
        ("processor", r.machine.cpu.clone()),
        ("threads", r.machine.threads.to_string()),
        ("memory", written_bytes(r.machine.memory_bytes)),
        ("unbake", r.versions.unbake.clone()),
        ("Embree", r.versions.embree.clone()),
        ("OpenImageIO", r.versions.openimageio.clone()),
        ("seed", r.seed.to_string()),
    ];
    html! {
        section #run {
            h2 { "Run" }
            @if !r.command.is_empty() { pre { (command_line(&r.command)) } }
            div.wrap.plain {
                table { tbody { @for (name, value) in rows { (row(&[name.to_owned(), value])) } } }
            }
            @if !r.options.is_null() {
                details {
                    summary { "Options in effect" }
                    pre { (serde_json::to_string_pretty(&r.options).unwrap_or_default()) }
                }
            }
            (input_files(r))
        }
    }
}

fn input_files(r: &RunRecord) -> Markup {
    if r.inputs.is_empty() {
        return html! {};
    }
    html! {
        details {
            summary { (r.inputs.len()) " input files" }
            div.wrap {
                table {
                    tbody {
                        @for i in &r.inputs {
                            tr {
                                td { (i.path) }
                                td { (grouped(i.bytes)) " bytes" }
                                td {
                                    code title={ "BLAKE3 " (i.blake3) } {
                                        (i.blake3.get(..16).unwrap_or(&i.blake3)) "…"
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_users_wrote_cannot_become_markup() {
        let mut record = RunRecord::default();
        record.scene.name = "<script>alert(1)</script>".into();
        record.notes.push("a < b & \"c\"".into());
        let decided = |s: &str| s.to_owned();
        record.decisions.push(crate::core::progress::Decision {
            what: decided("x<y"),
            why: decided("z<w"),
            ..Default::default()
        });
        let html = page(&Page {
            record: &record,
            evaluation: None,
            views: &[],
            atlas: &[],
            lights: &[],
            exposure: 0.0,
        })
        .expect("a page");
        assert!(!html.contains("<script>alert") && html.contains("a &lt; b &amp; &quot;c&quot;"));
        assert!(html.contains("x&lt;y") && html.contains("z&lt;w"));
        assert!(
            !html.contains("http://") && !html.contains("https://"),
            "nothing is fetched"
        );
    }

    #[test]
    fn pictures_are_embedded_and_stand_beside_their_captions() {
        let picture = |size| Captioned {
            caption: "a <map>".into(),
            picture: Picture {
                width: size,
                height: size,
                rgb: vec![90; 3 * size * size],
            },
        };
        let record = RunRecord::default();
        let page_of = |atlas: &[Captioned]| {
            page(&Page {
                record: &record,
                evaluation: None,
                views: &[],
                atlas,
                lights: &[],
                exposure: 0.0,
            })
        };
        let html = page_of(&[picture(8)]).expect("a page");
        assert!(
            html.contains("src=\"data:image/jpeg;base64,/9j/") && html.contains("a &lt;map&gt;")
        );
        assert!(page_of(&[picture(0)]).is_err(), "no picture of no pixels");
    }

    #[test]
    fn lights_stand_by_their_numbers() {
        let lights: Vec<Lamp> = (1..=LIGHTS_SHOWN + 2)
            .map(|id| Lamp {
                id,
                power: [1.0; 3],
                clipped: id == 2,
                standard_error: 0.25,
                ..Lamp::default()
            })
            .collect();
        let html = lights_section(&lights).into_string();
        assert!(html.contains("<td>20</td>") && !html.contains("<td>21</td>"));
        assert_eq!(html.matches("estimated, ± 25 %").count(), 1);
        assert!(html.contains("most powerful of 22"), "{html}");
        assert!(lights_section(&[]).into_string().is_empty());
    }

    #[test]
    fn numbers_read_well() {
        assert_eq!(short(61_440_000), "61.4 M");
        assert_eq!(duration(125.0), "2 min 05 s");
        assert_eq!(or_dash(Some(1.239), 2), "1.24");
        assert_eq!(or_dash(None, 2), "–");
    }
}
