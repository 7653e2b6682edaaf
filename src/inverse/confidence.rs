//! Standard error of the albedo: how far off the estimate must be expected to be, not merely how
//! well the views agree.
//!
//! An albedo is π/E times the diffuse part of the looks. Its parts err independently, so their
//! variances add:
//! * the looks: their disagreement. Most of it is common to all looks (shading model, geometry), so
//!   it does not shrink with their number; a few looks say little about their own spread and are
//!   shrunk towards their class's;
//! * the irradiance: its relative standard error;
//! * the specular part that was subtracted, known as well as computed light is;
//! * the place: registration and blur leave a texel's position uncertain by about one pixel
//!   footprint, so that it may have the albedo of a neighbour that far away;
//! * what no part accounts for: the scatter of albedo over the classes that scatter least. Most
//!   rooms have surfaces of one colour; how much their estimates vary is what unmodelled errors of
//!   light and shading amount to.

use super::AlbedoEstimate;
use super::class_prior::ANYTHING;
use crate::core::image::Plane;
use crate::core::math::luminance;
use crate::core::stats::{MAD_SCALE, MANY, median};
use crate::core::texture::Texels;
use std::collections::BTreeMap;

/// Relative error of computed light that looks have in common: of the specular part, and so of the slope of what is seen
/// on what is predicted (.1 to .4 alike: docs/lab/roughness.md), and of the irradiance of a texel's pixels.
/// Measured: a third of it costs dining-room 0.3 dB of albedo (docs/lab/albedo.md).
pub(super) const LIGHT_ERROR: f32 = 0.15;
/// The unexplained part is read from the class at this share of the observed texels, ordered by
/// scatter. Cited: the lower quartile (Tukey 1977).
const QUIET_SHARE: f64 = 0.25;

/// What the albedo inherits errors from besides its looks, per covered texel.
#[derive(Clone, Debug)]
pub struct ErrorSources {
    /// Relative standard error of the irradiance.
    pub irradiance: Vec<f32>,
    /// Side of the sharpest pixel footprint, in texels.
    pub footprint: Vec<f32>,
    /// Whether the texel only reflects: how lamps scatter tells nothing of albedo.
    pub reflects: Vec<bool>,
}

/// How far off an albedo must be expected to be.
#[derive(Clone, Debug, Default)]
pub struct StatedErrors {
    /// Standard error of each covered texel's luminance; infinite where unobserved.
    pub error: Vec<f32>,
    /// The relative part of it that no cause accounts for, the same for all.
    pub unexplained: f32,
}

/// The errors of an estimate.
#[must_use]
pub fn albedo_error(
    albedo: &AlbedoEstimate,
    texels: &Texels,
    labels: &[u16],
    sources: &ErrorSources,
) -> StatedErrors {
    let estimate = Luminances::of(albedo);
    let known: Vec<f32> = (0..estimate.value.len())
        .map(|i| {
            if estimate.known(i) {
                estimate.value[i]
            } else {
                f32::NAN
            }
        })
        .collect();
    let plane = texels.scatter(&known, f32::NAN);
    let scatter = estimate.scatter(labels, &sources.reflects);
    let parts = crate::core::parallel::map_chunks(estimate.value.len(), 4096, |range| {
        range
            .map(|i| {
                if !estimate.known(i) {
                    return f32::INFINITY;
                }
                let looks = albedo.looks[i];
                let typical = scatter.typical.get(&labels[i]).map_or(0.0, |t| t * t);
                // what the class tells counts as one look (unit information, Kass and Wasserman 1995)
                let own = estimate.spread(i).powi(2) * looks + typical;
                let share = albedo.specular_share[i].min(0.9);
                let specular = LIGHT_ERROR * share / (1.0 - share);
                let relative = own / (looks + 1.0)
                    + sources.irradiance[i].powi(2)
                    + specular * specular
                    + scatter.unexplained * scatter.unexplained;
                let value = estimate.value[i];
                let place = contrast(&plane, texels.cell[i] as usize, sources.footprint[i]);
                (relative * value * value + place * place).sqrt()
            })
            .collect::<Vec<_>>()
    });
    StatedErrors {
        error: parts.concat(),
        unexplained: scatter.unexplained,
    }
}

/// An estimate and the luminances of its albedos, 0 to 1.
struct Luminances<'a> {
    albedo: &'a AlbedoEstimate,
    value: Vec<f32>,
}

/// How much the estimate scatters.
struct Scatter {
    /// Per class the median relative spread of the looks.
    typical: BTreeMap<u16, f32>,
    /// That of ln albedo over the quiet classes.
    unexplained: f32,
}

impl<'a> Luminances<'a> {
    fn of(albedo: &'a AlbedoEstimate) -> Self {
        let value = albedo
            .value
            .iter()
            .map(|v| luminance(*v).clamp(0.0, 1.0))
            .collect();
        Self { albedo, value }
    }

    fn known(&self, i: usize) -> bool {
        self.albedo.error[i].is_finite() && self.albedo.looks[i] > 0.0
    }

    /// Standard deviation of a texel's looks, relative to its albedo.
    fn spread(&self, i: usize) -> f32 {
        self.albedo.error[i] * self.albedo.looks[i].sqrt() / self.value[i].max(1e-3)
    }

    fn scatter(&self, labels: &[u16], reflects: &[bool]) -> Scatter {
        let (albedo, value) = (self.albedo, &self.value);
        let counts = |i: usize| {
            self.known(i)
                && reflects[i]
                && albedo.clean[i]
                && albedo.looks[i] >= 1.5
                && value[i] > 0.005
        };
        let mut members: BTreeMap<u16, Vec<usize>> = BTreeMap::new();
        for i in (0..value.len()).filter(|&i| counts(i)) {
            members.entry(labels[i]).or_default().push(i);
        }
        let mut typical = BTreeMap::new();
        let mut scatter: Vec<(f32, usize)> = Vec::new();
        for (label, ids) in members {
            let stride = (ids.len() / MANY).max(1);
            let chosen: Vec<usize> = ids.iter().copied().step_by(stride).collect();
            let spreads = chosen.iter().map(|&i| self.spread(i)).collect();
            typical.insert(label, median(spreads).unwrap_or(0.0));
            let logs: Vec<f32> = chosen.iter().map(|&i| value[i].ln()).collect();
            let centre = median(logs.clone()).unwrap_or(0.0);
            let deviation =
                median(logs.iter().map(|l| (l - centre).abs()).collect()).unwrap_or(0.0);
            scatter.push((MAD_SCALE * deviation, ids.len()));
        }
        scatter.sort_by(|a, b| a.0.total_cmp(&b.0));
        let total: usize = scatter.iter().map(|s| s.1).sum();
        let mut below = 0;
        let quiet = scatter.iter().find(|s| {
            below += s.1;
            below as f64 >= QUIET_SHARE * total as f64
        });
        Scatter {
            typical,
            unexplained: quiet.map_or(ANYTHING, |q| q.0.min(ANYTHING)),
        }
    }
}

/// Root mean square difference between a texel and its eight neighbours `footprint` texels away
/// (one at least); its own value, which is the largest error there can be, where none of them is
/// known.
fn contrast(plane: &Plane<f32>, cell: usize, footprint: f32) -> f32 {
    let (w, h) = (plane.width as i64, plane.height as i64);
    let own = plane.data[cell];
    let lag = footprint.round().clamp(1.0, 16.0) as i64;
    let (x, y) = (cell as i64 % w, cell as i64 / w);
    let (mut sum, mut count) = (0.0, 0.0);
    for (dx, dy) in [
        (-1, -1),
        (0, -1),
        (1, -1),
        (-1, 0),
        (1, 0),
        (-1, 1),
        (0, 1),
        (1, 1),
    ] {
        let (i, j) = (x + dx * lag, y + dy * lag);
        if i >= 0 && j >= 0 && i < w && j < h {
            let v = plane.data[(j * w + i) as usize];
            if !v.is_nan() {
                sum += (v - own).powi(2);
                count += 1.0;
            }
        }
    }
    if count > 0.0 {
        (sum / count).sqrt()
    } else {
        own
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::Mesh;
    use glam::{Vec2, Vec3};

    fn square() -> Texels {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::ONE, Vec3::Y],
            normals: vec![Vec3::Z; 4],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        Texels::rasterize(&mesh, 32, 32)
    }

    fn estimate(n: usize, value: impl Fn(usize) -> f32, looks: f32, share: f32) -> AlbedoEstimate {
        AlbedoEstimate {
            value: (0..n).map(|i| Vec3::splat(value(i))).collect(),
            error: vec![0.01 / looks.sqrt(); n],
            looks: vec![looks; n],
            specular_share: vec![share; n],
            clean: vec![true; n],
            footprint: vec![0.01; n],
        }
    }

    /// The same sources at every texel.
    fn even(n: usize, irradiance: f32, footprint: f32) -> ErrorSources {
        ErrorSources {
            irradiance: vec![irradiance; n],
            footprint: vec![footprint; n],
            reflects: vec![true; n],
        }
    }

    #[test]
    fn variances_add_and_do_not_vanish_with_more_looks() {
        let texels = square();
        let labels = vec![1u16; texels.len()];
        let state = |looks: f32, share: f32, e: f32| {
            let a = estimate(texels.len(), |_| 0.5, looks, share);
            albedo_error(&a, &texels, &labels, &even(texels.len(), e, 1.0)).error[300]
        };
        // disagreement of 0.01 between looks, whatever their number
        assert!(
            (state(4.0, 0.0, 0.0) - 0.01).abs() < 1e-5
                && (state(40.0, 0.0, 0.0) - 0.01).abs() < 1e-5
        );
        assert!((state(4.0, 0.0, 0.06) - (0.01f32.powi(2) + 0.03f32.powi(2)).sqrt()).abs() < 1e-5);
        assert!((state(4.0, 0.5, 0.0) - 0.01f32.hypot(0.5 * LIGHT_ERROR)).abs() < 1e-5);
    }

    #[test]
    fn texture_makes_the_place_matter_and_the_unobserved_stay_so() {
        let texels = square();
        let labels = vec![1u16; texels.len()];
        let width = texels.width;
        let mut a = estimate(
            texels.len(),
            |i| {
                if (texels.cell[i] as usize % width).is_multiple_of(2) {
                    0.4
                } else {
                    0.6
                }
            },
            4.0,
            0.0,
        );
        a.error[7] = f32::INFINITY;
        let near = albedo_error(&a, &texels, &labels, &even(texels.len(), 0.0, 1.0)).error;
        let far = albedo_error(&a, &texels, &labels, &even(texels.len(), 0.0, 2.0)).error;
        assert!(near[7].is_infinite());
        // six of eight neighbours have the other value at a distance of one texel, none at two
        let unexplained = far[300];
        assert!(
            near[300] > 0.17 && unexplained < near[300],
            "{} {}",
            near[300],
            far[300]
        );
    }

    #[test]
    fn no_texels_no_errors() {
        let texels = square();
        let none = AlbedoEstimate {
            value: vec![Vec3::ZERO; texels.len()],
            error: vec![f32::INFINITY; texels.len()],
            looks: vec![0.0; texels.len()],
            specular_share: vec![0.0; texels.len()],
            clean: vec![false; texels.len()],
            footprint: vec![0.01; texels.len()],
        };
        let labels = vec![0u16; texels.len()];
        assert!(
            albedo_error(&none, &texels, &labels, &even(texels.len(), 0.0, 1.0))
                .error
                .iter()
                .all(|e| e.is_infinite())
        );
    }
}
