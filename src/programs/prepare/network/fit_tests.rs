//! Scale and shift by closed forms: a box whose distances are known, damaged tile by tile, recovered.

use super::engine_types::Shape;
use super::fit::{Anchor, Guess, Line, fit};
use super::options::{DepthFit, DepthValues};
use super::tiles::{Tile, tiles_of};
use crate::core::geometry::{Camera, Lens, Projection};
use crate::core::image::Plane;
use glam::{Mat3, Vec2, Vec3};

/// A room, metres.
const ROOM: Vec3 = Vec3::new(5.0, 2.6, 4.0);

/// Distance from a place in the room to its wall, along a ray.
fn wall(place: Vec3, direction: Vec3) -> f32 {
    let side = |k: usize| match direction[k] {
        d if d > 0.0 => (ROOM[k] - place[k]) / d,
        d => -place[k] / d,
    };
    (0..3)
        .map(side)
        .filter(|t| t.is_finite())
        .fold(f32::INFINITY, f32::min)
}

fn panorama(x: f32, y: f32, z: f32) -> Camera {
    Camera {
        projection: Projection::Equirectangular,
        width: 128,
        height: 64,
        world_from_camera: Mat3::from_rotation_y(x),
        position: Vec3::new(x, y, z),
    }
}

fn places() -> Vec<Camera> {
    vec![
        panorama(1.0, 1.4, 1.0),
        panorama(3.6, 1.5, 1.2),
        panorama(2.5, 1.2, 2.9),
        panorama(1.2, 1.6, 2.6),
    ]
}

fn shape(width: usize, height: usize) -> Shape {
    Shape {
        width: Some(width),
        height: Some(height),
    }
}

/// What a network would say of a tile that gives value = (y − shift)/scale.
fn damaged(tile: Tile, kind: DepthValues, line: Line) -> Guess {
    let [w, h] = tile.size;
    let value = |i: usize| {
        let pixel = Vec2::new((i % w) as f32 + 0.5, (i / w) as f32 + 0.5);
        let direction = tile.direction(pixel).expect("seen");
        let mut d = wall(tile.photo.position, direction);
        if kind.is_along_axis() {
            d /= tile.along_axis(direction);
        }
        let y = if kind.is_inverse() { 1.0 / d } else { d };
        ((f64::from(y) - line.shift) / line.scale) as f32
    };
    Guess {
        tile,
        values: Plane::from_data(w, h, (0..w * h).map(value).collect()).expect("plane"),
        kind,
        anchors: Vec::new(),
    }
}

/// Tiles of all views, each damaged by a line of its own.
fn guesses(photos: &[Camera], shape: Shape, kind: DepthValues, shifts: f64) -> Vec<Guess> {
    let tiles = photos.iter().flat_map(|p| tiles_of(p, shape, None));
    let line = |i: usize| Line {
        scale: 0.4 + 0.23 * ((i * 7 + 3) % 5) as f64,
        shift: shifts * (((i * 5 + 1) % 4) as f64 - 1.5),
    };
    tiles
        .enumerate()
        .map(|(i, t)| damaged(t, kind, line(i)))
        .collect()
}

/// Median and greatest error of the recovered distances, as shares.
fn errors(guesses: &[Guess], lines: &[Line]) -> [f32; 2] {
    let mut all = Vec::new();
    for (guess, line) in guesses.iter().zip(lines) {
        let [w, h] = guess.tile.size;
        for i in (0..w * h).step_by(7) {
            let pixel = Vec2::new((i % w) as f32 + 0.5, (i / w) as f32 + 0.5);
            let direction = guess.tile.direction(pixel).expect("seen");
            let truth = wall(guess.tile.photo.position, direction);
            let found = guess.distance(pixel, *line).unwrap_or(0.0);
            all.push((found / truth - 1.0).abs());
        }
    }
    all.sort_by(f32::total_cmp);
    [all[all.len() / 2], all[all.len() - 1]]
}

#[test]
fn scales_of_panoramas_come_from_the_distance_between_them() {
    let guesses = guesses(&places(), shape(128, 64), DepthValues::Ray, 0.0);
    let found = fit(&guesses, DepthFit::Scale).expect("overlaps");
    let [median, most] = errors(&guesses, &found.lines);
    assert!(median < 0.01 && most < 0.02, "{median} {most}");
    assert!(found.error < 0.02 && found.unfounded == 0, "{found:?}");
}

#[test]
fn shifts_are_found_with_the_scales() {
    let guesses = guesses(&places(), shape(128, 64), DepthValues::Ray, 0.3);
    let found = fit(&guesses, DepthFit::Affine).expect("overlaps");
    let [median, most] = errors(&guesses, &found.lines);
    assert!(median < 0.015 && most < 0.06, "{median} {most}");
    // a scale alone cannot undo a shift
    let stiff = fit(&guesses, DepthFit::Scale).expect("overlaps");
    assert!(errors(&guesses, &stiff.lines)[0] > 2.0 * median);
}

#[test]
fn a_far_sphere_is_no_agreement() {
    // a constant added to all depths lets a large scale make them alike: (d + 1.2) in units of 6 m or 4.2 m
    let tiles = places()
        .into_iter()
        .flat_map(|p| tiles_of(&p, shape(128, 64), None));
    let line = |i: usize| Line {
        scale: if i < 4 { 8.6 } else { 6.0 },
        shift: -1.2,
    };
    let guesses: Vec<Guess> = (tiles.enumerate())
        .map(|(i, t)| damaged(t, DepthValues::Ray, line(i)))
        .collect();
    let found = fit(&guesses, DepthFit::Affine).expect("overlaps");
    let [median, most] = errors(&guesses, &found.lines);
    assert!(median < 0.015 && most < 0.06, "{median} {most}");
}

#[test]
fn inverse_depth_of_perspective_tiles_is_brought_to_metres() {
    let guesses = guesses(&places(), shape(48, 48), DepthValues::InverseZ, 0.05);
    let found = fit(&guesses, DepthFit::Affine).expect("overlaps");
    let [median, most] = errors(&guesses, &found.lines);
    assert!(median < 0.02 && most < 0.15, "{median} {most}");
}

#[test]
fn a_liar_among_the_tiles_does_not_move_the_others() {
    let mut guesses = guesses(&places(), shape(128, 64), DepthValues::Ray, 0.0);
    // a wall that hangs in the room in a quarter of the first panorama's columns
    let width = guesses[0].values.width;
    let hung = |(i, v): (usize, &mut f32)| *v *= if i % width < width / 4 { 0.4 } else { 1.0 };
    guesses[0].values.data.iter_mut().enumerate().for_each(hung);
    let found = fit(&guesses, DepthFit::Scale).expect("overlaps");
    let [median, most] = errors(&guesses[1..], &found.lines[1..]);
    assert!(median < 0.015 && most < 0.03, "{median} {most}");
}

#[test]
fn one_photograph_has_no_scale_but_by_points() {
    let photo = Camera {
        projection: Projection::Pinhole(Lens::centred(96, 64, 70.0)),
        width: 96,
        height: 64,
        world_from_camera: Mat3::IDENTITY,
        position: Vec3::new(2.0, 1.3, 3.5),
    };
    let mut guesses = guesses(&[photo], shape(96, 64), DepthValues::InverseZ, 0.05);
    assert!(fit(&guesses, DepthFit::Affine).is_none());
    let tile = guesses[0].tile;
    guesses[0].anchors = (0..30)
        .map(|i| {
            let pixel = Vec2::new(3.0 * i as f32 + 2.0, (i * 17 % 60) as f32 + 2.0);
            let distance = wall(photo.position, tile.direction(pixel).expect("seen"));
            // one in ten is wrong
            let distance = if i % 10 == 0 {
                3.0 * distance
            } else {
                distance
            };
            Anchor { pixel, distance }
        })
        .collect();
    let found = fit(&guesses, DepthFit::Affine).expect("points");
    let [median, most] = errors(&guesses, &found.lines);
    assert!(median < 0.01 && most < 0.05, "{median} {most}");
    assert_eq!(found.unfounded, 0);
}
