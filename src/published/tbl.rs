//! Texture-based lighting: the radiance of every texel as one photograph shows it (method §2.1).

use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::texture::fill_uncovered;
use crate::observed::Surface;
use glam::Vec3;

/// Luma from which a texel is light, in units of the photographs' median luminance. Derived: the
/// code's 0.5 stands beside exposures of 2⁵ that bring its rooms' median near 0.5 (method §7.1), so light is 32 times as bright as the median.
const LIGHT: f32 = 32.0;

/// The light texture from one view a texel: that which sees it largest, at the nearest pixel.
#[must_use]
pub fn one_view_per_texel(surface: &Surface) -> RgbPlane {
    let observer = surface.observer();
    let found: Vec<Option<Vec3>> = (0..surface.texels.len())
        .into_par_iter()
        .map_init(Vec::new, |looks, i| {
            let point = surface.texels.point[i];
            let position = surface.texels.position(&surface.scene.mesh, i);
            let (_, face) = surface.normals(point.triangle as usize, point.u, point.v);
            observer.observe(position, face, looks);
            let largest = looks
                .iter()
                .min_by(|a, b| a.footprint.total_cmp(&b.footprint))?;
            let view = &observer.views[largest.view as usize];
            Some(*view.radiance.nearest(largest.pixel))
        })
        .collect();
    let value: Vec<Vec3> = found.iter().map(|v| v.unwrap_or(Vec3::ZERO)).collect();
    let known: Vec<bool> = found.iter().map(Option::is_some).collect();
    fill_uncovered(
        &surface.texels.scatter(&value, Vec3::ZERO),
        &surface.texels.scatter(&known, false),
    )
}

/// Median luminance of all photographs.
#[must_use]
pub fn median_luminance(surface: &Surface) -> f32 {
    // every 16th pixel tells the median of a million as well
    let mut all: Vec<f32> = surface
        .views
        .iter()
        .flat_map(|v| v.radiance.data.iter().step_by(16))
        .map(|c| luminance(*c))
        .filter(|l| l.is_finite() && *l > 0.0)
        .collect();
    let middle = all.len() / 2;
    if all.is_empty() {
        return 1.0;
    }
    *all.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// The light texture with everything black that is no light.
#[must_use]
pub fn lights_only(tbl: &RgbPlane, median: f32) -> RgbPlane {
    let luma = |c: &Vec3| c.dot(Vec3::new(0.299, 0.587, 0.114));
    tbl.map(|c| {
        if luma(c) < LIGHT * median {
            Vec3::ZERO
        } else {
            *c
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;

    #[test]
    fn what_is_much_brighter_than_the_room_is_light() {
        let tbl = Plane {
            width: 3,
            height: 1,
            data: vec![Vec3::splat(0.5), Vec3::splat(15.9), Vec3::splat(16.1)],
        };
        let light = lights_only(&tbl, 0.5);
        assert_eq!(light.data[..2], [Vec3::ZERO; 2]);
        assert_eq!(light.data[2], Vec3::splat(16.1));
    }
}
