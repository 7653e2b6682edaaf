//! The operator: from an edit of lights and colours to the irradiance of all texels.
//!
//! With m(·) what the model of patches says, the irradiance E of an edit is m + g (E₀ − m₀): E₀ is the
//! result's own irradiance, m₀ what the model says of it, g = m/m₀ up to a limit. Where g is below
//! the limit this is E₀ m/m₀: exact where nothing is changed, and where all light is changed alike;
//! beyond it, where light of a kind arrives that was not there, the base says little and the error
//! of its model is not magnified further.

use super::direct::Direct;
use super::groups::LightGroup;
use super::links::{LINKS, Seeing};
use super::patches::{Patch, describe};
use super::radiosity::{
    ANSWERED, Bounced, FormFactors, Reflecting, SETTLED, bounce, means, seen_areas,
};
use crate::core::image::{Plane, RgbPlane, Wrap};
use crate::core::parallel::map_chunks;
use crate::core::parallel::prelude::*;
use crate::core::texture::fill_uncovered;
use crate::render::LightmapTexels;
use crate::solution::Solution;
use glam::{Vec2, Vec3, Vec3A};
use std::collections::BTreeMap;

/// Factor up to which the result's own irradiance is taken to change as the model does.
/// Derived: three stops; what an eighth of the light shows tells little about the other seven.
const MOST_GAIN: f32 = 8.0;
/// Largest ratio stated: lookups mix that of neighbours. Derived: ten stops.
const MOST_RATIO: f32 = 1024.0;
/// Texels per parallel piece. Derived: some tens of pieces a megapixel.
const PIECE: usize = 4096;

/// Changed lights and colours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightEdit {
    /// Factor per channel on each group of lights, in the order of [`LiveLight::groups`]; 1 where
    /// the list ends early.
    pub lights: Vec<Vec3>,
    /// Factor per channel on the diffuse colour of classes; products beyond 1 count as 1.
    pub classes: BTreeMap<u16, Vec3>,
}

impl LightEdit {
    /// Factor on the light of a group.
    #[must_use]
    pub fn light(&self, group: usize) -> Vec3 {
        self.lights.get(group).copied().unwrap_or(Vec3::ONE)
    }

    fn changes_classes(&self) -> bool {
        self.classes.values().any(|f| *f != Vec3::ONE)
    }

    /// Whether it leaves all as it is.
    #[must_use]
    pub fn changes_nothing(&self) -> bool {
        self.lights.iter().all(|f| *f == Vec3::ONE) && !self.changes_classes()
    }
}

/// What the operator's answers are wrong by.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EditError {
    /// Root mean square of the difference of irradiance (luminance) from the path tracer's, over
    /// random points in the open and edits, relative to the root mean square of the irradiance; the noise of the
    /// path tracer is taken off.
    pub relative: f32,
    /// The same for the model without the correction by the result's own irradiance.
    pub model: f32,
    /// Half of the points lie nearer than this share of their own irradiance, the noise of the path tracer
    /// included: few points near lamps make most of the other figure.
    pub median: f32,
}

impl EditError {
    /// The relative error as a ratio of signal to noise, decibels.
    #[must_use]
    pub fn decibels(&self) -> f32 {
        -20.0 * self.relative.max(1e-6).log10()
    }
}

/// The irradiance under an edit.
#[derive(Clone, Debug)]
pub struct Answer {
    /// E of every covered texel ([`LiveLight::cells`]), linear RGB.
    pub irradiance: Vec<Vec3>,
    /// Ratio of it to the result's own irradiance, of use where that is 0, too.
    pub ratio: Vec<Vec3>,
    /// Bounces computed for it; 0 where the edit leaves all colours alone.
    pub bounces: u32,
    /// Share of the reflected light that is left out at most.
    pub remainder: f32,
}

/// What rays are traced for, and what is kept in a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Traced {
    /// Direct light.
    pub direct: Direct,
    /// What texels see.
    pub seeing: Seeing,
    /// Patch of each texel.
    pub of_texels: Vec<u16>,
}

/// The light of a solution, ready to be changed.
pub struct LiveLight {
    size: [usize; 2],
    cells: Vec<u32>,
    groups: Vec<LightGroup>,
    direct: Direct,
    links: Vec<u16>,
    /// How many rays meet each texel.
    seen: Vec<u8>,
    /// Patch of each texel.
    of_texels: Vec<u16>,
    /// Texel of each cell of the map; `u32::MAX` where none is.
    texel_of_cell: Plane<u32>,
    patches: Vec<Patch>,
    factors: FormFactors,
    /// Direct light of each group on the patches.
    on_patches: Direct,
    /// Exitance of the patches under each group, colours as they are.
    exitance: Vec<Vec<Vec3A>>,
    /// The result's own irradiance at the texels.
    base: Vec<Vec3>,
    /// What the model says of it.
    base_model: Vec<Vec3>,
    pub(super) error: EditError,
}

impl LiveLight {
    /// Puts an operator together from what was traced; its error is not yet known.
    pub(super) fn assemble(
        solution: &Solution,
        texels: &LightmapTexels<'_>,
        groups: Vec<LightGroup>,
        traced: Traced,
    ) -> Self {
        let Traced {
            direct,
            seeing: Seeing { links, seen },
            of_texels,
        } = traced;
        let areas = seen_areas(texels, &seen);
        let patches = describe(solution, texels, &of_texels, &areas);
        let factors = FormFactors::of_links(&links, &of_texels, &areas, patches.len());
        let on_patches: Direct = direct
            .iter()
            .map(|d| means(d, &of_texels, &areas, &patches))
            .collect();
        let grid = texels.texels();
        let base = (0..grid.len())
            .map(|i| grid.lookup(&solution.mesh, &solution.irradiance, i))
            .collect();
        let mut out = Self {
            size: [grid.width, grid.height],
            cells: grid.cell.clone(),
            groups,
            direct,
            links,
            seen,
            texel_of_cell: grid.numbers(),
            of_texels,
            patches,
            factors,
            on_patches,
            exitance: Vec::new(),
            base,
            base_model: Vec::new(),
            error: EditError::default(),
        };
        let nothing = LightEdit::default();
        out.exitance = (out.on_patches.iter())
            .map(|direct| {
                let dark = vec![Vec3A::ZERO; out.patches.len()];
                out.bounced(&nothing, direct, dark, SETTLED).exitance
            })
            .collect();
        out.base_model = out.modelled(&nothing).irradiance;
        out
    }

    /// Size of the map, width and height in texels.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Row-major positions of the covered texels in the map, ascending.
    #[must_use]
    pub fn cells(&self) -> &[u32] {
        &self.cells
    }

    /// The lights that can be changed.
    #[must_use]
    pub fn groups(&self) -> &[LightGroup] {
        &self.groups
    }

    /// The result's own irradiance at the covered texels.
    #[must_use]
    pub fn base(&self) -> &[Vec3] {
        &self.base
    }

    /// Patches of surface between which light bounces.
    #[must_use]
    pub fn patch_count(&self) -> usize {
        self.patches.len()
    }

    /// The patches.
    #[cfg(test)]
    pub(super) fn patches(&self) -> &[Patch] {
        &self.patches
    }

    /// Whether texel i is seen from where light goes: not inside a wall, nor below a cabinet.
    pub(super) fn is_open(&self, i: usize) -> bool {
        usize::from(self.seen[i]) >= LINKS / 2
    }

    /// Whether any light reaches texel i: the ratio of others means nothing.
    #[must_use]
    pub fn is_lit(&self, i: usize) -> bool {
        self.base_model[i].max_element() > 0.0
    }

    /// How far answers lie from the path tracer's.
    #[must_use]
    pub fn error(&self) -> EditError {
        self.error
    }

    /// The irradiance under an edit.
    #[must_use]
    pub fn answer(&self, edit: &LightEdit) -> Answer {
        if edit.changes_nothing() {
            return Answer {
                irradiance: self.base.clone(),
                ratio: vec![Vec3::ONE; self.base.len()],
                bounces: 0,
                remainder: 0.0,
            };
        }
        let mut out = self.modelled(edit);
        let changed = |i: usize, model: Vec3| Changed {
            base: self.base[i],
            base_model: self.base_model[i],
            model,
        };
        let ratio = map_chunks(self.base.len(), PIECE, |range| {
            range
                .map(|i| changed(i, out.irradiance[i]).ratio())
                .collect::<Vec<Vec3>>()
        });
        out.ratio = ratio.concat();
        let pieces = out.irradiance.par_chunks_mut(PIECE).enumerate();
        pieces.for_each(|(c, piece)| {
            for (k, value) in piece.iter_mut().enumerate() {
                *value = changed(c * PIECE + k, *value).irradiance();
            }
        });
        out
    }

    /// What the model alone says of an edit.
    pub(super) fn modelled(&self, edit: &LightEdit) -> Answer {
        let lit: Vec<usize> = (0..self.groups.len())
            .filter(|&k| edit.light(k) != Vec3::ZERO)
            .collect();
        let mut sum = vec![Vec3A::ZERO; self.patches.len()];
        let mut direct = vec![Vec3::ZERO; self.patches.len()];
        for &k in &lit {
            let factor = edit.light(k);
            for (i, s) in sum.iter_mut().enumerate() {
                *s += Vec3A::from(factor) * self.exitance[k][i];
                direct[i] += factor * self.on_patches[k][i];
            }
        }
        let bounced = if edit.changes_classes() {
            self.bounced(edit, &direct, sum, ANSWERED)
        } else {
            Bounced {
                exitance: sum,
                bounces: 0,
                remainder: SETTLED,
            }
        };
        let seen = map_chunks(self.cells.len(), PIECE, |range| {
            range
                .map(|i| self.gathered(i, &bounced.exitance))
                .collect::<Vec<Vec3>>()
        })
        .concat();
        let mut irradiance = vec![Vec3::ZERO; self.cells.len()];
        irradiance
            .par_chunks_mut(PIECE)
            .enumerate()
            .for_each(|(c, piece)| self.receive(c * PIECE, &seen, &lit, edit, piece));
        Answer {
            irradiance,
            ratio: Vec::new(),
            bounces: bounced.bounces,
            remainder: bounced.remainder,
        }
    }

    /// What texel i receives from the patches that it sees.
    fn gathered(&self, i: usize, exitance: &[Vec3A]) -> Vec3 {
        let mut seen = Vec3A::ZERO;
        for &link in &self.links[i * LINKS..(i + 1) * LINKS] {
            // what is no patch stands last
            let Some(e) = exitance.get(usize::from(link)) else {
                break;
            };
            seen += *e;
        }
        Vec3::from(seen) / LINKS as f32
    }

    /// Irradiance of consecutive texels, from number `from` on: direct light, and the mean of what they
    /// and their neighbours on the same patch see: few rays meet what is small and bright, each
    /// texel's others.
    fn receive(
        &self,
        from: usize,
        seen: &[Vec3],
        lit: &[usize],
        edit: &LightEdit,
        out: &mut [Vec3],
    ) {
        let [width, height] = self.size;
        for (k, value) in out.iter_mut().enumerate() {
            let i = from + k;
            let (x, y) = (
                self.cells[i] as usize % width,
                self.cells[i] as usize / width,
            );
            let (mut sum, mut count) = (Vec3::ZERO, 0.0);
            for y in y.saturating_sub(1)..(y + 2).min(height) {
                for x in x.saturating_sub(1)..(x + 2).min(width) {
                    let near = self.texel_of_cell[(x, y)] as usize;
                    if self.of_texels.get(near) == Some(&self.of_texels[i]) {
                        sum += seen[near];
                        count += 1.0;
                    }
                }
            }
            // its own cell is among them
            *value = sum / count;
        }
        for &k in lit {
            let factor = edit.light(k);
            let direct = &self.direct[k][from..from + out.len()];
            for (value, d) in out.iter_mut().zip(direct) {
                *value += factor * *d;
            }
        }
    }

    /// Exitances under an edit's colours.
    fn bounced(
        &self,
        edit: &LightEdit,
        direct: &[Vec3],
        guess: Vec<Vec3A>,
        enough: f32,
    ) -> Bounced {
        let reflectance: Vec<Vec3> = self
            .patches
            .iter()
            .map(|p| p.reflectance(edit.classes.get(&p.class).copied().unwrap_or(Vec3::ONE)))
            .collect();
        let reflecting = Reflecting {
            patches: &self.patches,
            factors: &self.factors,
            reflectance: &reflectance,
            direct,
            enough,
        };
        bounce(&reflecting, guess)
    }

    /// The ratio of an answer's irradiance to the result's own as a map, filled outside charts; the
    /// result's irradiance times it keeps details finer than the map.
    #[must_use]
    pub fn ratio_map(&self, answer: &Answer) -> RgbPlane {
        let [width, height] = self.size;
        let mut plane = Plane::filled(width, height, Vec3::ONE);
        let mut covered = Plane::filled(width, height, false);
        for (i, (&cell, ratio)) in self.cells.iter().zip(&answer.ratio).enumerate() {
            plane.data[cell as usize] = *ratio;
            covered.data[cell as usize] = self.is_lit(i);
        }
        fill_uncovered(&plane, &covered)
    }

    /// The irradiance texture of a solution under an edit, at its own size.
    #[must_use]
    pub fn irradiance_map(&self, solution: &Solution, answer: &Answer) -> RgbPlane {
        let ratio = self.ratio_map(answer);
        let mut out = solution.irradiance.clone();
        let (width, height) = (out.width, out.height);
        let scale = Vec2::new(
            ratio.width as f32 / width as f32,
            ratio.height as f32 / height as f32,
        );
        for (i, value) in out.data.iter_mut().enumerate() {
            let centre = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
            *value *= ratio.bilinear(centre * scale, Wrap::Clamp);
        }
        out
    }
}

/// A texel's light before and after.
struct Changed {
    /// The result's own irradiance E₀.
    base: Vec3,
    /// What the model says of it, m₀.
    base_model: Vec3,
    /// What the model says of the edit, m.
    model: Vec3,
}

impl Changed {
    fn channels(&self, of: impl Fn(f32, f32, f32) -> f32) -> Vec3 {
        let (e0, m0, m) = (self.base, self.base_model, self.model);
        Vec3::new(
            of(e0.x, m0.x, m.x),
            of(e0.y, m0.y, m.y),
            of(e0.z, m0.z, m.z),
        )
    }

    /// m + g (E₀ − m₀), channel by channel, g = m/m₀ up to [`MOST_GAIN`].
    fn irradiance(&self) -> Vec3 {
        self.channels(|e0, m0, m| {
            if m0 * MOST_GAIN > m {
                e0 * (m / m0)
            } else if m > 0.0 {
                (m + MOST_GAIN * (e0 - m0)).max(0.0)
            } else {
                e0
            }
        })
    }

    /// The same over E₀; where that is 0, what the model says of the change.
    fn ratio(&self) -> Vec3 {
        self.channels(|e0, m0, m| {
            if m0 * MOST_GAIN > m {
                m / m0
            } else if m > 0.0 && e0 > 0.0 {
                ((m + MOST_GAIN * (e0 - m0)) / e0).clamp(0.0, MOST_RATIO)
            } else if m > 0.0 {
                MOST_GAIN
            } else {
                1.0
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corrected(base: Vec3, base_model: Vec3, model: Vec3) -> Vec3 {
        let changed = Changed {
            base,
            base_model,
            model,
        };
        let (light, ratio) = (changed.irradiance(), changed.ratio());
        // the ratio says the same wherever there is something to multiply
        if base.min_element() > 0.0 {
            assert!((ratio * base).abs_diff_eq(light, 1e-4 * light.max_element()));
        }
        assert!(ratio.is_finite() && ratio.max_element() <= MOST_RATIO);
        light
    }

    #[test]
    fn the_base_is_kept_scaled_and_never_magnified_beyond_the_limit() {
        let (base, model) = (Vec3::splat(1.2), Vec3::ONE);
        assert!(corrected(base, model, model).abs_diff_eq(base, 1e-6));
        assert!(corrected(base, model, 3.0 * model).abs_diff_eq(3.0 * base, 1e-5));
        assert_eq!(corrected(base, model, Vec3::ZERO), Vec3::ZERO);
        let bright = corrected(base, model, 100.0 * model);
        assert!(bright.abs_diff_eq(Vec3::splat(100.0 + 8.0 * 0.2), 1e-3));
        // light where none was, and none where the model knows of none
        assert_eq!(corrected(Vec3::ZERO, Vec3::ZERO, Vec3::ONE), Vec3::ONE);
        assert_eq!(corrected(base, Vec3::ZERO, Vec3::ZERO), base);
        // where the result is dark and the model is not, nothing explodes
        let odd = Vec3::new(0.7, 0.3, 0.1);
        assert_eq!(corrected(Vec3::ZERO, odd, 1.7 * odd), Vec3::ZERO);
    }
}
