//! A texture that is learned by gradient descent: fetched trilinearly from its mip pyramid, its
//! gradient returned by the transpose of the fetch, one step of Adam (Kingma & Ba 2015) at a time.
//! What nvdiffrast's `texture` does in the published method.

use crate::core::image::Plane;
use crate::core::network::AdamRule;
use crate::core::parallel::prelude::*;
use glam::Vec2;

/// Where a fetch reads: texels of one or two levels with weights that sum to 1.
#[derive(Clone, Copy, Debug, Default)]
pub struct Taps {
    level: [u8; 8],
    index: [u32; 8],
    weight: [f32; 8],
}

/// One resolution of a texture of `C` channels.
#[derive(Clone, Debug)]
struct Level<const C: usize> {
    side: usize,
    texels: Vec<[f32; C]>,
}

/// The texels of the finer level that a texel of the coarser one is the mean of, along one axis.
fn children(parent: usize, coarse: usize, fine: usize) -> std::ops::Range<usize> {
    let end = if parent + 1 == coarse {
        fine
    } else {
        (2 * parent + 2).min(fine)
    };
    2 * parent..end
}

/// The texel of the coarser level that a texel of the finer one belongs to, along one axis.
fn parent(child: usize, coarse: usize) -> usize {
    (child / 2).min(coarse - 1)
}

/// A square texture of `C` channels and its mip pyramid.
#[derive(Clone, Debug)]
pub struct MipTexture<const C: usize> {
    levels: Vec<Level<C>>,
}

impl<const C: usize> MipTexture<C> {
    /// The pyramid of a square of `side`² texels in row-major order.
    #[must_use]
    pub fn new(side: usize, texels: Vec<[f32; C]>) -> Self {
        let mut levels = vec![Level { side, texels }];
        while let Some(finer) = levels.last().filter(|l| l.side > 1) {
            let side = finer.side / 2;
            let texels = vec![[0.0; C]; side * side];
            levels.push(Level { side, texels });
        }
        let mut texture = Self { levels };
        texture.rebuild();
        texture
    }

    /// The texture at full resolution.
    #[must_use]
    pub fn base(&self) -> &[[f32; C]] {
        &self.levels[0].texels
    }

    /// Texels along a side.
    #[must_use]
    pub fn side(&self) -> usize {
        self.levels[0].side
    }

    /// Averages every level from the one below it.
    fn rebuild(&mut self) {
        for l in 1..self.levels.len() {
            let (fine, coarse) = self.levels.split_at_mut(l);
            let (fine, coarse) = (&fine[l - 1], &mut coarse[0]);
            let side = coarse.side;
            let rows = coarse.texels.par_chunks_mut(side).enumerate();
            rows.for_each(|(y, row)| {
                let ys = children(y, side, fine.side);
                for (x, out) in row.iter_mut().enumerate() {
                    let xs = children(x, side, fine.side);
                    let mut sum = [0.0f32; C];
                    for y in ys.clone() {
                        for texel in &fine.texels[y * fine.side + xs.start..][..xs.len()] {
                            for c in 0..C {
                                sum[c] += texel[c];
                            }
                        }
                    }
                    let share = 1.0 / (ys.len() * xs.len()) as f32;
                    *out = sum.map(|s| s * share);
                }
            });
        }
    }

    /// Where the texture is read at `uv` (0 to 1, clamped) for a footprint of `width` texture
    /// widths; bilinear at full resolution if that is 0.
    #[must_use]
    pub fn taps(&self, uv: Vec2, width: f32) -> Taps {
        let texels = (width * self.side() as f32).max(1.0);
        let lod = texels.log2().min((self.levels.len() - 1) as f32);
        let first = lod.floor() as usize;
        let blend = lod - first as f32;
        let mut taps = Taps::default();
        let mut put = |k: usize, level: usize, share: f32| {
            let side = self.levels[level].side;
            let p = (uv.clamp(Vec2::ZERO, Vec2::ONE) * side as f32 - 0.5)
                .clamp(Vec2::ZERO, Vec2::splat((side - 1) as f32));
            let (x, y) = (p.x as usize, p.y as usize);
            let f = p - Vec2::new(x as f32, y as f32);
            let (x1, y1) = ((x + 1).min(side - 1), (y + 1).min(side - 1));
            let corners = [
                (x, y, (1.0 - f.x) * (1.0 - f.y)),
                (x1, y, f.x * (1.0 - f.y)),
                (x, y1, (1.0 - f.x) * f.y),
                (x1, y1, f.x * f.y),
            ];
            for (i, (x, y, w)) in corners.into_iter().enumerate() {
                taps.level[k + i] = level as u8;
                taps.index[k + i] = (y * side + x) as u32;
                taps.weight[k + i] = w * share;
            }
        };
        put(0, first, 1.0 - blend);
        if blend > 0.0 {
            put(4, first + 1, blend);
        }
        taps
    }

    /// The value at `taps`.
    #[must_use]
    pub fn fetch(&self, taps: &Taps) -> [f32; C] {
        let mut out = [0.0; C];
        for k in 0..8 {
            if taps.weight[k] != 0.0 {
                let texel = self.levels[taps.level[k] as usize].texels[taps.index[k] as usize];
                for c in 0..C {
                    out[c] += taps.weight[k] * texel[c];
                }
            }
        }
        out
    }
}

/// A [`MipTexture`] with its gradient and the state of its optimiser.
#[derive(Clone, Debug)]
pub struct LearnedTexture<const C: usize> {
    texture: MipTexture<C>,
    /// Levels as those of the texture.
    gradient: Vec<Vec<[f32; C]>>,
    mean: Vec<[f32; C]>,
    square: Vec<[f32; C]>,
    steps: i32,
}

impl<const C: usize> LearnedTexture<C> {
    /// A square of `side`² texels of one value.
    #[must_use]
    pub fn filled(side: usize, value: [f32; C]) -> Self {
        let texture = MipTexture::new(side, vec![value; side * side]);
        let gradient = texture
            .levels
            .iter()
            .map(|l| vec![[0.0; C]; l.texels.len()])
            .collect();
        Self {
            gradient,
            mean: vec![[0.0; C]; side * side],
            square: vec![[0.0; C]; side * side],
            steps: 0,
            texture,
        }
    }

    /// What is fetched from.
    #[must_use]
    pub fn texture(&self) -> &MipTexture<C> {
        &self.texture
    }

    /// Forgets the optimiser's state: every stage begins with a fresh one.
    pub fn restart(&mut self) {
        self.mean.fill([0.0; C]);
        self.square.fill([0.0; C]);
        self.steps = 0;
    }

    /// Adds the gradient of a fetched value: the transpose of [`MipTexture::fetch`].
    pub fn add_gradient(&mut self, taps: &Taps, gradient: [f32; C]) {
        for k in 0..8 {
            if taps.weight[k] != 0.0 {
                let to = &mut self.gradient[taps.level[k] as usize][taps.index[k] as usize];
                for c in 0..C {
                    to[c] += taps.weight[k] * gradient[c];
                }
            }
        }
    }

    /// Brings the gradient of all levels down to the full resolution and takes it away: the
    /// transpose of the pyramid's averages.
    fn gather(&mut self) {
        for l in (1..self.gradient.len()).rev() {
            let (coarse, fine) = (self.texture.levels[l].side, self.texture.levels[l - 1].side);
            let (below, above) = self.gradient.split_at_mut(l);
            let (below, above) = (&mut below[l - 1], &mut above[0]);
            let rows = below.par_chunks_mut(fine).enumerate();
            rows.for_each(|(y, row)| {
                let py = parent(y, coarse);
                let height = children(py, coarse, fine).len();
                for (x, g) in row.iter_mut().enumerate() {
                    let px = parent(x, coarse);
                    let from = above[py * coarse + px];
                    let share = 1.0 / (height * children(px, coarse, fine).len()) as f32;
                    for c in 0..C {
                        g[c] += share * from[c];
                    }
                }
            });
            above.fill([0.0; C]);
        }
    }

    /// One step of Adam along the gradient, which is zero afterwards; values are kept within
    /// `[low, high]`.
    pub fn step(&mut self, rate: f32, low: f32, high: f32) {
        self.gather();
        self.steps += 1;
        let rule = AdamRule::new(rate, self.steps);
        let side = self.texture.side();
        let rows = self.texture.levels[0].texels.par_chunks_mut(side);
        rows.zip(self.gradient[0].par_chunks_mut(side))
            .zip(self.mean.par_chunks_mut(side))
            .zip(self.square.par_chunks_mut(side))
            .for_each(|(((values, gradient), mean), square)| {
                for i in 0..values.len() {
                    for c in 0..C {
                        let g = std::mem::take(&mut gradient[i][c]);
                        let step = rule.advance(g, &mut mean[i][c], &mut square[i][c]);
                        values[i][c] = (values[i][c] - step).clamp(low, high);
                    }
                }
            });
        self.texture.rebuild();
    }

    /// Adds to a texel at full resolution.
    #[cfg(test)]
    pub fn nudge(&mut self, i: usize, by: f32) {
        let texel = &mut self.texture.levels[0].texels[i];
        *texel = texel.map(|t| t + by);
    }

    /// The gradient at full resolution of the texels that are `chosen`, channel by channel.
    #[cfg(test)]
    pub fn gradient_where(&mut self, chosen: impl Fn(usize) -> bool) -> Vec<f32> {
        self.gather();
        let chosen = self.gradient[0]
            .iter()
            .enumerate()
            .filter(|(i, _)| chosen(*i));
        chosen.flat_map(|(_, g)| *g).collect()
    }

    /// The learned values as a plane.
    #[must_use]
    pub fn plane<T: Clone>(&self, value: impl Fn(&[f32; C]) -> T) -> Plane<T> {
        Plane {
            width: self.texture.side(),
            height: self.texture.side(),
            data: self.texture.base().iter().map(value).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sampling::KeyedRng;

    fn random(side: usize) -> MipTexture<1> {
        let mut rng = KeyedRng::new(3, side as u64);
        MipTexture::new(side, (0..side * side).map(|_| [rng.next_f32()]).collect())
    }

    #[test]
    fn a_fetch_averages_what_its_footprint_covers() {
        for side in [8, 13] {
            let t = random(side);
            let mean = t.base().iter().map(|v| v[0]).sum::<f32>() / (side * side) as f32;
            let whole = t.fetch(&t.taps(Vec2::splat(0.5), 4.0))[0];
            let tolerance = if side == 8 { 1e-6 } else { 0.05 };
            assert!((whole - mean).abs() < tolerance, "{whole} for {mean}");
            let centre = Vec2::splat(2.5 / side as f32);
            assert_eq!(t.fetch(&t.taps(centre, 0.0))[0], t.base()[2 * side + 2][0]);
        }
    }

    /// ⟨fetch(x), g⟩ = ⟨x, transpose(g)⟩ for every place and footprint.
    #[test]
    fn the_gradient_is_the_transpose_of_the_fetch() {
        for side in [8usize, 13] {
            let mut rng = KeyedRng::new(9, side as u64);
            let x = random(side);
            let mut learned = LearnedTexture::<1>::filled(side, [0.0]);
            let mut forward = 0.0f64;
            for _ in 0..50 {
                let uv = Vec2::new(rng.next_f32(), rng.next_f32());
                let taps = x.taps(uv, rng.next_f32());
                let g = rng.next_f32() - 0.5;
                forward += f64::from(x.fetch(&taps)[0] * g);
                learned.add_gradient(&taps, [g]);
            }
            learned.gather();
            let pairs = x.base().iter().zip(&learned.gradient[0]);
            let backward: f64 = pairs.map(|(x, g)| f64::from(x[0] * g[0])).sum();
            assert!((forward - backward).abs() < 1e-5, "{forward} {backward}");
        }
    }

    #[test]
    fn adam_walks_to_the_nearest_bound_and_no_further() {
        let mut t = LearnedTexture::<1>::filled(4, [0.5]);
        let taps = t.texture().taps(Vec2::splat(0.125), 0.0);
        t.add_gradient(&taps, [3.0]);
        t.step(0.03, 0.0, 1.0);
        // the first step of Adam has the length of the rate whatever the gradient
        assert!((t.texture().base()[0][0] - 0.47).abs() < 1e-5);
        assert_eq!(t.texture().base()[5][0], 0.5, "no gradient, no step");
        for _ in 0..40 {
            t.add_gradient(&taps, [3.0]);
            t.step(0.03, 0.0, 1.0);
        }
        assert_eq!(t.texture().base()[0][0], 0.0);
    }
}
