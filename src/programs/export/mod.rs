//! Files that other programs open.

mod area_light;
mod frames;
mod hulls;
mod job;
mod levels;
mod light_mix;
mod lightings;
mod mitsuba;
mod object_atlas;
mod objects;
mod punctual;
mod save;
mod usd;
mod usd_collision;
mod usd_lights;
mod usd_text;
mod usd_variants;
mod variants;

pub use area_light::{AreaLight, LightShape, area_lights};
pub use frames::FrameWriter;
pub use hulls::{Hull, ObjectHulls, collision_glb, object_hulls};
pub use job::{ExportOptions, Exported, Format, camera_file, export};
pub use lightings::{Lightings, NamedLighting};
pub use mitsuba::write_mitsuba;
pub use object_atlas::{AtlasKind, cut_out};
pub use objects::{ClassName, Split, objects};
pub use punctual::punctual_lights;
pub use usd::{UsdOptions, write_usd};
pub use variants::{LightmapRecord, Variant, VariantLamp, VariantList, export_lightings};
