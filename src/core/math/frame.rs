//! An orthonormal frame around a normal.

use glam::Vec3;

/// Orthonormal frame whose third axis is a given unit normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// First tangent.
    pub t: Vec3,
    /// Second tangent.
    pub b: Vec3,
    /// Normal.
    pub n: Vec3,
}

impl Frame {
    /// Builds a frame from a unit normal without branches on its direction
    /// (Duff et al. 2017, "Building an Orthonormal Basis, Revisited", JCGT 6(1)).
    #[must_use]
    pub fn from_normal(n: Vec3) -> Self {
        let sign = 1.0f32.copysign(n.z);
        let a = -1.0 / (sign + n.z);
        let b = n.x * n.y * a;
        Self {
            t: Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
            b: Vec3::new(b, sign + n.y * n.y * a, -n.y),
            n,
        }
    }

    /// World direction of a direction given in this frame.
    #[must_use]
    pub fn world_from_local(&self, d: Vec3) -> Vec3 {
        self.t * d.x + self.b * d.y + self.n * d.z
    }

    /// Direction in this frame of a world direction.
    #[must_use]
    pub fn local_from_world(&self, d: Vec3) -> Vec3 {
        Vec3::new(d.dot(self.t), d.dot(self.b), d.dot(self.n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_orthonormal_for_normals_all_round() {
        for i in 0..1000u32 {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / 1000.0;
            let phi = i as f32 * 2.399_963;
            let s = (1.0 - z * z).sqrt();
            for n in [
                Vec3::new(s * phi.cos(), s * phi.sin(), z).normalize(),
                Vec3::NEG_Z,
                Vec3::Z,
            ] {
                let f = Frame::from_normal(n);
                assert!(
                    f.t.dot(f.b).abs() < 1e-5
                        && f.t.dot(f.n).abs() < 1e-5
                        && f.b.dot(f.n).abs() < 1e-5
                );
                assert!((f.t.length() - 1.0).abs() < 1e-5 && (f.b.length() - 1.0).abs() < 1e-5);
                assert!((f.t.cross(f.b) - f.n).length() < 1e-5, "right-handed");
                let d = Vec3::new(0.3, -0.2, 0.9);
                assert!((f.local_from_world(f.world_from_local(d)) - d).length() < 1e-5);
            }
        }
    }
}
