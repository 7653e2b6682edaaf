//! Lightmaps of many lightings from few bakes.
//!
//! Light transport is linear, channel by channel: the irradiance under lamps of factors f₁, f₂, … is
//! Σ fᵢ · Eᵢ, where Eᵢ is that of lamp i alone. Lamps that all lightings change alike are one light;
//! each light is baked once and the lightings are mixed of these, so that a thousand of them cost no
//! more than there are lights. A lighting that moves or adds lamps has a geometry of its own and is
//! baked by itself, and so is each where there are more lights than lightings.

use super::lightings::NamedLighting;
use crate::core::image::{Plane, RgbPlane};
use crate::core::progress::Progress;
use crate::core::trace::EmbreeTracer;
use crate::error::{Error, Result};
use crate::render::{
    EditableScene, LightmapSampling, LightmapTexels, PathTracer, PathTracerOptions,
};
use crate::solution::Solution;
use glam::Vec3;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// How lightmaps are baked.
#[derive(Clone, Copy, Debug)]
pub(super) struct LightmapQuality {
    /// Texels along each side.
    pub side: usize,
    /// Paths per texel.
    pub paths: u32,
    /// Seed of the paths.
    pub seed: u64,
}

/// A panorama: the scene's own where nothing is given.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Panorama {
    file: Option<PathBuf>,
    /// Bits of a constant radiance.
    constant: Option<[u32; 3]>,
}

impl Panorama {
    fn of(lighting: &NamedLighting) -> Self {
        let e = &lighting.lighting.environment;
        Self {
            file: e.file.clone(),
            // a file counts more, as in `Lighting::apply`
            constant: e.constant.filter(|_| e.file.is_none()).map(bits),
        }
    }
}

fn bits(v: [f32; 3]) -> [u32; 3] {
    v.map(f32::to_bits)
}

/// What a lighting does to each light.
pub(super) struct Factors {
    /// Factor on each lamp of the solution.
    pub lamps: Vec<Vec3>,
    /// Factor on the light from outside.
    pub environment: Vec3,
    panorama: Panorama,
    /// Whether it moves or adds lamps.
    own_geometry: bool,
}

impl Factors {
    fn of(lighting: &NamedLighting, solution: &Solution) -> Result<Self> {
        let world = relit(lighting, solution)?;
        let factor = |triangles: &[u32]| {
            let emitting = triangles.iter().find(|&&t| world.emits(t as usize));
            emitting.map_or(Vec3::ZERO, |&t| world.lamp_factor(t as usize))
        };
        let lamps = solution.lamps.iter().map(|l| factor(&l.triangles));
        Ok(Self {
            lamps: lamps.collect(),
            environment: world.environment_factor(),
            panorama: Panorama::of(lighting),
            own_geometry: !world.has_own_lamps_alone(),
        })
    }
}

/// A solution under a lighting.
///
/// # Errors
/// The lighting names a lamp that does not exist, or a file that cannot be read.
pub(super) fn relit<'a>(
    lighting: &NamedLighting,
    solution: &'a Solution,
) -> Result<EditableScene<'a>> {
    let mut world = EditableScene::new(solution);
    lighting
        .lighting
        .apply(&mut world, &solution.lamps)
        .map_err(|e| match e {
            Error::Usage(m) => Error::Usage(format!("lighting {:?}: {m}", lighting.name)),
            other => other,
        })?;
    Ok(world)
}

/// What is baked at once: lamps (numbers in the solution's list; one beyond stands for all that
/// emits and is no lamp), or a panorama.
#[derive(Clone, Debug, PartialEq)]
enum Light {
    Lamps(Vec<usize>),
    Outside(Panorama),
}

impl Light {
    /// Its factor under a lighting.
    fn factor(&self, factors: &Factors) -> Vec3 {
        match self {
            Self::Lamps(lamps) => factors.lamps.get(lamps[0]).copied().unwrap_or(Vec3::ONE),
            Self::Outside(panorama) if *panorama == factors.panorama => factors.environment,
            Self::Outside(_) => Vec3::ZERO,
        }
    }
}

/// The lights that lightings consist of: lamps that they change alike are one; what is off in all
/// of them is none.
fn lights(factors: &[&Factors], lamps: usize, rest_emits: bool) -> Vec<Light> {
    let mut alike: BTreeMap<Vec<[u32; 3]>, Vec<usize>> = BTreeMap::new();
    for lamp in 0..lamps + usize::from(rest_emits) {
        let light = Light::Lamps(vec![lamp]);
        let column: Vec<Vec3> = factors.iter().map(|f| light.factor(f)).collect();
        if column.iter().any(|f| *f != Vec3::ZERO) {
            let key = column.iter().map(|f| bits(f.to_array())).collect();
            alike.entry(key).or_default().push(lamp);
        }
    }
    let outside: BTreeSet<&Panorama> = factors
        .iter()
        .filter(|f| f.environment != Vec3::ZERO)
        .map(|f| &f.panorama)
        .collect();
    let mut groups: Vec<Vec<usize>> = alike.into_values().collect();
    groups.sort();
    let lamps = groups.into_iter().map(Light::Lamps);
    let outside = outside.into_iter().cloned().map(Light::Outside);
    lamps.chain(outside).collect()
}

/// Triangles that emit and belong to no lamp of the list.
fn emitting_beyond_lamps(solution: &Solution) -> Vec<u32> {
    let world = EditableScene::new(solution);
    let of_lamps = solution.lamps.iter().flat_map(|l| &l.triangles);
    let of_lamps: BTreeSet<u32> = of_lamps.copied().collect();
    (0..solution.mesh.triangles.len() as u32)
        .filter(|t| world.emits(*t as usize) && !of_lamps.contains(t))
        .collect()
}

/// Lightmaps of a list of lightings.
pub(super) struct LightMix<'a> {
    solution: &'a Solution,
    lightings: &'a [NamedLighting],
    texels: LightmapTexels<'a>,
    quality: LightmapQuality,
    /// Per lighting.
    pub factors: Vec<Factors>,
    /// Triangles that emit and belong to no lamp of the list: no lighting changes them.
    rest: Vec<u32>,
    /// The lights and the irradiance of each alone; empty if every lighting is baked by itself.
    baked: Vec<(Light, RgbPlane)>,
}

impl<'a> LightMix<'a> {
    /// Bakes the lights that several lightings share.
    ///
    /// # Errors
    /// A lighting names what does not exist; Embree cannot be used.
    pub fn new(
        solution: &'a Solution,
        lightings: &'a [NamedLighting],
        quality: LightmapQuality,
        progress: &Progress,
    ) -> Result<Self> {
        let factors = lightings
            .iter()
            .map(|l| Factors::of(l, solution))
            .collect::<Result<Vec<_>>>()?;
        let mut out = Self {
            rest: emitting_beyond_lamps(solution),
            solution,
            lightings,
            texels: LightmapTexels::new(&solution.mesh, quality.side),
            quality,
            factors,
            baked: Vec::new(),
        };
        let mixed: Vec<&Factors> = out.factors.iter().filter(|f| !f.own_geometry).collect();
        let lights = lights(&mixed, solution.lamps.len(), !out.rest.is_empty());
        if lights.len() < mixed.len() {
            for light in lights {
                let irradiance = out.bake(&out.texels, &out.alone(&light)?, progress)?;
                out.baked.push((light, irradiance));
            }
        }
        Ok(out)
    }

    /// How many bakes the lightings share.
    pub fn shared_bakes(&self) -> usize {
        self.baked.len()
    }

    /// Whether lighting `k` is mixed from shared bakes.
    pub fn is_mixed(&self, k: usize) -> bool {
        !(self.factors[k].own_geometry || self.baked.is_empty())
    }

    /// Whether lighting `k` leaves no light at all.
    fn is_dark(&self, k: usize) -> bool {
        let f = &self.factors[k];
        let mut all = f.lamps.iter().chain([&f.environment]);
        self.rest.is_empty() && !f.own_geometry && all.all(|f| *f == Vec3::ZERO)
    }

    /// Irradiance under lighting `k`.
    ///
    /// # Errors
    /// Embree cannot be used.
    pub fn lightmap(&self, k: usize, progress: &Progress) -> Result<RgbPlane> {
        let side = self.quality.side;
        let mut sum = Plane::filled(side, side, Vec3::ZERO);
        if self.is_dark(k) {
            return Ok(sum);
        }
        if !self.is_mixed(k) {
            let world = relit(&self.lightings[k], self.solution)?;
            let own = world.own_mesh();
            let texels = LightmapTexels::new(&own, side);
            return self.bake(&texels, &world, progress);
        }
        for (light, irradiance) in &self.baked {
            let factor = light.factor(&self.factors[k]);
            if factor != Vec3::ZERO {
                let pairs = sum.data.iter_mut().zip(&irradiance.data);
                pairs.for_each(|(sum, e)| *sum += factor * *e);
            }
        }
        Ok(sum)
    }

    /// The solution with one light alone, at factor 1.
    fn alone(&self, light: &Light) -> Result<EditableScene<'a>> {
        let mut world = EditableScene::new(self.solution);
        let lit: &[usize] = match light {
            Light::Lamps(lamps) => lamps,
            Light::Outside(_) => &[],
        };
        for (i, lamp) in self.solution.lamps.iter().enumerate() {
            if !lit.contains(&i) {
                world.scale_emission(&lamp.triangles, Vec3::ZERO);
            }
        }
        if !lit.contains(&self.solution.lamps.len()) {
            world.scale_emission(&self.rest, Vec3::ZERO);
        }
        match light {
            Light::Lamps(_) => world.scale_environment(Vec3::ZERO),
            Light::Outside(Panorama { file: Some(f), .. }) => {
                world.set_environment(crate::core::formats::read_panorama(f)?);
            }
            Light::Outside(Panorama { constant, .. }) => {
                if let Some(c) = constant {
                    let c = Vec3::from_array(c.map(f32::from_bits));
                    world.set_environment(Plane::filled(4, 2, c));
                }
            }
        }
        Ok(world)
    }

    fn bake(
        &self,
        texels: &LightmapTexels<'_>,
        world: &EditableScene<'_>,
        progress: &Progress,
    ) -> Result<RgbPlane> {
        let embree = EmbreeTracer::new(world.mesh())?;
        let options = PathTracerOptions {
            seed: self.quality.seed,
            ..PathTracerOptions::default()
        };
        let renderer = PathTracer::new(world.mesh(), &embree, world, world, options)
            .with_points(world.points().to_vec());
        let sampling = LightmapSampling::of_paths(self.quality.paths);
        Ok(texels.bake(&renderer, None, sampling, progress))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::core::geometry::Mesh;
    use crate::core::math::luminance;
    use crate::render::{Added, EnvironmentChange, LampChange, Lighting};
    use crate::solution::find_lamps;
    use crate::solution::tests::small_solution;
    use glam::Vec2;
    use std::f32::consts::PI;

    /// A floor of 4 m with two lamps of 0.4 m above it that face down, grey, under a sky.
    pub(in crate::programs::export) fn two_lamps() -> Solution {
        let mut solution = small_solution();
        let mut mesh = Mesh::default();
        // size, height, centre along x, place in the atlas, facing up
        for (size, y, x, u, up) in [
            (4.0, 0.0, 0.0, 0.0, true),
            (0.4, 1.5, -1.0, 1.0, false),
            (0.4, 1.5, 1.0, 2.0, false),
        ] {
            let first = mesh.positions.len() as u32;
            for (a, b) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                mesh.positions
                    .push(Vec3::new(x + size * (a - 0.5), y, size * (b - 0.5)));
                mesh.normals.push(if up { Vec3::Y } else { Vec3::NEG_Y });
                mesh.uvs
                    .push(Vec2::new((u + 0.1 + 0.8 * a) / 3.0, 0.1 + 0.8 * b));
            }
            let corners = if up {
                [[0, 2, 1], [0, 3, 2]]
            } else {
                [[0, 1, 2], [0, 2, 3]]
            };
            mesh.triangles
                .extend(corners.map(|t: [u32; 3]| t.map(|i| first + i)));
        }
        solution.mesh = mesh;
        solution.albedo.data.fill(Vec3::splat(0.5));
        solution.roughness.data.fill(1.0);
        solution.emission = Plane {
            width: 3,
            height: 1,
            data: vec![Vec3::ZERO, Vec3::new(8.0, 6.0, 4.0), Vec3::splat(5.0)],
        };
        solution.environment = Plane::filled(8, 4, Vec3::new(0.1, 0.2, 0.3));
        solution.lamps = find_lamps(&solution.mesh, &solution.emission, solution.origin);
        assert_eq!(solution.lamps.len(), 2);
        solution
    }

    fn named(lamps: Vec<LampChange>, environment: EnvironmentChange) -> NamedLighting {
        NamedLighting {
            name: "x".into(),
            lighting: Lighting {
                lamps,
                add: Vec::new(),
                environment,
            },
            random: false,
        }
    }

    fn lamp(group: usize, scale: f32, colour: [f32; 3]) -> LampChange {
        LampChange {
            group: Some(group),
            scale: Some(scale),
            colour: Some(colour),
            ..LampChange::default()
        }
    }

    fn dark_outside() -> EnvironmentChange {
        EnvironmentChange {
            off: true,
            ..EnvironmentChange::default()
        }
    }

    const QUALITY: LightmapQuality = LightmapQuality {
        side: 48,
        paths: 64,
        seed: 3,
    };

    fn mix<'a>(solution: &'a Solution, lightings: &'a [NamedLighting]) -> LightMix<'a> {
        LightMix::new(solution, lightings, QUALITY, &Progress::silent()).expect("bakes")
    }

    fn map(mix: &LightMix<'_>, k: usize) -> RgbPlane {
        mix.lightmap(k, &Progress::silent()).expect("bakes")
    }

    /// The mean over the texels of the floor.
    fn on_floor(map: &RgbPlane) -> Vec3 {
        let inside = |i: usize| (i % 48) > 1 && (i % 48) < 14 && (i / 48) > 5 && (i / 48) < 42;
        let values: Vec<Vec3> = (0..map.data.len())
            .filter(|&i| inside(i))
            .map(|i| map.data[i])
            .collect();
        values.iter().sum::<Vec3>() / values.len() as f32
    }

    #[test]
    fn lamps_that_change_alike_are_one_light() {
        let solution = two_lamps();
        let all = |f: f32| LampChange {
            scale: Some(f),
            ..LampChange::default()
        };
        let lightings: Vec<NamedLighting> = [0.0, 0.5, 1.0, 2.0]
            .iter()
            .map(|f| named(vec![all(*f)], dark_outside()))
            .collect();
        assert_eq!(mix(&solution, &lightings).shared_bakes(), 1);
        let apart = [
            named(vec![lamp(1, 0.5, [1.0; 3])], dark_outside()),
            named(vec![lamp(2, 0.5, [1.0; 3])], EnvironmentChange::default()),
        ];
        // two lamps and the sky are more than two lightings
        assert_eq!(mix(&solution, &apart).shared_bakes(), 0);
    }

    #[test]
    fn what_is_off_is_black_and_twice_the_light_is_twice_the_irradiance() {
        let solution = two_lamps();
        let off = LampChange {
            off: true,
            ..LampChange::default()
        };
        let twice = |g| lamp(g, 2.0, [1.0, 0.5, 0.0]);
        let lightings = [
            named(vec![off], dark_outside()),
            named(vec![], dark_outside()),
            named(vec![twice(1), twice(2)], dark_outside()),
        ];
        let mix = mix(&solution, &lightings);
        assert!((0..3).all(|k| mix.is_mixed(k)) && mix.shared_bakes() == 1);
        assert!(map(&mix, 0).data.iter().all(|e| *e == Vec3::ZERO));
        let (one, two) = (map(&mix, 1), map(&mix, 2));
        for (a, b) in one.data.iter().zip(&two.data) {
            assert_eq!(*b, *a * Vec3::new(2.0, 1.0, 0.0));
        }
        assert!(luminance(on_floor(&one)) > 0.1);
    }

    /// Mixed of three lights or traced at once: the same light within noise.
    #[test]
    fn mixed_light_is_the_light_of_all_lamps_together() {
        let solution = two_lamps();
        let one = named(
            vec![lamp(1, 0.5, [1.0, 0.8, 0.6]), lamp(2, 3.0, [0.2, 1.0, 1.0])],
            EnvironmentChange {
                constant: Some([0.3, 0.2, 0.1]),
                scale: Some(2.0),
                ..EnvironmentChange::default()
            },
        );
        let other = named(vec![lamp(1, 1.5, [1.0; 3])], dark_outside());
        let alone = std::slice::from_ref(&one);
        let lightings = [one.clone(), other.clone(), other.clone(), other];
        let whole = mix(&solution, alone);
        let mixed = mix(&solution, &lightings);
        assert!(!whole.is_mixed(0) && mixed.is_mixed(0));
        assert_eq!(mixed.shared_bakes(), 3);
        let (a, b) = (on_floor(&map(&whole, 0)), on_floor(&map(&mixed, 0)));
        assert!((a / b - 1.0).abs().max_element() < 0.02, "{a} {b}");
    }

    /// Under a sky of radiance L the upper side of a lone floor receives π · L.
    #[test]
    fn a_floor_under_an_even_sky_receives_pi_times_its_radiance() {
        let mut solution = two_lamps();
        solution.mesh.triangles.truncate(2);
        solution.lamps.clear();
        let sky = EnvironmentChange {
            constant: Some([1.0, 2.0, 3.0]),
            scale: Some(0.5),
            ..EnvironmentChange::default()
        };
        let lightings = [named(vec![], sky)];
        let e = on_floor(&map(&mix(&solution, &lightings), 0));
        let expected = 0.5 * PI * Vec3::new(1.0, 2.0, 3.0);
        assert!((e / expected - 1.0).abs().max_element() < 0.01, "{e}");
    }

    #[test]
    fn added_lamps_are_baked_with_their_lighting() {
        let solution = two_lamps();
        let mut lightings = vec![named(vec![lamp(1, 0.5, [1.0; 3])], dark_outside()); 4];
        let above = (solution.origin + glam::DVec3::new(0.0, 1.0, 0.0)).to_array();
        lightings[2].lighting.add.push(Added::Point {
            position: above,
            intensity: [5.0; 3],
        });
        let mix = mix(&solution, &lightings);
        assert!(mix.is_mixed(1) && !mix.is_mixed(2));
        assert!(on_floor(&map(&mix, 2)).x > 1.5 * on_floor(&map(&mix, 1)).x);
    }
}
