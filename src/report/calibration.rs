//! Stated against actual errors as a drawing: both axes logarithmic, the diagonal is calibrated.

use crate::evaluate::Calibration;
use std::fmt::Write;

/// Side of the square plot and its margin in SVG units.
const SIDE: f64 = 260.0;
const MARGIN: f64 = 44.0;
/// Range of both axes: 1/2048 to 1.
const OCTAVES: f64 = 11.0;

fn along(x: f64) -> f64 {
    ((x.max(1e-9).log2() + OCTAVES) / OCTAVES).clamp(0.0, 1.0) * SIDE
}

/// One plot; the area of a point is its bin's share of the pixels.
pub(super) fn plot(out: &mut String, name: &str, c: &Calibration) -> std::fmt::Result {
    let size = SIDE + MARGIN + 12.0;
    write!(
        out,
        "<svg viewBox=\"0 0 {size} {size}\" width=\"{size}\" height=\"{size}\" role=\"img\" aria-label=\"calibration of {name}\" \
         font-size=\"10\" fill=\"currentColor\"><g transform=\"translate({MARGIN} 8)\">\
         <rect width=\"{SIDE}\" height=\"{SIDE}\" fill=\"none\" stroke=\"currentColor\" stroke-opacity=\"0.4\"/>\
         <path d=\"M0 {SIDE}L{SIDE} 0\" stroke=\"currentColor\" stroke-dasharray=\"4 3\" stroke-opacity=\"0.6\"/>"
    )?;
    for tick in [0.001, 0.01, 0.1, 1.0] {
        let (x, y) = (along(tick), SIDE - along(tick));
        write!(
            out,
            "<text x=\"{x:.0}\" y=\"{:.0}\" text-anchor=\"middle\">{tick}</text><text x=\"-6\" y=\"{:.0}\" text-anchor=\"end\">{tick}</text>",
            SIDE + 14.0,
            y + 3.0
        )?;
    }
    let points: Vec<(f64, f64, f64)> = c
        .bins
        .iter()
        .map(|b| {
            (
                along(b.stated),
                SIDE - along(b.actual),
                b.pixels as f64 / c.all.pixels.max(1) as f64,
            )
        })
        .collect();
    let line: Vec<String> = points
        .iter()
        .map(|p| format!("{:.1} {:.1}", p.0, p.1))
        .collect();
    write!(
        out,
        "<path d=\"M{}\" fill=\"none\" stroke=\"#0072b2\" stroke-width=\"1.5\"/>",
        line.join("L")
    )?;
    for (x, y, share) in points {
        write!(
            out,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{:.1}\" fill=\"#0072b2\"/>",
            2.0 + 12.0 * share.sqrt()
        )?;
    }
    writeln!(
        out,
        "<text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">stated standard error, {name}</text>\
         <text transform=\"translate(-32 {:.0}) rotate(-90)\" text-anchor=\"middle\">actual</text></g></svg>",
        0.5 * SIDE,
        SIDE + 30.0,
        0.5 * SIDE
    )
}
