//! Stage I in closed form: a texel's albedo is π/E times its diffuse radiance, the robust mean over
//! views of the observed radiance less the specular part.

use super::TexelReflectance;
use crate::core::blocks::{Columns, Packed, column, flags, truths, values};
use crate::core::image::RgbPlane;
use crate::core::math::{HALF_STEP, luminance};
use crate::core::progress::Progress;
use crate::core::stats::weighted_median;
use crate::core::texture::Texels;
use crate::gbuffer::{Observation, Observer, Orientation};
use glam::Vec3;
use std::f32::consts::PI;

/// Albedo below which ln albedo means nothing.
pub const BLACK: f32 = HALF_STEP;

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

/// The light that is taken out of photographs to leave albedo.
#[derive(Clone, Copy)]
pub struct Shading<'a> {
    /// Irradiance on its texture: what divides.
    pub irradiance: &'a RgbPlane,
    /// Per view, the specular part of its radiance, as large as its image: what is subtracted.
    pub specular: &'a [RgbPlane],
}

/// Estimates the albedo of every covered texel from the views that see it.
#[must_use]
pub fn estimate_albedo(
    observer: &Observer,
    texels: &Texels,
    orientation: &Orientation,
    shading: Shading<'_>,
    reflectance: &TexelReflectance,
    progress: &Progress,
) -> AlbedoEstimate {
    // size of work
    const CHUNK: usize = 2048;
    // tasks per block that processes share, as where radiance is fused: size of work
    const BLOCK: usize = 8;
    let mesh = observer.mesh;
    let parts = progress.map_chunks(texels.len(), CHUNK, BLOCK, |range| {
        let mut out = AlbedoEstimate::default();
        let mut seen = Vec::new();
        for i in range.clone() {
            let t = texels.point[i].triangle as usize;
            observer.observe(
                texels.position(mesh, i),
                mesh.face_normal(t) * orientation.sign(t),
                &mut seen,
            );
            crate::observed::prefer_clean(&mut seen);
            let looks = Looks::of(i, &seen, observer, shading.specular, reflectance);
            out.push(&looks.albedo(texels.lookup(mesh, shading.irradiance, i)));
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

/// One texel's entries of an [`AlbedoEstimate`].
struct TexelAlbedo {
    value: Vec3,
    error: f32,
    looks: f32,
    specular_share: f32,
    clean: bool,
    footprint: f32,
}

impl AlbedoEstimate {
    /// Nothing is known of texel `i` any more.
    pub fn forget(&mut self, i: usize) {
        self.value[i] = Vec3::ZERO;
        self.error[i] = f32::INFINITY;
        self.clean[i] = false;
    }

    fn push(&mut self, texel: &TexelAlbedo) {
        self.value.push(texel.value);
        self.error.push(texel.error);
        self.looks.push(texel.looks);
        self.specular_share.push(texel.specular_share);
        self.clean.push(texel.clean);
        self.footprint.push(texel.footprint);
    }
}

impl Packed for AlbedoEstimate {
    fn columns(&self) -> Columns {
        let Self {
            value,
            error,
            looks,
            specular_share,
            clean,
            footprint,
        } = self;
        vec![
            column(value),
            column(error),
            column(looks),
            column(specular_share),
            truths(clean),
            column(footprint),
        ]
    }

    fn restored(columns: &[Vec<u8>]) -> Option<Self> {
        let [value, error, looks, specular_share, clean, footprint] = columns else {
            return None;
        };
        Some(Self {
            value: values(value)?,
            error: values(error)?,
            looks: values(looks)?,
            specular_share: values(specular_share)?,
            clean: flags(clean),
            footprint: values(footprint)?,
        })
    }
}

/// What the views show of a texel.
struct Looks {
    /// Diffuse radiance as a Lambertian surface would send it out, and its weight.
    diffuse: Vec<(Vec3, f32)>,
    /// Weighted mean share of the specular part.
    specular_share: f32,
    /// Whether one of them is clean.
    clean: bool,
    /// The sharpest one's footprint, metres; infinite without any.
    sharpest: f32,
}

impl Looks {
    /// Takes the specular part out of what was seen of texel `i`.
    fn of(
        i: usize,
        seen: &[Observation],
        observer: &Observer,
        specular: &[RgbPlane],
        reflectance: &TexelReflectance,
    ) -> Self {
        let sharpest = seen
            .iter()
            .map(|o| o.footprint)
            .fold(f32::INFINITY, f32::min);
        let mut diffuse = Vec::with_capacity(seen.len());
        let (mut share_sum, mut total) = (0.0, 0.0f32);
        for o in seen {
            let wrap = observer.views[o.view as usize].buffer.wrap();
            let s = specular[o.view as usize].bilinear(o.pixel, wrap);
            // where the specular part is a large share, its own error is too
            let share = luminance(s) / luminance(o.radiance).max(1e-12);
            let w = (sharpest / o.footprint).powi(4) * o.n_v / (1.0 + (share / 0.15).powi(2));
            let factor = reflectance.diffuse_factor(i, o.n_v);
            share_sum += w * share.min(1.0);
            total += w;
            diffuse.push(((o.radiance - s) / factor, w));
        }
        Self {
            diffuse,
            specular_share: share_sum / total.max(f32::MIN_POSITIVE),
            clean: seen.iter().any(|o| o.clean),
            sharpest,
        }
    }

    /// π/E times their robust mean, in irradiance `lit`.
    fn albedo(&self, lit: Vec3) -> TexelAlbedo {
        // without light nothing is known of what would reflect it
        if luminance(lit) <= 0.0 {
            return TexelAlbedo {
                value: Vec3::ZERO,
                error: f32::INFINITY,
                looks: 0.0,
                specular_share: 0.0,
                clean: false,
                footprint: self.sharpest,
            };
        }
        // a channel without light keeps a finite albedo whatever the exposure
        let e = lit.max(Vec3::splat(luminance(lit) * 1e-6));
        let (diffuse, spread, effective) = robust_diffuse(&self.diffuse);
        TexelAlbedo {
            value: diffuse * PI / e,
            error: spread * PI / luminance(e),
            looks: effective,
            specular_share: self.specular_share,
            clean: self.clean,
            footprint: self.sharpest,
        }
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
