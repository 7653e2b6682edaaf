//! The photographer's advice, first in what `check` says: whether the photographs hold the light.
//!
//! A file for screens ends at a ceiling, and so does a linear one whose sensor was clipped; lamps,
//! windows and patches of sun reach it, and what they send beyond is not in the photographs. How much that is, `solve` estimates from the shading they
//! throw; before, it is not known, and not claimed. Views that between them show most of the clipped
//! surface are named: brackets of those would record it (greedy set cover, Chvátal 1979).

use super::{PixelStats, View};
use crate::core::math::linear_from_srgb;
use glam::Vec3;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Codes from which a display-referred file is at its ceiling: encoders of JPEG ring, cameras roll
/// off (measured on `../shared/captures`: plateaus begin at 250 of 255).
const TOP: f32 = 250.0 / 255.0;
/// Side of the cells in which clipped surface is counted, metres. Derived: a lamp.
const CELL: f32 = 0.25;
/// Views that are asked for.
const VIEWS: usize = 3;
/// Share of a view (solid angle) from which it counts as clipped. Derived: a lamp of 20 cm at 3 m
/// takes 0.03 % of a panorama; a third of it is a highlight.
const LEAST: f64 = 1e-4;

impl View {
    /// From which radiance on a display-referred file, read with `stats`, is at its ceiling; `None`
    /// for linear files.
    #[must_use]
    pub fn encoded_ceiling(&self, stats: &PixelStats) -> Option<f32> {
        let encoded = stats.eight_bit || self.account.is_display_referred();
        encoded.then(|| ceiling(self.exposure_ev))
    }
}

fn ceiling(exposure_ev: f32) -> f32 {
    linear_from_srgb(TOP) * exposure_ev.exp2()
}

/// What a view shows at its ceiling.
#[derive(Clone, Debug, Default)]
pub(super) struct ClippedView {
    pub(super) stem: String,
    /// Solid angle of the view and of what is clipped in it.
    pub(super) whole: f64,
    pub(super) clipped: f64,
    /// Clipped solid angle by class.
    pub(super) classes: BTreeMap<u16, f64>,
    /// Cells of clipped surface.
    pub(super) cells: BTreeSet<[i32; 3]>,
}

impl ClippedView {
    /// Adds a ray of a solid angle that ends at `place` (`None`: beyond the geometry) on a class.
    pub(super) fn add(&mut self, angle: f64, place: Option<Vec3>, class: u16) {
        self.clipped += angle;
        *self.classes.entry(class).or_default() += angle;
        // what lies beyond the geometry is one place
        let cell = place.map_or([i32::MAX; 3], |p| (p / CELL).floor().as_ivec3().to_array());
        self.cells.insert(cell);
    }
}

/// Light that the photographs do not hold.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RecordedLight {
    /// Training views with clipped pixels, and all.
    pub clipped_views: usize,
    /// All training views.
    pub views: usize,
    /// Mean share of those views (solid angle) that is clipped.
    pub clipped_share: f64,
    /// Class that has most of it; empty if unlabelled.
    pub most_on: String,
    /// Views whose brackets would record most of it.
    pub bracket: Vec<String>,
    /// Share of the clipped surface that these show.
    pub bracket_share: f64,
}

impl RecordedLight {
    /// Sums up the training views; `None` if none is clipped.
    pub(super) fn of(views: &[&ClippedView], name: impl Fn(u16) -> String) -> Option<Self> {
        let clipped: Vec<&&ClippedView> = views
            .iter()
            .filter(|v| v.clipped > LEAST * v.whole)
            .collect();
        if clipped.is_empty() {
            return None;
        }
        let mut classes: BTreeMap<u16, f64> = BTreeMap::new();
        for (class, angle) in clipped.iter().flat_map(|v| &v.classes) {
            *classes.entry(*class).or_default() += angle;
        }
        let most = classes.iter().max_by(|a, b| a.1.total_cmp(b.1));
        let all: BTreeSet<[i32; 3]> = clipped.iter().flat_map(|v| v.cells.clone()).collect();
        let mut left = all.clone();
        let mut bracket = Vec::new();
        while bracket.len() < VIEWS {
            let new = |v: &ClippedView| v.cells.intersection(&left).count();
            // (the first of several that show as much)
            let Some(best) = clipped
                .iter()
                .rev()
                .max_by_key(|v| new(v))
                .filter(|v| new(v) > 0)
            else {
                break;
            };
            bracket.push(best.stem.clone());
            left.retain(|cell| !best.cells.contains(cell));
        }
        let share = |v: &&&ClippedView| v.clipped / v.whole;
        Some(Self {
            clipped_views: clipped.len(),
            views: views.len(),
            clipped_share: clipped.iter().map(share).sum::<f64>() / views.len() as f64,
            most_on: most.map_or(String::new(), |m| name(*m.0)),
            bracket,
            bracket_share: 1.0 - left.len() as f64 / all.len() as f64,
        })
    }

    /// The advice in words.
    #[must_use]
    pub fn advice(&self) -> String {
        let place = if self.most_on.is_empty() {
            String::new()
        } else {
            format!(", most of it on {}", self.most_on)
        };
        format!(
            "light: {} of {} views are clipped ({:.2} % of what they show{place}). What lamps, windows and sun \
             send beyond the ceiling is not in the photographs; `solve` estimates it from the shading it \
             throws and states how sure that is, and before that nobody knows how much is missing. To \
             record it: brackets at ±2 EV of {} (they show {:.0} % of the clipped surface), merged by \
             `unbake prepare brackets`.",
            self.clipped_views,
            self.views,
            100.0 * self.clipped_share,
            self.bracket.join(", "),
            100.0 * self.bracket_share,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(stem: &str, places: &[f32]) -> ClippedView {
        let mut v = ClippedView {
            stem: stem.into(),
            whole: 12.0,
            ..ClippedView::default()
        };
        for x in places {
            v.add(0.01, Some(Vec3::new(*x, 1.0, 1.0)), 7);
        }
        v
    }

    #[test]
    fn the_views_that_show_most_are_asked_for() {
        let views = [
            view("a", &[0.1, 1.1]),
            view("b", &[0.1, 1.1, 2.1]),
            view("c", &[3.1]),
            view("dark", &[]),
        ];
        let all: Vec<&ClippedView> = views.iter().collect();
        let found = RecordedLight::of(&all, |_| "lamp".into()).expect("clipped");
        assert_eq!((found.clipped_views, found.views), (3, 4));
        assert_eq!(found.bracket, ["b", "c"]);
        assert!((found.bracket_share - 1.0).abs() < 1e-9 && found.most_on == "lamp");
        assert!((found.clipped_share - 0.06 / 12.0 / 4.0).abs() < 1e-9);
        let text = found.advice();
        assert!(
            text.contains("3 of 4 views") && text.contains("of b, c"),
            "{text}"
        );
        assert!(RecordedLight::of(&all[3..], |_| String::new()).is_none());
        assert!(RecordedLight::of(&[], |_| String::new()).is_none());
    }

    #[test]
    fn the_ceiling_follows_the_exposure() {
        assert!((ceiling(1.0) / ceiling(0.0) - 2.0).abs() < 1e-5);
        assert!(ceiling(0.0) < 1.0 && ceiling(0.0) > 0.9);
    }

    #[test]
    fn windows_are_known_by_name() {
        let is = |name: &str| {
            let class = crate::scene::Class {
                id: 1,
                name: name.into(),
                is_light: false,
            };
            class.is_window()
        };
        assert!(is("window") && is("Kitchen Windows") && is("skylight_2"));
        assert!(!is("window_frame") && !is("window sill") && !is("wall") && !is("widow"));
    }
}
