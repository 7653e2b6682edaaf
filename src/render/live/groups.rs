//! The lights that can be changed live: the strongest lamps one by one, the weaker ones together,
//! the light from outside. Each costs a texture of direct light.

use crate::core::image::RgbPlane;
use crate::render::EditableScene;
use crate::solution::{Lamp, Solution};
use glam::Vec3;
use std::collections::BTreeSet;

/// Groups of lamps: where there are more lamps, the last group is all weaker ones. Derived: with the
/// light from outside and one for emission that no lamp lists, as many as the page has places for,
/// less a few.
pub const MOST_GROUPS: usize = 11;

/// Lights that are switched, scaled and coloured together.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LightGroup {
    /// Numbers of its lamps in `lights.json`, ascending; empty for the light from outside and for
    /// emission that belongs to no lamp.
    pub ids: Vec<usize>,
    /// Emitting triangles, ascending; empty for the light from outside.
    pub triangles: Vec<u32>,
}

impl LightGroup {
    /// Whether it is the light from outside.
    #[must_use]
    pub fn is_outside(&self) -> bool {
        self.triangles.is_empty()
    }

    fn of_lamps(lamps: &[Lamp]) -> Self {
        let mut triangles: Vec<u32> = lamps.iter().flat_map(|l| l.triangles.clone()).collect();
        triangles.sort_unstable();
        Self {
            ids: lamps.iter().map(|l| l.id).collect(),
            triangles,
        }
    }
}

fn shines(environment: &RgbPlane) -> bool {
    environment.data.iter().any(|v| *v != Vec3::ZERO)
}

/// The lights of a solution: lamps in the order of its list, then the light from outside if there is
/// any, last what emits and is no lamp.
#[must_use]
pub fn light_groups(solution: &Solution) -> Vec<LightGroup> {
    let lamps: Vec<Lamp> = solution
        .lamps
        .iter()
        .filter(|l| !l.triangles.is_empty())
        .cloned()
        .collect();
    let own = if lamps.len() <= MOST_GROUPS {
        lamps.len()
    } else {
        MOST_GROUPS - 1
    };
    let (single, together) = lamps.split_at(own);
    let mut out: Vec<LightGroup> = single
        .iter()
        .map(|l| LightGroup::of_lamps(std::slice::from_ref(l)))
        .collect();
    if !together.is_empty() {
        out.push(LightGroup::of_lamps(together));
    }
    if shines(&solution.environment) {
        out.push(LightGroup::default());
    }
    let listed: BTreeSet<u32> = lamps.iter().flat_map(|l| l.triangles.clone()).collect();
    let world = EditableScene::new(solution);
    let unlisted: Vec<u32> = (0..solution.mesh.triangles.len() as u32)
        .filter(|t| world.emits(*t as usize) && !listed.contains(t))
        .collect();
    if !unlisted.is_empty() {
        out.push(LightGroup {
            ids: Vec::new(),
            triangles: unlisted,
        });
    }
    out
}

/// The factors of a changed light on each group, by which its answer is asked for; lamps of one group
/// that are changed unlike count by their power. `None` where the change is more than factors: a
/// lamp moved or added, another panorama.
#[must_use]
pub fn factors_of(
    world: &EditableScene<'_>,
    solution: &Solution,
    groups: &[LightGroup],
) -> Option<Vec<Vec3>> {
    let other_panorama = world.environment_map().data != solution.environment.data;
    if other_panorama || !world.has_own_lamps_alone() {
        return None;
    }
    let factor = |group: &LightGroup| {
        if group.is_outside() {
            return world.environment_factor();
        }
        let (mut before, mut now) = (Vec3::ZERO, Vec3::ZERO);
        for &t in &group.triangles {
            let t = t as usize;
            let power = world.own_emission(t) * solution.mesh.area(t);
            before += power;
            now += power * world.emission_factor(t);
        }
        // a channel in which nothing shines is not changed
        let share = |b: f32, n: f32| if b > 0.0 { n / b } else { 1.0 };
        Vec3::new(
            share(before.x, now.x),
            share(before.y, now.y),
            share(before.z, now.z),
        )
    };
    Some(groups.iter().map(factor).collect())
}

/// The solution with a factor on the light of each group.
pub(super) fn lit_by<'a>(
    solution: &'a Solution,
    groups: &[LightGroup],
    factors: &[Vec3],
) -> EditableScene<'a> {
    let mut world = EditableScene::new(solution);
    for (group, &factor) in groups.iter().zip(factors) {
        if group.is_outside() {
            world.scale_environment(factor);
        } else {
            world.scale_emission(&group.triangles, factor);
        }
    }
    world
}
