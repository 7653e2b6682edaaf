//! unbake takes the light out of photographs of rooms.
//!
//! From a triangle mesh, posed HDR panoramas and semantic labels it reconstructs the albedo and
//! roughness textures of a whole indoor scene, its irradiance and radiance textures, and a `.glb`
//! that any engine can relight. The method is that of
//! *Multi-view Inverse Rendering for Large-scale Real-world Indoor Scenes* (TexIR, CVPR 2023), on CPUs, with Embree for every ray.

pub mod bench;
pub mod brdf;
pub mod cli;
pub mod edit;
pub mod error;
pub mod evaluate;
pub mod export;
pub mod ffi;
pub mod formats;
pub mod gbuffer;
pub mod geometry;
pub mod highlight;
pub mod image;
pub mod inverse;
pub mod irradiance;
pub mod lights;
pub mod math;
pub mod metrics;
pub mod observed;
pub mod optim;
pub mod parallel;
pub mod pipeline;
pub mod prepare;
pub mod progress;
pub mod radiance;
pub mod render;
pub mod report;
pub mod sampling;
pub mod scene;
pub mod solution;
pub mod specular;
pub mod switch;
pub mod synth;
pub mod texture;
pub mod trace;
pub mod view;

pub use error::{Error, Result};
