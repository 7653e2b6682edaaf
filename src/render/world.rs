//! A solution as something the path tracer can light: its materials, its lamps, its environment,
//! and changes to the latter two.

use super::path_tracer::{self, Surface, SurfaceModel};
use super::{IesProfile, PointLight, Shape};
use crate::core::brdf::{BaseColour, Material, Reflectance};
use crate::core::geometry::Mesh;
use crate::core::image::{RgbPlane, Wrap};
use crate::error::Result;
use crate::radiance::Environment;
use crate::solution::{Solution, triangle_emission};
use glam::{DVec3, Vec2, Vec3};
use serde::{Deserialize, Serialize};
use std::f32::consts::{PI, TAU};
use std::path::PathBuf;

/// A lamp that the scene does not have. Positions in the coordinates of the scene's file, metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Added {
    /// A luminous rectangle that shines along `direction`.
    Quad {
        /// Centre.
        position: [f64; 3],
        /// Where it shines.
        direction: [f32; 3],
        /// Width and height.
        size: [f32; 2],
        /// Emitted radiance.
        radiance: [f32; 3],
    },
    /// A luminous sphere.
    Sphere {
        /// Centre.
        position: [f64; 3],
        /// Radius.
        radius: f32,
        /// Emitted radiance.
        radiance: [f32; 3],
    },
    /// A bulb without extent.
    Point {
        /// Place.
        position: [f64; 3],
        /// Radiant intensity per steradian.
        intensity: [f32; 3],
    },
    /// A spotlight without extent.
    Spot {
        /// Place.
        position: [f64; 3],
        /// Axis of the cone.
        direction: [f32; 3],
        /// Angle between axis and edge of the cone, degrees.
        angle: f32,
        /// Share of the angle over which the light fades, 0 to 1.
        #[serde(default)]
        blend: f32,
        /// Radiant intensity on the axis, per steradian.
        intensity: [f32; 3],
    },
    /// A measured luminaire without extent.
    Ies {
        /// Place.
        position: [f64; 3],
        /// Where its axis points (vertical angle 0 of the file); down if not given.
        #[serde(default = "down")]
        direction: [f32; 3],
        /// IES file (LM-63, type C), relative to the lighting file.
        file: PathBuf,
        /// Turn about the axis, degrees.
        #[serde(default)]
        turn: f32,
        /// Radiant intensity where the luminaire is brightest, per steradian.
        intensity: [f32; 3],
    },
}

fn down() -> [f32; 3] {
    [0.0, -1.0, 0.0]
}

/// Materials and lights of a solution, with changed lights if so wished.
pub struct EditableScene<'a> {
    solution: &'a Solution,
    mesh: Mesh,
    /// Per triangle: factor on the emission texture; zero where the triangle does not emit.
    gain: Vec<Vec3>,
    /// Per triangle: mean of the emission texture.
    mean: Vec<Vec3>,
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

    /// Factor on what a triangle of the solution emits; 0 where it does not.
    #[must_use]
    pub fn emission_factor(&self, t: usize) -> Vec3 {
        self.gain[t]
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

    /// Triangles that the solution does not have: moved lamps, then added ones.
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

    /// Moves emitting triangles; what they were mounted on stays. To be called before any lamp is
    /// added.
    pub fn move_emission(&mut self, triangles: &[u32], by: Vec3) {
        for &t in triangles {
            let t = t as usize;
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
            self.gain[t] = Vec3::ZERO;
        }
        self.textured = self.mesh.triangles.len();
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
                let outer = angle.clamp(0.1, 179.0).to_radians();
                let inner = outer * (1.0 - blend.clamp(0.0, 1.0));
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
        let gain = self.gain[triangle];
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
            self.gain[triangle] * self.mean[triangle]
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

    #[test]
    fn scaled_and_moved_emission() {
        let mut solution = small_solution();
        solution.emission.data.fill(Vec3::splat(2.0));
        let mut world = EditableScene::new(&solution);
        assert!(world.emits(0));
        world.scale_emission(&[0], Vec3::new(0.5, 1.0, 0.0));
        assert_eq!(
            world.surface(0, 0.2, 0.2).emission,
            Vec3::new(1.0, 2.0, 0.0)
        );
        world.move_emission(&[0], Vec3::Y);
        assert_eq!(world.surface(0, 0.2, 0.2).emission, Vec3::ZERO);
        let moved = world.mesh().triangles.len() - 1;
        assert_eq!(
            world.surface(moved, 0.2, 0.2).emission,
            Vec3::new(1.0, 2.0, 0.0)
        );
        assert!(
            (world.mesh().position(moved, 0.2, 0.3) - world.mesh().position(0, 0.2, 0.3) - Vec3::Y)
                .length()
                < 1e-6
        );
        assert_eq!(world.mean_emission(0), Vec3::ZERO);
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
