//! Specular reflection of the light field: at surface points ([`Reflector`]), along the rays of an
//! irradiance bake ([`SpecularBounce`]), and its directional average ([`DirectionalAlbedo`]).

mod directional_albedo;
mod images;
mod reflector;
mod specular_bounce;

pub use directional_albedo::{DirectionalAlbedo, WIDE};
pub use images::{SpecularImages, TracedImage, WideRule};
pub use reflector::{Levels, Reflector, ShadingPoint};
pub(crate) use specular_bounce::Bounces;
pub use specular_bounce::{Glossy, SpecularBounce};
