//! Filling texels that no chart covers (Gortler et al. 1996, pull–push), so that mips and bilinear
//! lookups never meet black.

use crate::core::image::Plane;
use std::ops::{Add, Mul};

/// Fills every texel with `covered == false` from the covered ones around it; covered texels keep
/// their value. A texture without any covered texel is returned as it is.
#[must_use]
pub fn fill_uncovered<T>(plane: &Plane<T>, covered: &Plane<bool>) -> Plane<T>
where
    T: Copy + Default + Add<Output = T> + Mul<f32, Output = T>,
{
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

fn pull<T>(p: &Plane<T>, w: &Plane<f32>) -> (Plane<T>, Plane<f32>)
where
    T: Copy + Default + Add<Output = T> + Mul<f32, Output = T>,
{
    let (width, height) = (p.width.div_ceil(2), p.height.div_ceil(2));
    let mut out = Plane::filled(width, height, T::default());
    let mut weight = Plane::filled(width, height, 0.0f32);
    for y in 0..height {
        for x in 0..width {
            let mut sum = T::default();
            let mut total = 0.0;
            for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let (sx, sy) = (2 * x + i, 2 * y + j);
                if sx < p.width && sy < p.height {
                    let k = w[(sx, sy)];
                    if k > 0.0 {
                        sum = sum + p[(sx, sy)] * k;
                        total += k;
                    }
                }
            }
            if total > 0.0 {
                out[(x, y)] = sum * (1.0 / total);
                weight[(x, y)] = total.min(1.0);
            }
        }
    }
    (out, weight)
}

fn push<T: Copy>(
    fine: &mut Plane<T>,
    fine_weight: &mut Plane<f32>,
    coarse: &Plane<T>,
    coarse_weight: &Plane<f32>,
) {
    let width = fine.width;
    for (i, (value, weight)) in fine.data.iter_mut().zip(&mut fine_weight.data).enumerate() {
        if *weight == 0.0 {
            let at = (i % width / 2, i / width / 2);
            *value = coarse[at];
            *weight = coarse_weight[at];
        }
    }
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
