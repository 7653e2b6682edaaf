//! Paths from bounce to bounce.

use super::tracer::PathTracer;
use super::wave::{Feature, Following, Lobes, Path, PathKey, ShadowRay, Sums, Vertex, Wave};
use crate::brdf::{Material, Reflectance};
use crate::math::luminance;
use crate::render::point_light::PointLight;
use crate::sampling::{KeyedRng, SobolSequence};
use crate::trace::{Hit, Ray};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Paths per task.
pub(super) const WAVEFRONT: usize = 4096;
/// Ray origins move this many units in the last place of the largest coordinate off the surface.
const OFFSET_ULPS: f32 = 64.0;

fn power_heuristic(a: f32, b: f32) -> f32 {
    if a.is_infinite() {
        return 1.0;
    }
    let (a, b) = (a * a, b * b);
    if a + b > 0.0 && (a + b).is_finite() {
        a / (a + b)
    } else {
        0.5
    }
}

impl PathTracer<'_> {
    /// Follows the paths in `wave` until all have ended.
    pub(super) fn trace_wave(
        &self,
        wave: &mut Wave,
        keys: &[PathKey],
        sums: &mut [Sums],
        mut features: Option<&mut [Option<Feature>]>,
        following: Following<'_>,
        first_bounce: u32,
    ) {
        for bounce in first_bounce..self.options.max_bounces.max(first_bounce + 1) {
            if wave.paths.is_empty() {
                break;
            }
            wave.hits.clear();
            wave.hits.resize(wave.rays.len(), Hit::miss());
            self.tracer.closest(&wave.rays, &mut wave.hits);
            wave.next_paths.clear();
            wave.next_rays.clear();
            for i in 0..wave.paths.len() {
                let (path, hit, ray) = (wave.paths[i], wave.hits[i], wave.rays[i]);
                let direction = Vec3::from_array(ray.direction);
                let slot = path.slot as usize;
                if !hit.is_hit() {
                    let radiance = self.environment.radiance(direction);
                    if bounce == 0 {
                        sums[slot].emission += radiance;
                    } else {
                        let weight = power_heuristic(
                            path.pdf,
                            self.lights.environment_pdf(path.origin, direction),
                        );
                        self.deposit(&mut sums[slot], &path, radiance * weight, bounce);
                    }
                    continue;
                }
                let triangle = hit.triangle as usize;
                let surface = self.surfaces.surface(triangle, hit.u, hit.v);
                if surface.emission != Vec3::ZERO && self.emits_towards(triangle, direction) {
                    if bounce == 0 {
                        sums[slot].emission += surface.emission;
                    } else {
                        let distance = hit.t + self.offset(path.origin);
                        let other = self.lights.triangle_pdf(
                            path.origin,
                            direction,
                            distance,
                            hit.triangle,
                        );
                        self.deposit(
                            &mut sums[slot],
                            &path,
                            surface.emission * power_heuristic(path.pdf, other),
                            bounce,
                        );
                    }
                }
                let mut vertex = self.vertex(&hit, -direction, surface.material);
                if let Some(f) = features.as_deref_mut().filter(|_| bounce == 0) {
                    f[slot] = Some(Feature {
                        albedo: surface.material.albedo,
                        roughness: surface.material.roughness,
                        normal: vertex.normal,
                        depth: hit.t,
                        label: self.surfaces.label(triangle),
                    });
                }
                if bounce + 1 >= self.options.max_bounces {
                    continue;
                }
                if bounce == 0 && vertex.lobes == Lobes::Both {
                    vertex.lobes = following.first;
                }
                let known = if bounce == 0 {
                    following.known.first
                } else {
                    following.known.later
                };
                if let Some(cache) = known {
                    let view_factor = self
                        .reflectance
                        .diffuse_factor(vertex.normal.dot(vertex.view), surface.material.roughness);
                    let light = cache.irradiance(triangle, hit.u, hit.v)
                        * surface.material.albedo
                        * (FRAC_1_PI * view_factor);
                    if bounce == 0 {
                        sums[slot].diffuse += light;
                    } else {
                        self.deposit(&mut sums[slot], &path, light, bounce);
                        vertex.reference = luminance(path.beta * light);
                    }
                    if self.options.lambertian || vertex.lobes == Lobes::Neither {
                        continue;
                    }
                    vertex.lobes = Lobes::Specular;
                }
                self.scatter(&vertex, path, keys[slot], bounce, wave);
            }
            self.resolve_shadows(wave, sums);
            std::mem::swap(&mut wave.paths, &mut wave.next_paths);
            std::mem::swap(&mut wave.rays, &mut wave.next_rays);
        }
    }

    /// Whether a triangle's light leaves on the side that a ray along `direction` meets.
    fn emits_towards(&self, triangle: usize, direction: Vec3) -> bool {
        !self.surfaces.emits_forward_only() || self.mesh.face_normal(triangle).dot(direction) < 0.0
    }

    /// Adds radiance arriving along a path to the lobes of its first vertex.
    fn deposit(&self, sums: &mut Sums, path: &Path, radiance: Vec3, bounce: u32) {
        let mut light = path.beta * radiance;
        if let Some(limit) = self.options.clamp.filter(|_| bounce > 1) {
            light *= (limit / luminance(light).max(1e-20)).min(1.0);
        }
        sums.diffuse += path.first[0] * light;
        sums.specular += path.first[1] * light;
    }

    /// Distance by which origins near `p` are moved off the surface.
    fn offset(&self, p: Vec3) -> f32 {
        OFFSET_ULPS * f32::EPSILON * p.abs().max_element().max(self.offset_floor)
    }

    fn vertex(&self, hit: &Hit, view: Vec3, material: Material) -> Vertex {
        let t = hit.triangle as usize;
        let mut face_normal = self.mesh.face_normal(t);
        let mut normal = self.mesh.shading_normal(t, hit.u, hit.v);
        if face_normal.dot(view) < 0.0 {
            face_normal = -face_normal;
            normal = -normal;
        }
        // a smooth normal that turns away from the viewer at a silhouette would be black
        if self.options.flat || normal.dot(view) < 1e-3 {
            normal = face_normal;
        }
        let lobes = if self.options.lambertian {
            Lobes::Diffuse
        } else {
            Lobes::Both
        };
        Vertex {
            position: self.mesh.position(t, hit.u, hit.v),
            face_normal,
            normal,
            view,
            material,
            lobes,
            reference: 0.0,
        }
    }

    /// Next-event estimation and the continuation of a path at a vertex.
    pub(super) fn scatter(
        &self,
        vertex: &Vertex,
        path: Path,
        key: PathKey,
        bounce: u32,
        wave: &mut Wave,
    ) {
        let u = if bounce < 4 {
            SobolSequence::new(key.key, u64::from(bounce) + 1).point4(key.sample)
        } else {
            let mut rng = KeyedRng::new(key.key, (u64::from(bounce) << 32) | u64::from(key.sample));
            std::array::from_fn(|_| rng.next_f32())
        };
        let (n, v, m) = (vertex.normal, vertex.view, vertex.material);
        if n.dot(v) <= 0.0 {
            return;
        }
        let share = match vertex.lobes {
            Lobes::Both => m.specular_share(n.dot(v)),
            Lobes::Diffuse | Lobes::Neither => 0.0,
            Lobes::Specular => 1.0,
        };
        let first = bounce == 0;
        let offset = self.offset(vertex.position);
        let origin = vertex.position + vertex.face_normal * offset;
        // diffuse and specular BRDF·cos/pdf for a direction
        let lobes = |l: Vec3, pdf: f32| {
            let scale = n.dot(l) / pdf;
            let diffuse = match vertex.lobes {
                Lobes::Specular | Lobes::Neither => Vec3::ZERO,
                Lobes::Diffuse => m.albedo * (FRAC_1_PI * scale),
                Lobes::Both => {
                    m.albedo
                        * (FRAC_1_PI
                            * scale
                            * self
                                .reflectance
                                .diffuse(n.dot(l), n.dot(v), v.dot(l), m.roughness))
                }
            };
            let specular = match (vertex.lobes, self.reflectance) {
                (Lobes::Diffuse | Lobes::Neither, _) => 0.0,
                (_, Reflectance::Paper) => m.specular_lobe(n, v, l) * scale,
                (_, other) => other.specular_lobe(n, v, l, m.roughness) * scale,
            };
            (diffuse, Vec3::splat(specular))
        };
        let above = |l: Vec3| n.dot(l) > 0.0 && vertex.face_normal.dot(l) > 0.0;
        let advance = |(diffuse, specular): (Vec3, Vec3)| {
            if first {
                Path {
                    first: [diffuse, specular],
                    ..path
                }
            } else {
                Path {
                    beta: path.beta * (diffuse + specular),
                    ..path
                }
            }
        };
        if let Some(s) = self
            .lights
            .sample(vertex.position, [u[0], u[1]])
            .filter(|s| above(s.direction))
        {
            let pdf = m.pdf_with_share(n, v, s.direction, share);
            let weight = power_heuristic(s.pdf, pdf);
            let radiance = match s.hit {
                Some((t, _, _)) if !self.emits_towards(t as usize, s.direction) => Vec3::ZERO,
                Some((t, b1, b2)) => self.surfaces.surface(t as usize, b1, b2).emission,
                None => self.environment.radiance(s.direction),
            };
            let mut light = Sums::default();
            self.deposit(
                &mut light,
                &advance(lobes(s.direction, s.pdf)),
                radiance * weight,
                bounce + 1,
            );
            // beside the diffuse light of a cached vertex a faint highlight is worth a shadow ray
            // only now and then
            let worth = luminance(advance(lobes(s.direction, s.pdf)).beta * radiance * weight);
            let keep = if vertex.reference > 0.0 {
                (2.0 * worth / vertex.reference).clamp(0.1, 1.0)
            } else {
                1.0
            };
            let kept = keep >= 1.0
                || KeyedRng::new(
                    key.key ^ 0xa11e,
                    (u64::from(bounce) << 32) | u64::from(key.sample),
                )
                .next_f32()
                    < keep;
            if kept && light.diffuse + light.specular != Vec3::ZERO {
                // from the moved origin the same point of the light is aimed at; the end stays
                // clear of it
                let (direction, t_far) = if s.distance.is_finite() {
                    let d = vertex.position + s.direction * s.distance - origin;
                    (d.normalize(), d.length() * (1.0 - 1e-4) - offset)
                } else {
                    (s.direction, f32::INFINITY)
                };
                wave.shadow.push(ShadowRay {
                    slot: path.slot,
                    diffuse: light.diffuse / keep,
                    specular: light.specular / keep,
                });
                wave.shadow_rays
                    .push(Ray::new(origin, direction, t_far.max(0.0)));
            }
        }
        if let Some((light, share)) = self.choose_point(&vertex.position, key, bounce) {
            let d = light.position - origin;
            let distance = d.length();
            let l = d / distance.max(1e-9);
            if above(l) {
                let radiance = light.towards(-l) / (distance * distance).max(1e-12);
                let mut sums = Sums::default();
                self.deposit(&mut sums, &advance(lobes(l, share)), radiance, bounce + 1);
                if sums.diffuse + sums.specular != Vec3::ZERO {
                    wave.shadow.push(ShadowRay {
                        slot: path.slot,
                        diffuse: sums.diffuse,
                        specular: sums.specular,
                    });
                    wave.shadow_rays
                        .push(Ray::new(origin, l, (distance * (1.0 - 1e-4)).max(0.0)));
                }
            }
        }
        // the first number also chooses the lobe and is stretched back to [0, 1)
        let specular = u[2] < share;
        let u2 = if specular {
            u[2] / share
        } else {
            (u[2] - share) / (1.0 - share).max(1e-6)
        };
        let Some(l) = m
            .sample_direction(n, v, specular, [u2.clamp(0.0, 1.0 - 1e-7), u[3]])
            .filter(|&l| above(l))
        else {
            return;
        };
        let pdf = m.pdf_with_share(n, v, l, share);
        let mut next = advance(lobes(l, pdf));
        next.pdf = pdf;
        next.origin = vertex.position;
        let strength = next.beta.max_element();
        if !(pdf > 0.0
            && strength > 0.0
            && next.beta.is_finite()
            && next.first.iter().all(|f| f.is_finite()))
        {
            return;
        }
        let survival = if vertex.lobes == Lobes::Specular && !first {
            (next.beta.max_element() / path.beta.max_element()).clamp(0.05, 1.0)
        } else if bounce >= self.options.roulette_from {
            (strength * next.first[0].max(next.first[1]).max_element().min(1.0)).clamp(0.05, 0.95)
        } else {
            1.0
        };
        if survival < 1.0 {
            let mut rng = KeyedRng::new(
                key.key ^ 0x5f5f,
                (u64::from(bounce) << 32) | u64::from(key.sample),
            );
            if rng.next_f32() >= survival {
                return;
            }
            next.beta /= survival;
        }
        wave.next_paths.push(next);
        wave.next_rays.push(Ray::new(origin, l, f32::INFINITY));
    }

    /// One of the lights without extent, chosen by what it could send to `p`, with its probability.
    fn choose_point(&self, p: &Vec3, key: PathKey, bounce: u32) -> Option<(&PointLight, f32)> {
        let worth = |l: &PointLight| {
            let d = *p - l.position;
            luminance(l.towards(d.normalize_or_zero())) / d.length_squared().max(1e-6)
        };
        let total: f32 = self.points.iter().map(worth).sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        let mut rng = KeyedRng::new(
            key.key ^ 0x90_1e75,
            (u64::from(bounce) << 32) | u64::from(key.sample),
        );
        let mut rest = rng.next_f32() * total;
        let mut chosen = None;
        for l in &self.points {
            let w = worth(l);
            if w > 0.0 {
                chosen = Some((l, w / total));
                rest -= w;
                if rest < 0.0 {
                    break;
                }
            }
        }
        chosen
    }

    pub(super) fn resolve_shadows(&self, wave: &mut Wave, sums: &mut [Sums]) {
        wave.occluded.clear();
        wave.occluded.resize(wave.shadow_rays.len(), 0);
        self.tracer.occluded(&wave.shadow_rays, &mut wave.occluded);
        for (s, _) in wave
            .shadow
            .iter()
            .zip(&wave.occluded)
            .filter(|(_, o)| **o == 0)
        {
            sums[s.slot as usize].diffuse += s.diffuse;
            sums[s.slot as usize].specular += s.specular;
        }
        wave.shadow.clear();
        wave.shadow_rays.clear();
    }
}
