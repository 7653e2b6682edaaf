//! Lamps that a camera held below its ceiling: display-referred photographs compress what is bright.
//!
//! Once the light's level is that of white paint, what still outshines any paint by two standard
//! errors of the light is no paint. On a surface that faces down no sun falls either, so it is a
//! lamp; what it sends was photographed too dark by a factor that nobody knows. Called by the energy
//! balance.

use super::Light;
use super::clipped_light::FoundLight;
use super::room_levels::light_error;
use super::white_paint::MOST;
use crate::core::math::luminance;
use crate::core::texture::Texels;
use crate::inverse::AlbedoEstimate;
use crate::observed::Surface;

/// Pixels of its sharpest view that show a lamp at least. Derived: two by two, or a spot may be one
/// pixel's fault.
const LEAST_PIXELS: f32 = 4.0;
/// Share of the strongest lamp's power that a lamp sends at least. Derived: below it no surface gets
/// more than the per cent to which the bake knows its light.
const LEAST_POWER: f32 = 0.01;

/// The lamps on surfaces that face down, from albedos that no bound holds.
pub(super) fn find_unclipped_lamps(
    surface: &Surface,
    light: &Light,
    albedo: &AlbedoEstimate,
) -> Vec<FoundLight> {
    let brightest = (2.0 * light_error(surface)).exp();
    let triangle = |i: usize| surface.texels.point[i].triangle as usize;
    let outshines = |i: &u32| {
        let i = *i as usize;
        albedo.error[i].is_finite()
            && !light.emissive[triangle(i)]
            && luminance(albedo.value[i]) > brightest
    };
    let bright: Vec<u32> = (0..albedo.value.len() as u32).filter(outshines).collect();
    let area = |i: usize| surface.texels.area(&surface.scene.mesh, i);
    let pixels = |i: &u32| area(*i as usize) / albedo.footprint[*i as usize].powi(2);
    let sent = |i: &u32| area(*i as usize) * luminance(surface.fusion.radiance[*i as usize]);
    let mut patches = patches(&surface.texels, &bright);
    patches.retain(|p| surface.faces_down(p) && p.iter().map(pixels).sum::<f32>() > LEAST_PIXELS);
    let power = |patch: &Vec<u32>| patch.iter().map(sent).sum::<f32>();
    let strongest = patches.iter().map(power).fold(0.0, f32::max);
    patches.retain(|p| power(p) > LEAST_POWER * strongest);
    let lamp = |texels| FoundLight {
        texels,
        // anything from what is seen to what a closed white room makes of it
        log_error: 0.5 * MOST.ln(),
        emits: true,
    };
    surface
        .clusters(&patches.concat())
        .into_iter()
        .map(lamp)
        .collect()
}

/// Texels that touch each other in the atlas.
fn patches(texels: &Texels, among: &[u32]) -> Vec<Vec<u32>> {
    let mut marks = vec![u32::MAX; texels.len()];
    among.iter().for_each(|&i| marks[i as usize] = i);
    let mut open_cells = texels.scatter(&marks, u32::MAX);
    let (w, h) = (open_cells.width as i64, open_cells.height as i64);
    let mut out = Vec::new();
    for &first in among {
        let cell = texels.cell[first as usize] as usize;
        if open_cells.data[cell] == u32::MAX {
            continue;
        }
        open_cells.data[cell] = u32::MAX;
        let (mut patch, mut next) = (vec![first], 0);
        while let Some(&i) = patch.get(next) {
            next += 1;
            let cell = i64::from(texels.cell[i as usize]);
            let (x, y) = (cell % w, cell / w);
            for (x, y) in [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)] {
                if x >= 0 && x < w && y >= 0 && y < h {
                    let near = (y * w + x) as usize;
                    let found = std::mem::replace(&mut open_cells.data[near], u32::MAX);
                    if found != u32::MAX {
                        patch.push(found);
                    }
                }
            }
        }
        out.push(patch);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observed::surface_tests::box_scene;

    /// Two squares that do not touch are two patches, whole, in the order of their first texels.
    #[test]
    fn patches_are_what_touches() {
        let scene = box_scene();
        let texels = Texels::rasterize(&scene.mesh, 64, 64);
        let place = |i: u32| {
            let cell = texels.cell[i as usize] as usize;
            (cell % 64, cell / 64)
        };
        let square = |i: &u32, x: usize, side: usize| {
            let (px, py) = place(*i);
            (x..x + side).contains(&px) && (5..5 + side).contains(&py)
        };
        let all = 0..texels.len() as u32;
        let among: Vec<u32> = all
            .filter(|i| square(i, 4, 3) || square(i, 10, 4))
            .collect();
        let found = patches(&texels, &among);
        let sizes: Vec<usize> = found.iter().map(Vec::len).collect();
        assert_eq!(sizes, [9, 16]);
        let mut together: Vec<u32> = found.concat();
        together.sort_unstable();
        assert_eq!(together, among);
    }
}
