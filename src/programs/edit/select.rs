//! Which texels an edit means.

use super::Edit;
use crate::core::formats::read_ldr;
use crate::core::geometry::{Mesh, vector_key};
use crate::core::image::RgbPlane;
use crate::error::{Error, Result};
use crate::solution::Solution;
use glam::{DVec3, Vec2, Vec3};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// A picked surface ends where neighbouring triangles meet at more than this angle (cosine): 35°.
const SMOOTH: f32 = 0.82;
/// A picked point lies at most this far from the surface, as a share of the scene's diagonal.
const REACH: f32 = 0.02;

/// What an edit selects.
pub struct Selection {
    class: Option<u16>,
    room: Option<u16>,
    triangles: Option<Vec<bool>>,
    mask: Option<RgbPlane>,
}

/// Resolves edits against a solution.
pub struct Selector<'a> {
    solution: &'a Solution,
    /// Class names, if known.
    classes: &'a [(u16, String)],
    folder: &'a Path,
}

impl<'a> Selector<'a> {
    /// `classes` may be empty if their names are not known; paths are relative to `folder`.
    #[must_use]
    pub fn new(solution: &'a Solution, classes: &'a [(u16, String)], folder: &'a Path) -> Self {
        Self {
            solution,
            classes,
            folder,
        }
    }

    /// What one edit selects.
    ///
    /// # Errors
    /// A class or room that does not exist, a point beside every surface, an unreadable mask.
    pub fn select(&self, index: usize, edit: &Edit) -> Result<Selection> {
        let list = self.folder.join(super::EDITS);
        let wrong = |m: String| Error::input(&list, format!("edit[{index}].{m}"));
        let class = match &edit.class {
            None => None,
            Some(name) => Some(self.class_of(name).map_err(wrong)?),
        };
        if let Some(room) = edit.room {
            let rooms: BTreeSet<u16> = self.solution.rooms.data.iter().copied().collect();
            if !rooms.contains(&room) {
                return Err(wrong(format!(
                    "room: there is no room {room}; the solution has {rooms:?}"
                )));
            }
        }
        let triangles = match edit.point {
            None => None,
            Some(p) => {
                let local = (DVec3::from_array(p) - self.solution.origin).as_vec3();
                let found = surface_around(self.solution, local);
                Some(found.ok_or_else(|| {
                    wrong(format!(
                        "point: no surface near {p:?}; click a point on one in `unbake view`"
                    ))
                })?)
            }
        };
        let mask = edit
            .mask
            .as_ref()
            .map(|m| read_ldr(self.folder.join(m)))
            .transpose()?;
        Ok(Selection {
            class,
            room: edit.room,
            triangles,
            mask,
        })
    }

    /// A class that the solution has, by name or id.
    fn class_of(&self, name: &str) -> std::result::Result<u16, String> {
        let id = self.class_id(name)?;
        if self.solution.labels.data.contains(&id) {
            return Ok(id);
        }
        let known: BTreeSet<u16> = self.solution.labels.data.iter().copied().collect();
        Err(format!(
            "class: no surface is of class {id} ({name}); the solution has {known:?}"
        ))
    }

    fn class_id(&self, name: &str) -> std::result::Result<u16, String> {
        if let Ok(id) = name.parse::<u16>() {
            return Ok(id);
        }
        if self.classes.is_empty() {
            return Err(format!(
                "class: \"{name}\" is a name, and the class names are not known here; give the id or --scene"
            ));
        }
        let known = || {
            self.classes
                .iter()
                .map(|c| c.1.as_str())
                .collect::<Vec<_>>()
                .join(", ")
        };
        let found = self.classes.iter().find(|c| c.1.eq_ignore_ascii_case(name));
        found
            .map(|c| c.0)
            .ok_or_else(|| format!("class: there is no \"{name}\"; the scene has {}", known()))
    }
}

impl Selection {
    /// How much the edit means a surface point, 0 to 1.
    #[must_use]
    pub fn weight(&self, solution: &Solution, triangle: usize, uv: Vec2) -> f32 {
        let at = |w: usize, h: usize| uv * Vec2::new(w as f32, h as f32);
        let (labels, rooms) = (&solution.labels, &solution.rooms);
        if self
            .class
            .is_some_and(|c| *labels.nearest(at(labels.width, labels.height)) != c)
            || self
                .room
                .is_some_and(|r| *rooms.nearest(at(rooms.width, rooms.height)) != r)
            || self.triangles.as_ref().is_some_and(|t| !t[triangle])
        {
            return 0.0;
        }
        self.mask.as_ref().map_or(1.0, |m| {
            // the mask is a picture of weights, read as sRGB: brought back to what its bytes say
            let v = crate::core::math::luminance(*m.nearest(at(m.width, m.height))).clamp(0.0, 1.0);
            if v <= 0.003_130_8 {
                12.92 * v
            } else {
                1.055 * v.powf(1.0 / 2.4) - 0.055
            }
        })
    }
}

/// The triangles of the smooth surface of one class around a point; `None` if no surface is near.
fn surface_around(solution: &Solution, p: Vec3) -> Option<Vec<bool>> {
    let mesh = &solution.mesh;
    let (lo, hi) = mesh.bounds();
    let distance = |t: usize| {
        let (u, v) = mesh.barycentrics(t, p);
        (mesh.position(t, u, v) - p).length()
    };
    let usable = (0..mesh.triangles.len()).filter(|&t| mesh.area(t) > 0.0);
    let (start, d) = usable
        .map(|t| (t, distance(t)))
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    if d.is_nan() || d > REACH * (hi - lo).length() {
        return None;
    }
    let edges = neighbours(mesh);
    let label = |t: usize| {
        let l = &solution.labels;
        *l.nearest(mesh.uv(t, 1.0 / 3.0, 1.0 / 3.0) * Vec2::new(l.width as f32, l.height as f32))
    };
    let wanted = label(start);
    let mut chosen = vec![false; mesh.triangles.len()];
    let mut stack = vec![start];
    chosen[start] = true;
    while let Some(t) = stack.pop() {
        for &n in &edges[t] {
            let n = n as usize;
            if !chosen[n]
                && label(n) == wanted
                && mesh.face_normal(t).dot(mesh.face_normal(n)) > SMOOTH
            {
                chosen[n] = true;
                stack.push(n);
            }
        }
    }
    Some(chosen)
}

/// Triangles that share two vertex positions with each triangle.
fn neighbours(mesh: &Mesh) -> Vec<Vec<u32>> {
    let mut ids: BTreeMap<[u32; 3], u32> = BTreeMap::new();
    let weld: Vec<u32> = mesh
        .positions
        .iter()
        .map(|&p| {
            let next = ids.len() as u32;
            *ids.entry(vector_key(p)).or_insert(next)
        })
        .collect();
    let mut of_edge: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
    for (t, c) in mesh.triangles.iter().enumerate() {
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            let (a, b) = (weld[c[a] as usize], weld[c[b] as usize]);
            of_edge
                .entry((a.min(b), a.max(b)))
                .or_default()
                .push(t as u32);
        }
    }
    let mut out = vec![Vec::new(); mesh.triangles.len()];
    for sharing in of_edge.values() {
        for &a in sharing {
            out[a as usize].extend(sharing.iter().copied().filter(|&b| b != a));
        }
    }
    out
}
