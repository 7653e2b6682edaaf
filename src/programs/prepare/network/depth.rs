//! Depth by a network: guesses for the tiles of every photograph, brought to one scale (`fit`), blended, and
//! written in the form the depth importer reads: EXR, metres along the ray.

use super::fit::{Anchor, Fit, Guess, Line, fit};
use super::model::{Answer, Model};
use super::options::{DepthFit, DepthValues, NetworkOptions};
use crate::core::formats;
use crate::core::image::Plane;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::programs::prepare::account::Account;
use crate::programs::prepare::capture::{Depth, Shot};
use crate::programs::prepare::labels::MOST_COLUMNS;
use crate::programs::prepare::lens::Optics;
use glam::{DVec3, Vec2};
use std::path::Path;

/// Depth of every photograph that has a projection and no depth of its own, into files in `folder`.
///
/// # Errors
/// A network or photograph that cannot be used, depths that nothing brings to one scale.
pub(super) fn predict(
    shots: &mut [Shot],
    model: &mut Model,
    options: &NetworkOptions,
    folder: &Path,
    account: &mut Account,
    progress: &Progress,
) -> Result<()> {
    let wanted = |s: &Shot| s.depth.is_none() && !matches!(s.optics, Optics::Distorted(_));
    let mine: Vec<usize> = (0..shots.len()).filter(|i| wanted(&shots[*i])).collect();
    let Some(first) = mine.first() else {
        account.ignored("--depth-model: every photograph has depth of its own, or a lens the solver does not model");
        return Ok(());
    };
    let origin = shots[*first].world_from_camera.w_axis.truncate();
    let settings = Settings::of(model, options)?;
    let guesses = progress.stage("depth by network", mine.len() as u64, |p| {
        let look = |i: &usize| {
            p.advance(1);
            settings.guesses(model, &shots[*i], origin)
        };
        mine.iter().map(look).collect::<Result<Vec<_>>>()
    })?;
    let counts: Vec<usize> = guesses.iter().map(Vec::len).collect();
    let guesses: Vec<Guess> = guesses.into_iter().flatten().collect();
    let lines = match settings.fit {
        DepthFit::None => vec![
            Line {
                scale: 1.0,
                shift: 0.0
            };
            guesses.len()
        ],
        freedom => {
            let fit = progress.stage("scale of the depth", 1, |_| fit(&guesses, freedom));
            settled(fit, &guesses, model, account)?
        }
    };
    let mut begin = 0;
    for (i, count) in mine.into_iter().zip(counts) {
        let tiles = begin..begin + count;
        begin += count;
        let path = folder.join(format!("{}.exr", shots[i].stem));
        formats::write_plane_float(&path, &blended(&guesses[tiles.clone()], &lines[tiles]))?;
        shots[i].depth = Some(Depth {
            path,
            metres_per_step: 1.0,
            along_axis: false,
        });
    }
    Ok(())
}

/// How a network's numbers are understood.
struct Settings {
    kind: Option<DepthValues>,
    fit: DepthFit,
}

impl Settings {
    fn of(model: &Model, options: &NetworkOptions) -> Result<Self> {
        let properties = model.properties();
        let kind = properties.choice(options.depth_values, "depth_values")?;
        let fit = properties.choice(options.depth_fit, "depth_fit")?;
        let usual = match kind.is_some_and(DepthValues::is_inverse) {
            true => DepthFit::Affine,
            false => DepthFit::Scale,
        };
        Ok(Self {
            kind,
            fit: fit.unwrap_or(usual),
        })
    }

    fn guesses(&self, model: &mut Model, shot: &Shot, origin: DVec3) -> Result<Vec<Guess>> {
        let path = model.path.clone();
        let mut guesses = Vec::new();
        model.look(shot, origin, |answer| {
            guesses.push(self.guess(answer, shot, &path)?);
            Ok(())
        })?;
        Ok(guesses)
    }

    fn guess(&self, answer: Answer, shot: &Shot, path: &Path) -> Result<Guess> {
        let Answer { tile, output } = answer;
        let [width, height] = output.size;
        let usable = (output.channels == 1)
            .then(|| Plane::from_data(width, height, output.values))
            .flatten()
            .filter(|v| v.data.iter().any(|v| v.is_finite() && *v != 0.0));
        let values = usable.ok_or_else(|| {
            Error::input(
                path,
                format!(
                    "gives {} maps for {}; expected one of finite numbers, the depth. A network of classes goes to --semantic-model",
                    output.channels,
                    shot.image.display()
                ),
            )
        })?;
        let usual = match tile.is_perspective() {
            true => DepthValues::Z,
            false => DepthValues::Ray,
        };
        let anchor = |p: &DVec3| {
            let seen = tile.photo.position + tile.photo.world_from_camera * p.as_vec3();
            Some(Anchor {
                pixel: tile.project(seen)?,
                distance: Some(p.length() as f32).filter(|d| *d > 0.0)?,
            })
        };
        Ok(Guess {
            tile,
            values,
            kind: self.kind.unwrap_or(usual),
            anchors: shot.points.iter().filter_map(anchor).collect(),
        })
    }
}

/// The lines of a fit that holds, told.
fn settled(
    fit: Option<Fit>,
    guesses: &[Guess],
    model: &Model,
    account: &mut Account,
) -> Result<Vec<Line>> {
    let founded = fit.filter(|f| 2 * f.unfounded <= guesses.len());
    let fit = founded.ok_or_else(|| {
        Error::input(
            &model.path,
            "nothing tells the scale of its depth: too few photographs from different places see the same surfaces, and no sparse points lie with them. Add photographs, or say with --depth-fit none that the network gives metres",
        )
    })?;
    let points: usize = guesses.iter().map(|g| g.anchors.len()).sum();
    let held = match points {
        0 => String::new(),
        n => format!(" and {n} sparse points"),
    };
    let unfounded = match fit.unfounded {
        0 => String::new(),
        n => format!("; nothing founds {n} of them"),
    };
    account.converted(format!(
        "depth by the network {}: {} images brought to one scale by overlaps{held}; where they agree, to {:.1} % (standard deviation), each scale to {:.1} % (standard error){unfounded}",
        model.path.display(),
        guesses.len(),
        100.0 * fit.spread,
        100.0 * fit.error,
    ));
    Ok(fit.lines)
}

/// Metres along the ray over a photograph; 0 where no tile has any.
fn blended(guesses: &[Guess], lines: &[Line]) -> Plane<f32> {
    let Some(photo) = guesses.first().map(|g| g.tile.photo) else {
        return Plane::filled(1, 1, 0.0);
    };
    let width = photo.width.min(MOST_COLUMNS);
    let shrink = photo.width as f32 / width as f32;
    let height = ((photo.height as f32 / shrink).round() as usize).max(1);
    let scale = Vec2::new(shrink, photo.height as f32 / height as f32);
    let pixel = |i: usize| {
        let place = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5) * scale;
        let (mut sum, mut whole) = (0.0, 0.0);
        for (guess, line) in guesses.iter().zip(lines) {
            let Some(at) = guess.tile.tile_pixel(place) else {
                continue;
            };
            if let Some(d) = guess.distance(at, *line) {
                let weight = guess.tile.weight(at);
                sum += weight * d;
                whole += weight;
            }
        }
        if whole > 0.0 { sum / whole } else { 0.0 }
    };
    Plane {
        width,
        height,
        data: (0..width * height).into_par_iter().map(pixel).collect(),
    }
}
