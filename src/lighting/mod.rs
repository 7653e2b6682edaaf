//! The light of the scene as textures: observed radiance (TBL), emitters, environment and
//! irradiance (IrT).

mod adaptive;
mod aiming;
mod bundle;
mod emitters;
mod environment;
mod filter;
mod hidden;
mod hull;
mod irt;
mod lamp_choice;
mod light_field;
mod neighbourhood;
mod nirf;
mod packed;
mod reflection;
mod screens;
mod shared_choices;
mod sources;
mod specular_bounce;
mod sweep;
mod tbl;

pub use adaptive::{Budget, bake_surface};
pub use emitters::{EmissionEvidence, EmitterSample, Emitters, detect_emissive};
pub use environment::Environment;
pub use filter::SurfaceFilter;
pub(crate) use hull::Hull;
pub(crate) use irt::spread;
pub use irt::{Bake, Estimator, Irradiance, IrtOptions, PARTS, Receiver, bake_irradiance};
pub use lamp_choice::LampChoice;
pub use light_field::LightField;
pub use neighbourhood::Patch;
pub use nirf::{Nirf, NirfCost, NirfOptions, train_nirf};
pub use reflection::{Gaze, Levels, Reflector};
pub use specular_bounce::{Glossy, SpecularBounce};
pub(crate) use tbl::prefer_clean;
pub use tbl::{Fusion, UNSEEN, fuse_radiance};
