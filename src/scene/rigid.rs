//! Matrices that should be rotations: rounding is mended, anything else refused with its reason.

use glam::{DMat3, DVec3};

/// Deviation from a rigid rotation that is taken for rounding and mended.
const RIGID_TOLERANCE: f64 = 1e-3;

/// The exact rotation next to `m`, or why `m` is none.
pub(crate) fn rigid(m: DMat3) -> Result<DMat3, String> {
    let det = m.determinant();
    if det.abs() <= 1e-12 || !det.is_finite() {
        return Err(format!(
            "the pose is singular (determinant {det:.3e}); expected a rotation with determinant 1. Export the cameras again"
        ));
    }
    if det < 0.0 {
        return Err(format!(
            "the pose is mirrored (determinant {det:.4}); expected +1. OpenGL axes are x right, y up, -z forward: negate one column twice or none"
        ));
    }
    let gram = m.transpose() * m;
    let scale = (gram.x_axis.x + gram.y_axis.y + gram.z_axis.z) / 3.0;
    let off = |s: f64| {
        let d = gram - DMat3::from_diagonal(DVec3::splat(s));
        d.to_cols_array()
            .into_iter()
            .fold(0.0f64, |a, x| a.max(x.abs()))
    };
    if off(1.0) <= 2.0 * RIGID_TOLERANCE && (det - 1.0).abs() <= RIGID_TOLERANCE {
        // Gram-Schmidt removes what rounding in the file left
        let x = m.x_axis.normalize();
        let y = (m.y_axis - x * x.dot(m.y_axis)).normalize();
        return Ok(DMat3::from_cols(x, y, x.cross(y)));
    }
    if off(scale) <= 2.0 * RIGID_TOLERANCE * scale {
        let s = scale.sqrt();
        return Err(format!(
            "the rotation is scaled by {s:.6} (determinant {det:.6}, expected 1); divide its upper left 3x3 block by {s:.6}, and bring mesh and positions to metres"
        ));
    }
    Err(format!(
        "the pose is not rigid (determinant {det:.6}, columns not orthonormal to 1e-3); remove shear and scale from the camera"
    ))
}
