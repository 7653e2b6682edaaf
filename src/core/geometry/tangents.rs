//! Tangents of a mesh, for normal maps: at each corner of a triangle the direction in which u grows,
//! by MikkTSpace (Mikkelsen, *Simulation of Wrinkled Surfaces Revisited*, 2008), which glTF names
//! and programs that bake normal maps share. Called by `solution` for exports.

use super::Mesh;
use bevy_mikktspace::{Geometry, TangentSpace};
use glam::{Vec2, Vec3, Vec4};
use std::collections::HashMap;

/// A mesh with a tangent at each vertex.
#[derive(Clone, Debug, PartialEq)]
pub struct TangentMesh {
    /// The mesh. Vertices at which tangents of several directions meet are there once for each, the
    /// copies behind all others.
    pub mesh: Mesh,
    /// Unit tangents, orthogonal to the normal; w = ±1, the bitangent w · (normal × tangent) points
    /// up in the texture, along falling v.
    pub tangents: Vec<Vec4>,
}

/// The tangents at the corners of a mesh's triangles.
struct Corners<'a> {
    mesh: &'a Mesh,
    /// In the order of the triangles.
    found: Vec<[Option<Vec4>; 3]>,
}

impl Corners<'_> {
    fn vertex(&self, face: usize, corner: usize) -> usize {
        self.mesh.triangles[face][corner] as usize
    }
}

impl Geometry for Corners<'_> {
    fn num_faces(&self) -> usize {
        self.mesh.triangles.len()
    }

    fn num_vertices_of_face(&self, _face: usize) -> usize {
        3
    }

    fn position(&self, face: usize, corner: usize) -> [f32; 3] {
        self.mesh.positions[self.vertex(face, corner)].to_array()
    }

    fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
        self.mesh.normals[self.vertex(face, corner)].to_array()
    }

    /// With v upwards, as normal maps have it, and no bit lost.
    fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
        let Vec2 { x, y } = self.mesh.uvs[self.vertex(face, corner)];
        [x, -y]
    }

    fn set_tangent(&mut self, tangent: Option<TangentSpace>, face: usize, corner: usize) {
        let tangent = tangent.map(|t| Vec4::from_array(t.tangent_encoded()));
        self.found[face][corner] = tangent;
    }
}

/// The mesh with tangents; its normals are of unit length.
#[must_use]
pub fn tangent_mesh(mesh: &Mesh) -> TangentMesh {
    let mut corners = Corners {
        mesh,
        found: vec![[None; 3]; mesh.triangles.len()],
    };
    // the crate's error has no values
    let (Ok(()) | Err(_)) = bevy_mikktspace::generate_tangents(&mut corners);
    let found = corners.found;
    let mut out = mesh.clone();
    let mut tangents: Vec<Option<Vec4>> = vec![None; mesh.positions.len()];
    let mut copies: HashMap<(u32, [u32; 4]), u32> = HashMap::new();
    for (triangle, found) in out.triangles.iter_mut().zip(&found) {
        for (corner, tangent) in triangle.iter_mut().zip(found) {
            let vertex = *corner as usize;
            let tangent = orthogonal(*tangent, mesh.normals[vertex]);
            if *tangents[vertex].get_or_insert(tangent) == tangent {
                continue;
            }
            let key = (*corner, tangent.to_array().map(f32::to_bits));
            *corner = *copies.entry(key).or_insert_with(|| {
                out.positions.push(mesh.positions[vertex]);
                out.normals.push(mesh.normals[vertex]);
                out.uvs.push(mesh.uvs[vertex]);
                tangents.push(Some(tangent));
                tangents.len() as u32 - 1
            });
        }
    }
    let tangents = tangents.iter().zip(&out.normals);
    let tangents = tangents.map(|(t, n)| t.unwrap_or_else(|| orthogonal(None, *n)));
    TangentMesh {
        tangents: tangents.collect(),
        mesh: out,
    }
}

/// The tangent, turned into the plane of the normal; where there is none (a triangle without area in
/// the atlas), one of any direction there.
fn orthogonal(tangent: Option<Vec4>, normal: Vec3) -> Vec4 {
    let normal = normal.normalize_or(Vec3::Y);
    let along = tangent.and_then(|t| {
        let direction = t.truncate().reject_from_normalized(normal);
        // shorter ones are rounding alone
        (direction.length() > 1e-3).then(|| direction.normalize())
    });
    let sign = tangent.map_or(1.0, |t| 1.0f32.copysign(t.w));
    along
        .unwrap_or_else(|| normal.any_orthonormal_vector())
        .extend(sign)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of two triangles in the plane of x and z, facing up, turned about y; its chart is
    /// mirrored or not.
    fn square(angle: f32, mirrored: bool) -> Mesh {
        let turn = glam::Quat::from_rotation_y(angle);
        let at = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
        let u = |x: f32| if mirrored { 1.0 - x } else { x };
        Mesh {
            positions: at.map(|p| turn * Vec3::new(p.x, 0.0, p.y)).to_vec(),
            normals: vec![Vec3::Y; 4],
            uvs: at.map(|p| 0.1 + 0.8 * Vec2::new(u(p.x), p.y)).to_vec(),
            triangles: vec![[0, 2, 1], [0, 3, 2]],
        }
    }

    fn valid(m: &TangentMesh) {
        assert_eq!(m.tangents.len(), m.mesh.positions.len());
        assert_eq!(m.mesh.normals.len(), m.mesh.positions.len());
        for (t, n) in m.tangents.iter().zip(&m.mesh.normals) {
            let along = t.truncate();
            assert!((along.length() - 1.0).abs() < 1e-5, "{t}");
            assert!(along.dot(*n).abs() < 1e-5, "{t} {n}");
            assert!(t.w == 1.0 || t.w == -1.0, "{t}");
        }
    }

    #[test]
    fn tangents_follow_u_and_mirrored_charts_have_the_other_sign() {
        for (mirrored, sign) in [(false, 1.0), (true, -1.0)] {
            let mesh = square(0.7, mirrored);
            let out = tangent_mesh(&mesh);
            valid(&out);
            assert_eq!(out.mesh, mesh, "nothing to part");
            let along_u = sign * (glam::Quat::from_rotation_y(0.7) * Vec3::X);
            for t in &out.tangents {
                assert!((t.truncate() - along_u).length() < 1e-5, "{t} {along_u}");
                // v falls where z falls
                let up = glam::Quat::from_rotation_y(0.7) * Vec3::NEG_Z;
                assert!((t.w * Vec3::Y.cross(t.truncate()) - up).length() < 1e-5);
                assert_eq!(t.w, sign);
            }
        }
    }

    /// Two squares that share an edge in space and in the atlas, where the second is folded back.
    #[test]
    fn a_vertex_between_a_chart_and_its_mirror_image_is_parted() {
        let mut mesh = square(0.0, false);
        mesh.positions.push(Vec3::new(2.0, 0.0, 0.0));
        mesh.positions.push(Vec3::new(2.0, 0.0, 1.0));
        mesh.normals.extend([Vec3::Y; 2]);
        mesh.uvs.extend([mesh.uvs[0], mesh.uvs[3]]);
        mesh.triangles.extend([[1, 5, 4], [1, 2, 5]]);
        let out = tangent_mesh(&mesh);
        valid(&out);
        assert_eq!(out.mesh.positions.len(), 8, "both corners of the fold");
        for (t, signs) in out.mesh.triangles.iter().zip([1.0, 1.0, -1.0, -1.0]) {
            assert!(t.iter().all(|i| out.tangents[*i as usize].w == signs));
        }
        for t in 0..4 {
            assert_eq!(out.mesh.corners(t), mesh.corners(t));
            assert_eq!(out.mesh.corner_uvs(t), mesh.corner_uvs(t));
        }
    }

    #[test]
    fn triangles_without_area_get_valid_tangents() {
        let mut mesh = square(0.0, false);
        mesh.uvs.fill(Vec2::splat(0.5));
        mesh.positions.push(Vec3::ONE); // no triangle's
        mesh.normals.push(Vec3::X);
        mesh.uvs.push(Vec2::ZERO);
        valid(&tangent_mesh(&mesh));
        mesh.positions.fill(Vec3::ZERO);
        valid(&tangent_mesh(&mesh));
        let none = tangent_mesh(&Mesh::default());
        assert!(none.tangents.is_empty());
    }
}
