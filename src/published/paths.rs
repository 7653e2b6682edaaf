//! Light paths whose radiance is differentiable in the textures of surfaces: detached sampling with
//! replay (Vicini et al. 2021, "Path Replay Backpropagation", Sec. 4; Zeltner et al. 2021 on
//! detached estimators). Directions, densities and visibility are drawn once, with the textures of
//! that moment, and stay; [`Path::radiance`] and [`Path::adjoint`] then read the textures anew:
//!
//! L_k = w_k E(x_k) + f(x_k, lamp) E(lamp) + f(x_k, ω_k) L_{k+1}, geometry and 1/pdf in the weights.
//!
//! Lamps are met by shadow rays and by reflection, combined by the power heuristic (Veach 1997).

use super::learned_texture::{LearnedTexture, Taps};
use crate::core::brdf::{Material, specular_d_roughness};
use crate::core::geometry::Mesh;
use crate::core::sampling::{KeyedRng, hash_u64};
use crate::core::texture::SurfacePoint;
use crate::core::trace::{Hit, Ray, Tracer};
use crate::gbuffer::Orientation;
use crate::lights::{Emitters, LightModel, LightSampler};
use crate::radiance::{Environment, LightField};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Surfaces of a path: four reflections carry 97 % of the light where half of it is reflected
/// (derived: 1 − 0.5⁵).
pub const VERTICES: usize = 5;

/// Geometry and lamps.
#[derive(Clone, Copy)]
pub struct PathScene<'a> {
    /// Surfaces.
    pub mesh: &'a Mesh,
    /// Which way they face.
    pub orientation: &'a Orientation,
    /// Rays.
    pub tracer: &'a dyn Tracer,
    /// What lamps send out before their gain; black elsewhere.
    pub lamps: &'a LightField,
    /// How lamps are sampled.
    pub emitters: &'a Emitters,
    /// What rays meet that leave the geometry, in the units of the losses; paths find it by chance alone.
    pub sky: &'a Environment,
    /// Distance by which rays start above a surface, metres.
    pub offset: f32,
}

/// What is learned.
pub struct Textures {
    /// Albedo, linear RGB.
    pub albedo: LearnedTexture<3>,
    /// Roughness R.
    pub roughness: LearnedTexture<1>,
    /// Factor on what lamps send out.
    pub gain: LearnedTexture<3>,
}

/// A surface point as a camera sees it.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Where.
    pub place: SurfacePoint,
    /// Unit direction to the camera.
    pub to_camera: Vec3,
    /// What the photograph shows, in the units of the losses.
    pub radiance: Vec3,
}

/// A pair of directions at a surface; `weight` is n·l / pdf.
#[derive(Clone, Copy, Debug, Default)]
struct Scatter {
    n_l: f32,
    n_v: f32,
    sin2_nh: f32,
    v_h: f32,
    weight: f32,
}

/// Light of a lamp, MIS weight included, and where its gain is read.
#[derive(Clone, Copy, Debug)]
struct Shine {
    radiance: Vec3,
    gain: Taps,
}

#[derive(Clone, Copy, Debug)]
struct Vertex {
    albedo: Taps,
    roughness: Taps,
    /// Own light.
    shine: Option<Shine>,
    /// Towards a point on a lamp.
    lamp: Option<(Scatter, Shine)>,
    /// Towards the next vertex.
    next: Option<Scatter>,
}

/// One path from a look.
pub struct Path {
    vertices: Vec<Vertex>,
    /// What its last ray meets outside of the geometry.
    sky: Vec3,
}

/// A slope at a place of each texture.
pub enum Slope {
    /// Of albedo.
    Albedo(Taps, Vec3),
    /// Of roughness.
    Roughness(Taps, f32),
    /// Of a lamp's gain.
    Gain(Taps, Vec3),
}

impl Scatter {
    fn new([n, v, l]: [Vec3; 3], pdf: f32) -> Option<Self> {
        let (n_l, n_v) = (n.dot(l), n.dot(v));
        let h = (v + l).normalize_or(n);
        (n_l > 0.0 && n_v > 0.0 && pdf > 0.0).then(|| Self {
            n_l: n_l.min(1.0),
            n_v: n_v.min(1.0),
            sin2_nh: n.cross(h).length_squared().min(1.0),
            v_h: v.dot(h).clamp(0.0, 1.0),
            weight: n_l / pdf,
        })
    }

    /// f n·l / pdf, and its derivatives by albedo (of each channel alike) and roughness.
    fn evaluate(&self, material: &Material) -> (Vec3, f32, f32) {
        let (value, slope) = specular_d_roughness(
            self.n_l,
            self.n_v,
            self.sin2_nh,
            self.v_h,
            material.roughness,
        );
        (
            (material.albedo * FRAC_1_PI + value) * self.weight,
            FRAC_1_PI * self.weight,
            slope * self.weight,
        )
    }
}

impl Textures {
    fn material(&self, vertex: &Vertex) -> Material {
        Material {
            albedo: self.albedo.texture().fetch(&vertex.albedo).into(),
            roughness: self.roughness.texture().fetch(&vertex.roughness)[0],
        }
    }

    fn shining(&self, shine: &Shine) -> Vec3 {
        shine.radiance * Vec3::from(self.gain.texture().fetch(&shine.gain))
    }

    /// Adds a slope where it belongs.
    pub fn add(&mut self, slope: &Slope) {
        match slope {
            Slope::Albedo(taps, by) => self.albedo.add_gradient(taps, by.to_array()),
            Slope::Roughness(taps, by) => self.roughness.add_gradient(taps, [*by]),
            Slope::Gain(taps, by) => self.gain.add_gradient(taps, by.to_array()),
        }
    }
}

impl Path {
    /// What arrives at the camera, from every vertex on: the first is the whole.
    fn radiances(&self, textures: &Textures) -> Vec<Vec3> {
        let mut out = vec![self.sky; self.vertices.len() + 1];
        for (k, vertex) in self.vertices.iter().enumerate().rev() {
            let material = textures.material(vertex);
            let mut sum = Vec3::ZERO;
            if let Some(shine) = &vertex.shine {
                sum += textures.shining(shine);
            }
            if let Some((scatter, shine)) = &vertex.lamp {
                sum += scatter.evaluate(&material).0 * textures.shining(shine);
            }
            if let Some(scatter) = &vertex.next {
                sum += scatter.evaluate(&material).0 * out[k + 1];
            }
            out[k] = sum;
        }
        out
    }

    /// Radiance towards the camera.
    #[must_use]
    pub fn radiance(&self, textures: &Textures) -> Vec3 {
        self.radiances(textures)[0]
    }

    /// Appends the slopes of an objective whose derivative by [`Self::radiance`] is `by`.
    pub fn adjoint(&self, textures: &Textures, by: Vec3, out: &mut Vec<Slope>) {
        let radiances = self.radiances(textures);
        let mut by = by;
        for (k, vertex) in self.vertices.iter().enumerate() {
            let material = textures.material(vertex);
            let (mut by_albedo, mut by_roughness) = (Vec3::ZERO, 0.0);
            let mut reflect = |scatter: &Scatter, light: Vec3| {
                let (value, albedo, roughness) = scatter.evaluate(&material);
                by_albedo += by * light * albedo;
                by_roughness += (by * light).element_sum() * roughness;
                value
            };
            if let Some(shine) = &vertex.shine {
                out.push(Slope::Gain(shine.gain, by * shine.radiance));
            }
            if let Some((scatter, shine)) = &vertex.lamp {
                let value = reflect(scatter, textures.shining(shine));
                out.push(Slope::Gain(shine.gain, by * value * shine.radiance));
            }
            let passed = match &vertex.next {
                Some(scatter) => reflect(scatter, radiances[k + 1]),
                None => Vec3::ZERO,
            };
            out.push(Slope::Albedo(vertex.albedo, by_albedo));
            out.push(Slope::Roughness(vertex.roughness, by_roughness));
            by *= passed;
        }
    }
}

/// A path that grows: where it stands.
struct Tip {
    path: usize,
    place: SurfacePoint,
    /// Unit direction to where it came from.
    view: Vec3,
    /// Share of the vertex's own light that counts.
    shine: f32,
}

/// A ray to a lamp.
struct LampRay {
    ray: Ray,
    place: SurfacePoint,
    /// Density per steradian.
    pdf: f32,
}

/// A place on a path from which rays go out.
#[derive(Clone, Copy)]
struct Stand {
    path: usize,
    position: Vec3,
    normal: Vec3,
    /// Density of the drawn direction.
    pdf: f32,
}

impl PathScene<'_> {
    /// `samples` paths for each of `looks`, one after another; `key` and `first`, the number of the
    /// first look, decide them.
    #[must_use]
    pub fn trace(
        &self,
        looks: &[Look],
        samples: usize,
        textures: &Textures,
        key: u64,
        first: usize,
    ) -> Vec<Path> {
        let count = looks.len() * samples;
        let mut paths: Vec<Path> = (0..count)
            .map(|_| Path {
                vertices: Vec::with_capacity(VERTICES),
                sky: Vec3::ZERO,
            })
            .collect();
        let mut tips: Vec<Tip> = (0..count)
            .map(|path| {
                let look = &looks[path / samples];
                Tip {
                    path,
                    place: look.place,
                    view: look.to_camera,
                    shine: 1.0,
                }
            })
            .collect();
        for bounce in 0..VERTICES {
            let key = hash_u64(hash_u64(key, bounce as u64), first as u64);
            tips = self.bounce(&tips, textures, key, &mut paths);
        }
        paths
    }

    /// Adds a vertex at every tip; returns where the paths go on.
    fn bounce(&self, tips: &[Tip], textures: &Textures, key: u64, paths: &mut [Path]) -> Vec<Tip> {
        let (mut rays, mut stands) = (Vec::new(), Vec::new());
        let (mut shadows, mut shaded) = (Vec::new(), Vec::new());
        let mut choice = LightSampler::default();
        for tip in tips {
            let SurfacePoint { triangle, u, v } = tip.place;
            let t = triangle as usize;
            let sign = self.orientation.sign(t);
            let normal = self.mesh.shading_normal(t, u, v) * sign;
            let face_normal = self.mesh.face_normal(t) * sign;
            let uv = self.mesh.uv(t, u, v);
            let mut vertex = Vertex {
                albedo: textures.albedo.texture().taps(uv, 0.0),
                roughness: textures.roughness.texture().taps(uv, 0.0),
                shine: self.shine(&tip.place, tip.shine, textures),
                lamp: None,
                next: None,
            };
            let material = textures.material(&vertex);
            let position = self.mesh.position(t, u, v) + self.offset * face_normal;
            let mut rng = KeyedRng::new(key, tip.path as u64);
            let mut random = || rng.next_f32();
            let picked = [random(), random()];
            let lamp = self.lamp(position, normal, picked, &mut choice);
            if let Some(LampRay { ray, place, pdf }) = lamp {
                let direction = Vec3::from(ray.direction);
                let other = material.pdf(normal, tip.view, direction);
                let share = pdf * pdf / (pdf * pdf + other * other);
                let scatter = Scatter::new([normal, tip.view, direction], pdf);
                let shine = self.shine(&place, share, textures);
                vertex.lamp = scatter.zip(shine);
                if vertex.lamp.is_some() {
                    shadows.push(ray);
                    shaded.push(tip.path);
                }
            }
            let drawn = material.sample(normal, tip.view, random(), [random(), random()]);
            if let Some(drawn) = drawn.filter(|d| d.direction.dot(face_normal) > 0.0) {
                vertex.next = Scatter::new([normal, tip.view, drawn.direction], drawn.pdf);
                rays.push(Ray::new(position, drawn.direction, f32::INFINITY));
                stands.push(Stand {
                    path: tip.path,
                    position,
                    normal,
                    pdf: drawn.pdf,
                });
            }
            paths[tip.path].vertices.push(vertex);
        }
        let mut occluded = vec![0; shadows.len()];
        self.tracer.occluded(&shadows, &mut occluded);
        for (path, _) in shaded.iter().zip(&occluded).filter(|(_, o)| **o != 0) {
            if let Some(vertex) = paths[*path].vertices.last_mut() {
                vertex.lamp = None;
            }
        }
        let mut hits = vec![Hit::miss(); rays.len()];
        self.tracer.closest(&rays, &mut hits);
        let ends = stands.iter().zip(rays.iter().zip(&hits));
        for (stand, (ray, _)) in ends.clone().filter(|(_, (_, hit))| !hit.is_hit()) {
            paths[stand.path].sky = self.sky.radiance(Vec3::from(ray.direction));
        }
        ends.filter_map(|(stand, (ray, hit))| self.arrive(stand, ray, hit, &mut choice))
            .collect()
    }

    /// A shadow ray to a drawn point on a lamp.
    fn lamp(
        &self,
        from: Vec3,
        normal: Vec3,
        picked: [f32; 2],
        choice: &mut LightSampler,
    ) -> Option<LampRay> {
        /// Shadow rays end this much before the lamp, as a share of their length.
        const SHORT: f32 = 1e-3;
        if self.emitters.is_empty() {
            return None;
        }
        self.emitters.choose(from, normal, 0.0, choice);
        if choice.is_empty() {
            return None;
        }
        let model: &dyn LightModel = self.lamps;
        let point = self
            .emitters
            .sample_point(self.mesh, model, choice, from, picked)?;
        let ray = Ray::new(from, point.direction, point.distance * (1.0 - SHORT));
        let (triangle, u, v) = point.place?;
        Some(LampRay {
            ray,
            place: SurfacePoint { triangle, u, v },
            pdf: point.pdf,
        })
    }

    /// A share of the light that a place sends out; `None` where it is no lamp.
    fn shine(&self, place: &SurfacePoint, share: f32, textures: &Textures) -> Option<Shine> {
        let (t, u, v) = (place.triangle as usize, place.u, place.v);
        self.lamps.is_emissive(t).then(|| Shine {
            radiance: self.lamps.emitted(t, u, v) * share,
            gain: textures.gain.texture().taps(self.mesh.uv(t, u, v), 0.0),
        })
    }

    /// Where a ray goes on; `None` outside and behind surfaces.
    fn arrive(&self, from: &Stand, ray: &Ray, hit: &Hit, choice: &mut LightSampler) -> Option<Tip> {
        let direction = Vec3::from(ray.direction);
        let front = hit.is_hit() && {
            let t = hit.triangle as usize;
            (self.mesh.face_normal(t) * self.orientation.sign(t)).dot(direction) < 0.0
        };
        let shine = if front && self.lamps.is_emissive(hit.triangle as usize) {
            self.emitters
                .choose(from.position, from.normal, 0.0, choice);
            let other = self
                .emitters
                .pdf(self.lamps, choice, from.position, direction, hit);
            from.pdf * from.pdf / (from.pdf * from.pdf + other * other)
        } else {
            0.0
        };
        front.then(|| Tip {
            path: from.path,
            place: SurfacePoint {
                triangle: hit.triangle,
                u: hit.u,
                v: hit.v,
            },
            view: -direction,
            shine,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Plane;
    use crate::core::trace::BruteForce;
    use crate::radiance::SurfaceRadiance;
    use glam::Vec2;

    /// The inside of a unit cube: face k has a cell of a 3 × 2 atlas.
    fn cube() -> Mesh {
        let mut mesh = Mesh::default();
        for k in 0..6 {
            let axis = k / 2;
            let mut n = Vec3::ZERO;
            n[axis] = if k % 2 == 0 { 1.0 } else { -1.0 };
            let mut a = Vec3::ZERO;
            a[(axis + 1) % 3] = 1.0;
            let b = n.cross(a);
            let corner = Vec3::splat(0.5) - 0.5 * (n + a + b);
            let i = mesh.positions.len() as u32;
            mesh.positions
                .extend([corner, corner + a, corner + a + b, corner + b]);
            mesh.normals.extend([n; 4]);
            let (lo, size) = (
                Vec2::new((k % 3) as f32 / 3.0, (k / 3) as f32 / 2.0),
                Vec2::new(1.0 / 3.0, 0.5),
            );
            let inside = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y].map(|c| 0.1 + 0.8 * c);
            mesh.uvs.extend(inside.map(|c| lo + size * c));
            mesh.triangles
                .extend([[i, i + 1, i + 2], [i, i + 2, i + 3]]);
        }
        mesh
    }

    const SIDE: usize = 12;

    fn textures(albedo: f32, roughness: f32) -> Textures {
        Textures {
            albedo: LearnedTexture::filled(SIDE, [albedo; 3]),
            roughness: LearnedTexture::filled(SIDE, [roughness]),
            gain: LearnedTexture::filled(SIDE, [1.0; 3]),
        }
    }

    struct Room {
        mesh: Mesh,
        orientation: Orientation,
        tracer: BruteForce,
        lamps: LightField,
        emitters: Emitters,
        sky: Environment,
    }

    impl Room {
        /// Of which the first `shining` triangles are lamps of radiance 2.
        fn new(shining: usize) -> Self {
            let mesh = cube();
            let orientation = Orientation::of_winding(12);
            let emissive: Vec<bool> = (0..12).map(|t| t < shining).collect();
            let lamps = LightField::new(
                &mesh,
                &orientation,
                SurfaceRadiance {
                    radiance: Plane::filled(SIDE, SIDE, Vec3::splat(2.0)),
                    emissive: Plane::filled(SIDE, SIDE, true),
                    emissive_triangles: &emissive,
                    back: Vec::new(),
                },
                Environment::black(),
            );
            let tracer = BruteForce::new(&mesh);
            let probes: Vec<_> = (0..12)
                .map(|t| (mesh.position(t, 0.3, 0.3), mesh.face_normal(t)))
                .collect();
            let emitters = Emitters::new(&mesh, &lamps, &tracer, &probes);
            Self {
                mesh,
                orientation,
                tracer,
                lamps,
                emitters,
                sky: Environment::from_map(Plane::filled(2, 1, Vec3::splat(3.0))),
            }
        }

        fn scene(&self) -> PathScene<'_> {
            PathScene {
                mesh: &self.mesh,
                orientation: &self.orientation,
                tracer: &self.tracer,
                lamps: &self.lamps,
                emitters: &self.emitters,
                sky: &self.sky,
                offset: 1e-4,
            }
        }

        fn looks(&self, n: usize) -> Vec<Look> {
            let mut rng = KeyedRng::new(6, 1);
            (0..n)
                .map(|i| {
                    let (u, v) = (0.1 + 0.3 * rng.next_f32(), 0.1 + 0.3 * rng.next_f32());
                    let p = self.mesh.position(i % 12, u, v);
                    Look {
                        place: SurfacePoint {
                            triangle: (i % 12) as u32,
                            u,
                            v,
                        },
                        to_camera: (Vec3::splat(0.5) - p).normalize(),
                        radiance: Vec3::ZERO,
                    }
                })
                .collect()
        }
    }

    /// All walls shine alike: L = E/(1 − A) for the diffuse part alone, and the specular part
    /// reflects from 3 % (below F₀, by masking) to 12 % besides.
    #[test]
    fn a_furnace_is_as_bright_as_its_walls_make_it() {
        let room = Room::new(12);
        let textures = textures(0.3, 0.6);
        let paths = room.scene().trace(&room.looks(240), 32, &textures, 5, 0);
        let sum: f64 = paths
            .iter()
            .map(|p| f64::from(p.radiance(&textures).x))
            .sum();
        let mean = sum / paths.len() as f64;
        assert!(
            mean > 2.0 / (1.0 - 0.31) && mean < 2.0 / (1.0 - 0.42),
            "{mean}"
        );
    }

    #[test]
    fn lamps_are_counted_once_however_they_are_met() {
        let room = Room::new(2);
        let textures = textures(0.5, 0.4);
        let mean = |emitters: &Emitters| {
            let scene = PathScene {
                emitters,
                ..room.scene()
            };
            let paths = scene.trace(&room.looks(240), 256, &textures, 5, 0);
            let sum: f64 = paths
                .iter()
                .map(|p| f64::from(p.radiance(&textures).x))
                .sum();
            sum / paths.len() as f64
        };
        let none = Room::new(0).emitters;
        let (both, reflection) = (mean(&room.emitters), mean(&none));
        assert!(
            (both / reflection - 1.0).abs() < 0.02,
            "{both} {reflection}"
        );
    }

    /// Of surface under an even sky, what it reflects; its slope by albedo is the sky.
    #[test]
    fn rays_that_leave_the_geometry_meet_the_sky() {
        let room = Room::new(0);
        let nothing = BruteForce::new(&Mesh::default());
        let scene = PathScene {
            tracer: &nothing,
            ..room.scene()
        };
        let textures = textures(0.3, 0.6);
        let paths = scene.trace(&room.looks(240), 64, &textures, 5, 0);
        let (mut mean, mut by_albedo, mut slopes) = (0.0, 0.0, Vec::new());
        for path in &paths {
            mean += path.radiance(&textures).x / paths.len() as f32;
            path.adjoint(&textures, Vec3::X, &mut slopes);
        }
        for slope in &slopes {
            if let Slope::Albedo(_, by) = slope {
                by_albedo += by.x / paths.len() as f32;
            }
        }
        assert!(mean > 3.0 * 0.31 && mean < 3.0 * 0.42, "{mean}");
        assert!((by_albedo / 3.0 - 1.0).abs() < 0.02, "{by_albedo}");
    }

    #[test]
    fn the_adjoint_is_the_derivative_of_the_same_paths() {
        let room = Room::new(2);
        let mut textures = textures(0.5, 0.4);
        let looks = room.looks(48);
        let paths = room.scene().trace(&looks, 4, &textures, 9, 0);
        let mut rng = KeyedRng::new(4, 4);
        let by: Vec<Vec3> = paths
            .iter()
            .map(|_| Vec3::from_array(std::array::from_fn(|_| rng.next_f32() - 0.3)))
            .collect();
        let mut slopes = Vec::new();
        for (path, by) in paths.iter().zip(&by) {
            path.adjoint(&textures, *by, &mut slopes);
        }
        slopes.iter().for_each(|s| textures.add(s));
        let objective = |textures: &Textures| -> f64 {
            let values = paths.iter().zip(&by).map(|(p, by)| {
                p.radiance(textures)
                    .to_array()
                    .iter()
                    .zip(by.to_array())
                    .map(|(l, b)| f64::from(l * b))
                    .sum::<f64>()
            });
            values.sum()
        };
        // along the whole of each texture, and texel by texel
        let h = 1e-3;
        for texel in [None, Some(14), Some(40), Some(100)] {
            let chosen = |i: usize| texel.is_none_or(|t| t == i);
            let mut moved = |kind: usize, step: f32| {
                let texels = 0..SIDE * SIDE;
                match kind {
                    0 => texels.for_each(|i| {
                        textures
                            .albedo
                            .nudge(i, step * f32::from(u8::from(chosen(i))))
                    }),
                    1 => texels.for_each(|i| {
                        textures
                            .roughness
                            .nudge(i, step * f32::from(u8::from(chosen(i))))
                    }),
                    _ => texels.for_each(|i| {
                        textures
                            .gain
                            .nudge(i, step * f32::from(u8::from(chosen(i))))
                    }),
                }
                objective(&textures)
            };
            let central = [0, 1, 2].map(|k| {
                let (above, below) = (moved(k, h), moved(k, -2.0 * h));
                moved(k, h);
                (above - below) / f64::from(2.0 * h)
            });
            let sum_of = |g: Vec<f32>| g.iter().map(|g| f64::from(*g)).sum::<f64>();
            let own = [
                sum_of(textures.albedo.gradient_where(chosen)),
                sum_of(textures.roughness.gradient_where(chosen)),
                sum_of(textures.gain.gradient_where(chosen)),
            ];
            for k in 0..3 {
                let error = (own[k] - central[k]).abs();
                assert!(
                    error < 2e-3 * central[k].abs().max(0.3),
                    "texture {k} at {texel:?}: {} for {}",
                    own[k],
                    central[k]
                );
            }
        }
    }
}
