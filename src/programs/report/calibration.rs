//! Stated against actual errors as a drawing: both axes logarithmic, the diagonal is calibrated.

use crate::programs::evaluate::Calibration;
use maud::{Markup, html};

/// Side of the square plot and its margin in SVG units.
const SIDE: f64 = 260.0;
const MARGIN: f64 = 44.0;
/// Range of both axes: 1/2048 to 1.
const OCTAVES: f64 = 11.0;

fn along(x: f64) -> f64 {
    ((x.max(1e-9).log2() + OCTAVES) / OCTAVES).clamp(0.0, 1.0) * SIDE
}

/// One plot; the area of a point is its bin's share of the pixels.
pub(super) fn plot(name: &str, c: &Calibration) -> Markup {
    let size = SIDE + MARGIN + 12.0;
    let points: Vec<[f64; 3]> = c
        .bins
        .iter()
        .map(|b| {
            let share = b.pixels as f64 / c.all.pixels.max(1) as f64;
            [along(b.stated), SIDE - along(b.actual), share]
        })
        .collect();
    let line: Vec<String> = points
        .iter()
        .map(|[x, y, _]| format!("{x:.1} {y:.1}"))
        .collect();
    html! {
        svg viewBox={ "0 0 " (size) " " (size) } width=(size) height=(size) role="img"
            aria-label={ "calibration of " (name) } font-size="10" fill="currentColor" {
            g transform={ "translate(" (MARGIN) " 8)" } {
                (axes())
                path d={ "M" (line.join("L")) } fill="none" stroke="#0072b2" stroke-width="1.5" {}
                @for [x, y, share] in points {
                    circle cx=(format!("{x:.1}")) cy=(format!("{y:.1}"))
                        r=(format!("{:.1}", 2.0 + 12.0 * share.sqrt())) fill="#0072b2" {}
                }
                text x=(0.5 * SIDE) y=(SIDE + 30.0) text-anchor="middle" {
                    "stated standard error, " (name)
                }
                text transform={ "translate(-32 " (0.5 * SIDE) ") rotate(-90)" }
                    text-anchor="middle" { "actual" }
            }
        }
    }
}

/// Frame, diagonal and ticks at the powers of ten.
fn axes() -> Markup {
    html! {
        rect width=(SIDE) height=(SIDE) fill="none" stroke="currentColor" stroke-opacity="0.4" {}
        path d={ "M0 " (SIDE) "L" (SIDE) " 0" } stroke="currentColor" stroke-dasharray="4 3"
            stroke-opacity="0.6" {}
        @for tick in [0.001, 0.01, 0.1, 1.0] {
            text x=(format!("{:.0}", along(tick))) y=(SIDE + 14.0) text-anchor="middle" { (tick) }
            text x="-6" y=(format!("{:.0}", SIDE - along(tick) + 3.0)) text-anchor="end" { (tick) }
        }
    }
}
