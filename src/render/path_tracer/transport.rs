//! Paths from bounce to bounce.

use super::scene::Surface;
use super::tracer::PathTracer;
use super::wave::{Feature, Following, Lobes, Path, PathKey, ShadowRay, Sums, Vertex, Wave};
use crate::core::brdf::Reflectance;
use crate::core::math::luminance;
use crate::core::sampling::{KeyedRng, SobolSequence};
use crate::core::trace::{Hit, Ray};
use crate::lights::LightSampler;
use crate::render::point_light::PointLight;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Paths per task.
pub(super) const WAVEFRONT: usize = 4096;
/// Ray origins move this many units in the last place of the largest coordinate off the surface.
const OFFSET_ULPS: f32 = 64.0;
/// Directions drawn by a surface per direction drawn towards a light.
const SURFACE_RAYS: f32 = 1.0;

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

/// A path that arrives somewhere: at a surface, or in the environment if `hit` is a miss.
struct Arrival {
    path: Path,
    hit: Hit,
    direction: Vec3,
    bounce: u32,
}

/// Diffuse and specular BRDF·cos/pdf of a direction.
struct Factors {
    diffuse: Vec3,
    specular: Vec3,
}

/// A path at a vertex: what next-event estimation and its continuation share.
struct Scattering<'a> {
    vertex: &'a Vertex,
    path: Path,
    key: PathKey,
    bounce: u32,
    reflectance: Reflectance,
    /// Whether the diffuse part lies below the lobe.
    layered: bool,
    /// Probability with which the specular lobe draws the next direction.
    share: f32,
    /// Where rays start: off the surface by `offset`.
    origin: Vec3,
    offset: f32,
}

impl Scattering<'_> {
    /// The factors of a light's or a continued path's direction `l`, drawn with density `pdf`.
    fn factors(&self, l: Vec3, pdf: f32) -> Factors {
        let (n, v, m) = (self.vertex.normal, self.vertex.view, self.vertex.material);
        let scale = n.dot(l) / pdf;
        let diffuse = match self.vertex.lobes {
            Lobes::Specular | Lobes::Neither => Vec3::ZERO,
            Lobes::Diffuse => m.albedo * (FRAC_1_PI * scale),
            Lobes::Both => {
                let beyond_lambert =
                    self.reflectance
                        .diffuse(n.dot(l), n.dot(v), v.dot(l), m.roughness);
                m.albedo * (FRAC_1_PI * scale * beyond_lambert * self.let_through(v, l))
            }
        };
        let specular = match (self.vertex.lobes, self.reflectance) {
            (Lobes::Diffuse | Lobes::Neither, _) => 0.0,
            (_, Reflectance::Paper) => m.specular_lobe(n, v, l) * scale,
            (_, other) => other.specular_lobe(n, v, l, m.roughness) * scale,
        };
        Factors {
            diffuse,
            specular: specular * self.vertex.metal_share(self.reflectance, v, l),
        }
    }

    /// What the lobe lets through to the diffuse part.
    fn let_through(&self, v: Vec3, l: Vec3) -> f32 {
        if !self.layered {
            return 1.0;
        }
        // 2 cos² of the half angle = 1 + v·l
        let v_h = (0.5 * (1.0 + v.dot(l))).clamp(0.0, 1.0).sqrt();
        1.0 - self.reflectance.fresnel(v_h)
    }

    /// Whether `l` leaves the surface, by its shading normal and by its face.
    fn above(&self, l: Vec3) -> bool {
        self.vertex.normal.dot(l) > 0.0 && self.vertex.face_normal.dot(l) > 0.0
    }

    /// The path beyond the vertex.
    fn advance(&self, factors: &Factors) -> Path {
        if self.bounce == 0 {
            Path {
                first: [factors.diffuse, factors.specular],
                ..self.path
            }
        } else {
            Path {
                beta: self.path.beta * (factors.diffuse + factors.specular),
                ..self.path
            }
        }
    }

    /// Random numbers of this vertex for one purpose.
    fn rng(&self, purpose: u64) -> KeyedRng {
        self.key.rng(purpose, self.bounce)
    }
}

impl PathKey {
    /// Random numbers of a vertex of the path for one purpose.
    fn rng(self, purpose: u64, bounce: u32) -> KeyedRng {
        KeyedRng::new(
            self.key ^ purpose,
            (u64::from(bounce) << 32) | u64::from(self.sample),
        )
    }

    /// The four numbers that choose light and continuation at a vertex.
    fn numbers(self, bounce: u32) -> [f32; 4] {
        if bounce < 4 {
            SobolSequence::new(self.key, u64::from(bounce) + 1).point4(self.sample)
        } else {
            let mut rng = self.rng(0, bounce);
            std::array::from_fn(|_| rng.next_f32())
        }
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
            self.find_hits(wave, bounce);
            wave.next_paths.clear();
            wave.next_rays.clear();
            for i in 0..wave.paths.len() {
                let mut arrival = Arrival {
                    path: wave.paths[i],
                    hit: wave.hits[i],
                    direction: Vec3::from_array(wave.rays[i].direction),
                    bounce,
                };
                let (hit, slot) = (arrival.hit, arrival.path.slot as usize);
                if !hit.is_hit() {
                    self.add_environment(&arrival, &mut wave.choice, &mut sums[slot]);
                    continue;
                }
                let triangle = hit.triangle as usize;
                let surface = self.surfaces.surface(triangle, hit.u, hit.v);
                if bounce > 0 {
                    arrival.path.beta *= self.weight_of_stopped(arrival.direction, &hit, &surface);
                }
                let emission = surface.emission;
                self.add_emission(&arrival, emission, &mut wave.choice, &mut sums[slot]);
                let mut vertex = self.vertex(&hit, -arrival.direction, &surface);
                if let Some(f) = features.as_deref_mut().filter(|_| bounce == 0) {
                    let albedo = arrival.path.beta * vertex.material.albedo;
                    let feature = f[slot].get_or_insert_with(|| Feature {
                        base: surface.base,
                        transmission: surface.transmission,
                        albedo: Vec3::ZERO,
                        roughness: surface.roughness,
                        normal: Vec3::ZERO,
                        depth: 0.0,
                        label: self.surfaces.label(triangle),
                    });
                    feature.albedo += albedo;
                    (feature.normal, feature.depth) = (vertex.normal, hit.t);
                }
                if bounce + 1 >= self.options.max_bounces {
                    continue;
                }
                if self.goes_on(&arrival, &mut vertex, following, &mut sums[slot]) {
                    self.scatter(&vertex, arrival.path, keys[slot], bounce, wave);
                }
            }
            self.resolve_shadows(wave, sums);
            std::mem::swap(&mut wave.paths, &mut wave.next_paths);
            std::mem::swap(&mut wave.rays, &mut wave.next_rays);
        }
    }

    /// Adds the environment's light to a path that leaves the scene.
    fn add_environment(&self, arrival: &Arrival, choice: &mut LightSampler, sums: &mut Sums) {
        let (path, direction) = (&arrival.path, arrival.direction);
        let radiance = self.environment.radiance(direction);
        if arrival.bounce == 0 {
            sums.emission += path.beta * radiance;
        } else {
            let other = self
                .choose_lights(path.origin, path.normal, choice)
                .map_or(0.0, |c| self.emitters.miss_pdf(c, path.origin, direction));
            let weight = power_heuristic(path.pdf, other);
            self.deposit(sums, path, radiance * weight, arrival.bounce);
        }
    }

    /// Adds what the surface that a path meets emits towards it.
    fn add_emission(
        &self,
        arrival: &Arrival,
        emission: Vec3,
        choice: &mut LightSampler,
        sums: &mut Sums,
    ) {
        let (path, hit, direction) = (&arrival.path, &arrival.hit, arrival.direction);
        if emission == Vec3::ZERO || !self.emits_towards(hit.triangle as usize, direction) {
            return;
        }
        if arrival.bounce == 0 {
            sums.emission += path.beta * emission;
        } else {
            let normal = self.mesh.face_normal(hit.triangle as usize);
            let hit = Hit {
                t: hit.t + self.offset(path.origin),
                ..*hit
            };
            let cosine = normal.dot(direction).abs();
            let other = self
                .choose_lights(path.origin, path.normal, choice)
                .map_or(0.0, |c| self.emitters.hit_pdf(c, &hit, cosine));
            let weight = power_heuristic(path.pdf, other);
            self.deposit(sums, path, emission * weight, arrival.bounce);
        }
    }

    /// Chooses the lobes followed at a vertex, and adds its diffuse light where that is known.
    /// Whether anything is left to follow.
    fn goes_on(
        &self,
        arrival: &Arrival,
        vertex: &mut Vertex,
        following: Following<'_>,
        sums: &mut Sums,
    ) -> bool {
        let (hit, first) = (&arrival.hit, arrival.bounce == 0);
        if first && vertex.lobes == Lobes::Both {
            vertex.lobes = following.first;
        }
        let known = if first {
            following.known.first
        } else {
            following.known.later
        };
        let Some(cache) = known else {
            return true;
        };
        let material = vertex.material;
        let view_factor = self
            .reflectance
            .diffuse_factor(vertex.normal.dot(vertex.view), material.roughness);
        let light = cache.irradiance(hit.triangle as usize, hit.u, hit.v)
            * material.albedo
            * (FRAC_1_PI * view_factor);
        if first {
            sums.diffuse += arrival.path.beta * light;
        } else {
            self.deposit(sums, &arrival.path, light, arrival.bounce);
            vertex.reference = luminance(arrival.path.beta * light);
        }
        if self.options.lambertian || vertex.lobes == Lobes::Neither {
            return false;
        }
        vertex.lobes = Lobes::Specular;
        true
    }

    /// How a vertex chooses among the lights; `None` where none can send it any.
    fn choose_lights<'c>(
        &self,
        p: Vec3,
        normal: Vec3,
        choice: &'c mut LightSampler,
    ) -> Option<&'c LightSampler> {
        if self.emitters.is_empty() {
            return None;
        }
        self.emitters.choose(p, normal, SURFACE_RAYS, choice);
        (!choice.is_empty()).then_some(choice)
    }

    /// Whether a triangle's light leaves on the side that a ray along `direction` meets.
    fn emits_towards(&self, triangle: usize, direction: Vec3) -> bool {
        !self.surfaces.emits_forward_only(triangle)
            || self.mesh.face_normal(triangle).dot(direction) < 0.0
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

    fn vertex(&self, hit: &Hit, view: Vec3, surface: &Surface) -> Vertex {
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
            material: surface.material(),
            f0: surface.base.f0(),
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
        let [u0, u1, u2, u3] = key.numbers(bounce);
        let cos_view = vertex.normal.dot(vertex.view);
        if cos_view <= 0.0 {
            return;
        }
        let share = match vertex.lobes {
            Lobes::Both => vertex.material.specular_share(cos_view),
            Lobes::Diffuse | Lobes::Neither => 0.0,
            Lobes::Specular => 1.0,
        };
        let offset = self.offset(vertex.position);
        let scattering = Scattering {
            vertex,
            path,
            key,
            bounce,
            reflectance: self.reflectance,
            layered: self.layered,
            share,
            origin: vertex.position + vertex.face_normal * offset,
            offset,
        };
        self.sample_light(&scattering, [u0, u1], wave);
        self.sample_point_light(&scattering, wave);
        self.continue_path(&scattering, [u2, u3], wave);
    }

    /// Next-event estimation: a shadow ray to a point of a light or of the environment.
    fn sample_light(&self, s: &Scattering<'_>, u: [f32; 2], wave: &mut Wave) {
        let vertex = s.vertex;
        let (from, model) = (vertex.position, self.light_model());
        let Some(sample) = self
            .choose_lights(from, vertex.normal, &mut wave.choice)
            .and_then(|c| self.emitters.sample_point(self.mesh, &model, c, from, u))
            .filter(|sample| s.above(sample.direction))
        else {
            return;
        };
        let towards = sample.direction;
        let pdf = vertex
            .material
            .pdf_with_share(vertex.normal, vertex.view, towards, s.share);
        let weight = power_heuristic(sample.pdf, pdf);
        let radiance = match sample.place {
            Some((t, b1, b2)) => self.surfaces.surface(t as usize, b1, b2).emission,
            None => self.environment.radiance(towards),
        };
        let next = s.advance(&s.factors(towards, sample.pdf));
        let mut light = Sums::default();
        self.deposit(&mut light, &next, radiance * weight, s.bounce + 1);
        // beside the diffuse light of a cached vertex a faint highlight is worth a shadow ray
        // only now and then
        let worth = luminance(next.beta * radiance * weight);
        let keep = if vertex.reference > 0.0 {
            (2.0 * worth / vertex.reference).clamp(0.1, 1.0)
        } else {
            1.0
        };
        let kept = keep >= 1.0 || s.rng(0xa11e).next_f32() < keep;
        if !kept || light.diffuse + light.specular == Vec3::ZERO {
            return;
        }
        // from the moved origin the same point of the light is aimed at; the end stays clear of it
        let (direction, t_far) = if sample.distance.is_finite() {
            let d = vertex.position + towards * sample.distance - s.origin;
            (d.normalize(), d.length() * (1.0 - 1e-4) - s.offset)
        } else {
            (towards, f32::INFINITY)
        };
        wave.shadow.push(ShadowRay {
            slot: s.path.slot,
            diffuse: light.diffuse / keep,
            specular: light.specular / keep,
        });
        wave.shadow_rays
            .push(Ray::new(s.origin, direction, t_far.max(0.0)));
    }

    /// Next-event estimation of the lights without extent.
    fn sample_point_light(&self, s: &Scattering<'_>, wave: &mut Wave) {
        let Some((light, share)) = self.choose_point(&s.vertex.position, s.key, s.bounce) else {
            return;
        };
        let arriving = light.arriving(s.origin);
        let l = arriving.direction;
        if !s.above(l) {
            return;
        }
        let next = s.advance(&s.factors(l, share));
        let mut sums = Sums::default();
        self.deposit(&mut sums, &next, arriving.irradiance, s.bounce + 1);
        if sums.diffuse + sums.specular != Vec3::ZERO {
            wave.shadow.push(ShadowRay {
                slot: s.path.slot,
                diffuse: sums.diffuse,
                specular: sums.specular,
            });
            let t_far = (arriving.distance * (1.0 - 1e-4)).max(0.0);
            // a start below 0 counts as 0: it only tells the rays of many paths apart, of which what
            // covers a share stops a share
            wave.shadow_rays.push(Ray {
                t_near: -s.rng(0x7e_a4).next_f32(),
                ..Ray::new(s.origin, l, t_far)
            });
        }
    }

    /// Draws the path's next direction, and whether it survives.
    fn continue_path(&self, s: &Scattering<'_>, u: [f32; 2], wave: &mut Wave) {
        let (vertex, share) = (s.vertex, s.share);
        let (n, v, m) = (vertex.normal, vertex.view, vertex.material);
        // the first number also chooses the lobe and is stretched back to [0, 1)
        let specular = u[0] < share;
        let stretched = if specular {
            u[0] / share
        } else {
            (u[0] - share) / (1.0 - share).max(1e-6)
        };
        let Some(l) = m
            .sample_direction(n, v, specular, [stretched.clamp(0.0, 1.0 - 1e-7), u[1]])
            .filter(|&l| s.above(l))
        else {
            return;
        };
        let pdf = m.pdf_with_share(n, v, l, share);
        let mut next = s.advance(&s.factors(l, pdf));
        next.pdf = pdf;
        next.origin = vertex.position;
        next.normal = vertex.normal;
        if !(pdf > 0.0
            && next.beta.max_element() > 0.0
            && next.beta.is_finite()
            && next.first.iter().all(|f| f.is_finite()))
        {
            return;
        }
        let survival = self.survival(s, &next);
        if survival < 1.0 {
            if s.rng(0x5f5f).next_f32() >= survival {
                return;
            }
            next.beta /= survival;
        }
        wave.next_paths.push(next);
        wave.next_rays.push(Ray::new(s.origin, l, f32::INFINITY));
    }

    /// Russian roulette: the probability that a path goes on as `next`.
    fn survival(&self, s: &Scattering<'_>, next: &Path) -> f32 {
        let strength = next.beta.max_element();
        if s.vertex.lobes == Lobes::Specular && s.bounce > 0 {
            (strength / s.path.beta.max_element()).clamp(0.05, 1.0)
        } else if s.bounce >= self.options.roulette_from {
            (strength * next.first[0].max(next.first[1]).max_element().min(1.0)).clamp(0.05, 0.95)
        } else {
            1.0
        }
    }

    /// One of the lights without extent, chosen by what it could send to `p`, with its probability.
    fn choose_point(&self, p: &Vec3, key: PathKey, bounce: u32) -> Option<(&PointLight, f32)> {
        let worth = |l: &PointLight| luminance(l.arriving(*p).irradiance);
        let total: f32 = self.points.iter().map(worth).sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        let mut rng = key.rng(0x90_1e75, bounce);
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
        self.find_occluded(wave);
        let found = wave.shadow.iter().zip(&wave.occluded);
        for (s, _) in found.filter(|(_, o)| **o == 0) {
            sums[s.slot as usize].diffuse += s.diffuse;
            sums[s.slot as usize].specular += s.specular;
        }
        wave.shadow.clear();
        wave.shadow_rays.clear();
    }
}
