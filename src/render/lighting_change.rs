//! Changed light: which lamps burn, how, where; what is added; what lies outside.

use super::added_lamp::{finite, light};
use super::{Added, EditableScene, LampMove};
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::luminance;
use crate::error::{Error, Result};
use crate::solution::Lamp;
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f32::consts::{PI, TAU};
use std::path::{Path, PathBuf};

/// A change of one lamp (or of all, where neither `group` nor `near` is given).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct LampChange {
    /// Number of the lamp in `--list-lamps`.
    pub group: Option<usize>,
    /// A point in the coordinates of the scene's file: the lamp whose centre is nearest to it.
    pub near: Option<[f64; 3]>,
    /// Switched off.
    pub off: bool,
    /// Factor on its light.
    pub scale: Option<f32>,
    /// Colour filter: factor per channel.
    pub colour: Option<[f32; 3]>,
    /// Displacement of the lamp with its body, metres; a lamp that is a part of something much
    /// larger, as of a ceiling, leaves it behind.
    #[serde(rename = "move")]
    pub shift: Option<[f32; 3]>,
}

/// A change of the light from outside.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct EnvironmentChange {
    /// Nothing comes from outside.
    pub off: bool,
    /// An equirectangular panorama (EXR or HDR, axes as a scene's images with the identity pose).
    pub file: Option<PathBuf>,
    /// The same radiance from everywhere.
    pub constant: Option<[f32; 3]>,
    /// Factor.
    pub scale: Option<f32>,
    /// Factor per channel.
    pub colour: Option<[f32; 3]>,
}

/// A lighting file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Lighting {
    /// Changes of lamps, in order.
    #[serde(rename = "lamp")]
    pub lamps: Vec<LampChange>,
    /// New lamps.
    pub add: Vec<Added>,
    /// Change of the light from outside.
    pub environment: EnvironmentChange,
}

impl Lighting {
    /// Reads a lighting file; paths in it are relative to it.
    ///
    /// # Errors
    /// The file cannot be read, or a key in it is unknown or out of range.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| {
            Error::input(
                path,
                format!("cannot be read ({e}); give --lights an existing TOML file"),
            )
        })?;
        let mut out: Self = toml::from_str(&text)
            .map_err(|e| Error::input(path, format!("is no lighting file: {e}")))?;
        out.resolve(path.parent().unwrap_or(Path::new(".")));
        out.check().map_err(|m| Error::input(path, m))?;
        Ok(out)
    }

    /// Files it names: measured luminaires and the panorama.
    pub fn files(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let luminaires = self.add.iter_mut().filter_map(|a| {
            if let Added::Ies { file, .. } = a {
                Some(file)
            } else {
                None
            }
        });
        luminaires.chain(&mut self.environment.file)
    }

    /// Takes the paths in it to be relative to a folder.
    pub fn resolve(&mut self, folder: &Path) {
        for file in self.files() {
            *file = folder.join(&file);
        }
    }

    /// Whether all that is given is light, and somewhere.
    ///
    /// # Errors
    /// What is out of range, in words that name its key.
    pub fn check(&self) -> std::result::Result<(), String> {
        for (i, l) in self.lamps.iter().enumerate() {
            if l.group.is_some() && l.near.is_some() {
                return Err(format!("lamp[{i}]: has both group and near; keep one"));
            }
            light(
                &l.scale.map_or(vec![], |s| vec![s]),
                &format!("lamp[{i}].scale"),
            )?;
            light(
                &l.colour.map_or(vec![], |c| c.to_vec()),
                &format!("lamp[{i}].colour"),
            )?;
            let shift = l.shift.map(|s| s.map(f64::from));
            for (place, key) in [(l.near, "near"), (shift, "move")] {
                place
                    .iter()
                    .try_for_each(|p| finite(p, &format!("lamp[{i}].{key}")))?;
            }
        }
        for (i, added) in self.add.iter().enumerate() {
            added.check().map_err(|m| format!("add[{i}]{m}"))?;
        }
        light(
            &self.environment.scale.map_or(vec![], |s| vec![s]),
            "environment.scale",
        )?;
        light(
            &self.environment.constant.map_or(vec![], |s| s.to_vec()),
            "environment.constant",
        )?;
        light(
            &self.environment.colour.map_or(vec![], |s| s.to_vec()),
            "environment.colour",
        )
    }

    /// Names lamps by their places instead of their numbers, for another solution of the same
    /// scene.
    pub fn by_place(&mut self, groups: &[Lamp]) {
        for change in &mut self.lamps {
            if let Some(group) = change
                .group
                .and_then(|id| groups.iter().find(|g| g.id == id))
            {
                change.near = Some(group.centre);
                change.group = None;
            }
        }
    }

    /// Brings the changes into a world. `groups` are its lamps, `origin` its solution's origin.
    ///
    /// # Errors
    /// A lamp is named that does not exist; the panorama cannot be read.
    pub fn apply(&self, world: &mut EditableScene<'_>, groups: &[Lamp]) -> Result<()> {
        let mut moves = BTreeMap::<usize, LampMove>::new();
        for change in &self.lamps {
            let chosen: Vec<&Lamp> = match (change.group, change.near) {
                (Some(id), _) => match groups.iter().find(|g| g.id == id) {
                    Some(g) => vec![g],
                    None => {
                        let n = groups.len();
                        return Err(Error::Usage(format!(
                            "lamp {id} does not exist: there are {n}; `unbake relight OUT --list-lamps` lists them"
                        )));
                    }
                },
                (None, Some(p)) => {
                    let distance =
                        |g: &&Lamp| (DVec3::from_array(g.centre) - DVec3::from_array(p)).length();
                    groups
                        .iter()
                        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
                        .into_iter()
                        .collect()
                }
                (None, None) => groups.iter().collect(),
            };
            let factor = if change.off {
                0.0
            } else {
                change.scale.unwrap_or(1.0)
            };
            let factor = Vec3::from_array(change.colour.unwrap_or([1.0; 3])) * factor;
            for g in chosen {
                world.scale_emission(&g.triangles, factor);
                if let Some(by) = change.shift {
                    let new = || LampMove {
                        triangles: g.triangles.clone(),
                        by: Vec3::ZERO,
                    };
                    moves.entry(g.id).or_insert_with(new).by += Vec3::from_array(by);
                }
            }
        }
        world.move_lamps(&moves.into_values().collect::<Vec<_>>());
        for lamp in &self.add {
            world.add(lamp)?;
        }
        let e = &self.environment;
        if let Some(file) = &e.file {
            world.set_environment(crate::core::formats::read_panorama(file)?);
        } else if let Some(c) = e.constant {
            world.set_environment(Plane::filled(4, 2, Vec3::from_array(c)));
        }
        let factor = if e.off { 0.0 } else { e.scale.unwrap_or(1.0) };
        world.scale_environment(Vec3::from_array(e.colour.unwrap_or([1.0; 3])) * factor);
        Ok(())
    }
}

/// Radius of the sun's disc in radians: wider than the true one (0.0047), so that it can be
/// sampled; its power is right.
const SUN_RADIUS: f32 = 0.06;

/// A clear sky at an hour of the day (0 to 24), and the factor for the lamps: on after dark.
/// `level` is the mean luminance of the sky at noon.
#[must_use]
pub fn daylight(hour: f32, level: f32) -> (RgbPlane, f32) {
    let noon = 60f32.to_radians();
    let elevation = noon * (TAU * (hour - 6.0) / 24.0).sin();
    let azimuth = TAU * (hour - 12.0) / 24.0;
    let sun = Vec3::new(
        elevation.cos() * azimuth.sin(),
        elevation.sin(),
        elevation.cos() * azimuth.cos(),
    );
    // day, and the warm hour around sunrise and sunset
    let day = ((elevation.sin() + 0.1) / 0.5).clamp(0.0, 1.0);
    let warm = (1.0 - (elevation / 0.35).abs()).clamp(0.0, 1.0);
    let zenith = Vec3::new(0.45, 0.75, 1.45) * (day + 0.003);
    let horizon =
        Vec3::new(0.9, 1.0, 1.15) * (day + 0.003) + Vec3::new(1.1, 0.45, 0.12) * (0.5 * warm);
    let ground = Vec3::new(0.30, 0.28, 0.24) * (day + 0.002);
    // the direct sun sends about five times the sky's irradiance at noon, less through more air
    let path = (-0.12 / elevation.sin().max(0.02)).exp();
    let sun_power = if elevation > -SUN_RADIUS {
        5.0 * PI * path * Vec3::new(1.0, 0.92 - 0.35 * warm, 0.82 - 0.6 * warm)
    } else {
        Vec3::ZERO
    };
    let sun_radiance = sun_power / (PI * SUN_RADIUS * SUN_RADIUS);
    let (w, h) = (512usize, 256usize);
    let colour = |i: usize| {
        let lambda = TAU * ((i % w) as f32 + 0.5) / w as f32 - PI;
        let theta = PI * ((i / w) as f32 + 0.5) / h as f32;
        let d = Vec3::new(
            lambda.sin() * theta.sin(),
            theta.cos(),
            -lambda.cos() * theta.sin(),
        );
        let sky = horizon.lerp(zenith, d.y.max(0.0).sqrt());
        let t = (d.y / 0.05 + 0.5).clamp(0.0, 1.0);
        let mut l = ground.lerp(sky, t * t * (3.0 - 2.0 * t));
        let angle = d.dot(sun).clamp(-1.0, 1.0).acos();
        if d.y > 0.0 {
            let edge = ((SUN_RADIUS - angle) / (0.2 * SUN_RADIUS) + 0.5).clamp(0.0, 1.0);
            l += sun_radiance * edge + horizon * (0.6 * (-angle / 0.25).exp());
        }
        l * level
    };
    (
        Plane {
            width: w,
            height: h,
            data: (0..w * h).map(colour).collect(),
        },
        1.0 - ((elevation.sin() + 0.05) / 0.25).clamp(0.0, 1.0),
    )
}

/// Mean luminance over the sphere of an equirectangular map.
#[must_use]
pub fn mean_luminance(map: &RgbPlane) -> f32 {
    let (mut sum, mut total) = (0.0f64, 0.0f64);
    for (i, c) in map.data.iter().enumerate() {
        let weight = f64::from((PI * ((i / map.width) as f32 + 0.5) / map.height as f32).sin());
        sum += weight * f64::from(luminance(*c));
        total += weight;
    }
    (sum / total.max(1e-12)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::SurfaceModel;
    use crate::solution::find_lamps;
    use crate::solution::tests::small_solution;

    #[test]
    fn a_lighting_file_is_applied_and_its_errors_are_named() {
        let folder = tempfile::tempdir().expect("temp");
        let path = folder.path().join("lights.toml");
        let mut solution = small_solution();
        solution.emission.data.fill(Vec3::splat(2.0));
        std::fs::write(
            &path,
            "[[lamp]]\ngroup = 1\nscale = 0.5\ncolour = [1, 0.5, 0]\n[[add]]\nkind = \"sphere\"\nposition = [0,1,0]\nradius = 0.1\nradiance = [3,3,3]\n[environment]\nconstant = [1,2,3]\nscale = 2\n",
        )
        .expect("writes");
        let mut world = EditableScene::new(&solution);
        let groups = find_lamps(&solution.mesh, &solution.emission, solution.origin);
        Lighting::read(&path)
            .expect("valid")
            .apply(&mut world, &groups)
            .expect("applies");
        assert_eq!(
            world.surface(0, 0.3, 0.3).emission,
            Vec3::new(1.0, 0.5, 0.0)
        );
        assert!(world.mesh().triangles.len() > 100);
        assert_eq!(
            crate::render::Environment::radiance(&world, Vec3::X),
            Vec3::new(2.0, 4.0, 6.0)
        );

        for (text, expected) in [
            ("[[lamp]]\nbright = 2\n", "bright"),
            ("[[lamp]]\ngroup = 1\nscale = -1\n", "lamp[0].scale"),
            ("[[lamp]]\ngroup = 1\nnear = [0,0,0]\n", "keep one"),
            ("[[add]]\nkind = \"candle\"\n", "candle"),
            ("[[lamp]]\nnear = [nan,0,0]\n", "lamp[0].near"),
            ("[[lamp]]\nmove = [0,inf,0]\n", "lamp[0].move"),
            (
                "[[add]]\nkind = \"point\"\nposition = [inf,0,0]\nintensity = [1,1,1]\n",
                "add[0].position",
            ),
            (
                "[[add]]\nkind = \"sphere\"\nposition = [0,0,0]\nradius = 0\nradiance = [1,1,1]\n",
                "add[0].radius",
            ),
            (
                "[[add]]\nkind = \"quad\"\nposition = [0,0,0]\ndirection = [0,0,0]\nsize = [1,1]\nradiance = [1,1,1]\n",
                "add[0].direction",
            ),
            (
                "[[add]]\nkind = \"spot\"\nposition = [0,0,0]\ndirection = [0,-1,0]\nangle = 120\nintensity = [1,1,1]\n",
                "add[0].angle",
            ),
            (
                "[[add]]\nkind = \"spot\"\nposition = [0,0,0]\ndirection = [0,-1,0]\nangle = 20\nblend = 5\nintensity = [1,1,1]\n",
                "add[0].blend",
            ),
        ] {
            std::fs::write(&path, text).expect("writes");
            let e = Lighting::read(&path).expect_err("wrong");
            assert!(
                e.exit_code() == 2 && e.to_string().contains(expected),
                "{e}"
            );
        }
        // twice the way of one step, not two lamps
        std::fs::write(&path, "[[lamp]]\nmove = [0, 1, 0]\n".repeat(2)).expect("writes");
        let mut moved = EditableScene::new(&solution);
        let twice = Lighting::read(&path).expect("valid");
        twice.apply(&mut moved, &groups).expect("applies");
        assert!(moved.beyond_solution().is_empty());
        let [from, to] = [&solution.mesh, moved.mesh()].map(|m| m.position(0, 0.3, 0.3));
        assert!((to - from - 2.0 * Vec3::Y).length() < 1e-6);

        let none = Lighting {
            lamps: vec![LampChange {
                group: Some(7),
                ..LampChange::default()
            }],
            ..Lighting::default()
        };
        assert!(
            none.apply(&mut EditableScene::new(&solution), &groups)
                .expect_err("no lamp 7")
                .to_string()
                .contains("--list-lamps")
        );
    }

    #[test]
    fn noon_is_bright_and_night_is_dark() {
        let (noon, lamps) = daylight(12.0, 1.0);
        assert!(lamps < 0.01 && mean_luminance(&noon) > 1.0);
        let (night, lamps) = daylight(0.0, 1.0);
        assert!(lamps > 0.99 && mean_luminance(&night) < 0.02);
        let (evening, _) = daylight(17.8, 1.0);
        assert!(mean_luminance(&evening) < mean_luminance(&noon));
        assert!(
            evening
                .data
                .iter()
                .all(|c| c.is_finite() && c.min_element() >= 0.0)
        );
    }
}
