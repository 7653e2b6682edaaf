//! `unbake prepare brackets`: several exposures of a pose to one radiance image.
//!
//! Exposure by EXIF ([`exposure`]), hand-held frames aligned ([`align`]), one response for the whole
//! set ([`response`]), merged without ghosts ([`merge`]), one scale over the set: images of
//! different poses stay comparable.

mod align;
mod exposure;
mod merge;
mod response;
#[cfg(test)]
mod tests;

use super::folder::{SceneFolder, extension};
use super::importer::files_in;
use super::{Account, PrepareOptions, Prepared};
use crate::core::formats;
use crate::core::image::{Plane, RgbPlane};
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use align::shift;
use exposure::{Photograph, groups, parse_times, read_exposure};
use merge::{Exposed, merge};
use response::{Response, Seen, Sighting};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Its name on the command line.
pub const KIND: &str = "brackets";
/// Points per bracket that the response is fitted to.
const POINTS: usize = 4000;
/// A point lies where the codes of its 3×3 neighbourhood differ by less: edges carry the error of
/// alignment.
const FLAT: u8 = 12;
/// Codes the fit uses.
const FIT_RANGE: std::ops::RangeInclusive<u8> = 5..=250;
/// Disagreement of exposures beyond which their times are another's. Derived: a third of a stop, the step of cameras.
const CONTRADICTED: f64 = 0.26;
/// Share of a photograph that something may have moved in. Derived: most of it must show one scene.
const MOST_MOVED: f64 = 0.5;
/// The set's median radiance after scaling: middle grey.
const MIDDLE_GREY: f64 = 0.18;

/// Whether a folder looks like brackets: its first two photographs state different exposures.
#[must_use]
pub fn recognises(path: &Path) -> bool {
    let files = photographs(path);
    let exposure = |i: usize| files.get(i).and_then(|p| read_exposure(p).ok());
    match (exposure(0), exposure(1)) {
        (Some(a), Some(b)) => (a / b).ln().abs() > 0.3,
        _ => false,
    }
}

/// JPEG and PNG files of a folder by name.
fn photographs(path: &Path) -> Vec<PathBuf> {
    let mut files = files_in(path, |p| {
        // macOS leaves a "._" file beside every file on a card
        let name = p.file_name().unwrap_or_default().to_string_lossy();
        !name.starts_with('.') && ["jpg", "jpeg", "png"].contains(&extension(p).as_str())
    });
    files.sort_by_cached_key(|p| counted(&p.to_string_lossy()));
    files
}

/// A name as people sort it: runs of digits by what they count, "img9" before "img10".
fn counted(name: &str) -> Vec<(u64, String)> {
    let mut parts: Vec<(u64, String)> = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let text = rest
            .find(|c: char| c.is_ascii_digit())
            .unwrap_or(rest.len());
        let (before, after) = rest.split_at(text);
        let digits = after
            .find(|c: char| !c.is_ascii_digit())
            .unwrap_or(after.len());
        let (number, next) = after.split_at(digits);
        parts.push((0, before.to_owned()));
        if !number.is_empty() {
            parts.push((number.parse().unwrap_or(u64::MAX), String::new()));
        }
        rest = next;
    }
    parts
}

/// Merges the brackets of `path` into `out/images/*.exr`.
///
/// # Errors
/// [`Error::Input`] for a folder without brackets or a photograph that cannot be used.
pub fn run(
    path: &Path,
    out: &Path,
    options: &PrepareOptions,
    progress: &Progress,
) -> Result<Prepared> {
    let mut account = Account::default();
    let sets = groups(with_exposures(path, options)?);
    if sets.iter().all(|s| s.len() < 2) {
        return Err(Error::input(
            path,
            "no bracket: every photograph has the same exposure; give a folder with several exposures of each pose",
        ));
    }
    let folder = SceneFolder::new(out)?;
    let responses = progress.stage("response of the camera", 1, |_| {
        fitted_response(&sets, &mut account)
    })?;
    let steps = sets.len() as u64;
    let merged: Vec<(String, RgbPlane)> = progress.stage("merging", steps, |progress| {
        let one = |set: &Vec<Photograph>| {
            let merged = merge_one(set, &responses, &mut account);
            progress.advance(1);
            merged
        };
        sets.iter().map(one).collect::<Result<Vec<_>>>()
    })?;
    let scale = set_scale(&merged);
    for (stem, image) in &merged {
        let image = image.map(|v| *v * scale as f32);
        folder.write_radiance(&format!("images/{stem}.exr"), &image)?;
    }
    account.converted(format!(
        "one scale for the whole set: the median radiance is {MIDDLE_GREY}"
    ));
    account.ignored("poses and mesh: name these images in a transforms.json, or give them to a program that finds poses");
    folder.write_json("prepare.json", &json!({"account": account}))?;
    folder.publish()?;
    Ok(Prepared {
        kind: KIND,
        frames: merged.len(),
        triangles: 0,
        rooms: 0,
        notes: account.lines(),
    })
}

/// The folder's photographs with exposures by EXIF or by hand.
fn with_exposures(path: &Path, options: &PrepareOptions) -> Result<Vec<Photograph>> {
    let files = photographs(path);
    if files.is_empty() {
        return Err(Error::input(
            path,
            "no JPEG or PNG photographs here; give the folder that holds the exposures",
        ));
    }
    let by_hand = options
        .exposure_times
        .as_deref()
        .map(parse_times)
        .transpose()?;
    if let Some(times) = by_hand
        .as_ref()
        .filter(|t| !files.len().is_multiple_of(t.len()))
    {
        return Err(Error::Usage(format!(
            "--exposure-times: {} times for {} photographs; their number must divide that of the photographs",
            times.len(),
            files.len()
        )));
    }
    files
        .into_iter()
        .enumerate()
        .map(|(i, path)| {
            let exposure = match &by_hand {
                Some(times) => times[i % times.len()],
                None => read_exposure(&path)?,
            };
            Ok(Photograph { path, exposure })
        })
        .collect()
}

/// Reads a bracket, aligned to its reference.
fn exposures(set: &[Photograph]) -> Result<(Vec<Exposed>, usize)> {
    let mut bracket = Vec::with_capacity(set.len());
    for p in set {
        let linear = formats::read_ldr(&p.path)?;
        // the reader undoes the sRGB curve: back to the codes of the file
        let codes = linear.map(|v| v.to_array().map(formats::srgb8_from_linear));
        bracket.push(Exposed {
            codes,
            exposure: p.exposure,
            shift: align::Shift::default(),
        });
    }
    let size = |e: &Exposed| [e.codes.width, e.codes.height];
    if let Some(i) = (1..set.len()).find(|&i| size(&bracket[i]) != size(&bracket[0])) {
        return Err(Error::input(
            &set[i].path,
            format!(
                "{:?} pixels, the first of its bracket has {:?}; all exposures of a pose need the same size",
                size(&bracket[i]),
                size(&bracket[0])
            ),
        ));
    }
    let reference = middle(&bracket);
    align_all(&mut bracket, reference);
    Ok((bracket, reference))
}

/// The photograph of middle exposure: what most others differ least from, and what people take for
/// the picture. Others move to it, and the image is named after it.
fn middle(bracket: &[Exposed]) -> usize {
    let mut ladder: Vec<usize> = (0..bracket.len()).collect();
    ladder.sort_by(|&a, &b| bracket[a].exposure.total_cmp(&bracket[b].exposure));
    ladder.get(bracket.len() / 2).copied().unwrap_or(0)
}

/// Aligns along the ladder of exposures, each to its neighbour: their medians differ least.
fn align_all(bracket: &mut [Exposed], reference: usize) {
    let grey = |e: &Exposed| {
        e.codes.map(|&[r, g, b]| {
            ((54 * u32::from(r) + 183 * u32::from(g) + 19 * u32::from(b)) / 256) as u8
        })
    };
    let greys: Vec<Plane<u8>> = bracket.iter().map(grey).collect();
    let mut ladder: Vec<usize> = (0..bracket.len()).collect();
    ladder.sort_by(|&a, &b| bracket[a].exposure.total_cmp(&bracket[b].exposure));
    let at = ladder.iter().position(|&i| i == reference).unwrap_or(0);
    let up: Vec<usize> = ladder[at..].to_vec();
    let down: Vec<usize> = ladder[..=at].iter().rev().copied().collect();
    for way in [up, down] {
        for step in way.windows(2) {
            let s = shift(&greys[step[0]], &greys[step[1]]);
            let from = bracket[step[0]].shift;
            bracket[step[1]].shift = align::Shift {
                dx: from.dx + s.dx,
                dy: from.dy + s.dy,
            };
        }
    }
}

/// The response of each channel, from all brackets together.
fn fitted_response(sets: &[Vec<Photograph>], account: &mut Account) -> Result<[Response; 3]> {
    let mut points: [Vec<Sighting>; 3] = Default::default();
    for set in sets.iter().filter(|s| s.len() > 1) {
        let (bracket, _) = exposures(set)?;
        for (c, channel) in points.iter_mut().enumerate() {
            channel.extend(sightings(&bracket, c));
        }
    }
    let mut fitted = true;
    let responses = [0, 1, 2].map(|c| {
        Response::fit(&points[c]).unwrap_or_else(|| {
            fitted = false;
            Response::srgb()
        })
    });
    if fitted {
        let spread = [0, 1, 2].map(|c| responses[c].spread(&points[c]));
        if spread.iter().sum::<f64>() / 3.0 > CONTRADICTED {
            return Err(Error::input(
                sets.first()
                    .and_then(|s| s.first())
                    .map_or(Path::new(""), |p| &p.path),
                format!(
                    "this photograph and those after it contradict their exposure times (by {:.0} % in the median): are --exposure-times in the order of the file names, and the photographs of each set of one place?",
                    100.0 * spread.iter().sum::<f64>() / 3.0
                ),
            ));
        }
        account.converted(format!(
            "the camera's response was fitted to {} points (Debevec & Malik); exposures agree to {:.1} % in the median",
            points[1].len(),
            100.0 * spread.iter().sum::<f64>() / 3.0
        ));
    } else {
        account.converted("no point is seen in range twice: the response is taken for sRGB");
    }
    Ok(responses)
}

/// Flat places on a grid, as each exposure saw them.
fn sightings(bracket: &[Exposed], channel: usize) -> Vec<Sighting> {
    let (w, h) = (bracket[0].codes.width, bracket[0].codes.height);
    let stride = (((w * h) as f64 / POINTS as f64).sqrt() as usize).max(1);
    let mut found = Vec::new();
    for y in (1..h.saturating_sub(1)).step_by(stride) {
        for x in (1..w.saturating_sub(1)).step_by(stride) {
            let seen: Sighting = bracket
                .iter()
                .filter_map(|e| flat_code(e, x, y, channel))
                .collect();
            if seen.len() > 1 {
                found.push(seen);
            }
        }
    }
    found
}

/// The code at a place around which the image is flat and in range.
fn flat_code(e: &Exposed, x: usize, y: usize, channel: usize) -> Option<Seen> {
    let (mut lo, mut hi) = (u8::MAX, 0);
    for v in y - 1..=y + 1 {
        for u in x - 1..=x + 1 {
            let z = e.at(u, v)?[channel];
            (lo, hi) = (lo.min(z), hi.max(z));
        }
    }
    let code = e.at(x, y)?[channel];
    let usable = hi - lo < FLAT && FIT_RANGE.contains(&lo) && FIT_RANGE.contains(&hi);
    usable.then_some(Seen {
        ln_exposure: e.exposure.ln(),
        code,
    })
}

fn merge_one(
    set: &[Photograph],
    responses: &[Response; 3],
    account: &mut Account,
) -> Result<(String, RgbPlane)> {
    let (bracket, reference) = exposures(set)?;
    let merged = merge(&bracket, responses, reference);
    let stem = set[reference]
        .path
        .file_stem()
        .map(|s| s.to_string_lossy().into_owned())
        .unwrap_or_default();
    if merged.moved > MOST_MOVED {
        return Err(Error::input(
            &set[reference].path,
            format!(
                "{:.0} % of this photograph is something else in the other exposures of its set: is one of them turned (EXIF), of another place, or its exposure time another's?",
                100.0 * merged.moved
            ),
        ));
    }
    let farthest = bracket
        .iter()
        .map(|e| e.shift.dx.abs().max(e.shift.dy.abs()))
        .max()
        .unwrap_or(0);
    let range =
        |f: fn(f64, f64) -> f64, start: f64| bracket.iter().map(|e| e.exposure).fold(start, f);
    let stops = (range(f64::max, 0.0) / range(f64::min, f64::INFINITY)).log2();
    account.read(format!(
        "{stem}: {} exposures over {stops:.1} stops, moved by up to {farthest} pixels, {:.2} % clipped in all of them, {:.2} % with something that moved",
        bracket.len(),
        100.0 * merged.clipped,
        100.0 * merged.moved
    ));
    Ok((stem, merged.radiance))
}

/// The factor that brings the median of all images to middle grey.
fn set_scale(images: &[(String, RgbPlane)]) -> f64 {
    let mut all: Vec<f32> = images
        .iter()
        .flat_map(|(_, i)| i.data.iter().step_by((i.data.len() / 10_000).max(1)))
        .map(|v| v.dot(glam::Vec3::new(0.2126, 0.7152, 0.0722)))
        .filter(|v| *v > 0.0)
        .collect();
    all.sort_by(f32::total_cmp);
    match all.get(all.len() / 2) {
        Some(&m) => MIDDLE_GREY / f64::from(m),
        None => 1.0,
    }
}
