//! Which surface points carry evidence about roughness.
//!
//! A pixel is a virtual highlight if a mirror there would show something much brighter than the
//! surface itself (the paper's VHL with a scale-free threshold, method §6). Per class the strongest
//! ones are kept beside evenly spread ones: highlights fix the roughness, ordinary points keep the
//! answer honest.

use crate::core::brdf::fresnel;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::sampling::hash_u64;
use crate::core::trace::{Hit, Ray};
use crate::lights::LitScene;
use crate::observed::{ClassMap, Surface};
use glam::Vec3;
use std::collections::{BTreeMap, BTreeSet};

/// How many points are selected.
#[derive(Clone, Debug)]
pub struct SelectOptions {
    /// Pixels between candidates along rows and columns; every pixel is one for classes too rare to
    /// fill their places.
    pub stride: usize,
    /// Evenly spread points per class.
    pub even: usize,
    /// Highlight points per class.
    pub highlights: usize,
    /// Seed.
    pub seed: u64,
}

/// A surface point seen at a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Triangle.
    pub triangle: u32,
    /// Position.
    pub position: Vec3,
    /// Class id.
    pub class: u16,
    /// Mirrored light over own radiance: how much of a highlight this pixel would be.
    pub strength: f32,
    order: u64,
}

impl Candidate {
    /// A point that was selected otherwise.
    #[must_use]
    pub fn at(triangle: u32, position: Vec3, class: u16) -> Self {
        Self {
            triangle,
            position,
            class,
            strength: 0.0,
            order: 0,
        }
    }
}

/// Selects points per class; surfaces without material (emitters) have none.
#[must_use]
pub fn select_points(
    lit: &LitScene,
    surface: &Surface,
    classes: &ClassMap,
    options: &SelectOptions,
) -> Vec<Candidate> {
    let search = Search {
        lit,
        surface,
        classes,
    };
    let by_class = |common: &BTreeSet<u16>, options: &SelectOptions| {
        let per_view: Vec<Vec<Candidate>> = (0..surface.views.len())
            .into_par_iter()
            .map(|i| search.candidates(i, common, options))
            .collect();
        let mut classes: BTreeMap<u16, Vec<Candidate>> = BTreeMap::new();
        for c in per_view.into_iter().flatten() {
            classes.entry(c.class).or_default().push(c);
        }
        classes
    };
    let mut classes = by_class(&BTreeSet::new(), options);
    let enough = options.even + options.highlights;
    let common: BTreeSet<u16> = classes
        .iter()
        .filter(|(_, c)| c.len() >= enough)
        .map(|(class, _)| *class)
        .collect();
    classes.extend(by_class(
        &common,
        &SelectOptions {
            stride: 1,
            ..*options
        },
    ));
    let of_class = |(_, mut members): (u16, Vec<Candidate>)| {
        // a keyed shuffle, then evenly spread points first
        members.sort_by_key(|c| c.order);
        let even = options.even.min(members.len());
        let mut rest = members.split_off(even);
        rest.retain(|c| c.strength > 0.05);
        rest.sort_by(|a, b| {
            b.strength
                .min(2.0)
                .total_cmp(&a.strength.min(2.0))
                .then(a.order.cmp(&b.order))
        });
        rest.truncate(options.highlights);
        members.extend(rest);
        members
    };
    let classes: Vec<(u16, Vec<Candidate>)> = classes.into_iter().collect();
    let classes = classes.into_par_iter().with_max_len(1);
    classes.flat_map_iter(of_class).collect()
}

/// What candidates are searched with.
struct Search<'a> {
    lit: &'a LitScene<'a>,
    surface: &'a Surface<'a>,
    classes: &'a ClassMap<'a>,
}

impl Search<'_> {
    /// The candidates of one view in all classes but the `common` ones.
    fn candidates(
        &self,
        index: usize,
        common: &BTreeSet<u16>,
        options: &SelectOptions,
    ) -> Vec<Candidate> {
        let (lit, view) = (self.lit, &self.surface.views[index]);
        let b = &view.buffer;
        let (w, h) = (b.triangle.width, b.triangle.height);
        let stride = options.stride.max(1);
        let mut found = Vec::new();
        let mut rays = Vec::new();
        let mut kept: Vec<(Candidate, f32, f32)> = Vec::new();
        for y in (index % stride..h).step_by(stride) {
            rays.clear();
            kept.clear();
            for x in (0..w).step_by(stride) {
                let t = b.triangle[(x, y)];
                let valid = view.valid.as_ref().is_none_or(|v| v[(x, y)]);
                // (a highlight may have clipped it)
                let bound = || self.surface.is_clean_bound(index, y * w + x);
                if t == Hit::MISS || !(view.clean[(x, y)] && valid || bound()) {
                    continue;
                }
                let d = b.direction(x, y);
                let position = b.camera.position + d * b.distance[(x, y)];
                let (n, face) = self.surface.normals_at(t, position);
                let n_v = -n.dot(d);
                let own_class = self.classes.material(t, position);
                let Some(own_class) = own_class
                    .filter(|c| !common.contains(c))
                    .filter(|_| n_v > 0.05 && face.dot(d) < 0.0)
                else {
                    continue;
                };
                let mirror = d + n * (2.0 * n_v);
                let order = hash_u64(options.seed, hash_u64(index as u64, (y * w + x) as u64));
                rays.push(Ray::new(
                    position + face * lit.offset,
                    mirror,
                    f32::INFINITY,
                ));
                let c = Candidate {
                    triangle: t,
                    position,
                    class: own_class,
                    strength: 0.0,
                    order,
                };
                kept.push((c, n_v, luminance(view.radiance[(x, y)])));
            }
            let mut hits = vec![Hit::miss(); rays.len()];
            lit.tracer.closest(&rays, &mut hits);
            for (k, (mut c, n_v, own)) in kept.iter().copied().enumerate() {
                let mirrored = luminance(lit.field.arriving(
                    &hits[k],
                    Vec3::from_array(rays[k].direction),
                    0.05,
                ));
                c.strength = fresnel(n_v) * mirrored / own.max(1e-12);
                found.push(c);
            }
        }
        found
    }
}
