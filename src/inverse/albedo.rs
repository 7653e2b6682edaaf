//! Stage I in closed form: a texel's albedo is π/E times its diffuse radiance, the robust mean over
//! views of the observed radiance less the specular part.

use super::TexelReflectance;
use crate::gbuffer::{Observer, Orientation};
use crate::image::RgbPlane;
use crate::math::luminance;
use crate::optim::weighted_median;
use crate::parallel;
use crate::progress::Progress;
use crate::texture::Texels;
use glam::Vec3;

/// Albedo per covered texel.
#[derive(Clone, Debug, Default)]
pub struct AlbedoEstimate {
    /// Albedo, not clamped; zero where unobserved.
    pub value: Vec<Vec3>,
    /// Standard error of its luminance as far as the views' disagreement tells; infinite where
    /// unobserved.
    pub error: Vec<f32>,
    /// Effective number of independent looks; 0 where unobserved.
    pub looks: Vec<f32>,
    /// Weighted mean share of the specular part in the looks' radiance.
    pub specular_share: Vec<f32>,
    /// Whether a look is clean: free of edges and clipping.
    pub clean: Vec<bool>,
    /// Side of the sharpest look's pixel footprint on the surface, metres; infinite where
    /// unobserved.
    pub footprint: Vec<f32>,
}

/// Estimates albedo from views whose specular part is `specular[v]` (same size as view v's image).
#[must_use]
pub fn estimate_albedo(
    observer: &Observer,
    specular: &[RgbPlane],
    orientation: &Orientation,
    texels: &Texels,
    irradiance: &RgbPlane,
    reflectance: &TexelReflectance,
    progress: &Progress,
) -> AlbedoEstimate {
    const CHUNK: usize = 2048;
    let mesh = observer.mesh;
    let parts = parallel::map_chunks(texels.len(), CHUNK, |range| {
        let mut out = AlbedoEstimate::default();
        let mut seen = Vec::new();
        let mut looks: Vec<(Vec3, f32)> = Vec::new();
        for i in range.clone() {
            let t = texels.point[i].triangle as usize;
            observer.observe(
                texels.position(mesh, i),
                mesh.face_normal(t) * orientation.sign(t),
                &mut seen,
            );
            crate::observed::prefer_clean(&mut seen);
            looks.clear();
            let mut mean_share = 0.0;
            let sharpest = seen
                .iter()
                .map(|o| o.footprint)
                .fold(f32::INFINITY, f32::min);
            for o in &seen {
                let s = specular[o.view as usize]
                    .bilinear(o.pixel, observer.views[o.view as usize].buffer.wrap());
                // where the specular part is a large share, its own error is too
                let share = luminance(s) / luminance(o.radiance).max(1e-12);
                let w = (sharpest / o.footprint).powi(4) * o.n_v / (1.0 + (share / 0.15).powi(2));
                let factor = reflectance.diffuse_factor(i, o.n_v);
                mean_share += w * share.min(1.0);
                looks.push(((o.radiance - s) / factor, w));
            }
            let lit = texels.lookup(mesh, irradiance, i);
            // a channel without light keeps a finite albedo whatever the exposure
            let e = lit.max(Vec3::splat(luminance(lit) * 1e-6));
            let (diffuse, spread, effective) = robust_diffuse(&looks);
            let specular_share = mean_share
                / looks
                    .iter()
                    .map(|l| l.1)
                    .sum::<f32>()
                    .max(f32::MIN_POSITIVE);
            // without light nothing is known of what would reflect it
            if luminance(lit) <= 0.0 {
                out.push(Vec3::ZERO, f32::INFINITY, [0.0; 2], (false, sharpest));
                continue;
            }
            let error = spread * std::f32::consts::PI / luminance(e);
            let clean = seen.iter().any(|o| o.clean);
            out.push(
                diffuse * std::f32::consts::PI / e,
                error,
                [effective, specular_share],
                (clean, sharpest),
            );
        }
        progress.advance(range.len() as u64);
        out
    });
    let mut all = AlbedoEstimate::default();
    for p in parts {
        all.value.extend(p.value);
        all.error.extend(p.error);
        all.looks.extend(p.looks);
        all.specular_share.extend(p.specular_share);
        all.clean.extend(p.clean);
        all.footprint.extend(p.footprint);
    }
    all
}

impl AlbedoEstimate {
    fn push(
        &mut self,
        value: Vec3,
        error: f32,
        [looks, specular_share]: [f32; 2],
        (clean, footprint): (bool, f32),
    ) {
        self.value.push(value);
        self.error.push(error);
        self.looks.push(looks);
        self.specular_share.push(specular_share);
        self.clean.push(clean);
        self.footprint.push(footprint);
    }
}

/// Weighted robust mean of diffuse radiances, its standard error and the effective number of looks;
/// (0, ∞, 0) without any.
fn robust_diffuse(looks: &[(Vec3, f32)]) -> (Vec3, f32, f32) {
    if looks.is_empty() {
        return (Vec3::ZERO, f32::INFINITY, 0.0);
    }
    let order: Vec<(f32, f32)> = looks.iter().map(|l| (luminance(l.0), l.1)).collect();
    let median = weighted_median(&order).map_or(0.0, |i| order[i].0);
    let tolerance = 0.06 * median.abs() + f32::MIN_POSITIVE;
    let (mut sum, mut total, mut square, mut weight2) = (Vec3::ZERO, 0.0, 0.0, 0.0);
    for (v, w) in looks {
        let r = (luminance(*v) - median) / tolerance;
        let k = w / (1.0 + r * r);
        sum += *v * k;
        total += k;
        square += k * (luminance(*v) - median).powi(2);
        weight2 += k * k;
    }
    if total <= 0.0 {
        return (looks[0].0, median.abs(), 1.0);
    }
    let effective = total * total / weight2;
    (
        sum / total,
        ((square / total).max((0.02 * median).powi(2)) / effective).sqrt(),
        effective,
    )
}
