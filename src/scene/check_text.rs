//! [`CheckReport`] for people: what was understood first, then warnings, then problems, and a
//! verdict in the last line.

use super::{CheckReport, ClassShare, MeshSummary, Summary};
use crate::core::formats::grouped;
use crate::error::printable;
use std::collections::BTreeMap;
use std::fmt::{Display, Formatter, Result};

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

impl Display for CheckReport {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        writeln!(f, "{}", printable(&self.path))?;
        if let Some(s) = &self.summary {
            if let Some(light) = &s.recorded_light {
                writeln!(f, "\n{}\n", printable(&light.advice()))?;
            }
            summary(f, s)?;
        }
        list(f, "warning", &self.warnings)?;
        list(f, "problem", &self.problems)?;
        match self.problems.len() {
            0 => write!(f, "The scene can be used."),
            1 => write!(f, "The scene cannot be used until this problem is mended."),
            n => write!(
                f,
                "The scene cannot be used until these {n} problems are mended."
            ),
        }
    }
}

fn list(f: &mut Formatter<'_>, what: &str, lines: &[String]) -> Result {
    if lines.is_empty() {
        return Ok(());
    }
    writeln!(
        f,
        "\n{} {what}{}",
        lines.len(),
        if lines.len() == 1 { "" } else { "s" }
    )?;
    lines
        .iter()
        .try_for_each(|l| writeln!(f, "  - {}", printable(l)))
}

/// How the photographs were understood, with their numbers.
fn image_kinds(s: &Summary) -> BTreeMap<String, usize> {
    let mut kinds = BTreeMap::new();
    for frame in &s.frames {
        let i = &frame.image;
        let part = i
            .part
            .as_ref()
            .map_or(String::new(), |p| format!(", part {p}"));
        let kind = format!(
            "{} {}, channels {}{part}, {}, {}",
            i.format, i.sample, i.channels, i.primaries, i.transfer
        );
        *kinds.entry(printable(&kind).into_owned()).or_default() += 1;
    }
    kinds
}

fn row(f: &mut Formatter<'_>, name: &str, text: String) -> Result {
    writeln!(f, "  {name:<18} {text}")
}

fn summary(f: &mut Formatter<'_>, s: &Summary) -> Result {
    row(
        f,
        "views",
        format!("{} for training, {} held out", s.train_views, s.test_views),
    )?;
    for k in &s.images {
        row(
            f,
            "images",
            format!("{} × {}: {}×{}", k.views, k.projection, k.width, k.height),
        )?;
    }
    for (kind, count) in image_kinds(s) {
        row(f, "read as", format!("{count} × {kind}"))?;
    }
    mesh_rows(f, &s.mesh)?;
    let r = &s.radiance;
    let unread = match s.unread_views {
        0 => String::new(),
        n => format!(" ({n} views could not be read)"),
    };
    let radiance = match s.frames.is_empty() {
        true => "unknown".to_owned(),
        false => format!(
            "min {:.3e}, median {:.3e}, 99.9 % {:.3e}, max {:.3e}",
            r.min, r.median, r.p999, r.max
        ),
    };
    row(f, "radiance", format!("{radiance}{unread}"))?;
    row(
        f,
        "geometry",
        format!(
            "{} of the camera rays meet it; {} of it is seen by no training view",
            percent(1.0 - s.hole_share),
            percent(s.unseen_area_share)
        ),
    )?;
    let how = if s.rooms_given { "given" } else { "found" };
    let rooms: Vec<String> = s
        .rooms
        .iter()
        .map(|r| format!("{:.1} m² ({} views)", r.area, r.train_views))
        .collect();
    row(
        f,
        "rooms",
        format!("{} {how}: {}", s.rooms.len(), rooms.join(", ")),
    )?;
    if s.frames.is_empty() {
        return row(f, "classes", s.classes.len().to_string());
    }
    row(
        f,
        "classes",
        format!(
            "{}{}, {} of the labelled solid angle unlabelled",
            s.classes.len(),
            s.mesh_classes
                .map_or(String::new(), |of| format!(" by the mesh's {of}")),
            percent(s.unlabelled_share)
        ),
    )?;
    class_table(f, &s.classes)
}

fn mesh_rows(f: &mut Formatter<'_>, m: &MeshSummary) -> Result {
    row(
        f,
        "mesh",
        format!(
            "{} triangles, {} vertices, {:.1} m²",
            grouped(m.triangles),
            grouped(m.vertices),
            m.area
        ),
    )?;
    let [x, y, z] = std::array::from_fn(|k| format!("{:.2} … {:.2}", m.min[k], m.max[k]));
    row(f, "bounds (m, y up)", format!("x {x}, y {y}, z {z}"))?;
    let made = m.details.unwrapped.as_ref().map_or(String::new(), |u| {
        format!(", made by unbake in {} charts", grouped(u.charts as usize))
    });
    row(
        f,
        "atlas",
        format!(
            "{} filled, {:.0} texels/m at 2048²{made}",
            percent(m.atlas_fill),
            m.texels_per_metre
        ),
    )
}

fn class_table(f: &mut Formatter<'_>, classes: &[ClassShare]) -> Result {
    if classes.is_empty() {
        return Ok(());
    }
    writeln!(
        f,
        "\n  {:>6}  {:<28} {:>8} {:>8}",
        "id", "class", "pixels", "mesh"
    )?;
    for c in classes {
        let light = if c.is_light { " (light)" } else { "" };
        writeln!(
            f,
            "  {:>6}  {:<28} {:>8} {:>8}",
            c.id,
            format!("{}{light}", printable(&c.name)),
            percent(c.pixel_share),
            percent(c.mesh_share)
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_set_apart() {
        assert_eq!(
            [0, 12, 123, 1234, 123_456, 1_234_567].map(grouped),
            ["0", "12", "123", "1,234", "123,456", "1,234,567"]
        );
    }

    #[test]
    fn the_last_line_is_the_verdict() {
        let mut report = CheckReport {
            path: "s".into(),
            ..CheckReport::default()
        };
        assert!(report.to_string().ends_with("can be used."));
        report.problems = vec!["a".into(), "b".into()];
        let text = report.to_string();
        assert!(
            text.contains("2 problems\n  - a\n  - b\n")
                && text.ends_with("these 2 problems are mended.")
        );
    }
}
