//! Lights: which surfaces emit, the openings through which the environment shines in (portals), and
//! how both are sampled from any point of the scene (next event estimation).

mod emission;
mod emitters;
mod grouping;
mod light_model;
mod light_sampler;
mod lit_scene;
mod portal_grid;
pub mod portals;
mod primitives;
mod reach;
mod sampler_cache;
mod shadow_rays;

pub use emission::{EmissionEvidence, detect_emissive};
pub use emitters::{EmitterSample, Emitters};
pub use light_model::LightModel;
pub use light_sampler::LightSampler;
pub use lit_scene::LitScene;
pub(crate) use portal_grid::PortalGrid;
pub(crate) use primitives::PORTAL;
pub(crate) use sampler_cache::SamplerCache;
pub(crate) use shadow_rays::{LightPicks, ShadowSample, ShadowSampler};
