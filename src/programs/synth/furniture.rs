//! Furniture from boxes, cylinders, spheres, lathes and cushions, arranged by room kind.
//!
//! Local coordinates: y up, pieces stand at the origin on the floor and face −z (their back is at
//! +z).

use super::catalogue::{
    BED_FRAME, BEDDING, BOOK, BOWL, CABINET, CHAIR, CUSHION, FRUIT, GLASS_SCREEN, HANDLE, HOOD,
    LAMP_STAND, MIRROR, ORNAMENT, PICTURE, PICTURE_FRAME, PILLOW, PLANT, PLANT_POT, PLANTER, RUG,
    SHELF, SOFA, SPLASHBACK, TABLE, TABLE_TOP, TAP, VASE, WORKTOP,
};
use super::plan::Decorator;
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, PI};

/// Warm lamp light of the given radiance.
fn warm(radiance: f32) -> Vec3 {
    Vec3::new(1.0, 0.83, 0.64) * radiance
}

/// Neutral lamp light.
fn neutral(radiance: f32) -> Vec3 {
    Vec3::new(1.0, 0.96, 0.9) * radiance
}

/// Furnishes a room of `size` whose doors lie towards the south (+z) ends of its west and east
/// walls and whose window is in the north (z = 0) wall.
pub fn furnish(d: &mut Decorator, kind: usize, size: Vec3) {
    match kind {
        0 => living_room(d, size),
        1 => bedroom(d, size),
        _ => kitchen(d, size),
    }
}

fn living_room(d: &mut Decorator, size: Vec3) {
    let middle = 0.5 * size.x + d.uniform(-0.15, 0.15);
    d.builder_turned(Vec3::new(middle, 0.0, 0.62), PI, |d| sofa(d, 2.1));
    let table = Vec3::new(middle, 0.0, 1.95);
    d.builder_at(table, |d| {
        rug(d, Vec2::new(2.3, 1.5));
        d.builder_at(Vec3::Y * 0.012, |d| {
            coffee_table(d, Vec3::new(1.1, 0.42, 0.6))
        });
    });
    d.builder_turned(
        Vec3::new(size.x - 0.9, 0.0, 2.1),
        -FRAC_PI_2 + 0.25,
        armchair,
    );
    let shelf_x = middle + d.uniform(-0.3, 0.3);
    d.builder_at(Vec3::new(shelf_x - 0.55, 0.0, size.z - 0.17), |d| {
        shelf(d, 1.0, 1.9)
    });
    d.builder_at(Vec3::new(shelf_x + 0.85, 0.0, size.z - 0.24), |d| {
        sideboard(d, 1.3)
    });
    picture(
        d,
        Vec3::new(shelf_x + 0.85, 1.55, size.z),
        Vec3::NEG_Z,
        Vec2::new(0.9, 0.6),
    );
    let by_the_lamp = if d.fittings { MIRROR } else { PICTURE };
    framed(
        d,
        by_the_lamp,
        Vec3::new(0.0, 1.5, 1.6),
        Vec3::X,
        Vec2::new(0.6, 0.8),
    );
    picture(
        d,
        Vec3::new(size.x, 1.55, 1.7),
        Vec3::NEG_X,
        Vec2::new(1.1, 0.7),
    );
    d.builder_at(Vec3::new(0.45, 0.0, 0.5), floor_lamp);
    d.builder_at(Vec3::new(size.x - 0.45, 0.0, 0.5), |d| plant(d, 1.0));
    pendant(d, Vec3::new(middle, size.y, 2.2), 0.6, 0.19, warm(48.0));
    if d.panes {
        d.builder_turned(Vec3::new(shelf_x - 0.3, 0.0, size.z - 1.2), 0.2, |d| {
            glass_screen(d, Vec2::new(1.2, 1.8));
        });
    }
}

/// A pane that stands on two feet, across z.
fn glass_screen(d: &mut Decorator, size: Vec2) {
    const FOOT: Vec3 = Vec3::new(0.03, 0.08, 0.3);
    let (pane, stand) = (d.finish(GLASS_SCREEN), d.finish(LAMP_STAND));
    let half = 0.5 * size.x;
    d.occupy(
        Vec2::new(-half, -0.5 * FOOT.z),
        Vec2::new(half, 0.5 * FOOT.z),
    );
    for x in [-0.8 * half, 0.8 * half] {
        let low = Vec3::new(x - 0.5 * FOOT.x, 0.0, -0.5 * FOOT.z);
        d.builder.cuboid(low, low + FOOT, false, stand);
    }
    let corner = Vec3::new(-half, FOOT.y, 0.0);
    d.builder
        .rect(corner, Vec3::X * size.x, Vec3::Y * size.y, pane);
}

fn bedroom(d: &mut Decorator, size: Vec3) {
    let middle = 0.5 * size.x + d.uniform(-0.1, 0.1);
    d.builder_at(Vec3::new(middle, 0.0, size.z), |d| bed(d, 1.6, 2.05));
    for side in [-1.0, 1.0] {
        d.builder_at(Vec3::new(middle + side * 1.12, 0.0, size.z - 0.24), |d| {
            bedside_table(d);
            d.builder_at(Vec3::Y * 0.5, table_lamp);
        });
    }
    d.builder_at(Vec3::new(middle, 0.0, size.z - 2.75), |d| {
        rug(d, Vec2::new(1.9, 0.9))
    });
    d.builder_turned(Vec3::new(0.32, 0.0, 1.35), -FRAC_PI_2, |d| {
        wardrobe(d, Vec3::new(1.6, 2.1, 0.6))
    });
    d.builder_turned(Vec3::new(size.x - 0.2, 0.0, 1.3), FRAC_PI_2, |d| {
        sideboard(d, 1.1)
    });
    let above_sideboard = Vec3::new(size.x, 1.55, 1.3);
    if d.fittings {
        framed(d, MIRROR, above_sideboard, Vec3::NEG_X, Vec2::splat(0.9));
    } else {
        picture(d, above_sideboard, Vec3::NEG_X, Vec2::splat(0.7));
    }
    picture(
        d,
        Vec3::new(middle, 1.65, size.z),
        Vec3::NEG_Z,
        Vec2::new(1.2, 0.55),
    );
    d.builder_turned(Vec3::new(middle + 0.2, 0.0, 0.75), 2.6, armchair);
    ceiling_panel(
        d,
        Vec3::new(middle, size.y, 0.5 * size.z - 0.3),
        Vec2::new(0.8, 0.8),
        neutral(26.0),
    );
}

fn kitchen(d: &mut Decorator, size: Vec3) {
    let centre = Vec3::new(0.5 * size.x + d.uniform(-0.1, 0.1), 0.0, 1.75);
    d.builder_at(centre, |d| {
        dining_table(d, Vec3::new(1.6, 0.75, 0.9));
        for (x, z, yaw) in [
            (-0.4, -0.72, PI),
            (0.4, -0.72, PI + 0.15),
            (-0.4, 0.72, 0.1),
            (0.42, 0.72, -0.08),
        ] {
            d.builder_turned(Vec3::new(x, 0.0, z), yaw, chair);
        }
    });
    let length = size.x - 2.4;
    d.builder_at(Vec3::new(0.5 * size.x, 0.0, size.z), |d| {
        counter(d, length, size.y);
    });
    d.builder_turned(Vec3::new(0.3, 0.0, 1.2), -FRAC_PI_2, |d| {
        wardrobe(d, Vec3::new(0.7, 1.95, 0.6))
    });
    d.builder_turned(Vec3::new(size.x - 0.17, 0.0, 1.3), FRAC_PI_2, |d| {
        shelf(d, 0.9, 1.5)
    });
    picture(d, Vec3::new(0.0, 1.5, 2.4), Vec3::X, Vec2::new(0.5, 0.6));
    d.builder_at(Vec3::new(size.x - 0.4, 0.0, 0.4), |d| plant(d, 0.8));
    pendant(
        d,
        centre + Vec3::new(-0.35, size.y, 0.0),
        0.75,
        0.13,
        warm(50.0),
    );
    pendant(
        d,
        centre + Vec3::new(0.35, size.y, 0.0),
        0.75,
        0.13,
        warm(50.0),
    );
    let spot = d.lamp(neutral(50.0));
    let rim = d.finish(LAMP_STAND);
    for i in 0..4 {
        let x = 0.5 * size.x + (i as f32 - 1.5) * length / 4.0;
        let p = Vec3::new(x, size.y - 0.03, size.z - 0.75);
        d.builder.cylinder(p, 0.085, 0.03, 24, false, rim);
        d.builder
            .lathe(p, &[Vec2::ZERO, Vec2::new(0.06, 0.0)], 24, spot);
        d.builder
            .lathe(p, &[Vec2::new(0.06, 0.0), Vec2::new(0.085, 0.0)], 24, rim);
    }
}

/// A block given by its centre line on the floor: x centred, from z back to front.
fn block(d: &mut Decorator, low: [f32; 3], high: [f32; 3], bottom: bool, class: u16) {
    let finish = d.finish(class);
    d.builder.cuboid(
        Vec3::from_array(low),
        Vec3::from_array(high),
        bottom,
        finish,
    );
}

fn legs(d: &mut Decorator, half: Vec2, height: f32, radius: f32, class: u16) {
    let finish = d.finish(class);
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
        d.builder.cylinder(
            Vec3::new(sx * half.x, 0.0, sz * half.y),
            radius,
            height,
            14,
            false,
            finish,
        );
    }
}

fn sofa(d: &mut Decorator, width: f32) {
    let (h, cloth) = (0.5 * width, d.finish(SOFA));
    d.occupy(Vec2::new(-h, -0.5), Vec2::new(h, 0.45));
    legs(d, Vec2::new(h - 0.12, 0.35), 0.12, 0.025, LAMP_STAND);
    block(d, [-h, 0.12, -0.45], [h, 0.28, 0.45], true, SOFA);
    for i in 0..3 {
        let w = (width - 0.36) / 3.0;
        let x = -h + 0.18 + w * (i as f32 + 0.5);
        d.builder.cushion(
            Vec3::new(x, 0.36, -0.08),
            Vec3::new(0.5 * w, 0.1, 0.38),
            0.35,
            cloth,
        );
        d.builder.cushion(
            Vec3::new(x, 0.62, 0.3),
            Vec3::new(0.5 * w, 0.24, 0.12),
            0.45,
            cloth,
        );
    }
    for side in [-1.0, 1.0] {
        d.builder.cushion(
            Vec3::new(side * (h - 0.09), 0.4, -0.02),
            Vec3::new(0.1, 0.2, 0.44),
            0.4,
            cloth,
        );
    }
    for x in [-0.6, 0.55] {
        let finish = d.own_finish(CUSHION);
        d.builder_turned(Vec3::new(x, 0.6, 0.08), 0.4 * x, |d| {
            d.builder
                .cushion(Vec3::ZERO, Vec3::new(0.2, 0.18, 0.08), 0.7, finish);
        });
    }
}

fn armchair(d: &mut Decorator) {
    let cloth = d.own_finish(SOFA);
    d.occupy(Vec2::new(-0.42, -0.42), Vec2::new(0.42, 0.42));
    legs(d, Vec2::new(0.3, 0.3), 0.14, 0.022, CHAIR);
    d.builder.cuboid(
        Vec3::new(-0.38, 0.14, -0.36),
        Vec3::new(0.38, 0.27, 0.36),
        true,
        cloth,
    );
    d.builder.cushion(
        Vec3::new(0.0, 0.36, -0.05),
        Vec3::new(0.29, 0.1, 0.33),
        0.4,
        cloth,
    );
    d.builder.cushion(
        Vec3::new(0.0, 0.6, 0.28),
        Vec3::new(0.3, 0.28, 0.11),
        0.45,
        cloth,
    );
    for side in [-1.0, 1.0] {
        d.builder.cushion(
            Vec3::new(side * 0.33, 0.4, -0.02),
            Vec3::new(0.085, 0.17, 0.36),
            0.4,
            cloth,
        );
    }
}

fn rug(d: &mut Decorator, size: Vec2) {
    let finish = d.own_finish(RUG);
    let half = 0.5 * size;
    d.builder.cuboid(
        Vec3::new(-half.x, 0.0, -half.y),
        Vec3::new(half.x, 0.012, half.y),
        false,
        finish,
    );
}

fn coffee_table(d: &mut Decorator, size: Vec3) {
    let (hx, hz) = (0.5 * size.x, 0.5 * size.z);
    d.occupy(Vec2::new(-hx, -hz), Vec2::new(hx, hz));
    legs(
        d,
        Vec2::new(hx - 0.06, hz - 0.06),
        size.y - 0.035,
        0.024,
        TABLE,
    );
    let top = if d.fittings { TABLE_TOP } else { TABLE };
    block(d, [-hx, size.y - 0.035, -hz], [hx, size.y, hz], true, top);
    d.builder_at(Vec3::new(0.2, size.y, 0.02), bowl);
    d.builder_turned(Vec3::new(-0.25, size.y, -0.05), 0.4, |d| book_pile(d, 3));
}

fn dining_table(d: &mut Decorator, size: Vec3) {
    let (hx, hz) = (0.5 * size.x, 0.5 * size.z);
    d.occupy(Vec2::new(-hx, -hz), Vec2::new(hx, hz));
    legs(
        d,
        Vec2::new(hx - 0.08, hz - 0.08),
        size.y - 0.04,
        0.032,
        TABLE,
    );
    block(d, [-hx, size.y - 0.04, -hz], [hx, size.y, hz], true, TABLE);
    d.builder_at(Vec3::new(-0.05, size.y, 0.05), bowl);
    d.builder_at(Vec3::new(0.45, size.y, -0.1), |d| vase(d, 0.28));
    d.builder_at(Vec3::new(-0.5, size.y, -0.15), |d| vase(d, 0.18));
}

fn chair(d: &mut Decorator) {
    d.occupy(Vec2::new(-0.23, -0.24), Vec2::new(0.23, 0.26));
    legs(d, Vec2::new(0.18, 0.18), 0.43, 0.017, CHAIR);
    block(d, [-0.22, 0.43, -0.22], [0.22, 0.46, 0.22], true, CHAIR);
    let finish = d.own_finish(CUSHION);
    d.builder.cushion(
        Vec3::new(0.0, 0.48, 0.0),
        Vec3::new(0.2, 0.025, 0.2),
        0.4,
        finish,
    );
    for x in [-0.18, 0.18] {
        block(
            d,
            [x - 0.016, 0.46, 0.185],
            [x + 0.016, 0.92, 0.215],
            false,
            CHAIR,
        );
    }
    for y in [0.62, 0.76, 0.88] {
        block(d, [-0.164, y, 0.19], [0.164, y + 0.05, 0.21], true, CHAIR);
    }
}

fn bowl(d: &mut Decorator) {
    let finish = d.own_finish(BOWL);
    let outer = [0.05, 0.07, 0.1, 0.125, 0.145, 0.16]
        .iter()
        .enumerate()
        .map(|(i, &r)| Vec2::new(r, 0.003 + 0.014 * i as f32));
    let inner = [0.155, 0.14, 0.12, 0.09, 0.05, 0.0]
        .iter()
        .enumerate()
        .map(|(i, &r)| Vec2::new(r, 0.07 - 0.011 * i as f32));
    d.builder.lathe(
        Vec3::ZERO,
        &outer.chain(inner).collect::<Vec<_>>(),
        40,
        finish,
    );
    for i in 0..4 {
        let a = i as f32 * 1.6 + d.uniform(0.0, 0.4);
        let r = d.uniform(0.033, 0.042);
        let fruit = d.own_finish(FRUIT);
        let reach = if i == 3 { 0.0 } else { 0.06 };
        let y = if i == 3 { 0.105 } else { 0.06 };
        d.builder
            .sphere(Vec3::new(reach * a.cos(), y, reach * a.sin()), r, 8, fruit);
    }
}

fn vase(d: &mut Decorator, height: f32) {
    let finish = d.own_finish(VASE);
    let rows = 18;
    let profile: Vec<Vec2> = (0..=rows)
        .map(|i| {
            let t = i as f32 / rows as f32;
            let r = 0.3
                + 0.55 * (PI * (0.15 + 0.85 * t)).sin().max(0.0) * (1.0 - 0.35 * t)
                + 0.12 * t.powi(6);
            Vec2::new(0.24 * height * r, height * t)
        })
        .collect();
    d.builder.lathe(Vec3::ZERO, &profile, 36, finish);
    let neck = profile[rows].x;
    d.builder.lathe(
        Vec3::new(0.0, height * 0.97, 0.0),
        &[Vec2::new(neck * 0.97, 0.0), Vec2::ZERO],
        24,
        finish,
    );
}

fn book_pile(d: &mut Decorator, count: usize) {
    let mut y = 0.0;
    for i in 0..count {
        let (w, h, l) = (
            d.uniform(0.14, 0.18),
            d.uniform(0.02, 0.04),
            d.uniform(0.2, 0.26),
        );
        let finish = d.own_finish(BOOK);
        d.builder_turned(Vec3::Y * y, 0.25 * i as f32, |d| {
            d.builder.cuboid(
                Vec3::new(-0.5 * w, 0.0, -0.5 * l),
                Vec3::new(0.5 * w, h, 0.5 * l),
                true,
                finish,
            );
        });
        y += h + 0.0005;
    }
}

fn shelf(d: &mut Decorator, width: f32, height: f32) {
    let (h, depth, t) = (0.5 * width, 0.15, 0.022);
    d.occupy(Vec2::new(-h, -depth), Vec2::new(h, depth));
    for x in [-h, h - t] {
        block(d, [x, 0.0, -depth], [x + t, height, depth], false, SHELF);
    }
    let back = d.finish(SHELF);
    d.builder.rect_facing(
        Vec3::new(-h + t, 0.0, depth - 0.01),
        Vec3::X * (width - 2.0 * t),
        Vec3::Y * height,
        Vec3::NEG_Z,
        back,
    );
    let boards = (height / 0.36) as usize;
    for i in 0..=boards {
        let y = 0.05 + (height - 0.08) * i as f32 / boards as f32;
        block(
            d,
            [-h + t, y, -depth + 0.01],
            [h - t, y + t, depth - 0.012],
            true,
            SHELF,
        );
        if i == boards {
            break;
        }
        let mut x = -h + t + 0.03;
        if d.rng.below(3) > 0 {
            let end = d.uniform(0.45, 0.8) * width - h;
            while x < end {
                let (w, tall, deep) = (
                    d.uniform(0.02, 0.05),
                    d.uniform(0.17, 0.27),
                    d.uniform(0.14, 0.19),
                );
                let finish = d.own_finish(BOOK);
                let low = Vec3::new(x, y + t, depth - 0.02 - deep);
                d.builder
                    .cuboid(low, low + Vec3::new(w, tall, deep), false, finish);
                x += w + 0.001;
            }
            x += 0.12;
        } else {
            x += 0.15;
        }
        if x < h - 0.14 {
            match d.rng.below(3) {
                0 => d.builder_at(Vec3::new(x + 0.03, y + t, 0.0), |d| vase(d, 0.2)),
                1 => {
                    let finish = d.own_finish(ORNAMENT);
                    d.builder
                        .sphere(Vec3::new(x + 0.03, y + t + 0.062, 0.0), 0.062, 14, finish);
                }
                _ => d.builder_at(Vec3::new(x + 0.03, y + t, 0.0), |d| book_pile(d, 3)),
            }
        }
    }
}

fn sideboard(d: &mut Decorator, width: f32) {
    let h = 0.5 * width;
    d.occupy(Vec2::new(-h, -0.22), Vec2::new(h, 0.22));
    legs(d, Vec2::new(h - 0.08, 0.16), 0.14, 0.018, LAMP_STAND);
    block(d, [-h, 0.14, -0.2], [h, 0.72, 0.22], true, CABINET);
    doors(d, [-h, 0.17], [h, 0.69], -0.2, 3, CABINET);
    d.builder_at(Vec3::new(-0.6 * h, 0.72, 0.02), |d| vase(d, 0.32));
    let finish = d.own_finish(ORNAMENT);
    d.builder
        .sphere(Vec3::new(0.15 * h, 0.72 + 0.09, 0.0), 0.09, 20, finish);
    d.builder_turned(Vec3::new(0.62 * h, 0.72, 0.0), 0.3, |d| book_pile(d, 2));
}

/// Door panels in front of a carcass at z.
fn doors(d: &mut Decorator, low: [f32; 2], high: [f32; 2], z: f32, count: usize, class: u16) {
    let w = (high[0] - low[0]) / count as f32;
    let knob = d.finish(LAMP_STAND);
    for i in 0..count {
        let x = low[0] + w * i as f32;
        block(
            d,
            [x + 0.006, low[1], z - 0.018],
            [x + w - 0.006, high[1], z],
            true,
            class,
        );
        let place = Vec3::new(x + w - 0.05, 0.5 * (low[1] + high[1]), z - 0.03);
        if d.fittings {
            handle(d, place);
        } else {
            d.builder.sphere(place, 0.014, 5, knob);
        }
    }
}

/// An upright bar around `middle`, in front of a door.
fn handle(d: &mut Decorator, middle: Vec3) {
    let finish = d.finish(HANDLE);
    let (radius, half) = (0.011, Vec3::Y * 0.08);
    let bar = 2.0 * half.y;
    d.builder
        .cylinder(middle - half, radius, bar, 12, true, finish);
}

fn wardrobe(d: &mut Decorator, size: Vec3) {
    let (h, depth) = (0.5 * size.x, 0.5 * size.z);
    d.occupy(Vec2::new(-h, -depth), Vec2::new(h, depth));
    block(
        d,
        [-h, 0.0, -depth + 0.02],
        [h, size.y, depth],
        false,
        CABINET,
    );
    doors(
        d,
        [-h, 0.08],
        [h, size.y - 0.03],
        -depth + 0.02,
        if size.x > 1.0 { 3 } else { 1 },
        CABINET,
    );
}

fn bed(d: &mut Decorator, width: f32, length: f32) {
    let h = 0.5 * width;
    d.occupy(
        Vec2::new(-h - 0.05, -length - 0.1),
        Vec2::new(h + 0.05, 0.0),
    );
    block(d, [-h, 0.08, -length], [h, 0.28, -0.06], true, BED_FRAME);
    block(
        d,
        [-h - 0.04, 0.0, -0.06],
        [h + 0.04, 1.05, -0.004],
        false,
        BED_FRAME,
    );
    legs_at_foot(d, h, length);
    let (sheet, cover) = (d.finish(PILLOW), d.finish(BEDDING));
    d.builder.cushion(
        Vec3::new(0.0, 0.37, -0.5 * length - 0.02),
        Vec3::new(h - 0.02, 0.12, 0.5 * length - 0.05),
        0.22,
        sheet,
    );
    d.builder.cushion(
        Vec3::new(0.0, 0.42, -0.62 * length),
        Vec3::new(h + 0.02, 0.12, 0.37 * length),
        0.25,
        cover,
    );
    for x in [-0.38, 0.38] {
        d.builder_turned(Vec3::new(x, 0.56, -0.36), 0.1 * x, |d| {
            d.builder
                .cushion(Vec3::ZERO, Vec3::new(0.31, 0.08, 0.2), 0.6, sheet);
        });
    }
}

fn legs_at_foot(d: &mut Decorator, half: f32, length: f32) {
    let finish = d.finish(BED_FRAME);
    for x in [-half + 0.06, half - 0.06] {
        d.builder.cylinder(
            Vec3::new(x, 0.0, -length + 0.06),
            0.03,
            0.08,
            14,
            false,
            finish,
        );
    }
}

fn bedside_table(d: &mut Decorator) {
    d.occupy(Vec2::new(-0.22, -0.2), Vec2::new(0.22, 0.24));
    block(d, [-0.21, 0.06, -0.19], [0.21, 0.5, 0.2], true, BED_FRAME);
    legs(d, Vec2::new(0.17, 0.15), 0.06, 0.018, LAMP_STAND);
    block(
        d,
        [-0.19, 0.28, -0.203],
        [0.19, 0.47, -0.19],
        true,
        BED_FRAME,
    );
}

fn table_lamp(d: &mut Decorator) {
    let (stand, glow) = (d.finish(LAMP_STAND), d.lamp(warm(30.0)));
    d.builder
        .cylinder(Vec3::ZERO, 0.06, 0.015, 24, false, stand);
    d.builder
        .cylinder(Vec3::Y * 0.015, 0.012, 0.12, 12, false, stand);
    d.builder.sphere(Vec3::Y * 0.22, 0.09, 8, glow);
}

fn floor_lamp(d: &mut Decorator) {
    d.occupy(Vec2::splat(-0.2), Vec2::splat(0.2));
    let (stand, glow) = (d.finish(LAMP_STAND), d.lamp(warm(20.0)));
    d.builder.cylinder(Vec3::ZERO, 0.15, 0.02, 28, false, stand);
    d.builder
        .cylinder(Vec3::Y * 0.02, 0.014, 1.4, 12, false, stand);
    let shade = [Vec2::new(0.0, 0.0), Vec2::new(0.17, 0.0)];
    let side = [
        Vec2::new(0.17, 0.0),
        Vec2::new(0.15, 0.14),
        Vec2::new(0.13, 0.28),
    ];
    let top = [Vec2::new(0.13, 0.28), Vec2::ZERO + Vec2::Y * 0.28];
    for profile in [&shade[..], &side[..], &top[..]] {
        d.builder.lathe(Vec3::Y * 1.42, profile, 28, glow);
    }
}

fn pendant(d: &mut Decorator, ceiling: Vec3, drop: f32, radius: f32, radiance: Vec3) {
    let (stand, glow) = (d.finish(LAMP_STAND), d.lamp(radiance));
    d.occupy(
        Vec2::new(ceiling.x - radius, ceiling.z - radius),
        Vec2::new(ceiling.x + radius, ceiling.z + radius),
    );
    let centre = ceiling - Vec3::Y * (drop + radius);
    d.builder
        .cylinder(ceiling - Vec3::Y * 0.03, 0.05, 0.03, 20, true, stand);
    d.builder.cylinder(
        centre + Vec3::Y * radius,
        0.007,
        drop - 0.03,
        8,
        false,
        stand,
    );
    d.builder.sphere(centre, radius, 8, glow);
}

fn ceiling_panel(d: &mut Decorator, centre: Vec3, size: Vec2, radiance: Vec3) {
    let (stand, glow) = (d.finish(LAMP_STAND), d.lamp(radiance));
    let half = Vec3::new(0.5 * size.x, 0.0, 0.5 * size.y);
    let low = centre - half - Vec3::Y * 0.05;
    let rim = 0.02;
    d.builder.cuboid(low, centre + half, false, stand);
    // the frame's underside, then the glowing field
    let field = low + Vec3::new(rim, -0.0008, rim);
    d.builder
        .rect_facing(low, Vec3::X * size.x, Vec3::Z * size.y, Vec3::NEG_Y, stand);
    let (x, z) = (
        Vec3::X * (size.x - 2.0 * rim),
        Vec3::Z * (size.y - 2.0 * rim),
    );
    d.builder.rect_facing(field, x, z, Vec3::NEG_Y, glow);
}

/// A framed picture on a wall: centre on the wall and the wall's normal.
fn picture(d: &mut Decorator, centre: Vec3, normal: Vec3, size: Vec2) {
    framed(d, PICTURE, centre, normal, size);
}

/// As [`picture`], of whatever hangs there.
fn framed(d: &mut Decorator, class: u16, centre: Vec3, normal: Vec3, size: Vec2) {
    let finish = d.own_finish(class);
    let frame = d.finish(PICTURE_FRAME);
    // local frame: x to the right as seen from the room, picture plane at −z
    let yaw = (-normal.x).atan2(-normal.z);
    d.builder_turned(centre, yaw, |d| {
        let (h, t, deep) = (0.5 * size, 0.03, 0.025);
        for y in [-h.y - t, h.y] {
            let low = Vec3::new(-h.x - t, y, -deep);
            d.builder
                .cuboid(low, low + Vec3::new(size.x + 2.0 * t, t, deep), true, frame);
        }
        for x in [-h.x - t, h.x] {
            let low = Vec3::new(x, -h.y, -deep);
            d.builder
                .cuboid(low, low + Vec3::new(t, size.y, deep), false, frame);
        }
        // u runs right and v down as on the wall, so that the painting stands upright in its
        // texture
        let corner = Vec3::new(h.x, h.y, -0.008);
        d.builder.rect_facing(
            corner,
            Vec3::NEG_X * size.x,
            Vec3::NEG_Y * size.y,
            Vec3::NEG_Z,
            finish,
        );
    });
}

fn plant(d: &mut Decorator, height: f32) {
    d.occupy(Vec2::splat(-0.3), Vec2::splat(0.3));
    let (pot, leaf) = (d.finish(PLANT_POT), d.finish(PLANT));
    let pot = if d.fittings { d.finish(PLANTER) } else { pot };
    let profile: Vec<Vec2> = (0..=6)
        .map(|i| Vec2::new(0.11 + 0.012 * i as f32, 0.045 * i as f32))
        .collect();
    d.builder.lathe(Vec3::ZERO, &profile, 32, pot);
    d.builder
        .lathe(Vec3::Y * 0.25, &[Vec2::new(0.18, 0.0), Vec2::ZERO], 24, pot);
    for i in 0..9 {
        let a = i as f32 * 2.4;
        let r = 0.05 + 0.1 * d.rng.next_f32();
        let y = 0.3 + (height - 0.35) * (i as f32 + 0.5) / 9.0;
        let half = Vec3::new(
            d.uniform(0.09, 0.14),
            d.uniform(0.08, 0.12),
            d.uniform(0.07, 0.11),
        );
        d.builder_turned(Vec3::new(r * a.cos(), y, r * a.sin()), a, |d| {
            d.builder.cushion(Vec3::ZERO, half, 0.9, leaf)
        });
    }
}

/// Half the width of a hood, metres.
const HOOD_HALF: f32 = 0.35;

/// An extractor hood on the wall (z = 0): a canopy, and a shaft up to the ceiling.
fn hood(d: &mut Decorator, ceiling: f32) {
    let w = HOOD_HALF - 0.01;
    block(d, [-w, 1.5, -0.5], [w, 1.62, -0.001], true, HOOD);
    block(
        d,
        [-0.16, 1.62, -0.31],
        [0.16, ceiling - 0.001, -0.001],
        false,
        HOOD,
    );
}

/// A mixer tap that stands at `foot`, its spout towards -z.
fn tap(d: &mut Decorator, foot: Vec3) {
    let finish = d.finish(TAP);
    d.builder_at(foot, |d| {
        let b = &mut d.builder;
        b.cylinder(Vec3::ZERO, 0.03, 0.05, 24, false, finish);
        b.cylinder(Vec3::Y * 0.05, 0.016, 0.27, 20, false, finish);
        let spout = [Vec3::new(-0.014, 0.292, -0.22), Vec3::new(0.014, 0.32, 0.0)];
        b.cuboid(spout[0], spout[1], true, finish);
        let nozzle = Vec3::new(0.0, 0.262, -0.205);
        b.cylinder(nozzle, 0.012, 0.03, 16, true, finish);
    });
}

/// A kitchen counter of `length` below wall cupboards, or a hood between them, in a room of
/// `height`.
fn counter(d: &mut Decorator, length: f32, height: f32) {
    let h = 0.5 * length;
    d.occupy(Vec2::new(-h, -0.62), Vec2::new(h, 0.0));
    block(d, [-h, 0.08, -0.58], [h, 0.86, 0.0], true, CABINET);
    block(
        d,
        [-h + 0.03, 0.0, -0.52],
        [h - 0.03, 0.08, 0.0],
        false,
        LAMP_STAND,
    );
    doors(d, [-h, 0.11], [h, 0.84], -0.58, 4, CABINET);
    block(
        d,
        [-h - 0.01, 0.86, -0.62],
        [h + 0.01, 0.9, 0.0],
        true,
        WORKTOP,
    );
    let tiles = d.finish(SPLASHBACK);
    d.builder.cuboid(
        Vec3::new(-h, 0.9, -0.012),
        Vec3::new(h, 1.45, -0.001),
        true,
        tiles,
    );
    let cupboards: &[[f32; 2]] = if d.fittings {
        hood(d, height);
        tap(d, Vec3::new(-0.35 * h, 0.9, -0.13));
        &[[-h, -HOOD_HALF], [HOOD_HALF, h]]
    } else {
        &[[-h, h]]
    };
    for &[left, right] in cupboards {
        let count = 4 / cupboards.len();
        block(d, [left, 1.45, -0.34], [right, 2.15, -0.001], true, CABINET);
        doors(d, [left, 1.47], [right, 2.13], -0.34, count, CABINET);
    }
    d.builder_at(Vec3::new(-0.7 * h, 0.9, -0.3), |d| vase(d, 0.24));
    d.builder_at(Vec3::new(0.1 * h, 0.9, -0.32), bowl);
    for i in 0..3 {
        let finish = d.own_finish(VASE);
        let r = 0.05 + 0.008 * i as f32;
        d.builder.cylinder(
            Vec3::new(0.55 * h + 0.14 * i as f32, 0.9, -0.2),
            r,
            0.14 + 0.03 * i as f32,
            28,
            false,
            finish,
        );
    }
}
