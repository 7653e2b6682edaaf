//! Geometry with what the photographs see of it: the ground every later stage stands on. Built by
//! the pipeline's stage `observe`.

use super::{Contradictions, Fusion, Panes};
use crate::core::geometry::Mesh;
use crate::core::image::{CameraMask, Plane};
use crate::core::texture::{Texels, fill_uncovered};
use crate::core::trace::EmbreeTracer;
use crate::gbuffer::{ObservedView, Observer, Orientation};
use crate::scene::{Class, Scene, Shortfall};
use glam::Vec3;
use std::collections::{BTreeMap, HashSet};

/// Sides of the textures, texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TextureSizes {
    /// Albedo, radiance, emission, labels.
    pub albedo: usize,
    /// Roughness.
    pub roughness: usize,
    /// Irradiance.
    pub irradiance: usize,
}

/// A texel of a reflecting surface that is at the ceiling in most looks at it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClippedTexel {
    /// Index among the covered texels.
    pub texel: u32,
    /// Radiance sent out at least.
    pub least: Vec3,
    /// Side of the sharpest clipped pixel's footprint, metres.
    pub footprint: f32,
}

/// Mesh, acceleration structure, views and their fused observations on the atlas.
pub struct Surface<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Embree, for which panes are not there.
    pub tracer: EmbreeTracer,
    /// What the photographs look through.
    pub panes: Panes,
    /// Training views.
    pub views: Vec<ObservedView>,
    /// Channels at the sensor's ceiling, a bit for each, per pixel of every view; `None` where no
    /// pixel is.
    pub ceilings: Vec<Option<Plane<u8>>>,
    /// Pixels that show only that their surface sends out at least as much; empty where nothing is
    /// clipped.
    pub bounds: Vec<Option<Plane<bool>>>,
    /// What of the light the photographs' files may lack.
    pub shortfalls: Vec<Shortfall>,
    /// Side of each triangle the cameras see.
    pub orientation: Orientation,
    /// Sizes of the textures.
    pub sizes: TextureSizes,
    /// Covered texels of the albedo atlas.
    pub texels: Texels,
    /// Fused radiance and label votes of `texels`.
    pub fusion: Fusion,
    /// Class per texel after the vote and filling; 0 only without any label.
    pub labels: Vec<u16>,
    /// Mean radiance of each triangle's far side, zero where unseen.
    pub back: Vec<Vec3>,
    /// Where views contradict each other; empty unless geometry is only roughly right.
    pub contradictions: Contradictions,
    /// Reflecting texels of which clipped looks give lower bounds, ascending.
    pub clipped: Vec<ClippedTexel>,
    /// Whether all looks were made for a display (8-bit sRGB), which cameras compress by place.
    pub encoded: bool,
    /// Radiance of directions without geometry where no view looks along any: a scan's holes.
    pub ambient: Vec3,
    /// What the cameras carry along.
    pub camera_masks: Vec<CameraMask>,
    /// Distance by which rays start above a surface, metres.
    pub offset: f32,
    /// By how much the views disagree about what they share, where texels do not state it as
    /// contradicted: the standard deviation of ln radiance, robustly.
    pub disagreement: f32,
}

/// Texels closer than this share of the scene's diagonal are one light.
const GAP: f32 = 0.02;
/// Cosine to the vertical of a face that looks down.
const DOWN: f32 = -0.7;

impl Surface<'_> {
    /// Whether photographs have labels, or the mesh has classes of its own.
    #[must_use]
    pub fn is_labelled(&self) -> bool {
        self.scene.mesh_classes.is_some() || self.views.iter().any(|v| v.labels.is_some())
    }

    /// Whether the class of each texel is one of those that `is` holds for.
    #[must_use]
    pub fn texels_of(&self, is: impl Fn(&Class) -> bool) -> Vec<bool> {
        let classes = self.scene.classes.iter().filter(|c| is(c));
        let ids: HashSet<u16> = classes.map(|c| c.id).collect();
        self.labels.iter().map(|l| ids.contains(l)).collect()
    }

    /// Whether a pixel of a view gives a lower bound ([`Self::bounds`]) of one surface alone.
    #[must_use]
    pub fn is_clean_bound(&self, view: usize, pixel: usize) -> bool {
        let Some(Some(bounds)) = self.bounds.get(view) else {
            return false;
        };
        let (v, at) = (
            &self.views[view],
            (pixel % bounds.width, pixel / bounds.width),
        );
        bounds.data[pixel] && (v.buffer).is_clean(&self.scene.mesh, v.labels.as_ref(), at)
    }

    /// Texels of one class close to each other: the parts of `texels` that hang together, each
    /// ascending.
    #[must_use]
    pub fn clusters(&self, texels: &[u32]) -> Vec<Vec<u32>> {
        let mesh = &self.scene.mesh;
        let (lo, hi) = mesh.bounds();
        let step = (GAP * (hi - lo).length()).max(f32::MIN_POSITIVE);
        let mut cells: BTreeMap<(u16, [i32; 3]), Vec<u32>> = BTreeMap::new();
        for &i in texels {
            let p = (self.texels.position(mesh, i as usize) - lo) / step;
            let key = p.floor().to_array().map(|x| x as i32);
            let class = self.labels[i as usize];
            cells.entry((class, key)).or_default().push(i);
        }
        let mut out = Vec::new();
        while let Some((first, members)) = cells.pop_first() {
            let (mut cluster, mut open) = (members, vec![first.1]);
            while let Some(at) = open.pop() {
                for k in 0..27 {
                    let near = [at[0] + k % 3 - 1, at[1] + k / 3 % 3 - 1, at[2] + k / 9 - 1];
                    if let Some(more) = cells.remove(&(first.0, near)) {
                        cluster.extend(more);
                        open.push(near);
                    }
                }
            }
            cluster.sort_unstable();
            out.push(cluster);
        }
        out
    }

    /// Whether most of `texels` look down: the sun does not shine on them.
    #[must_use]
    pub fn faces_down(&self, texels: &[u32]) -> bool {
        let down = |i: &&u32| {
            let t = self.texels.point[**i as usize].triangle as usize;
            self.scene.mesh.face_normal(t).y * self.orientation.sign(t) < DOWN
        };
        2 * texels.iter().filter(down).count() > texels.len()
    }

    /// Finds the observations of surface points.
    #[must_use]
    pub fn observer(&self) -> Observer<'_> {
        Observer {
            mesh: &self.scene.mesh,
            views: &self.views,
        }
    }

    /// The mesh with every triangle wound so that its front is the side the cameras see. Vertices
    /// of turned triangles whose normals do not agree with the new fronts are doubled; those that do
    /// (of files whose windings are wrong and whose normals are right) stay shared.
    #[must_use]
    pub fn oriented_mesh(&self) -> Mesh {
        let mut mesh = self.scene.mesh.clone();
        let mut turned: Vec<Option<u32>> = vec![None; mesh.positions.len()];
        for (t, corners) in mesh.triangles.iter_mut().enumerate() {
            if self.orientation.sign(t) > 0.0 {
                continue;
            }
            let front = -self.scene.mesh.face_normal(t);
            for c in corners.iter_mut() {
                let i = *c as usize;
                if mesh.normals[i].dot(front) > 0.0 {
                    continue;
                }
                *c = *turned[i].get_or_insert_with(|| {
                    mesh.positions.push(mesh.positions[i]);
                    mesh.uvs.push(mesh.uvs[i]);
                    mesh.normals.push(-mesh.normals[i]);
                    (mesh.positions.len() - 1) as u32
                });
            }
            corners.swap(1, 2);
        }
        mesh
    }

    /// Shading and geometric normal at the point of a triangle nearest to `position`, on the side
    /// the cameras see.
    #[must_use]
    pub fn normals_at(&self, triangle: u32, position: Vec3) -> (Vec3, Vec3) {
        let (u, v) = self.scene.mesh.barycentrics(triangle as usize, position);
        self.normals(triangle as usize, u, v)
    }

    /// Atlas coordinate of the point of a triangle nearest to `position`.
    #[must_use]
    pub fn uv_at(&self, triangle: u32, position: Vec3) -> glam::Vec2 {
        let (u, v) = self.scene.mesh.barycentrics(triangle as usize, position);
        self.scene.mesh.uv(triangle as usize, u, v)
    }

    /// The texel of an atlas texture of any size at the point of a triangle nearest to `position`.
    #[must_use]
    pub fn nearest<T: Copy>(&self, plane: &Plane<T>, triangle: u32, position: Vec3) -> T {
        *plane.nearest(
            self.uv_at(triangle, position)
                * glam::Vec2::new(plane.width as f32, plane.height as f32),
        )
    }

    /// Shading and geometric normal at a surface point, on the side the cameras see.
    #[must_use]
    pub fn normals(&self, triangle: usize, u: f32, v: f32) -> (Vec3, Vec3) {
        let sign = self.orientation.sign(triangle);
        (
            self.scene.mesh.shading_normal(triangle, u, v) * sign,
            self.scene.mesh.face_normal(triangle) * sign,
        )
    }
}

/// A plane of texel validity for the covered texels of `texels`.
pub(crate) fn coverage(texels: &Texels) -> Plane<bool> {
    texels.scatter(&vec![true; texels.len()], false)
}

/// A value per covered texel as a texture, filled outside charts.
pub(crate) fn filled(texels: &Texels, values: &[f32]) -> Plane<f32> {
    fill_uncovered(&texels.scatter(values, 0.0), &coverage(texels))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use glam::{DVec3, Vec2};

    /// A box of 4 × 3 × 5 m seen from inside: floor, ceiling and four walls, two triangles and a
    /// cell of the atlas each.
    pub fn box_scene() -> Scene {
        let size = Vec3::new(4.0, 3.0, 5.0);
        let [x, y, z] = [Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z];
        let walls = [
            (Vec3::ZERO, z, x),
            (y, x, z),
            (Vec3::ZERO, y, z),
            (x, z, y),
            (Vec3::ZERO, x, y),
            (z, y, x),
        ];
        let mut mesh = Mesh::default();
        for (i, (corner, u, v)) in walls.into_iter().enumerate() {
            let first = mesh.positions.len() as u32;
            let cell = Vec2::new((i % 3) as f32, (i / 3) as f32);
            for (a, b) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                mesh.positions.push(corner + u * a + v * b);
                mesh.uvs
                    .push((cell + Vec2::new(0.1 + 0.8 * a, 0.1 + 0.8 * b)) / 3.0);
                mesh.normals.push(u.cross(v).normalize());
            }
            mesh.triangles
                .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        Scene::from_parts(
            std::path::PathBuf::new(),
            DVec3::ZERO,
            mesh,
            Vec::new(),
            Vec::new(),
        )
    }

    /// The surface of a scene of which no view sees anything: what is seen is up to the test.
    pub fn unseen(scene: &Scene, side: usize) -> Surface<'_> {
        let texels = Texels::rasterize(&scene.mesh, side, side);
        let (n, triangles) = (texels.len(), scene.mesh.triangles.len());
        let fusion = Fusion {
            radiance: vec![Vec3::ZERO; n],
            clean: vec![false; n],
            peak: vec![Vec3::ZERO; n],
            views: vec![0; n],
            label: vec![0; n],
            floor: vec![f32::INFINITY; n],
        };
        Surface {
            scene,
            tracer: EmbreeTracer::new(&scene.mesh).expect("Embree"),
            panes: Panes::default(),
            views: Vec::new(),
            ceilings: Vec::new(),
            bounds: Vec::new(),
            shortfalls: Vec::new(),
            orientation: Orientation::of_winding(triangles),
            sizes: TextureSizes {
                albedo: side,
                roughness: side,
                irradiance: side,
            },
            labels: texels
                .point
                .iter()
                .map(|p| 1 + p.triangle as u16 / 2)
                .collect(),
            texels,
            fusion,
            back: vec![Vec3::ZERO; triangles],
            contradictions: Contradictions::default(),
            clipped: Vec::new(),
            encoded: false,
            ambient: Vec3::ZERO,
            camera_masks: Vec::new(),
            offset: 7e-5,
            disagreement: 0.0,
        }
    }
}
