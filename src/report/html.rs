//! `report.html`: one self-contained page with the figures, pictures and plots of a run.
//!
//! Style, script and pictures are embedded; nothing is fetched. The page follows the reader's light
//! or dark preference and works without the script (the comparison slider then stands at the
//! middle).

use super::jpeg::encode_jpeg;
use super::pictures::{CONFIDENCE_RANGE, Captioned, ERROR_RANGE, ViewPictures, inferno};
use super::record::{RunRecord, StageRecord};
use crate::evaluate::{Evaluation, ImageScores, MaterialScores, SplitScores};
use crate::formats::grouped;
use crate::scene::Split;
use std::fmt::Write;

/// Quality of the embedded pictures: artefacts stay invisible at the size at which they are shown.
const QUALITY: u8 = 86;

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
    /// Exposure of the radiance pictures, stops.
    pub exposure: f32,
}

/// Text made safe for HTML.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c => out.push(c),
        }
    }
    out
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

fn bytes(n: u64) -> String {
    let mib = n as f64 / (1u64 << 20) as f64;
    if mib < 1024.0 {
        format!("{mib:.0} MiB")
    } else {
        format!("{:.2} GiB", mib / 1024.0)
    }
}

/// The page as HTML.
#[must_use]
pub fn page(page: &Page<'_>) -> String {
    let mut out = String::new();
    // writing to a String cannot fail
    let _ = write_page(&mut out, page);
    out
}

fn write_page(out: &mut String, p: &Page<'_>) -> std::fmt::Result {
    let r = p.record;
    let name = escaped(&r.scene.name);
    writeln!(
        out,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width, \
         initial-scale=1\">\n<title>{name}: unbake report</title>\n<link rel=\"icon\" href=\"data:,\">\n<style>\n{}</style>\n</head>\n\
         <body>\n<main>\n<header>\n<h1>{name}</h1>\n<p>Reconstructed by unbake {} from {} photographs of {} × {} pixels and a mesh of {} \
         triangles.</p>",
        include_str!("page.css"),
        escaped(&r.versions.unbake),
        r.scene.training_views,
        r.scene.image_size[0],
        r.scene.image_size[1],
        grouped(r.scene.triangles as u64),
    )?;
    let sections = [
        ("evaluation", "Evaluation", p.evaluation.is_some()),
        ("views", "Views", !p.views.is_empty()),
        ("maps", "Maps", !p.atlas.is_empty()),
        (
            "decisions",
            "Decisions",
            !r.notes.is_empty() || !r.decisions.is_empty(),
        ),
        ("stages", "Stages", !r.stages.is_empty()),
        ("run", "Run", true),
    ];
    out.push_str("<nav>");
    for (id, title, _) in sections.iter().filter(|s| s.2) {
        write!(out, "<a href=\"#{id}\">{title}</a>")?;
    }
    out.push_str("</nav>\n</header>\n");
    summary(out, p)?;
    if let Some(evaluation) = p.evaluation {
        evaluation_section(out, evaluation)?;
    }
    views_section(out, p)?;
    maps_section(out, p)?;
    decisions_section(out, r)?;
    stages_section(out, &r.stages)?;
    run_section(out, r)?;
    writeln!(
        out,
        "<footer>unbake {} · Embree {} · OpenImageIO {}</footer>\n</main>\n<dialog><img alt=\"\"><p><span></span><span>← → \
         Esc</span></p></dialog>\n<script>\n{}</script>\n</body>\n</html>",
        escaped(&r.versions.unbake),
        escaped(&r.versions.embree),
        escaped(&r.versions.openimageio),
        include_str!("page.js")
    )
}

fn tile(out: &mut String, main: bool, value: &str, label: &str) -> std::fmt::Result {
    writeln!(
        out,
        "<div class=\"tile{}\"><b>{value}</b><span>{label}</span></div>",
        if main { " main" } else { "" }
    )
}

fn summary(out: &mut String, p: &Page<'_>) -> std::fmt::Result {
    let r = p.record;
    out.push_str("<div class=\"tiles\">\n");
    let scored = p.evaluation.and_then(|e| {
        e.test
            .as_ref()
            .map(|t| ("novel views", t))
            .or(e.train.as_ref().map(|t| ("re-rendering", t)))
    });
    if let Some((label, split)) = scored {
        tile(
            out,
            true,
            &format!("{:.2} dB", split.rendering.psnr_of_mean_mse),
            label,
        )?;
        if let Some(m) = &split.materials {
            tile(
                out,
                true,
                &format!("{:.2} dB", m.albedo.linear.psnr_of_mean_mse),
                "albedo, no alignment",
            )?;
            tile(
                out,
                true,
                &format!("{:.2} dB", m.roughness.fipt.psnr_of_mean_mse),
                "roughness, FIPT protocol",
            )?;
        }
    } else {
        for (split, label) in [
            (Split::Test, "novel views shown"),
            (Split::Train, "training views shown"),
        ] {
            let shown: Vec<f64> = p
                .views
                .iter()
                .filter(|v| v.split == split)
                .map(|v| v.psnr)
                .collect();
            if !shown.is_empty() {
                tile(
                    out,
                    true,
                    &format!("{:.2} dB", shown.iter().sum::<f64>() / shown.len() as f64),
                    label,
                )?;
            }
        }
    }
    tile(out, false, &duration(r.wall_seconds), "wall time")?;
    tile(
        out,
        false,
        &duration(r.cpu_seconds),
        &format!("processor time, {} threads", r.machine.threads),
    )?;
    tile(out, false, &bytes(r.peak_bytes), "peak memory")?;
    if r.rays > 0 {
        tile(out, false, &short(r.rays), "rays traced")?;
    }
    tile(
        out,
        false,
        &format!("{} + {}", r.scene.training_views, r.scene.held_out_views),
        "training + held-out views",
    )?;
    out.push_str("</div>\n");
    Ok(())
}

fn evaluation_section(out: &mut String, evaluation: &Evaluation) -> std::fmt::Result {
    out.push_str("<section id=\"evaluation\">\n<h2>Evaluation</h2>\n");
    command(out, "unbake eval OUT --scene SCENE")?;
    for (title, kind, split) in [
        ("Held-out views", "novel views", &evaluation.test),
        ("Training views", "re-rendering", &evaluation.train),
    ] {
        if let Some(split) = split {
            split_tables(out, title, kind, split)?;
        }
    }
    out.push_str("<details><summary>What the figures mean</summary><ul class=\"notes\">\n");
    for line in &evaluation.protocols {
        writeln!(out, "<li>{}</li>", escaped(line))?;
    }
    out.push_str("</ul></details>\n</section>\n");
    Ok(())
}

/// The command whose result a section shows.
fn command(out: &mut String, text: &str) -> std::fmt::Result {
    writeln!(
        out,
        "<p class=\"command\">from <code>{}</code></p>",
        escaped(text)
    )
}

fn split_tables(
    out: &mut String,
    title: &str,
    kind: &str,
    split: &SplitScores,
) -> std::fmt::Result {
    writeln!(
        out,
        "<h3>{title} <small>{} images</small></h3>\n<div class=\"wrap\"><table><thead><tr><th></th><th>PSNR of mean MSE</th><th>mean \
         PSNR</th><th>SSIM</th><th>MSE</th></tr></thead><tbody>",
        split.views.len()
    )?;
    score_row(out, kind, &split.rendering)?;
    if let Some(m) = &split.materials {
        score_row(out, "albedo, linear (no alignment)", &m.albedo.linear)?;
        score_row(out, "albedo, FIPT", &m.albedo.fipt)?;
        score_row(out, "albedo, TexIR (one scale per view)", &m.albedo.texir)?;
        score_row(out, "roughness, linear", &m.roughness.linear)?;
        score_row(
            out,
            "roughness, FIPT (clamped to [0.2, 1])",
            &m.roughness.fipt,
        )?;
    }
    out.push_str("</tbody></table></div>\n");
    if let Some(e) = &split.emission {
        writeln!(
            out,
            "<p class=\"remark\">Emission: IoU {:.3}, log-L2 {:.4}, {:.3} of the true power where both emit.</p>",
            e.iou, e.log_l2, e.power_ratio
        )?;
    }
    if let Some(m) = &split.materials {
        class_table(out, m)?;
        calibration_section(out, m)?;
    }
    out.push_str(
        "<details><summary>Every view</summary><div class=\"wrap\"><table><thead><tr><th>view</th><th>PSNR</th><th>SSIM</th>",
    );
    out.push_str(
        "<th>albedo</th><th>albedo, TexIR</th><th>its scale</th><th>roughness</th><th>roughness, FIPT</th></tr></thead><tbody>\n",
    );
    let optional = |v: Option<f64>| v.map_or_else(|| "–".to_owned(), |v| format!("{v:.2}"));
    for v in &split.views {
        writeln!(
            out,
            "<tr><td>{}</td><td>{:.2}</td><td>{:.4}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escaped(&v.stem),
            v.psnr,
            v.ssim,
            optional(v.albedo_psnr),
            optional(v.albedo_psnr_texir),
            v.albedo_scale
                .map_or_else(|| "–".to_owned(), |s| format!("{s:.3}")),
            optional(v.roughness_psnr),
            optional(v.roughness_psnr_fipt),
        )?;
    }
    out.push_str("</tbody></table></div></details>\n");
    Ok(())
}

fn score_row(out: &mut String, name: &str, s: &ImageScores) -> std::fmt::Result {
    writeln!(
        out,
        "<tr><td>{name}</td><td>{:.2} dB</td><td>{:.2} dB</td><td>{:.4}</td><td>{:.5}</td></tr>",
        s.psnr_of_mean_mse, s.mean_psnr, s.ssim, s.mse
    )
}

fn class_table(out: &mut String, m: &MaterialScores) -> std::fmt::Result {
    writeln!(
        out,
        "<details open><summary>Every class</summary><div class=\"wrap\"><table><thead><tr><th>class</th><th>pixels</th><th>albedo</th>\
         <th>roughness</th><th>median |ΔR|</th><th>bias of R</th><th>true R</th></tr></thead><tbody>"
    )?;
    for c in &m.classes {
        writeln!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{:.2} dB</td><td>{:.2} dB</td><td>{:.3}</td><td>{:+.3}</td><td>{:.3}</td></tr>",
            escaped(&c.name),
            grouped(c.pixels),
            c.albedo_psnr,
            c.roughness_psnr,
            c.roughness_median_absolute_error,
            c.roughness_bias,
            c.roughness_truth
        )?;
    }
    writeln!(
        out,
        "</tbody></table></div><p class=\"remark\">Median of |ΔR| over all pixels: {:.3}.</p></details>",
        m.roughness_median_absolute_error
    )
}

/// Does the stated standard error explain the actual one?
fn calibration_section(out: &mut String, m: &MaterialScores) -> std::fmt::Result {
    out.push_str(
        "<details open><summary>Stated against actual error</summary><div class=\"wrap\">",
    );
    for (name, c) in [
        ("albedo", &m.calibration.albedo),
        ("roughness", &m.calibration.roughness),
    ] {
        super::calibration::plot(out, name, c)?;
    }
    out.push_str("</div>");
    for (name, c) in [
        ("albedo", &m.calibration.albedo),
        ("roughness", &m.calibration.roughness),
    ] {
        writeln!(
            out,
            "<p class=\"remark\">{name}: stated {:.4}, actual {:.4}; {:.0} % of the pixels within one stated standard error (68 % if \
             Gaussian), {:.0} % within two (95 %); {} pixels stated as unobserved.</p>",
            c.all.stated,
            c.all.actual,
            100.0 * c.all.within_1,
            100.0 * c.all.within_2,
            grouped(c.unobserved)
        )?;
    }
    out.push_str("</details>\n");
    Ok(())
}

fn data_url(picture: &super::jpeg::Picture) -> String {
    format!(
        "data:image/jpeg;base64,{}",
        base64(&encode_jpeg(picture, QUALITY))
    )
}

fn figure(out: &mut String, captioned: &Captioned) -> std::fmt::Result {
    let caption = escaped(&captioned.caption);
    let (w, h) = (captioned.picture.width, captioned.picture.height);
    writeln!(
        out,
        "<figure><button type=\"button\" aria-label=\"enlarge {caption}\"><img src=\"{}\" alt=\"{caption}\" width=\"{w}\" \
         height=\"{h}\"></button><figcaption>{caption}</figcaption></figure>",
        data_url(&captioned.picture)
    )
}

fn views_section(out: &mut String, p: &Page<'_>) -> std::fmt::Result {
    if p.views.is_empty() {
        return Ok(());
    }
    writeln!(
        out,
        "<section id=\"views\">\n<h2>Views</h2>\n<p class=\"remark\">Photographs are shown in sRGB at {:+.1} EV, roughness as grey from 0 to \
         1; errors are mean absolute differences of the channels (of re-renderings after clamp(x^(1/2.2))): 0{}{:.1}. Drag across a comparison; \
         click a picture to enlarge it.</p>",
        p.exposure,
        scale_bar(),
        ERROR_RANGE
    )?;
    for split in [Split::Test, Split::Train] {
        for view in p.views.iter().filter(|v| v.split == split) {
            view_section(out, view)?;
        }
    }
    out.push_str("</section>\n");
    Ok(())
}

fn view_section(out: &mut String, view: &ViewPictures) -> std::fmt::Result {
    let kind = if view.split == Split::Test {
        "held out"
    } else {
        "training"
    };
    writeln!(
        out,
        "<section><h3>View {} <small>{kind} · {:.2} dB · SSIM {:.4}</small></h3>",
        escaped(&view.stem),
        view.psnr,
        view.ssim
    )?;
    if let [photograph, rendering, ..] = &view.pictures[..] {
        let (w, h) = (photograph.picture.width, photograph.picture.height);
        writeln!(
            out,
            "<div class=\"compare\"><img src=\"{}\" alt=\"re-rendering\" width=\"{w}\" height=\"{h}\" style=\"height:auto\"><img \
             class=\"top\" src=\"{}\" alt=\"photograph\" width=\"{w}\" height=\"{h}\" style=\"height:auto\"><div class=\"rule\"></div><span \
             class=\"tag\" style=\"left:.5rem\">photograph</span><span class=\"tag\" style=\"right:.5rem\">re-rendering</span><input \
             type=\"range\" min=\"0\" max=\"100\" value=\"50\" step=\"0.1\" aria-label=\"photograph against re-rendering\"></div>",
            data_url(&rendering.picture),
            data_url(&photograph.picture)
        )?;
    }
    out.push_str("<div class=\"figures views\">\n");
    for captioned in view.pictures.iter().skip(2) {
        figure(out, captioned)?;
    }
    out.push_str("</div></section>\n");
    Ok(())
}

fn maps_section(out: &mut String, p: &Page<'_>) -> std::fmt::Result {
    if p.atlas.is_empty() {
        return Ok(());
    }
    writeln!(
        out,
        "<section id=\"maps\">\n<h2>Maps on the atlas</h2>\n<p class=\"remark\">Sizes are those of the files. Standard errors on a \
         logarithmic scale, {}{}{}; grey is unobserved.</p>\n<div class=\"figures maps\">",
        CONFIDENCE_RANGE.0,
        scale_bar(),
        CONFIDENCE_RANGE.1
    )?;
    for captioned in p.atlas {
        figure(out, captioned)?;
    }
    out.push_str("</div>\n</section>\n");
    Ok(())
}

/// The colour scale of error maps as a CSS gradient.
fn scale_bar() -> String {
    let stops: Vec<String> = (0..=8)
        .map(|i| {
            let [r, g, b] = inferno(i as f32 / 8.0);
            format!("rgb({r} {g} {b})")
        })
        .collect();
    format!(
        "<span class=\"scale\" style=\"background:linear-gradient(90deg,{})\"></span>",
        stops.join(",")
    )
}

fn decisions_section(out: &mut String, r: &RunRecord) -> std::fmt::Result {
    if r.notes.is_empty() && r.decisions.is_empty() {
        return Ok(());
    }
    out.push_str("<section id=\"decisions\">\n<h2>What the program decided and noticed</h2>\n");
    if !r.decisions.is_empty() {
        out.push_str("<div class=\"wrap\"><table><thead><tr><th>what</th><th>decided</th><th>why</th></tr></thead><tbody>\n");
        for d in &r.decisions {
            let forced = if d.forced { "forced: " } else { "" };
            let [what, decided, why] = [&d.what, &d.decided, &d.why].map(|s| escaped(s));
            writeln!(
                out,
                "<tr><td>{what}</td><td>{decided}</td><td>{forced}{why}</td></tr>"
            )?;
        }
        out.push_str("</tbody></table></div>\n");
    }
    out.push_str("<ul class=\"notes\">\n");
    for note in &r.notes {
        writeln!(out, "<li>{}</li>", escaped(note))?;
    }
    out.push_str("</ul>\n</section>\n");
    Ok(())
}

fn stages_section(out: &mut String, stages: &[StageRecord]) -> std::fmt::Result {
    if stages.is_empty() {
        return Ok(());
    }
    let longest = stages.iter().map(|s| s.wall_seconds).fold(1e-9, f64::max);
    out.push_str("<section id=\"stages\">\n<h2>Stages</h2>\n");
    command(out, "unbake solve SCENE -o OUT")?;
    out.push_str("<div class=\"wrap\"><table><thead><tr><th>stage</th><th>wall</th>");
    out.push_str("<th>processor</th><th>cores busy</th><th>rays</th><th>rays/s</th><th></th></tr></thead><tbody>\n");
    for s in stages {
        let rays = if s.rays > 0 {
            short(s.rays)
        } else {
            "–".into()
        };
        let speed = if s.rays > 0 && s.wall_seconds > 0.0 {
            short((s.rays as f64 / s.wall_seconds) as u64)
        } else {
            "–".into()
        };
        writeln!(
            out,
            "<tr><td style=\"padding-left:{:.1}rem\">{}</td><td>{}</td><td>{}</td><td>{:.1}</td><td>{rays}</td><td>{speed}</td><td \
             class=\"bar\"><svg viewBox=\"0 0 100 10\" preserveAspectRatio=\"none\" role=\"img\" aria-label=\"{:.1} seconds\"><rect \
             class=\"wall\" width=\"{:.2}\" height=\"10\" rx=\".6\"/></svg></td></tr>",
            0.8 + 1.1 * s.depth as f64,
            escaped(&s.name),
            duration(s.wall_seconds),
            duration(s.cpu_seconds),
            s.cpu_seconds / s.wall_seconds.max(1e-9),
            s.wall_seconds,
            100.0 * s.wall_seconds / longest
        )?;
    }
    out.push_str("</tbody></table></div>\n</section>\n");
    Ok(())
}

fn run_section(out: &mut String, r: &RunRecord) -> std::fmt::Result {
    out.push_str("<section id=\"run\">\n<h2>Run</h2>\n");
    if !r.command.is_empty() {
        let quoted: Vec<String> = r
            .command
            .iter()
            .map(|a| {
                if a.contains(char::is_whitespace) || a.is_empty() {
                    format!("'{a}'")
                } else {
                    a.clone()
                }
            })
            .collect();
        writeln!(out, "<pre>unbake {}</pre>", escaped(&quoted.join(" ")))?;
    }
    out.push_str("<div class=\"wrap plain\"><table><tbody>\n");
    let rows = [
        ("processor", escaped(&r.machine.cpu)),
        ("threads", r.machine.threads.to_string()),
        ("memory", bytes(r.machine.memory_bytes)),
        ("unbake", escaped(&r.versions.unbake)),
        ("Embree", escaped(&r.versions.embree)),
        ("OpenImageIO", escaped(&r.versions.openimageio)),
        ("seed", r.seed.to_string()),
    ];
    for (name, value) in rows {
        writeln!(out, "<tr><td>{name}</td><td>{value}</td></tr>")?;
    }
    out.push_str("</tbody></table></div>\n");
    if !r.options.is_null() {
        let options = serde_json::to_string_pretty(&r.options).unwrap_or_default();
        writeln!(
            out,
            "<details><summary>Options in effect</summary><pre>{}</pre></details>",
            escaped(&options)
        )?;
    }
    if !r.inputs.is_empty() {
        writeln!(
            out,
            "<details><summary>{} input files</summary><div class=\"wrap\"><table><tbody>",
            r.inputs.len()
        )?;
        for i in &r.inputs {
            writeln!(
                out,
                "<tr><td>{}</td><td>{} bytes</td><td><code title=\"BLAKE3 {}\">{}…</code></td></tr>",
                escaped(&i.path),
                grouped(i.bytes),
                escaped(&i.blake3),
                escaped(i.blake3.get(..16).unwrap_or(&i.blake3))
            )?;
        }
        out.push_str("</tbody></table></div></details>\n");
    }
    out.push_str("</section>\n");
    Ok(())
}

/// RFC 4648 base64 with padding.
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = u32::from(chunk[0]) << 16
            | u32::from(chunk.get(1).copied().unwrap_or(0)) << 8
            | u32::from(chunk.get(2).copied().unwrap_or(0));
        for i in 0..4 {
            let padded = i > chunk.len();
            out.push(if padded {
                '='
            } else {
                char::from(ALPHABET[(word >> (18 - 6 * i) & 63) as usize])
            });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_follows_the_rfcs_test_vectors() {
        for (plain, encoded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), encoded);
        }
    }

    #[test]
    fn what_users_wrote_cannot_become_markup() {
        let mut record = RunRecord::default();
        record.scene.name = "<script>alert(1)</script>".into();
        record.notes.push("a < b & \"c\"".into());
        let decided = |s: &str| s.to_owned();
        record.decisions.push(crate::progress::Decision {
            what: decided("x<y"),
            why: decided("z<w"),
            ..Default::default()
        });
        let html = page(&Page {
            record: &record,
            evaluation: None,
            views: &[],
            atlas: &[],
            exposure: 0.0,
        });
        assert!(!html.contains("<script>alert") && html.contains("a &lt; b &amp; &quot;c&quot;"));
        assert!(html.contains("x&lt;y") && html.contains("z&lt;w"));
        assert!(
            !html.contains("http://") && !html.contains("https://"),
            "nothing is fetched"
        );
    }

    #[test]
    fn numbers_read_well() {
        assert_eq!(short(61_440_000), "61.4 M");
        assert_eq!(duration(125.0), "2 min 05 s");
        assert_eq!(bytes(3 << 30), "3.00 GiB");
    }
}
