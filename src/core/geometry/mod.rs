//! Triangle meshes and cameras.

mod camera;
mod clusters;
mod copies;
mod distance;
mod mesh;
mod shells;
mod tangents;

pub use camera::{Camera, DirectionGrid, Lens, Projection};
pub use clusters::{bodies, charts, clusters, numbered, pieces, smooth_patches, touching};
pub use copies::{MeshCopy, Similarity, copies};
pub use distance::SurfaceDistance;
#[cfg(test)]
pub(crate) use mesh::tests::add_box;
pub use mesh::{BOX_SIDES, Mesh, bounds, box_corners, triangle_normal, vector_key};
pub use shells::{Neighbour, Shells};
pub use tangents::{TangentMesh, tangent_mesh};

/// Normals closer than this cosine belong to one smooth surface, whose points see nearly the same light.
pub const SMOOTH: f32 = 0.95;
