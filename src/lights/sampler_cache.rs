//! Choices of lamps that points share which lie close together: finding one costs as much as a few
//! samples of it.

use super::{Emitters, LightSampler};
use glam::Vec3;
use std::ops::Index;

/// The choices of a list of points, in memory that later lists use again.
#[derive(Default)]
pub(crate) struct SamplerCache {
    /// The first `count` are of this list.
    choices: Vec<LightSampler>,
    count: usize,
    /// Whom the last one was made for: position, unit normal.
    last: Option<(Vec3, Vec3)>,
}

impl SamplerCache {
    /// Begins another list.
    pub(crate) fn clear(&mut self) {
        (self.count, self.last) = (0, None);
    }

    /// How many choices the list has.
    pub(crate) fn len(&self) -> usize {
        self.count
    }

    /// The number of the choice that suits the next point of the list ([`Emitters::choose`]): the
    /// last one if it was made close by, else a new one.
    pub(crate) fn choose(
        &mut self,
        emitters: &Emitters,
        p: Vec3,
        normal: Vec3,
        rays: f32,
    ) -> usize {
        let place = (p, normal);
        if self.last.is_none_or(|last| !emitters.alike([last, place])) {
            self.choices.resize_with(
                self.choices.len().max(self.count + 1),
                LightSampler::default,
            );
            emitters.choose(p, normal, rays, &mut self.choices[self.count]);
            (self.count, self.last) = (self.count + 1, Some(place));
        }
        self.count - 1
    }
}

impl Index<usize> for SamplerCache {
    type Output = LightSampler;

    fn index(&self, number: usize) -> &LightSampler {
        &self.choices[number]
    }
}
