//! A dense row-major plane. Row 0 is the top of an image and v = 0 of a texture.

use glam::Vec2;
use std::ops::{Add, Index, IndexMut, Mul};

/// A dense `width × height` array, row-major, row 0 first.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane<T> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` values, row-major.
    pub data: Vec<T>,
}

impl<T: Clone> Plane<T> {
    /// A plane filled with one value.
    #[must_use]
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self {
            width,
            height,
            data: vec![value; width * height],
        }
    }
}

impl<T> Plane<T> {
    /// A plane from `width * height` values; `None` if the count differs.
    #[must_use]
    pub fn from_data(width: usize, height: usize, data: Vec<T>) -> Option<Self> {
        (width.checked_mul(height) == Some(data.len())).then_some(Self {
            width,
            height,
            data,
        })
    }

    /// Applies `f` to every value.
    #[must_use]
    pub fn map<U>(&self, f: impl Fn(&T) -> U) -> Plane<U> {
        Plane {
            width: self.width,
            height: self.height,
            data: self.data.iter().map(f).collect(),
        }
    }

    /// The value at the place of pixel `(x, y)` of an image of another size and the same aspect.
    #[must_use]
    #[inline]
    pub fn at_pixel_of(&self, size: (usize, usize), (x, y): (usize, usize)) -> &T {
        &self[(x * self.width / size.0, y * self.height / size.1)]
    }

    /// The value nearest to continuous pixel coordinates (pixel centres at +0.5), clamped at the
    /// border.
    #[must_use]
    #[inline]
    pub fn nearest(&self, p: Vec2) -> &T {
        let x = (p.x.max(0.0) as usize).min(self.width - 1);
        let y = (p.y.max(0.0) as usize).min(self.height - 1);
        &self.data[y * self.width + x]
    }
}

/// How a coordinate outside the plane is brought back in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// Clamp to the border.
    Clamp,
    /// Wrap round: the horizontal axis of a panorama.
    Repeat,
}

/// The four values and weights of a bilinear lookup: `(index, weight)`; weights sum to 1.
pub type BilinearTaps = [(usize, f32); 4];

/// Bilinear taps at continuous pixel coordinates (centres at +0.5); `wrap_x` says what happens at
/// the left and right border, rows clamp.
#[must_use]
pub fn bilinear_taps(width: usize, height: usize, p: Vec2, wrap_x: Wrap) -> BilinearTaps {
    let (fx, fy) = (p.x - 0.5, p.y - 0.5);
    let (x0, y0) = (fx.floor(), fy.floor());
    let (tx, ty) = (fx - x0, fy - y0);
    let column = |x: f32| match wrap_x {
        Wrap::Clamp => (x.max(0.0) as usize).min(width - 1),
        Wrap::Repeat => (x as i64).rem_euclid(width as i64) as usize,
    };
    let row = |y: f32| (y.max(0.0) as usize).min(height - 1);
    let (c0, c1, r0, r1) = (
        column(x0),
        column(x0 + 1.0),
        row(y0) * width,
        row(y0 + 1.0) * width,
    );
    [
        (r0 + c0, (1.0 - tx) * (1.0 - ty)),
        (r0 + c1, tx * (1.0 - ty)),
        (r1 + c0, (1.0 - tx) * ty),
        (r1 + c1, tx * ty),
    ]
}

impl<T> Plane<T>
where
    T: Copy + Mul<f32, Output = T> + Add<Output = T>,
{
    /// Bilinear lookup at continuous pixel coordinates (centres at +0.5).
    #[must_use]
    pub fn bilinear(&self, p: Vec2, wrap_x: Wrap) -> T {
        let taps = bilinear_taps(self.width, self.height, p, wrap_x);
        let v = |i: usize| self.data[taps[i].0] * taps[i].1;
        v(0) + v(1) + v(2) + v(3)
    }

    /// The plane at another size, between its texels.
    #[must_use]
    pub fn resampled(&self, width: usize, height: usize) -> Self {
        let scale = Vec2::new(
            self.width as f32 / width as f32,
            self.height as f32 / height as f32,
        );
        let centre = |i: usize| Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        Self {
            width,
            height,
            data: (0..width * height)
                .map(|i| self.bilinear(centre(i) * scale, Wrap::Clamp))
                .collect(),
        }
    }

    /// Box-filtered image of half the size (odd sizes drop the last row or column; a side of 1
    /// stays 1).
    #[must_use]
    pub fn half(&self) -> Self {
        let (w, h) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let (sx, sy) = (self.width / w, self.height / h);
        let scale = 1.0 / (sx * sy) as f32;
        let mut data = Vec::with_capacity(w * h);
        for y in 0..h {
            for x in 0..w {
                let mut acc: Option<T> = None;
                for j in 0..sy {
                    for i in 0..sx {
                        let v = self[(x * sx + i, y * sy + j)];
                        acc = Some(acc.map_or(v, |a| a + v));
                    }
                }
                data.extend(acc.map(|a| a * scale));
            }
        }
        Self {
            width: w,
            height: h,
            data,
        }
    }
}

impl<T> Index<(usize, usize)> for Plane<T> {
    type Output = T;
    /// Value at (column, row).
    fn index(&self, (x, y): (usize, usize)) -> &T {
        &self.data[y * self.width + x]
    }
}

impl<T> IndexMut<(usize, usize)> for Plane<T> {
    fn index_mut(&mut self, (x, y): (usize, usize)) -> &mut T {
        &mut self.data[y * self.width + x]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bilinear_reproduces_a_linear_ramp_and_wraps() {
        let p = Plane {
            width: 4,
            height: 3,
            data: (0..12)
                .map(|i| (i % 4) as f32 + 10.0 * (i / 4) as f32)
                .collect(),
        };
        assert!((p.bilinear(Vec2::new(1.75, 1.25), Wrap::Clamp) - (1.25 + 7.5)).abs() < 1e-6);
        // half a pixel left of the first centre: mean of the last and the first column
        assert!((p.bilinear(Vec2::new(0.0, 0.5), Wrap::Repeat) - 1.5).abs() < 1e-6);
        assert!((p.bilinear(Vec2::new(0.0, 0.5), Wrap::Clamp) - 0.0).abs() < 1e-6);
        assert!((p.bilinear(Vec2::new(-9.0, 99.0), Wrap::Clamp) - 20.0).abs() < 1e-6);
    }

    #[test]
    fn half_keeps_the_mean_and_survives_a_single_pixel() {
        let p = Plane {
            width: 4,
            height: 2,
            data: vec![1.0f32, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0],
        };
        let h = p.half();
        assert_eq!((h.width, h.height), (2, 1));
        assert_eq!(h.data, vec![3.5, 5.5]);
        assert_eq!(Plane::filled(1, 1, 2.0f32).half().data, vec![2.0]);
    }
}
