//! What the photographs bring to the test of alignment: small log images, their contrasts across
//! pairs of neighbouring pixels, and class ids. Made once; every hypothesis is scored against it.

use crate::core::geometry::{Camera, Projection};
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::math::luminance;
use crate::gbuffer::wrap_of;
use crate::scene::{Scene, View};
use crate::{Error, Result};
use glam::{Vec2, Vec3, Vec4};
use std::f32::consts::{PI, TAU};

/// How much is taken from each photograph.
#[derive(Clone, Copy, Debug)]
pub struct EvidenceSize {
    /// Widest small image, pixels.
    pub width: usize,
    /// Samples per view.
    pub samples: usize,
}

impl EvidenceSize {
    /// For the verdict: 1.9° per pixel of a panorama, finer than the steps of the search.
    pub const COARSE: Self = Self {
        width: 192,
        samples: 450,
    };
    /// For the refinement of poses after a coarse look, to half a degree per pixel.
    pub const FINER: [Self; 2] = [
        Self {
            width: 384,
            samples: 3000,
        },
        Self {
            width: 768,
            samples: 4000,
        },
    ];
}

/// Half the distance of the two pixels of a pair, as a share of the small image's width (2.8° of a
/// panorama).
const PAIR_REACH: f32 = 1.5 / 192.0;
/// The small image's width over the radius of the mean that is taken off for the detail channel
/// (11° of a panorama).
const SURROUND: usize = 32;
/// Radiance below this share of the view's mean is noise to a logarithm.
const FLOOR: f32 = 0.01;
/// Colour differences of rooms are a fraction of their differences of brightness.
const CHROMA_WEIGHT: f32 = 2.0;
/// Rows this near to a pole show tripods and stitching (angle in radians, 12°).
const POLE: f32 = 0.21;

/// Two neighbouring points of a sample and how much the photograph differs between them.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    /// Both points, pixels of the small image.
    pub ends: [Vec2; 2],
    /// Rank of the contrast between the ends among all pairs of the view, in (0, 1).
    pub rank: f32,
    /// Class ids at the ends; 0 = none.
    pub labels: [u16; 2],
}

/// A pixel of a view that is followed into the scene.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Place in the small image, pixels.
    pub pixel: Vec2,
    /// Log luminance, two weighted log chromaticities, log luminance less its surround.
    pub feature: Vec4,
    /// Class id; 0 = none.
    pub label: u16,
    /// A horizontal and a vertical pair around it.
    pub pairs: [Pair; 2],
}

/// One view's evidence.
#[derive(Clone, Debug)]
pub struct ViewEvidence {
    /// Name of the view.
    pub stem: String,
    /// The camera as loaded, at the small image's size.
    pub camera: Camera,
    /// See `Sample::feature`.
    pub features: Plane<Vec4>,
    /// Pixels with light, inside the mask.
    pub valid: Plane<bool>,
    /// Class ids; `None` without labels.
    pub labels: Option<Plane<u16>>,
    /// Points spread evenly over the sphere or the frame.
    pub samples: Vec<Sample>,
    /// The contrast (difference of log radiance) that a tenth of the pairs exceed.
    pub contrast: f32,
}

impl ViewEvidence {
    /// Evidence of one view from its pixels; `labels` at any size of the same aspect.
    #[must_use]
    pub fn new(
        stem: &str,
        camera: &Camera,
        image: &RgbPlane,
        mask: Option<&Plane<bool>>,
        labels: Option<&Plane<u16>>,
        size: EvidenceSize,
    ) -> Self {
        let width = size.width.min(image.width);
        let height = (image.height * width / image.width).max(1);
        let camera = camera.resized(width, height);
        let wrap = wrap_of(&camera);
        let (features, valid) = log_image(image, mask, width, height, wrap);
        let labels = labels.map(|l| {
            let scale = Vec2::new(
                l.width as f32 / width as f32,
                l.height as f32 / height as f32,
            );
            let data = (0..width * height)
                .map(|i| *l.nearest((pixel(i, width)) * scale))
                .collect();
            Plane {
                width,
                height,
                data,
            }
        });
        let mut view = Self {
            stem: stem.to_owned(),
            camera,
            features,
            valid,
            labels,
            samples: Vec::new(),
            contrast: 0.0,
        };
        view.samples = spread(&camera, size.samples)
            .into_iter()
            .filter_map(|p| view.sample(p, wrap))
            .collect();
        view.rank_pairs(wrap);
        view
    }

    /// Class id at a place of the small image; 0 without labels.
    #[must_use]
    pub fn label(&self, p: Vec2) -> u16 {
        self.labels.as_ref().map_or(0, |l| *l.nearest(p))
    }

    fn sample(&self, p: Vec2, wrap: Wrap) -> Option<Sample> {
        let (w, h) = (self.features.width as f32, self.features.height as f32);
        let stretch = match self.camera.projection {
            Projection::Equirectangular => 1.0 / (PI * p.y / h).sin().max(0.2),
            Projection::Pinhole(_) => 1.0,
        };
        let bring_in = |q: Vec2| match wrap {
            Wrap::Repeat => Some(Vec2::new(q.x.rem_euclid(w), q.y)),
            Wrap::Clamp => (q.x >= 0.0 && q.x < w && q.y >= 0.0 && q.y < h).then_some(q),
        };
        let pair = |reach: Vec2| -> Option<Pair> {
            let ends = [bring_in(p - reach)?, bring_in(p + reach)?];
            let good = ends.iter().all(|e| *self.valid.nearest(*e));
            good.then(|| Pair {
                ends,
                rank: 0.5,
                labels: ends.map(|e| self.label(e)),
            })
        };
        let reach = PAIR_REACH * w;
        let pairs = [
            pair(Vec2::new(reach * stretch, 0.0))?,
            pair(Vec2::new(0.0, reach))?,
        ];
        (*self.valid.nearest(p)).then(|| Sample {
            pixel: p,
            feature: self.features.bilinear(p, wrap),
            label: self.label(p),
            pairs,
        })
    }

    /// Ranks of contrast do not know how contrasty a room is.
    fn rank_pairs(&mut self, wrap: Wrap) {
        let contrast = |p: &Pair| {
            let d =
                self.features.bilinear(p.ends[0], wrap) - self.features.bilinear(p.ends[1], wrap);
            d.truncate().length()
        };
        let mut order: Vec<(f32, usize)> = self
            .samples
            .iter()
            .flat_map(|s| &s.pairs)
            .map(contrast)
            .enumerate()
            .map(|(i, c)| (c, i))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        self.contrast = order.get(order.len() * 9 / 10).map_or(0.0, |o| o.0);
        let n = order.len() as f32;
        for (rank, (_, i)) in order.iter().enumerate() {
            self.samples[i / 2].pairs[i % 2].rank = (rank as f32 + 0.5) / n;
        }
    }
}

/// Evidence of all training views, at most `most` of them, evenly spread in file order.
///
/// # Errors
/// Images, labels or masks that cannot be read.
pub fn gather(scene: &Scene, most: usize, size: EvidenceSize) -> Result<Vec<ViewEvidence>> {
    let sizes = gather_sizes(scene, most, &[size])?;
    Ok(sizes.into_iter().flatten().collect())
}

/// The same at several sizes, each photograph read once: one list of views per size.
///
/// # Errors
/// Images, labels or masks that cannot be read.
pub fn gather_sizes(
    scene: &Scene,
    most: usize,
    sizes: &[EvidenceSize],
) -> Result<Vec<Vec<ViewEvidence>>> {
    let train: Vec<&View> = scene.train_views().collect();
    let n = train.len().min(most);
    let chosen: Vec<&View> = (0..n).map(|i| train[i * train.len() / n.max(1)]).collect();
    let all: Vec<Result<Vec<ViewEvidence>>> = scene.decoding().map(&chosen, |view| {
        let image = scene.load_radiance(view)?;
        let labels = scene.load_labels(view)?;
        let mask = scene.load_mask(view)?;
        let at_size = |size: &EvidenceSize| {
            ViewEvidence::new(
                &view.stem,
                &view.camera,
                &image,
                mask.as_ref(),
                labels.as_ref(),
                *size,
            )
        };
        Ok(sizes.iter().map(at_size).collect())
    });
    let (mut out, mut errors) = (vec![Vec::new(); sizes.len()], Vec::new());
    for one in all {
        match one {
            Ok(view) => out.iter_mut().zip(view).for_each(|(o, v)| o.push(v)),
            Err(e) => errors.push(e),
        }
    }
    if errors.is_empty() {
        Ok(out)
    } else {
        Err(Error::Inputs(errors))
    }
}

/// Centre of pixel `i` of an image of this width.
fn pixel(i: usize, width: usize) -> Vec2 {
    Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5)
}

/// The image by cell means, in logarithms.
fn log_image(
    image: &RgbPlane,
    mask: Option<&Plane<bool>>,
    width: usize,
    height: usize,
    wrap: Wrap,
) -> (Plane<Vec4>, Plane<bool>) {
    let mut sums = Plane::filled(width, height, Vec4::ZERO);
    for y in 0..image.height {
        for x in 0..image.width {
            if mask.is_some_and(|m| !m[(x, y)]) {
                continue;
            }
            let cell = (x * width / image.width, y * height / image.height);
            sums[cell] += image[(x, y)].extend(1.0);
        }
    }
    let means = sums.map(|s| s.truncate() / s.w.max(1.0));
    let lit: Vec<f32> = means
        .data
        .iter()
        .map(|&m| luminance(m))
        .filter(|&l| l > 0.0 && l.is_finite())
        .map(f32::ln)
        .collect();
    let level = (lit.iter().map(|&x| f64::from(x)).sum::<f64>() / lit.len().max(1) as f64).exp();
    let floor = (FLOOR * level as f32).max(f32::MIN_POSITIVE);
    let mut valid = sums.map(|s| s.w > 0.0);
    // (negative radiance, which denoisers and demosaicing leave, is none)
    let mut features = means.map(|&m| {
        let m = if m.is_finite() { m } else { Vec3::ZERO };
        let v = m.max(Vec3::ZERO) + floor;
        let (r, g, b) = (v.x.ln(), v.y.ln(), v.z.ln());
        Vec4::new(
            luminance(v).ln(),
            CHROMA_WEIGHT * (r - g),
            CHROMA_WEIGHT * (b - g),
            0.0,
        )
    });
    for (v, m) in valid.data.iter_mut().zip(&means.data) {
        *v &= m.is_finite();
    }
    let surround = box_mean(&features.map(|f| f.x), width / SURROUND, wrap);
    for (f, s) in features.data.iter_mut().zip(&surround.data) {
        f.w = f.x - s;
    }
    (features, valid)
}

/// Mean over (2r + 1)² pixels, by rows and then columns.
fn box_mean(plane: &Plane<f32>, r: usize, wrap: Wrap) -> Plane<f32> {
    let (w, h, r) = (plane.width as i64, plane.height as i64, r as i64);
    let n = (2 * r + 1) as f32;
    let mut rows = plane.clone();
    let mut out = plane.clone();
    for y in 0..h {
        for x in 0..w {
            let column = |k: i64| match wrap {
                Wrap::Repeat => k.rem_euclid(w),
                Wrap::Clamp => k.clamp(0, w - 1),
            };
            rows[(x as usize, y as usize)] = (x - r..=x + r)
                .map(|k| plane[(column(k) as usize, y as usize)])
                .sum::<f32>()
                / n;
        }
    }
    for y in 0..h {
        for x in 0..w {
            out[(x as usize, y as usize)] = (y - r..=y + r)
                .map(|k| rows[(x as usize, k.clamp(0, h - 1) as usize)])
                .sum::<f32>()
                / n;
        }
    }
    out
}

/// Points evenly over the sphere (a Fibonacci lattice) or over the frame (the R2 sequence, Roberts
/// 2018).
fn spread(camera: &Camera, n: usize) -> Vec<Vec2> {
    let (w, h) = (camera.width as f32, camera.height as f32);
    (0..n)
        .map(|i| {
            let along = (i as f64 * 0.618_033_988_749_895).fract() as f32;
            let down = (i as f32 + 0.5) / n as f32;
            match camera.projection {
                Projection::Equirectangular => {
                    let theta = (POLE.cos() * (1.0 - 2.0 * down)).acos();
                    let lambda = TAU * (along - 0.5);
                    Vec2::new((lambda / TAU + 0.5) * w, theta / PI * h)
                }
                Projection::Pinhole(_) => {
                    let k = i as f64 + 0.5;
                    let u = (k * 0.754_877_666_246_693).fract() as f32;
                    let v = (k * 0.569_840_290_998_053).fract() as f32;
                    Vec2::new(w * u, h * v)
                }
            }
        })
        .collect()
}
