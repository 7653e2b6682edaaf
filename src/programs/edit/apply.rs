//! Edits brought into the textures.

use super::{Edit, EditList, Mapping, Selection, Selector, TextureSet, follow_light};
use crate::core::formats::{image_info, read_display_photograph, read_ldr, read_rgb};
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::math::colour::ColourSpace;
use crate::core::math::luminance;
use crate::core::parallel::map_chunks;
use crate::core::progress::Progress;
use crate::core::texture::{Texel, Texels, fill_uncovered};
use crate::error::Result;
use crate::solution::Solution;
use glam::{Vec2, Vec3};
use std::path::Path;

/// An edited solution and what was done.
pub struct Edited {
    /// The solution.
    pub solution: Solution,
    /// Texels each edit changed (albedo texture).
    pub texels: Vec<usize>,
    /// Bounces of light followed, and the relative change of irradiance each brought.
    pub bounces: Vec<f64>,
}

/// Texels per task.
const CHUNK: usize = 4096;

/// A solution with a list of edits applied, and the light that follows from them. Paths in the list
/// are relative to `folder`.
///
/// # Errors
/// See [`Selector::select`]; a texture cannot be read.
pub fn apply_edits(
    solution: &Solution,
    list: &EditList,
    folder: &Path,
    classes: &[(u16, String)],
    seed: u64,
    progress: &Progress,
) -> Result<Edited> {
    let selector = Selector::new(solution, classes, folder);
    let mut prepared = Vec::new();
    for (i, edit) in list.edits.iter().enumerate() {
        prepared.push(Prepared::new(
            solution,
            edit,
            selector.select(i, edit)?,
            folder,
        )?);
    }
    let texels = Texels::rasterize(
        &solution.mesh,
        solution.albedo.width,
        solution.albedo.height,
    );
    let mut out = solution.clone();
    let mut counts = vec![0usize; prepared.len()];
    progress.stage("editing", 2, |p| {
        let changed = over_texels(solution, &texels, &prepared, |i, at| {
            let mut albedo = solution.albedo.data[texels.cell[i] as usize];
            let mut touched = Vec::new();
            for (k, e) in prepared.iter().enumerate() {
                let w = e.selection.weight(solution, at.triangle, at.uv);
                if w > 0.0 {
                    albedo = albedo.lerp(e.albedo(albedo, at), w);
                    touched.push(k);
                }
            }
            (albedo.clamp(Vec3::ZERO, Vec3::ONE), touched)
        });
        for (i, (albedo, touched)) in changed.into_iter().enumerate() {
            touched.iter().for_each(|&k| counts[k] += 1);
            out.albedo.data[texels.cell[i] as usize] = albedo;
        }
        out.albedo = refilled(&out.albedo, &texels);
        p.advance(1);
        if prepared.iter().any(Prepared::changes_roughness) {
            let fine = Texels::rasterize(
                &solution.mesh,
                solution.roughness.width,
                solution.roughness.height,
            );
            let changed = over_texels(solution, &fine, &prepared, |i, at| {
                let mut r = solution.roughness.data[fine.cell[i] as usize];
                for e in &prepared {
                    let w = e.selection.weight(solution, at.triangle, at.uv);
                    r += w * (e.roughness(r, at) - r);
                }
                r.clamp(0.0, 1.0)
            });
            for (i, r) in changed.into_iter().enumerate() {
                out.roughness.data[fine.cell[i] as usize] = r;
            }
            out.roughness = refilled(&out.roughness, &fine);
        }
        p.advance(1);
    });
    for (k, count) in counts.iter().enumerate().filter(|(_, c)| **c == 0) {
        progress.note(format!("edit[{k}] selects nothing ({count} texels)"));
    }
    let bounces = follow_light(solution, &mut out, seed, progress)?;
    Ok(Edited {
        solution: out,
        texels: counts,
        bounces: bounces.changes,
    })
}

fn refilled<T: Texel>(plane: &Plane<T>, texels: &Texels) -> Plane<T> {
    fill_uncovered(plane, &texels.scatter(&vec![true; texels.len()], false))
}

/// A surface point as edits see it.
struct At {
    triangle: usize,
    uv: Vec2,
    position: Vec3,
    normal: Vec3,
}

fn over_texels<T: Send>(
    solution: &Solution,
    texels: &Texels,
    edits: &[Prepared<'_>],
    f: impl Fn(usize, &At) -> T + Sync + Send,
) -> Vec<T> {
    let mesh = &solution.mesh;
    let shift = (solution.origin - solution.origin.floor()).as_vec3();
    let needs_place = edits.iter().any(|e| e.edit.texture.is_some());
    let parts = map_chunks(texels.len(), CHUNK, |range| {
        range
            .map(|i| {
                let p = texels.point[i];
                let t = p.triangle as usize;
                let (position, normal) = if needs_place {
                    (
                        texels.position(mesh, i) + shift,
                        mesh.shading_normal(t, p.u, p.v),
                    )
                } else {
                    (Vec3::ZERO, Vec3::Y)
                };
                f(
                    i,
                    &At {
                        triangle: t,
                        uv: mesh.uv(t, p.u, p.v),
                        position,
                        normal,
                    },
                )
            })
            .collect::<Vec<T>>()
    });
    parts.into_iter().flatten().collect()
}

/// An edit with its pictures loaded.
struct Prepared<'a> {
    edit: &'a Edit,
    selection: Selection,
    albedo: Option<RgbPlane>,
    roughness: Option<RgbPlane>,
    /// Factor that gives the selection's mean albedo the tint and keeps its luminance.
    tint: Vec3,
}

/// Whether a picture's file holds linear values, whatever its name ends in.
fn is_linear(path: &Path) -> Result<bool> {
    Ok(image_info(path)?.format.is_linear())
}

impl<'a> Prepared<'a> {
    fn new(
        solution: &Solution,
        edit: &'a Edit,
        selection: Selection,
        folder: &Path,
    ) -> Result<Self> {
        let colours = |path: &Path| {
            let path = folder.join(path);
            match is_linear(&path)? {
                true => read_rgb(path),
                false => read_ldr(path),
            }
        };
        // of numbers, whatever a profile says of colours
        let numbers = |path: &Path| {
            let path = folder.join(path);
            match is_linear(&path)? {
                true => read_rgb(path),
                false => read_display_photograph(&path, Some(ColourSpace::Srgb))
                    .map(|photograph| photograph.pixels),
            }
        };
        let set = edit.texture.as_ref();
        let albedo = set
            .and_then(|t| t.albedo.as_deref())
            .map(colours)
            .transpose()?;
        let roughness = set
            .and_then(|t| t.roughness.as_deref())
            .map(numbers)
            .transpose()?;
        // a roughness picture's bytes are the values themselves
        let as_it_is = set
            .and_then(|t| t.roughness.as_ref())
            .map_or(Ok(true), |p| is_linear(&folder.join(p)))?;
        let roughness = roughness.map(|r| {
            if as_it_is {
                r
            } else {
                r.map(|c| c.map(srgb_value))
            }
        });
        let mut out = Self {
            edit,
            selection,
            albedo,
            roughness,
            tint: Vec3::ONE,
        };
        if let Some(t) = edit.tint {
            let mean = out.mean_albedo(solution);
            let t = Vec3::from_array(t);
            out.tint = t * (luminance(mean) / luminance(t).max(1e-6)) / mean.max(Vec3::splat(1e-4));
        }
        Ok(out)
    }

    fn mean_albedo(&self, solution: &Solution) -> Vec3 {
        let mesh = &solution.mesh;
        let (w, h) = (solution.albedo.width as f32, solution.albedo.height as f32);
        let (mut sum, mut total) = (glam::DVec3::ZERO, 0.0f64);
        for t in 0..mesh.triangles.len() {
            let uv = mesh.uv(t, 1.0 / 3.0, 1.0 / 3.0);
            let weight = f64::from(mesh.area(t) * self.selection.weight(solution, t, uv));
            if weight > 0.0 {
                sum += solution
                    .albedo
                    .bilinear(uv * Vec2::new(w, h), Wrap::Clamp)
                    .as_dvec3()
                    * weight;
                total += weight;
            }
        }
        if total > 0.0 {
            (sum / total).as_vec3()
        } else {
            Vec3::splat(0.5)
        }
    }

    fn changes_roughness(&self) -> bool {
        self.roughness.is_some()
            || self.edit.set.is_some_and(|s| s.roughness.is_some())
            || self.edit.scale.is_some_and(|s| s.roughness.is_some())
    }

    fn albedo(&self, old: Vec3, at: &At) -> Vec3 {
        let mut a = old;
        if let (Some(picture), Some(set)) = (&self.albedo, &self.edit.texture) {
            a = projected(picture, set, at);
        }
        if let Some(v) = self.edit.set.and_then(|s| s.albedo) {
            a = Vec3::from_array(v);
        }
        if let Some(v) = self.edit.scale.and_then(|s| s.albedo) {
            a *= Vec3::from_array(v);
        }
        a * self.tint
    }

    fn roughness(&self, old: f32, at: &At) -> f32 {
        let mut r = old;
        if let (Some(picture), Some(set)) = (&self.roughness, &self.edit.texture) {
            r = luminance(projected(picture, set, at));
        }
        if let Some(v) = self.edit.set.and_then(|s| s.roughness) {
            r = v;
        }
        r * self.edit.scale.and_then(|s| s.roughness).unwrap_or(1.0)
    }
}

fn srgb_value(v: f32) -> f32 {
    if v <= 0.003_130_8 {
        12.92 * v
    } else {
        1.055 * v.powf(1.0 / 2.4) - 0.055
    }
}

/// A repeated picture laid on the surface.
fn projected(picture: &RgbPlane, set: &TextureSet, at: &At) -> Vec3 {
    let size = set.size.unwrap_or(1.0);
    let (s, c) = set.rotation.to_radians().sin_cos();
    let p = at.position;
    let look = |axis: usize| {
        let q = match axis {
            0 => Vec2::new(-p.z * at.normal.x.signum(), -p.y),
            1 => Vec2::new(p.x, p.z * at.normal.y.signum()),
            _ => Vec2::new(p.x * at.normal.z.signum(), -p.y),
        };
        let q = Vec2::new(c * q.x + s * q.y, c * q.y - s * q.x) / size;
        // one repetition is `size` wide; its height follows the picture's aspect
        let (w, h) = (picture.width as f32, picture.height as f32);
        tiled(
            picture,
            Vec2::new(q.x.rem_euclid(1.0) * w, (q.y * w / h).rem_euclid(1.0) * h),
        )
    };
    let n = at.normal.abs();
    match set.mapping {
        Mapping::Planar => look(1),
        Mapping::Box => look(if n.y >= n.x && n.y >= n.z {
            1
        } else {
            usize::from(n.z > n.x) * 2
        }),
        Mapping::Triplanar => {
            let w = n.powf(6.0);
            let total = w.element_sum().max(1e-12);
            (0..3)
                .filter(|&k| w[k] > 1e-3 * total)
                .map(|k| look(k) * (w[k] / total))
                .sum()
        }
    }
}

/// Bilinear lookup that repeats in both directions.
fn tiled(picture: &RgbPlane, p: Vec2) -> Vec3 {
    let (x, y) = (p.x - 0.5, p.y - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let (tx, ty) = (x - x0, y - y0);
    let at = |i: f32, j: f32| {
        picture[(
            (i as i64).rem_euclid(picture.width as i64) as usize,
            (j as i64).rem_euclid(picture.height as i64) as usize,
        )]
    };
    at(x0, y0)
        .lerp(at(x0 + 1.0, y0), tx)
        .lerp(at(x0, y0 + 1.0).lerp(at(x0 + 1.0, y0 + 1.0), tx), ty)
}
