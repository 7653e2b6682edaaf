//! Labels by a network: logits of the tiles are blended, and a pixel's class is the one with the most.
//! Called by `mod`.

use super::model::{Answer, Model};
use super::options::NetworkOptions;
use crate::core::formats::{self, read_input_text};
use crate::core::image::Plane;
use crate::core::parallel::prelude::*;
use crate::core::progress::Progress;
use crate::error::{Error, Result};
use crate::programs::prepare::account::Account;
use crate::programs::prepare::capture::Capture;
use crate::programs::prepare::labels::MOST_COLUMNS;
use crate::scene::{Class, is_lamp, unnamed_class};
use glam::{DVec3, Vec2};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// Names of channels that say nothing of a pixel: it is unlabelled (id 0).
const NOTHING: [&str; 8] = [
    "",
    "background",
    "void",
    "unlabeled",
    "unlabelled",
    "unknown",
    "ignore",
    "none",
];

/// Labels of every photograph, into files in `folder`; the capture's classes become the network's.
///
/// # Errors
/// A network, list of names or photograph that cannot be used.
pub(super) fn predict(
    capture: &mut Capture,
    model: &mut Model,
    options: &NetworkOptions,
    folder: &Path,
    account: &mut Account,
    progress: &Progress,
) -> Result<()> {
    let names = names(model, options.semantic_names.as_deref())?;
    let count = capture.shots.len() as u64;
    let mut seen = BTreeSet::new();
    let mut channels = names.as_ref().map(Vec::len);
    progress.stage("labels by network", count, |p| {
        for shot in &mut capture.shots {
            let info = formats::image_info(&shot.image)?;
            let mut blend = Blend::new([info.width, info.height], channels);
            let path = model.path.clone();
            model.look(shot, DVec3::ZERO, |answer| blend.add(&answer, &path))?;
            channels = Some(blend.channels);
            let ids = blend.ids(names.as_deref());
            seen.extend(ids.data.iter().copied().filter(|id| *id > 0));
            let file = folder.join(format!("{}.png", shot.stem));
            formats::write_png16(&file, &ids)?;
            shot.labels = Some(file);
            p.advance(1);
        }
        Ok(())
    })?;
    let class = |id: &u16| {
        let name = names.as_ref().map(|n| n[usize::from(*id) - 1].clone());
        let name = name.unwrap_or_else(|| unnamed_class(*id));
        Class {
            id: *id,
            is_light: is_lamp(&name),
            name,
        }
    };
    let classes: Vec<Class> = seen.iter().map(class).collect();
    let unnamed = match names {
        Some(_) => "",
        None => {
            "; the file names none of them: --semantic-names says which are lamps, metal and so on"
        }
    };
    account.converted(format!(
        "labels by the network {}: {} of its {} classes are seen{unnamed}",
        model.path.display(),
        classes.len(),
        channels.unwrap_or(0)
    ));
    if !capture.classes.is_empty() {
        account.ignored("the capture's own classes: the network's take their place");
    }
    capture.classes = classes;
    Ok(())
}

/// Names of the channels: the list given, else the file's `names` or `classes`; `None` if neither is there.
fn names(model: &Model, list: Option<&Path>) -> Result<Option<Vec<String>>> {
    let (path, found) = match list {
        Some(path) => {
            let text = read_input_text(path)?;
            let lines = text.lines().map(|l| l.trim().to_owned());
            (path, Some(lines.collect()))
        }
        None => {
            let properties = model.properties();
            let stated = ["names", "classes"]
                .iter()
                .find_map(|k| properties.of.get(*k));
            let Some(text) = stated else { return Ok(None) };
            (model.path.as_path(), stated_names(text))
        }
    };
    // ids are 16 bits, and 0 is no class
    let usable = |n: &Vec<String>| !n.is_empty() && n.len() < usize::from(u16::MAX);
    found.filter(usable).map(Some).ok_or_else(|| {
        Error::input(
            path,
            "the names of its classes cannot be read; expected metadata_props names as JSON ([\"wall\", \"floor\"] or {\"0\": \"wall\"}), or --semantic-names FILE with one name a line",
        )
    })
}

/// Names in a list, or in an object by their channels.
fn stated_names(text: &str) -> Option<Vec<String>> {
    let name = |v: &Value| v.as_str().map(|s| s.trim().to_owned());
    match serde_json::from_str(text).ok()? {
        Value::Array(all) => all.iter().map(name).collect(),
        Value::Object(all) => {
            let of = |k: usize| all.get(&k.to_string()).and_then(name);
            (0..all.len()).map(of).collect()
        }
        _ => None,
    }
}

/// Logits over a photograph, pixel by pixel.
struct Blend {
    photo: [usize; 2],
    size: [usize; 2],
    channels: usize,
    /// Weighted sums, a pixel's channels beside each other.
    sums: Vec<f32>,
}

impl Blend {
    fn new(photo: [usize; 2], channels: Option<usize>) -> Self {
        let width = photo[0].min(MOST_COLUMNS);
        let height = ((photo[1] * width) as f64 / photo[0] as f64)
            .round()
            .max(1.0) as usize;
        Self {
            photo,
            size: [width, height],
            channels: channels.unwrap_or(0),
            sums: Vec::new(),
        }
    }

    /// Adds a tile's logits; ids of classes vote in their place.
    fn add(&mut self, answer: &Answer, path: &Path) -> Result<()> {
        let output = &answer.output;
        let votes = output.integers && output.channels == 1;
        let of = match votes {
            true => self.channels,
            false => output.channels,
        };
        let wrong = match (votes, self.channels) {
            (true, 0) => Some("it gives ids of classes: name them with --semantic-names FILE, one a line".into()),
            (true, n) => (output.values.iter().any(|v| !(0.0..n as f32).contains(v)))
                .then(|| format!("it gives ids beyond its {n} names; expected a name for each")),
            (false, _) if of < 2 => Some("it gives one map of fractions; expected one for each class. A network of depth goes to --depth-model".into()),
            (false, n) => (n > 0 && n != of).then(|| format!("it gives {of} classes and has {n} names; expected as many")),
        };
        if let Some(message) = wrong {
            return Err(Error::input(path, message));
        }
        self.channels = of;
        self.sums.resize(of * self.size[0] * self.size[1], 0.0);
        let scale = Vec2::new(
            self.photo[0] as f32 / self.size[0] as f32,
            self.photo[1] as f32 / self.size[1] as f32,
        );
        let (width, map) = (self.size[0], output.size[0] * output.size[1]);
        let one = |(i, sums): (usize, &mut [f32])| {
            let place = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5) * scale;
            let Some(at) = answer.tile.tile_pixel(place) else {
                return;
            };
            let weight = answer.tile.weight(at);
            for (k, tap) in answer.taps(at) {
                if votes {
                    sums[output.values[k] as usize] += weight * tap;
                    continue;
                }
                for (c, sum) in sums.iter_mut().enumerate() {
                    *sum += weight * tap * output.values[c * map + k];
                }
            }
        };
        self.sums.par_chunks_mut(of).enumerate().for_each(one);
        Ok(())
    }

    /// Ids: 1 for the first channel; 0 where its name says nothing.
    fn ids(&self, names: Option<&[String]>) -> Plane<u16> {
        let nothing = |c: usize| {
            let name = names.map(|n| n[c].to_lowercase());
            name.is_some_and(|n| NOTHING.contains(&n.as_str()))
        };
        let id = |sums: &[f32]| {
            let most = (0..sums.len()).max_by(|a, b| sums[*a].total_cmp(&sums[*b]).then(b.cmp(a)));
            match most {
                Some(c) if !nothing(c) => (c + 1) as u16,
                _ => 0,
            }
        };
        Plane {
            width: self.size[0],
            height: self.size[1],
            data: self.sums.par_chunks(self.channels.max(1)).map(id).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_a_list_or_an_object_by_channels() {
        let expected = Some(vec!["wall".to_owned(), "ceiling lamp".to_owned()]);
        assert_eq!(stated_names(r#"["wall", "ceiling lamp "]"#), expected);
        assert_eq!(
            stated_names(r#"{"1": "ceiling lamp", "0": "wall"}"#),
            expected
        );
        assert_eq!(stated_names(r#"{"2": "lamp", "0": "wall"}"#), None);
        assert_eq!(stated_names("wall, lamp"), None);
    }
}
