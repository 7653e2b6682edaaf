//! A room of the floor plan and what builds its contents.

use super::catalogue;
use super::charts::{Builder, Finish};
use super::options::SynthOptions;
use super::pattern::Paint;
use crate::core::sampling::KeyedRng;
use glam::{Vec2, Vec3};
use std::collections::BTreeMap;

/// A room of the plan.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// x of its west wall.
    pub x: f32,
    /// Extent (x, y, z); z starts at 0.
    pub size: Vec3,
    /// 0 living room, 1 bedroom, 2 kitchen.
    pub kind: usize,
}

/// What a room's furniture occupies: no camera stands here. Low and high corner in the x-z plane.
pub type Footprint = (Vec2, Vec2);

/// Builds one room's contents: charts, paints per (room, class), footprints.
pub struct Decorator {
    /// Geometry under construction.
    pub builder: Builder,
    /// Random numbers of the room.
    pub rng: KeyedRng,
    /// Occupied floor.
    pub footprints: Vec<Footprint>,
    /// Materials of the room.
    pub paints: Vec<Paint>,
    /// Whether the room has fittings of metal.
    pub fittings: bool,
    /// Whether it has panes of glass.
    pub panes: bool,
    paint_of: BTreeMap<u16, usize>,
}

impl Decorator {
    /// An empty room of an apartment of some options.
    #[must_use]
    pub fn new(rng: KeyedRng, options: &SynthOptions) -> Self {
        Self {
            builder: Builder::new(),
            rng,
            footprints: Vec::new(),
            paints: Vec::new(),
            fittings: options.fittings,
            panes: options.panes,
            paint_of: BTreeMap::new(),
        }
    }

    /// The room's finish of a class.
    pub fn finish(&mut self, class: u16) -> Finish {
        let (paints, rng) = (&mut self.paints, &mut self.rng);
        let material = *self.paint_of.entry(class).or_insert_with(|| {
            paints.push(catalogue::paint(class, rng));
            paints.len() - 1
        });
        Finish {
            material,
            class,
            emission: Vec3::ZERO,
            metallic: catalogue::metallic(class),
            transmission: catalogue::transmission(class),
        }
    }

    /// A finish of a class with colours of its own.
    pub fn own_finish(&mut self, class: u16) -> Finish {
        self.paints.push(catalogue::paint(class, &mut self.rng));
        Finish {
            material: self.paints.len() - 1,
            class,
            emission: Vec3::ZERO,
            metallic: catalogue::metallic(class),
            transmission: catalogue::transmission(class),
        }
    }

    /// A lamp of the given radiance.
    pub fn lamp(&mut self, radiance: Vec3) -> Finish {
        Finish {
            emission: radiance,
            ..self.finish(catalogue::LAMP)
        }
    }

    /// Marks floor as occupied: local corners of an axis-aligned rectangle.
    pub fn occupy(&mut self, low: Vec2, high: Vec2) {
        let corners = [
            low,
            high,
            Vec2::new(low.x, high.y),
            Vec2::new(high.x, low.y),
        ]
        .map(|c| self.builder.world(Vec3::new(c.x, 0.0, c.y)))
        .map(|p| Vec2::new(p.x, p.z));
        let fold = |f: fn(Vec2, Vec2) -> Vec2| corners.iter().copied().fold(corners[0], f);
        self.footprints.push((fold(Vec2::min), fold(Vec2::max)));
    }

    /// Uniform in a range.
    pub fn uniform(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.rng.next_f32()
    }
}

impl Decorator {
    /// Runs `f` with the builder moved.
    pub fn builder_at(&mut self, translation: Vec3, f: impl FnOnce(&mut Self)) {
        self.builder_turned(translation, 0.0, f);
    }

    /// Runs `f` with the builder moved and turned about y.
    pub fn builder_turned(&mut self, translation: Vec3, yaw: f32, f: impl FnOnce(&mut Self)) {
        let mut builder = std::mem::take(&mut self.builder);
        builder.at(translation, yaw, |b| {
            std::mem::swap(&mut self.builder, b);
            f(self);
            std::mem::swap(&mut self.builder, b);
        });
        self.builder = builder;
    }
}
