//! A scan's own colours as the light field: albedo and light without a photograph.
//!
//! What a scan's texture shows is what its surface sent out, so it is the light of the scene by
//! itself, as TexIR takes it (texture-based lighting, method §2.1): emitters, segments, irradiance
//! and albedo π L/E are found as `solve` finds them from photographs. What needs several looks is
//! left out: roughness stays the prior's and is stated as unknown, and gloss counts as paint but
//! for what even light makes of it. Called by `unbake delight`.

use super::albedo::settle_bounds;
use super::doubt::Doubt;
use super::segments::doubt_of_segments;
use super::settle::{Estimated, settle};
use super::solved::Solved;
use super::{Fit, Light, Roughness, SolveOptions, fit_roughness, reconstruct_light};
use crate::Result;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::highlight::Evidence;
use crate::inverse::AlbedoEstimate;
use crate::observed::{ScannedSurface, Surface, TextureSizes, scanned_surface};
use crate::scene::Scan;
use glam::Vec3;
use std::f32::consts::PI;

/// Relative error of a look that nothing else confirms: that of one look in `inverse::albedo`.
const ONE_LOOK: f32 = 0.02;
/// Error of an albedo, relative, by gloss that nobody can tell from paint. Derived: a dielectric's
/// mean reflectance under even light, 0.09 of white, half of which is taken out as expected.
const GLOSS: f64 = 0.09;
/// Error of an albedo, relative, by light that nothing confirms. Measured: irradiance of walls and
/// ceiling of a synthetic room is 0.85 to 1.05 of that found from its photographs
/// (docs/lab/scans.md).
const UNCONFIRMED: f64 = 0.1;
/// Error of an albedo, relative, by pictures for screens. Measured: 0.15 is what an sRGB texture cut
/// off above the walls adds (docs/lab/scans.md); derived: a tone curve that is not sRGB's as much
/// again, 0.15 · √2.
const TONE_CURVE: f64 = 0.21;
/// How much brighter what lies behind a hole may be than the surface on average: a window's sky. Measured: 7
/// (`synth --rooms 1 --views 8 --test-views 2 --width 256 --spp 4 --texture 512`, 2026-11-26).
const SKY: f64 = 7.0;
/// Sizes of textures are multiples of this.
const STEP: usize = 64;

/// Takes the light out of a scan's colours.
///
/// # Errors
/// Unusable options, or Embree's own.
pub fn delight(scan: &Scan, options: &SolveOptions, progress: &Progress) -> Result<Solved> {
    options.validate()?;
    let sizes = choose_sizes(scan, options, progress);
    let found = progress.stage("colours", 1, |_| scanned_surface(scan, sizes))?;
    let ScannedSurface { mut surface, holes } = found;
    progress.note(format!("light from {}", scan.colours.source));
    let mut doubts = doubts(&surface, holes, progress);
    // without views no point of evidence can choose one
    let options = &SolveOptions {
        reflectance: Some(options.reflectance.unwrap_or_default()),
        ..options.clone()
    };
    let mut light = reconstruct_light(&surface, options, progress);
    if let Some(segments) = light.segments.take() {
        surface.labels = segments;
        doubts.push(doubt_of_segments());
    }
    let roughness = fit_roughness(&surface, &light, &Evidence::default(), options, progress);
    let albedo = albedo_of_colours(&surface, &light, &roughness);
    let estimated = Estimated {
        albedo,
        roughness: &roughness,
        clipped_light: None,
        doubts,
        rays: light.rays,
    };
    let mut solved = settle(&surface, light, estimated, options, progress);
    // (said in its own words)
    solved.findings.seen_once.share = 0.0;
    Ok(solved)
}

/// Texture sizes: as given, or as fine as the scan's own colours and no finer.
fn choose_sizes(scan: &Scan, options: &SolveOptions, progress: &Progress) -> TextureSizes {
    let mesh = &scan.scene.mesh;
    let (mut own, mut charts) = (0.0f64, 0.0f64);
    for t in 0..mesh.triangles.len() {
        own += f64::from(scan.colours.texels_of(t));
        charts += f64::from(mesh.chart_area(t));
    }
    let side = (own / charts.max(f64::MIN_POSITIVE)).sqrt();
    let supported = ((side / STEP as f64).ceil().clamp(1.0, 256.0) as usize) * STEP;
    let fitted = |given: usize, fit: bool| if fit { given.min(supported) } else { given };
    let Fit {
        albedo,
        roughness,
        irradiance,
        ..
    } = options.fit;
    let sizes = TextureSizes {
        albedo: fitted(options.albedo_size, albedo),
        roughness: fitted(options.roughness_size, roughness),
        irradiance: fitted(options.irradiance_size, irradiance),
    };
    progress.decide(
        "albedo texture",
        format!("{}²", sizes.albedo),
        format!(
            "at {supported}² a texel is as small as one of the scan's own colours; --albedo-size"
        ),
        !albedo,
    );
    sizes
}

/// What is against a result without photographs.
fn doubts(surface: &Surface, holes: f32, progress: &Progress) -> Vec<Doubt> {
    let known = surface.fusion.views.iter().filter(|v| **v > 0).count();
    let clipped = surface.clipped.len() as f64 / known.max(1) as f64;
    let mut doubts = vec![
        Doubt {
            what: "no photographs: roughness is not known, and gloss that the texture shows counts as paint".into(),
            relative: GLOSS,
        },
        Doubt {
            what: "no photographs: nothing confirms the light of the texture".into(),
            relative: UNCONFIRMED,
        },
    ];
    let at_ceiling = if surface.encoded {
        Some(Doubt {
            what: format!(
                "the scan's colours were made for a screen: their tone curve is not known, and {:.1} % of the surface is at their ceiling, lamps and windows above all, whose light is a lower bound",
                100.0 * clipped
            ),
            relative: TONE_CURVE,
        })
    } else {
        (clipped > 0.0).then(|| Doubt {
            what: format!(
                "{:.1} % of the surface is at the texture's ceiling: its light is a lower bound",
                100.0 * clipped
            ),
            relative: clipped.sqrt(),
        })
    };
    if let Some(doubt) = at_ceiling {
        progress.note(&doubt.what);
        doubts.push(doubt);
    }
    if holes > 0.0 && surface.ambient != Vec3::ZERO {
        doubts.push(Doubt {
            what: format!(
                "{:.1} % of the directions from the surface lead through holes of the scan: they are taken to be as bright as its surface is on average",
                100.0 * holes
            ),
            relative: SKY * f64::from(holes),
        });
    }
    doubts
}

/// Albedo of every texel whose colour is known: π L/E less what even light makes a dielectric of the
/// prior's roughness reflect specularly.
fn albedo_of_colours(surface: &Surface, light: &Light, roughness: &Roughness) -> AlbedoEstimate {
    let (texels, mesh, fusion) = (&surface.texels, &surface.scene.mesh, &surface.fusion);
    let reflectance = &roughness.reflectance;
    let of = |i: usize| {
        let r = reflectance.roughness[i];
        let e = texels.lookup(mesh, &light.irradiance, i);
        let whole = fusion.radiance[i] * PI / e;
        let gloss = reflectance.lobes.mean_response(r);
        let known = fusion.views[i] > 0 && e.min_element() > 0.0 && whole.is_finite();
        let diffuse = (whole - gloss).max(Vec3::ZERO) / reflectance.model.mean_diffuse_factor(r);
        let share = gloss / whole.max_element().max(gloss);
        known.then_some((diffuse, share))
    };
    let found: Vec<Option<(Vec3, f32)>> = (0..texels.len()).into_par_iter().map(of).collect();
    let value = |f: &Option<(Vec3, f32)>| f.map_or(Vec3::ZERO, |f| f.0);
    let error = |f: &Option<(Vec3, f32)>| match f {
        Some((value, _)) => ONE_LOOK * luminance(*value),
        None => f32::INFINITY,
    };
    let mut albedo = AlbedoEstimate {
        value: found.iter().map(value).collect(),
        error: found.iter().map(error).collect(),
        looks: found
            .iter()
            .map(|f| f32::from(u8::from(f.is_some())))
            .collect(),
        specular_share: found.iter().map(|f| f.map_or(0.0, |f| f.1)).collect(),
        clean: (found.iter().zip(&fusion.clean))
            .map(|(f, clean)| f.is_some() && *clean)
            .collect(),
        footprint: (0..texels.len())
            .map(|i| texels.area(mesh, i).sqrt())
            .collect(),
    };
    settle_bounds(surface, light, &roughness.texel_rooms(texels), &mut albedo);
    albedo
}
