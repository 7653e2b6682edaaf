//! Every ray against every triangle in f64: the plain twin that tests compare Embree with.

use super::{Hit, Ray, Tracer};
use crate::core::geometry::Mesh;
use crate::ffi::ray::is_usable;
use glam::DVec3;

/// A tracer without acceleration structure, for tests and small meshes.
pub struct BruteForce {
    /// Corner, edge and edge per triangle; `None` where a corner is not finite.
    triangles: Vec<Option<[DVec3; 3]>>,
}

impl BruteForce {
    /// Copies the triangles of `mesh`; those with indices out of range or corners that are not
    /// finite are never hit.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        let corner = |i: u32| {
            mesh.positions
                .get(i as usize)
                .copied()
                .filter(|&p| is_usable(p))
                .map(|p| p.as_dvec3())
        };
        let triangles = mesh
            .triangles
            .iter()
            .map(|&[a, b, c]| {
                let (a, b, c) = (corner(a)?, corner(b)?, corner(c)?);
                Some([a, b - a, c - a])
            })
            .collect();
        Self { triangles }
    }

    /// The nearest hit of one ray; the first of several triangles at the same distance.
    fn nearest(&self, ray: &Ray) -> Hit {
        let mut best = Hit::miss();
        let mut best_t = f64::INFINITY;
        if !ray.is_usable() {
            return best;
        }
        let origin = DVec3::from(ray.origin.map(f64::from));
        let direction = DVec3::from(ray.direction.map(f64::from));
        for (index, triangle) in self.triangles.iter().enumerate() {
            let Some([a, e1, e2]) = triangle else {
                continue;
            };
            // Möller and Trumbore 1997: solve origin + t·direction = a + u·e1 + v·e2 by Cramer's
            // rule.
            let p = direction.cross(*e2);
            let determinant = e1.dot(p);
            if determinant == 0.0 {
                continue;
            }
            let s = origin - *a;
            let u = s.dot(p) / determinant;
            let q = s.cross(*e1);
            let v = direction.dot(q) / determinant;
            let t = e2.dot(q) / determinant;
            let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
            if inside
                && t > f64::from(ray.t_near.max(0.0))
                && t <= f64::from(ray.t_far)
                && t < best_t
            {
                best_t = t;
                best = Hit {
                    t: t as f32,
                    u: u as f32,
                    v: v as f32,
                    triangle: index as u32,
                };
            }
        }
        best
    }
}

impl Tracer for BruteForce {
    fn closest(&self, rays: &[Ray], hits: &mut [Hit]) {
        assert_eq!(rays.len(), hits.len(), "one hit per ray");
        for (ray, hit) in rays.iter().zip(hits) {
            *hit = self.nearest(ray);
        }
    }

    fn occluded(&self, rays: &[Ray], occluded: &mut [u8]) {
        assert_eq!(rays.len(), occluded.len(), "one flag per ray");
        for (ray, flag) in rays.iter().zip(occluded) {
            *flag = u8::from(self.nearest(ray).is_hit());
        }
    }
}
