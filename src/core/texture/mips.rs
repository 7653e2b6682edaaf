//! Prefiltered copies of a texture for lookups with a footprint.

use crate::core::image::{Plane, Wrap};
use glam::Vec2;
use std::ops::{Add, Mul};

/// A texture and its box-filtered reductions. Few levels only: beyond three halvings, charts bleed
/// into each other.
#[derive(Clone, Debug)]
pub struct MipChain<T> {
    levels: Vec<Plane<T>>,
}

impl<T> MipChain<T>
where
    T: Copy + Add<Output = T> + Mul<f32, Output = T>,
{
    /// Builds `levels` levels (at least one) from a texture whose uncovered texels are filled.
    #[must_use]
    pub fn new(base: Plane<T>, levels: usize) -> Self {
        let mut all = vec![base];
        while all.len() < levels.max(1) {
            let Some(next) = all
                .last()
                .filter(|p| p.width > 1 && p.height > 1)
                .map(Plane::half)
            else {
                break;
            };
            all.push(next);
        }
        Self { levels: all }
    }

    /// The full-resolution level.
    #[must_use]
    pub fn base(&self) -> &Plane<T> {
        &self.levels[0]
    }

    /// Number of levels.
    #[must_use]
    pub fn level_count(&self) -> usize {
        self.levels.len()
    }

    /// Nearest texel of the level whose texels are about `footprint` base texels wide.
    #[must_use]
    #[inline]
    pub fn lookup(&self, uv: Vec2, footprint: f32) -> T {
        // the whole part of the logarithm is the exponent of the number
        let level =
            ((footprint.max(1.0).to_bits() >> 23) as usize - 127).min(self.levels.len() - 1);
        let p = &self.levels[level];
        *p.nearest(uv * Vec2::new(p.width as f32, p.height as f32))
    }

    /// Bilinear lookup at full resolution.
    #[must_use]
    pub fn bilinear(&self, uv: Vec2) -> T {
        let p = &self.levels[0];
        p.bilinear(uv * Vec2::new(p.width as f32, p.height as f32), Wrap::Clamp)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn footprint_selects_the_level() {
        let base = Plane {
            width: 4,
            height: 4,
            data: (0..16).map(|i| i as f32).collect(),
        };
        let m = MipChain::new(base, 9);
        assert_eq!(m.level_count(), 3);
        let uv = Vec2::new(0.1, 0.1);
        assert_eq!(m.lookup(uv, 0.0), 0.0);
        assert_eq!(m.lookup(uv, 1.99), 0.0);
        assert_eq!(m.lookup(uv, 2.0), 2.5);
        assert_eq!(m.lookup(uv, f32::NAN), 0.0);
        assert_eq!(m.lookup(uv, f32::INFINITY), 7.5);
        assert_eq!(m.lookup(uv, 99.0), 7.5);
        assert_eq!(m.bilinear(Vec2::new(0.25, 0.25)), 2.5);
    }
}
