//! Variance-guided filtering of a rendered frame: the edge-avoiding à-trous wavelet of Dammertz et
//! al. 2010 with the luminance weight of SVGF (Schied et al. 2017).
//!
//! The diffuse part is divided by the pixel's albedo first and multiplied afterwards, so that
//! textures stay as sharp as they were; the specular part is filtered among pixels of like class
//! and roughness; emission is not touched. Weights fall with the distance from the pixel's tangent
//! plane, with the angle of the normals, and with differences of luminance beyond what the noise
//! explains. The result is biased, by less than the noise it removes; how much of that is allowed
//! depends on the [`Purpose`].

use super::Frame;
use crate::core::geometry::{Camera, Projection};
use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::core::parallel::map_chunks;
use glam::{Vec2, Vec3};

/// Wavelet levels: the support is 4·(2^LEVELS − 1) + 1 pixels wide.
const LEVELS: u32 = 5;
/// B₃ spline.
const KERNEL: [f32; 3] = [0.375, 0.25, 0.0625];
/// Width of the luminance weight in standard deviations of the difference.
const LUMINANCE_SIGMAS: f32 = 4.0;
/// Standard deviations by which a pixel may exceed the brightest of its neighbours before it is
/// taken for a stray.
const OUTLIER_SIGMAS: f32 = 2.0;
/// Albedo below which the diffuse part is not divided further.
const ALBEDO_FLOOR: f32 = 0.02;
/// Width of the roughness weight of the specular part.
const ROUGHNESS_WIDTH: f32 = 0.04;

/// What a picture is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// To be looked at: smooth from few samples, though small highlights are flattened.
    Viewing,
    /// To measure materials from: reflections are filtered by as much as the surface's roughness
    /// blurs them anyway. What is left of their noise must be sampled away.
    Measuring,
}

/// Roughness up to which reflections to measure stay as traced, and from which on they are filtered
/// fully.
const MEASURED_SHARP: f32 = 0.15;
const MEASURED_ROUGH: f32 = 0.6;

/// What decides whether two pixels show the same surface.
#[derive(Clone, Copy)]
struct Guide {
    position: Vec3,
    normal: Vec3,
    /// 1/tolerance of the distance from the tangent plane.
    inverse_tolerance: f32,
    label: u16,
    roughness: f32,
}

/// A signal with the variance of its luminance.
#[derive(Clone, Copy)]
struct Signal {
    value: Vec3,
    variance: f32,
}

/// Neighbours of a pixel, wrapping round in a panorama.
struct Grid {
    width: usize,
    height: usize,
    wraps: bool,
}

impl Grid {
    fn neighbour(&self, x: usize, y: usize, dx: isize, dy: isize) -> Option<usize> {
        let (x, y) = (x as isize + dx, y as isize + dy);
        let (w, h) = (self.width as isize, self.height as isize);
        let x = if self.wraps { x.rem_euclid(w) } else { x };
        (x >= 0 && x < w && y >= 0 && y < h).then(|| (y * w + x) as usize)
    }
}

/// The filtered image: emission + albedo · filtered diffuse + specular, filtered as `purpose` asks.
#[must_use]
pub fn denoise(frame: &Frame, camera: &Camera, purpose: Purpose) -> RgbPlane {
    let (w, h) = (frame.emission.width, frame.emission.height);
    let grid = Grid {
        width: w,
        height: h,
        wraps: matches!(camera.projection, Projection::Equirectangular),
    };
    let guides: Vec<Guide> = (0..w * h).map(|i| guide(frame, camera, i, w)).collect();
    let albedo: Vec<Vec3> = frame
        .albedo
        .data
        .iter()
        .map(|a| a.max(Vec3::splat(ALBEDO_FLOOR)))
        .collect();
    let diffuse = (0..w * h).map(|i| {
        let scale = luminance(albedo[i]).recip();
        Signal {
            value: frame.diffuse.data[i] / albedo[i],
            variance: frame.variance.data[i][0] * scale * scale,
        }
    });
    let mut diffuse: Vec<Signal> = diffuse.collect();
    // known irradiance comes without variance
    if diffuse.iter().any(|s| s.variance > 0.0) {
        diffuse = filter(&grid, &guides, diffuse, false, LEVELS);
    }
    let specular = (0..w * h).map(|i| Signal {
        value: frame.specular.data[i],
        variance: frame.variance.data[i][1],
    });
    let levels = if purpose == Purpose::Measuring {
        SPECULAR_LEVELS
    } else {
        LEVELS
    };
    let specular = filter(&grid, &guides, specular.collect(), true, levels);
    let share = |i: usize| match purpose {
        Purpose::Viewing => 1.0,
        Purpose::Measuring => ramp(guides[i].roughness, MEASURED_SHARP, MEASURED_ROUGH),
    };
    let mut out = frame.emission.clone();
    for (i, p) in out.data.iter_mut().enumerate() {
        *p +=
            diffuse[i].value * albedo[i] + frame.specular.data[i].lerp(specular[i].value, share(i));
    }
    out
}

fn guide(frame: &Frame, camera: &Camera, i: usize, width: usize) -> Guide {
    let pixel = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
    let depth = frame.depth.data[i];
    Guide {
        position: camera.position + camera.direction(pixel) * depth,
        normal: frame.normal.data[i].normalize_or_zero(),
        // half a pixel's footprint, at least a millimetre
        inverse_tolerance: 1.0 / (0.5 * depth * camera.pixel_angle(pixel)).max(1e-3),
        label: frame.label.data[i],
        roughness: frame.class_roughness.data[i],
    }
}

/// Whether and how much pixel `b` may speak for pixel `a`.
#[inline]
fn same_surface(a: &Guide, b: &Guide, specular: bool) -> f32 {
    let cosine = a.normal.dot(b.normal);
    if cosine < 0.8 || (specular && a.label != b.label) {
        return 0.0;
    }
    let off_plane = a.normal.dot(b.position - a.position).abs() * a.inverse_tolerance;
    let mut exponent = off_plane + 60.0 * (1.0 - cosine);
    if specular {
        exponent += (a.roughness - b.roughness).abs() / ROUGHNESS_WIDTH;
    }
    if exponent > 12.0 {
        0.0
    } else {
        (-exponent).exp()
    }
}

/// First hit of a pixel, for [`filter_specular`].
#[derive(Clone, Copy, Debug, Default)]
pub struct SpecularFeature {
    /// Shading normal, zero where nothing reflects.
    pub normal: Vec3,
    /// Distance from the camera.
    pub depth: f32,
    /// Class.
    pub label: u16,
    /// Roughness.
    pub roughness: f32,
}

/// Filters specular reflection of few samples per pixel, whose noise is known only from the
/// neighbourhood. Rough surfaces blur what they reflect, so pixels of one surface may share; up to
/// `SHARP` nothing is shared, from `ROUGH` on everything.
pub fn filter_specular(specular: &mut RgbPlane, features: &[SpecularFeature], camera: &Camera) {
    let (w, h) = (specular.width, specular.height);
    let grid = Grid {
        width: w,
        height: h,
        wraps: matches!(camera.projection, Projection::Equirectangular),
    };
    let guides: Vec<Guide> = features
        .iter()
        .enumerate()
        .map(|(i, f)| {
            let pixel = Vec2::new((i % w) as f32 + 0.5, (i / w) as f32 + 0.5);
            Guide {
                position: camera.position + camera.direction(pixel) * f.depth,
                normal: f.normal.normalize_or_zero(),
                inverse_tolerance: 1.0 / (0.5 * f.depth * camera.pixel_angle(pixel)).max(1e-3),
                label: f.label,
                roughness: f.roughness,
            }
        })
        .collect();
    let share = |i: usize| {
        if guides[i].normal == Vec3::ZERO {
            0.0
        } else {
            ramp(guides[i].roughness, SHARP, ROUGH)
        }
    };
    let parts = map_chunks(w * h, 4096, |range| {
        range
            .map(|i| match share(i) > 0.0 {
                true => local_signal(&grid, &guides, specular, i),
                false => Signal {
                    value: specular.data[i],
                    variance: 0.0,
                },
            })
            .collect::<Vec<Signal>>()
    });
    let tamed: Vec<Signal> = parts.into_iter().flatten().collect();
    let filtered = wavelets(&grid, &guides, tamed, true, SPECULAR_LEVELS);
    for (i, (value, f)) in specular.data.iter_mut().zip(filtered).enumerate() {
        *value = value.lerp(f.value, share(i));
    }
}

/// Roughness up to which reflections are left as traced, and from which on they are filtered fully.
const SHARP: f32 = 0.15;
const ROUGH: f32 = 0.35;
/// Wavelet levels of [`filter_specular`] and of reflections to measure.
const SPECULAR_LEVELS: u32 = 3;
/// How far a pixel may exceed the mean of its neighbours (their two brightest left out) before it
/// counts as a stray.
const STRAY: f32 = 2.5;

/// A pixel's reflection, strays pulled down, with the variance over its 5 × 5 neighbours on the
/// same surface.
fn local_signal(grid: &Grid, guides: &[Guide], specular: &RgbPlane, i: usize) -> Signal {
    let (x, y) = (i % grid.width, i / grid.width);
    let (mut sum, mut squares, mut count, mut brightest) = (0.0f32, 0.0f32, 0.0f32, [0.0f32; 2]);
    for dy in -2isize..=2 {
        for dx in -2isize..=2 {
            let Some(j) = grid.neighbour(x, y, dx, dy).filter(|&j| j != i) else {
                continue;
            };
            if same_surface(&guides[i], &guides[j], true) < 0.05 {
                continue;
            }
            let l = luminance(specular.data[j]);
            (sum, squares, count) = (sum + l, squares + l * l, count + 1.0);
            if l > brightest[0] {
                brightest = [l, brightest[0]];
            } else {
                brightest[1] = brightest[1].max(l);
            }
        }
    }
    let here = specular.data[i];
    if count < 6.0 {
        return Signal {
            value: here,
            variance: 0.0,
        };
    }
    let n = count - 2.0;
    let mean = (sum - brightest[0] - brightest[1]).max(0.0) / n;
    let variance = ((squares - brightest[0] * brightest[0] - brightest[1] * brightest[1]) / n
        - mean * mean)
        .max(0.0);
    let limit = STRAY * mean + 2.0 * variance.sqrt();
    let value = if luminance(here) > limit {
        here * (limit / luminance(here))
    } else {
        here
    };
    Signal { value, variance }
}

/// 0 up to `low`, 1 from `high` on, linear between.
fn ramp(x: f32, low: f32, high: f32) -> f32 {
    ((x - low) / (high - low)).clamp(0.0, 1.0)
}

fn filter(
    grid: &Grid,
    guides: &[Guide],
    signal: Vec<Signal>,
    specular: bool,
    levels: u32,
) -> Vec<Signal> {
    let signal = smooth_variance(
        grid,
        guides,
        &tame_outliers(grid, guides, &signal, specular),
        specular,
    );
    wavelets(grid, guides, signal, specular, levels)
}

fn wavelets(
    grid: &Grid,
    guides: &[Guide],
    mut signal: Vec<Signal>,
    specular: bool,
    levels: u32,
) -> Vec<Signal> {
    for level in 0..levels {
        let step = 1isize << level;
        let steering = steering(grid, guides, &signal, specular);
        let wavelet = Wavelet {
            grid,
            guides,
            signal: &signal,
            steering: &steering,
            step,
            specular,
        };
        let rows = map_chunks(grid.height, 4, |range| {
            let mut out = Vec::with_capacity(range.len() * grid.width);
            for y in range {
                for x in 0..grid.width {
                    out.push(wavelet.at(x, y));
                }
            }
            out
        });
        signal = rows.into_iter().flatten().collect();
    }
    signal
}

/// Luminance and its variance, averaged over 3×3 pixels of a surface: what luminance weights are
/// taken from. A pixel's own noise in its own weights would prefer neighbours that err the same
/// way, and skewed noise would darken the image.
fn steering(grid: &Grid, guides: &[Guide], signal: &[Signal], specular: bool) -> Vec<[f32; 2]> {
    let average = |i: usize| {
        let (x, y) = (i % grid.width, i / grid.width);
        let (mut sum, mut variance, mut total) = (0.0f32, 0.0f32, 0.0f32);
        for dy in -1isize..=1 {
            for dx in -1isize..=1 {
                let Some(j) = grid.neighbour(x, y, dx, dy) else {
                    continue;
                };
                let weight = if j == i {
                    1.0
                } else {
                    same_surface(&guides[i], &guides[j], specular)
                };
                sum += weight * luminance(signal[j].value);
                variance += weight * weight * signal[j].variance;
                total += weight;
            }
        }
        [sum / total, variance / (total * total)]
    };
    let parts = map_chunks(signal.len(), 4096, |range| {
        range.map(average).collect::<Vec<[f32; 2]>>()
    });
    parts.into_iter().flatten().collect()
}

/// One level of the edge-avoiding à-trous wavelet: what each of its pixels is filtered from.
struct Wavelet<'a> {
    grid: &'a Grid,
    guides: &'a [Guide],
    signal: &'a [Signal],
    /// Luminance and variance that decide weights, see [`steering`].
    steering: &'a [[f32; 2]],
    /// Pixels between the taps of the kernel.
    step: isize,
    specular: bool,
}

impl Wavelet<'_> {
    /// The filtered pixel at column `x` of row `y`.
    fn at(&self, x: usize, y: usize) -> Signal {
        let i = y * self.grid.width + x;
        let (here, g) = (self.signal[i], &self.guides[i]);
        if g.normal == Vec3::ZERO {
            return here;
        }
        let [brightness, uncertainty] = self.steering[i];
        let (mut value, mut variance, mut total) = (Vec3::ZERO, 0.0f32, 0.0f32);
        for dy in -2isize..=2 {
            for dx in -2isize..=2 {
                let Some(j) = self.grid.neighbour(x, y, dx * self.step, dy * self.step) else {
                    continue;
                };
                let there = self.signal[j];
                let mut weight = KERNEL[dx.unsigned_abs()] * KERNEL[dy.unsigned_abs()];
                if j != i {
                    let surface = same_surface(g, &self.guides[j], self.specular);
                    if surface == 0.0 {
                        continue;
                    }
                    let [other, noise] = self.steering[j];
                    let sigma =
                        LUMINANCE_SIGMAS * (uncertainty + noise).sqrt() + 1e-5 * brightness + 1e-12;
                    weight *= surface * (-(other - brightness).abs() / sigma).exp();
                }
                value += there.value * weight;
                variance += there.variance * weight * weight;
                total += weight;
            }
        }
        Signal {
            value: value / total,
            variance: variance / (total * total),
        }
    }
}

/// Few samples misjudge their own variance: takes the mean over the same surface nearby.
fn smooth_variance(
    grid: &Grid,
    guides: &[Guide],
    signal: &[Signal],
    specular: bool,
) -> Vec<Signal> {
    let rows = map_chunks(grid.height, 4, |range| {
        let mut out = Vec::with_capacity(range.len() * grid.width);
        for y in range {
            for x in 0..grid.width {
                let i = y * grid.width + x;
                let (mut sum, mut total) = (signal[i].variance, 1.0f32);
                for dy in -2isize..=2 {
                    for dx in -2isize..=2 {
                        let Some(j) = grid.neighbour(x, y, dx, dy).filter(|&j| j != i) else {
                            continue;
                        };
                        let weight = same_surface(&guides[i], &guides[j], specular);
                        sum += weight * signal[j].variance;
                        total += weight;
                    }
                }
                out.push(Signal {
                    value: signal[i].value,
                    variance: sum / total,
                });
            }
        }
        out
    });
    rows.into_iter().flatten().collect()
}

/// Pulls pixels that stand out of all their neighbours on the same surface, and are uncertain
/// themselves, down to what the brightest of these and their noise allow: one lucky path would
/// otherwise become a disc.
fn tame_outliers(grid: &Grid, guides: &[Guide], signal: &[Signal], specular: bool) -> Vec<Signal> {
    let tame = |i: usize| {
        let (x, y) = (i % grid.width, i / grid.width);
        let here = signal[i];
        let brightness = luminance(here.value);
        if here.variance.sqrt() < 0.3 * brightness {
            return here;
        }
        // (brightest, summed variance, count) over the neighbours on the same surface, and over all
        // of them: a pixel across an edge has few of the former
        let (mut same, mut all) = ((0.0f32, 0.0f32, 0), (0.0f32, 0.0f32, 0));
        for dy in -1isize..=1 {
            for dx in -1isize..=1 {
                let Some(j) = grid
                    .neighbour(x, y, dx, dy)
                    .filter(|&j| j != i && guides[j].normal != Vec3::ZERO)
                else {
                    continue;
                };
                let count = |c: &mut (f32, f32, i32)| {
                    *c = (
                        c.0.max(luminance(signal[j].value)),
                        c.1 + signal[j].variance,
                        c.2 + 1,
                    );
                };
                count(&mut all);
                if same_surface(&guides[i], &guides[j], specular) > 0.05 {
                    count(&mut same);
                }
            }
        }
        let (brightest, variance, count) = if same.2 < 4 { all } else { same };
        // one pixel in nine is the brightest of its neighbourhood: only what their noise does not
        // explain is taken away
        let mean_variance = variance / count.max(1) as f32;
        let limit = brightest + OUTLIER_SIGMAS * mean_variance.sqrt();
        if count < 4 || brightness <= limit {
            return here;
        }
        Signal {
            value: here.value * (limit / brightness),
            variance: here.variance.min(mean_variance),
        }
    };
    let parts = map_chunks(signal.len(), 4096, |range| {
        range.map(tame).collect::<Vec<Signal>>()
    });
    parts.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;
    use crate::core::sampling::KeyedRng;
    use glam::Mat3;

    #[test]
    fn rough_reflections_lose_their_noise_and_mirrors_stay_as_traced() {
        let (w, h) = (64, 32);
        let lens = crate::core::geometry::Lens::centred(w, h, 60.0);
        let camera = Camera {
            projection: Projection::Pinhole(lens),
            width: w,
            height: h,
            world_from_camera: Mat3::IDENTITY,
            position: Vec3::ZERO,
        };
        let truth = |i: usize| 0.5 + 0.4 * ((i % w) as f32 / w as f32);
        let mut rng = KeyedRng::new(5, 6);
        let noisy: Vec<Vec3> = (0..w * h)
            .map(|i| {
                let stray = if rng.next_f32() < 0.01 { 30.0 } else { 1.0 };
                Vec3::splat(truth(i) * stray * (0.5 + rng.next_f32()))
            })
            .collect();
        for (roughness, gain) in [(0.6, 8.0), (0.1, 1.0)] {
            let mut plane = RgbPlane {
                width: w,
                height: h,
                data: noisy.clone(),
            };
            let features: Vec<SpecularFeature> = (0..w * h)
                .map(|i| {
                    let d = camera.direction(Vec2::new((i % w) as f32 + 0.5, (i / w) as f32 + 0.5));
                    SpecularFeature {
                        normal: Vec3::Z,
                        depth: -2.0 / d.z,
                        label: 1,
                        roughness,
                    }
                })
                .collect();
            filter_specular(&mut plane, &features, &camera);
            if roughness < SHARP {
                assert_eq!(plane.data, noisy);
                continue;
            }
            let error = |p: &[Vec3]| {
                (p.iter()
                    .enumerate()
                    .map(|(i, v)| (v.x - truth(i)).powi(2))
                    .sum::<f32>()
                    / (w * h) as f32)
                    .sqrt()
            };
            assert!(
                error(&plane.data) * gain < error(&noisy),
                "{} {}",
                error(&plane.data),
                error(&noisy)
            );
            assert!(error(&plane.data) < 0.12, "{}", error(&plane.data));
        }
    }

    /// A wall and a floor with a textured albedo, a shadow edge, and noise of known variance.
    fn noisy_frame(sigma: f32) -> (Frame, Camera, RgbPlane) {
        let (w, h) = (96, 64);
        let lens = crate::core::geometry::Lens {
            fl_x: 80.0,
            fl_y: 80.0,
            cx: 48.0,
            cy: 32.0,
            ..Default::default()
        };
        let projection = Projection::Pinhole(lens);
        let camera = Camera {
            projection,
            width: w,
            height: h,
            world_from_camera: Mat3::IDENTITY,
            position: Vec3::ZERO,
        };
        let mut rng = KeyedRng::new(1, 2);
        let zero = Plane::filled(w, h, Vec3::ZERO);
        let (mut diffuse, mut truth, mut albedo, mut normal) =
            (zero.clone(), zero.clone(), zero.clone(), zero.clone());
        let mut depth = Plane::filled(w, h, 0.0);
        for y in 0..h {
            for x in 0..w {
                let d = camera.direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
                let (to_wall, to_floor) = (
                    3.0 / -d.z,
                    if d.y < 0.0 { 1.0 / -d.y } else { f32::INFINITY },
                );
                let floor = to_floor < to_wall;
                depth[(x, y)] = to_wall.min(to_floor);
                normal[(x, y)] = if floor { Vec3::Y } else { Vec3::Z };
                let a = Vec3::new(0.2 + 0.5 * ((x / 3) % 2) as f32, 0.5, 0.3);
                let light = if x > 40 { 1.0 } else { 0.4 };
                let noise: f32 = (0..12).map(|_| rng.next_f32()).sum::<f32>() - 6.0;
                albedo[(x, y)] = a;
                truth[(x, y)] = a * light;
                diffuse[(x, y)] = a * (light + sigma * noise).max(0.0);
            }
        }
        let variance = albedo.map(|a| [(sigma * luminance(*a)).powi(2), 0.0]);
        let frame = Frame {
            emission: zero.clone(),
            diffuse,
            specular: zero,
            variance,
            class_albedo: albedo.clone(),
            class_metallic: Plane::filled(w, h, 0.0),
            class_transmission: Plane::filled(w, h, 0.0),
            albedo,
            normal,
            depth,
            label: Plane::filled(w, h, 1),
            class_roughness: Plane::filled(w, h, 0.5),
        };
        (frame, camera, truth)
    }

    fn rmse(a: &RgbPlane, b: &RgbPlane) -> f64 {
        let sum: f64 = a
            .data
            .iter()
            .zip(&b.data)
            .map(|(p, q)| f64::from((*p - *q).length_squared()))
            .sum();
        (sum / (3 * a.data.len()) as f64).sqrt()
    }

    #[test]
    fn removes_noise_and_keeps_texture_and_shadow_edges() {
        let (frame, camera, truth) = noisy_frame(0.1);
        let before = rmse(&frame.radiance(), &truth);
        let after = rmse(&denoise(&frame, &camera, Purpose::Viewing), &truth);
        assert!(after < 0.25 * before, "from {before} to {after}");
    }

    #[test]
    fn a_frame_without_noise_stays_as_it_is() {
        let (frame, camera, truth) = noisy_frame(0.0);
        let error = rmse(&denoise(&frame, &camera, Purpose::Viewing), &truth);
        assert!(error < 1e-4, "{error}");
    }

    #[test]
    fn reflections_to_measure_stay_as_traced_where_they_are_sharp_and_only_there() {
        let (mut frame, camera, diffuse) = noisy_frame(0.0);
        let reflection = |i: usize| {
            let (x, y) = ((i % 96) as f32, (i / 96) as f32);
            Vec3::splat(0.2 + 2.0 * (-((x - 20.0).powi(2) + (y - 20.0).powi(2)) / 800.0).exp())
        };
        let mut rng = KeyedRng::new(3, 4);
        for i in 0..frame.specular.data.len() {
            let sigma = 0.3 * reflection(i).x;
            frame.specular.data[i] =
                reflection(i) + Vec3::splat(sigma * (rng.next_f32() - 0.5) * 12f32.sqrt());
            frame.variance.data[i][1] = sigma * sigma;
        }
        let mut truth = diffuse;
        truth
            .data
            .iter_mut()
            .enumerate()
            .for_each(|(i, t)| *t += reflection(i));
        let traced = frame.radiance();
        for (roughness, least, most) in [(0.1, 0.0, 1e-4), (0.8, 0.7, 1.0)] {
            frame.class_roughness = Plane::filled(96, 64, roughness);
            let measured = denoise(&frame, &camera, Purpose::Measuring);
            let change = rmse(&measured, &traced) / rmse(&traced, &truth);
            assert!(
                (least..most).contains(&change),
                "roughness {roughness}: noise removed {change}"
            );
            assert!(roughness < 0.5 || rmse(&measured, &truth) < 0.5 * rmse(&traced, &truth));
        }
    }
}
