//! Albedo of surface at which views contradict each other.
//!
//! What stands before such surface is not in the mesh, so its looks are of different things and
//! their mean v tells of the surface no better than they agree, to s. What its class is like nearby,
//! N(m, τ²), was there before the look. Both together are the mean and variance of the product of
//! two normal densities,
//!
//! > ρ = (v/s² + m/τ²)/(1/s² + 1/τ²),  its variance = 1/(1/s² + 1/τ²)
//!
//! (Gelman et al. 2013, Bayesian Data Analysis, § 2.5): a sofa that is not in the mesh leaves a
//! painted wall, a patterned floor keeps what was seen. Called by `solve` after the missing light.

use super::AlbedoEstimate;
use super::class_prior::{Ground, class_prior};

/// Gives the texels `ids`, whose looks contradict each other, the mean of what they show and of what
/// their class is like, each by its certainty. They are no evidence for classes any more. `nearby` is
/// the share of what the class is like near a texel beside what it is like in its room, 0 to 1.
pub fn settle_contradicted(
    ground: &Ground<'_>,
    ids: &[u32],
    nearby: &(dyn Fn(usize) -> f32 + Sync),
    albedo: &mut AlbedoEstimate,
) {
    if ids.is_empty() {
        return; // the prior of the whole atlas is not gathered for nothing
    }
    for &i in ids {
        albedo.clean[i as usize] = false;
    }
    let prior = class_prior(albedo, ground, ids, nearby);
    for (&i, prior) in ids.iter().zip(prior) {
        let i = i as usize;
        if !albedo.error[i].is_finite() {
            continue;
        }
        // as far as the looks differ, however many there are: they are not of one thing
        let looks = albedo.error[i].powi(2) * albedo.looks[i];
        let share = looks / (looks + prior.variance).max(f32::MIN_POSITIVE);
        albedo.value[i] = albedo.value[i].lerp(prior.mean, share);
        albedo.error[i] = (prior.variance * share).sqrt();
        albedo.looks[i] = 1.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::Mesh;
    use crate::core::math::luminance;
    use crate::core::sampling::KeyedRng;
    use crate::core::texture::Texels;
    use glam::{Vec2, Vec3};

    const PAINT: f32 = 0.7;

    /// A wall of paint that scatters by `scatter`; before a third of it stands something dark that
    /// half of the views show. The settled estimate and what was hidden.
    fn wall(scatter: f32) -> (AlbedoEstimate, Vec<u32>) {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(Vec2::from_array);
        let mesh = Mesh {
            positions: corners.map(|c| Vec3::new(c.x, c.y, 0.0)).to_vec(),
            normals: vec![Vec3::Z; 4],
            uvs: corners.to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let texels = Texels::rasterize(&mesh, 96, 96);
        let n = texels.len();
        let hidden: Vec<u32> = (0..n as u32)
            .filter(|&i| texels.cell[i as usize] % 96 < 32)
            .collect();
        let mut rng = KeyedRng::new(3, 1);
        let mut paint = || PAINT + scatter * (rng.next_f32() - 0.5) * 12f32.sqrt();
        let mut albedo = AlbedoEstimate {
            value: (0..n).map(|_| Vec3::splat(paint())).collect(),
            error: vec![0.02; n],
            looks: vec![4.0; n],
            specular_share: vec![0.0; n],
            clean: vec![true; n],
            footprint: vec![0.01; n],
        };
        for &i in &hidden {
            albedo.value[i as usize] *= 0.6;
            albedo.error[i as usize] = 0.3 / 2.0; // four looks that differ by 0.3
        }
        let ground = Ground {
            texels: &texels,
            mesh: &mesh,
            labels: &vec![1; n],
            rooms: &vec![1; n],
        };
        settle_contradicted(&ground, &hidden, &|_| 1.0, &mut albedo);
        (albedo, hidden)
    }

    fn mean_off(albedo: &AlbedoEstimate, hidden: &[u32]) -> f32 {
        let off = |i: &u32| luminance(albedo.value[*i as usize]) - PAINT;
        hidden.iter().map(off).sum::<f32>() / hidden.len() as f32
    }

    /// Paint hides nothing: the wall behind is the wall beside, and its error is the paint's scatter.
    #[test]
    fn what_stands_before_paint_leaves_paint() {
        let (albedo, hidden) = wall(0.01);
        assert!(mean_off(&albedo, &hidden).abs() < 0.02);
        for &i in &hidden {
            let i = i as usize;
            assert!(
                !albedo.clean[i] && albedo.error[i] < 0.1,
                "{}",
                albedo.error[i]
            );
        }
    }

    /// A class that varies as much as the looks differ says little: half of what was seen stays, and
    /// the stated error holds what is off.
    #[test]
    fn a_patterned_class_keeps_what_was_seen() {
        let (albedo, hidden) = wall(0.25);
        let off = mean_off(&albedo, &hidden);
        assert!((-0.22..-0.04).contains(&off), "{off}");
        let error = albedo.error[hidden[0] as usize];
        assert!(error > 0.15 && error < 0.3, "{error}");
        assert!(off.abs() < 2.0 * error);
    }
}
