//! Geometry with what the photographs see of it: the ground every later stage stands on.

use super::SolveOptions;
use super::balance::{balance_views, leave_out_clipped_sky};
use super::decisions::{Sizes, choose_sizes};
use super::labels::complete_labels;
use crate::Result;
use crate::gbuffer::{ObservedView, Observer, Orientation, ViewBuffer, clipped_pixels};
use crate::geometry::Mesh;
use crate::image::{Plane, RgbPlane};
use crate::lighting::Fusion;
use crate::progress::Progress;
use crate::scene::{Scene, Split};
use crate::texture::Texels;
use crate::trace::{EmbreeTracer, Hit};
use glam::Vec3;
use std::time::Instant;

/// Mesh, acceleration structure, views and their fused observations on the atlas.
pub struct Surface<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Embree.
    pub tracer: EmbreeTracer,
    /// Training views.
    pub views: Vec<ObservedView>,
    /// Side of each triangle the cameras see.
    pub orientation: Orientation,
    /// Sizes of the textures.
    pub sizes: Sizes,
    /// Covered texels of the albedo atlas.
    pub texels: Texels,
    /// Fused radiance and label votes of `texels`.
    pub fusion: Fusion,
    /// Class per texel after the vote and filling; 0 only without any label.
    pub labels: Vec<u16>,
    /// Mean radiance of each triangle's far side, zero where unseen.
    pub back: Vec<Vec3>,
    /// Distance by which rays start above a surface, metres.
    pub offset: f32,
}

impl<'a> Surface<'a> {
    /// Reads the training views and fuses what they see.
    ///
    /// # Errors
    /// Unreadable or unusable images and labels.
    pub fn observe(scene: &'a Scene, options: &SolveOptions, progress: &Progress) -> Result<Self> {
        let tracer = EmbreeTracer::new(&scene.mesh)?;
        let train: Vec<_> = scene
            .views
            .iter()
            .filter(|v| v.split == Split::Train)
            .collect();
        let mut clipped = Vec::with_capacity(train.len());
        let mut views = progress.stage("views", train.len() as u64, |p| {
            train
                .iter()
                .map(|view| {
                    let full = scene.load_radiance(view)?;
                    let ceiling =
                        clipped_pixels(&full).map(|c| any_of(&c, options.photo_reduction));
                    let radiance = reduced(full, options.photo_reduction);
                    let labels = scene.load_labels(view)?;
                    let valid = scene
                        .load_mask(view)?
                        .map(|m| all_valid(&m, options.photo_reduction));
                    let buffer = ViewBuffer::trace(
                        &view.camera.resized(radiance.width, radiance.height),
                        &tracer,
                    );
                    let mut clean = buffer.clean_pixels(&scene.mesh, labels.as_ref());
                    if let Some(at) = &ceiling {
                        // a lower bound: used only where no other look is at hand
                        clean
                            .data
                            .iter_mut()
                            .zip(&at.data)
                            .for_each(|(clean, clipped)| *clean &= !clipped);
                        let share =
                            at.data.iter().filter(|c| **c).count() as f64 / at.data.len() as f64;
                        p.note(format!(
                            "{}: {:.2} % of the pixels are clipped",
                            view.stem,
                            100.0 * share
                        ));
                    }
                    clipped.push(ceiling);
                    p.advance(1);
                    Ok(ObservedView {
                        buffer,
                        radiance,
                        clean,
                        labels,
                        valid,
                    })
                })
                .collect::<Result<Vec<_>>>()
        })?;
        let orientation = Orientation::vote(
            &scene.mesh,
            &views.iter().map(|v| &v.buffer).collect::<Vec<_>>(),
        );
        if orientation.flipped() > 0 {
            progress.note(format!(
                "{} of {} triangles are seen from behind their winding; their normals are turned",
                orientation.flipped(),
                scene.mesh.triangles.len()
            ));
        }
        leave_out_clipped_sky(&mut views, &clipped);
        drop(clipped);
        balance_views(scene, &mut views, &orientation, options.exposure, progress);
        let sizes = choose_sizes(
            &Observer {
                mesh: &scene.mesh,
                views: &views,
            },
            &orientation,
            options,
            progress,
        );
        let texels = Texels::rasterize(&scene.mesh, sizes.albedo, sizes.albedo);
        let begin = Instant::now();
        let fusion = options.checkpoints.reuse("radiance", progress, || {
            progress.stage("radiance", texels.len() as u64, |p| {
                crate::lighting::fuse_radiance(
                    &Observer {
                        mesh: &scene.mesh,
                        views: &views,
                    },
                    &orientation,
                    &texels,
                    p,
                )
            })
        });
        if let Some(budget) = &options.budget {
            budget.fused(begin.elapsed().as_secs_f64());
        }
        let labels = complete_labels(&scene.mesh, &texels, &fusion);
        let back = back_radiance(scene, &views, &orientation);
        let (lo, hi) = scene.mesh.bounds();
        // a tenth of a millimetre in a ten-metre room, well above the rounding of positions
        let offset = (hi - lo).length() * 1e-5;
        Ok(Self {
            scene,
            tracer,
            views,
            orientation,
            sizes,
            texels,
            fusion,
            labels,
            back,
            offset,
        })
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
    /// between turned and unturned triangles are doubled, so that vertex normals agree with their
    /// faces.
    #[must_use]
    pub fn oriented_mesh(&self) -> Mesh {
        let mut mesh = self.scene.mesh.clone();
        let mut turned: Vec<Option<u32>> = vec![None; mesh.positions.len()];
        for (t, corners) in mesh.triangles.iter_mut().enumerate() {
            if self.orientation.sign(t) > 0.0 {
                continue;
            }
            for c in corners.iter_mut() {
                let i = *c as usize;
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

/// A photograph at a `factor`-th of its size: means of blocks, those at the far edges cut off.
fn reduced(image: RgbPlane, factor: usize) -> RgbPlane {
    if factor <= 1 {
        return image;
    }
    let factor = within(&image, factor);
    let gain = 1.0 / (factor * factor) as f32;
    blocks(&image.map(|v| *v * gain), factor, |a, b| a + b)
}

/// A mask at the size of [`reduced`]: a block may be used if all of it may.
fn all_valid(mask: &Plane<bool>, factor: usize) -> Plane<bool> {
    blocks(mask, factor, |a, b| a && b)
}

/// Marks at the size of [`reduced`]: a block is marked if any of it is.
fn any_of(marks: &Plane<bool>, factor: usize) -> Plane<bool> {
    blocks(marks, factor, |a, b| a || b)
}

/// The factor, but no more than leaves one block.
fn within<T>(image: &Plane<T>, factor: usize) -> usize {
    factor.clamp(1, image.width.min(image.height).max(1))
}

/// Square blocks of pixels joined into one each; at least one block however large the factor.
fn blocks<T: Copy>(image: &Plane<T>, factor: usize, join: impl Fn(T, T) -> T) -> Plane<T> {
    let factor = within(image, factor);
    let (width, height) = (image.width / factor, image.height / factor);
    let block = |i: usize| {
        let (x, y) = (i % width * factor, i / width * factor);
        (1..factor * factor).fold(image[(x, y)], |sum, k| {
            join(sum, image[(x + k % factor, y + k / factor)])
        })
    };
    Plane {
        width,
        height,
        data: (0..width * height).map(block).collect(),
    }
}

/// Mean radiance per triangle of pixels that see it from the side away from its orientation.
fn back_radiance(scene: &Scene, views: &[ObservedView], orientation: &Orientation) -> Vec<Vec3> {
    let n = scene.mesh.triangles.len();
    let mut sum = vec![Vec3::ZERO; n];
    let mut count = vec![0u32; n];
    for v in views {
        let b = &v.buffer;
        let (w, h): (usize, usize) = (b.triangle.width, b.triangle.height);
        for y in 0..h {
            for x in 0..w {
                let t = b.triangle[(x, y)];
                if t == Hit::MISS {
                    continue;
                }
                let t = t as usize;
                let d = b
                    .camera
                    .direction(glam::Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
                if scene.mesh.face_normal(t).dot(d) * orientation.sign(t) > 0.0 {
                    sum[t] += v.radiance[(x, y)];
                    count[t] += 1;
                }
            }
        }
    }
    sum.iter()
        .zip(&count)
        .map(|(s, c)| if *c > 0 { *s / *c as f32 } else { Vec3::ZERO })
        .collect()
}

/// A plane of texel validity for the covered texels of `texels`.
pub(super) fn coverage(texels: &Texels) -> Plane<bool> {
    texels.scatter(&vec![true; texels.len()], false)
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
            views: Vec::new(),
            orientation: Orientation::of_winding(triangles),
            sizes: Sizes {
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
            offset: 7e-5,
        }
    }

    #[test]
    fn a_reduced_photograph_keeps_its_brightness_even_beyond_its_size() {
        let image = Plane::filled(4, 2, Vec3::new(3.0, 2.0, 1.0));
        for (factor, size) in [(0, (4, 2)), (1, (4, 2)), (2, (2, 1)), (100, (2, 1))] {
            let small = reduced(image.clone(), factor);
            assert_eq!((small.width, small.height), size, "factor {factor}");
            assert!(
                small.data.iter().all(|v| *v == image.data[0]),
                "factor {factor}: {:?}",
                small.data[0]
            );
        }
    }
}
