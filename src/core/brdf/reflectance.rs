//! Which reflection model explains the photographs.
//!
//! The paper's model is Lambert plus GGX with Karis' remapped masking (k = (R+1)²/8) and a fit to
//! Schlick's Fresnel term. Other renderers, and real surfaces, follow the exact Smith masking of
//! GGX, Fresnel's equations, and a diffuse part that darkens or brightens at grazing angles (Burley
//! 2012, "Physically-Based Shading at Disney"). The difference is up to a third of a highlight and
//! several percent of a white wall, so the solver compares the models on the evidence and uses the
//! one that explains it.

use super::ggx::{fresnel, fresnel_exact, ggx_d, specular};
use super::material::MIN_ROUGHNESS;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// A reflection model. All share α = R², GGX and F0 = 0.04.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Reflectance {
    /// The paper's eq. 1–4: Lambert, k = (R+1)²/8.
    #[default]
    Paper,
    /// Lambert with the exact Smith masking and Fresnel's equations.
    Smith,
    /// Burley's diffuse part with the exact Smith masking and Fresnel's equations.
    Burley,
}

impl Reflectance {
    /// All models, simplest first.
    pub const ALL: [Self; 3] = [Self::Paper, Self::Smith, Self::Burley];

    /// What a dielectric's facet reflects at the cosine `v_h` to its normal, [0, 1].
    #[inline]
    #[must_use]
    pub fn fresnel(self, v_h: f32) -> f32 {
        match self {
            Self::Paper => fresnel(v_h),
            Self::Smith | Self::Burley => fresnel_exact(v_h),
        }
    }

    /// Specular BRDF D·F·G/(4 n·l n·v); arguments as [`specular`].
    #[inline]
    #[must_use]
    pub fn specular(self, n_l: f32, n_v: f32, sin2_nh: f32, v_h: f32, roughness: f32) -> f32 {
        if self == Self::Paper {
            return specular(n_l, n_v, sin2_nh, v_h, roughness);
        }
        let alpha = roughness * roughness;
        ggx_d(sin2_nh, alpha) * self.fresnel(v_h) * smith_visibility(n_l, n_v, alpha)
    }

    /// As [`Self::specular`] in world space: unit normal, directions to viewer and light; 0 where
    /// one of them is below the surface. Roughness is taken as at least [`MIN_ROUGHNESS`].
    #[inline]
    #[must_use]
    pub fn specular_lobe(self, n: Vec3, v: Vec3, l: Vec3, roughness: f32) -> f32 {
        let (n_v, n_l) = (n.dot(v), n.dot(l));
        if !(n_v > 0.0 && n_l > 0.0) {
            return 0.0;
        }
        let h = (v + l).normalize_or(n);
        let sin2 = n.cross(h).length_squared().min(1.0);
        self.specular(
            n_l.min(1.0),
            n_v.min(1.0),
            sin2,
            v.dot(h).clamp(0.0, 1.0),
            roughness.clamp(MIN_ROUGHNESS, 1.0),
        )
    }

    /// Diffuse BRDF over Lambert's albedo/π for one pair of directions (Burley 2012, §5.3; cosines
    /// at the normal and between view and light).
    #[inline]
    #[must_use]
    pub fn diffuse(self, n_l: f32, n_v: f32, v_l: f32, roughness: f32) -> f32 {
        if self != Self::Burley {
            return 1.0;
        }
        Self::diffuse_at(Self::diffuse_by_roughness(n_l, n_v, v_l), roughness)
    }

    /// The value at a roughness of a polynomial of [`Self::diffuse_by_roughness`], or of a mean of
    /// several.
    #[inline]
    #[must_use]
    pub fn diffuse_at([a, b, c]: [f32; 3], roughness: f32) -> f32 {
        a + roughness * (b + roughness * c)
    }

    /// Burley's diffuse factor for one pair of directions as a polynomial in the roughness, lowest
    /// power first; arguments as [`Self::diffuse`].
    #[inline]
    #[must_use]
    pub fn diffuse_by_roughness(n_l: f32, n_v: f32, v_l: f32) -> [f32; 3] {
        // (1 + g·a)(1 + g·b) with g = R·(1 + v·l) − ½, for 2 cos²θ_d = 1 + v·l
        let [a, b] = [n_l, n_v].map(|c| (1.0 - c.clamp(0.0, 1.0)).powi(5));
        let (s, a0, b0) = (1.0 + v_l, 1.0 - 0.5 * a, 1.0 - 0.5 * b);
        [a0 * b0, s * (a * b0 + b * a0), s * s * a * b]
    }

    /// Diffuse radiance towards a viewer at cosine `n_v` over that of a Lambertian surface under
    /// the same irradiance, for light that is even: the mean of Burley's factor over a
    /// cosine-weighted hemisphere, in closed form ([`GRAZING`]).
    #[inline]
    #[must_use]
    pub fn diffuse_factor(self, n_v: f32, roughness: f32) -> f32 {
        if self != Self::Burley {
            return 1.0;
        }
        let c = n_v.clamp(0.0, 1.0);
        let b = (1.0 - c).powi(5);
        let [m0, m1, m2] = GRAZING;
        // means of s·a, of s·(1 − a/2) and of s²·a, with s = 1 + v·l and a = (1 − n·l)⁵
        let (sa, b0) = (m0 + c * m1, 1.0 - 0.5 * b);
        let s = 1.0 + c * (2.0 / 3.0) - 0.5 * sa;
        let s2a = m0 + 2.0 * c * m1 + c * c * m2 + 0.5 * (1.0 - c * c) * (m0 - m2);
        let by_roughness = [(1.0 - 0.5 * m0) * b0, sa * b0 + b * s, b * s2a];
        Self::diffuse_at(by_roughness, roughness)
    }

    /// The mean of [`Self::diffuse_factor`] over all viewers, by cosine: the flux that the diffuse
    /// part sends out over that of a Lambertian surface.
    #[inline]
    #[must_use]
    pub fn mean_diffuse_factor(self, roughness: f32) -> f32 {
        if self != Self::Burley {
            return 1.0;
        }
        let [m0, m1, m2] = GRAZING;
        let by_roughness = [
            (1.0 - 0.5 * m0).powi(2),
            2.0 * (m0 * (1.0 - 0.5 * m0) + m1 * (2.0 / 3.0 - 0.5 * m1)),
            m0 * m0 + 2.0 * m1 * m1 + m2 * m2 + 0.5 * (m0 - m2).powi(2),
        ];
        Self::diffuse_at(by_roughness, roughness)
    }
}

/// Means of (1 − c)⁵ cᵏ over a cosine-weighted hemisphere, 2∫(1 − c)⁵ cᵏ⁺¹ dc, for k = 0, 1, 2.
/// Derived. The azimuth averages v·l to c·c′ and (v·l)² to c²c′² + ½(1 − c²)(1 − c′²).
const GRAZING: [f32; 3] = [1.0 / 21.0, 1.0 / 84.0, 1.0 / 252.0];

/// G/(4 n·l n·v) of the separable exact Smith masking.
#[inline]
fn smith_visibility(n_l: f32, n_v: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let side = |x: f32| x + (a2 + (1.0 - a2) * x * x).sqrt();
    1.0 / (side(n_l) * side(n_v)).max(1e-12)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::{SobolSequence, square_to_cosine_hemisphere};
    use glam::Vec3;

    /// The closed form of Burley's diffuse factor against its integral over uniform light.
    #[test]
    fn diffuse_factor_is_the_mean_over_diffuse_light() {
        for roughness in [0.0f32, 0.3, 0.6, 1.0] {
            for n_v in [0.15f32, 0.4, 0.7, 0.95] {
                let v = Vec3::new((1.0 - n_v * n_v).sqrt(), 0.0, n_v);
                let sequence = SobolSequence::new(1, 2);
                let n = 4096;
                let mean = (0..n)
                    .map(|i| {
                        let l = square_to_cosine_hemisphere(sequence.point2(i));
                        let cos2_d = 0.5 * (1.0 + v.dot(l));
                        let f90 = 0.5 + 2.0 * roughness * cos2_d;
                        f64::from(
                            (1.0 + (f90 - 1.0) * (1.0 - l.z).powi(5))
                                * (1.0 + (f90 - 1.0) * (1.0 - n_v).powi(5)),
                        )
                    })
                    .sum::<f64>()
                    / f64::from(n);
                let closed = f64::from(Reflectance::Burley.diffuse_factor(n_v, roughness));
                assert!(
                    (closed / mean - 1.0).abs() < 2e-3,
                    "R {roughness} n·v {n_v}: {closed} against {mean}"
                );
            }
        }
        assert_eq!(Reflectance::Paper.diffuse_factor(0.1, 1.0), 1.0);
    }

    /// The flux of the diffuse part is the integral of what viewers see.
    #[test]
    fn mean_diffuse_factor_is_the_mean_over_viewers() {
        for roughness in [0.0f32, 0.4, 1.0] {
            let n = 2000;
            // cosine-weighted: c² is even
            let viewer = |i: i32| ((i as f32 + 0.5) / n as f32).sqrt();
            let mean = (0..n)
                .map(|i| f64::from(Reflectance::Burley.diffuse_factor(viewer(i), roughness)))
                .sum::<f64>()
                / f64::from(n);
            let closed = f64::from(Reflectance::Burley.mean_diffuse_factor(roughness));
            assert!(
                (closed - mean).abs() < 1e-4,
                "R {roughness}: {closed}, {mean}"
            );
        }
        assert_eq!(Reflectance::Smith.mean_diffuse_factor(1.0), 1.0);
    }

    /// The polynomial against Burley's formula as published.
    #[test]
    fn diffuse_is_burleys() {
        for (roughness, n_l, n_v, v_l) in [
            (0.0f32, 0.3f32, 0.8f32, 0.2f32),
            (0.45, 0.1, 0.2, 0.9),
            (1.0, 0.05, 0.05, -0.7),
        ] {
            let f90 = 0.5 + roughness * (1.0 + v_l);
            let side = |c: f32| 1.0 + (f90 - 1.0) * (1.0 - c).powi(5);
            let got = Reflectance::Burley.diffuse(n_l, n_v, v_l, roughness);
            assert!(
                (got - side(n_l) * side(n_v)).abs() < 1e-5,
                "{got} against {}",
                side(n_l) * side(n_v)
            );
            assert_eq!(Reflectance::Smith.diffuse(n_l, n_v, v_l, roughness), 1.0);
        }
    }

    #[test]
    fn exact_terms_are_brighter_than_the_papers_for_smooth_surfaces_and_equal_at_normal_incidence()
    {
        let args = (0.5f32, 0.5f32, 0.0f32, 0.5f32, 0.2f32);
        let (paper, smith) = (
            Reflectance::Paper.specular(args.0, args.1, args.2, args.3, args.4),
            Reflectance::Smith.specular(args.0, args.1, args.2, args.3, args.4),
        );
        // G1 = x/(x(1−k)+k) with k = 0.18 is 0.847 at x = 0.5; exact Smith is 0.998
        let masking = (0.9988f32 / 0.847_457_6).powi(2);
        let facets = Reflectance::Smith.fresnel(args.3) / Reflectance::Paper.fresnel(args.3);
        assert!(
            (smith / paper / facets / masking - 1.0).abs() < 0.01,
            "{}",
            smith / paper
        );
        assert!((facets - 1.2285).abs() < 1e-3, "at 60°: {facets}");
        let head_on = |m: Reflectance| m.specular(1.0, 1.0, 0.0, 1.0, 0.4);
        // (the fit to Schlick's term is 0.4 % above 0.04 there)
        assert!((head_on(Reflectance::Smith) / head_on(Reflectance::Paper) - 1.0).abs() < 5e-3);
    }
}
