//! `unbake prepare rooms SCENE`: the rooms of a scene folder as a grid of ids (an occupancy grid,
//! `scene::rooms`) and as a picture, beside the scene.
//!
//! The grid is in the form that `rooms_path` names; it counts once transforms.json names it, and a
//! grid named there already is somebody's own and stays. Called by `cli`.

use super::importer::Prepared;
use crate::core::formats;
use crate::core::progress::Progress;
use crate::core::trace::EmbreeTracer;
use crate::error::{Error, Result};
use crate::scene::{LoadOptions, RoomGrid, Scene, floor_plan};
use serde_json::json;
use std::path::Path;

/// Its name on the command line.
pub const ROOMS: &str = "rooms";
const GRID: &str = "rooms.png";
const PICTURE: &str = "rooms_plan.png";
/// Sides of the pixels that a cell and a camera take in the picture.
const PIXELS_PER_CELL: usize = 4;
const CAMERA: usize = 3;
/// Golden angle over a full turn: neighbouring ids get hues far apart.
const HUE_STEP: f32 = 0.381_966;

/// Finds the rooms of the scene at `path` and writes grid, its description and the picture into
/// `out`.
///
/// # Errors
/// If the scene cannot be read, names a grid already, or writing fails.
pub fn write_floor_plan(path: &Path, out: &Path, progress: &Progress) -> Result<Prepared> {
    let scene = Scene::load(path, &LoadOptions::default())?;
    if scene.rooms.is_some() {
        return Err(Error::input(
            path,
            "transforms.json names a grid of rooms (rooms_path), which counts; remove the key to have rooms found",
        ));
    }
    let grid = progress.stage("finding rooms", 1, |_| -> Result<RoomGrid> {
        Ok(floor_plan(&scene, &EmbreeTracer::new(&scene.mesh)?))
    })?;
    let out = match out.is_file() {
        // the scene may be named by its transforms.json
        true => out.parent().unwrap_or(Path::new(".")),
        false => out,
    };
    std::fs::create_dir_all(out).map_err(|source| Error::Io {
        path: out.into(),
        source,
    })?;
    formats::write_png16(out.join(GRID), &grid.cells)?;
    let (width, height, rgb) = picture(&grid, &scene);
    formats::write_png_rgb8(out.join(PICTURE), width, height, &rgb)?;
    let description = json!({
        "cell": grid.cell,
        "x_min": f64::from(grid.x_min) + scene.origin.x,
        "z_min": f64::from(grid.z_min) + scene.origin.z,
        "found_by": "unbake prepare rooms",
    });
    let text = format!("{description:#}\n");
    formats::atomic_write(out.join("rooms.json"), text.as_bytes())?;
    let area = |id: u16| {
        let cells = grid.cells.data.iter().filter(|&&c| c == id).count();
        cells as f32 * grid.cell * grid.cell
    };
    let areas: Vec<String> = (1..=grid.count())
        .map(|id| format!("{id}: {:.1} m²", area(id)))
        .collect();
    Ok(Prepared {
        kind: ROOMS,
        frames: scene.views.len(),
        triangles: scene.mesh.triangles.len(),
        rooms: usize::from(grid.count()),
        notes: vec![
            format!("rooms with half their walls: {}", areas.join(", ")),
            format!(
                "{GRID} counts once transforms.json says \"rooms_path\": \"{GRID}\"; {PICTURE} shows it with the cameras"
            ),
        ],
    })
}

/// Rooms in colours, cameras in black: width, height, RGB.
fn picture(grid: &RoomGrid, scene: &Scene) -> (usize, usize, Vec<u8>) {
    let (columns, rows) = (grid.cells.width, grid.cells.height);
    let (width, height) = (columns * PIXELS_PER_CELL, rows * PIXELS_PER_CELL);
    let mut rgb = Vec::with_capacity(3 * width * height);
    for y in 0..height {
        for x in 0..width {
            rgb.extend(colour(
                grid.cells[(x / PIXELS_PER_CELL, y / PIXELS_PER_CELL)],
            ));
        }
    }
    for view in &scene.views {
        let at = view.camera.position;
        let pixel = |from_edge: f32| (from_edge / grid.cell * PIXELS_PER_CELL as f32) as usize;
        let (cx, cy) = (pixel(at.x - grid.x_min), pixel(at.z - grid.z_min));
        for y in cy.saturating_sub(CAMERA)..(cy + CAMERA).min(height) {
            for x in cx.saturating_sub(CAMERA)..(cx + CAMERA).min(width) {
                rgb[3 * (y * width + x)..][..3].fill(0);
            }
        }
    }
    (width, height, rgb)
}

/// White for no room, else a light hue of its own.
fn colour(id: u16) -> [u8; 3] {
    if id == 0 {
        return [255; 3];
    }
    let hue = 6.0 * (f32::from(id) * HUE_STEP).fract();
    // a third of a turn apart, as in HSV
    [0.0, 4.0, 2.0].map(|shift| {
        let ramp = ((hue + shift) % 6.0 - 3.0).abs() - 1.0;
        (130.0 + 110.0 * ramp.clamp(0.0, 1.0)) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_rooms_differ_and_no_room_is_white() {
        assert_eq!(colour(0), [255; 3]);
        for id in 1..60 {
            let far = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).any(|(a, b)| a.abs_diff(b) > 40);
            assert!(far(colour(id), colour(id + 1)), "{id}");
            assert!(far(colour(id), colour(0)), "{id}");
        }
    }
}
