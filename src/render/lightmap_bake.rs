//! Irradiance at texels of an atlas, by the path tracer: each texel is sampled in independent parts,
//! whose scatter tells their noise, and filtered over the surface ([`SurfaceFilter`]).
//!
//! `synth` bakes the diffuse light that all of its photographs show, `export --lightings` the
//! lightmaps of a scene under changed light.

use super::{IndirectCache, IrradiancePoint, PathTracer};
use crate::core::geometry::Mesh;
use crate::core::image::{Plane, RgbPlane};
use crate::core::progress::Progress;
use crate::core::texture::{Texels, fill_uncovered};
use crate::irradiance::{Irradiance, SUB_ESTIMATES, SurfaceFilter, Surfel};
use glam::Vec3;

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
        let points: Vec<IrradiancePoint> = self.open.iter().map(|&i| self.points[i]).collect();
        let parts: Vec<[Vec3; SUB_ESTIMATES]> = progress.stage(
            "baking diffuse light",
            (SUB_ESTIMATES * points.len()) as u64,
            |p| {
                let part = |k: usize| {
                    let paths = sampling.paths_per_part;
                    renderer.irradiance_with(&points, paths, 0x11a + k as u64, cache, p)
                };
                let parts: [Vec<Vec3>; SUB_ESTIMATES] = std::array::from_fn(part);
                (0..points.len())
                    .map(|i| std::array::from_fn(|k| parts[k][i]))
                    .collect()
            },
        );
        let value = progress.stage("filtering diffuse light", 1, |_| {
            self.filtered(&points, parts, sampling, renderer)
        });
        let (width, height) = (self.texels.width, self.texels.height);
        let mut plane = Plane::filled(width, height, Vec3::ZERO);
        let mut covered = Plane::filled(width, height, false);
        for (&i, value) in self.open.iter().zip(value) {
            let cell = self.texels.cell[i] as usize;
            (plane.data[cell], covered.data[cell]) = (value, true);
        }
        fill_uncovered(&plane, &covered)
    }

    /// The values of the open texels, shared over the surface.
    fn filtered(
        &self,
        points: &[IrradiancePoint],
        parts: Vec<[Vec3; SUB_ESTIMATES]>,
        sampling: LightmapSampling,
        renderer: &PathTracer<'_>,
    ) -> Vec<Vec3> {
        let size = |i: usize| self.texels.area(self.mesh, i).sqrt();
        let patch = |(p, &i): (&IrradiancePoint, &usize)| Surfel {
            position: p.position,
            normal: p.normal,
            size: size(i),
        };
        let patches: Vec<Surfel> = points.iter().zip(&self.open).map(patch).collect();
        let baked = Irradiance::of_parts(parts);
        let filter = SurfaceFilter::new(&patches, renderer.tracer());
        let filter = match sampling.parting {
            Some(different) => filter.parting_at(different),
            None => filter,
        };
        filter.filter(&baked, |_| 1.0).value
    }
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
