//! Texture-space differentiable rendering (Nimier-David et al., EGSR 2021, "Material and Lighting
//! Reconstruction for Complex Indoor Scenes with Texture-space Differentiable Rendering"): albedo,
//! roughness and emission textures descend the gradient of a path tracer. A step draws places on
//! the textures, not pixels, so that every part of the surface learns alike; each is seen by one of
//! the views that see it. Residuals and gradients have paths of their own (method §12.2, W2).
//!
//! Emission is learned as a factor on the light texture's lamps; which surfaces are lamps is given,
//! as there. The authors' regularisers are not reproduced.

use super::descent::Descent;
use super::learned_texture::LearnedTexture;
use super::paths::{Look, PathScene, Slope, Textures, VERTICES};
use super::stages::Sides;
use super::strategy::Loss;
use crate::core::parallel::map_chunks;
use crate::core::sampling::{KeyedRng, hash_u64};
use crate::core::texture::Texels;
use crate::observed::Surface;

/// Paths of a place, for its residual and again for its gradient.
const SAMPLES: usize = 4;
/// Places that are traced together: 2,048 paths, so that one foreign call carries many.
const CHUNK: usize = 512;
/// Step of Adam: that of the published textures, which start from the same values (method §7).
const RATE: f32 = 0.03;
/// Values that the textures start from: grey, neither smooth nor rough.
const FIRST_ALBEDO: f32 = 0.5;
const FIRST_ROUGHNESS: f32 = 0.5;
/// Range of roughness.
const ROUGHNESS: (f32, f32) = (0.01, 1.0);

/// A reconstruction under way.
pub struct Tsdr<'a> {
    surface: &'a Surface<'a>,
    scene: PathScene<'a>,
    texels: Texels,
    /// Factor from the photographs' units to those of the losses.
    exposure: f32,
    places: usize,
    /// What is learned.
    pub textures: Textures,
    looks: u64,
}

impl<'a> Tsdr<'a> {
    /// `places` are drawn in each visit.
    #[must_use]
    pub fn new(
        surface: &'a Surface<'a>,
        scene: PathScene<'a>,
        exposure: f32,
        places: usize,
        sides: Sides,
    ) -> Self {
        Self {
            texels: Texels::rasterize(&surface.scene.mesh, sides.albedo, sides.albedo),
            surface,
            scene,
            exposure,
            places,
            textures: Textures {
                albedo: LearnedTexture::filled(sides.albedo, [FIRST_ALBEDO; 3]),
                roughness: LearnedTexture::filled(sides.roughness, [FIRST_ROUGHNESS]),
                gain: LearnedTexture::filled(sides.albedo, [1.0; 3]),
            },
            looks: 0,
        }
    }

    /// Rays traced, at most: a path has two at each of its vertices.
    #[must_use]
    pub fn rays(&self) -> u64 {
        self.looks * (2 * SAMPLES * 2 * VERTICES) as u64
    }

    /// Places of the textures, each in one view; those that no view sees are left out.
    fn draw(&self, key: u64) -> Vec<Look> {
        let observer = self.surface.observer();
        let parts = map_chunks(self.places, CHUNK, |range| {
            let mut seen = Vec::new();
            let look = |i: usize| {
                let mut rng = KeyedRng::new(key, i as u64);
                let texel = rng.below(self.texels.len());
                let point = self.texels.point[texel];
                let position = self.texels.position(&self.surface.scene.mesh, texel);
                let (_, face_normal) =
                    self.surface
                        .normals(point.triangle as usize, point.u, point.v);
                observer.observe(position, face_normal, &mut seen);
                if seen.is_empty() {
                    return None;
                }
                let observed = &seen[rng.below(seen.len())];
                let camera = &observer.views[observed.view as usize].buffer.camera;
                Some(Look {
                    place: point,
                    to_camera: (camera.position - position).normalize(),
                    radiance: observed.radiance * self.exposure,
                })
            };
            range.filter_map(look).collect::<Vec<Look>>()
        });
        parts.concat()
    }

    /// Slopes of the mean loss over some places, by which all textures are changed.
    fn slopes(&self, looks: &[Look], first: usize, share: f32, key: u64) -> Vec<Slope> {
        let trace = |purpose: u64| {
            let key = hash_u64(key, purpose);
            self.scene.trace(looks, SAMPLES, &self.textures, key, first)
        };
        let (shown, followed) = (trace(1), trace(2));
        let mut out = Vec::new();
        for (i, look) in looks.iter().enumerate() {
            let paths = i * SAMPLES..(i + 1) * SAMPLES;
            let sum: glam::Vec3 = shown[paths.clone()]
                .iter()
                .map(|p| p.radiance(&self.textures))
                .sum();
            let slope = Loss::Absolute.slope(sum / SAMPLES as f32, look.radiance);
            for path in &followed[paths] {
                path.adjoint(&self.textures, slope * share / SAMPLES as f32, &mut out);
            }
        }
        out
    }
}

impl Descent for Tsdr<'_> {
    fn visit(&mut self, _: usize, key: u64) {
        if self.texels.is_empty() {
            return;
        }
        let looks = self.draw(key);
        let share = 1.0 / (3.0 * looks.len().max(1) as f32);
        let parts = map_chunks(looks.len(), CHUNK, |range| {
            self.slopes(&looks[range.clone()], range.start, share, key)
        });
        for slope in parts.iter().flatten() {
            self.textures.add(slope);
        }
        self.textures.albedo.step(RATE, 0.0, 1.0);
        self.textures.roughness.step(RATE, ROUGHNESS.0, ROUGHNESS.1);
        self.textures.gain.step(RATE, 0.0, f32::INFINITY);
        self.looks += looks.len() as u64;
    }
}
