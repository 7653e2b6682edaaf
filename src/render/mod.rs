//! Shading and image formation.
//!
//! * [`path_tracer`]: unbiased light transport over any [`crate::core::trace::Tracer`], in batches;
//! * the hybrid renderer: irradiance texture plus traced specular reflection;
//! * [`denoise`]: variance-guided filtering of what it renders.

mod added_lamp;
mod cameras;
pub mod denoise;
mod edges;
mod frames;
mod hybrid;
mod ies;
mod lighting_change;
mod lightmap_bake;
pub mod live;
mod options;
mod panes;
pub mod path_tracer;
mod point_light;
mod relight;
mod tone;
mod viewpoints;
mod world;

pub use added_lamp::Added;
pub use cameras::{FileCameras, NamedCamera, cameras_of_scene, read_cameras, smooth_path};
pub use hybrid::{HybridOptions, HybridRenderer, RenderedView, ViewRenderer};
pub use ies::IesProfile;
pub use lighting_change::{EnvironmentChange, LampChange, Lighting, daylight, mean_luminance};
pub use lightmap_bake::{LightmapSampling, LightmapTexels, Parts, Receiving, buried, inside};
pub use options::{FrameOptions, RenderOptions, Renderer, Show, Video, Views};
pub use path_tracer::{
    Adaptive, BlackEnvironment, Environment, Frame, IndirectCache, IrradiancePoint, KnownLight,
    Noise, PathTracer, PathTracerOptions, Surface, SurfaceModel,
};
pub use point_light::{PointLight, Shape};
pub use relight::{PathTracedScene, RelightOptions, TraceSettings};
pub use tone::{Exposure, tone_map};
pub use viewpoints::viewpoints;
pub use world::{EditableScene, LampMove};
