//! Surfaces that photographs look through: their share of light, and views that look through them.
//!
//! What is found (`find_panes`) is taken out of the way of rays, and the photographs are given the light that
//! the pane kept back (`docs/lab/panes.md`). Called by the pipeline's stage `panes`.

use crate::core::brdf::BaseColour;
use crate::core::geometry::Mesh;
use crate::core::image::Plane;
use crate::core::parallel::prelude::*;
use crate::core::texture::Texels;
use crate::core::trace::{EmbreeTracer, Hit, Ray, Tracer, beyond};
use crate::gbuffer::{ObservedView, ViewBuffer};
use crate::scene::Scene;
use glam::Vec3;
use std::collections::BTreeMap;

/// Faces of one pane that a ray may pass: panes of more than double glazing tell no more.
const MOST_FACES: usize = 8;
/// Share of light, in every channel, below which a pixel says nothing of what lies behind panes. Derived: a
/// photograph's noise of a percent is a fifth there.
const LEAST_PASSED: f32 = 0.05;

/// A surface that photographs look through.
#[derive(Clone, Debug)]
pub struct Pane {
    /// Its class; 0 without labels.
    pub class: u16,
    /// Its triangles, ascending.
    pub triangles: Vec<u32>,
    /// Share of the light that is not reflected which passes one face, linear Rec. 709, [0, 1].
    pub tint: Vec3,
    /// Standard error of its luminance.
    pub tint_error: f32,
}

/// The panes of a scene, and which triangle is whose.
#[derive(Clone, Debug, Default)]
pub struct Panes {
    /// All of them.
    pub panes: Vec<Pane>,
    /// Index into `panes` by triangle.
    of_triangle: BTreeMap<u32, u32>,
}

impl Panes {
    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.panes.is_empty()
    }

    /// The pane that a triangle belongs to.
    #[must_use]
    pub fn of(&self, triangle: u32) -> Option<&Pane> {
        let index = self.of_triangle.get(&triangle)?;
        Some(&self.panes[*index as usize])
    }

    /// These panes.
    pub(super) fn new(panes: Vec<Pane>) -> Self {
        let numbered = (0..).zip(&panes);
        let of_triangle =
            numbered.flat_map(|(i, pane)| pane.triangles.iter().map(move |t| (*t, i)));
        Self {
            of_triangle: of_triangle.collect(),
            panes,
        }
    }

    /// The tracer for which panes are not there.
    ///
    /// # Errors
    /// As [`EmbreeTracer::new`].
    pub fn cleared(&self, mesh: &Mesh) -> crate::Result<EmbreeTracer> {
        EmbreeTracer::without(mesh, |t| self.of_triangle.contains_key(&t))
    }

    /// Lets a view look through the panes: what its pixels see is what lies behind them, brighter
    /// by what they kept back; where they keep back nearly all of a channel, the pixel is not used. Such a
    /// pixel may hold a reflection of the room and is not clean; its label is not that of what it sees,
    /// unless the mesh tells that.
    pub fn look_through(
        &self,
        view: &mut ObservedView,
        whole: &dyn Tracer,
        cleared: &dyn Tracer,
        scene: &Scene,
    ) {
        let behind = ViewBuffer::trace(&view.buffer.camera, cleared);
        let share = self.passed_by_pixel(&view.buffer, &scene.mesh, whole);
        let all = || share.map(|_| true);
        for (i, share) in share.data.iter().enumerate() {
            match share {
                Some(share) if share.min_element() < LEAST_PASSED => {
                    view.valid.get_or_insert_with(all).data[i] = false;
                }
                Some(share) => view.radiance.data[i] /= *share,
                None => {}
            }
        }
        if let Some(labels) = &mut view.labels {
            let size = (labels.width, labels.height);
            for (i, label) in labels.data.iter_mut().enumerate() {
                let at = (i % size.0, i / size.0);
                if share.at_pixel_of(size, at).is_some() {
                    let triangle = *behind.triangle.at_pixel_of(size, at) as usize;
                    let classes = scene.mesh_classes.as_ref();
                    let of_mesh = classes.and_then(|m| m.of_triangle.get(triangle));
                    *label = of_mesh.copied().unwrap_or(0);
                }
            }
        }
        let clean = behind.clean_pixels(&scene.mesh, view.labels.as_ref());
        for (i, was) in view.clean.data.iter_mut().enumerate() {
            *was = *was && clean.data[i] && share.data[i].is_none();
        }
        view.buffer = behind;
    }

    /// The share of light that comes through the panes before each pixel; `None` where there is
    /// none.
    fn passed_by_pixel(
        &self,
        first: &ViewBuffer,
        mesh: &Mesh,
        whole: &dyn Tracer,
    ) -> Plane<Option<Vec3>> {
        let (width, height) = (first.triangle.width, first.triangle.height);
        let mut share = Plane::filled(width, height, None);
        (share.data.par_chunks_mut(width).enumerate()).for_each(|(y, row)| {
            for (x, (share, ray)) in row.iter_mut().zip(first.row_rays(y)).enumerate() {
                let pane = self.of(first.triangle[(x, y)]);
                *share = pane.map(|_| self.passed(mesh, whole, ray));
            }
        });
        share
    }

    /// The texels of panes, ascending.
    pub fn texels<'a>(&'a self, texels: &'a Texels) -> impl Iterator<Item = (usize, &'a Pane)> {
        let points = texels.point.iter().enumerate();
        points.filter_map(|(i, p)| Some((i, self.of(p.triangle)?)))
    }

    /// The share of light that comes through all panes along a ray.
    fn passed(&self, mesh: &Mesh, tracer: &dyn Tracer, ray: Ray) -> Vec3 {
        let mut share = Vec3::ONE;
        behind(tracer, ray, |t| {
            let Some(pane) = self.of(t) else {
                return false;
            };
            let glass = BaseColour {
                colour: pane.tint,
                metallic: 0.0,
            };
            share *= glass.transmitted(1.0, cosine(mesh, t, ray.direction.into()));
            true
        });
        share
    }
}

/// Cosine between a ray and the normal of a triangle, on whichever side.
pub(super) fn cosine(mesh: &Mesh, triangle: u32, direction: Vec3) -> f32 {
    mesh.face_normal(triangle as usize).dot(direction).abs()
}

/// What a ray meets once it has passed the triangles that `passes` tells of, each asked once.
pub(super) fn behind(tracer: &dyn Tracer, ray: Ray, mut passes: impl FnMut(u32) -> bool) -> Hit {
    let mut hit = [Hit::miss()];
    let mut from = ray;
    for _ in 0..=MOST_FACES {
        tracer.closest(&[from], &mut hit);
        if !hit[0].is_hit() || !passes(hit[0].triangle) {
            return hit[0];
        }
        from = beyond(&from, &hit[0]);
    }
    Hit::miss()
}
