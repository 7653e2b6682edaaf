//! nerfstudio's `applied_transform` and `applied_scale`, undone.
//!
//! nerfstudio turns the poses of a reconstruction into its own world (x' = s · T x) and writes T and
//! s down. A mesh usually is in the coordinates of the reconstruction: the poses are brought back to
//! them. Whoever turned the mesh alike removes the keys.

use super::rigid::rigid;
use glam::{DMat3, DVec3};
use serde_json::{Map, Value};

/// The change of world that the poses of a file went through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AppliedChange {
    rotation: DMat3,
    translation: DVec3,
    scale: f64,
}

impl Default for AppliedChange {
    fn default() -> Self {
        Self {
            rotation: DMat3::IDENTITY,
            translation: DVec3::ZERO,
            scale: 1.0,
        }
    }
}

impl AppliedChange {
    /// Reads both keys of a `transforms.json`; the identity where they are absent.
    ///
    /// # Errors
    /// A key is no rigid transform or no positive number; the message says what was expected.
    pub fn read(root: &Map<String, Value>) -> Result<Self, String> {
        let mut change = Self::default();
        if let Some(value) = root.get("applied_scale").filter(|v| !v.is_null()) {
            change.scale = value
                .as_f64()
                .filter(|s| s.is_finite() && *s > 0.0)
                .ok_or("applied_scale: expected a positive number")?;
        }
        if let Some(value) = root.get("applied_transform").filter(|v| !v.is_null()) {
            let rows = matrix(value)
                .ok_or("applied_transform: expected 3 or 4 rows of 4 finite numbers")?;
            let column = |j: usize| DVec3::new(rows[0][j], rows[1][j], rows[2][j]);
            change.rotation = rigid(DMat3::from_cols(column(0), column(1), column(2)))
                .map_err(|e| format!("applied_transform: {e}"))?;
            change.translation = column(3);
        }
        Ok(change)
    }

    /// A camera's rotation and position as they were before the change.
    #[must_use]
    pub fn undone(&self, rotation: DMat3, position: DVec3) -> (DMat3, DVec3) {
        if *self == Self::default() {
            return (rotation, position);
        }
        let back = self.rotation.transpose();
        (
            back * rotation,
            back * (position / self.scale - self.translation),
        )
    }

    /// What the user should know, if anything was undone.
    #[must_use]
    pub fn note(&self) -> Option<String> {
        (*self != Self::default()).then(|| {
            "applied_transform and applied_scale are undone on the poses: the mesh is taken to be in the coordinates from before them. \
             Remove the keys if the mesh was transformed like the poses"
                .into()
        })
    }
}

fn matrix(value: &Value) -> Option<Vec<[f64; 4]>> {
    let rows = value.as_array().filter(|r| r.len() == 3 || r.len() == 4)?;
    let row = |r: &Value| -> Option<[f64; 4]> {
        let numbers: Vec<f64> = r.as_array()?.iter().filter_map(Value::as_f64).collect();
        let row: [f64; 4] = numbers.try_into().ok()?;
        row.iter().all(|x| x.is_finite()).then_some(row)
    };
    rows.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(value: &Value) -> Result<AppliedChange, String> {
        AppliedChange::read(value.as_object().expect("object"))
    }

    #[test]
    fn what_was_applied_is_undone() {
        let value = json!({"applied_transform": [[0, 1, 0, 5], [1, 0, 0, 6], [0, 0, -1, 7]], "applied_scale": 0.5});
        let change = read(&value).expect("rigid");
        let (rotation, position) = (
            DMat3::from_rotation_y(0.3) * DMat3::from_rotation_x(1.0),
            DVec3::new(1.0, -2.0, 3.0),
        );
        let turned = change.rotation * rotation;
        let moved = 0.5 * (change.rotation * position + change.translation);
        let (r, p) = change.undone(turned, moved);
        assert!((p - position).length() < 1e-12 && r.abs_diff_eq(rotation, 1e-12));
        assert!(change.note().is_some());
    }

    #[test]
    fn nothing_applied_changes_no_bit_and_nonsense_is_refused() {
        let change = read(&json!({"applied_transform": null})).expect("absent");
        let (r, p) = (DMat3::from_rotation_y(0.123), DVec3::new(0.1, 0.2, 0.3));
        assert_eq!(change.undone(r, p), (r, p));
        assert!(change.note().is_none());
        for bad in [
            json!({"applied_scale": 0}),
            json!({"applied_scale": "1"}),
            json!({"applied_transform": [[1, 0, 0]]}),
            json!({"applied_transform": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}),
            json!({"applied_transform": [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}),
        ] {
            let e = read(&bad).expect_err("refused");
            assert!(e.starts_with("applied_"), "{e}");
        }
    }
}
