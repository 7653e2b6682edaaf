//! Which way is up, for sources that leave it open (COLMAP): people hold cameras upright, so the
//! mean of the photographs' up axes points up. An axis of the world near it is taken as it is, so
//! that a world somebody aligned keeps its coordinates.

use super::account::Account;
use super::capture::{Capture, Surface, Up};
use super::importer::PrepareOptions;
use glam::{DMat3, DMat4, DVec2, DVec3};

/// An axis of the world this near to the mean is meant (derived: the mean of n cameras tilted by
/// 15° at random is off by 15°/√n).
const NEAR_AXIS_DEGREES: f64 = 5.0;
/// Below this length of the mean, the cameras agree on no direction.
const AGREEMENT: f64 = 0.3;

/// Turns a capture of unknown orientation so that y (or z, as it lies) points up.
pub fn orient(capture: &mut Capture, options: &PrepareOptions, account: &mut Account) {
    if capture.unit_unknown && options.scale.is_none() {
        account.converted(
            "the unit of this source is arbitrary and taken for a metre: measure a length and give --scale",
        );
    }
    match options.up.as_deref() {
        Some("z") => capture.up = Up::Z,
        Some(_) => capture.up = Up::Y,
        None => {}
    }
    if capture.up != Up::Unknown {
        return;
    }
    capture.up = Up::Y;
    let ups = capture
        .shots
        .iter()
        .map(|s| s.world_from_camera.y_axis.truncate());
    let mean = ups.sum::<DVec3>() / capture.shots.len().max(1) as f64;
    if mean.length() < AGREEMENT {
        account.converted(
            "the photographs do not tell which way is up: y is taken (--up z or y says so)",
        );
        return;
    }
    let axes = [
        DVec3::Y,
        DVec3::Z,
        DVec3::NEG_Y,
        DVec3::NEG_Z,
        DVec3::X,
        DVec3::NEG_X,
    ];
    let near = axes
        .into_iter()
        .find(|a| a.angle_between(mean) < NEAR_AXIS_DEGREES.to_radians());
    let turn = match near {
        Some(DVec3::Y) => return,
        Some(DVec3::Z) => {
            capture.up = Up::Z;
            return;
        }
        Some(axis) => exact_turn(axis),
        None => DMat3::from_quat(glam::DQuat::from_rotation_arc(mean.normalize(), DVec3::Y)),
    };
    turn_world(capture, turn);
    let rows = turn.transpose().to_cols_array_2d();
    account.converted(format!(
        "the world was turned so that the photographs' mean up is +y: rows {rows:?} (--up y or z keeps it)"
    ));
}

/// The turn by a multiple of 90° that brings an axis to +y.
fn exact_turn(axis: DVec3) -> DMat3 {
    // rows of the turn: the new x, y, z in old coordinates
    let x = if axis.x == 0.0 { DVec3::X } else { DVec3::Z };
    DMat3::from_cols(x, axis, x.cross(axis)).transpose()
}

fn turn_world(capture: &mut Capture, turn: DMat3) {
    let turn4 = DMat4::from_mat3(turn);
    for shot in &mut capture.shots {
        shot.world_from_camera = turn4 * shot.world_from_camera;
    }
    match &mut capture.surface {
        Some(Surface::File {
            world_from_file, ..
        }) => *world_from_file = turn4 * *world_from_file,
        Some(Surface::Built(m)) => {
            m.mesh.positions.iter_mut().for_each(|p| *p = turn * *p);
            let turn = turn.as_mat3();
            m.mesh.normals.iter_mut().for_each(|n| *n = turn * *n);
        }
        None => {}
    }
    // plans are in x and z: only a half turn about x keeps them plans
    let half_turn = turn == DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    match (&mut capture.room_grid, half_turn) {
        (Some(grid), true) => {
            let rows = grid.cells.height;
            let width = grid.cells.width.max(1);
            let mut data = Vec::with_capacity(grid.cells.data.len());
            for row in grid.cells.data.chunks(width).rev() {
                data.extend_from_slice(row);
            }
            grid.cells.data = data;
            grid.min.y = -(grid.min.y + rows as f64 * grid.cell);
        }
        (grid, _) => *grid = None,
    }
    match half_turn {
        true => {
            for corner in capture.rooms.iter_mut().flat_map(|r| &mut r.corners) {
                *corner = DVec2::new(corner.x, -corner.y);
            }
        }
        false => capture.rooms.clear(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::capture::Shot;
    use super::super::lens::Optics;
    use super::*;
    use std::path::PathBuf;

    fn capture(ups: &[DVec3]) -> Capture {
        let shot = |up: &DVec3| {
            let up = up.normalize();
            let x = up.any_orthonormal_vector();
            let pose = DMat3::from_cols(x, up, x.cross(up));
            Shot::new(
                "a",
                PathBuf::new(),
                DMat4::from_mat3(pose),
                Optics::Panorama,
            )
        };
        Capture {
            shots: ups.iter().map(shot).collect(),
            up: Up::Unknown,
            ..Capture::default()
        }
    }

    fn oriented(mut c: Capture, up: Option<&str>) -> (Capture, Account) {
        let options = PrepareOptions {
            up: up.map(Into::into),
            ..PrepareOptions::default()
        };
        let mut account = Account::default();
        orient(&mut c, &options, &mut account);
        (c, account)
    }

    #[test]
    fn aligned_worlds_keep_their_coordinates_and_others_are_turned() {
        let a_little_off = |axis: DVec3| axis + 0.03 * axis.any_orthonormal_vector();
        for (axis, up) in [(DVec3::Y, Up::Y), (DVec3::Z, Up::Z)] {
            let before = capture(&[a_little_off(axis)]);
            let (after, _) = oriented(before.clone(), None);
            assert_eq!((after.up, &after.shots), (up, &before.shots));
        }
        for axis in [DVec3::NEG_Y, DVec3::X, DVec3::NEG_Z, DVec3::NEG_X] {
            let (after, account) = oriented(capture(&[axis]), None);
            let m = after.shots[0].world_from_camera;
            assert_eq!(m.y_axis.truncate(), DVec3::Y, "{axis}");
            assert!((m.determinant() - 1.0).abs() < 1e-12);
            assert_eq!(account.converted.len(), 1);
        }
        let tilted = DVec3::new(0.5, -1.0, 0.4);
        let (after, _) = oriented(capture(&[tilted, tilted]), None);
        let up = after.shots[0].world_from_camera.y_axis.truncate();
        assert!((up - DVec3::Y).length() < 1e-12);
        let (kept, _) = oriented(capture(&[tilted]), Some("y"));
        assert_eq!(kept.shots, capture(&[tilted]).shots);
        let (_, account) = oriented(capture(&[DVec3::X, DVec3::NEG_X]), None);
        assert!(account.converted[0].contains("do not tell"));
    }
}
