//! unbake takes the light out of photographs of rooms.
//!
//! From a triangle mesh, posed HDR panoramas and semantic labels it reconstructs the albedo and
//! roughness textures of a whole indoor scene, its irradiance and radiance textures, and a `.glb`
//! that any engine can relight. The method is that of *Multi-view Inverse Rendering for
//! Large-scale Real-world Indoor Scenes* (TexIR, CVPR 2023), on CPUs, with Embree for every ray.
//!
//! What most programs need stands here at the root:
//!
//! ```no_run
//! use unbake::{LoadOptions, Progress, SaveOptions, Scene, SolveRequest, reconstruct};
//!
//! # fn main() -> unbake::Result<()> {
//! let scene = Scene::load("kitchen", &LoadOptions::default())?;
//! let options = SolveRequest::default().options(0, std::time::Instant::now());
//! let solution = reconstruct(&scene, &options, &Progress::silent())?.solution;
//! solution.save("result".as_ref(), &SaveOptions::default())?;
//! # Ok(())
//! # }
//! ```
//!
//! `examples/` has more: reading a result, relighting it, baking irradiance. The modules below are
//! public for the program's own tests, benches and examples; they are left out of this
//! documentation, and what is in them may change with any version. `docs/architecture.md` in the
//! repository says what they do.

#[doc(hidden)]
pub mod alignment;
#[doc(hidden)]
pub mod cli;
#[doc(hidden)]
pub mod core;
#[doc(hidden)]
pub mod error;
#[doc(hidden)]
pub mod ffi;
#[doc(hidden)]
pub mod gbuffer;
#[doc(hidden)]
pub mod highlight;
#[doc(hidden)]
pub mod inverse;
#[doc(hidden)]
pub mod irradiance;
#[doc(hidden)]
pub mod lights;
#[doc(hidden)]
pub mod observed;
#[doc(hidden)]
pub mod pipeline;
#[doc(hidden)]
pub mod programs;
#[doc(hidden)]
pub mod published;
#[doc(hidden)]
pub mod radiance;
#[doc(hidden)]
pub mod render;
#[doc(hidden)]
pub mod scene;
#[doc(hidden)]
pub mod solution;
#[doc(hidden)]
pub mod specular;
pub mod verdict;

pub use crate::core::geometry::{Camera, Mesh, Projection};
pub use crate::core::image::{Plane, RgbPlane};
pub use crate::core::progress::Progress;
pub use crate::programs::evaluate::{EvalOptions, Evaluation, evaluate};
pub use error::{Error, Result};
pub use pipeline::{Quality, SolveOptions, SolveRequest, Solved, reconstruct};
pub use render::{
    EditableScene, HybridOptions, HybridRenderer, Lighting, PathTracer, PathTracerOptions,
    ViewRenderer,
};
pub use scene::{LoadOptions, Scene};
pub use solution::{SaveOptions, Solution};
