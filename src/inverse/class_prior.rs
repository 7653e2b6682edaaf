//! What a texel's albedo should be expected to be before it is looked at: that of its class nearby.

use super::AlbedoEstimate;
use crate::core::geometry::{Mesh, bodies};
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::{ENOUGH, MAD_SCALE, MANY, median, step_over_many, weighted_median};
use crate::core::texture::Texels;
use glam::{DVec3, IVec3, Vec3};
use std::collections::BTreeMap;

/// Least relative standard deviation of an albedo, and of a pixel that albedos explain: irradiance, specular part and
/// camera err by as much. What lies nearer together is one colour.
/// Measured: ×½ albedo within two errors −4 %, ×2 views +0.2 dB (docs/constants.md).
pub(super) const LEAST_SPREAD: f32 = 0.05;
/// Standard deviation of the prior where there is no class, or nothing of it is seen clean: no albedo is less certain,
/// and views that disagree by more tell nothing of a surface.
/// Measured: ×½ albedo −0.1 dB, ×2 albedo +0.2 dB (docs/constants.md).
pub(super) const ANYTHING: f32 = 0.3;

/// Share of a surface from which a part of it is no accident. Derived: what lies beyond two standard errors to one side.
pub(super) const LEAST_SHARE: f32 = 0.023;
/// Side of the cubes, in texels, within which texels count as near. Derived: a square of twice as much, which the eight
/// cubes around a texel cut out of its plane, holds [`MANY`].
pub(super) const NEAR: f32 = (1 << (MANY.ilog2() / 2)) as f32 / 2.0;
/// How many clean texels there outweigh the class.
pub(super) const ENOUGH_NEAR: f32 = ENOUGH as f32;

/// The atlas that texels lie on.
#[derive(Clone, Copy)]
pub struct Ground<'a> {
    /// Covered texels.
    pub texels: &'a Texels,
    /// The mesh they lie on.
    pub mesh: &'a Mesh,
    /// Class per texel.
    pub labels: &'a [u16],
    /// Room per texel.
    pub rooms: &'a [u16],
}

impl Ground<'_> {
    /// Class and room of each texel.
    fn places(&self) -> Vec<Place> {
        (self.labels.iter().copied())
            .zip(self.rooms.iter().copied())
            .collect()
    }
}

/// What an albedo should be expected to be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected {
    pub(super) mean: Vec3,
    /// Variance of its luminance.
    pub(super) variance: f32,
}

/// Mean albedo and its variance from the clean texels of a texel's class: those nearby of its own
/// body of the mesh, as far as they are frontal, sharp and not far from what is usual there; those
/// nearby of any body where these are few, then the class in its room as a whole, and in all rooms
/// where its room shows none. `nearby` is the share of what is nearby beside the class in its room.
pub(super) fn class_prior(
    albedo: &AlbedoEstimate,
    ground: &Ground<'_>,
    ids: &[u32],
    nearby: &(dyn Fn(usize) -> f32 + Sync),
) -> Vec<Expected> {
    let (texels, mesh) = (ground.texels, ground.mesh);
    let places = &ground.places()[..];
    let clean = CleanTexels::of(albedo, texels.len());
    let class = clean.typical_by(|i| places[i]);
    let anywhere = clean.typical_by(|i| places[i].0);
    let usual_of = |i: usize| {
        let own = class.get(&places[i]);
        own.or_else(|| anywhere.get(&places[i].0))
    };
    let all = clean.typical(&clean.ids);
    let body = bodies(mesh);
    let of_body: Vec<(Place, u32)> = (texels.point.iter().zip(places))
        .map(|(point, place)| (*place, body[point.triangle as usize]))
        .collect();
    let cubes = Cubes::over(&clean, texels, mesh, places);
    let near = cubes.sums(&clean, &class);
    let own_cubes = Cubes {
        places: &of_body[..],
        texels,
        mesh,
        edge: cubes.edge,
    };
    let own = own_cubes.sums(&clean, &clean.typical_by(|i| of_body[i]));
    ids.par_iter()
        .map(|&i| {
            let i = i as usize;
            let Some(usual) = usual_of(i).filter(|_| places[i].0 != 0) else {
                return Expected {
                    mean: if albedo.error[i].is_finite() {
                        clean.value(i)
                    } else {
                        all.mean
                    },
                    variance: ANYTHING * ANYTHING,
                };
            };
            let share = nearby(i);
            let any_body = cubes.sums_around(&near, i).beside(usual, share);
            own_cubes.sums_around(&own, i).beside(&any_body, share)
        })
        .collect()
}

/// The texels that a prior is made of: seen clean.
struct CleanTexels<'a> {
    albedo: &'a AlbedoEstimate,
    /// A regular subset of them, where they are many.
    ids: Vec<usize>,
    /// Their median footprint, metres: a wide one is a distant or a slanting look.
    sharp: f32,
}

impl<'a> CleanTexels<'a> {
    fn of(albedo: &'a AlbedoEstimate, count: usize) -> Self {
        let stride = (count / 2_000_000).max(1);
        let ids: Vec<usize> = (0..count)
            .step_by(stride)
            .filter(|&i| albedo.clean[i] && albedo.error[i].is_finite())
            .collect();
        let sharp = median(ids.iter().map(|&i| albedo.footprint[i]).collect()).unwrap_or(1.0);
        Self { albedo, ids, sharp }
    }

    fn value(&self, i: usize) -> Vec3 {
        self.albedo.value[i].clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// Weight of a texel: less than 1 for a blurred look.
    fn trust(&self, i: usize) -> f32 {
        (self.sharp / self.albedo.footprint[i].max(f32::MIN_POSITIVE))
            .powi(2)
            .min(1.0)
    }

    /// [`Self::typical`] of the texels of every group.
    fn typical_by<K: Ord>(&self, group: impl Fn(usize) -> K) -> BTreeMap<K, Expected> {
        let mut members: BTreeMap<K, Vec<usize>> = BTreeMap::new();
        for &i in &self.ids {
            members.entry(group(i)).or_default().push(i);
        }
        members
            .into_iter()
            .map(|(key, m)| (key, self.typical(&m)))
            .collect()
    }

    /// Weighted median of the albedos of `members`, channel by channel, and the variance of their
    /// luminance by its median deviation.
    fn typical(&self, members: &[usize]) -> Expected {
        let some: Vec<(Vec3, f32)> = members
            .iter()
            .step_by(step_over_many(members.len()))
            .map(|&i| (self.value(i), self.trust(i)))
            .collect();
        let middle = |of: &dyn Fn(Vec3) -> f32| {
            let pairs: Vec<(f32, f32)> = some.iter().map(|&(v, trust)| (of(v), trust)).collect();
            weighted_median(&pairs).map(|k| pairs[k].0)
        };
        let Some(x) = middle(&|a| a.x) else {
            return Expected {
                mean: Vec3::splat(0.5),
                variance: 0.1,
            };
        };
        let mean = Vec3::new(
            x,
            middle(&|a| a.y).unwrap_or(x),
            middle(&|a| a.z).unwrap_or(x),
        );
        let deviation = middle(&|a| (luminance(a) - luminance(mean)).abs()).unwrap_or(0.0);
        Expected {
            mean,
            variance: (MAD_SCALE * deviation)
                .max(LEAST_SPREAD * luminance(mean))
                .max(1e-3)
                .powi(2),
        }
    }
}

/// Class and room.
pub(super) type Place = (u16, u16);
/// A kind of place in a cube of space.
type Cube<K> = (K, [i32; 3]);

/// Space divided into cubes within which texels count as near.
struct Cubes<'a, K> {
    texels: &'a Texels,
    mesh: &'a Mesh,
    /// The kind of every texel's place.
    places: &'a [K],
    /// Edge of a cube, metres: [`NEAR`] texels of the usual size.
    edge: f32,
}

impl<'a, K: Copy + Ord + Send + Sync> Cubes<'a, K> {
    fn over(clean: &CleanTexels<'_>, texels: &'a Texels, mesh: &'a Mesh, places: &'a [K]) -> Self {
        let sides = clean
            .ids
            .iter()
            .step_by(step_over_many(clean.ids.len()))
            .map(|&i| texels.area(mesh, i).sqrt())
            .collect();
        let usual_side = median(sides).unwrap_or(1.0);
        Self {
            texels,
            mesh,
            places,
            edge: usual_side.max(f32::MIN_POSITIVE) * NEAR,
        }
    }

    fn place(&self, i: usize) -> Cube<K> {
        let position = self.texels.position(self.mesh, i);
        (
            self.places[i],
            (position / self.edge).floor().as_ivec3().to_array(),
        )
    }

    /// Sums around texel `i`: those of the eight cubes whose middles are next to it, by nearness, so
    /// that what is expected changes smoothly.
    fn sums_around(&self, near: &BTreeMap<Cube<K>, Sums>, i: usize) -> Sums {
        let at = self.texels.position(self.mesh, i) / self.edge - 0.5;
        let within = at - at.floor();
        let mut sums = Sums::default();
        for corner in 0..8 {
            let step = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let nearness = Vec3::ONE - (step.as_vec3() - within).abs();
            let cube = (self.places[i], (at.floor().as_ivec3() + step).to_array());
            if let Some(cube) = near.get(&cube) {
                sums.add(cube, f64::from(nearness.element_product()));
            }
        }
        sums
    }

    /// The clean texels cube by cube; those far from what is usual in their kind of place count less.
    fn sums(
        &self,
        clean: &CleanTexels<'_>,
        class: &BTreeMap<K, Expected>,
    ) -> BTreeMap<Cube<K>, Sums> {
        let of_texel = |&i: &usize| {
            let usual = class[&self.places[i]];
            let a = clean.value(i);
            let odd = (luminance(a) - luminance(usual.mean)).powi(2) / (9.0 * usual.variance);
            let w = f64::from(clean.trust(i) / (1.0 + odd));
            let l = f64::from(luminance(a));
            let sums = Sums {
                weight: w,
                albedo: w * a.as_dvec3(),
                square: w * (l * l),
            };
            (self.place(i), sums)
        };
        let texels: Vec<_> = clean.ids.par_iter().map(of_texel).collect();
        let mut near: BTreeMap<Cube<K>, Sums> = BTreeMap::new();
        for (cube, sums) in texels {
            near.entry(cube).or_default().add(&sums, 1.0);
        }
        near
    }
}

/// Weighted sums over the clean texels of a class in a cube.
#[derive(Clone, Copy, Default)]
struct Sums {
    weight: f64,
    albedo: DVec3,
    /// Of squared luminance.
    square: f64,
}

impl Sums {
    /// Adds `share` of others.
    fn add(&mut self, others: &Self, share: f64) {
        self.weight += share * others.weight;
        self.albedo += share * others.albedo;
        self.square += share * others.square;
    }

    /// What is expected in the cube: its own mean as far as its texels outweigh what is usual, and at
    /// most by the share `most`.
    fn beside(&self, usual: &Expected, most: f32) -> Expected {
        let total = self.weight as f32;
        let mean = self.albedo.as_vec3() / total.max(f32::MIN_POSITIVE);
        let variance = self.square as f32 / total.max(f32::MIN_POSITIVE) - luminance(mean).powi(2);
        let share = most * total / (total + ENOUGH_NEAR);
        let mean = usual.mean.lerp(mean, share);
        let spread = variance.max(0.0) * share + usual.variance * (1.0 - share);
        Expected {
            mean,
            variance: spread.max((LEAST_SPREAD * luminance(mean)).powi(2)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    /// Boards of one class and room that lie edge to edge, 1 m by 0.1 m each, bodies of their own: the
    /// first dark, the others pale. Two thirds of each are seen clean.
    #[test]
    fn what_is_expected_of_a_board_is_what_it_shows_elsewhere() {
        let mut mesh = Mesh::default();
        for board in 0..4 {
            let (first, y) = (mesh.positions.len() as u32, 0.1 * board as f32);
            for (x, dy) in [(0.0, 0.001), (1.0, 0.001), (1.0, 0.099), (0.0, 0.099)] {
                mesh.positions.push(Vec3::new(x, y + dy, 0.0));
                mesh.normals.push(Vec3::Z);
                mesh.uvs.push(Vec2::new(0.95 * x, 0.95 * (y + dy)) + 0.02);
            }
            mesh.triangles
                .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        let texels = Texels::rasterize(&mesh, 128, 128);
        let n = texels.len();
        let is_dark = |i: usize| texels.point[i].triangle < 2;
        let clean: Vec<bool> = (0..n).map(|i| i % 3 != 0).collect();
        let albedo = AlbedoEstimate {
            value: (0..n)
                .map(|i| Vec3::splat(if is_dark(i) { 0.05 } else { 0.8 }))
                .collect(),
            error: (clean.iter())
                .map(|c| if *c { 0.01 } else { f32::INFINITY })
                .collect(),
            looks: vec![3.0; n],
            specular_share: vec![0.0; n],
            footprint: vec![0.01; n],
            clean,
        };
        let ids: Vec<u32> = (0..n).filter(|i| i % 3 == 0).map(|i| i as u32).collect();
        let ground = Ground {
            texels: &texels,
            mesh: &mesh,
            labels: &vec![1; n],
            rooms: &vec![1; n],
        };
        let expected = class_prior(&albedo, &ground, &ids, &|_| 1.0);
        let mean_over = |dark: bool| {
            let of = ids.iter().zip(&expected);
            let of = of.filter(|(i, _)| is_dark(**i as usize) == dark);
            let means: Vec<f32> = of.map(|(_, e)| e.mean.x).collect();
            means.iter().sum::<f32>() / means.len() as f32
        };
        let (dark, pale) = (mean_over(true), mean_over(false));
        assert!(dark < 0.4 && (pale - 0.8).abs() < 0.05, "{dark}, {pale}");
        assert!(expected.iter().all(|e| e.variance > 0.0));
        // one paint, by what is known elsewhere: all boards are what most of them are
        for one in class_prior(&albedo, &ground, &ids, &|_| 0.0) {
            assert!((one.mean.x - 0.8).abs() < 0.01, "{}", one.mean);
        }
    }
}
