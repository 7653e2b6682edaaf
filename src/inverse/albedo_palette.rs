//! Surfaces painted in few colours: what a whole class of surfaces says about each of its texels.
//!
//! Most of a room has no texture: walls, ceilings, mouldings and doors are painted evenly, a class
//! in one colour or in a few. Their albedo still comes out uneven, for every error of the light is
//! in it: a few percent everywhere, much more at edges and in corners. That unevenness is smooth or
//! lies at edges, while texture shows on flat surface far from any edge. So the contrast of such
//! texels tells how much texture a class has. Where it is hardly any, the colours of the class are
//! the modes of its albedo (mean shift, Comaniciu and Meer 2002), and every texel becomes its
//! posterior mean: its own value and the colours around it, each weighed by its precision. A texel
//! that is none of the colours keeps its value, and so does every class with texture.

use super::class_prior::{ENOUGH_NEAR, LEAST_SHARE, LEAST_SPREAD, NEAR};
use super::flat_surface::{ENOUGH_FLAT, FlatSurface, LAG};
use super::mixed_pixels::COVERAGE_ERROR;
use super::palette_detail::kept_details;
use super::palette_look::Look;
use super::{AlbedoEstimate, BLACK};
use crate::core::geometry::Mesh;
use crate::core::math::luminance;
use crate::core::parallel::prelude::*;
use crate::core::stats::{
    GROSS_ERRORS, ROUNDS, SURELY, USUALLY, median, passing_weight, step_over_many,
};
use crate::core::texture::Texels;
use glam::Vec3;
use std::collections::BTreeMap;

/// Relative contrast of flat surface up to which a class is painted: estimates of paint vary by 0.6
/// to 2.5 %, wood by 4 to 15 %. What is painted may err by as much as a whole, and spread as much about its model.
/// Measured: ×½ albedo −0.9 dB, ×2 albedo within two errors −1 % (docs/constants.md).
pub(super) const MOST_TEXTURE: f32 = 0.03;

/// The paint of one class.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassPalette {
    /// Class.
    pub class: u16,
    /// Albedo and share of each colour.
    pub colours: Vec<(Vec3, f32)>,
    /// Relative standard deviation of the albedo within a colour.
    pub texture: f32,
    /// How surely the class is painted: 1 where its texture is well below the mark and its colours
    /// explain nearly all, less where either is close.
    pub surely: f32,
}

impl ClassPalette {
    fn logs(&self) -> Vec<Vec3> {
        self.colours.iter().map(|c| c.0.ln()).collect()
    }
}

/// A class's paint and the ln albedo of its colours.
type Palette<'a> = BTreeMap<u16, (&'a ClassPalette, Vec<Vec3>)>;

/// Room and place of a cube of space.
type Cube = (u16, [i32; 3]);

/// What is known of every covered texel before its class is asked.
pub struct PaletteFit<'a> {
    /// Albedo as observed.
    pub albedo: &'a AlbedoEstimate,
    /// Standard error of its luminance; infinite where unobserved.
    pub error: &'a [f32],
    /// Texels of the atlas.
    pub texels: &'a Texels,
    /// Mesh they lie on.
    pub mesh: &'a Mesh,
    /// Class per texel; 0 where unknown.
    pub labels: &'a [u16],
    /// Room per texel.
    pub rooms: &'a [u16],
}

/// How a clean texel looks.
struct CleanLook {
    texel: usize,
    cube: Cube,
    /// Logarithm of its albedo.
    log: Vec3,
    /// The colour of its class's palette that is nearest, if one is near.
    colour: Option<usize>,
}

impl PaletteFit<'_> {
    /// The classes that are painted and their colours; with `any`, whatever their texture.
    #[must_use]
    pub fn paints(&self, any: bool) -> Vec<ClassPalette> {
        let mut clean: BTreeMap<u16, Vec<usize>> = BTreeMap::new();
        (0..self.texels.len())
            .filter(|&i| self.is_clean(i))
            .for_each(|i| clean.entry(self.labels[i]).or_default().push(i));
        let texture = self.textures(&self.flat());
        let clean: Vec<(u16, Vec<usize>)> = clean.into_iter().collect();
        clean
            .into_par_iter()
            .filter_map(|(class, members)| {
                let texture = *texture.get(&class)?;
                let even = 1.0 - passing_weight(texture.into(), MOST_TEXTURE.into()) as f32;
                let surely = if any { 1.0 } else { even };
                if surely <= 0.0 {
                    return None;
                }
                let looks: Vec<Look> = members
                    .iter()
                    .step_by(step_over_many(members.len()))
                    .map(|&i| self.look(i, texture))
                    .collect();
                let (colours, explained) = colours(&looks)?;
                Some(ClassPalette {
                    class,
                    colours,
                    texture,
                    surely: surely * explained,
                })
            })
            .collect()
    }

    /// The posterior mean of every texel's albedo and its standard error.
    #[must_use]
    pub fn settle(&self, paints: &[ClassPalette]) -> Vec<(Vec3, f32)> {
        let palette: Palette = paints.iter().map(|p| (p.class, (p, p.logs()))).collect();
        let clean = self.clean_looks(&palette);
        let near = self.neighbours(&palette, &clean);
        let by_room = self.shares_by_room(&palette, &clean);
        let details = self.details(&palette);
        (0..self.texels.len())
            .into_par_iter()
            .map(|i| {
                let own = (self.albedo.value[i], self.error[i]);
                let Some((paint, logs)) = palette
                    .get(&self.labels[i])
                    .filter(|_| self.error[i].is_finite())
                else {
                    return own;
                };
                // a pattern's detail is none of the light's errors
                let mut look = self.look(i, paint.texture);
                look.log -= details[i];
                let around = near.get(&self.cube(i)).map_or(&[][..], |c| c);
                let here = around.iter().find(|n| n.class == paint.class);
                let share = |k: usize| {
                    let (count, total) = here.map_or((0.0, 0.0), |n| {
                        (n.colours[k], n.colours.iter().sum::<f32>())
                    });
                    let usual = by_room
                        .get(&(paint.class, self.rooms[i]))
                        .map_or(paint.colours[k].1, |room| room[k]);
                    (count + ENOUGH_NEAR * usual) / (total + ENOUGH_NEAR)
                };
                // its label may be that of the surface next to it
                let all: f32 = around.iter().map(|n| n.texels).sum();
                let others = around.iter().filter(|n| n.class != paint.class);
                let mislabelled: f32 = others
                    .map(|n| {
                        let look = Look {
                            error: look.error.hypot(MOST_TEXTURE),
                            ..look
                        };
                        n.texels / all * look.density(look.distance2(n.sum / n.texels))
                    })
                    .sum();
                posterior(
                    &look,
                    (paint, logs),
                    share,
                    GROSS_ERRORS as f32 * mislabelled,
                )
                .map_or(own, |mut p| {
                    p.log += details[i];
                    p.over(own)
                })
            })
            .collect()
    }

    fn is_clean(&self, i: usize) -> bool {
        self.albedo.clean[i] && self.error[i].is_finite() && self.labels[i] != 0
    }

    fn look(&self, i: usize, texture: f32) -> Look {
        let value = self.albedo.value[i].clamp(Vec3::splat(BLACK), Vec3::ONE);
        let error = (self.error[i] / luminance(value)).max(LEAST_SPREAD);
        let error = if self.albedo.clean[i] {
            error
        } else {
            error.hypot(COVERAGE_ERROR)
        };
        Look {
            log: value.ln(),
            error: error.hypot(texture),
        }
    }

    /// Room and cube of a texel.
    fn cube(&self, i: usize) -> Cube {
        let side = self.texels.area(self.mesh, i).sqrt();
        // texels of about the same size share cubes
        let side = NEAR * side.max(f32::MIN_POSITIVE).log2().round().exp2();
        let cube = (self.texels.position(self.mesh, i) / side).floor();
        (self.rooms[i], cube.as_ivec3().to_array())
    }

    /// The clean texels, each with the colour it looks like.
    fn clean_looks(&self, palette: &Palette) -> Vec<CleanLook> {
        let look = |i: usize| {
            let look = self.look(i, 0.0);
            let logs = palette.get(&self.labels[i]).map(|(_, logs)| &logs[..]);
            CleanLook {
                texel: i,
                cube: self.cube(i),
                log: look.log,
                colour: logs.and_then(|logs| nearest(&look, logs)),
            }
        };
        (0..self.texels.len())
            .into_par_iter()
            .filter(|&i| self.is_clean(i))
            .map(look)
            .collect()
    }

    /// How common each colour of a class is in each room: one room's paint is no other's. The
    /// class as a whole counts for [`ENOUGH_NEAR`] texels.
    fn shares_by_room(
        &self,
        palette: &Palette,
        clean: &[CleanLook],
    ) -> BTreeMap<(u16, u16), Vec<f32>> {
        let mut counts: BTreeMap<(u16, u16), Vec<f32>> = BTreeMap::new();
        for look in clean {
            let class = self.labels[look.texel];
            let (Some((_, logs)), Some(k)) = (palette.get(&class), look.colour) else {
                continue;
            };
            let room = counts.entry((class, self.rooms[look.texel]));
            room.or_insert_with(|| vec![0.0; logs.len()])[k] += 1.0;
        }
        for ((class, _), room) in &mut counts {
            let Some((paint, _)) = palette.get(class) else {
                continue;
            };
            let total: f32 = room.iter().sum();
            for (count, (_, share)) in room.iter_mut().zip(&paint.colours) {
                *count = (*count + ENOUGH_NEAR * share) / (total + ENOUGH_NEAR);
            }
        }
        counts
    }

    /// What the clean texels around are, by cube and class.
    fn neighbours(
        &self,
        palette: &Palette,
        clean: &[CleanLook],
    ) -> BTreeMap<Cube, Vec<Neighbours>> {
        let mut near: BTreeMap<Cube, Vec<Neighbours>> = BTreeMap::new();
        for look in clean {
            let class = self.labels[look.texel];
            let colours = palette.get(&class).map_or(0, |(_, logs)| logs.len());
            let cube = near.entry(look.cube).or_default();
            let known = cube
                .iter()
                .position(|n| n.class == class)
                .unwrap_or_else(|| {
                    cube.push(Neighbours {
                        class,
                        texels: 0.0,
                        sum: Vec3::ZERO,
                        colours: vec![0.0; colours],
                    });
                    cube.len() - 1
                });
            let n = &mut cube[known];
            n.texels += 1.0;
            n.sum += look.log;
            if let Some(k) = look.colour {
                n.colours[k] += 1.0;
            }
        }
        near
    }

    /// Median contrast of the flat surface of every class that has enough of it.
    fn textures(&self, flat: &FlatSurface) -> BTreeMap<u16, f32> {
        let log: Vec<f32> = (self.albedo.value.iter())
            .map(|a| luminance(*a).max(BLACK).ln())
            .collect();
        let contrast = |i: usize| {
            let others = [(LAG, 0), (-LAG, 0), (0, LAG), (0, -LAG)]
                .into_iter()
                .filter_map(|(dx, dy)| flat.at(i, dx, dy));
            (0.25 * others.map(|j| (log[j] - log[i]).powi(2)).sum::<f32>()).sqrt()
        };
        let found: Vec<(u16, bool, f32)> = (0..self.texels.len())
            .into_par_iter()
            .filter(|&i| flat.is_flat(i))
            .map(|i| (self.labels[i], flat.is_far_from_edges(i), contrast(i)))
            .collect();
        let mut classes: BTreeMap<u16, [Vec<f32>; 2]> = BTreeMap::new();
        for (class, wide, contrast) in found {
            let [all, far] = classes.entry(class).or_default();
            all.push(contrast);
            if wide {
                far.push(contrast);
            }
        }
        classes
            .into_iter()
            .filter(|(_, [all, _])| all.len() >= ENOUGH_FLAT)
            .filter_map(|(c, [all, far])| Some((c, texture_of(all, far)?)))
            .collect()
    }

    /// What texels of painted classes keep of a pattern, ln albedo.
    fn details(&self, palette: &Palette) -> Vec<Vec3> {
        let looks: Vec<Look> = (self.albedo.value.iter().zip(self.error))
            .map(|(a, e)| {
                let value = a.clamp(Vec3::splat(BLACK), Vec3::ONE);
                Look::at(value.ln(), e / luminance(value))
            })
            .collect();
        kept_details(&self.flat(), &looks, self.labels, |class| {
            palette.contains_key(&class)
        })
    }

    /// Where the surface is flat and seen clean.
    fn flat(&self) -> FlatSurface<'_> {
        FlatSurface::new(self.mesh, self.texels, self.labels, |i| self.is_clean(i))
    }
}

/// Median contrast of flat surface: of what lies `far` from edges if there is enough of it, else of
/// `all`, or what the few far texels allow at most if that is less.
///
/// The median of n independent contrasts errs by √(π/2) σ/√n, σ being half of their central 68 %.
/// Texels that are compared with the same ones are not independent: one in (2 [`LAG`])² counts.
fn texture_of(all: Vec<f32>, mut far: Vec<f32>) -> Option<f32> {
    if far.len() >= ENOUGH_FLAT {
        return median(far);
    }
    let near = median(all)?;
    far.sort_by(f32::total_cmp);
    let at = |share: f64| far.get((share * far.len() as f64) as usize).copied();
    let (Some(low), Some(middle), Some(high)) = (at(0.16), at(0.5), at(0.84)) else {
        return Some(near);
    };
    let independent = far.len() as f32 / (4 * LAG * LAG) as f32;
    let error = (0.5 * std::f32::consts::PI / independent).sqrt() * 0.5 * (high - low);
    Some(near.min(middle + error))
}

/// The clean texels of one class in a cube: their number, the sum of their ln albedo, and how many
/// have which colour.
struct Neighbours {
    class: u16,
    texels: f32,
    sum: Vec3,
    colours: Vec<f32>,
}

/// Which of the colours, as ln albedo, a look is nearest to, if it may be it.
fn nearest(look: &Look, logs: &[Vec3]) -> Option<usize> {
    let distance: Vec<f32> = logs.iter().map(|l| look.distance2(*l)).collect();
    (0..distance.len())
        .min_by(|&a, &b| distance[a].total_cmp(&distance[b]))
        .filter(|&k| distance[k] < SURELY * SURELY)
}

/// The modes of the looks, the largest first, if few of them, of [`LEAST_SHARE`] each at least, explain all but gross
/// errors; and how surely they do.
fn colours(looks: &[Look]) -> Option<(Vec<(Vec3, f32)>, f32)> {
    let mut cells: BTreeMap<[i32; 3], (u32, Vec3)> = BTreeMap::new();
    for l in looks {
        let cell = cells
            .entry((l.log / LEAST_SPREAD).floor().as_ivec3().to_array())
            .or_default();
        *cell = (cell.0 + 1, cell.1 + l.log);
    }
    let mut starts: Vec<(u32, Vec3)> = cells.into_values().collect();
    starts.sort_by_key(|s| std::cmp::Reverse(s.0));
    let mut modes: Vec<Vec3> = Vec::new();
    // no more colours can have the least share
    let most = LEAST_SHARE.recip() as usize;
    for (count, sum) in starts.into_iter().take(most) {
        let mode = climb(looks, sum / count as f32);
        // modes nearer than the errors are one
        let same = |m: &Vec3| {
            Look {
                log: mode,
                error: LEAST_SPREAD,
            }
            .distance2(*m)
                < USUALLY * USUALLY
        };
        if !modes.iter().any(same) {
            modes.push(mode);
        }
    }
    let assign = |modes: &[Vec3]| -> Vec<Option<usize>> {
        looks.iter().map(|l| nearest(l, modes)).collect()
    };
    let shares = |of: &[Option<usize>], n: usize| -> Vec<f32> {
        (0..n)
            .map(|k| of.iter().filter(|o| **o == Some(k)).count() as f32 / looks.len() as f32)
            .collect()
    };
    let all = shares(&assign(&modes), modes.len());
    let mut kept: Vec<(Vec3, f32)> = modes
        .into_iter()
        .zip(all)
        .filter(|(_, s)| *s >= LEAST_SHARE)
        .collect();
    kept.sort_by(|a, b| b.1.total_cmp(&a.1));
    let modes: Vec<Vec3> = kept.into_iter().map(|(m, _)| m).collect();
    let of = assign(&modes);
    let share = shares(&of, modes.len());
    let other = f64::from(1.0 - share.iter().sum::<f32>());
    let explained = 1.0 - passing_weight(other, GROSS_ERRORS) as f32;
    if modes.is_empty() || explained <= 0.0 {
        return None;
    }
    let mean = |k: usize| {
        let (sum, total) = looks.iter().zip(&of).filter(|(_, o)| **o == Some(k)).fold(
            (Vec3::ZERO, 0.0),
            |(s, t), (l, _)| {
                let w = 1.0 / (l.error * l.error);
                (s + l.log * w, t + w)
            },
        );
        (sum / total).exp()
    };
    let colours = (0..modes.len()).map(|k| (mean(k), share[k])).collect();
    Some((colours, explained))
}

/// The mode that mean shift reaches from `log`.
fn climb(looks: &[Look], mut log: Vec3) -> Vec3 {
    for _ in 0..ROUNDS {
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for l in looks {
            let d2 = l.distance2(log);
            let w = l.density(d2) / (l.error * l.error);
            sum += l.log * w;
            total += w;
        }
        let next = sum / total.max(f32::MIN_POSITIVE);
        let moved = (next - log).length();
        log = next;
        if moved < 1e-4 {
            break;
        }
    }
    log
}

/// What a texel is if it is paint, and how likely it is.
struct Posterior {
    /// Probability that the texel is one of the colours.
    paint: f32,
    /// Mean ln albedo of the colours, weighed by how likely each is.
    log: Vec3,
    /// Relative variance of that.
    variance: f32,
}

impl Posterior {
    /// Mean albedo and standard error, `own` being those of the texel if it is no paint.
    fn over(&self, own: (Vec3, f32)) -> (Vec3, f32) {
        let value = own.0.max(Vec3::splat(BLACK));
        let mean = (self.log * self.paint + value.ln() * (1.0 - self.paint)).exp();
        let apart = luminance(value).ln() - luminance(self.log.exp()).ln();
        let relative = own.1 / luminance(value);
        let variance = self.paint * self.variance
            + (1.0 - self.paint) * relative * relative
            + self.paint * (1.0 - self.paint) * apart * apart;
        (mean, luminance(mean) * variance.sqrt())
    }
}

/// What a look is if it is paint; none if nothing is known of it. `share(k)` is how common colour k
/// is where it lies, `mislabelled` the density of looks like it on other classes there.
fn posterior(
    look: &Look,
    (paint, logs): (&ClassPalette, &[Vec3]),
    share: impl Fn(usize) -> f32,
    mislabelled: f32,
) -> Option<Posterior> {
    let weight: Vec<f32> = logs
        .iter()
        .enumerate()
        .map(|(k, l)| share(k) * look.density(look.distance2(*l)))
        .collect();
    let known: f32 = paint.colours.iter().map(|c| c.1).sum();
    // albedos that are no paint lie evenly between black and white, per unit of (ln albedo)³
    let anything = BLACK.recip().ln().powi(3).recip();
    let other = (1.0 - known).max(LEAST_SHARE) * anything + mislabelled;
    let total: f32 = weight.iter().sum();
    if total <= f32::MIN_POSITIVE || !(total + other).is_finite() {
        return None;
    }
    // of the deviation from a colour, what texture explains is the texel's own
    let (own2, texture2) = (look.error * look.error, paint.texture * paint.texture);
    let keep = texture2 / own2;
    let log = logs
        .iter()
        .zip(&weight)
        .map(|(l, w)| (*l + (look.log - *l) * keep) * (w / total))
        .sum::<Vec3>();
    let spread: f32 = logs
        .iter()
        .zip(&weight)
        .map(|(l, w)| ((*l - log).element_sum() / 3.0).powi(2) * w / total)
        .sum();
    // (as much as estimates of paint vary, all texels of a colour may err together)
    let variance = keep * (own2 - texture2) + MOST_TEXTURE * MOST_TEXTURE + spread;
    Some(Posterior {
        paint: paint.surely * total / (total + other),
        log,
        variance,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    const SIDE: usize = 128;

    fn square() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
            normals: vec![Vec3::Z; 4],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    /// A square of `SIDE`² texels with an albedo, a standard error and cleanness per place.
    struct Wall {
        mesh: Mesh,
        texels: Texels,
        albedo: AlbedoEstimate,
        error: Vec<f32>,
        labels: Vec<u16>,
        rooms: Vec<u16>,
    }

    impl Wall {
        fn new(albedo: impl Fn(usize, usize) -> Vec3) -> Self {
            let mesh = square();
            let texels = Texels::rasterize(&mesh, SIDE, SIDE);
            let value: Vec<Vec3> = texels
                .cell
                .iter()
                .map(|&c| albedo(c as usize % SIDE, c as usize / SIDE))
                .collect();
            let n = value.len();
            let albedo = AlbedoEstimate {
                error: vec![0.01; n],
                looks: vec![3.0; n],
                specular_share: vec![0.0; n],
                clean: vec![true; n],
                footprint: vec![0.01; n],
                value,
            };
            Self {
                error: vec![0.02; n],
                labels: vec![1; n],
                rooms: vec![1; n],
                mesh,
                texels,
                albedo,
            }
        }

        fn painting(&self) -> PaletteFit<'_> {
            let Self {
                mesh,
                texels,
                albedo,
                error,
                labels,
                rooms,
            } = self;
            PaletteFit {
                albedo,
                error,
                texels,
                mesh,
                labels,
                rooms,
            }
        }

        fn settled(&self) -> Vec<(Vec3, f32)> {
            self.painting().settle(&self.painting().paints(false))
        }

        fn at(&self, x: usize, y: usize) -> usize {
            self.texels
                .cell
                .iter()
                .position(|c| *c as usize == y * SIDE + x)
                .expect("covered")
        }
    }

    /// Uneven by a few percent, smoothly, as errors of the light are.
    fn shade(x: usize, y: usize) -> f32 {
        1.0 + 0.04 * (x as f32 / 30.0).sin() * (y as f32 / 25.0).cos()
    }

    #[test]
    fn paint_loses_the_unevenness_of_its_light() {
        let grey = Vec3::new(0.6, 0.58, 0.55);
        let wall = Wall::new(|x, y| grey * shade(x, y));
        let paints = wall.painting().paints(false);
        assert_eq!((paints.len(), paints[0].colours.len()), (1, 1));
        assert!(
            (paints[0].colours[0].0 - grey).abs().max_element() < 0.005,
            "{paints:?}"
        );
        for (value, error) in wall.settled() {
            assert!((value - grey).abs().max_element() < 0.008, "{value}");
            assert!(error > 0.0 && error < 0.02, "{error}");
        }
    }

    #[test]
    fn two_colours_stay_two_and_a_picture_on_the_wall_stays() {
        let (red, blue) = (Vec3::new(0.6, 0.3, 0.3), Vec3::new(0.3, 0.35, 0.6));
        let picture = |x: usize, y: usize| (50..58).contains(&x) && (50..58).contains(&y);
        let wall = Wall::new(|x, y| {
            let colour = if picture(x, y) {
                Vec3::splat(0.05)
            } else if x < 80 {
                red
            } else {
                blue
            };
            colour * shade(x, y)
        });
        assert_eq!(wall.painting().paints(false)[0].colours.len(), 2);
        let settled = wall.settled();
        for (x, y, truth) in [(20, 20, red), (120, 90, blue), (54, 54, Vec3::splat(0.05))] {
            let value = settled[wall.at(x, y)].0;
            assert!(
                ((value - truth) / truth).abs().max_element()
                    < 0.03 + 0.03 * f32::from(u8::from(picture(x, y))),
                "{x} {y}: {value}"
            );
        }
    }

    /// Sprigs on a tenth of the wall, an eighth darker: they stay, and the ground is evened.
    #[test]
    fn a_sparse_pattern_stays_while_its_ground_is_evened() {
        let grey = Vec3::new(0.6, 0.58, 0.55);
        let sprig = |x: usize, y: usize| x % 13 < 4 && y % 13 < 4;
        let truth = |x, y| grey * if sprig(x, y) { 0.875 } else { 1.0 };
        let noise = |x: usize, y: usize| 1.0 + 0.01 * ((x * 31 + y * 17) as f32 * 0.7).sin();
        let wall = Wall::new(|x, y| truth(x, y) * shade(x, y) * noise(x, y));
        assert_eq!(wall.painting().paints(false).len(), 1);
        let settled = wall.settled();
        let mut error = [0.0f32; 2];
        for (x, y) in (20..100).flat_map(|x| (20..100).map(move |y| (x, y))) {
            let off = (settled[wall.at(x, y)].0 / truth(x, y) - Vec3::ONE).length();
            let worst = &mut error[usize::from(sprig(x, y))];
            *worst = worst.max(off);
        }
        assert!(error[0] < 0.05 && error[1] < 0.06, "{error:?}");
    }

    #[test]
    fn wood_keeps_its_grain_whatever_its_light() {
        let grain =
            |x: usize, y: usize| 0.3 * (1.0 + 0.15 * ((x * 7 + y / 9) as f32).sin()) * shade(x, y);
        let wall = Wall::new(|x, y| Vec3::splat(grain(x, y)));
        assert!(wall.painting().paints(false).is_empty());
        assert!(
            wall.settled()
                .iter()
                .zip(&wall.albedo.value)
                .all(|(s, v)| s.0 == *v)
        );
    }

    /// A class of which most flat surface lies near edges is judged by the rest, if that is enough to
    /// be sure.
    #[test]
    fn few_texels_far_from_edges_tell_of_texture_as_far_as_they_can() {
        let even = |n: usize, level: f32| -> Vec<f32> {
            (0..n)
                .map(|i| level * (0.5 + i as f32 / n as f32))
                .collect()
        };
        let texture = |far: usize| texture_of(even(1500, 0.06), even(far, 0.01)).expect("known");
        assert!((texture(400) - 0.01).abs() < 1e-4);
        let (some, few, none) = (texture(70), texture(8), texture(0));
        assert!(some > 0.011 && some < 0.015, "{some}");
        assert!(few > some && few < none, "{few}");
        assert!((none - 0.06).abs() < 1e-3, "{none}");
        // surface that is smoother near edges than far from them stays what it was
        assert!(texture_of(even(1500, 0.01), even(70, 0.06)).expect("known") < 0.011);
    }

    #[test]
    fn an_edge_takes_the_colour_around_it_but_not_that_of_another_class() {
        let (white, wood) = (Vec3::splat(0.8), Vec3::new(0.4, 0.2, 0.05));
        let mut wall = Wall::new(|x, _| if x < 64 { white } else { wood });
        wall.labels = wall
            .texels
            .cell
            .iter()
            .map(|c| if *c as usize % SIDE < 64 { 1 } else { 2 })
            .collect();
        let (mixed, stray) = (wall.at(62, 40), wall.at(61, 90));
        for (i, value, error) in [(mixed, 0.65 * Vec3::ONE, 0.2), (stray, wood, 0.12)] {
            wall.albedo.value[i] = value;
            wall.albedo.clean[i] = false;
            wall.error[i] = error;
        }
        let settled = wall.settled();
        assert!(
            (settled[mixed].0 - white).abs().max_element() < 0.02,
            "{:?}",
            settled[mixed]
        );
        // labelled as paint, but it looks like the wood beside it
        assert!(
            (settled[stray].0 - wood).abs().max_element() < 0.05,
            "{:?}",
            settled[stray]
        );
    }

    #[test]
    fn an_edge_takes_the_paint_of_its_own_room() {
        let (beige, pink) = (Vec3::new(0.7, 0.62, 0.5), Vec3::new(0.75, 0.5, 0.5));
        let mut wall = Wall::new(|x, _| if x < 64 { beige } else { pink });
        // a texel in the beige room that an edge makes pinkish, far from the other room
        let stray = wall.at(20, 40);
        wall.albedo.value[stray] = 0.55 * pink + 0.45 * beige;
        wall.albedo.clean[stray] = false;
        wall.error[stray] = 0.2;
        let off = |wall: &Wall| {
            let value = wall.settled()[stray].0;
            (value - beige).abs().max_element()
        };
        let anywhere = off(&wall);
        wall.rooms = wall
            .texels
            .cell
            .iter()
            .map(|c| if *c as usize % SIDE < 64 { 1 } else { 2 })
            .collect();
        let in_room = off(&wall);
        assert!(
            in_room < 0.02 && in_room < 0.5 * anywhere,
            "{in_room} {anywhere}"
        );
    }

    #[test]
    fn what_nobody_saw_and_empty_input_pass() {
        let mut wall = Wall::new(|_, _| Vec3::splat(0.5));
        wall.error[9] = f32::INFINITY;
        assert!(wall.settled()[9].1.is_infinite());
        wall.error.fill(f32::INFINITY);
        assert!(wall.painting().paints(false).is_empty());
        wall.albedo.value.fill(Vec3::ZERO);
        wall.error.fill(0.0);
        assert!(
            wall.settled()
                .iter()
                .all(|s| s.0.is_finite() && s.1.is_finite())
        );
    }
}
