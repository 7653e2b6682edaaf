//! Options of the path tracer.

/// Settings of the path tracer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathTracerOptions {
    /// Samples per pixel.
    pub samples: u32,
    /// Surface interactions after which a path ends for certain; Russian roulette ends most long
    /// before.
    pub max_bounces: u32,
    /// First bounce at which Russian roulette may end a path.
    pub roulette_from: u32,
    /// Seed of all numbers.
    pub seed: u64,
    /// Leave out the specular lobe (tests, furnace).
    pub lambertian: bool,
    /// Shade with the triangles' own normals (comparison with renderers that treat smooth normals
    /// otherwise).
    pub flat: bool,
    /// Largest luminance a single indirect contribution may have; biased, off by default.
    pub clamp: Option<f32>,
}

impl Default for PathTracerOptions {
    fn default() -> Self {
        Self {
            samples: 64,
            max_bounces: 64,
            roulette_from: 3,
            seed: 0,
            lambertian: false,
            flat: false,
            clamp: None,
        }
    }
}

/// When [`super::PathTracer::render_adaptive`] is content.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// Samples every pixel gets at least.
    pub first: u32,
    /// Samples no pixel exceeds.
    pub most: u32,
    /// Standard error, relative to the local brightness, at which a block of pixels is done.
    pub error: f32,
    /// Of what.
    pub noise: Noise,
}

/// The part of the light whose standard error [`Adaptive`] watches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Noise {
    /// All that surfaces reflect.
    Reflected,
    /// The specular lobe's part alone; samples after the first pass follow no other.
    Specular,
}
