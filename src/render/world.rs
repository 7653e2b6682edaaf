//! A solution as something the path tracer can light: its materials, its lamps, its environment,
//! and changes to the latter two.

use super::added_lamp::Added;
use super::path_tracer::{self, Surface, SurfaceModel};
use super::{IesProfile, PointLight, Shape};
use crate::core::brdf::{BaseColour, Material, Reflectance};
use crate::core::geometry::{Mesh, bodies};
use crate::core::image::{RgbPlane, Wrap};
use crate::error::Result;
use crate::radiance::Environment;
use crate::solution::{Solution, triangle_emission};
use glam::{DVec3, Vec2, Vec3};
use std::collections::BTreeSet;
use std::f32::consts::{PI, TAU};

/// Where a lamp goes.
#[derive(Clone, Debug)]
pub struct LampMove {
    /// What emits of it: triangles of the solution.
    pub triangles: Vec<u32>,
    /// Displacement, metres.
    pub by: Vec3,
}

/// A body longer than what shines of it times this is no lamp's but what the lamp is mounted on
/// (rule of thumb: shades and housings are about as long as their lamps; ceilings and beams are not).
const LONGEST_BODY: f32 = 2.0;

/// What vertices at one place hold together.
struct Bodies {
    /// Per triangle.
    of_triangle: Vec<u32>,
    /// Diagonal of each body's bounding box.
    length: Vec<f32>,
}

impl Bodies {
    fn of(mesh: &Mesh) -> Self {
        let of_triangle = bodies(mesh);
        let count = of_triangle.iter().max().map_or(0, |n| *n as usize + 1);
        let mut bounds = vec![(Vec3::INFINITY, Vec3::NEG_INFINITY); count];
        for (t, &body) in of_triangle.iter().enumerate() {
            let (low, high) = &mut bounds[body as usize];
            for p in mesh.corners(t) {
                (*low, *high) = (low.min(p), high.max(p));
            }
        }
        Self {
            of_triangle,
            length: bounds
                .iter()
                .map(|(low, high)| (*high - *low).length())
                .collect(),
        }
    }

    /// The triangles of the bodies that a lamp alone makes up: those it shines from, but for what is
    /// much longer than the lamp.
    fn of_lamp(&self, mesh: &Mesh, emitting: &[u32]) -> BTreeSet<u32> {
        let corners = || emitting.iter().flat_map(|&t| mesh.corners(t as usize));
        let low = corners().fold(Vec3::INFINITY, Vec3::min);
        let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
        let most = LONGEST_BODY * (high - low).length();
        let of = |t: u32| self.of_triangle[t as usize];
        let own: BTreeSet<u32> = emitting
            .iter()
            .map(|&t| of(t))
            .filter(|&body| self.length[body as usize] <= most)
            .collect();
        let all = 0..self.of_triangle.len() as u32;
        all.filter(|&t| own.contains(&of(t))).collect()
    }
}

/// Materials and lights of a solution, with changed lights if so wished.
pub struct EditableScene<'a> {
    solution: &'a Solution,
    mesh: Mesh,
    /// Per triangle: factor on the emission texture; zero where the triangle does not emit.
    gain: Vec<Vec3>,
    /// Per triangle: mean of the emission texture.
    mean: Vec<Vec3>,
    /// Whether lamps were moved.
    moved: bool,
    /// Emitting triangles whose light was moved away from what they were mounted on.
    dark: BTreeSet<usize>,
    /// Emission of triangles beyond the solution's own and its moved lamps: `constant[t -
    /// textured]`.
    constant: Vec<Vec3>,
    textured: usize,
    environment: Environment,
    environment_gain: Vec3,
    points: Vec<PointLight>,
}

impl<'a> EditableScene<'a> {
    /// The solution's own light.
    #[must_use]
    pub fn new(solution: &'a Solution) -> Self {
        let mesh = solution.mesh.clone();
        let mean = triangle_emission(&mesh, &solution.emission);
        let gain = mean
            .iter()
            .map(|m| {
                if *m == Vec3::ZERO {
                    Vec3::ZERO
                } else {
                    Vec3::ONE
                }
            })
            .collect();
        Self {
            textured: mesh.triangles.len(),
            solution,
            mesh,
            gain,
            mean,
            moved: false,
            dark: BTreeSet::new(),
            constant: Vec::new(),
            environment: Environment::from_map(solution.environment.clone()),
            environment_gain: Vec3::ONE,
            points: Vec::new(),
        }
    }

    /// Geometry, added lamps included.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Lights without extent.
    #[must_use]
    pub fn points(&self) -> &[PointLight] {
        &self.points
    }

    /// Whether a triangle of the solution emits.
    #[must_use]
    pub fn emits(&self, t: usize) -> bool {
        self.mean.get(t).is_some_and(|m| *m != Vec3::ZERO)
    }

    /// Mean radiance that a triangle of the solution emits, unchanged.
    #[must_use]
    pub fn own_emission(&self, t: usize) -> Vec3 {
        self.mean[t]
    }

    /// Factor on what a triangle of the solution emits where it is now, or its light after it was
    /// moved away; 0 where it does not emit.
    #[must_use]
    pub fn lamp_factor(&self, t: usize) -> Vec3 {
        self.gain[t]
    }

    /// Factor on what a triangle of the solution emits; 0 where it does not, or its light was moved
    /// away from it.
    #[must_use]
    pub fn emission_factor(&self, t: usize) -> Vec3 {
        match self.dark.contains(&t) {
            true => Vec3::ZERO,
            false => self.gain[t],
        }
    }

    /// Factor on the light from outside.
    #[must_use]
    pub fn environment_factor(&self) -> Vec3 {
        self.environment_gain
    }

    /// The panorama of the light from outside, before its factor.
    #[must_use]
    pub fn environment_map(&self) -> &RgbPlane {
        self.environment.map()
    }

    /// Whether its light is that of the solution but for factors: no lamp was moved or added.
    #[must_use]
    pub fn has_own_lamps_alone(&self) -> bool {
        !self.moved && self.beyond_solution().is_empty() && self.points.is_empty()
    }

    /// The solution's own surfaces as they stand now: lamps that were moved with their bodies are
    /// elsewhere.
    #[must_use]
    pub fn own_mesh(&self) -> Mesh {
        let own = &self.solution.mesh;
        let vertices = own.positions.len();
        Mesh {
            positions: self.mesh.positions[..vertices].to_vec(),
            ..own.clone()
        }
    }

    /// Triangles that the solution does not have: the light of moved lamps without a body of their
    /// own, then added lamps.
    #[must_use]
    pub fn beyond_solution(&self) -> std::ops::Range<usize> {
        self.solution.mesh.triangles.len()..self.mesh.triangles.len()
    }

    /// Multiplies what some triangles emit.
    pub fn scale_emission(&mut self, triangles: &[u32], factor: Vec3) {
        for &t in triangles {
            self.gain[t as usize] *= factor;
        }
    }

    /// Moves lamps, each with its body: what vertices hold together with it, if it
    /// is not much longer than the lamp. Where a lamp has none (it shines from a
    /// part of a ceiling), its light moves and what it was mounted on stays, dark. To be called
    /// before any lamp is added.
    pub fn move_lamps(&mut self, moves: &[LampMove]) {
        let moves = || moves.iter().filter(|m| m.by != Vec3::ZERO);
        if moves().next().is_none() {
            return;
        }
        self.moved = true;
        let bodies = Bodies::of(&self.solution.mesh);
        for LampMove { triangles, by } in moves() {
            let body = bodies.of_lamp(&self.solution.mesh, triangles);
            let corners = body
                .iter()
                .flat_map(|&t| self.solution.mesh.triangles[t as usize]);
            for v in corners.collect::<BTreeSet<u32>>() {
                self.mesh.positions[v as usize] += *by;
            }
            for &t in triangles.iter().filter(|t| !body.contains(t)) {
                self.move_light(t as usize, *by);
            }
        }
        self.textured = self.mesh.triangles.len();
    }

    /// Moves the light of a triangle; what it was mounted on stays.
    fn move_light(&mut self, t: usize, by: Vec3) {
        let base = self.mesh.positions.len() as u32;
        for corner in self.mesh.triangles[t] {
            let i = corner as usize;
            self.mesh.positions.push(self.mesh.positions[i] + by);
            self.mesh.normals.push(self.mesh.normals[i]);
            self.mesh.uvs.push(self.mesh.uvs[i]);
        }
        self.mesh.triangles.push([base, base + 1, base + 2]);
        self.gain.push(self.gain[t]);
        self.mean.push(self.mean[t]);
        self.dark.insert(t);
    }

    /// Replaces the environment by a panorama in world axes.
    pub fn set_environment(&mut self, map: RgbPlane) {
        self.environment = Environment::from_map(map);
    }

    /// Multiplies the environment.
    pub fn scale_environment(&mut self, factor: Vec3) {
        self.environment_gain *= factor;
    }

    /// Adds a lamp.
    ///
    /// # Errors
    /// A luminaire's file cannot be read.
    pub fn add(&mut self, lamp: &Added) -> Result<()> {
        let origin = self.solution.origin;
        let local = |p: &[f64; 3]| (DVec3::from_array(*p) - origin).as_vec3();
        match lamp {
            Added::Quad {
                position,
                direction,
                size,
                radiance,
            } => {
                let n = Vec3::from_array(*direction).normalize_or(Vec3::NEG_Y);
                let frame = crate::core::math::Frame::from_normal(n);
                let (du, dv) = (
                    frame.world_from_local(Vec3::X) * size[0],
                    frame.world_from_local(Vec3::Y) * size[1],
                );
                let corner = local(position) - 0.5 * (du + dv);
                let corners = [corner, corner + du, corner + du + dv, corner + dv];
                // the winding decides where it shines
                let flip = du.cross(dv).dot(n) < 0.0;
                let triangles = if flip {
                    [[0, 2, 1], [0, 3, 2]]
                } else {
                    [[0, 1, 2], [0, 2, 3]]
                };
                self.push(&corners, &[n; 4], &triangles, Vec3::from_array(*radiance));
            }
            Added::Sphere {
                position,
                radius,
                radiance,
            } => {
                let (points, triangles) = unit_sphere(24, 12);
                let centre = local(position);
                let corners: Vec<Vec3> = points.iter().map(|p| centre + *p * *radius).collect();
                self.push(&corners, &points, &triangles, Vec3::from_array(*radiance));
            }
            Added::Point {
                position,
                intensity,
            } => self.points.push(PointLight {
                position: local(position),
                intensity: Vec3::from_array(*intensity),
                axis: Vec3::NEG_Y,
                shape: Shape::Bulb,
            }),
            Added::Spot {
                position,
                direction,
                angle,
                blend,
                intensity,
            } => {
                let outer = angle.to_radians();
                let inner = outer * (1.0 - blend);
                self.points.push(PointLight {
                    position: local(position),
                    intensity: Vec3::from_array(*intensity),
                    axis: Vec3::from_array(*direction).normalize_or(Vec3::NEG_Y),
                    shape: Shape::Spot([inner.cos(), outer.cos()]),
                });
            }
            Added::Ies {
                position,
                direction,
                file,
                turn,
                intensity,
            } => self.points.push(PointLight {
                position: local(position),
                intensity: Vec3::from_array(*intensity),
                axis: Vec3::from_array(*direction).normalize_or(Vec3::NEG_Y),
                shape: Shape::Measured(IesProfile::read(file)?, turn.to_radians()),
            }),
        }
        Ok(())
    }

    fn push(&mut self, corners: &[Vec3], normals: &[Vec3], triangles: &[[u32; 3]], radiance: Vec3) {
        let base = self.mesh.positions.len() as u32;
        self.mesh.positions.extend_from_slice(corners);
        self.mesh.normals.extend_from_slice(normals);
        self.mesh
            .uvs
            .extend(std::iter::repeat_n(Vec2::ZERO, corners.len()));
        self.mesh
            .triangles
            .extend(triangles.iter().map(|t| t.map(|i| i + base)));
        self.constant
            .extend(std::iter::repeat_n(radiance, triangles.len()));
    }
}

impl SurfaceModel for EditableScene<'_> {
    fn surface(&self, triangle: usize, u: f32, v: f32) -> Surface {
        if triangle >= self.textured {
            let material = Material {
                albedo: Vec3::ZERO,
                roughness: 1.0,
            };
            return Surface::dielectric(material, self.constant[triangle - self.textured]);
        }
        let s = self.solution;
        let uv = self.mesh.uv(triangle, u, v);
        let at = |w: usize, h: usize| uv * Vec2::new(w as f32, h as f32);
        let albedo = s
            .albedo
            .bilinear(at(s.albedo.width, s.albedo.height), Wrap::Clamp);
        let roughness = s
            .roughness
            .bilinear(at(s.roughness.width, s.roughness.height), Wrap::Clamp);
        let gain = self.emission_factor(triangle);
        let emission = if gain == Vec3::ZERO {
            gain
        } else {
            gain * *s.emission.nearest(at(s.emission.width, s.emission.height))
        };
        Surface {
            base: BaseColour {
                colour: albedo,
                metallic: s.metal_at(uv),
            },
            transmission: s.transmission_at(uv),
            roughness,
            emission,
        }
    }

    fn mean_emission(&self, triangle: usize) -> Vec3 {
        if triangle >= self.textured {
            self.constant[triangle - self.textured]
        } else {
            self.emission_factor(triangle) * self.mean[triangle]
        }
    }

    fn label(&self, triangle: usize) -> u16 {
        if triangle >= self.textured {
            return 0;
        }
        let middle = self.mesh.uv(triangle, 1.0 / 3.0, 1.0 / 3.0);
        self.solution.class_at(middle)
    }

    fn has_panes(&self) -> bool {
        self.solution.transmission.is_some()
    }

    fn reflectance(&self) -> Reflectance {
        self.solution.reflectance
    }

    fn emits_forward_only(&self, _: usize) -> bool {
        true
    }
}

impl path_tracer::Environment for EditableScene<'_> {
    fn radiance(&self, direction: Vec3) -> Vec3 {
        self.environment.radiance(direction) * self.environment_gain
    }

    fn is_black(&self) -> bool {
        self.environment.is_black() || self.environment_gain == Vec3::ZERO
    }
}

/// Points and outward triangles of a unit sphere of `around` × `rings` quads.
fn unit_sphere(around: u32, rings: u32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let mut points = Vec::new();
    for j in 0..=rings {
        let theta = PI * j as f32 / rings as f32;
        for i in 0..around {
            let phi = TAU * i as f32 / around as f32;
            points.push(Vec3::new(
                theta.sin() * phi.cos(),
                theta.cos(),
                theta.sin() * phi.sin(),
            ));
        }
    }
    let mut triangles = Vec::new();
    for j in 0..rings {
        for i in 0..around {
            let (a, b) = (j * around + i, j * around + (i + 1) % around);
            let (c, d) = (a + around, b + around);
            triangles.extend([[a, b, c], [b, d, c]]);
        }
    }
    (points, triangles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::brdf::DIELECTRIC;
    use crate::solution::tests::small_solution;

    #[test]
    fn added_lamps_face_outwards() {
        let solution = small_solution();
        let mut world = EditableScene::new(&solution);
        let own = world.mesh().triangles.len();
        let p = (solution.origin + DVec3::new(0.0, 1.0, 0.0)).to_array();
        world
            .add(&Added::Sphere {
                position: p,
                radius: 0.2,
                radiance: [1.0, 2.0, 3.0],
            })
            .expect("adds");
        let sphere = world.mesh().triangles.len();
        world
            .add(&Added::Quad {
                position: p,
                direction: [0.0, -1.0, 0.0],
                size: [0.4, 0.2],
                radiance: [4.0; 3],
            })
            .expect("adds");
        let centre = Vec3::new(0.0, 1.0, 0.0);
        let m = world.mesh();
        for t in own..sphere {
            let outward = m.position(t, 1.0 / 3.0, 1.0 / 3.0) - centre;
            assert!(m.area(t) < 1e-9 || m.face_normal(t).dot(outward) > 0.0);
            assert_eq!(
                world.surface(t, 0.2, 0.2).emission,
                Vec3::new(1.0, 2.0, 3.0)
            );
        }
        let area: f32 = (sphere..m.triangles.len()).map(|t| m.area(t)).sum();
        assert!((area - 0.08).abs() < 1e-5);
        assert!(m.face_normal(sphere).dot(Vec3::NEG_Y) > 0.99);
        assert_eq!(m.positions.len(), m.uvs.len());
    }

    /// Where rays meet a triangle of the world, and what it emits there.
    fn shining(world: &EditableScene<'_>) -> Vec<(Vec3, Vec3)> {
        let mesh = world.mesh();
        let emits = |t: &usize| world.mean_emission(*t) != Vec3::ZERO;
        (0..mesh.triangles.len())
            .filter(emits)
            .map(|t| {
                (
                    mesh.position(t, 0.3, 0.3),
                    world.surface(t, 0.3, 0.3).emission,
                )
            })
            .collect()
    }

    #[test]
    fn a_lamp_moves_with_its_body_and_by_nothing_not_at_all() {
        let mut solution = small_solution();
        solution.emission.data.fill(Vec3::splat(2.0));
        let mut world = EditableScene::new(&solution);
        world.scale_emission(&[0], Vec3::new(0.5, 1.0, 0.0));
        let before = shining(&world);
        let lamp = |by| LampMove {
            triangles: (0..solution.mesh.triangles.len() as u32).collect(),
            by,
        };
        world.move_lamps(&[lamp(Vec3::ZERO)]);
        assert!(world.has_own_lamps_alone() && shining(&world) == before);
        world.move_lamps(&[lamp(Vec3::Y), lamp(Vec3::X)]);
        // all is one body: nothing stays behind, nothing is added
        assert!(!world.has_own_lamps_alone() && world.beyond_solution().is_empty());
        for ((p, emission), (p_before, emission_before)) in shining(&world).iter().zip(&before) {
            assert!((*p - *p_before - Vec3::Y - Vec3::X).length() < 1e-5);
            assert_eq!(emission, emission_before);
        }
        let moved = world.own_mesh();
        assert!((moved.position(0, 0.2, 0.2) - world.mesh().position(0, 0.2, 0.2)).length() == 0.0);
    }

    #[test]
    fn light_from_a_part_of_a_ceiling_leaves_the_ceiling() {
        let mut solution = small_solution();
        solution.emission.data.fill(Vec3::splat(2.0));
        // beside it, joined to it, ten times as long
        let [a, b, _] = solution.mesh.triangles[0];
        let far = solution.mesh.positions.len() as u32;
        let along = solution.mesh.positions[b as usize] - solution.mesh.positions[a as usize];
        let place = solution.mesh.positions[a as usize] + 100.0 * along.any_orthogonal_vector();
        solution.mesh.positions.push(place);
        solution
            .mesh
            .normals
            .push(solution.mesh.normals[a as usize]);
        solution.mesh.uvs.push(solution.mesh.uvs[a as usize]);
        solution.mesh.triangles.push([b, a, far]);
        let mut world = EditableScene::new(&solution);
        world.scale_emission(&[0], Vec3::new(0.5, 1.0, 0.0));
        world.move_lamps(&[LampMove {
            triangles: vec![0],
            by: Vec3::Y,
        }]);
        assert_eq!(world.surface(0, 0.2, 0.2).emission, Vec3::ZERO);
        assert_eq!(world.mean_emission(0), Vec3::ZERO);
        assert_eq!(world.emission_factor(0), Vec3::ZERO);
        assert_eq!(world.lamp_factor(0), Vec3::new(0.5, 1.0, 0.0));
        let moved = world.mesh().triangles.len() - 1;
        assert_eq!(world.beyond_solution(), moved..moved + 1);
        assert_eq!(
            world.surface(moved, 0.2, 0.2).emission,
            Vec3::new(1.0, 2.0, 0.0)
        );
        let path = world.mesh().position(moved, 0.2, 0.3) - world.mesh().position(0, 0.2, 0.3);
        assert!((path - Vec3::Y).length() < 1e-4);
    }

    #[test]
    fn metal_is_metal_to_the_path_tracer() {
        let mut solution = small_solution();
        let gold = Vec3::new(1.0, 0.78, 0.34);
        solution.albedo.data.fill(gold);
        let plain = EditableScene::new(&solution).surface(0, 0.2, 0.2);
        let close = |a: Vec3, b: Vec3| assert!((a - b).length() < 1e-6, "{a} instead of {b}");
        close(plain.base.diffuse(), gold);
        assert_eq!(plain.base.f0(), DIELECTRIC);
        let mut metallic = solution.albedo.map(|_| 0.0);
        let uv = solution.mesh.uv(0, 0.2, 0.2) * metallic.width as f32;
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let corner = uv - 0.5;
            metallic[(corner.x as usize + x, corner.y as usize + y)] = 1.0;
        }
        solution.metallic = Some(metallic);
        let world = EditableScene::new(&solution);
        let metal = world.surface(0, 0.2, 0.2).base;
        close(metal.diffuse(), Vec3::ZERO);
        close(metal.f0(), gold);
        let beside = world.surface(0, 0.4, 0.4).base;
        close(beside.diffuse(), gold);
        assert_eq!(beside.f0(), DIELECTRIC);
    }

    #[test]
    fn a_spot_ends_at_its_angle() {
        let solution = small_solution();
        let mut world = EditableScene::new(&solution);
        let spot = Added::Spot {
            position: [0.0; 3],
            direction: [0.0, -1.0, 0.0],
            angle: 30.0,
            blend: 0.5,
            intensity: [8.0; 3],
        };
        world.add(&spot).expect("adds");
        let light = &world.points()[0];
        let at = |degrees: f32| {
            light
                .towards(Vec3::new(
                    degrees.to_radians().sin(),
                    -degrees.to_radians().cos(),
                    0.0,
                ))
                .x
        };
        assert_eq!(
            (at(0.0), at(14.0), at(31.0), at(120.0)),
            (8.0, 8.0, 0.0, 0.0)
        );
        assert!(at(22.0) > 0.5 && at(22.0) < 7.5);
    }
}
