//! The irradiance texture (IrT): baking, adaptive sampling and filtering over the surface; and the
//! paper's neural alternative (NIrF).

mod adaptive;
mod bake;
mod estimate;
mod hilbert_order;
mod next_bounce;
mod nirf;
mod occluded_pairs;
mod ray_batch;
mod surface_filter;
mod surfel_grid;
mod surfel_visibility;

pub use adaptive::{SampleBudget, bake_surface};
pub use bake::bake_irradiance;
pub(crate) use estimate::spread;
pub use estimate::{Bake, Estimator, Irradiance, IrradianceOptions, Receiver, SUB_ESTIMATES};
pub use next_bounce::{Glossy, NextBounce};
pub use nirf::{Nirf, NirfCost, NirfOptions, train_nirf};
pub use surface_filter::SurfaceFilter;
pub use surfel_grid::Surfel;
