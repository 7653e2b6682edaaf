//! Procedural finishes: albedo and roughness as functions of metres on a chart.

use crate::core::sampling::hash_u64;
use glam::{Vec2, Vec3};

/// Albedo and roughness at a point.
pub type Look = (Vec3, f32);

/// A procedural material.
#[derive(Clone, Copy, Debug)]
pub enum Pattern {
    /// One colour with faint mottling.
    Plain,
    /// One colour, even: metal.
    Polished,
    /// Boards along u with growth rings; the second colour is the dark grain.
    Wood {
        /// Width of a board, metres.
        board: f32,
    },
    /// Square tiles of the first colour with grout of the second, rougher by `grout_roughness`.
    Tiles {
        /// Edge of a tile, metres.
        edge: f32,
        /// Roughness of the grout.
        grout_roughness: f32,
    },
    /// Two colours in squares.
    Checks {
        /// Edge of a square, metres.
        edge: f32,
    },
    /// Two colours in stripes across u.
    Stripes {
        /// Width of a stripe, metres.
        width: f32,
    },
    /// Woven cloth: noise at two scales.
    Fabric,
    /// A painting: bands and discs in colours of its own.
    Picture,
    /// A rug: border, field and lozenges.
    Rug,
    /// Every chart its own colour between the two.
    Assorted,
    /// Wallpaper: sprigs that cover little of an even ground.
    Sprigs {
        /// Distance between sprigs, metres.
        spacing: f32,
        /// How far their albedo is from the ground's towards the second colour.
        contrast: f32,
    },
}

/// A material of the apartment.
#[derive(Clone, Debug)]
pub struct Paint {
    /// Arrangement of the colours.
    pub pattern: Pattern,
    /// First and second colour.
    pub colours: [Vec3; 2],
    /// Roughness R.
    pub roughness: f32,
}

fn unit(key: u64, x: i64, y: i64) -> f32 {
    (hash_u64(hash_u64(key, x as u64), y as u64) >> 40) as f32 / 16_777_216.0
}

/// Smooth value noise in [0, 1] with features of size 1.
fn noise(key: u64, p: Vec2) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let s = f * f * (Vec2::splat(3.0) - 2.0 * f);
    let (x, y) = (cell.x as i64, cell.y as i64);
    let row = |dy: i64| unit(key, x, y + dy) * (1.0 - s.x) + unit(key, x + 1, y + dy) * s.x;
    row(0) * (1.0 - s.y) + row(1) * s.y
}

fn fractal(key: u64, p: Vec2) -> f32 {
    (noise(key, p) * 4.0 + noise(key + 1, p * 2.1) * 2.0 + noise(key + 2, p * 4.3)) / 7.0
}

/// A saturated colour of albedo below 0.8 from a key.
fn vivid(key: u64) -> Vec3 {
    let hue = unit(key, 1, 1) * 6.0;
    let channel = |k: f32| (((hue + k) % 6.0 - 3.0).abs() - 1.0).clamp(0.0, 1.0);
    let full = Vec3::new(channel(0.0), channel(4.0), channel(2.0));
    let value = 0.2 + 0.5 * unit(key, 2, 1);
    (Vec3::splat(0.25) + full * 0.75) * value
}

impl Paint {
    /// Takes the gloss off.
    pub fn make_matte(&mut self) {
        self.roughness = 1.0;
        if let Pattern::Tiles {
            grout_roughness, ..
        } = &mut self.pattern
        {
            *grout_roughness = 1.0;
        }
    }

    /// Papers a wall: sprigs a third of the way from the ground to a fixed dull green.
    pub const fn make_wallpaper(&mut self) {
        self.pattern = Pattern::Sprigs {
            spacing: 0.16,
            contrast: 0.35,
        };
        self.colours[1] = Vec3::new(0.25, 0.32, 0.22);
    }

    /// The look at `uv` metres on chart `key` of the given size.
    #[must_use]
    pub fn look(&self, uv: Vec2, size: Vec2, key: u64) -> Look {
        let [a, b] = self.colours;
        let chosen = |odd: bool| if odd { a } else { b };
        let albedo = match self.pattern {
            Pattern::Plain => a * (0.96 + 0.06 * fractal(key, uv * 3.0)),
            // no second lobe adds to it
            Pattern::Polished => return (a, self.roughness),
            Pattern::Wood { board } => self.wood(uv, board, key),
            Pattern::Tiles { edge, .. } if in_grout(uv, edge) => b,
            Pattern::Tiles { edge, .. } => {
                let p = uv / edge;
                let tone = 0.9 + 0.2 * unit(key, p.x.floor() as i64, p.y.floor() as i64);
                a * tone * (0.95 + 0.1 * fractal(key, uv * 6.0))
            }
            Pattern::Checks { edge } => {
                let p = (uv / edge).floor();
                let odd = (p.x + p.y).rem_euclid(2.0) > 0.5;
                chosen(odd) * (0.94 + 0.1 * fractal(key, uv * 9.0))
            }
            Pattern::Stripes { width } => {
                let odd = (uv.x / width).floor().rem_euclid(2.0) > 0.5;
                chosen(odd) * (0.94 + 0.1 * fractal(key, uv * 12.0))
            }
            Pattern::Fabric => {
                let weave = noise(key, uv * 40.0);
                let soft = fractal(key + 7, uv * 4.0);
                a.lerp(b, 0.5 * weave + 0.5 * soft)
            }
            Pattern::Picture => picture(uv / size, key),
            Pattern::Rug => self.rug(uv, size, key),
            Pattern::Assorted => a.lerp(b, unit(key, 5, 5)) * (0.4 + 0.6 * vivid(key)) * 1.4,
            Pattern::Sprigs { spacing, contrast } => {
                a.lerp(b, contrast * sprigs(uv / spacing, key)) * (0.98 + 0.03 * fractal(key, uv))
            }
        };
        let roughness = match self.pattern {
            Pattern::Tiles {
                edge,
                grout_roughness,
            } if in_grout(uv, edge) => grout_roughness,
            _ => self.roughness,
        };
        (
            albedo.clamp(Vec3::splat(0.02), Vec3::splat(0.85)),
            roughness.clamp(0.05, 1.0),
        )
    }

    /// Boards of width `board` along u, each of its own tone and grain, with dark joints.
    fn wood(&self, uv: Vec2, board: f32, key: u64) -> Vec3 {
        let [light, dark] = self.colours;
        let row = (uv.y / board).floor();
        let id = hash_u64(key, row as i64 as u64);
        let shift = unit(id, 3, 0) * 5.0;
        let along = uv.x + shift;
        let tone = 0.8 + 0.4 * unit(id, (along / (board * 9.0)).floor() as i64, 1);
        let across = uv.y + 0.035 * noise(id, Vec2::new(along * 1.3, uv.y * 6.0));
        let grain = fractal(id, Vec2::new(along * 2.5, across * 55.0));
        let joint = (uv.y / board).fract();
        let gap = if !(0.02..=0.98).contains(&joint) {
            0.6
        } else {
            1.0
        };
        light.lerp(dark, (grain * 1.4 - 0.3).clamp(0.0, 1.0)) * (tone * gap)
    }

    /// A border of the second colour, an inner one, and lozenges in the field.
    fn rug(&self, uv: Vec2, size: Vec2, key: u64) -> Vec3 {
        let [field, border] = self.colours;
        let inset = uv.min(size - uv).min_element();
        let p = uv - 0.5 * size;
        let lozenge = ((p.x.abs() * 4.0 + p.y.abs() * 6.0) * 1.2)
            .floor()
            .rem_euclid(3.0);
        let colour = if inset < 0.08 {
            border
        } else if inset < 0.14 {
            field * 0.5 + Vec3::splat(0.3)
        } else if lozenge < 0.5 {
            border * 0.8 + Vec3::new(0.1, 0.06, 0.02)
        } else {
            field
        };
        colour * (0.85 + 0.25 * noise(key, uv * 40.0))
    }
}

/// How far a point lies in a sprig, 0 to 1: in every other unit square a stalk with two leaves, a
/// tenth of the ground in all.
fn sprigs(p: Vec2, key: u64) -> f32 {
    let cell = p.floor();
    if (cell.x + cell.y).rem_euclid(2.0) < 0.5 {
        return 0.0;
    }
    let q = p - cell - Vec2::splat(0.5);
    let angle = 0.6 * (unit(key, cell.x as i64, cell.y as i64) - 0.5);
    let q = Vec2::from_angle(angle).rotate(q);
    let stalk = 0.03 - q.x.abs().max(q.y.abs() - 0.35);
    let leaf = |side: f32| {
        let d = Vec2::from_angle(side * 0.7).rotate(q - Vec2::new(side * 0.16, 0.1));
        0.17 - (d * Vec2::new(2.2, 1.0)).length()
    };
    let inside = stalk.max(leaf(1.0)).max(leaf(-1.0));
    (inside / 0.02 + 0.5).clamp(0.0, 1.0)
}

/// Whether `uv` lies in the grout between square tiles of the given edge.
fn in_grout(uv: Vec2, edge: f32) -> bool {
    let p = uv / edge;
    let f = p - p.floor();
    f.min(Vec2::ONE - f).min_element() * edge < 0.009
}

/// A painting on the unit square.
fn picture(p: Vec2, key: u64) -> Vec3 {
    let horizon = 0.35 + 0.3 * unit(key, 0, 0);
    let wave = 0.08 * (fractal(key, Vec2::new(p.x * 4.0, 0.5)) - 0.5);
    let mut c = if p.y < horizon + wave {
        vivid(key + 1).lerp(vivid(key + 2), p.y / horizon)
    } else {
        vivid(key + 3).lerp(vivid(key + 4), (p.y - horizon) / (1.0 - horizon))
    };
    for k in 0..5 {
        let centre = Vec2::new(unit(key, k, 10), unit(key, k, 11));
        let radius = 0.05 + 0.13 * unit(key, k, 12);
        if p.distance(centre) < radius {
            c = vivid(key + 20 + k as u64);
        }
    }
    c * (0.85 + 0.3 * noise(key, p * 30.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metal_is_as_bright_as_published_and_even() {
        let paint = Paint {
            pattern: Pattern::Polished,
            colours: [Vec3::new(0.91, 0.78, 0.42), Vec3::ZERO],
            roughness: 0.1,
        };
        for uv in [Vec2::ZERO, Vec2::new(0.3, 0.7)] {
            assert_eq!(paint.look(uv, Vec2::ONE, 7), (paint.colours[0], 0.1));
        }
    }

    #[test]
    fn every_pattern_stays_within_the_albedos_that_let_light_decay() {
        let patterns = [
            Pattern::Plain,
            Pattern::Wood { board: 0.1 },
            Pattern::Tiles {
                edge: 0.3,
                grout_roughness: 0.8,
            },
            Pattern::Checks { edge: 0.1 },
            Pattern::Stripes { width: 0.1 },
            Pattern::Fabric,
            Pattern::Picture,
            Pattern::Rug,
            Pattern::Assorted,
            Pattern::Sprigs {
                spacing: 0.2,
                contrast: 0.5,
            },
        ];
        for pattern in patterns {
            let paint = Paint {
                pattern,
                colours: [Vec3::splat(0.9), Vec3::splat(0.1)],
                roughness: 0.3,
            };
            for i in 0..400 {
                let uv = Vec2::new((i % 20) as f32 * 0.07 - 0.05, (i / 20) as f32 * 0.05 - 0.05);
                let (c, r) = paint.look(uv, Vec2::new(1.3, 0.9), 5);
                assert!(
                    c.is_finite()
                        && c.min_element() >= 0.02
                        && c.max_element() <= 0.85
                        && (0.05..=1.0).contains(&r)
                );
                assert_eq!((c, r), paint.look(uv, Vec2::new(1.3, 0.9), 5));
            }
        }
    }
}
