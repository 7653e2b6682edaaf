//! Triangle meshes and cameras.

mod camera;
mod mesh;

pub use camera::{Camera, Lens, Projection};
pub use mesh::Mesh;
