//! Irradiance at texels of an atlas, by the path tracer: each texel is sampled in independent parts,
//! whose scatter tells their noise, and filtered over the surface ([`SurfaceFilter`]).
//!
//! `synth` bakes the diffuse light that all of its photographs show, `export --lightings` the
//! lightmaps of a scene under changed light, `bake` those of any glTF file.

use super::{IndirectCache, IrradiancePoint, PathTracer};
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::Frame;
use crate::core::parallel::map_chunks;
use crate::core::progress::Progress;
use crate::core::sampling::{hammersley, square_to_cosine_hemisphere};
use crate::core::texture::{Texels, fill_uncovered};
use crate::core::trace::{Hit, Ray, Tracer};
use crate::irradiance::{Irradiance, SUB_ESTIMATES, SurfaceFilter, Surfel};
use glam::Vec3;

/// Independent estimates of one value.
pub type Parts = [Vec3; SUB_ESTIMATES];

/// How a lightmap is sampled.
#[derive(Clone, Copy, Debug)]
pub struct LightmapSampling {
    /// Paths per texel in each of the parts ([`SUB_ESTIMATES`] of them).
    pub paths_per_part: u32,
    /// Squared differences in variances at which texels part; `None` = as irradiance textures do.
    pub parting: Option<f32>,
}

impl LightmapSampling {
    /// About as many paths per texel, parted as irradiance textures are.
    #[must_use]
    pub fn of_paths(paths: u32) -> Self {
        Self {
            paths_per_part: (paths / SUB_ESTIMATES as u32).max(1),
            parting: None,
        }
    }
}

/// The texels of a lightmap and the points on which they lie.
pub struct LightmapTexels<'a> {
    mesh: &'a Mesh,
    texels: Texels,
    points: Vec<IrradiancePoint>,
    /// Texels that are baked, ascending.
    open: Vec<usize>,
}

impl<'a> LightmapTexels<'a> {
    /// The texels of a square map of `side` texels over a mesh's atlas.
    #[must_use]
    pub fn new(mesh: &'a Mesh, side: usize) -> Self {
        let texels = Texels::rasterize(mesh, side, side);
        let points: Vec<IrradiancePoint> = (0..texels.len())
            .map(|i| receiver(mesh, &texels, i))
            .collect();
        let open = (0..points.len()).collect();
        Self {
            mesh,
            texels,
            points,
            open,
        }
    }

    /// The texels.
    #[must_use]
    pub fn texels(&self) -> &Texels {
        &self.texels
    }

    /// The points of all texels.
    #[must_use]
    pub fn points(&self) -> &[IrradiancePoint] {
        &self.points
    }

    /// Leaves texels out, one mark per point: they take the light of those beside them.
    #[must_use]
    pub fn without(self, hidden: &[bool]) -> Self {
        let open = self.open.into_iter().filter(|&i| !hidden[i]).collect();
        Self { open, ..self }
    }

    /// The texels that are baked, ascending, as numbers among [`Self::points`].
    #[must_use]
    pub fn open(&self) -> &[usize] {
        &self.open
    }

    /// World area of each texel that is baked, m².
    #[must_use]
    pub fn areas(&self) -> Vec<f32> {
        let area = |&i: &usize| self.texels.area(self.mesh, i);
        self.open.iter().map(area).collect()
    }

    /// Irradiance of the map with the lights of `renderer`, filled outside charts; indirect light
    /// comes from `cache` where one is given. The renderer's mesh may have more triangles than that
    /// of the atlas.
    #[must_use]
    pub fn bake(
        &self,
        renderer: &PathTracer<'_>,
        cache: Option<&dyn IndirectCache>,
        sampling: LightmapSampling,
        progress: &Progress,
    ) -> RgbPlane {
        let normals = self.normals();
        let parts = self.sample(
            &Receiving {
                renderer,
                cache,
                normals: &normals,
            },
            sampling.paths_per_part,
            0,
            progress,
        );
        let filtered = progress.stage("filtering diffuse light", 1, |_| {
            let filter = self.filter(renderer);
            let filter = match sampling.parting {
                Some(different) => filter.parting_at(different),
                None => filter,
            };
            filter.filter(&Irradiance::of_parts(parts), |_| 1.0)
        });
        self.spread(&filtered.value)
    }

    /// Shading normal of each texel that is baked.
    #[must_use]
    pub fn normals(&self) -> Vec<Vec3> {
        self.open.iter().map(|&i| self.points[i].normal).collect()
    }

    /// Samples the texels that are baked, in independent parts of `paths` paths each; `pass` tells
    /// samplings of the same scene apart.
    #[must_use]
    pub fn sample(
        &self,
        receiving: &Receiving<'_, '_>,
        paths: u32,
        pass: u64,
        progress: &Progress,
    ) -> Vec<Parts> {
        let point = |(&i, &normal): (&usize, &Vec3)| IrradiancePoint {
            normal,
            ..self.points[i]
        };
        let points = self.open.iter().zip(receiving.normals).map(point);
        let points: Vec<IrradiancePoint> = points.collect();
        progress.stage(
            "baking diffuse light",
            (SUB_ESTIMATES * points.len()) as u64,
            |p| {
                let part = |k: usize| {
                    let key = 0x11a + pass * SUB_ESTIMATES as u64 + k as u64;
                    let Receiving {
                        renderer, cache, ..
                    } = receiving;
                    renderer.irradiance_with(&points, paths, key, *cache, p)
                };
                let parts: [Vec<Vec3>; SUB_ESTIMATES] = std::array::from_fn(part);
                (0..points.len())
                    .map(|i| std::array::from_fn(|k| parts[k][i]))
                    .collect()
            },
        )
    }

    /// The filter over the texels that are baked.
    #[must_use]
    pub fn filter(&self, renderer: &PathTracer<'_>) -> SurfaceFilter {
        let patch = |&i: &usize| Surfel {
            position: self.points[i].position,
            normal: self.points[i].normal,
            size: self.texels.area(self.mesh, i).sqrt(),
        };
        let patches: Vec<Surfel> = self.open.iter().map(patch).collect();
        SurfaceFilter::new(&patches, renderer.tracer())
    }

    /// A map of one value per texel that is baked, filled elsewhere.
    #[must_use]
    pub fn spread(&self, values: &[Vec3]) -> RgbPlane {
        let (width, height) = (self.texels.width, self.texels.height);
        let mut plane = Plane::filled(width, height, Vec3::ZERO);
        let mut covered = Plane::filled(width, height, false);
        for (&i, &value) in self.open.iter().zip(values) {
            let cell = self.texels.cell[i] as usize;
            (plane.data[cell], covered.data[cell]) = (value, true);
        }
        fill_uncovered(&plane, &covered)
    }
}

/// What texels receive, and for which normals.
pub struct Receiving<'a, 's> {
    /// The lit scene.
    pub renderer: &'a PathTracer<'s>,
    /// Where indirect light comes from, if not from paths.
    pub cache: Option<&'a dyn IndirectCache>,
    /// Normal of each texel that is baked: its own, or another whose irradiance is wanted. Only
    /// what arrives above the surface itself counts.
    pub normals: &'a [Vec3],
}

/// Directions in which a point looks about: enough to tell a quarter from a half.
const LOOKS: usize = 16;

/// Cosine-distributed rays from each point, as far as `reach`.
fn looking_about(points: &[IrradiancePoint], reach: f32, lift: f32) -> Vec<Ray> {
    let rays = points.iter().flat_map(|point| {
        let frame = Frame::from_normal(point.normal);
        (0..LOOKS).map(move |k| {
            let u = hammersley(k as u32, LOOKS as u32);
            let local = square_to_cosine_hemisphere([u[0] + 0.5 / LOOKS as f32, u[1]]);
            let from = point.position + point.face_normal * lift;
            Ray::new(from, frame.world_from_local(local), reach)
        })
    });
    rays.collect()
}

/// Which points lie inside or under something: most of their view is blocked nearer than `reach`.
#[must_use]
pub fn buried(points: &[IrradiancePoint], reach: f32, tracer: &dyn Tracer) -> Vec<bool> {
    let lift = 1e-4_f32.min(0.01 * reach);
    let parts = map_chunks(points.len(), 256, |range| {
        let rays = looking_about(&points[range], reach, lift);
        let mut occluded = vec![0u8; rays.len()];
        tracer.occluded(&rays, &mut occluded);
        let blocked = |o: &[u8]| o.iter().filter(|&&x| x != 0).count() > LOOKS * 3 / 4;
        occluded.chunks(LOOKS).map(blocked).collect::<Vec<bool>>()
    });
    parts.into_iter().flatten().collect()
}

/// Which points lie inside of a body: more than half of what they see are backs of surfaces that
/// have but a front (`one_sided` by triangle). `lift` is how far above their surface they look
/// about.
#[must_use]
pub fn inside(
    points: &[IrradiancePoint],
    lift: f32,
    mesh: &Mesh,
    tracer: &dyn Tracer,
    one_sided: &(dyn Fn(usize) -> bool + Sync),
) -> Vec<bool> {
    let parts = map_chunks(points.len(), 256, |range| {
        let rays = looking_about(&points[range], f32::INFINITY, lift);
        let mut hits = vec![Hit::miss(); rays.len()];
        tracer.closest(&rays, &mut hits);
        let back = |(ray, hit): (&Ray, &Hit)| {
            let t = hit.triangle as usize;
            hit.is_hit()
                && one_sided(t)
                && mesh.face_normal(t).dot(Vec3::from_array(ray.direction)) > 0.0
        };
        let backs: Vec<bool> = rays.iter().zip(&hits).map(back).collect();
        let enclosed = |b: &[bool]| b.iter().filter(|x| **x).count() > LOOKS / 2;
        backs.chunks(LOOKS).map(enclosed).collect::<Vec<bool>>()
    });
    parts.into_iter().flatten().collect()
}

fn receiver(mesh: &Mesh, texels: &Texels, i: usize) -> IrradiancePoint {
    let triangle = texels.point[i].triangle as usize;
    let (u, v) = texels.ray_point(i);
    let normal = mesh.shading_normal(triangle, u, v);
    IrradiancePoint {
        position: mesh.position(triangle, u, v),
        face_normal: mesh.face_normal(triangle),
        normal,
    }
}
