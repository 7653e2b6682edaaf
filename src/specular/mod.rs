//! Specular reflection of the light field: at surface points ([`Reflector`]), in images, and its
//! directional average ([`DirectionalAlbedo`]).

mod directional_albedo;
mod images;
mod reflector;

pub use directional_albedo::{DirectionalAlbedo, WIDE, under_even_light};
pub use images::{SpecularImages, TracedImage, WideRule};
pub use reflector::{Levels, Own, Reflector, ShadingPoint};
