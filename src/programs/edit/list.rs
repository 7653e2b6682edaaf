//! The list of edits as people write it.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Name of the list in an output folder.
pub const EDITS: &str = "edits.toml";

/// All edits, applied in order.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EditList {
    /// The edits.
    #[serde(rename = "edit")]
    pub edits: Vec<Edit>,
}

/// Which surfaces (all given criteria must hold; none = everything) and what becomes of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Edit {
    /// Class: its id, or its name if the scene's classes are known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub class: Option<String>,
    /// Room id.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub room: Option<u16>,
    /// A point on a surface, coordinates of the scene's file: the connected smooth surface of one
    /// class around it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point: Option<[f64; 3]>,
    /// A picture on the atlas: white is edited, black is not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask: Option<PathBuf>,
    /// New values.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub set: Option<Paint>,
    /// Factors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<Scale>,
    /// New colour of the same brightness: albedo's mean luminance stays, its texture stays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tint: Option<[f32; 3]>,
    /// A texture set in place of the surface's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texture: Option<TextureSet>,
}

/// Values to set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Paint {
    /// Linear RGB, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo: Option<[f32; 3]>,
    /// Roughness, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness: Option<f32>,
}

/// Factors on the values that are there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scale {
    /// Per channel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo: Option<[f32; 3]>,
    /// On R.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness: Option<f32>,
}

/// How a texture set lies on a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mapping {
    /// From three sides, blended by the normal.
    #[default]
    Triplanar,
    /// From the side the normal faces most.
    Box,
    /// From above.
    Planar,
}

/// Pictures that replace a surface's texture.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TextureSet {
    /// Albedo: PNG or JPEG (sRGB), EXR or HDR (linear); relative to the list.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo: Option<PathBuf>,
    /// Roughness: grey PNG (linear) or EXR.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness: Option<PathBuf>,
    /// Width of one repetition, metres; 1 if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size: Option<f32>,
    /// Degrees, counter-clockwise.
    pub rotation: f32,
    /// Projection.
    pub mapping: Mapping,
}

impl EditList {
    /// Reads and checks a list.
    ///
    /// # Errors
    /// The file cannot be read, a key in it is unknown or a value out of range.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| {
            Error::input(
                path,
                format!("cannot be read ({e}); expected a TOML list of [[edit]] tables"),
            )
        })?;
        let list: Self = toml::from_str(&text)
            .map_err(|e| Error::input(path, format!("is no list of edits: {e}")))?;
        for (i, edit) in list.edits.iter().enumerate() {
            edit.check()
                .map_err(|m| Error::input(path, format!("edit[{i}].{m}")))?;
        }
        Ok(list)
    }
}

impl EditList {
    /// Replaces class names by ids where they are known; true if anything was replaced.
    pub fn name_classes(&mut self, classes: &[(u16, String)]) -> bool {
        let mut any = false;
        for class in self.edits.iter_mut().filter_map(|e| e.class.as_mut()) {
            if let Some((id, _)) = classes.iter().find(|c| c.1.eq_ignore_ascii_case(class)) {
                *class = id.to_string();
                any = true;
            }
        }
        any
    }

    /// Makes pictures that are named relative to the list's own `file` absolute, for a list that
    /// moves elsewhere; true if there were any.
    ///
    /// # Errors
    /// The current folder is gone.
    pub fn anchor(&mut self, file: &Path) -> Result<bool> {
        let file = std::path::absolute(file).map_err(|e| Error::io(file, e))?;
        let folder = file.parent().unwrap_or(Path::new("/"));
        let mut any = false;
        for file in self
            .edits
            .iter_mut()
            .flat_map(Edit::files_mut)
            .filter(|f| f.is_relative())
        {
            *file = folder.join(&*file);
            any = true;
        }
        Ok(any)
    }

    /// Writes the list, whole or not at all.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text =
            toml::to_string(self).map_err(|e| Error::Failed(format!("{}: {e}", path.display())))?;
        crate::core::formats::atomic_write(path, text.as_bytes())
    }
}

impl Edit {
    fn files_mut(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let (albedo, roughness) = self
            .texture
            .as_mut()
            .map_or((None, None), |t| (t.albedo.as_mut(), t.roughness.as_mut()));
        self.mask.iter_mut().chain(albedo).chain(roughness)
    }

    /// The pictures it names.
    pub fn files(&self) -> impl Iterator<Item = &PathBuf> {
        let set = self.texture.as_ref();
        self.mask
            .iter()
            .chain(set.and_then(|t| t.albedo.as_ref()))
            .chain(set.and_then(|t| t.roughness.as_ref()))
    }

    fn check(&self) -> std::result::Result<(), String> {
        let unit = |values: &[f32], at: &str| {
            let fine = values.iter().all(|v| (0.0..=1.0).contains(v));
            if fine {
                Ok(())
            } else {
                Err(format!("{at}: {values:?}; expected values from 0 to 1"))
            }
        };
        let factor = |values: &[f32], at: &str| {
            let fine = values.iter().all(|v| v.is_finite() && *v >= 0.0);
            if fine {
                Ok(())
            } else {
                Err(format!(
                    "{at}: {values:?}; expected finite factors that are not negative"
                ))
            }
        };
        if let Some(s) = &self.set {
            unit(&s.albedo.map_or(vec![], |a| a.to_vec()), "set.albedo")?;
            unit(&s.roughness.map_or(vec![], |r| vec![r]), "set.roughness")?;
        }
        if let Some(s) = &self.scale {
            factor(&s.albedo.map_or(vec![], |a| a.to_vec()), "scale.albedo")?;
            factor(&s.roughness.map_or(vec![], |r| vec![r]), "scale.roughness")?;
        }
        factor(&self.tint.map_or(vec![], |t| t.to_vec()), "tint")?;
        if self.tint.is_some_and(|t| t == [0.0; 3]) {
            return Err("tint: black is no tint; use set.albedo".into());
        }
        if let Some(t) = &self.texture {
            if t.albedo.is_none() && t.roughness.is_none() {
                return Err("texture: names neither albedo nor roughness".into());
            }
            if !(t.size.unwrap_or(1.0) > 0.0
                && t.size.unwrap_or(1.0).is_finite()
                && t.rotation.is_finite())
            {
                return Err("texture.size: expected metres above 0".into());
            }
        }
        if self.set.is_none()
            && self.scale.is_none()
            && self.tint.is_none()
            && self.texture.is_none()
        {
            return Err("set: missing; give set, scale, tint or texture".into());
        }
        if self.point.is_some_and(|p| p.iter().any(|x| !x.is_finite())) {
            return Err("point: expected three finite coordinates".into());
        }
        Ok(())
    }
}
