//! What glossy surfaces mirror towards the receivers of a bake: one more bounce along the rays that
//! meet them.
//!
//! The TBL sends one radiance to all sides; a narrow lobe sends most of its light to one. With
//! materials known, a ray that meets such a surface goes on from there, as FIPT grows paths at
//! specular hits (Wu et al. 2023), instead of reading the lobe's mean.

use super::reflector::{Levels, Reflector, ShadingPoint};
use crate::core::sampling::hash_u64;
use crate::core::trace::{Hit, Ray};
use glam::Vec3;

/// A glossy surface point.
#[derive(Clone, Copy, Debug)]
pub struct Glossy {
    /// Unit shading normal on the lit side.
    pub normal: Vec3,
    /// Unit geometric normal on the lit side.
    pub face_normal: Vec3,
    /// Roughness of its lobe.
    pub roughness: f32,
}

/// The specular lobes of the scene's glossy surfaces, in the light that `reflector` looks at.
pub struct SpecularBounce<'a> {
    /// How a lobe's radiance is estimated.
    pub reflector: Reflector<'a>,
    /// What a hit from its lit side meets; `None` where the field holds all that is sent.
    pub surface: &'a (dyn Fn(&Hit) -> Option<Glossy> + Sync),
    /// Of so many rays that meet such surfaces one goes on, for all of them; at least 1.
    pub one_in: u32,
}

/// Buffers of one thread.
#[derive(Default)]
pub(crate) struct Bounces {
    gazes: Vec<ShadingPoint>,
    roughness: Vec<f32>,
    /// Number of each gaze's ray.
    ray: Vec<u32>,
    radiance: Vec<Vec3>,
}

impl SpecularBounce<'_> {
    /// `add(k, radiance)` takes what the surface that the k-th ray meets mirrors back along it.
    /// Returns the rays traced.
    pub(crate) fn follow(
        &self,
        rays: &[Ray],
        hits: &[Hit],
        buffers: &mut Bounces,
        mut add: impl FnMut(usize, Vec3),
    ) -> u64 {
        let Bounces {
            gazes,
            roughness,
            ray,
            radiance,
        } = buffers;
        gazes.clear();
        roughness.clear();
        ray.clear();
        for (k, (r, hit)) in rays
            .iter()
            .zip(hits)
            .enumerate()
            .filter(|(_, (_, hit))| hit.is_hit())
        {
            // the same whatever else is in the batch
            let key = hash_u64(bits(r.origin), bits(r.direction));
            if !key.is_multiple_of(u64::from(self.one_in)) {
                continue;
            }
            let (origin, direction) = (Vec3::from_array(r.origin), Vec3::from_array(r.direction));
            let Some(g) = (self.surface)(hit).filter(|g| g.face_normal.dot(direction) < 0.0) else {
                continue;
            };
            let position = origin + direction * hit.t;
            gazes.push(ShadingPoint {
                position,
                normal: g.normal,
                face_normal: g.face_normal,
                view: -direction,
                key,
                turn: 0,
            });
            roughness.push(g.roughness);
            ray.push(k as u32);
        }
        radiance.clear();
        radiance.resize(gazes.len(), Vec3::ZERO);
        let traced = self
            .reflector
            .reflect(gazes, Levels::Own(roughness), radiance);
        ray.iter()
            .zip(radiance)
            .for_each(|(k, l)| add(*k as usize, *l * self.one_in as f32));
        traced
    }
}

fn bits([x, y, z]: [f32; 3]) -> u64 {
    hash_u64(
        u64::from(x.to_bits()),
        u64::from(y.to_bits()) << 32 | u64::from(z.to_bits()),
    )
}
