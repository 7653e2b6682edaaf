//! Triangle meshes and cameras.

mod camera;
mod clusters;
mod mesh;
mod shells;

pub use camera::{Camera, Lens, Projection};
pub use clusters::{clusters, pieces, touching};
pub use mesh::Mesh;
pub use shells::{Neighbour, Shells};
