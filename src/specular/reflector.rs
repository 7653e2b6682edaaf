//! Specular reflection of the light field: L_s(R) = ∫ L(l) f_s(v, l; R) (n·l) dl at surface points
//! seen from given directions.
//!
//! Directions come from a mixture of visible-normal GGX lobes and emitter samples (balance
//! heuristic), so that one set of traced rays serves any number of roughness levels R (method §12.3
//! point 6); the radiance along a ray is averaged over the cone the ray stands for.

use crate::core::brdf::{
    DIELECTRIC, MIN_ROUGHNESS, Reflectance, SpecularLobe, over_dielectric, sample_vndf,
    vndf_reflection_pdf,
};
use crate::core::math::{Frame, luminance};
use crate::core::sampling::SobolSequence;
use crate::core::trace::{Hit, Ray};
use crate::lights::LightSampler;
use crate::lights::LitScene;
use crate::lights::SamplerCache;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;
use std::ops::Range;

/// Gazes per batch of rays.
const BATCH: usize = 48;

/// A surface point seen from a direction.
#[derive(Clone, Copy, Debug)]
pub struct ShadingPoint {
    /// Position on the surface.
    pub position: Vec3,
    /// Unit shading normal on the seen side.
    pub normal: Vec3,
    /// Unit geometric normal on the seen side.
    pub face_normal: Vec3,
    /// Unit direction towards the viewer.
    pub view: Vec3,
    /// Key of its random numbers.
    pub key: u64,
    /// Which block of that key's sample points it takes: gazes may share a key and take turns.
    pub turn: u32,
}

/// The roughness values (and lobes) rays are drawn for and responses evaluated at.
#[derive(Clone, Copy, Debug)]
pub enum Levels<'a> {
    /// All gazes share the lobes and the evaluated roughness levels.
    Shared {
        /// Roughness of the sampled lobes.
        lobes: &'a [f32],
        /// Roughness levels evaluated.
        evaluate: &'a [f32],
        /// What is evaluated at every level: the output of a gaze is models × levels.
        models: &'a [SpecularLobe],
    },
    /// Every gaze has its own roughness, sampled and evaluated.
    Own(Own<'a>),
}

/// Lobes gaze by gaze, of the reflector's model.
#[derive(Clone, Copy, Debug)]
pub struct Own<'a> {
    /// Roughness.
    pub roughness: &'a [f32],
    /// Reflectance at normal incidence; empty where there is no metal.
    pub f0: &'a [Vec3],
}

impl<'a> Own<'a> {
    /// Gazes at no metal.
    #[must_use]
    pub fn dielectric(roughness: &'a [f32]) -> Self {
        Self { roughness, f0: &[] }
    }

    /// Those of some gazes.
    fn part(&self, range: Range<usize>) -> Self {
        Self {
            roughness: &self.roughness[range.clone()],
            f0: if self.f0.is_empty() {
                &[]
            } else {
                &self.f0[range]
            },
        }
    }
}

/// Estimates specular reflection.
pub struct Reflector<'a> {
    /// Scene and light.
    pub lit: &'a LitScene<'a>,
    /// Rays per lobe.
    pub rays_per_lobe: u32,
    /// Emitter samples per gaze.
    pub emitter_samples: u32,
    /// Reflection model.
    pub model: Reflectance,
    /// Seed of the sample points.
    pub seed: u64,
}

#[derive(Default)]
struct Scratch {
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    gaze_of_ray: Vec<u32>,
    shadow: Vec<Ray>,
    hidden: Vec<u8>,
    light: Vec<(u32, Vec3, f32)>,
    /// Which lamps are asked, and by which gaze.
    choices: SamplerCache,
    choice_of: Vec<usize>,
}

impl Reflector<'_> {
    /// Adds to `out[i · K + k]` the specular radiance of gaze i at its k-th evaluated level (K
    /// levels). Returns the rays traced.
    pub fn reflect(&self, gazes: &[ShadingPoint], levels: Levels, out: &mut [Vec3]) -> u64 {
        self.reflect_and_spread(gazes, levels, out, &mut [])
    }

    /// As [`Self::reflect`]; also writes for every gaze how Burley's diffuse radiance towards it
    /// compares with a Lambertian surface's in the same light, as a polynomial in the roughness
    /// ([`Reflectance::diffuse_by_roughness`], averaged over the arriving light). `diffuse` holds
    /// one entry per gaze, or none if nobody asks.
    pub fn reflect_and_spread(
        &self,
        gazes: &[ShadingPoint],
        levels: Levels,
        out: &mut [Vec3],
        diffuse: &mut [[f32; 3]],
    ) -> u64 {
        let k = match levels {
            Levels::Shared {
                evaluate, models, ..
            } => evaluate.len() * models.len(),
            Levels::Own(_) => 1,
        };
        let mut scratch = Scratch::default();
        let mut rays = 0;
        for (b, group) in gazes.chunks(BATCH).enumerate() {
            let first = b * BATCH;
            let own = match levels {
                Levels::Own(own) => Levels::Own(own.part(first..first + group.len())),
                shared @ Levels::Shared { .. } => shared,
            };
            let spread = if diffuse.is_empty() {
                &mut [][..]
            } else {
                &mut diffuse[first..first + group.len()]
            };
            rays += self.batch(
                group,
                own,
                &mut scratch,
                &mut out[first * k..(first + group.len()) * k],
                spread,
            );
        }
        rays
    }

    fn batch(
        &self,
        gazes: &[ShadingPoint],
        levels: Levels,
        s: &mut Scratch,
        out: &mut [Vec3],
        diffuse: &mut [[f32; 3]],
    ) -> u64 {
        s.rays.clear();
        s.gaze_of_ray.clear();
        s.shadow.clear();
        s.light.clear();
        let (mut choices, mut choice_of) = (
            std::mem::take(&mut s.choices),
            std::mem::take(&mut s.choice_of),
        );
        choices.clear();
        choice_of.clear();
        choice_of.extend(
            gazes
                .iter()
                .map(|g| choices.choose(self.lit.emitters, g.position, g.normal, 0.0)),
        );
        for (i, g) in gazes.iter().enumerate() {
            self.lobe_rays(i, g, lobes(&levels, i), s);
            let choice = &choices[choice_of[i]];
            if !choice.is_empty() {
                self.emitter_rays(i, g, choice, s);
            }
        }
        s.hits.resize(s.rays.len(), Hit::miss());
        self.lit.tracer.closest(&s.rays, &mut s.hits);
        s.hidden.resize(s.shadow.len(), 0);
        self.lit.tracer.occluded(&s.shadow, &mut s.hidden);
        let mut shading = vec![Spread::default(); diffuse.len()];
        for (r, hit) in s.hits.iter().enumerate() {
            let i = s.gaze_of_ray[r] as usize;
            let g = &gazes[i];
            let l = Vec3::from_array(s.rays[r].direction);
            let origin = Vec3::from_array(s.rays[r].origin);
            let emitter_pdf =
                self.lit
                    .emitters
                    .pdf(self.lit.field, &choices[choice_of[i]], origin, l, hit);
            let half = HalfVector::new(g, l);
            let density = self.density(&half, lobes(&levels, i), emitter_pdf);
            let spread = 2.0 * (FRAC_1_PI / density.max(0.3)).sqrt();
            let radiance = self.lit.field.arriving(hit, l, spread);
            accumulate(self.model, &half, radiance / density, &levels, i, out);
            shading
                .get_mut(i)
                .into_iter()
                .for_each(|s| s.add(&half, radiance / density));
        }
        for (k, &(i, radiance, pdf)) in s.light.iter().enumerate() {
            if s.hidden[k] == 0 {
                let i = i as usize;
                let half = HalfVector::new(&gazes[i], Vec3::from_array(s.shadow[k].direction));
                let density = self.density(&half, lobes(&levels, i), pdf);
                accumulate(self.model, &half, radiance / density, &levels, i, out);
                shading
                    .get_mut(i)
                    .into_iter()
                    .for_each(|s| s.add(&half, radiance / density));
            }
        }
        diffuse
            .iter_mut()
            .zip(&shading)
            .for_each(|(d, s)| *d = s.mean());
        (s.choices, s.choice_of) = (choices, choice_of);
        (s.rays.len() + s.shadow.len()) as u64
    }

    /// Expected number of samples per steradian of the whole mixture.
    fn density(&self, half: &HalfVector, lobes: &[f32], emitter_pdf: f32) -> f32 {
        let lobe_sum: f32 = lobes
            .iter()
            .map(|r| vndf_reflection_pdf(half.n_v, half.sin2_nh, alpha(*r)))
            .sum();
        self.rays_per_lobe as f32 * lobe_sum + self.emitter_samples as f32 * emitter_pdf
    }

    fn lobe_rays(&self, i: usize, g: &ShadingPoint, lobes: &[f32], s: &mut Scratch) {
        let frame = Frame::from_normal(g.normal);
        let mut view = frame.local_from_world(g.view);
        view.z = view.z.max(MIN_COSINE);
        let view = view.normalize();
        let origin = g.position + g.face_normal * self.lit.offset;
        for (k, &roughness) in lobes.iter().enumerate() {
            let sequence = SobolSequence::new(self.seed.wrapping_add(k as u64), g.key);
            for j in g.turn * self.rays_per_lobe..(g.turn + 1) * self.rays_per_lobe {
                let h = sample_vndf(view, alpha(roughness), sequence.point2(j));
                let l_local = h * (2.0 * view.dot(h)) - view;
                let l = frame.world_from_local(l_local);
                if l_local.z > 0.0 && l.dot(g.face_normal) > 0.0 {
                    s.rays.push(Ray::new(origin, l, f32::INFINITY));
                    s.gaze_of_ray.push(i as u32);
                }
            }
        }
    }

    fn emitter_rays(&self, i: usize, g: &ShadingPoint, choice: &LightSampler, s: &mut Scratch) {
        let origin = g.position + g.face_normal * self.lit.offset;
        let sequence = SobolSequence::new(self.seed ^ 0x11_9474, g.key);
        for j in g.turn * self.emitter_samples..(g.turn + 1) * self.emitter_samples {
            let Some(e) =
                self.lit
                    .emitters
                    .sample(self.lit.field, choice, origin, sequence.point3(j))
            else {
                continue;
            };
            let l = Vec3::from_array(e.ray.direction);
            if g.normal.dot(l) > 0.0 && g.face_normal.dot(l) > 0.0 {
                s.shadow.push(e.ray);
                s.light.push((i as u32, e.radiance, e.pdf));
            }
        }
    }
}

/// Below this cosine the view counts as grazing: the model's terms stay finite.
const MIN_COSINE: f32 = 1e-3;

/// α of a roughness from a texture, which may hold a mirror's 0.
fn alpha(roughness: f32) -> f32 {
    let r = roughness.max(MIN_ROUGHNESS);
    r * r
}

struct HalfVector {
    n_l: f32,
    n_v: f32,
    sin2_nh: f32,
    v_h: f32,
}

impl HalfVector {
    fn new(g: &ShadingPoint, l: Vec3) -> Self {
        let h = (g.view + l).normalize_or(g.normal);
        Self {
            n_l: g.normal.dot(l).max(0.0),
            n_v: g.normal.dot(g.view).max(MIN_COSINE),
            sin2_nh: g.normal.cross(h).length_squared().min(1.0),
            v_h: g.view.dot(h).max(0.0),
        }
    }
}

/// Burley's factor summed over arriving light.
#[derive(Clone, Copy, Default)]
struct Spread {
    light: f32,
    sums: [f32; 3],
}

impl Spread {
    fn add(&mut self, half: &HalfVector, weighted: Vec3) {
        let light = luminance(weighted) * half.n_l;
        // v·l = 2 (v·h)² − 1
        let terms =
            Reflectance::diffuse_by_roughness(half.n_l, half.n_v, 2.0 * half.v_h * half.v_h - 1.0);
        self.light += light;
        self.sums
            .iter_mut()
            .zip(terms)
            .for_each(|(s, t)| *s += light * t);
    }

    /// The mean factor's polynomial; Lambert's where no light arrives.
    fn mean(&self) -> [f32; 3] {
        if self.light > 0.0 {
            self.sums.map(|s| s / self.light)
        } else {
            [1.0, 0.0, 0.0]
        }
    }
}

fn lobes<'a>(levels: &Levels<'a>, i: usize) -> &'a [f32] {
    match levels {
        Levels::Shared { lobes, .. } => lobes,
        Levels::Own(own) => std::slice::from_ref(&own.roughness[i]),
    }
}

fn accumulate(
    model: Reflectance,
    half: &HalfVector,
    weighted: Vec3,
    levels: &Levels,
    i: usize,
    out: &mut [Vec3],
) {
    if half.n_l <= 0.0 || weighted == Vec3::ZERO {
        return;
    }
    // light times what it counts for beside a dielectric's
    let coloured = |f0: Vec3, m: Reflectance| {
        if f0 == DIELECTRIC {
            weighted
        } else {
            weighted * over_dielectric(f0, m.fresnel(half.v_h.min(1.0)))
        }
    };
    let term = |light: Vec3, m: Reflectance, r: f32| {
        light
            * (m.specular(
                half.n_l,
                half.n_v,
                half.sin2_nh,
                half.v_h,
                r.max(MIN_ROUGHNESS),
            ) * half.n_l)
    };
    match levels {
        Levels::Shared {
            evaluate, models, ..
        } => {
            let k = evaluate.len();
            let row = &mut out[i * k * models.len()..(i + 1) * k * models.len()];
            for (part, lobe) in row.chunks_mut(k).zip(*models) {
                let light = coloured(lobe.f0, lobe.model);
                for (value, &r) in part.iter_mut().zip(*evaluate) {
                    *value += term(light, lobe.model, r);
                }
            }
        }
        Levels::Own(own) => {
            let f0 = own.f0.get(i).copied().unwrap_or(DIELECTRIC);
            out[i] += term(coloured(f0, model), model, own.roughness[i]);
        }
    }
}
