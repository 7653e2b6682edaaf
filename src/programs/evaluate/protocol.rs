//! The published protocols, each as small functions, and the sentences that say what they do.

use super::options::EvalOptions;
use super::truth::GroundTruth;
use crate::core::image::{Plane, RgbPlane};
use crate::core::metrics::least_squares_scale;
use crate::core::parallel::prelude::*;
use glam::Vec3;
use std::collections::BTreeSet;

/// Largest width at which images are compared (TexIR: 512×256 panoramas).
pub const WORKING_WIDTH: usize = 512;

/// What only some scenes' truth knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Known {
    /// Which pixels are metal.
    pub metals: bool,
    /// Which pixels show a pane.
    pub panes: bool,
}

/// What every figure means, for the readers of `metrics.json`; those of metals and panes where the
/// truth is known.
#[must_use]
pub fn descriptions(options: &EvalOptions, known: Known) -> Vec<String> {
    let mut lines = vec![
        format!(
            "rendering: linear radiance box-averaged to 512x256 (native size if smaller), exposure {:+} EV, clamp(x^(1/2.2), 0, 1); \
             SSIM as pytorch_msssim (11x11 Gaussian, sigma 1.5, K 0.01/0.03, windows inside the image)",
            options.exposure
        ),
        "gains: the same after the gain on linear radiance, one per view (or per view and channel), that minimises the view's MSE; \
         ceiling_reprojected: the fused radiance (radiance.exr) seen through the same cameras, with one gain per view and (as_is) without"
            .into(),
        "materials: at the frame's size, each pixel's being the mean over the surfaces in it of the class its label names, as the ground \
         truth is; pixels without geometry (label 0) and of classes of kind light are left out; values clipped \
         to [0, 1]; nothing is overwritten; PSNR has peak 1 and is at most 100 dB"
            .into(),
        "linear: no alignment of any kind".into(),
        "fipt: no scale alignment, roughness of both clamped to [0.2, 1]; emitters are left out (its authors set them to zero in \
         both images, which counts them as perfect)"
            .into(),
        "texir: one least-squares scale per view for albedo, all channels together, before clipping; roughness is not scaled and \
         equals linear"
            .into(),
        "emission: IoU of emitting pixels and mean squared difference of log(1 + L_e) over all pixels, as FIPT; truth from \
         gt/emission, otherwise pixels of classes of kind light emit what the photograph shows there (pixels far darker than their \
         class are housing); power_ratio: stated over true radiance where both emit, power_ratio_gained: with one gain per view"
            .into(),
        "calibration: pixels binned by the stated standard error (confidence.exr), root mean square of the actual error per bin; \
         albedo by luminance"
            .into(),
        "psnr_of_mean_mse: -10 log10 of the mean over images of the MSE; mean_psnr: mean over images of the PSNR".into(),
    ];
    if known.metals {
        lines.push(
            "metals: pixels more than half metal against gt/metallic; found: share of the true ones, wrong: share of the stated ones \
             that are not; f0_error, roughness_error: root mean square over the pixels that are both"
                .into(),
        );
    }
    if known.panes {
        lines.push(
            "panes: pixels more than half transparent against gt/transmission; found: share of the true ones, wrong: share of the \
             stated ones that are not; transmittance_error: root mean square of transmission times albedo over the pixels that are both"
                .into(),
        );
    }
    if options.quantise {
        lines.push("fipt values are rounded to 8 bits before comparison".into());
    }
    lines
}

/// The size at which a `width × height` image is compared: at most 512 columns, same aspect.
#[must_use]
pub fn working_size(width: usize, height: usize) -> (usize, usize) {
    if width <= WORKING_WIDTH {
        return (width, height);
    }
    let scaled = (height * WORKING_WIDTH + width / 2) / width;
    (WORKING_WIDTH, scaled.max(1))
}

/// Averages the `valid` pixels under each pixel of a smaller image, weighted by covered area. The
/// second plane says where there was any; the first is 0 elsewhere.
#[must_use]
pub fn box_average(
    image: &RgbPlane,
    valid: &Plane<bool>,
    width: usize,
    height: usize,
) -> (RgbPlane, Plane<bool>) {
    // the source pixels under output pixel i and the share of each that it covers
    let cover = |i: usize, n: usize, source: usize| {
        let (begin, end) = (
            i as f64 * source as f64 / n as f64,
            (i + 1) as f64 * source as f64 / n as f64,
        );
        let last = (end.ceil() as usize).min(source);
        (begin as usize..last)
            .map(move |s| (s, (end.min(s as f64 + 1.0) - begin.max(s as f64)).max(0.0)))
    };
    let pixels: Vec<Option<Vec3>> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let (mut sum, mut weight) = (glam::DVec3::ZERO, 0.0);
            for (y, wy) in cover(i / width, height, image.height) {
                for (x, wx) in cover(i % width, width, image.width) {
                    if valid[(x, y)] && wx * wy > 1e-9 {
                        sum += image[(x, y)].as_dvec3() * (wx * wy);
                        weight += wx * wy;
                    }
                }
            }
            (weight > 0.0).then(|| (sum / weight).as_vec3())
        })
        .collect();
    let counted = Plane {
        width,
        height,
        data: pixels.iter().map(Option::is_some).collect(),
    };
    (
        Plane {
            width,
            height,
            data: pixels
                .into_iter()
                .map(|p| p.unwrap_or(Vec3::ZERO))
                .collect(),
        },
        counted,
    )
}

/// γ of TexIR's display transform.
pub const DISPLAY_EXPONENT: f32 = 2.2;

/// max(gain·x, 0)^(1/γ), not clipped above; NaN stays NaN, so that it scores as an error.
#[must_use]
pub fn display(image: &RgbPlane, gain: f32) -> RgbPlane {
    image.map(|v| {
        v.map(|x| {
            if x.is_nan() {
                x
            } else {
                (x * gain).max(0.0).powf(1.0 / DISPLAY_EXPONENT)
            }
        })
    })
}

/// TexIR's display transform clamp((gain·x)^(1/γ), 0, 1); NaN stays NaN.
#[must_use]
pub fn tone_mapped(image: &RgbPlane, gain: f32) -> RgbPlane {
    clipped(&display(image, gain))
}

/// Display values clipped at 1; NaN stays NaN.
#[must_use]
pub fn clipped(image: &RgbPlane) -> RgbPlane {
    image.map(|v| v.map(|x| if x.is_nan() { x } else { x.min(1.0) }))
}

/// The nearest multiple of 1/255 in [0, 1].
#[must_use]
pub fn quantised(x: f32) -> f32 {
    (x.clamp(0.0, 1.0) * 255.0).round() / 255.0
}

/// Pixels that count for material scores: geometry of a class that is not a light, with finite
/// ground truth.
#[must_use]
pub fn material_mask(
    labels: &Plane<u16>,
    truth: &GroundTruth,
    lights: &BTreeSet<u16>,
) -> Plane<bool> {
    let counts = |i: usize| {
        let label = labels.data[i];
        label != 0
            && !lights.contains(&label)
            && truth.albedo.data[i].is_finite()
            && truth.roughness.data[i].is_finite()
    };
    Plane {
        width: labels.width,
        height: labels.height,
        data: (0..labels.data.len()).map(counts).collect(),
    }
}

/// The prediction times the scalar that brings it closest to the truth, and that scalar.
#[must_use]
pub fn least_squares_albedo(
    prediction: &RgbPlane,
    truth: &RgbPlane,
    mask: &Plane<bool>,
) -> (RgbPlane, f64) {
    let scale = least_squares_scale(prediction, truth, mask);
    (prediction.map(|v| *v * scale as f32), scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_average_keeps_the_mean_at_any_ratio() {
        let image = Plane {
            width: 7,
            height: 5,
            data: (0..35).map(|i| Vec3::splat((i * i % 13) as f32)).collect(),
        };
        let valid = Plane::filled(7, 5, true);
        let (small, counted) = box_average(&image, &valid, 3, 2);
        let mean =
            |p: &RgbPlane| p.data.iter().map(|v| f64::from(v.x)).sum::<f64>() / p.data.len() as f64;
        assert!(
            (mean(&small) - mean(&image)).abs() < 1e-5,
            "area weights partition the image"
        );
        assert!(counted.data.iter().all(|c| *c));
        assert_eq!(
            box_average(&image, &valid, 7, 5).0,
            image,
            "same size is the identity"
        );
    }

    #[test]
    fn invalid_pixels_do_not_enter_the_average() {
        let mut image = Plane::filled(4, 2, Vec3::splat(0.5));
        let mut valid = Plane::filled(4, 2, true);
        image[(0, 0)] = Vec3::NAN;
        valid[(0, 0)] = false;
        for x in 2..4 {
            for y in 0..2 {
                valid[(x, y)] = false;
            }
        }
        let (small, counted) = box_average(&image, &valid, 2, 1);
        assert_eq!(small.data[0], Vec3::splat(0.5));
        assert_eq!(counted.data, vec![true, false]);
    }

    #[test]
    fn working_size_is_texirs_for_panoramas_and_never_larger() {
        assert_eq!(working_size(1024, 512), (512, 256));
        assert_eq!(working_size(768, 384), (512, 256));
        assert_eq!(working_size(320, 160), (320, 160));
        assert_eq!(working_size(640, 480), (512, 384));
    }

    #[test]
    fn tone_mapping_and_quantisation_have_their_closed_forms() {
        let p = Plane {
            width: 3,
            height: 1,
            data: vec![Vec3::splat(0.25), Vec3::splat(9.0), Vec3::splat(-1.0)],
        };
        let t = tone_mapped(&p, 2.0);
        assert!((t.data[0].x - 0.5f32.powf(1.0 / 2.2)).abs() < 1e-6);
        assert_eq!((t.data[1], t.data[2]), (Vec3::ONE, Vec3::ZERO));
        assert!((quantised(0.501) - 128.0 / 255.0).abs() < 1e-7);
    }
}
