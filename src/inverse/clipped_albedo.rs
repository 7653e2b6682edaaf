//! Albedo of surface that every view shows at the sensor's ceiling.
//!
//! Such looks are lower bounds: a surface that sends out at least L in irradiance E has an albedo
//! of at least b = πL/E. What its class is like nearby, ln ρ ~ N(μ, σ²), is what must be expected of
//! it before the look; the bound is known to τ, the relative error of E. Given that ln ρ lies above
//! ln b + τ ε with a standard normal ε,
//!
//! > mean of ln ρ = μ + (σ²/s) λ(z),  its variance = σ² − (σ⁴/s²) λ(z) (λ(z) + z),
//!
//! where s² = σ² + τ², z = (μ − ln b)/s and λ = φ/Φ (the moments of a truncated normal
//! distribution, Johnson, Kotz and Balakrishnan 1994, ch. 13). Far above the bound that is the
//! class; a class that lies below it moves up to it. The colour is the class's: a bound tells
//! brightness. Called by the pipeline's stage "albedo", before the mixed pixels, to which these
//! texels are known.

use super::class_prior::{Ground, class_prior};
use super::{AlbedoEstimate, BLACK};
use crate::core::math::luminance;
use crate::core::stats::inverse_mills;
use glam::Vec3;

/// The least that a texel sends out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeastAlbedo {
    /// Index among the covered texels.
    pub texel: u32,
    /// Least albedo π/E · (what is sent out at least).
    pub albedo: Vec3,
    /// Its relative standard error: that of the light.
    pub error: f32,
    /// Side of the footprint of the sharpest pixel on the surface, metres.
    pub footprint: f32,
}

/// Gives texels of which only lower bounds are known, and no look at all, the albedo of their class
/// above the bound; the texels that got one.
pub fn settle_clipped(
    ground: &Ground<'_>,
    bounds: &[LeastAlbedo],
    albedo: &mut AlbedoEstimate,
) -> Vec<u32> {
    let open: Vec<&LeastAlbedo> = bounds
        .iter()
        .filter(|b| !albedo.error[b.texel as usize].is_finite() && b.albedo.is_finite())
        .collect();
    if open.is_empty() {
        return Vec::new();
    }
    let ids: Vec<u32> = open.iter().map(|b| b.texel).collect();
    let expected = class_prior(albedo, ground, &ids, &|_| 1.0);
    for (bound, expected) in open.iter().zip(expected) {
        let i = bound.texel as usize;
        let mean = expected.mean.max(Vec3::splat(BLACK));
        let spread = expected.variance.sqrt() / luminance(mean);
        let least = (bound.albedo / mean).max_element().max(f32::MIN_POSITIVE);
        let above = Truncated::above(spread, least.ln(), bound.error);
        albedo.value[i] = mean * above.mean.exp();
        albedo.error[i] = above.deviation * luminance(albedo.value[i]);
        albedo.looks[i] = 1.0;
        albedo.specular_share[i] = 0.0;
        albedo.clean[i] = false;
        albedo.footprint[i] = bound.footprint;
    }
    ids
}

/// Mean and standard deviation of what lies above a bound.
#[derive(Clone, Copy, Debug)]
struct Truncated {
    mean: f32,
    deviation: f32,
}

impl Truncated {
    /// Of N(0, `spread`²) above `bound`, which is known to `error`.
    fn above(spread: f32, bound: f32, error: f32) -> Self {
        let (variance, bound) = (f64::from(spread).powi(2), f64::from(bound));
        let s2 = (variance + f64::from(error).powi(2)).max(f64::MIN_POSITIVE);
        let z = -bound / s2.sqrt();
        let ratio = inverse_mills(z);
        let left = variance - variance * variance / s2 * ratio * (ratio + z);
        Self {
            mean: (variance / s2.sqrt() * ratio) as f32,
            deviation: left.max(0.0).sqrt() as f32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::Mesh;
    use crate::core::sampling::KeyedRng;
    use crate::core::texture::Texels;
    use glam::Vec2;

    /// Against a large sample of both normal numbers, of which those above the bound are kept.
    #[test]
    fn moments_above_a_bound_are_those_of_a_sample() {
        let mut rng = KeyedRng::new(5, 1);
        let mut normal = || (0..12).map(|_| rng.next_f32()).sum::<f32>() - 6.0;
        for (spread, bound, error) in [
            (0.1f32, -0.3f32, 0.05f32),
            (0.1, 0.0, 0.05),
            (0.2, 0.2, 0.1),
        ] {
            let (mut n, mut sum, mut square) = (0.0f64, 0.0f64, 0.0f64);
            for _ in 0..200_000 {
                let x = spread * normal();
                if x > bound + error * normal() {
                    n += 1.0;
                    sum += f64::from(x);
                    square += f64::from(x * x);
                }
            }
            let (mean, deviation) = (sum / n, (square / n - (sum / n).powi(2)).sqrt());
            let found = Truncated::above(spread, bound, error);
            assert!(
                (f64::from(found.mean) - mean).abs() < 0.01 * f64::from(spread),
                "{found:?} {mean}"
            );
            assert!(
                (f64::from(found.deviation) / deviation - 1.0).abs() < 0.02,
                "{found:?} {deviation}"
            );
        }
    }

    /// A wall of which the lower half is seen, of albedo 0.5 ± 5 %, the upper half clipped.
    struct Wall {
        mesh: Mesh,
        texels: Texels,
        albedo: AlbedoEstimate,
        labels: Vec<u16>,
        rooms: Vec<u16>,
    }

    const SIDE: usize = 64;

    impl Wall {
        fn new() -> Self {
            let mesh = Mesh {
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
                normals: vec![Vec3::Z; 4],
                uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
                triangles: vec![[0, 1, 2], [0, 2, 3]],
            };
            let texels = Texels::rasterize(&mesh, SIDE, SIDE);
            let mut rng = KeyedRng::new(2, 2);
            let seen: Vec<bool> = (texels.cell.iter())
                .map(|c| (*c as usize / SIDE) < SIDE / 2)
                .collect();
            let value = |seen: bool, x: f32| {
                let grey = Vec3::new(0.5, 0.45, 0.4) * (1.0 + 0.17 * (x - 0.5));
                if seen { grey } else { Vec3::ZERO }
            };
            let albedo = AlbedoEstimate {
                value: seen.iter().map(|s| value(*s, rng.next_f32())).collect(),
                error: seen
                    .iter()
                    .map(|s| if *s { 0.01 } else { f32::INFINITY })
                    .collect(),
                looks: vec![3.0; seen.len()],
                specular_share: vec![0.0; seen.len()],
                clean: seen.clone(),
                footprint: vec![0.01; seen.len()],
            };
            Self {
                labels: vec![1; seen.len()],
                rooms: vec![0; seen.len()],
                mesh,
                texels,
                albedo,
            }
        }

        /// Mean albedo of the clipped half, of which `least` is known, and mean stated error.
        fn settled(mut self, least: f32) -> (Vec3, f32) {
            let clipped: Vec<u32> = (0..self.texels.len() as u32)
                .filter(|&i| !self.albedo.clean[i as usize])
                .collect();
            let bounds: Vec<LeastAlbedo> = clipped
                .iter()
                .map(|&texel| LeastAlbedo {
                    texel,
                    albedo: Vec3::new(0.5, 0.45, 0.4) * least,
                    error: 0.03,
                    footprint: 0.01,
                })
                .collect();
            let ground = Ground {
                texels: &self.texels,
                mesh: &self.mesh,
                labels: &self.labels,
                rooms: &self.rooms,
            };
            let done = settle_clipped(&ground, &bounds, &mut self.albedo);
            assert_eq!(done, clipped);
            let n = clipped.len() as f32;
            let at = clipped.iter().map(|i| *i as usize);
            (
                at.clone().map(|i| self.albedo.value[i]).sum::<Vec3>() / n,
                at.map(|i| self.albedo.error[i]).sum::<f32>() / n,
            )
        }
    }

    /// Where the bound says little, the class decides; where the class lies below it, the bound
    /// does, and the colour stays.
    #[test]
    fn clipped_paint_is_that_of_its_class_or_what_the_bound_asks_for() {
        let class = Vec3::new(0.5, 0.45, 0.4);
        let (value, error) = Wall::new().settled(0.6);
        assert!((value / class - 1.0).abs().max_element() < 0.02, "{value}");
        assert!((0.02..0.06).contains(&error), "{error}");
        let (value, error) = Wall::new().settled(1.5);
        let ratio = value / class;
        assert!((1.3..1.6).contains(&ratio.x), "{value}");
        assert!((ratio - ratio.x).abs().max_element() < 0.02, "{value}");
        assert!(error > 0.0 && error < 0.06, "{error}");
    }

    /// A texel with a look of its own keeps it.
    #[test]
    fn a_look_is_better_than_a_bound() {
        let mut wall = Wall::new();
        let seen = wall.albedo.clean.iter().position(|c| *c).expect("seen");
        let before = wall.albedo.value[seen];
        let bound = LeastAlbedo {
            texel: seen as u32,
            albedo: Vec3::ONE,
            error: 0.01,
            footprint: 0.01,
        };
        let ground = Ground {
            texels: &wall.texels,
            mesh: &wall.mesh,
            labels: &wall.labels,
            rooms: &wall.rooms,
        };
        assert!(settle_clipped(&ground, &[bound], &mut wall.albedo).is_empty());
        assert_eq!(wall.albedo.value[seen], before);
    }
}
