//! `lightings.toml`: the lightings that `export --lightings` writes, one by one or drawn at random
//! from stated distributions.
//!
//! A lighting says what a lighting file of `relight` says ([`Lighting`]), under a name. Draws are
//! keyed by seed, place and quantity: one more lamp or lighting changes no other.

use crate::core::formats::read_input_text;
use crate::core::sampling::KeyedRng;
use crate::error::{Error, Result};
use crate::render::{Added, EnvironmentChange, LampChange, Lighting};
use crate::solution::Lamp;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::f32::consts::TAU;
use std::path::{Path, PathBuf};

/// The file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
struct LightingsFile {
    /// Key of all draws; that of the command where it is not given.
    seed: Option<u64>,
    lighting: Vec<Stated>,
    random: Vec<RandomLightings>,
}

/// A lighting with all its values.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
struct Stated {
    name: String,
    lamp: Vec<LampChange>,
    add: Vec<Added>,
    environment: EnvironmentChange,
}

/// Lightings drawn at random.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
struct RandomLightings {
    /// Their names are this with a number.
    name: String,
    count: usize,
    /// Lamps that are drawn for; all where it is not given. The others keep their light.
    lamps: Option<Vec<usize>>,
    /// Probability that a lamp is on.
    on: Option<f32>,
    /// Factor on a lamp's light.
    scale: Option<Distribution>,
    /// Factor per channel.
    colour: Option<[Distribution; 3]>,
    environment: RandomEnvironment,
}

/// Light from outside, drawn at random.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
struct RandomEnvironment {
    /// Probability that there is any.
    on: Option<f32>,
    /// Panoramas of which one is taken; the scene's own where there are none.
    files: Vec<PathBuf>,
    scale: Option<Distribution>,
    colour: Option<[Distribution; 3]>,
}

/// What a factor is drawn from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Distribution {
    /// Always the same.
    Fixed(f32),
    /// Evenly between two values.
    Uniform([f32; 2]),
    /// Its logarithm evenly between those of two values.
    LogUniform([f32; 2]),
    /// Mean and standard deviation; below 0 it is 0.
    Normal([f32; 2]),
    /// One of a list.
    Choice(Vec<f32>),
}

/// A lighting with its name.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedLighting {
    /// Name, fit for a file.
    pub name: String,
    /// Its changes of the light, drawn where they are random.
    pub lighting: Lighting,
    /// Whether it was drawn.
    pub random: bool,
}

/// The lightings of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Lightings {
    /// Key of the draws.
    pub seed: u64,
    /// In the order of the file, stated ones first.
    pub list: Vec<NamedLighting>,
}

impl Lightings {
    /// Reads a file and draws what is random in it. `lamps` are the solution's, `seed` is used where
    /// the file has none; paths in the file are relative to it.
    ///
    /// # Errors
    /// The file cannot be read; a key in it is unknown or out of range; a name is no file's or is
    /// there twice; a lamp does not exist.
    pub fn read(path: &Path, lamps: &[Lamp], seed: u64) -> Result<Self> {
        let text = read_input_text(path)
            .map_err(|e| e.advise("give --lightings an existing TOML file"))?;
        let file: LightingsFile = toml::from_str(&text)
            .map_err(|e| Error::input(path, format!("is no list of lightings: {e}")))?;
        let folder = path.parent().unwrap_or(Path::new("."));
        file.lightings(lamps, folder, seed)
            .map_err(|m| Error::input(path, m))
    }
}

/// A value or what is wrong, in words.
type Checked<T> = std::result::Result<T, String>;

impl LightingsFile {
    fn lightings(self, lamps: &[Lamp], folder: &Path, seed: u64) -> Checked<Lightings> {
        let seed = self.seed.unwrap_or(seed);
        let mut list = Vec::new();
        for (i, s) in self.lighting.into_iter().enumerate() {
            let mut lighting = Lighting {
                lamps: s.lamp,
                add: s.add,
                environment: s.environment,
            };
            lighting.resolve(folder);
            lighting.check().map_err(|m| format!("lighting[{i}].{m}"))?;
            list.push(NamedLighting {
                name: s.name,
                lighting,
                random: false,
            });
        }
        for (i, random) in self.random.iter().enumerate() {
            random
                .check(lamps)
                .map_err(|m| format!("random[{i}].{m}"))?;
            for k in 0..random.count {
                let mut lighting = random.draw(lamps, Key([seed, i as u64, k as u64]));
                lighting.resolve(folder);
                list.push(NamedLighting {
                    name: random.name_of(k),
                    lighting,
                    random: true,
                });
            }
        }
        if list.is_empty() {
            return Err(
                "has no lighting: expected [[lighting]] with a name, or [[random]] with a name and a count"
                    .into(),
            );
        }
        check_names(&list)?;
        Ok(Lightings { seed, list })
    }
}

/// Every name must do as a file's and be there once.
fn check_names(list: &[NamedLighting]) -> Checked<()> {
    let mut seen = BTreeSet::from(["unlit", "scene"].map(str::to_owned));
    for (i, l) in list.iter().enumerate() {
        let plain = |c: char| c.is_alphanumeric() || "-_ .".contains(c);
        if l.name.is_empty() || l.name.starts_with('.') || !l.name.chars().all(plain) {
            return Err(format!(
                "lighting {} of {} is named {:?}; it names a file: letters, digits, - _ . and spaces, no . first",
                i + 1,
                list.len(),
                l.name
            ));
        }
        // file systems may not tell capitals
        if !seen.insert(l.name.to_lowercase()) {
            return Err(format!(
                "{:?} names two lightings (\"unlit\" and \"scene\" are taken); give each a name of its own",
                l.name
            ));
        }
    }
    Ok(())
}

/// What a draw is for: seed, entry of the file, number of the lighting.
#[derive(Clone, Copy)]
struct Key([u64; 3]);

impl Key {
    /// The numbers of one quantity (`what`) of one lamp; lamp 0 is the light from outside.
    fn numbers(self, lamp: usize, what: u64) -> KeyedRng {
        let Key([seed, entry, lighting]) = self;
        let of_lighting = crate::core::sampling::hash_u64(entry, lighting);
        let of_quantity = crate::core::sampling::hash_u64(lamp as u64, what);
        KeyedRng::new(
            seed,
            crate::core::sampling::hash_u64(of_lighting, of_quantity),
        )
    }
}

/// The quantities that are drawn.
const ON: u64 = 0;
const SCALE: u64 = 1;
const COLOUR: u64 = 2;
const FILE: u64 = 3;

impl RandomLightings {
    fn name_of(&self, k: usize) -> String {
        format!("{}_{k:04}", self.name)
    }

    fn check(&self, lamps: &[Lamp]) -> Checked<()> {
        if self.count == 0 {
            return Err("count: missing or 0; expected how many lightings are drawn".into());
        }
        let ids = self.lamps.iter().flatten();
        if let Some(id) = ids.copied().find(|id| lamps.iter().all(|l| l.id != *id)) {
            return Err(format!(
                "lamps: lamp {id} does not exist, there are {}; `unbake relight OUT --list-lamps` lists them",
                lamps.len()
            ));
        }
        for (on, at) in [(self.on, "on"), (self.environment.on, "environment.on")] {
            if on.is_some_and(|p| !(0.0..=1.0).contains(&p)) {
                return Err(format!("{at}: expected a probability from 0 to 1"));
            }
        }
        let of_environment = &self.environment;
        let scales = [
            (&self.scale, "scale"),
            (&of_environment.scale, "environment.scale"),
        ];
        for (scale, at) in scales {
            scale.iter().try_for_each(|d| d.check(at))?;
        }
        let colours = [
            (&self.colour, "colour"),
            (&of_environment.colour, "environment.colour"),
        ];
        for (colour, at) in colours {
            colour.iter().flatten().try_for_each(|d| d.check(at))?;
        }
        Ok(())
    }

    fn draw(&self, lamps: &[Lamp], key: Key) -> Lighting {
        let chosen = |l: &&Lamp| self.lamps.as_ref().is_none_or(|ids| ids.contains(&l.id));
        let change = |l: &Lamp| LampChange {
            group: Some(l.id),
            off: is_off(self.on, l.id, key),
            scale: draw_scale(self.scale.as_ref(), l.id, key),
            colour: draw_colour(self.colour.as_ref(), l.id, key),
            ..LampChange::default()
        };
        let e = &self.environment;
        let file = key.numbers(0, FILE).below(e.files.len());
        Lighting {
            lamps: lamps.iter().filter(chosen).map(change).collect(),
            add: Vec::new(),
            environment: EnvironmentChange {
                off: is_off(e.on, 0, key),
                file: e.files.get(file).cloned(),
                scale: draw_scale(e.scale.as_ref(), 0, key),
                colour: draw_colour(e.colour.as_ref(), 0, key),
                ..EnvironmentChange::default()
            },
        }
    }
}

fn is_off(on: Option<f32>, lamp: usize, key: Key) -> bool {
    on.is_some_and(|p| key.numbers(lamp, ON).next_f32() >= p)
}

fn draw_scale(from: Option<&Distribution>, lamp: usize, key: Key) -> Option<f32> {
    from.map(|d| d.draw(&mut key.numbers(lamp, SCALE)))
}

fn draw_colour(from: Option<&[Distribution; 3]>, lamp: usize, key: Key) -> Option<[f32; 3]> {
    let mut numbers = key.numbers(lamp, COLOUR);
    from.map(|channels| channels.each_ref().map(|d| d.draw(&mut numbers)))
}

impl Distribution {
    fn check(&self, at: &str) -> Checked<()> {
        let light = |v: &f32| v.is_finite() && *v >= 0.0;
        let ascending = |[a, b]: &[f32; 2]| light(a) && light(b) && a <= b;
        let expected = match self {
            Self::Fixed(v) if !light(v) => "a factor, finite and not negative",
            Self::Uniform(range) if !ascending(range) => {
                "uniform = [LOW, HIGH], finite, not negative, ascending"
            }
            Self::LogUniform(range) if !(ascending(range) && range[0] > 0.0) => {
                "log-uniform = [LOW, HIGH], finite, above 0, ascending"
            }
            Self::Normal(parameters) if !parameters.iter().all(light) => {
                "normal = [MEAN, STANDARD DEVIATION], finite, not negative"
            }
            Self::Choice(list) if list.is_empty() || !list.iter().all(light) => {
                "choice = [FACTOR, …], finite, not negative, at least one"
            }
            _ => return Ok(()),
        };
        Err(format!("{at}: {self:?}; expected {expected}"))
    }

    fn draw(&self, numbers: &mut KeyedRng) -> f32 {
        match self {
            Self::Fixed(v) => *v,
            Self::Uniform([a, b]) => a + (b - a) * numbers.next_f32(),
            Self::LogUniform([a, b]) => a * (b / a).powf(numbers.next_f32()),
            Self::Normal([mean, deviation]) => {
                // Box & Muller 1958; 1 − u is never 0
                let radius = (-2.0 * (1.0 - numbers.next_f32()).ln()).sqrt();
                let z = radius * (TAU * numbers.next_f32()).cos();
                (mean + deviation * z).max(0.0)
            }
            Self::Choice(list) => list[numbers.below(list.len())],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lamps(count: usize) -> Vec<Lamp> {
        let lamp = |id| Lamp {
            id,
            ..Lamp::default()
        };
        (1..=count).map(lamp).collect()
    }

    fn read(text: &str, count: usize, seed: u64) -> Result<Lightings> {
        let folder = tempfile::tempdir().expect("temp");
        let path = folder.path().join("lightings.toml");
        std::fs::write(&path, text).expect("writes");
        Lightings::read(&path, &lamps(count), seed)
    }

    const RANDOM: &str = "[[random]]\nname = \"r\"\ncount = 400\non = 0.75\nscale = { log-uniform = [0.5, 2] }\n\
        colour = [{ fixed = 1 }, { uniform = [0.2, 0.6] }, { normal = [1, 0.1] }]\n\
        [random.environment]\non = 0.5\nscale = { choice = [1, 3] }\nfiles = [\"a.exr\", \"b.exr\"]\n";

    #[test]
    fn draws_follow_their_distributions() {
        let drawn = read(RANDOM, 3, 5).expect("valid").list;
        assert_eq!((drawn.len(), drawn[7].name.as_str()), (400, "r_0007"));
        let lamps: Vec<&LampChange> = drawn.iter().flat_map(|l| &l.lighting.lamps).collect();
        assert_eq!(lamps.len(), 1200);
        let mean = |f: &dyn Fn(&LampChange) -> f32| {
            lamps.iter().map(|l| f(l)).sum::<f32>() / lamps.len() as f32
        };
        let channel = |l: &LampChange, k: usize| l.colour.expect("drawn")[k];
        // four standard errors of 1200 draws
        assert!((mean(&|l| f32::from(u8::from(!l.off))) - 0.75).abs() < 0.05);
        assert!(mean(&|l| l.scale.expect("drawn").ln()).abs() < 0.05);
        assert!(
            lamps
                .iter()
                .all(|l| (0.5..=2.0).contains(&l.scale.expect("drawn")))
        );
        assert!((mean(&|l| channel(l, 1)) - 0.4).abs() < 0.014);
        assert!((mean(&|l| channel(l, 2)) - 1.0).abs() < 0.012);
        let spread = mean(&|l| (channel(l, 2) - 1.0).powi(2)).sqrt();
        assert!((spread - 0.1).abs() < 0.01, "{spread}");
        assert!(lamps.iter().all(|l| channel(l, 0) == 1.0));
        let share = |f: &dyn Fn(&EnvironmentChange) -> bool| {
            let hits = drawn.iter().filter(|l| f(&l.lighting.environment)).count();
            hits as f32 / drawn.len() as f32
        };
        assert!((share(&|e| e.off) - 0.5).abs() < 0.1);
        assert!((share(&|e| e.scale == Some(3.0)) - 0.5).abs() < 0.1);
        let is_b = |e: &EnvironmentChange| e.file.as_ref().is_some_and(|f| f.ends_with("b.exr"));
        assert!((share(&is_b) - 0.5).abs() < 0.1);
    }

    #[test]
    fn the_seed_decides_and_more_lamps_change_no_other() {
        let of = |count, seed| read(RANDOM, count, seed).expect("valid").list;
        assert_eq!(of(3, 5)[9].lighting.lamps, of(3, 5)[9].lighting.lamps);
        assert_ne!(of(3, 5)[9].lighting.lamps, of(3, 6)[9].lighting.lamps);
        assert_eq!(of(3, 5)[9].lighting.lamps, of(4, 5)[9].lighting.lamps[..3]);
        let lamps = &of(3, 5)[9].lighting.lamps;
        assert_ne!(lamps[0].scale, lamps[1].scale, "each lamp for itself");
        let own = read(&format!("seed = 6\n{RANDOM}"), 3, 5).expect("valid");
        assert_eq!((own.seed, own.list.len()), (6, 400));
        assert_eq!(own.list[9].lighting.lamps, of(3, 6)[9].lighting.lamps);
    }

    #[test]
    fn the_example_of_the_documents_is_read() {
        let text = include_str!("../../../docs/examples/lightings.toml");
        let list = read(text, 3, 0).expect("valid");
        assert_eq!((list.seed, list.list.len()), (7, 11));
        assert_eq!(list.list[0].lighting, Lighting::default());
        assert!(list.list[2].lighting.lamps[0].off);
        // what was drawn can be stated again, as a lighting file of `relight`
        let folder = tempfile::tempdir().expect("temp");
        let path = folder.path().join("lights.toml");
        let drawn = &list.list[10].lighting;
        let text = toml::to_string(drawn).expect("TOML");
        std::fs::write(&path, text).expect("writes");
        assert_eq!(&Lighting::read(&path).expect("valid"), drawn);
    }

    #[test]
    fn mistakes_are_named_with_their_place() {
        for (text, expected) in [
            ("", "[[random]]"),
            ("[[lighting]]\nname = \"a\"\nbright = 2\n", "bright"),
            ("[[lighting]]\nname = \"a/b\"\n", "names a file"),
            (
                "[[lighting]]\nname = \"a\"\n[[lighting]]\nname = \"A\"\n",
                "two lightings",
            ),
            ("[[lighting]]\nname = \"unlit\"\n", "taken"),
            (
                "[[lighting]]\nname = \"a\"\n[[lighting.lamp]]\nscale = -1\n",
                "lighting[0].lamp[0].scale",
            ),
            ("[[random]]\nname = \"a\"\n", "random[0].count"),
            (
                "[[random]]\nname = \"a\"\ncount = 1\non = 2\n",
                "random[0].on",
            ),
            (
                "[[random]]\nname = \"a\"\ncount = 1\nlamps = [3]\n",
                "lamp 3",
            ),
            (
                "[[random]]\nname = \"a\"\ncount = 1\nscale = { uniform = [2, 1] }\n",
                "uniform = [LOW, HIGH]",
            ),
            (
                "[[random]]\nname = \"a\"\ncount = 1\nscale = { even = [1, 2] }\n",
                "log-uniform",
            ),
        ] {
            let e = read(text, 2, 0).expect_err(text);
            let said = e.to_string();
            assert!(
                e.exit_code() == 2 && said.contains(expected) && said.contains("lightings.toml"),
                "{text}: {said}"
            );
        }
        let nowhere = Lightings::read(Path::new("nowhere.toml"), &[], 0).expect_err("no file");
        assert!(nowhere.to_string().contains("--lightings"), "{nowhere}");
    }
}
