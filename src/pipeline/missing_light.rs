//! Light that the first pass could not know of, added once materials are known.
//!
//! The bake takes every texel to send the radiance that cameras saw in all directions alike.
//! Photographs look at floors and tables from above and mostly past their reflections; the robust
//! mean over views drops what is left of those. A dielectric sends out a twentieth of the light it
//! receives by specular reflection, a dark floor more than a quarter of all it sends out. And
//! surfaces that face away from every camera, like the upper side of a hanging lamp, are black to
//! it. So, with materials known, every texel sends out what its material does: E A f / π to all
//! sides, f being the mean of its diffuse part over that of a Lambertian surface; where the specular lobe is wide, its flux E ρ / π as well, ρ being its hemispherical
//! reflectance under even light; where it is narrow, towards every receiver what it mirrors there
//! ([`NextBounce`]). Surface that nobody saw sends what its class reflects of the light that it
//! receives; on far sides, which have no texels, rays that meet them go on to find it. The difference
//! to the first pass is baked at a low resolution and added to E.

use super::Light;
use super::light::{coarse_texels, patches};
use super::texel_radiance::texture_of;
use crate::core::brdf::Reflectance;
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::core::stats::median_colours;
use crate::core::texture::Texels;
use crate::core::trace::Hit;
use crate::inverse::{AlbedoEstimate, TexelReflectance};
use crate::irradiance::{
    Bake, Estimator, Glossy, Irradiance, IrradianceOptions, NextBounce, SurfaceFilter,
    bake_irradiance,
};
use crate::observed::Surface;
use crate::radiance::{Environment, LightField, SurfaceRadiance};
use crate::specular::{Reflector, WIDE};
use glam::{Vec2, Vec3};
use std::collections::BTreeMap;
use std::f32::consts::FRAC_1_PI;

/// Rays per texel for the difference: it is a few percent of the whole, and so is its noise.
const RAYS: u32 = 256;
/// Of so many rays that meet narrow lobes one is followed further: what these send is a small part
/// even of the difference.
const ONE_IN: u32 = 2;
/// Albedo of surface of which nothing is known.
const UNKNOWN_ALBEDO: f32 = 0.5;
/// The first pass may be off by this factor at most: what goes beyond is a lack of samples, not of
/// light.
const LIMITS: (f32, f32) = (0.7, 1.5);

/// What adding the missing light did.
#[derive(Clone, Copy, Debug)]
pub(super) struct MissingLight {
    /// Mean relative change of the irradiance.
    pub change: f32,
    /// Rays traced.
    pub rays: u64,
}

/// Adds the missing light to the irradiance and takes it out of the albedo, whose product stays.
pub(super) fn add_missing_light(
    surface: &Surface,
    light: &mut Light,
    albedo: &mut AlbedoEstimate,
    reflectance: &TexelReflectance,
    seed: u64,
    progress: &Progress,
) -> MissingLight {
    let texels = &surface.texels;
    let usual = UsualAlbedo::of(surface, light, albedo);
    let unsent = unsent_radiance(surface, light, albedo, reflectance, &usual);
    let field = LightField::new(
        &surface.scene.mesh,
        &surface.orientation,
        SurfaceRadiance::reflected(texture_of(texels, &unsent)),
        Environment::from_map(Plane::filled(2, 1, Vec3::ZERO)),
    );
    let glossy = |i: usize| is_known(surface, light, albedo, i) && reflectance.roughness[i] < WIDE;
    // where a lobe is narrow: its roughness, and 1
    let lobe = |i: usize| {
        if glossy(i) {
            Vec3::new(reflectance.roughness[i], 1.0, 0.0)
        } else {
            Vec3::ZERO
        }
    };
    let lobes: Vec<Vec3> = (0..texels.len()).into_par_iter().map(lobe).collect();
    let narrow = texture_of(texels, &lobes);
    let coarse = coarse_texels(surface);
    let more = Gathering {
        surface,
        light,
        field,
        narrow,
        far_sides: usual.per_triangle(surface),
        model: reflectance.model,
        coarse: &coarse,
    }
    .bake(seed, progress);
    let rays = more.rays;
    let ratio = relative_change(surface, light, more, &coarse);
    let change = scale_irradiance(surface, light, albedo, &ratio);
    MissingLight { change, rays }
}

/// Whether the material of texel `i` is known.
fn is_known(surface: &Surface, light: &Light, albedo: &AlbedoEstimate, i: usize) -> bool {
    let triangle = surface.texels.point[i].triangle as usize;
    !light.emissive[triangle] && albedo.error[i].is_finite()
}

/// Radiance that texels send to all sides beyond what the first pass took them to send.
fn unsent_radiance(
    surface: &Surface,
    light: &Light,
    albedo: &AlbedoEstimate,
    reflectance: &TexelReflectance,
    usual: &UsualAlbedo,
) -> Vec<Vec3> {
    let (mesh, texels) = (&surface.scene.mesh, &surface.texels);
    let roughness = &reflectance.roughness;
    (0..texels.len())
        .into_par_iter()
        .map(|i| {
            if light.emissive[texels.point[i].triangle as usize] {
                return Vec3::ZERO;
            }
            let seen = surface.fusion.views[i] > 0;
            let known = albedo.error[i].is_finite();
            if seen && !known {
                return Vec3::ZERO;
            }
            let specular = Vec3::splat(if roughness[i] < WIDE {
                0.0
            } else {
                reflectance.lobes.mean_response(roughness[i])
            });
            let irradiance = texels.lookup(mesh, &light.irradiance, i) * FRAC_1_PI;
            if seen && !albedo.clean[i] {
                // the photographs hold the diffuse part
                return irradiance * specular;
            }
            let own = if known {
                albedo.value[i]
            } else {
                usual.of_class(surface.labels[i])
            };
            // (of all it sends, not of what views from the front see)
            let diffuse = reflectance.model.mean_diffuse_factor(roughness[i]);
            irradiance * (own.clamp(Vec3::ZERO, Vec3::ONE) * diffuse + specular)
                - light.radiance.data[texels.cell[i] as usize]
        })
        .collect()
}

/// The median albedo of each class, for surface of which nothing else is known.
struct UsualAlbedo {
    by_class: BTreeMap<u16, Vec3>,
}

impl UsualAlbedo {
    fn of(surface: &Surface, light: &Light, albedo: &AlbedoEstimate) -> Self {
        let known = (0..surface.texels.len())
            .filter(|&i| albedo.clean[i] && is_known(surface, light, albedo, i));
        let shown = |i: usize| {
            let value = albedo.value[i].to_array().map(|v| v.clamp(0.0, 1.0));
            (surface.labels[i], Vec3::from_array(value))
        };
        Self {
            by_class: median_colours(known.map(shown)),
        }
    }

    fn of_class(&self, label: u16) -> Vec3 {
        let unknown = Vec3::splat(UNKNOWN_ALBEDO);
        self.by_class.get(&label).copied().unwrap_or(unknown)
    }

    /// That of every triangle's class.
    fn per_triangle(&self, surface: &Surface) -> Vec<Vec3> {
        let unknown = Vec3::splat(UNKNOWN_ALBEDO);
        let mut out = vec![unknown; surface.scene.mesh.triangles.len()];
        for (p, label) in surface.texels.point.iter().zip(&surface.labels) {
            out[p.triangle as usize] = self.of_class(*label);
        }
        out
    }
}

/// What the missing light is gathered from.
struct Gathering<'a> {
    surface: &'a Surface<'a>,
    light: &'a Light,
    /// What is sent to all sides beyond the first pass.
    field: LightField,
    /// Roughness and coverage of narrow lobes on the atlas.
    narrow: RgbPlane,
    /// Albedo per triangle for its far side.
    far_sides: Vec<Vec3>,
    model: Reflectance,
    coarse: &'a Texels,
}

impl Gathering<'_> {
    /// Irradiance that the first pass lacks, per coarse texel.
    fn bake(&self, seed: u64, progress: &Progress) -> Irradiance {
        let (surface, light) = (self.surface, self.light);
        let options = IrradianceOptions {
            estimator: Estimator::Cosine,
            rays: RAYS,
            emitter_samples: 0,
            seed: seed ^ 2,
            ..IrradianceOptions::default()
        };
        let first_pass = surface.lit(&light.field, &light.emitters);
        let bounce = NextBounce {
            reflector: Reflector {
                lit: &first_pass,
                rays_per_lobe: 1,
                emitter_samples: 1,
                model: self.model,
                seed: seed ^ 4,
            },
            mirror: &|hit| self.glossy(hit),
            scatter: &|t| self.far_side(t),
            one_in: ONE_IN,
        };
        let bake = Bake {
            lit: surface.lit(&self.field, &light.emitters),
            bounce: Some(&bounce),
        };
        let receiver = |i: usize| surface.receiver(self.coarse, i);
        bake_irradiance(&bake, self.coarse.len(), receiver, &options, progress)
    }

    /// The albedo of triangle `t`'s far side, if nobody saw that.
    fn far_side(&self, t: usize) -> Option<Vec3> {
        (self.surface.back[t] == Vec3::ZERO).then_some(self.far_sides[t])
    }

    /// The narrow lobe at a hit, if there is one.
    fn glossy(&self, hit: &Hit) -> Option<Glossy> {
        let size = Vec2::new(self.narrow.width as f32, self.narrow.height as f32);
        let t = hit.triangle as usize;
        let uv = self.surface.scene.mesh.uv(t, hit.u, hit.v);
        let lobe = *self.narrow.nearest(uv * size);
        (lobe.y > 0.5).then(|| {
            let (normal, face_normal) = self.surface.normals(t, hit.u, hit.v);
            Glossy {
                normal,
                face_normal,
                roughness: lobe.x / lobe.y,
            }
        })
    }
}

/// Factor on the irradiance that adds `more`, filtered over the surface: relative, it is smooth
/// wherever the surface is.
fn relative_change(
    surface: &Surface,
    light: &Light,
    more: Irradiance,
    coarse: &Texels,
) -> RgbPlane {
    let mesh = &surface.scene.mesh;
    let relative = |i: usize, more: Vec3| {
        let e = coarse.lookup(mesh, &light.irradiance, i);
        // (parts one by one: of the few rays that find something very bright, most is chance)
        Vec3::from_array(std::array::from_fn(|c| {
            if e[c] > 0.0 {
                1.0 + more[c] / e[c]
            } else {
                1.0
            }
        }))
        .clamp(Vec3::splat(LIMITS.0), Vec3::splat(LIMITS.1))
    };
    let relative = Irradiance {
        value: more
            .value
            .par_iter()
            .enumerate()
            .map(|(i, v)| relative(i, *v))
            .collect(),
        parts: more
            .parts
            .par_iter()
            .enumerate()
            .map(|(i, h)| h.map(|v| relative(i, v)))
            .collect(),
        ..more
    };
    let patches = patches(surface, coarse);
    let ratio = SurfaceFilter::new(&patches, &surface.tracer).filter(&relative, |_| 1.0);
    texture_of(coarse, &ratio.value)
}

/// Multiplies the irradiance by `ratio` and divides the albedo by what that changes; returns the
/// mean relative change.
pub(super) fn scale_irradiance(
    surface: &Surface,
    light: &mut Light,
    albedo: &mut AlbedoEstimate,
    ratio: &RgbPlane,
) -> f32 {
    let (mesh, texels) = (&surface.scene.mesh, &surface.texels);
    let before = &light.irradiance;
    let size = Vec2::new(
        ratio.width as f32 / before.width as f32,
        ratio.height as f32 / before.height as f32,
    );
    let after = Plane {
        width: before.width,
        height: before.height,
        data: (0..before.data.len())
            .into_par_iter()
            .map(|k| {
                let at = Vec2::new(
                    (k % before.width) as f32 + 0.5,
                    (k / before.width) as f32 + 0.5,
                );
                before.data[k] * ratio.bilinear(at * size, Wrap::Clamp)
            })
            .collect(),
    };
    let change = |i: usize| {
        let (a, b) = (
            texels.lookup(mesh, before, i),
            texels.lookup(mesh, &after, i),
        );
        Vec3::from_array(std::array::from_fn(|c| {
            if b[c] > 0.0 { a[c] / b[c] } else { 1.0 }
        }))
    };
    let changes: Vec<Vec3> = (0..texels.len()).into_par_iter().map(change).collect();
    let mut mean = 0.0f64;
    for (i, c) in changes.iter().enumerate() {
        albedo.value[i] *= *c;
        albedo.error[i] *= luminance(*c);
        mean += f64::from(1.0 / luminance(*c) - 1.0);
    }
    light.irradiance = after;
    (mean / changes.len().max(1) as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::brdf::{fresnel, smith_g1};
    use crate::lights::Emitters;
    use crate::observed::surface_tests::{box_scene, unseen};
    use std::f32::consts::PI;

    const SIDE: usize = 384;
    const ALBEDO: f32 = 0.6;

    /// One side of the box: the radiance of its first pass, whether its material is known, which it
    /// then is, and whether views see it.
    struct Wall {
        radiance: f32,
        known: bool,
        seen: bool,
        albedo: f32,
        roughness: f32,
    }

    /// A texel after the second pass: its irradiance beside π, which was that of the first, its
    /// albedo, its place, and its side of the box.
    struct After {
        gain: f32,
        albedo: f32,
        place: Vec3,
        wall: usize,
    }

    /// The second pass in a box that its first pass found to receive π everywhere.
    fn second_pass(model: Reflectance, wall: impl Fn(usize) -> Wall + Sync) -> Vec<After> {
        let scene = box_scene();
        let mut surface = unseen(&scene, SIDE);
        let sides = surface.texels.point.iter().map(|p| p.triangle as usize / 2);
        surface.fusion.views = sides.map(|w| u8::from(wall(w).seen)).collect();
        let (mesh, n) = (&scene.mesh, surface.texels.len());
        let number = |i: usize| surface.texels.point[i].triangle as usize / 2;
        let radiance = texture_of(
            &surface.texels,
            &(0..n)
                .map(|i| Vec3::splat(wall(number(i)).radiance))
                .collect::<Vec<_>>(),
        );
        let field = LightField::new(
            mesh,
            &surface.orientation,
            SurfaceRadiance::reflected(radiance.clone()),
            Environment::black(),
        );
        let emitters = Emitters::new(mesh, &field, &surface.tracer, &[]);
        let mut light = Light {
            segments: None,
            field,
            emitters,
            emissive: vec![false; mesh.triangles.len()],
            radiance,
            texels: surface.texels.clone(),
            irradiance: Plane::filled(SIDE, SIDE, Vec3::splat(PI)),
            error: vec![0.0; n],
            rays: 0,
        };
        let mut albedo = AlbedoEstimate {
            value: (0..n)
                .map(|i| Vec3::splat(wall(number(i)).albedo))
                .collect(),
            error: (0..n)
                .map(|i| {
                    if wall(number(i)).known {
                        0.1
                    } else {
                        f32::INFINITY
                    }
                })
                .collect(),
            looks: vec![1.0; n],
            specular_share: vec![0.0; n],
            clean: (0..n).map(|i| wall(number(i)).seen).collect(),
            footprint: vec![0.01; n],
        };
        let roughness = (0..n).map(|i| wall(number(i)).roughness).collect();
        let reflectance = TexelReflectance::new(model, roughness);
        let MissingLight { rays, .. } = add_missing_light(
            &surface,
            &mut light,
            &mut albedo,
            &reflectance,
            1,
            &Progress::silent(),
        );
        assert!(rays > 0);
        let of = |i: usize| After {
            gain: surface.texels.lookup(mesh, &light.irradiance, i).x / PI,
            albedo: albedo.value[i].x,
            place: surface.texels.position(mesh, i),
            wall: number(i),
        };
        (0..n).map(of).collect()
    }

    /// A furnace whose first pass sends out `radiance`, and the specular reflectance of its walls;
    /// `known` are those whose material is.
    fn furnace(
        model: Reflectance,
        radiance: f32,
        known: impl Fn(usize) -> bool + Sync,
    ) -> (Vec<After>, f32) {
        let wall = |w: usize| Wall {
            radiance,
            known: known(w),
            seen: true,
            albedo: ALBEDO,
            roughness: 0.8,
        };
        (
            second_pass(model, wall),
            crate::specular::DirectionalAlbedo::new(model).mean_response(0.8),
        )
    }

    /// With diffuse radiance alone the specular part is missing: E grows by ρ, and what is
    /// reflected diffusely stays.
    #[test]
    fn a_furnace_gets_the_light_its_walls_mirror() {
        // as photographed past all reflections; with a highlight taken for light; black; far too
        // bright
        for radiance in [ALBEDO, 0.8, 0.0, 2.0] {
            let (texels, specular) = furnace(Reflectance::Paper, radiance, |_| true);
            assert!(specular > 0.01 && specular < 0.1, "{specular}");
            let expected = (1.0 + ALBEDO + specular - radiance).clamp(LIMITS.0, LIMITS.1);
            for After {
                gain: e,
                albedo,
                place: p,
                ..
            } in texels
            {
                assert!(
                    (e / expected - 1.0).abs() < 2e-3,
                    "radiance {radiance}, {p}: {e} for {expected}"
                );
                assert!(
                    (albedo * e / ALBEDO - 1.0).abs() < 1e-4,
                    "radiance {radiance}, {p}: albedo {albedo}"
                );
            }
        }
    }

    /// A ceiling that nobody saw, black to the first pass, sends what its class reflects of the light
    /// that it receives.
    #[test]
    fn unseen_surface_sends_what_its_class_reflects() {
        let wall = |w: usize| Wall {
            radiance: if w == 1 { 0.0 } else { ALBEDO },
            known: w != 1,
            seen: w != 1,
            albedo: ALBEDO,
            roughness: 0.8,
        };
        let lobes = crate::specular::DirectionalAlbedo::new(Reflectance::Paper);
        let specular = lobes.mean_response(0.8);
        for After {
            gain, place, wall, ..
        } in second_pass(Reflectance::Paper, wall)
        {
            // of what the ceiling sends the floor gets a share by its form factor, at most a half
            let least = 1.0 + specular + if wall == 0 { 0.05 * ALBEDO } else { 0.0 };
            let most = 1.0 + specular + if wall == 1 { 2e-3 } else { ALBEDO };
            assert!(
                gain > least - 2e-3 && gain < most,
                "{place}, side {wall}: {gain} within {least} and {most}"
            );
        }
    }

    /// A diffuse part that brightens at grazing angles sends out more than views from the front
    /// see: taken for Lambertian, white rough walls would darken their room.
    #[test]
    fn a_furnace_of_burleys_walls_gets_all_that_they_send() {
        let (texels, specular) = furnace(Reflectance::Burley, ALBEDO, |_| true);
        let diffuse = ALBEDO * Reflectance::Burley.mean_diffuse_factor(0.8);
        assert!(
            diffuse > 1.03 * ALBEDO,
            "the factor of the test must matter"
        );
        let expected = 1.0 + diffuse + specular - ALBEDO;
        for After { gain, place, .. } in texels {
            let off = (gain / expected - 1.0).abs();
            assert!(off < 2e-3, "{place}: {gain} for {expected}");
        }
    }

    /// If only the ceiling's material is known, the floor gets its share of that by the ceiling's
    /// form factor.
    #[test]
    fn missing_light_falls_off_as_form_factors_say() {
        let (texels, specular) = furnace(Reflectance::Paper, 0.0, |wall| wall == 1);
        // of a rectangle from the point below its corner, x and y in units of the height
        let corner = |x: f32, y: f32| {
            let half =
                |x: f32, y: f32| x / (1.0 + x * x).sqrt() * (y / (1.0 + x * x).sqrt()).atan();
            (half(x, y) + half(y, x)) / (2.0 * PI)
        };
        let height = 3.0;
        let (mut square, mut count) = (0.0, 0);
        for After {
            gain: e, place: p, ..
        } in texels.iter().filter(|t| t.wall == 0)
        {
            let [x, z] = [p.x, p.z].map(|v| v / height);
            let [far_x, far_z] = [4.0 / height - x, 5.0 / height - z];
            let share = corner(x, z) + corner(far_x, z) + corner(x, far_z) + corner(far_x, far_z);
            let expected = 1.0 + (ALBEDO + specular) * share;
            assert!((e / expected - 1.0).abs() < 0.03, "{p}: {e} for {expected}");
            square += (e / expected - 1.0).powi(2);
            count += 1;
        }
        let rms = (square / count as f32).sqrt();
        assert!(count > 400 && rms < 0.006, "{count} texels, rms {rms}");
    }

    /// A mirror for a ceiling shows the shining wall upside down: the floor gets what Fresnel and
    /// masking leave of that image, most of it beside the opposite wall. Sent out to all sides
    /// alike, the same light would be spread.
    #[test]
    fn a_mirror_sends_its_light_where_the_image_is_seen() {
        const RADIANCE: f32 = 20.0;
        let texels = second_pass(Reflectance::Paper, |w| Wall {
            radiance: if w == 2 { RADIANCE } else { 0.0 },
            known: w == 1,
            seen: true,
            albedo: 0.0,
            roughness: crate::core::brdf::MIN_ROUGHNESS,
        });
        let image = |p: Vec3| {
            // the wall x = 0, mirrored at y = 3: cosines at the floor and at the ceiling are the
            // same
            let (steps, mut sum) = (60, 0.0);
            for k in 0..steps * steps {
                let [y, z] = [k / steps, k % steps].map(|i| (i as f32 + 0.5) / steps as f32);
                let d = Vec3::new(0.0, 3.0 + 3.0 * y, 5.0 * z) - p;
                let (d2, cosine) = (d.length_squared(), d.y / d.length());
                let response =
                    fresnel(cosine) * smith_g1(cosine, crate::core::brdf::MIN_ROUGHNESS).powi(2);
                sum += response * cosine * (p.x / d.length()) / d2;
            }
            sum * 15.0 / (steps * steps) as f32
        };
        let (mut square, mut count, mut most, mut sums) = (0.0, 0, 0.0f32, [0.0f32; 2]);
        for t in texels.iter().filter(|t| t.wall == 0) {
            let (got, expected) = (t.gain - 1.0, RADIANCE * image(t.place) * FRAC_1_PI);
            assert!(
                (got - expected).abs() < 0.25 * expected + 0.01,
                "{}: {got} for {expected}",
                t.place
            );
            square += (got - expected).powi(2);
            most = most.max(expected);
            sums = [sums[0] + got, sums[1] + expected];
            count += 1;
        }
        let (rms, share) = ((square / count as f32).sqrt(), sums[0] / sums[1]);
        assert!(
            count > 5000 && most > 0.05 && rms < 0.08 * most,
            "{count} texels, rms {rms} of {most}"
        );
        assert!((share - 1.0).abs() < 0.03, "{share} of the light");
    }
}
