//! The evaluation as an aligned table for the terminal.

use super::{Evaluation, SplitScores};
use std::fmt::Write;

/// All figures as plain text, at most 100 columns wide.
#[must_use]
pub fn terminal_table(evaluation: &Evaluation) -> String {
    let mut out = String::new();
    for (title, kind, split) in [
        ("Held-out views", "novel views", &evaluation.test),
        ("Training views", "re-rendering", &evaluation.train),
    ] {
        if let Some(split) = split {
            if !out.is_empty() {
                out.push('\n');
            }
            split_table(&mut out, title, kind, split);
        }
    }
    out
}

fn split_table(out: &mut String, title: &str, kind: &str, split: &SplitScores) {
    // writing to a String cannot fail
    let count = split.views.len();
    let _ = writeln!(
        out,
        "{title} ({count} image{})",
        if count == 1 { "" } else { "s" }
    );
    let _ = writeln!(
        out,
        "  {:<24} {:>18} {:>12} {:>9} {:>10}",
        "", "PSNR of mean MSE", "mean PSNR", "SSIM", "MSE"
    );
    row(out, kind, &split.rendering);
    gains(out, &split.gains);
    if let Some(e) = &split.emission {
        let _ = writeln!(
            out,
            "  {:<24} IoU {:.3} (mean of images {:.3}), log-L2 {:.4}",
            "emission", e.iou, e.mean_iou, e.log_l2
        );
        let _ = writeln!(
            out,
            "    power of the true      {:.3}, with one gain per view {:.3}",
            e.power_ratio, e.power_ratio_gained
        );
    }
    add_found(out, split);
    if let Some(m) = &split.materials {
        row(out, "albedo, linear", &m.albedo.linear);
        row(out, "albedo, FIPT", &m.albedo.fipt);
        row(out, "albedo, TexIR", &m.albedo.texir);
        row(out, "roughness, linear", &m.roughness.linear);
        row(out, "roughness, FIPT", &m.roughness.fipt);
        let _ = writeln!(
            out,
            "  median |R - truth| {:>24.4}",
            m.roughness_median_absolute_error
        );
        for (name, c) in [
            ("albedo", &m.calibration.albedo),
            ("roughness", &m.calibration.roughness),
        ] {
            let _ = writeln!(
                out,
                "  stated error, {name:<10} {:.4} (actual {:.4}); within 1: {:.0} %, within 2: {:.0} %",
                c.all.stated,
                c.all.actual,
                100.0 * c.all.within_1,
                100.0 * c.all.within_2
            );
        }
        let _ = writeln!(
            out,
            "\n  {:<24} {:>10} {:>12} {:>12} {:>12} {:>9} {:>9}",
            "class", "pixels", "albedo", "roughness", "median |dR|", "bias R", "true R"
        );
        for c in &m.classes {
            let name: String = c.name.chars().take(24).collect();
            let _ = writeln!(
                out,
                "  {name:<24} {:>10} {:>9.2} dB {:>9.2} dB {:>12.4} {:>+9.3} {:>9.3}",
                c.pixels,
                c.albedo_psnr,
                c.roughness_psnr,
                c.roughness_median_absolute_error,
                c.roughness_bias,
                c.roughness_truth
            );
        }
    }
}

/// What exposure, materials and geometry cost: with fitted gains, beside the ceiling.
fn gains(out: &mut String, g: &super::GainScores) {
    let mut line = |name: &str, psnr: f64| {
        let _ = writeln!(out, "  {name:<24} {psnr:>15.2} dB");
    };
    line("  one gain per view", g.psnr_gain_per_view);
    line("  ... and per channel", g.psnr_gain_per_channel);
    if let (Some(gained), Some(as_is)) =
        (g.ceiling_reprojected_psnr, g.ceiling_reprojected_psnr_as_is)
    {
        line("  ceiling, as it is", as_is);
        line("  ceiling, gain per view", gained);
        let _ = writeln!(
            out,
            "    (ceiling: the fused radiance itself seen through the same cameras: what mesh and\n     poses allow before any model of light and material)"
        );
    }
}

fn row(out: &mut String, name: &str, s: &super::ImageScores) {
    let (psnr, mean) = (s.psnr_of_mean_mse, s.mean_psnr);
    let _ = writeln!(
        out,
        "  {name:<24} {psnr:>15.2} dB {mean:>9.2} dB {:>9.4} {:>10.5}",
        s.ssim, s.mse
    );
}

/// The lines of metals and panes, where the truth knows them.
fn add_found(out: &mut String, split: &SplitScores) {
    if let Some(m) = &split.metals {
        let _ = writeln!(
            out,
            "  {:<24} found {:.1} % of {} pixels; {:.1} % of the {} stated are none;\n  {:<24} where it is found, F0 is off by {:.3}, R by {:.3}",
            "metals",
            100.0 * m.found,
            m.true_pixels,
            100.0 * m.wrong,
            m.stated_pixels,
            "",
            m.f0_error,
            m.roughness_error
        );
    }
    if let Some(p) = &split.panes {
        let _ = writeln!(
            out,
            "  {:<24} found {:.1} % of {} pixels; {:.1} % of the {} stated are none;\n  {:<24} where they are found, transmittance is off by {:.3}",
            "panes",
            100.0 * p.found,
            p.true_pixels,
            100.0 * p.wrong,
            p.stated_pixels,
            "",
            p.transmittance_error
        );
    }
}
