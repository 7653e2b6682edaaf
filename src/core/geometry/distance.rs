//! Distances of points to the surface of a mesh, by a hierarchy of bounding boxes (crate `parry3d`).
//! Called by `export`, which states how far its coarser meshes are off.

use super::Mesh;
use glam::Vec3;
use parry3d::query::PointQuery;
use parry3d::shape::TriMesh;

/// A mesh that is asked for distances.
pub struct SurfaceDistance(Option<TriMesh>);

impl SurfaceDistance {
    /// Prepares a mesh.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        let positions = mesh.positions.iter().map(|p| p.to_array().into());
        Self(TriMesh::new(positions.collect(), mesh.triangles.clone()).ok())
    }

    /// Distance of a point to the nearest triangle, in the unit of the positions; infinite if there
    /// is none.
    #[must_use]
    pub fn to(&self, point: Vec3) -> f32 {
        self.0.as_ref().map_or(f32::INFINITY, |mesh| {
            mesh.distance_to_local_point(point.to_array().into(), false)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_to_faces_edges_and_corners() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Z],
            triangles: vec![[0, 2, 1]],
            ..Mesh::default()
        };
        let distance = SurfaceDistance::new(&mesh);
        for (p, expected) in [
            (Vec3::new(0.2, 0.5, 0.2), 0.5),
            (Vec3::new(0.2, -0.5, 0.2), 0.5),
            (Vec3::new(0.5, 0.0, -2.0), 2.0),
            (Vec3::new(-3.0, 4.0, 0.0), 5.0),
            (Vec3::new(1.0, 0.0, 1.0), 0.5f32.sqrt()),
        ] {
            assert!((distance.to(p) - expected).abs() < 1e-6, "{p}");
        }
        assert_eq!(
            SurfaceDistance::new(&Mesh::default()).to(Vec3::ZERO),
            f32::INFINITY
        );
    }
}
