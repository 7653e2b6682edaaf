//! Where the samples of a pixel must be finer: at edges between surfaces or classes.

use crate::core::geometry::{Camera, Mesh};
use crate::core::image::Plane;
use crate::core::parallel::prelude::*;
use crate::core::trace::{Hit, Tracer};
use crate::gbuffer::ViewBuffer;
use glam::Vec2;

/// Pixels with an edge in them or within a quarter of a pixel of them. `labels` is an atlas texture
/// of class ids.
///
/// Four samples per pixel and their neighbours decide: the samples of the pixel alone would miss an
/// edge between the outermost of them and the pixel's border, which half of all edges are.
pub(super) fn pixels_at_edges(
    camera: &Camera,
    tracer: &dyn Tracer,
    mesh: &Mesh,
    labels: &Plane<u16>,
) -> Plane<bool> {
    let (w, h) = (camera.width, camera.height);
    let samples = ViewBuffer::trace(&camera.resized(2 * w, 2 * h), tracer);
    let size = Vec2::new(labels.width as f32, labels.height as f32);
    let label = |i: usize| {
        let t = samples.triangle.data[i];
        if t == Hit::MISS {
            return 0;
        }
        let (u, v) = mesh.barycentrics(t as usize, samples.position(i % (2 * w), i / (2 * w)));
        *labels.nearest(mesh.uv(t as usize, u, v) * size)
    };
    let shown = Plane {
        width: 2 * w,
        height: 2 * h,
        data: (0..4 * w * h).into_par_iter().map(label).collect(),
    };
    let clean = samples.clean_pixels(mesh, Some(&shown));
    let at_edge = |i: usize| {
        let (x, y) = (2 * (i % w), 2 * (i / w));
        [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)]
            .iter()
            .any(|at| !clean[*at])
    };
    Plane {
        width: w,
        height: h,
        data: (0..w * h).into_par_iter().map(at_edge).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::{Lens, Projection};
    use crate::core::trace::BruteForce;
    use glam::{Mat3, Vec3};

    /// A wall of two classes, left and right of x = `border`, before a pinhole camera whose pixels
    /// are 1 wide there.
    fn columns_at_edges(border: f32) -> Vec<usize> {
        let corners = |x0: f32, x1: f32| {
            [(x0, -9.0), (x1, -9.0), (x1, 9.0), (x0, 9.0)].map(|(x, y)| Vec3::new(x, y, -1.0))
        };
        let positions: Vec<Vec3> = corners(-9.0, border)
            .into_iter()
            .chain(corners(border, 9.0))
            .collect();
        let uv = |x: f32| [Vec2::splat(x); 4];
        let mesh = Mesh {
            normals: vec![Vec3::Z; 8],
            uvs: [uv(0.25), uv(0.75)].concat(),
            triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
            positions,
        };
        let labels = Plane {
            width: 2,
            height: 1,
            data: vec![1, 2],
        };
        let lens = Lens {
            fl_x: 1.0,
            fl_y: 1.0,
            cx: 4.0,
            cy: 1.5,
            k: [0.0; 2],
            p: [0.0; 2],
        };
        let projection = Projection::Pinhole(lens);
        let camera = Camera {
            projection,
            width: 8,
            height: 3,
            world_from_camera: Mat3::IDENTITY,
            position: Vec3::ZERO,
        };
        let edges = pixels_at_edges(&camera, &BruteForce::new(&mesh), &mesh, &labels);
        (0..8).filter(|&x| edges[(x, 1)]).collect()
    }

    #[test]
    fn an_edge_is_found_wherever_it_lies_in_or_beside_a_pixel() {
        // column x spans from x - 4 to x - 3 on the wall
        assert_eq!(columns_at_edges(0.5), [4], "in the middle");
        assert_eq!(
            columns_at_edges(0.1),
            [3, 4],
            "near the left border, where no sample of the pixel lies beyond"
        );
        assert_eq!(columns_at_edges(0.9), [4, 5]);
        assert_eq!(
            columns_at_edges(8.5),
            Vec::<usize>::new(),
            "outside the picture"
        );
    }
}
