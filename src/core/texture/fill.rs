//! Filling texels that no chart covers (Gortler et al. 1996, pull–push), so that mips and bilinear
//! lookups never meet black.

use crate::core::image::Plane;
use crate::core::parallel::prelude::*;
use std::ops::{Add, Mul};

/// What textures are made of.
pub trait Texel:
    Copy + Default + Mul<f32, Output = Self> + Add<Output = Self> + Send + Sync
{
}

impl<T: Copy + Default + Mul<f32, Output = T> + Add<Output = T> + Send + Sync> Texel for T {}

/// Fills every texel with `covered == false` from the covered ones around it; covered texels keep
/// their value. A texture without any covered texel is returned as it is.
#[must_use]
pub fn fill_uncovered<T: Texel>(plane: &Plane<T>, covered: &Plane<bool>) -> Plane<T> {
    let weight = covered.map(|&c| if c { 1.0f32 } else { 0.0 });
    let mut levels = vec![(plane.clone(), weight)];
    while let Some((p, w)) = levels.last() {
        if p.width == 1 && p.height == 1 {
            break;
        }
        let pulled = pull(p, w);
        levels.push(pulled);
    }
    while levels.len() > 1 {
        let Some((coarse, coarse_weight)) = levels.pop() else {
            break;
        };
        let Some((fine, fine_weight)) = levels.last_mut() else {
            break;
        };
        push(fine, fine_weight, &coarse, &coarse_weight);
    }
    levels.pop().map_or_else(|| plane.clone(), |l| l.0)
}

fn pull<T: Texel>(p: &Plane<T>, w: &Plane<f32>) -> (Plane<T>, Plane<f32>) {
    let (width, height) = (p.width.div_ceil(2), p.height.div_ceil(2));
    let mut out = Plane::filled(width, height, T::default());
    let mut weight = Plane::filled(width, height, 0.0f32);
    let mean = |x: usize, y: usize| {
        let (mut sum, mut total) = (T::default(), 0.0);
        for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (sx, sy) = (2 * x + i, 2 * y + j);
            if sx < p.width && sy < p.height && w[(sx, sy)] > 0.0 {
                let k = w[(sx, sy)];
                sum = sum + p[(sx, sy)] * k;
                total += k;
            }
        }
        (sum, total)
    };
    let rows = out.data.par_chunks_mut(width);
    rows.zip(weight.data.par_chunks_mut(width))
        .enumerate()
        .for_each(|(y, (out, weight))| {
            for x in 0..width {
                let (sum, total) = mean(x, y);
                if total > 0.0 {
                    (out[x], weight[x]) = (sum * (1.0 / total), total.min(1.0));
                }
            }
        });
    (out, weight)
}

fn push<T: Texel>(
    fine: &mut Plane<T>,
    fine_weight: &mut Plane<f32>,
    coarse: &Plane<T>,
    coarse_weight: &Plane<f32>,
) {
    let width = fine.width;
    let rows = fine.data.par_chunks_mut(width);
    rows.zip(fine_weight.data.par_chunks_mut(width))
        .enumerate()
        .for_each(|(y, (values, weights))| {
            for (x, (value, weight)) in values.iter_mut().zip(weights).enumerate() {
                if *weight == 0.0 {
                    let at = (x / 2, y / 2);
                    (*value, *weight) = (coarse[at], coarse_weight[at]);
                }
            }
        });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn covered_texels_stay_and_holes_lie_between_their_neighbours() {
        let mut p = Plane::filled(13, 7, 0.0f32);
        let mut c = Plane::filled(13, 7, false);
        p[(2, 3)] = 4.0;
        c[(2, 3)] = true;
        p[(11, 6)] = 8.0;
        c[(11, 6)] = true;
        let f = fill_uncovered(&p, &c);
        assert_eq!((f[(2, 3)], f[(11, 6)]), (4.0, 8.0));
        assert!(f.data.iter().all(|v| (4.0..=8.0).contains(v)));
        assert_eq!(f[(3, 3)], 4.0);
        let none = fill_uncovered(&p, &Plane::filled(13, 7, false));
        assert_eq!(none.data.len(), p.data.len());
    }
}
