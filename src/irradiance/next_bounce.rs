//! One more bounce along the rays of a bake that meet what the light field does not hold.
//!
//! The TBL sends one radiance to all sides; a narrow lobe sends most of its light to one. With
//! materials known, a ray that meets such a surface goes on from there, as FIPT grows paths at
//! specular hits (Wu et al. 2023), instead of reading the lobe's mean. So does one that meets a
//! side that no camera saw: what that sends differs from place to place with the light it receives.

use crate::core::math::Frame;
use crate::core::sampling::{KeyedRng, hash_u64, square_to_cosine_hemisphere};
use crate::core::trace::{Hit, Ray};
use crate::specular::{Levels, Own, Reflector, ShadingPoint};
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

/// The surfaces from which rays go on, in the light that `reflector` looks at.
pub struct NextBounce<'a> {
    /// How a lobe's radiance is estimated.
    pub reflector: Reflector<'a>,
    /// The lobe that a hit from the lit side meets; `None` where the field holds all that is sent.
    pub mirror: &'a (dyn Fn(&Hit) -> Option<Glossy> + Sync),
    /// Albedo, [0, 1] per channel, of a triangle's far side; `None` where the field holds what it
    /// sends.
    pub scatter: &'a (dyn Fn(usize) -> Option<Vec3> + Sync),
    /// Of so many rays that meet lobes one goes on, for all of them; at least 1.
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
    /// Rays that go on from matte surfaces, what they meet, and whence they come.
    scattered: Vec<Ray>,
    hits: Vec<Hit>,
    from: Vec<(u32, Vec3)>,
}

impl NextBounce<'_> {
    /// `add(k, radiance)` takes what the surface that the k-th ray meets sends back along it.
    /// Returns the rays traced.
    pub(crate) fn follow(
        &self,
        rays: &[Ray],
        hits: &[Hit],
        buffers: &mut Bounces,
        mut add: impl FnMut(usize, Vec3),
    ) -> u64 {
        buffers.collect(self, rays, hits);
        let Bounces {
            gazes,
            roughness,
            ray,
            radiance,
            scattered,
            hits,
            from,
        } = buffers;
        radiance.clear();
        radiance.resize(gazes.len(), Vec3::ZERO);
        let traced =
            self.reflector
                .reflect(gazes, Levels::Own(Own::dielectric(roughness)), radiance);
        ray.iter()
            .zip(radiance)
            .for_each(|(k, l)| add(*k as usize, *l * self.one_in as f32));
        let lit = self.reflector.lit;
        hits.clear();
        hits.resize(scattered.len(), Hit::miss());
        lit.tracer.closest(scattered, hits);
        for ((ray, hit), (k, albedo)) in scattered.iter().zip(hits).zip(from) {
            let received = lit
                .field
                .arriving(hit, Vec3::from_array(ray.direction), 0.0);
            add(*k as usize, *albedo * received);
        }
        traced + scattered.len() as u64
    }
}

impl Bounces {
    /// Finds the rays that go on.
    fn collect(&mut self, bounce: &NextBounce, rays: &[Ray], hits: &[Hit]) {
        self.gazes.clear();
        self.roughness.clear();
        self.ray.clear();
        self.scattered.clear();
        self.from.clear();
        let lit = bounce.reflector.lit;
        let found = rays.iter().zip(hits).enumerate();
        for (k, (r, hit)) in found.filter(|(_, (_, hit))| hit.is_hit()) {
            let direction = Vec3::from_array(r.direction);
            let normal = lit.field.outward_normal(hit.triangle as usize);
            let along = normal.dot(direction);
            // the same whatever else is in the batch
            let key = hash_u64(bits(r.origin), bits(r.direction));
            let position = Vec3::from_array(r.origin) + direction * hit.t;
            if along < 0.0 && key.is_multiple_of(u64::from(bounce.one_in)) {
                let Some(g) = (bounce.mirror)(hit) else {
                    continue;
                };
                self.gazes.push(ShadingPoint {
                    position,
                    normal: g.normal,
                    face_normal: g.face_normal,
                    view: -direction,
                    key,
                    turn: 0,
                });
                self.roughness.push(g.roughness);
                self.ray.push(k as u32);
            } else if along > 0.0 {
                let Some(albedo) = (bounce.scatter)(hit.triangle as usize) else {
                    continue;
                };
                let mut rng = KeyedRng::new(bounce.reflector.seed, key);
                let u = [rng.next_f32(), rng.next_f32()];
                let frame = Frame::from_normal(-normal);
                self.scattered.push(Ray::new(
                    position - normal * lit.offset,
                    frame.world_from_local(square_to_cosine_hemisphere(u)),
                    f32::INFINITY,
                ));
                self.from.push((k as u32, albedo));
            }
        }
    }
}

fn bits([x, y, z]: [f32; 3]) -> u64 {
    hash_u64(
        u64::from(x.to_bits()),
        u64::from(y.to_bits()) << 32 | u64::from(z.to_bits()),
    )
}
