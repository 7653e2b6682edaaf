//! Where views contradict each other: geometry that is missing or only roughly right (furniture
//! absent from a floor plan, open door leaves, walls 5 cm off).
//!
//! A texel then receives photographs of different things. Nothing tells which of them belongs to
//! the surface, and a robust estimate takes sides: it is right or far off. The estimate with the
//! least expected error is the mean of the views, with their disagreement as its error
//! (`docs/lab/real-house.md` measures both). So contradicted texels take the mean, state that
//! error, and are no evidence for the colours of classes. Called by the pipeline's stage `observe`
//! once the exposures are equal, only where most views disagree ([`super::ViewGains`]).

use super::fusion::{prefer_clean, sharpness};
use crate::core::geometry::Mesh;
use crate::core::math::luminance;
use crate::core::parallel;
use crate::core::stats::median;
use crate::core::texture::Texels;
use crate::gbuffer::{Observation, Observer, Orientation};
use glam::{DVec3, Vec3};
use std::collections::BTreeMap;

/// Root mean square of ln luminance against its mean beyond which views contradict each other: a
/// third more or less light, three times what exposure, gloss and response leave on average.
const CONTRADICTED: f32 = 0.3;
/// Texels per parallel task.
const CHUNK: usize = 2048;
/// Side of the cells in which missing geometry is looked for, metres.
const CELL: f32 = 1.0;
/// Places that are named.
const PLACES: usize = 6;

/// What the views of each covered texel say against each other.
#[derive(Clone, Debug, Default)]
pub struct Contradictions {
    /// Weighted root mean square of the looks' ln luminance against its mean; 0 where the looks
    /// agree or there is only one.
    pub deviation: Vec<f32>,
    /// Mean radiance of the looks of a contradicted texel.
    mean: Vec<Vec3>,
    /// Median of the standard deviations of texels that several views see and that are not contradicted: by
    /// how much views disagree where no texel states it; 0 without any.
    pub agreed: f32,
}

/// A place at which much surface is contradicted: what is missing stands there or before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MissingGeometry {
    /// Its middle, in coordinates of the file (y up), metres.
    pub place: DVec3,
    /// Surface that is contradicted within a metre, m².
    pub area: f32,
}

impl Contradictions {
    /// Compares the looks of every texel.
    #[must_use]
    pub fn find(observer: &Observer, orientation: &Orientation, texels: &Texels) -> Self {
        let parts = parallel::map_chunks(texels.len(), CHUNK, |range| {
            let mut seen = Vec::new();
            range
                .map(|i| {
                    let t = texels.point[i].triangle as usize;
                    let normal = observer.mesh.face_normal(t) * orientation.sign(t);
                    observer.observe(texels.position(observer.mesh, i), normal, &mut seen);
                    prefer_clean(&mut seen);
                    compared(&seen)
                })
                .collect::<Vec<_>>()
        });
        let looks: Vec<Compared> = parts.into_iter().flatten().collect();
        let agree = |c: &&Compared| c.several && c.deviation < CONTRADICTED;
        let agreed: Vec<f32> = looks.iter().filter(agree).map(|c| c.deviation).collect();
        let (deviation, mean) = looks
            .iter()
            .map(|c| match c.deviation < CONTRADICTED {
                true => (0.0, Vec3::ZERO),
                false => (c.deviation, c.mean),
            })
            .unzip();
        Self {
            deviation,
            mean,
            agreed: median(agreed).unwrap_or(0.0),
        }
    }

    /// Whether the views of texel `i` contradict each other.
    #[must_use]
    pub fn contradicted(&self, i: usize) -> bool {
        self.deviation.get(i).is_some_and(|d| *d > 0.0)
    }

    /// Puts the mean of the looks in the place of what a robust estimate took from some of them.
    pub fn settle(&self, radiance: &mut [Vec3]) {
        for (i, out) in radiance.iter_mut().enumerate() {
            if self.contradicted(i) {
                *out = self.mean[i];
            }
        }
    }

    /// Share of the surface on which views contradict each other.
    #[must_use]
    pub fn share(&self, mesh: &Mesh, texels: &Texels) -> f32 {
        let (mut part, mut all) = (0.0f64, 0.0f64);
        for i in 0..self.deviation.len() {
            let a = f64::from(texels.area(mesh, i));
            all += a;
            part += if self.contradicted(i) { a } else { 0.0 };
        }
        (part / all.max(f64::MIN_POSITIVE)) as f32
    }

    /// The places at which most surface is contradicted, the largest first; `origin` is that of the
    /// scene in coordinates of the file.
    #[must_use]
    pub fn places(&self, mesh: &Mesh, texels: &Texels, origin: DVec3) -> Vec<MissingGeometry> {
        let mut cells: BTreeMap<[i32; 3], (Vec3, f32)> = BTreeMap::new();
        for i in (0..self.deviation.len()).filter(|i| self.contradicted(*i)) {
            let (p, area) = (texels.position(mesh, i), texels.area(mesh, i));
            let cell = (p / CELL).floor().as_ivec3().to_array();
            let sum = cells.entry(cell).or_default();
            *sum = (sum.0 + p * area, sum.1 + area);
        }
        let mut places = Vec::new();
        while places.len() < PLACES {
            let largest = cells
                .values()
                .copied()
                .reduce(|a, b| if b.1 > a.1 { b } else { a });
            let Some((sum, area)) = largest.filter(|l| l.1 > 0.0) else {
                break;
            };
            let middle = sum / area;
            let mut around = 0.0;
            // what lies around is the same piece of furniture
            cells.retain(|_, (sum, area)| {
                let near = (*sum / *area).distance(middle) < 1.5 * CELL;
                around += if near { *area } else { 0.0 };
                !near
            });
            places.push(MissingGeometry {
                place: origin + middle.as_dvec3(),
                area: around,
            });
        }
        places
    }
}

/// What some looks at a texel say against each other.
#[derive(Clone, Copy, Default)]
struct Compared {
    /// Whether there are several.
    several: bool,
    /// Weighted root mean square of their ln luminance against its mean.
    deviation: f32,
    /// Their mean radiance.
    mean: Vec3,
}

/// Deviation and mean of some looks at a texel; zeros where there is only one.
fn compared(seen: &[Observation]) -> Compared {
    let weight = |o: &Observation| sharpness(o).sqrt();
    let total: f32 = seen.iter().map(weight).sum();
    if seen.len() < 2 || total <= 0.0 {
        return Compared::default();
    }
    let log = |o: &Observation| luminance(o.radiance).max(f32::MIN_POSITIVE).ln();
    let centre = seen.iter().map(|o| weight(o) * log(o)).sum::<f32>() / total;
    let square = seen.iter().map(|o| weight(o) * (log(o) - centre).powi(2));
    Compared {
        several: true,
        deviation: (square.sum::<f32>() / total).sqrt(),
        mean: seen.iter().map(|o| o.radiance * weight(o)).sum::<Vec3>() / total,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::{Camera, Projection};
    use crate::core::image::Plane;
    use crate::core::trace::EmbreeTracer;
    use crate::gbuffer::{ObservedView, ViewBuffer};
    use crate::observed::surface_tests::box_scene;
    use glam::Mat3;

    /// Four panoramas of a white box of 4 × 3 × 5 m; a dark crate of 0.4 m stands in the middle of
    /// its floor and is not in the mesh.
    fn views() -> Vec<ObservedView> {
        let scene = box_scene();
        let tracer = EmbreeTracer::new(&scene.mesh).expect("Embree");
        let crate_hit = |from: Vec3, d: Vec3| {
            let (lo, hi) = (Vec3::new(1.8, 0.0, 2.3), Vec3::new(2.2, 0.4, 2.7));
            let (a, b) = ((lo - from) / d, (hi - from) / d);
            a.min(b).max_element() < a.max(b).min_element() && a.max(b).min_element() > 0.0
        };
        [(0.6, 0.6), (3.4, 0.8), (0.7, 4.3), (3.3, 4.4)]
            .into_iter()
            .map(|(x, z)| {
                let camera = Camera {
                    projection: Projection::Equirectangular,
                    width: 256,
                    height: 128,
                    world_from_camera: Mat3::IDENTITY,
                    position: Vec3::new(x, 1.4, z),
                };
                let buffer = ViewBuffer::trace(&camera, &tracer);
                let data = (0..256 * 128)
                    .map(|i| {
                        let d = (buffer.position(i % 256, i / 256) - camera.position).normalize();
                        let dark = crate_hit(camera.position, d);
                        Vec3::splat(if dark { 0.1 } else { 0.8 })
                    })
                    .collect();
                ObservedView {
                    clean: buffer.clean_pixels(&scene.mesh, None),
                    buffer,
                    radiance: Plane {
                        width: 256,
                        height: 128,
                        data,
                    },
                    labels: None,
                    valid: None,
                }
            })
            .collect()
    }

    #[test]
    fn a_missing_crate_is_found_near_its_place_and_nothing_else() {
        let (scene, views) = (box_scene(), views());
        let buffers: Vec<&ViewBuffer> = views.iter().map(|v| &v.buffer).collect();
        let orientation = Orientation::vote(&scene.mesh, &buffers);
        let texels = Texels::rasterize(&scene.mesh, 256, 256);
        let observer = Observer {
            mesh: &scene.mesh,
            views: &views,
        };
        let found = Contradictions::find(&observer, &orientation, &texels);
        let places = found.places(&scene.mesh, &texels, scene.origin);
        let first = places.first().expect("the crate");
        assert!(
            first.place.distance(DVec3::new(2.0, 0.2, 2.5)) < 1.0,
            "{places:?}"
        );
        assert!(first.area > 0.16, "{places:?}");
        // under the crate one view at least sees its side and one sees over it, far from its rays
        // all agree; the mean lies between
        let mut radiance = vec![Vec3::ZERO; texels.len()];
        found.settle(&mut radiance);
        for (i, l) in radiance.iter().map(|l| l.x).enumerate() {
            let p = texels.position(&scene.mesh, i);
            assert!(l == 0.0 || (0.1..0.8).contains(&l), "{p}: {l}");
            assert!(
                p.y < 2.0 || l == 0.0,
                "the ceiling at {p} is seen by all alike"
            );
        }
        let share = found.share(&scene.mesh, &texels);
        assert!((0.02..0.4).contains(&share), "{share}");
        // nothing is said of what is seen once, or alike
        let alone = Contradictions::find(
            &Observer {
                mesh: &scene.mesh,
                views: &views[..1],
            },
            &orientation,
            &texels,
        );
        assert!(!alone.deviation.iter().any(|d| *d > 0.0));
        assert!(alone.places(&scene.mesh, &texels, scene.origin).is_empty());
    }
}
