//! Live relighting: the irradiance of a whole scene under changed lamps and changed colours of its
//! classes, bounces included, within milliseconds.
//!
//! Light transport is linear in the lights and a Neumann series in the reflectances (Goral et al.
//! 1984, "Modeling the Interaction of Light Between Diffuse Surfaces"):
//!
//! E = D + F ρ E,  D = Σ s_k D_k
//!
//! * `groups`: the lights k that can be changed, their factors s_k;
//! * `direct`: D_k, the direct light of each on the texels of an atlas, path traced and filtered;
//! * `patches`: surface patches of one class each, and the reflectance ρ of each;
//! * `links`: the patches that every texel sees, by cosine-distributed rays: a final gather
//!   (Reichert 1992) as a matrix; summed over the texels of a patch they are the form factors F;
//! * `radiosity`: the bounces between patches, iterated to a stated remainder;
//! * `operator`: an edit's answer, exact where nothing is changed;
//! * `error`: how far answers lie from the path tracer's, measured when an operator is built;
//! * `store`: the operator beside the result, in a file that is there whole or not at all.
//!
//! `view` answers its page with it, `relight --preview` renders with it.

mod direct;
mod error;
mod groups;
mod links;
mod operator;
mod patches;
mod radiosity;
mod store;
#[cfg(test)]
mod tests;

pub use groups::{LightGroup, factors_of, light_groups};
pub use operator::{Answer, EditError, LightEdit, LiveLight};
pub use store::{OPERATOR, open_or_build};
