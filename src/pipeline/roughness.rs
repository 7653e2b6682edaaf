//! Stage "roughness": the reflection model, the roughness of every class and of the materials
//! within, and from them the roughness of every texel.

use super::decisions::{choose_rooms, report_materials, report_metals, report_model};
use super::metals::look_for_metals;
use super::usual_roughness::UsualRoughness;
use super::{Light, SolveOptions};
use crate::core::brdf::F0;
use crate::core::image::{Plane, Wrap};
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::switch::Switch;
use crate::core::texture::Texels;
use crate::highlight::Evidence;
use crate::inverse::{
    Materials, Metal, Places, SPLIT_GAIN, TexelReflectance, choose_model, fit_groups,
};
use crate::observed::Surface;
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// What is known of the surface's reflection.
pub struct Roughness {
    /// Fits per class and material.
    pub materials: Materials,
    /// Classes that are metal: without a diffuse part.
    pub metals: Vec<Metal>,
    /// What to expect of classes without evidence.
    pub usual: UsualRoughness,
    /// Room ids on the atlas.
    pub rooms: Plane<u16>,
    /// The model and the roughness per covered texel.
    pub reflectance: TexelReflectance,
}

impl Roughness {
    /// The room of every covered texel.
    #[must_use]
    pub fn texel_rooms(&self, texels: &Texels) -> Vec<u16> {
        let room = |c: &u32| self.rooms.data[*c as usize];
        texels.cell.iter().map(room).collect()
    }
}

/// Fits roughness to the evidence.
#[must_use]
pub fn fit_roughness(
    surface: &Surface,
    light: &Light,
    evidence: &Evidence,
    options: &SolveOptions,
    progress: &Progress,
) -> Roughness {
    let (model, mut fits, scores) = progress.stage("roughness", 1, |_| match options.reflectance {
        Some(model) => (model, fit_groups(evidence, model), Vec::new()),
        None => choose_model(evidence),
    });
    report_model(model, &scores, options, progress);
    let metals = if options.metals == Switch::Off || evidence.points.is_empty() {
        Vec::new()
    } else {
        let found = look_for_metals(surface, light, evidence, model, options, progress);
        report_metals(surface.scene, &found, progress);
        found
    };
    fits.retain(|f| metals.iter().all(|m| m.fit.class != f.class));
    let irradiance_at = |t: u32, p: Vec3| {
        let size = Vec2::new(
            light.irradiance.width as f32,
            light.irradiance.height as f32,
        );
        light
            .irradiance
            .bilinear(surface.uv_at(t, p) * size, Wrap::Clamp)
    };
    let rooms = rooms_of(surface, options, progress);
    let places = Places {
        irradiance: &irradiance_at,
        room: &|t, p| surface.nearest(&rooms, t, p),
    };
    let materials = progress
        .stage("materials", 1, |_| match options.divide {
            Switch::Off => Materials::undivided(fits),
            Switch::Auto => Materials::find(evidence, fits, model, &places, SPLIT_GAIN),
            Switch::On => Materials::find(evidence, fits, model, &places, f64::NEG_INFINITY),
        })
        .with(metals.iter().map(|m| m.fit.clone()));
    report_materials(surface.scene, &materials, options, progress);
    let usual = UsualRoughness::of(surface.scene, &materials);
    let roughness = first_albedo(surface, light)
        .into_par_iter()
        .enumerate()
        .map(|(i, colour)| {
            let colour = (surface.fusion.views[i] > 0).then_some(colour);
            let room = rooms.data[surface.texels.cell[i] as usize];
            let position = surface.texels.position(&surface.scene.mesh, i);
            materials
                .roughness(surface.labels[i], room, colour, position)
                .map_or_else(|| usual.of_class(surface.labels[i]), |r| r.0)
        })
        .collect();
    Roughness {
        materials,
        metals,
        usual,
        rooms,
        reflectance: TexelReflectance::new(model, roughness),
    }
}

/// A first guess of the albedo of every covered texel: of what it reflects, a dielectric's share at
/// normal incidence is specular.
fn first_albedo(surface: &Surface, light: &Light) -> Vec<Vec3> {
    let albedo = |i: usize| {
        let e = surface
            .texels
            .lookup(&surface.scene.mesh, &light.irradiance, i);
        surface.fusion.radiance[i] * PI / e.max(Vec3::splat(1e-12)) - F0 as f32
    };
    (0..surface.texels.len())
        .into_par_iter()
        .map(albedo)
        .collect()
}

/// Room ids per texel: the scene's own grid, or the rooms found in the mesh.
pub(super) fn rooms_of(
    surface: &Surface,
    options: &SolveOptions,
    progress: &Progress,
) -> Plane<u16> {
    let scene = surface.scene;
    let Some(grid) = choose_rooms(scene, &surface.tracer, options, progress) else {
        return surface.texels.scatter(&vec![1; surface.texels.len()], 0);
    };
    let rooms: Vec<u16> = (0..surface.texels.len())
        .into_par_iter()
        .map(|i| {
            let p = surface.texels.point[i];
            let (_, face_normal) = surface.normals(p.triangle as usize, p.u, p.v);
            grid.room_of_surface(surface.texels.position(&scene.mesh, i), face_normal)
        })
        .collect();
    surface.texels.scatter(&rooms, 0)
}
