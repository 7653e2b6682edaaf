//! Cameras to render from: those of a file or a scene, and smooth paths through them.
//!
//! A path interpolates positions by a Catmull-Rom spline with centripetal knots (Yuksel et al.
//! 2011: no loops, no overshoot at unevenly spaced cameras), evaluated by Barry and Goldman's
//! pyramid of linear interpolations; with spherical interpolation in the same pyramid, orientations
//! follow a curve that is as smooth. Frames lie at even distances along the path.

use crate::core::geometry::{Camera, Lens, Projection};
use crate::error::{Error, Result};
use crate::scene::transforms::parse_transforms;
use crate::scene::{Scene, Split, View};
use glam::{DVec3, Mat3, Quat, Vec3};
use serde_json::Value;
use std::path::Path;

/// A camera and the name of what is written for it.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// File stem.
    pub name: String,
    /// Pose and projection.
    pub camera: Camera,
}

/// The cameras of a file.
pub struct FileCameras {
    /// Cameras in file order.
    pub cameras: Vec<NamedCamera>,
}

/// Reads cameras from a file in the form of `transforms.json` (images need not exist; `w` and `h`
/// must be stated, or `size` is used). Positions become relative to `origin`.
///
/// # Errors
/// Everything that is wrong with the file, at once.
pub fn read_cameras(path: &Path, origin: DVec3, size: Option<[usize; 2]>) -> Result<FileCameras> {
    let text = std::fs::read_to_string(path).map_err(|e| {
        Error::input(
            path,
            format!("cannot be read ({e}); give --cameras a file like a scene's transforms.json"),
        )
    })?;
    let mut root: Value = serde_json::from_str(&text).map_err(|e| {
        Error::input(
            path,
            format!(
                "line {}, column {}: not valid JSON ({e})",
                e.line(),
                e.column()
            ),
        )
    })?;
    // a list of cameras needs no mesh and no images
    if let Some(map) = root.as_object_mut() {
        map.entry("mesh_path").or_insert_with(|| "-".into());
        for key in ["classes", "train_filenames", "test_filenames"] {
            map.remove(key);
        }
        let frames = map.get_mut("frames").and_then(Value::as_array_mut);
        for (i, frame) in frames.into_iter().flatten().enumerate() {
            if let Some(frame) = frame.as_object_mut() {
                frame
                    .entry("file_path")
                    .or_insert_with(|| format!("{i:04}").into());
            }
        }
    }
    let issues = |list: Vec<String>| {
        Error::Inputs(list.into_iter().map(|m| Error::input(path, m)).collect())
    };
    let transforms = parse_transforms(&root.to_string()).map_err(issues)?;
    let mut cameras: Vec<NamedCamera> = Vec::new();
    let mut missing = Vec::new();
    for f in &transforms.frames {
        let Some([width, height]) = f.size.or(size) else {
            missing.push(format!(
                "frames[{}] ({}).w, .h: missing; state the image size or pass --width",
                f.index, f.file_path
            ));
            continue;
        };
        let projection = f.model.projection(width, height);
        let stem = Path::new(&f.file_path)
            .file_stem()
            .map_or_else(|| f.index.to_string(), |s| s.to_string_lossy().into_owned());
        let name = if cameras.iter().any(|c| c.name == stem) {
            format!("{stem}_{}", f.index)
        } else {
            stem
        };
        let position = (f.position - origin).as_vec3();
        let camera = Camera {
            projection,
            width,
            height,
            world_from_camera: f.rotation.as_mat3(),
            position,
        };
        cameras.push(NamedCamera { name, camera });
    }
    if missing.is_empty() {
        Ok(FileCameras { cameras })
    } else {
        Err(issues(missing))
    }
}

/// The cameras of a scene's views, relative to `origin` (a solution's).
#[must_use]
pub fn cameras_of_scene(scene: &Scene, split: Option<Split>, origin: DVec3) -> Vec<NamedCamera> {
    let shift = (scene.origin - origin).as_vec3();
    let named = |v: &View| NamedCamera {
        name: v.stem.clone(),
        camera: Camera {
            position: v.camera.position + shift,
            ..v.camera
        },
    };
    scene
        .views
        .iter()
        .filter(|v| split.is_none_or(|s| v.split == s))
        .map(named)
        .collect()
}

impl NamedCamera {
    /// The camera at another image width, same aspect.
    #[must_use]
    pub fn with_width(&self, width: usize) -> Self {
        let height = (self.camera.height * width)
            .div_ceil(self.camera.width.max(1))
            .max(1);
        Self {
            name: self.name.clone(),
            camera: self.camera.resized(width, height),
        }
    }

    /// A pinhole camera of `width` × `height` with the given horizontal angle of view that looks
    /// where this one does.
    #[must_use]
    pub fn pinhole(&self, width: usize, height: usize, degrees: f32) -> Self {
        let lens = Lens::centred(width, height, degrees.clamp(1.0, 170.0));
        let camera = Camera {
            projection: Projection::Pinhole(lens),
            width,
            height,
            ..self.camera
        };
        Self {
            name: self.name.clone(),
            camera,
        }
    }
}

/// Pose of a camera.
#[derive(Clone, Copy)]
struct Pose {
    position: Vec3,
    rotation: Quat,
}

impl Pose {
    fn of(c: &Camera) -> Self {
        Self {
            position: c.position,
            rotation: Quat::from_mat3(&c.world_from_camera).normalize(),
        }
    }

    fn toward(self, other: Self, t: f32) -> Self {
        Self {
            position: self.position.lerp(other.position, t),
            rotation: slerp(self.rotation, other.rotation, t),
        }
    }

    /// Metres and radians together: what counts as movement.
    fn distance(self, other: Self) -> f32 {
        (self.position - other.position).length()
            + 0.5 * self.rotation.angle_between(other.rotation)
    }
}

/// Spherical interpolation that also extrapolates.
fn slerp(a: Quat, b: Quat, t: f32) -> Quat {
    let b = if a.dot(b) < 0.0 { -b } else { b };
    let relative = (a.inverse() * b).normalize();
    let v = relative.xyz();
    let angle = 2.0 * v.length().atan2(relative.w);
    (a * Quat::from_axis_angle(v.normalize_or(Vec3::Y), angle * t)).normalize()
}

/// Samples per segment of the table that turns distance into the spline's parameter.
const STEPS: usize = 48;

/// `frames` cameras at even distances along a smooth path through `through`, with the projection of
/// the first; at least one.
#[must_use]
pub fn smooth_path(through: &[NamedCamera], frames: usize) -> Vec<NamedCamera> {
    let Some(first) = through.first() else {
        return Vec::new();
    };
    let poses: Vec<Pose> = through.iter().map(|c| Pose::of(&c.camera)).collect();
    let mut knots = vec![0.0f32];
    for pair in poses.windows(2) {
        let last = knots[knots.len() - 1];
        knots.push(last + pair[0].distance(pair[1]).max(1e-4).sqrt());
    }
    let mut table = vec![(0.0f32, 0usize, 0.0f32)];
    let mut before = poses[0];
    for segment in 0..poses.len() - 1 {
        for k in 1..=STEPS {
            let t = k as f32 / STEPS as f32;
            let here = on_spline(&poses, &knots, segment, t);
            let length = table[table.len() - 1].0 + before.distance(here);
            table.push((length, segment, t));
            before = here;
        }
    }
    let total = table[table.len() - 1].0;
    let frames = frames.max(1);
    (0..frames)
        .map(|i| {
            let wanted = total * i as f32 / (frames - 1).max(1) as f32;
            let k = table.partition_point(|e| e.0 < wanted).min(table.len() - 1);
            let pose = if k == 0 {
                poses[0]
            } else {
                let (a, b) = (table[k - 1], table[k]);
                let share = ((wanted - a.0) / (b.0 - a.0).max(1e-12)).clamp(0.0, 1.0);
                // the entry before may be the end of the previous segment
                let start = if a.1 == b.1 { a.2 } else { 0.0 };
                on_spline(&poses, &knots, b.1, start + (b.2 - start) * share)
            };
            let world_from_camera = Mat3::from_quat(pose.rotation);
            let camera = Camera {
                position: pose.position,
                world_from_camera,
                ..first.camera
            };
            NamedCamera {
                name: format!("{i:04}"),
                camera,
            }
        })
        .collect()
}

/// The pose at `t` in [0, 1] of a segment.
fn on_spline(poses: &[Pose], knots: &[f32], segment: usize, t: f32) -> Pose {
    let (p1, p2) = (poses[segment], poses[segment + 1]);
    let (k1, k2) = (knots[segment], knots[segment + 1]);
    let mirrored = |a: Pose, b: Pose| b.toward(a, 2.0);
    // beyond the ends the path goes on as it came
    let (p0, k0) = if segment > 0 {
        (poses[segment - 1], knots[segment - 1])
    } else {
        (mirrored(p1, p2), 2.0 * k1 - k2)
    };
    let (p3, k3) = match poses.get(segment + 2) {
        Some(p) => (*p, knots[segment + 2]),
        None => (mirrored(p2, p1), 2.0 * k2 - k1),
    };
    let k = k1 + (k2 - k1) * t;
    let between = |a: Pose, ka: f32, b: Pose, kb: f32| a.toward(b, (k - ka) / (kb - ka));
    let (a1, a2, a3) = (
        between(p0, k0, p1, k1),
        between(p1, k1, p2, k2),
        between(p2, k2, p3, k3),
    );
    let (b1, b2) = (between(a1, k0, a2, k2), between(a2, k1, a3, k3));
    between(b1, k1, b2, k2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(x: f32, y: f32, yaw: f32) -> NamedCamera {
        let camera = Camera {
            projection: Projection::Equirectangular,
            width: 8,
            height: 4,
            world_from_camera: Mat3::from_rotation_y(yaw),
            position: Vec3::new(x, y, 0.0),
        };
        NamedCamera {
            name: String::new(),
            camera,
        }
    }

    #[test]
    fn a_path_meets_its_cameras_smoothly() {
        let keys = [
            key(0.0, 0.0, 0.0),
            key(1.0, 0.5, 0.4),
            key(3.0, 0.0, 1.2),
            key(3.5, -1.0, 0.9),
        ];
        let path = smooth_path(&keys, 400);
        assert_eq!(path.len(), 400);
        for k in &keys {
            let near = path
                .iter()
                .map(|c| (c.camera.position - k.camera.position).length())
                .fold(f32::INFINITY, f32::min);
            assert!(near < 0.01, "{near}");
        }
        let first = &path[0].camera;
        assert!((first.position - keys[0].camera.position).length() < 1e-5);
        let last = &path[399].camera;
        assert!((last.position - keys[3].camera.position).length() < 1e-3);
        assert!(
            (last.world_from_camera.x_axis - keys[3].camera.world_from_camera.x_axis).length()
                < 1e-2
        );
        // even steps without a kink: the second difference is small against the first
        let steps: Vec<f32> = path
            .windows(2)
            .map(|w| Pose::of(&w[0].camera).distance(Pose::of(&w[1].camera)))
            .collect();
        let mean = steps.iter().sum::<f32>() / steps.len() as f32;
        assert!(
            steps.iter().all(|s| (s / mean - 1.0).abs() < 0.1),
            "uneven: {steps:?}"
        );
        for w in path.windows(3) {
            let bend = w[2].camera.position - 2.0 * w[1].camera.position + w[0].camera.position;
            assert!(bend.length() < 0.2 * mean, "{bend}");
        }
    }

    #[test]
    fn one_camera_or_coincident_cameras_make_a_still() {
        let still = smooth_path(&[key(1.0, 2.0, 0.3)], 5);
        assert_eq!(still.len(), 5);
        assert!(
            still
                .iter()
                .all(|c| c.camera.position == Vec3::new(1.0, 2.0, 0.0))
        );
        let same = smooth_path(&[key(1.0, 2.0, 0.3), key(1.0, 2.0, 0.3)], 3);
        assert!(
            same.iter()
                .all(|c| c.camera.position.is_finite() && c.camera.world_from_camera.is_finite())
        );
        assert!(smooth_path(&[], 3).is_empty());
    }

    #[test]
    fn a_camera_file_needs_no_mesh_and_no_images() {
        let folder = tempfile::tempdir().expect("temp");
        let path = folder.path().join("cameras.json");
        let pose = "[[1,0,0,5],[0,1,0,2],[0,0,1,3],[0,0,0,1]]";
        std::fs::write(
            &path,
            format!(r#"{{"camera_model":"PINHOLE","fl_x":100,"w":64,"h":48,"frames":[{{"transform_matrix":{pose}}}]}}"#),
        )
        .expect("writes");
        let cameras = read_cameras(&path, DVec3::new(5.0, 0.0, 0.0), None)
            .expect("reads")
            .cameras;
        assert_eq!(
            (cameras[0].name.as_str(), cameras[0].camera.width),
            ("0000", 64)
        );
        assert_eq!(cameras[0].camera.position, Vec3::new(0.0, 2.0, 3.0));
        let wide = cameras[0].pinhole(100, 50, 90.0);
        let Projection::Pinhole(lens) = wide.camera.projection else {
            panic!("pinhole")
        };
        assert!((lens.fl_x - 50.0).abs() < 1e-3);

        std::fs::write(
            &path,
            format!(
                r#"{{"camera_model":"EQUIRECTANGULAR","frames":[{{"transform_matrix":{pose}}}]}}"#
            ),
        )
        .expect("writes");
        let e = read_cameras(&path, DVec3::ZERO, None)
            .err()
            .expect("no size")
            .to_string();
        assert!(e.contains("cameras.json") && e.contains("--width"), "{e}");
        std::fs::write(&path, "{").expect("writes");
        assert_eq!(
            read_cameras(&path, DVec3::ZERO, None)
                .err()
                .expect("broken")
                .exit_code(),
            2
        );
    }
}
