//! How far an operator's answers lie from the path tracer's: random edits, path traced at surface
//! points that had no part in building the operator.

use super::groups::{LightGroup, lit_by};
use super::operator::{EditError, LightEdit, LiveLight};
use crate::core::brdf::Reflectance;
use crate::core::math::luminance;
use crate::core::progress::Progress;
use crate::core::sampling::KeyedRng;
use crate::core::stats::median;
use crate::core::trace::Tracer;
use crate::render::{
    EditableScene, IrradiancePoint, LightmapTexels, PathTracer, PathTracerOptions, Surface,
    SurfaceModel,
};
use crate::solution::Solution;
use glam::Vec3;
use std::collections::{BTreeMap, BTreeSet};

/// Random edits, and points at which each is path traced.
/// Derived: the figure's own error is about 1/√(2 · edits · points), 2 %.
const EDITS: usize = 3;
/// Derived: as above.
const POINTS: usize = 384;
/// Paths per point in each of two halves, whose difference tells the reference's noise.
/// Derived: that noise is taken off the figure; this many keep it below what is measured.
const PATHS: u32 = 128;

/// Surfaces whose classes have other colours.
pub(super) struct Recoloured<'a, 's> {
    pub(super) scene: &'a EditableScene<'s>,
    pub(super) solution: &'s Solution,
    pub(super) classes: &'a BTreeMap<u16, Vec3>,
}

impl SurfaceModel for Recoloured<'_, '_> {
    fn surface(&self, triangle: usize, u: f32, v: f32) -> Surface {
        let mut surface = self.scene.surface(triangle, u, v);
        if triangle < self.solution.mesh.triangles.len() {
            let class = self
                .solution
                .class_at(self.solution.mesh.uv(triangle, u, v));
            if let Some(factor) = self.classes.get(&class) {
                let colour = surface.base.colour * *factor;
                surface.base.colour = colour.clamp(Vec3::ZERO, Vec3::ONE);
            }
        }
        surface
    }

    fn mean_emission(&self, triangle: usize) -> Vec3 {
        self.scene.mean_emission(triangle)
    }

    fn label(&self, triangle: usize) -> u16 {
        self.scene.label(triangle)
    }

    fn has_panes(&self) -> bool {
        self.scene.has_panes()
    }

    fn reflectance(&self) -> Reflectance {
        self.scene.reflectance()
    }

    fn emits_forward_only(&self, triangle: usize) -> bool {
        self.scene.emits_forward_only(triangle)
    }
}

/// What answers are compared with.
pub(super) struct Reference<'a> {
    pub(super) solution: &'a Solution,
    pub(super) texels: &'a LightmapTexels<'a>,
    pub(super) groups: &'a [LightGroup],
    pub(super) tracer: &'a dyn Tracer,
}

impl Reference<'_> {
    /// Irradiance of texels under an edit, path traced.
    pub(super) fn irradiance(
        &self,
        edit: &LightEdit,
        chosen: &[usize],
        paths: u32,
        key: u64,
    ) -> Vec<Vec3> {
        let world = lit_by(self.solution, self.groups, &edit.lights);
        let surfaces = Recoloured {
            scene: &world,
            solution: self.solution,
            classes: &edit.classes,
        };
        let options = PathTracerOptions::default();
        let mesh = &self.solution.mesh;
        let renderer = PathTracer::new(mesh, self.tracer, &surfaces, &world, options);
        let points: Vec<IrradiancePoint> =
            chosen.iter().map(|&i| self.texels.points()[i]).collect();
        renderer.irradiance(&points, paths, key, &Progress::silent())
    }

    /// An edit of every group, some switched off, and of every other class.
    fn random_edit(&self, number: u64) -> LightEdit {
        let mut random = KeyedRng::new(0x6564_6974, number);
        let mut colour = |low: f32, high: f32| {
            Vec3::from_array(std::array::from_fn(|_| {
                low + (high - low) * random.next_f32()
            }))
        };
        let mut lights: Vec<Vec3> = self.groups.iter().map(|_| colour(0.0, 2.0)).collect();
        let count = lights.len().max(1);
        // switch some off, never all
        for (k, light) in lights.iter_mut().enumerate() {
            if (k + number as usize) % count.min(3) == 1 {
                *light = Vec3::ZERO;
            }
        }
        let labels: BTreeSet<u16> = self.solution.labels.data.iter().copied().collect();
        let classes = labels
            .into_iter()
            .filter(|c| (u64::from(*c) + number).is_multiple_of(2))
            .map(|c| (c, colour(0.3, 1.2)))
            .collect();
        LightEdit { lights, classes }
    }

    /// Compares random edits.
    pub(super) fn error(&self, live: &LiveLight) -> EditError {
        let inside: Vec<usize> = (0..self.texels.points().len())
            .filter(|&i| self.texels.texels().interior[i] && live.is_open(i))
            .collect();
        if inside.is_empty() || self.groups.is_empty() {
            return EditError::default();
        }
        let (mut square, mut answered, mut modelled) = (0.0f64, 0.0f64, 0.0f64);
        let mut shares = Vec::with_capacity(EDITS * POINTS);
        for number in 0..EDITS as u64 {
            let edit = self.random_edit(number);
            let mut random = KeyedRng::new(0x706f_696e, number);
            let chosen: Vec<usize> = (0..POINTS)
                .map(|_| inside[random.below(inside.len())])
                .collect();
            let key = 2 * number + 1;
            let halves = [key, key + 1].map(|k| self.irradiance(&edit, &chosen, PATHS, k));
            let (answer, model) = (live.answer(&edit), live.modelled(&edit));
            for (k, &i) in chosen.iter().enumerate() {
                let [a, b] = [0, 1].map(|h: usize| f64::from(luminance(halves[h][k])));
                let off = |e: Vec3| {
                    let e = f64::from(luminance(e));
                    // unbiased: the halves' noise is independent
                    (e - a) * (e - b)
                };
                square += a * b;
                answered += off(answer.irradiance[i]);
                modelled += off(model.irradiance[i]);
                let mean = 0.5 * (a + b);
                let away = (f64::from(luminance(answer.irradiance[i])) - mean).abs();
                shares.push(if away > 0.0 { away / mean } else { 0.0 } as f32);
            }
        }
        let root = |x: f64| {
            if square > 0.0 {
                (x.max(0.0) / square).sqrt() as f32
            } else {
                0.0
            }
        };
        EditError {
            relative: root(answered),
            model: root(modelled),
            median: median(shares).unwrap_or(0.0),
        }
    }
}
