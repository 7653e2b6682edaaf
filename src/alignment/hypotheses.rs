//! What is commonly wrong with poses: conventions of axes, units, order of the matrix, mirrored
//! pixels, nerfstudio's transform; and one-parameter families that are searched.

use super::correction::Correction;
use crate::core::geometry::Projection;
use crate::scene::transforms::y_up_from_z_up;
use crate::scene::{Mirror, Scene};
use glam::{DMat3, DVec3};

/// A named correction.
#[derive(Clone, Debug, PartialEq)]
pub struct Hypothesis {
    /// What is wrong, in the words of a user.
    pub name: String,
    /// What it does to the poses.
    pub correction: Correction,
    /// Elementary changes it consists of: the fewer, the likelier. A searched parameter counts
    /// two.
    pub steps: usize,
    /// The name comes from the parameters.
    pub searched: bool,
}

impl Hypothesis {
    /// The poses as they are.
    #[must_use]
    pub fn as_given() -> Self {
        Self {
            name: "as given".into(),
            correction: Correction::default(),
            steps: 0,
            searched: false,
        }
    }

    /// One change.
    #[must_use]
    pub fn one(name: impl Into<String>, correction: Correction) -> Self {
        Self {
            name: name.into(),
            correction,
            steps: 1,
            searched: false,
        }
    }

    /// A change whose parameters were searched, named by them.
    #[must_use]
    pub fn searched(correction: Correction) -> Self {
        Self {
            name: described(&correction),
            correction,
            steps: 2,
            searched: true,
        }
    }

    /// The same mistake with other parameters.
    #[must_use]
    pub fn with(&self, correction: Correction) -> Self {
        if correction == self.correction {
            return self.clone();
        }
        if self.searched || self.steps == 0 {
            return Self::searched(correction);
        }
        Self {
            name: format!("{}, adjusted", self.name),
            correction,
            steps: self.steps + 1,
            searched: false,
        }
    }

    /// This change and `next` after it.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        if self.steps == 0 || next.steps == 0 {
            return if self.steps == 0 { next } else { self }.clone();
        }
        Self {
            name: format!("{}, {}", self.name, next.name),
            correction: self.correction.then(&next.correction),
            steps: self.steps + next.steps,
            searched: false,
        }
    }
}

/// Metres per unit, with the unit's name.
const UNITS: [(f64, &str); 4] = [
    (0.001, "millimetres"),
    (0.01, "centimetres"),
    (0.3048, "feet"),
    (0.0254, "inches"),
];

/// Units in which one of mesh and poses may be, the other in metres.
#[must_use]
pub fn units() -> Vec<Hypothesis> {
    let mut out = Vec::new();
    for (metres, unit) in UNITS {
        let of = |scale| Correction {
            scale,
            ..Correction::default()
        };
        out.push(Hypothesis::one(format!("mesh in {unit}"), of(1.0 / metres)));
        out.push(Hypothesis::one(format!("poses in {unit}"), of(metres)));
    }
    out
}

/// Matrices the wrong way round.
#[must_use]
pub fn inversions() -> Vec<Hypothesis> {
    let invert = Correction {
        invert: true,
        ..Correction::default()
    };
    vec![Hypothesis::one("poses are world-to-camera", invert)]
}

/// "Up" of the poses that is not the mesh's; `z_up`: both were turned from z up on loading.
#[must_use]
pub fn world_axes(z_up: bool) -> Vec<Hypothesis> {
    let of = |turn| Correction {
        turn,
        ..Correction::default()
    };
    vec![
        Hypothesis::one(
            if z_up {
                "up_axis \"z\" holds for the poses, the mesh is y up (as glTF is)"
            } else {
                "poses z up, mesh y up"
            },
            of(y_up_from_z_up()),
        ),
        Hypothesis::one(
            if z_up {
                "up_axis \"z\" holds for the mesh, the poses are y up"
            } else {
                "mesh z up, poses y up"
            },
            of(y_up_from_z_up().transpose()),
        ),
        Hypothesis::one(
            "one of mesh and poses is upside down: y and z turned about (OpenCV's world, y down)",
            of(DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0))),
        ),
    ]
}

/// The other ways in which a right-handed world's axes can be another's, but for turns about the
/// vertical ([`right_angles`]) and those of [`world_axes`].
#[must_use]
pub fn other_axes() -> Vec<Hypothesis> {
    let known: Vec<DMat3> = world_axes(false)
        .iter()
        .chain(&right_angles())
        .map(|h| h.correction.turn)
        .chain([DMat3::IDENTITY])
        .collect();
    axis_turns()
        .into_iter()
        .filter(|turn| !known.iter().any(|k| k.abs_diff_eq(*turn, 1e-9)))
        .map(|turn| {
            let [x, y, z] = [0, 1, 2].map(|k| axis_name(turn.col(k)));
            Hypothesis::one(
                format!("other axes: the poses' x, y, z are the mesh's {x}, {y}, {z}"),
                Correction {
                    turn,
                    ..Correction::default()
                },
            )
        })
        .collect()
}

/// The 24 turns that bring axes onto axes.
fn axis_turns() -> Vec<DMat3> {
    let axes: Vec<DVec3> = DVec3::AXES.into_iter().flat_map(|a| [a, -a]).collect();
    let turn = |x: DVec3, y: DVec3| DMat3::from_cols(x, y, x.cross(y));
    let pairs = axes.iter().flat_map(|x| axes.iter().map(move |y| (*x, *y)));
    pairs
        .filter(|(x, y)| x.dot(*y) == 0.0)
        .map(|(x, y)| turn(x, y))
        .collect()
}

/// "−y" for (0, −1, 0).
fn axis_name(axis: DVec3) -> String {
    let name = ["x", "y", "z"][axis.abs().max_position()];
    let sign = if axis.max_element() > 0.5 { "" } else { "−" };
    format!("{sign}{name}")
}

/// Axes of the camera that are not OpenGL's.
#[must_use]
pub fn camera_axes() -> Vec<Hypothesis> {
    let of = |camera_turn| Correction {
        camera_turn,
        ..Correction::default()
    };
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    vec![
        Hypothesis::one(
            "OpenCV axes (y down, z forward)",
            of(DMat3::from_cols(x, -y, -z)),
        ),
        Hypothesis::one(
            "camera axes z up, y forward",
            of(DMat3::from_cols(x, z, -y)),
        ),
        Hypothesis::one(
            "camera axes z up, x forward (ROS)",
            of(DMat3::from_cols(-y, z, -x)),
        ),
    ]
}

/// Panoramas whose columns start elsewhere; and mirrored pixels and meshes.
#[must_use]
pub fn pictures(panoramas: bool, labelled: bool) -> Vec<Hypothesis> {
    let mut out = Vec::new();
    if panoramas {
        for (degrees, name) in [
            (180.0f64, "panorama's seam in the middle"),
            (90.0, "panorama's columns shifted by a quarter"),
            (-90.0, "panorama's columns shifted by three quarters"),
        ] {
            let camera_turn = DMat3::from_rotation_y(degrees.to_radians());
            out.push(Hypothesis::one(
                name,
                Correction {
                    camera_turn,
                    ..Correction::default()
                },
            ));
        }
    }
    let mirrored = |mirror| Correction {
        mirror,
        ..Correction::default()
    };
    let what = if panoramas {
        "panoramas"
    } else {
        "photographs"
    };
    out.push(Hypothesis::one(
        if labelled {
            format!("{what} and labels mirrored left to right")
        } else {
            format!("{what} mirrored left to right")
        },
        mirrored(Mirror::All),
    ));
    if labelled {
        out.push(Hypothesis::one(
            format!("{what} mirrored left to right, labels not"),
            mirrored(Mirror::Images),
        ));
        out.push(Hypothesis::one(
            format!("{what} upside down, labels not (an EXIF orientation that was not applied?)"),
            mirrored(Mirror::UpsideDown),
        ));
    }
    for (axis, name) in [(DVec3::X, "x"), (DVec3::Z, "z")] {
        let turn = DMat3::from_diagonal(DVec3::ONE - 2.0 * axis);
        out.push(Hypothesis::one(
            format!("mesh mirrored in {name}"),
            Correction {
                turn,
                ..Correction::default()
            },
        ));
    }
    out
}

/// The poses turned about the file's origin by right angles.
#[must_use]
pub fn right_angles() -> Vec<Hypothesis> {
    [90.0, 180.0, 270.0]
        .into_iter()
        .map(|degrees| Hypothesis {
            steps: 1,
            ..yaw(DVec3::ZERO, degrees)
        })
        .collect()
}

/// A turn of all poses about the vertical through `centre`.
#[must_use]
pub fn yaw(centre: DVec3, degrees: f64) -> Hypothesis {
    Hypothesis::searched(Correction::about(centre, DVec3::Y, degrees))
}

/// A turn of every camera about its own vertical.
#[must_use]
pub fn camera_yaw(degrees: f64) -> Hypothesis {
    Hypothesis::searched(Correction {
        camera_turn: DMat3::from_rotation_y(degrees.to_radians()),
        ..Correction::default()
    })
}

/// A scale of the positions about `centre`.
#[must_use]
pub fn scale(centre: DVec3, factor: f64) -> Hypothesis {
    Hypothesis::searched(Correction::scaled(centre, factor))
}

/// A shift of all positions, metres.
#[must_use]
pub fn shift(by: DVec3) -> Hypothesis {
    Hypothesis::searched(Correction {
        shift: by,
        ..Correction::default()
    })
}

/// What is wrong with poses that a turn, scale and shift correct: the inverse of the correction, in
/// words; changes too small to matter are left out.
fn described(c: &Correction) -> String {
    let yaw_of = |m: DMat3| m.x_axis.z.atan2(m.x_axis.x).to_degrees();
    let back = c.turn.transpose();
    let (turn, scale) = (-yaw_of(back), 1.0 / c.scale);
    let shift = -(back * c.shift) * scale;
    let own = -yaw_of(c.camera_turn.transpose());
    let mut parts = Vec::new();
    if own.abs() > 0.5 {
        parts.push(format!(
            "cameras turned by {own:.1}° about their own vertical"
        ));
    }
    if turn.abs() > 0.5 {
        parts.push(format!("poses turned by {turn:.1}° about the vertical"));
    }
    if scale.ln().abs() > 0.005 {
        parts.push(format!("poses scaled by {scale:.3} against the mesh"));
    }
    if shift.length() > 0.02 {
        let [x, y, z] = shift.to_array();
        parts.push(format!("poses shifted by ({x:.2}, {y:.2}, {z:.2}) m"));
    }
    if parts.is_empty() {
        parts.push("poses off by a little".into());
    }
    parts.join(", ")
}

/// Factors of the focal length, and the principal point in the middle, for pinhole cameras.
#[must_use]
pub fn lenses(scene: &Scene) -> Vec<Hypothesis> {
    let pinhole = |v: &crate::scene::View| matches!(v.camera.projection, Projection::Pinhole(_));
    if !scene.views.iter().any(pinhole) {
        return Vec::new();
    }
    let mut out = vec![Hypothesis::one(
        "principal point not in the middle of the image",
        Correction {
            centred: true,
            ..Correction::default()
        },
    )];
    for k in -12..=12 {
        let factor = (f64::from(k) * 0.02).exp() as f32;
        if k != 0 {
            let right = 1.0 / factor;
            out.push(Hypothesis::one(
                format!("focal length {:.0} % of the right one", 100.0 * right),
                Correction {
                    focal_scale: factor,
                    ..Correction::default()
                },
            ));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_turn_of_the_axes_is_tried_once() {
        let turns: Vec<DMat3> = world_axes(false)
            .into_iter()
            .chain(right_angles())
            .chain(other_axes())
            .map(|h| h.correction.turn)
            .collect();
        assert_eq!(turns.len(), 23);
        for (i, a) in turns.iter().enumerate() {
            assert!((a.determinant() - 1.0).abs() < 1e-12);
            let same = turns.iter().filter(|b| b.abs_diff_eq(*a, 1e-9));
            assert_eq!(same.count(), 1, "turn {i}");
        }
        let [first, ..] = &other_axes()[..] else {
            panic!("none");
        };
        assert!(first.name.contains("the mesh's "), "{}", first.name);
    }

    #[test]
    fn names_say_what_was_done_to_the_poses() {
        let turned = Correction::about(DVec3::ZERO, DVec3::Y, -20.0);
        assert_eq!(
            described(&turned),
            "poses turned by 20.0° about the vertical"
        );
        let both = Correction::scaled(DVec3::ZERO, 0.5).then(&Correction {
            shift: DVec3::new(1.0, 0.0, -0.5),
            ..Correction::default()
        });
        assert_eq!(
            described(&both),
            "poses scaled by 2.000 against the mesh, poses shifted by (-2.00, -0.00, 1.00) m"
        );
        let own = camera_yaw(15.0).name;
        assert_eq!(own, "cameras turned by -15.0° about their own vertical");
    }
}
