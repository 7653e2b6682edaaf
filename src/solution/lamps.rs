//! The lamps of a solution: one list, one rule, one numbering, made once by `solve`, stored as
//! `lights.json` and read by every program that names a lamp (`relight`, `view`, `export`, the
//! report).
//!
//! Emitting triangles that touch or nearly so are one lamp; lamps are numbered by power. The rule
//! knows no unit: the gap is a share of the scene's diagonal.

use super::Solution;
use super::generation::other_run;
use crate::core::geometry::{Mesh, clusters};
use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::error::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use serde::{Deserialize, Serialize};
use std::f32::consts::PI;
use std::path::Path;

/// File of the list in the output folder.
pub const LIGHTS: &str = "lights.json";

/// Parts of a lamp lie at most this share of the scene's diagonal apart: a few centimetres in a
/// flat (measured: bulbs and their shades join, neighbouring spots do not, on the scenes of
/// docs/results.md).
const GAP: f32 = 0.002;

/// Points of a triangle at which its emission is looked up.
const POINTS: [(f32, f32); 7] = [
    (0.34, 0.33),
    (0.6, 0.2),
    (0.2, 0.6),
    (0.2, 0.2),
    (0.46, 0.46),
    (0.46, 0.08),
    (0.08, 0.46),
];

/// What a light is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LampKind {
    /// A surface that emits.
    #[default]
    Lamp,
    /// A surface that emits and belongs to a window.
    Window,
    /// An opening through which the environment is seen.
    Portal,
}

impl std::fmt::Display for LampKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Lamp => "lamp",
            Self::Window => "window",
            Self::Portal => "portal",
        })
    }
}

/// A lamp.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Lamp {
    /// Number by which it is named, 1 for the most powerful.
    pub id: usize,
    /// What it is.
    pub kind: LampKind,
    /// Centre of its surface in the coordinates of the scene's file, metres.
    pub centre: [f64; 3],
    /// Extent of its bounding box, metres.
    pub size: [f32; 3],
    /// Luminous area, m².
    pub area: f32,
    /// Emitted power RGB: π · ∫ radiance dA, radiance units · m².
    pub power: [f32; 3],
    /// Mean emitted radiance RGB.
    pub radiance: [f32; 3],
    /// Its radiance was clipped in the photographs and has been estimated.
    #[serde(default)]
    pub clipped: bool,
    /// Relative standard error of the power; 0 where nothing states one.
    #[serde(default)]
    pub standard_error: f32,
    /// Its triangles in `scene.glb`.
    pub triangles: Vec<u32>,
}

impl Lamp {
    /// Luminance of the power.
    #[must_use]
    pub fn strength(&self) -> f32 {
        luminance(Vec3::from_array(self.power))
    }
}

/// Distance up to which emitting triangles are one lamp, metres.
#[must_use]
pub fn lamp_gap(mesh: &Mesh) -> f32 {
    let (low, high) = mesh.bounds();
    GAP * (high - low).length()
}

/// Mean radiance that each triangle emits.
#[must_use]
pub fn triangle_emission(mesh: &Mesh, emission: &RgbPlane) -> Vec<Vec3> {
    let size = Vec2::new(emission.width as f32, emission.height as f32);
    (0..mesh.triangles.len())
        .map(|t| {
            let at = |&(u, v): &(f32, f32)| *emission.nearest(mesh.uv(t, u, v) * size);
            POINTS.iter().map(at).sum::<Vec3>() / POINTS.len() as f32
        })
        .collect()
}

/// The lamps of a mesh that emits what its texture `emission` says, most powerful first.
/// `origin` is that of [`Solution::origin`].
#[must_use]
pub fn find_lamps(mesh: &Mesh, emission: &RgbPlane, origin: DVec3) -> Vec<Lamp> {
    let mean = triangle_emission(mesh, emission);
    let emitting: Vec<u32> = (0..mesh.triangles.len())
        .filter(|&t| mean[t] != Vec3::ZERO && mesh.area(t) > 0.0)
        .map(|t| t as u32)
        .collect();
    let mut out: Vec<Lamp> = clusters(mesh, &emitting, lamp_gap(mesh))
        .into_iter()
        .map(|triangles| describe(mesh, &mean, triangles, origin))
        .collect();
    number(&mut out);
    out
}

/// Orders lights by power, ties by their first triangle, and numbers them from 1.
fn number(lamps: &mut [Lamp]) {
    lamps.sort_by(|a, b| {
        b.strength()
            .total_cmp(&a.strength())
            .then(a.triangles.first().cmp(&b.triangles.first()))
    });
    for (i, lamp) in lamps.iter_mut().enumerate() {
        lamp.id = i + 1;
    }
}

fn describe(mesh: &Mesh, mean: &[Vec3], mut triangles: Vec<u32>, origin: DVec3) -> Lamp {
    triangles.sort_unstable();
    let (mut area, mut flux, mut centre) = (0.0f32, Vec3::ZERO, Vec3::ZERO);
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for &t in &triangles {
        let t = t as usize;
        let a = mesh.area(t);
        area += a;
        flux += mean[t] * a;
        centre += mesh.position(t, 1.0 / 3.0, 1.0 / 3.0) * a;
        for p in mesh.corners(t) {
            (low, high) = (low.min(p), high.max(p));
        }
    }
    Lamp {
        centre: ((centre / area).as_dvec3() + origin).to_array(),
        size: (high - low).to_array(),
        area,
        power: (PI * flux).to_array(),
        radiance: (flux / area).to_array(),
        triangles,
        ..Lamp::default()
    }
}

/// The file's content.
#[derive(Serialize, Deserialize)]
struct LightsFile {
    /// The set of files it belongs to; `None` in files of older versions or made by hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    generation: Option<String>,
    lights: Vec<Lamp>,
}

/// The list as the bytes of `lights.json`, lamps and windows, then portals, with the generation of
/// the set of files it belongs to.
pub(super) fn encode(lamps: &[Lamp], portals: &[Lamp], generation: &str) -> Result<Vec<u8>> {
    let file = LightsFile {
        generation: Some(generation.to_owned()),
        lights: [lamps, portals].concat(),
    };
    serde_json::to_vec_pretty(&file).map_err(|e| Error::Failed(format!("{LIGHTS}: {e}")))
}

/// The stored list, portals apart; that of the solution's own emission where a folder has none.
///
/// # Errors
/// A file that is no list of lights, names triangles that the mesh does not have, or is of another
/// generation than `expected`.
pub(super) fn read(
    folder: &Path,
    solution: &Solution,
    expected: Option<&str>,
) -> Result<(Vec<Lamp>, Vec<Lamp>)> {
    let path = folder.join(LIGHTS);
    if !path.is_file() {
        let lamps = find_lamps(&solution.mesh, &solution.emission, solution.origin);
        return Ok((lamps, Vec::new()));
    }
    let bytes = std::fs::read(&path).map_err(|e| Error::io(&path, e))?;
    let file: LightsFile = serde_json::from_slice(&bytes).map_err(|e| {
        Error::input(
            &path,
            format!("is no list of lights ({e}); run `unbake solve` again"),
        )
    })?;
    if let (Some(found), Some(expected)) = (&file.generation, expected)
        && found != expected
    {
        return Err(other_run(&path));
    }
    let triangles = solution.mesh.triangles.len();
    for lamp in &file.lights {
        if let Some(t) = lamp.triangles.iter().find(|&&t| t as usize >= triangles) {
            return Err(Error::input(
                &path,
                format!(
                    "light {} names triangle {t}, but scene.glb has {triangles}; run `unbake solve` again",
                    lamp.id
                ),
            ));
        }
    }
    let is_portal = |light: &Lamp| light.kind == LampKind::Portal;
    let (portals, lamps) = file.lights.into_iter().partition(is_portal);
    Ok((lamps, portals))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solution::tests::small_solution;

    /// Two quads of emitting triangles, the second half as large, `lift` metres above.
    fn two_quads(lift: f32) -> Solution {
        let mut solution = small_solution();
        solution.emission.data.fill(Vec3::splat(2.0));
        let base = solution.mesh.positions.len() as u32;
        for i in 0..4 {
            let p = solution.mesh.positions[i];
            let above = Vec3::new(0.5 * p.x, p.y + lift, 0.5 * p.z);
            solution.mesh.positions.push(above);
            solution.mesh.normals.push(Vec3::Y);
            solution.mesh.uvs.push(solution.mesh.uvs[i]);
        }
        let more: Vec<[u32; 3]> = solution
            .mesh
            .triangles
            .iter()
            .map(|t| t.map(|i| i + base))
            .collect();
        solution.mesh.triangles.extend(more);
        solution
    }

    fn lamps(s: &Solution) -> Vec<Lamp> {
        find_lamps(&s.mesh, &s.emission, s.origin)
    }

    #[test]
    fn touching_triangles_are_one_lamp_and_distant_ones_are_not() {
        let solution = two_quads(2.0);
        let found = lamps(&solution);
        assert_eq!(found.len(), 2);
        assert_eq!([found[0].id, found[1].id], [1, 2]);
        let area: f32 = (0..2).map(|t| solution.mesh.area(t)).sum();
        assert!((found[0].area - area).abs() < 1e-4 * area);
        // a flat lamp of radiance L sends out π L A
        assert!((found[0].power[0] - PI * 2.0 * area).abs() < 1e-3 * found[0].power[0]);
        assert!((found[1].power[0] - 0.25 * found[0].power[0]).abs() < 1e-3 * found[0].power[0]);
        let y = f64::from(solution.mesh.positions[0].y) + solution.origin.y;
        assert!((found[0].centre[1] - y).abs() < 1e-5);
    }

    #[test]
    fn the_rule_knows_no_unit() {
        for scale in [0.001f32, 1.0, 1000.0] {
            for (lift, count) in [(2.0, 2), (1e-4, 1)] {
                let mut solution = two_quads(lift);
                solution.mesh.positions.iter_mut().for_each(|p| *p *= scale);
                assert_eq!(lamps(&solution).len(), count, "scale {scale}, lift {lift}");
            }
        }
    }

    #[test]
    fn what_is_stored_is_what_is_read() {
        let folder = tempfile::tempdir().expect("folder");
        let mut solution = two_quads(2.0);
        solution.lamps = lamps(&solution);
        solution.lamps[1].clipped = true;
        solution.lamps[0].kind = LampKind::Window;
        solution.portals = vec![Lamp {
            id: 3,
            kind: LampKind::Portal,
            ..Lamp::default()
        }];
        let bytes = encode(&solution.lamps, &solution.portals, "a").expect("json");
        std::fs::write(folder.path().join(LIGHTS), &bytes).expect("write");
        assert_eq!(
            read(folder.path(), &solution, Some("a")).expect("read"),
            (solution.lamps.clone(), solution.portals.clone())
        );
        let mixed = read(folder.path(), &solution, Some("b")).expect_err("of another run");
        assert!(mixed.exit_code() == 2 && mixed.to_string().contains("of another run"));
        solution.mesh.triangles.truncate(2);
        let refused =
            read(folder.path(), &solution, None).expect_err("triangles that are not there");
        assert!(refused.to_string().contains("light 2 names triangle"));
        std::fs::write(folder.path().join(LIGHTS), b"{").expect("write");
        assert!(read(folder.path(), &solution, None).is_err());
        std::fs::remove_file(folder.path().join(LIGHTS)).expect("remove");
        let (lamps, portals) = read(folder.path(), &solution, None).expect("found");
        assert_eq!((lamps.len(), portals.len()), (1, 0));
    }
}
