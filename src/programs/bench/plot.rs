//! Curves as SVG: small charts side by side, linear or logarithmic axes.
//!
//! Logarithmic axes are drawn as linear ones of the logarithm with labels turned back into values,
//! so that one chart type serves.

use crate::error::{Error, Result};
use plotters::prelude::*;

/// One curve.
pub(super) struct Series {
    /// Name in the legend.
    pub name: String,
    /// Points in drawing order.
    pub points: Vec<(f64, f64)>,
    /// Whether points are joined.
    pub line: bool,
}

/// One chart.
pub(super) struct Chart {
    /// Title.
    pub title: String,
    /// Caption of the x axis.
    pub x: String,
    /// Caption of the y axis.
    pub y: String,
    /// Logarithmic x.
    pub log_x: bool,
    /// Logarithmic y.
    pub log_y: bool,
    /// Curves.
    pub series: Vec<Series>,
}

impl Chart {
    fn names(&self) -> impl Iterator<Item = &str> {
        self.series.iter().map(|s| s.name.as_str())
    }
}

/// Size of one chart in pixels.
const SIZE: (u32, u32) = (620, 430);
/// Colour-blind-safe colours (Okabe & Ito 2008).
const COLOURS: [RGBColor; 9] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
    RGBColor(120, 120, 120),
    RGBColor(136, 84, 40),
];

/// Draws the charts in rows of two.
///
/// # Errors
/// The drawing library failing.
pub(super) fn svg(charts: &[Chart]) -> Result<String> {
    let columns = charts.len().clamp(1, 2);
    let rows = charts.len().div_ceil(columns).max(1);
    let mut out = String::new();
    {
        let area =
            SVGBackend::with_string(&mut out, (SIZE.0 * columns as u32, SIZE.1 * rows as u32))
                .into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        for (i, (chart, cell)) in charts
            .iter()
            .zip(area.split_evenly((rows, columns)))
            .enumerate()
        {
            // charts of the same curves share the legend of the last
            let named = charts
                .get(i + 1)
                .is_none_or(|next| !chart.names().eq(next.names()));
            draw(chart, named, &cell).map_err(failed)?;
        }
        area.present().map_err(failed)?;
    }
    Ok(out)
}

fn failed(e: impl std::fmt::Display) -> Error {
    Error::Failed(format!("drawing the plot: {e}"))
}

type Drawn = std::result::Result<(), DrawingAreaErrorKind<std::io::Error>>;

fn draw(
    chart: &Chart,
    named: bool,
    area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
) -> Drawn {
    let place = |&(x, y): &(f64, f64)| (scaled(x, chart.log_x), scaled(y, chart.log_y));
    let curves: Vec<Vec<(f64, f64)>> = chart
        .series
        .iter()
        .map(|s| {
            s.points
                .iter()
                .map(place)
                .filter(|(x, y)| x.is_finite() && y.is_finite())
                .collect()
        })
        .collect();
    let range = |of: fn(&(f64, f64)) -> f64| {
        let (lo, hi) = curves
            .iter()
            .flatten()
            .map(of)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
                (a.min(v), b.max(v))
            });
        if lo > hi {
            return 0.0..1.0;
        }
        let margin = (0.06 * (hi - lo)).max(1e-3 * lo.abs()).max(1e-9);
        lo - margin..hi + margin
    };
    let mut context = ChartBuilder::on(area)
        .caption(&chart.title, ("sans-serif", 17))
        .margin(14)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(range(|p| p.0), range(|p| p.1))?;
    context
        .configure_mesh()
        .x_desc(&chart.x)
        .y_desc(&chart.y)
        .x_labels(8)
        .y_labels(8)
        .light_line_style(WHITE)
        .x_label_formatter(&|v| label(*v, chart.log_x))
        .y_label_formatter(&|v| label(*v, chart.log_y))
        .draw()?;
    for (i, (series, points)) in chart.series.iter().zip(&curves).enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        if series.line {
            context.draw_series(LineSeries::new(
                points.iter().copied(),
                colour.stroke_width(2),
            ))?;
        }
        let drawn = context.draw_series(points.iter().map(|&p| mark(i, p)))?;
        drawn
            .label(series.name.clone())
            .legend(move |(x, y)| mark(i, (x + 10, y)));
    }
    if named && chart.series.len() > 1 {
        context
            .configure_series_labels()
            .background_style(WHITE.mix(0.85))
            .border_style(BLACK.mix(0.3))
            .draw()?;
    }
    Ok(())
}

/// The mark of a point of series `i`: where colours repeat, the shapes differ.
fn mark<'a, C: Clone + 'static>(i: usize, at: C) -> DynElement<'static, SVGBackend<'a>, C> {
    let style = COLOURS[i % COLOURS.len()].filled();
    if i < COLOURS.len() {
        Circle::new(at, 4, style).into_dyn()
    } else {
        TriangleMarker::new(at, 6, style).into_dyn()
    }
}

fn scaled(v: f64, log: bool) -> f64 {
    if log { v.log10() } else { v }
}

/// A number in three digits, without a tail of zeros.
fn label(v: f64, log: bool) -> String {
    let v = if log { 10f64.powf(v) } else { v };
    match v.abs() {
        a if a >= 1e7 => format!("{:.0}M", v * 1e-6),
        a if a >= 1e6 => format!("{:.1}M", v * 1e-6),
        a if a >= 1e4 => format!("{:.0}k", v * 1e-3),
        a if a >= 100.0 => format!("{v:.0}"),
        a if a >= 10.0 => format!("{v:.1}"),
        a if a >= 1.0 => format!("{v:.2}"),
        0.0 => "0".to_owned(),
        _ => format!("{v:.2e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_becomes_a_picture_with_its_words() {
        let chart = |log| Chart {
            title: "Error <of> bake".into(),
            x: "seconds".into(),
            y: "error".into(),
            log_x: log,
            log_y: log,
            series: vec![
                Series {
                    name: "uniform".into(),
                    points: vec![(1.0, 0.1), (10.0, 0.01), (f64::NAN, 1.0)],
                    line: true,
                },
                Series {
                    name: "empty".into(),
                    points: vec![],
                    line: false,
                },
            ],
        };
        let text = svg(&[chart(true), chart(false), chart(true)]).expect("draws");
        assert!(
            text.starts_with("<svg")
                && text.contains("uniform")
                && text.contains("Error &lt;of&gt; bake")
        );
        assert!(!text.contains("NaN"));
    }

    #[test]
    fn labels_are_short() {
        assert_eq!(
            [label(2.0, true), label(0.0, false), label(0.0123, false)],
            ["100", "0", "1.23e-2"]
        );
        assert_eq!(
            [label(25_000.0, false), label(8.4e6, false)],
            ["25k", "8.4M"]
        );
    }
}
