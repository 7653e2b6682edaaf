//! The operator beside the result: what rays were traced for, in a file whose label names the
//! version of this code and the result it belongs to. A file that is damaged or of another result
//! is traced anew and replaced.

use super::direct::{Direct, direct_light};
use super::error::Reference;
use super::groups::{LightGroup, light_groups};
use super::links::{LINKS, Seeing, links};
use super::operator::{EditError, LiveLight, Traced};
use super::patches::{NONE, WANTED, divide};
use crate::core::blocks::{Columns, column, opened, sealed, values};
use crate::core::formats::atomic_write;
use crate::core::progress::Progress;
use crate::core::trace::Tracer;
use crate::render::LightmapTexels;
use crate::solution::Solution;
use glam::Vec3;
use half::f16;
use std::path::Path;

/// Name of the file in a result's folder.
pub const OPERATOR: &str = "light_operator.bin";
/// Of what the file holds and how it is computed: to be raised with any change of either.
const VERSION: u32 = 3;
/// Longest side of the operator's map. Derived: a texel of a flat is some centimetres, and an answer
/// reads 64 links of each within its time.
const SIDE: usize = 512;

/// Texels of the operator's map of a solution.
fn texels_of(solution: &Solution) -> LightmapTexels<'_> {
    let own = solution.irradiance.width.max(solution.irradiance.height);
    LightmapTexels::new(&solution.mesh, own.clamp(1, SIDE))
}

/// What tells a file from that of any other result or version.
fn label(solution: &Solution, groups: &[LightGroup]) -> String {
    format!(
        "unbake light operator {VERSION} {} {groups:?}",
        solution.generation()
    )
}

/// The operator of a solution: from the file in `folder`, else traced and, where the folder can be
/// written to, kept there.
pub fn open_or_build(
    solution: &Solution,
    folder: Option<&Path>,
    tracer: &dyn Tracer,
    progress: &Progress,
) -> LiveLight {
    let groups = light_groups(solution);
    let texels = texels_of(solution);
    let label = label(solution, &groups);
    let path = folder.map(|f| f.join(OPERATOR));
    let kept = path
        .as_ref()
        .and_then(|p| std::fs::read(p).ok())
        .and_then(|bytes| opened(&label, &bytes))
        .and_then(|columns| restored(&columns, texels.points().len(), groups.len()));
    if let Some(Kept { traced, error }) = kept {
        let mut live = LiveLight::assemble(solution, &texels, groups, traced);
        live.error = error;
        return live;
    }
    let traced = trace(solution, &groups, &texels, tracer, progress);
    let mut live = LiveLight::assemble(solution, &texels, groups.clone(), traced.clone());
    let reference = Reference {
        solution,
        texels: &texels,
        groups: &groups,
        tracer,
    };
    live.error = progress.stage("comparing with the path tracer", 1, |_| {
        reference.error(&live)
    });
    if let Some(path) = path {
        let columns = columns(&traced, live.error);
        if let Err(e) = atomic_write(&path, &sealed(&label, &columns)) {
            progress.note(format!("the light operator is not kept: {e}"));
        }
    }
    live
}

/// Traces an operator, as exactly as its file keeps it.
pub(super) fn trace(
    solution: &Solution,
    groups: &[LightGroup],
    texels: &LightmapTexels<'_>,
    tracer: &dyn Tracer,
    progress: &Progress,
) -> Traced {
    let of_texels = divide(solution, texels, tracer, WANTED);
    let seeing = links(solution, texels, &of_texels, tracer, progress);
    let direct = direct_light(solution, groups, texels, tracer, progress);
    let kept = direct.iter().map(|d| HalfLight::of(d).light()).collect();
    Traced {
        direct: kept,
        seeing,
        of_texels,
    }
}

/// A map of light as half floats of its largest value.
struct HalfLight {
    unit: f32,
    halves: Vec<f16>,
}

impl HalfLight {
    fn of(light: &[Vec3]) -> Self {
        let finite = light
            .iter()
            .map(|v| v.max_element())
            .filter(|m| m.is_finite());
        let unit = finite.fold(0.0, f32::max).max(f32::MIN_POSITIVE);
        // what is no number is no light
        let half = |x: f32| f16::from_f32(if x > 0.0 { (x / unit).min(1.0) } else { 0.0 });
        Self {
            unit,
            halves: light.iter().flat_map(|v| v.to_array().map(half)).collect(),
        }
    }

    fn light(&self) -> Vec<Vec3> {
        let colour = |h: &[f16]| Vec3::new(h[0].to_f32(), h[1].to_f32(), h[2].to_f32());
        let texels = self.halves.chunks_exact(3);
        texels.map(|h| colour(h) * self.unit).collect()
    }
}

/// What a file holds.
struct Kept {
    traced: Traced,
    error: EditError,
}

fn columns(traced: &Traced, error: EditError) -> Columns {
    let halves: Vec<HalfLight> = traced.direct.iter().map(|d| HalfLight::of(d)).collect();
    let units: Vec<f32> = halves.iter().map(|h| h.unit).collect();
    let fixed = [
        column(&traced.seeing.links),
        column(&traced.seeing.seen),
        column(&traced.of_texels),
        column(&[error.relative, error.model, error.median]),
        column(&units),
    ];
    let light = halves.into_iter().map(|h| column(&h.halves));
    fixed.into_iter().chain(light).collect()
}

/// The content of a file, if it is that of so many texels and groups.
fn restored(columns: &[Vec<u8>], texels: usize, groups: usize) -> Option<Kept> {
    let [links, seen, of_texels, error, units, light @ ..] = columns else {
        return None;
    };
    let units: Vec<f32> = values(units)?;
    let [relative, model, median] = values::<f32>(error)?.try_into().ok()?;
    let direct: Direct = light
        .iter()
        .zip(&units)
        .map(|(bytes, &unit)| {
            let halves = values(bytes)?;
            Some(HalfLight { unit, halves }.light())
        })
        .collect::<Option<_>>()?;
    let traced = Traced {
        direct,
        seeing: Seeing {
            links: values(links)?,
            seen: seen.clone(),
        },
        of_texels: values(of_texels)?,
    };
    let fits = traced.direct.len() == groups
        && traced.direct.iter().all(|d| d.len() == texels)
        && traced.seeing.links.len() == texels * LINKS
        && traced.seeing.seen.len() == texels
        && traced.of_texels.len() == texels
        && traced.of_texels.iter().all(|p| *p < NONE);
    let error = EditError {
        relative,
        model,
        median,
    };
    fits.then_some(Kept { traced, error })
}
