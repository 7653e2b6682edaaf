//! `unbake bench alignment`: how many generated misalignments of a scene are recognised, and
//! whether the scene as it is passes.

use crate::alignment::{Alignment, AlignmentOptions, align, apply, assess};
use crate::core::sampling::KeyedRng;
use crate::core::switch::Switch;
use crate::core::trace::EmbreeTracer;
use crate::error::Result;
use crate::scene::{LoadOptions, Mirror, Scene};
use crate::verdict::AlignmentVerdict;
use glam::{DMat3, DVec3, Mat3, Quat, Vec3};
use serde::Serialize;
use std::fmt::{Display, Formatter};
use std::path::Path;
use std::time::Instant;

/// What is damaged.
#[derive(clap::Args, Clone, Debug, Default, PartialEq)]
pub struct AlignmentBench {
    /// Only the scene as it is.
    #[arg(long)]
    pub undamaged: bool,
    /// Leave the labels out.
    #[arg(long)]
    pub no_labels: bool,
    /// Only damages whose name contains this.
    #[arg(long, value_name = "TEXT")]
    pub only: Option<String>,
}

/// One way to spoil the poses of a scene or its mesh.
#[derive(Clone, Copy, Debug)]
enum Damage {
    None,
    /// The mesh in another unit (units per metre).
    MeshScale(f64),
    /// Positions scaled about the origin.
    PoseScale(f64),
    /// y down, z forward.
    OpenCv,
    WorldToCamera,
    /// Poses turned to z up, the mesh not.
    ZUp,
    /// All poses turned about the origin's vertical, degrees.
    Yaw(f64),
    /// Every camera about its own vertical, degrees.
    CameraYaw(f64),
    /// All poses shifted along x and z by this much in all, metres.
    Shift(f64),
    Mirror(Mirror),
    MirroredMesh,
    /// Every camera turned and shifted by a random amount of this size, degrees and metres.
    Jitter(f64, f64),
}

/// The fifteen misalignments that count.
const DAMAGES: [(&str, Damage); 15] = [
    ("mesh in millimetres", Damage::MeshScale(1000.0)),
    ("mesh in centimetres", Damage::MeshScale(100.0)),
    ("mesh in feet", Damage::MeshScale(1.0 / 0.3048)),
    ("OpenCV axes", Damage::OpenCv),
    ("world-to-camera", Damage::WorldToCamera),
    ("poses z up", Damage::ZUp),
    ("yaw 20", Damage::Yaw(20.0)),
    ("yaw 90", Damage::Yaw(90.0)),
    ("yaw 180", Damage::Yaw(180.0)),
    ("panoramas mirrored", Damage::Mirror(Mirror::Images)),
    ("mesh mirrored", Damage::MirroredMesh),
    ("shift 1 m", Damage::Shift(1.0)),
    ("shift 2 m", Damage::Shift(2.0)),
    ("scale 0.7", Damage::PoseScale(0.7)),
    ("scale 1.3", Damage::PoseScale(1.3)),
];

/// Further ones, for information.
const MORE: [(&str, Damage); 11] = [
    ("jitter 0.5°, 1 cm", Damage::Jitter(0.5, 0.01)),
    ("jitter 2°, 2 cm", Damage::Jitter(2.0, 0.02)),
    ("jitter 5°, 5 cm", Damage::Jitter(5.0, 0.05)),
    ("camera yaw 20", Damage::CameraYaw(20.0)),
    ("camera yaw 90", Damage::CameraYaw(90.0)),
    ("camera yaw 180", Damage::CameraYaw(180.0)),
    ("yaw 5", Damage::Yaw(5.0)),
    ("camera yaw 5", Damage::CameraYaw(5.0)),
    ("panoramas and labels mirrored", Damage::Mirror(Mirror::All)),
    ("poses in millimetres", Damage::PoseScale(1000.0)),
    ("poses in feet", Damage::PoseScale(1.0 / 0.3048)),
];

/// A damage and what was said to it.
#[derive(Clone, Debug, Serialize)]
pub struct Judged {
    /// The damage.
    pub damage: String,
    /// It counts among the fifteen.
    pub counts: bool,
    /// What was found.
    pub alignment: Alignment,
    /// Seconds it took.
    pub seconds: f64,
    /// Verdict after the correction was applied.
    pub after: Option<AlignmentVerdict>,
    /// Poses that were refined.
    pub refined: usize,
    /// Median error of the poses before and after refinement, degrees.
    pub degrees: [f64; 2],
    /// The same of the places, metres.
    pub metres: [f64; 2],
}

/// All damages of one scene.
#[derive(Clone, Debug, Serialize)]
pub struct AlignmentFigures {
    /// The scene.
    pub scene: String,
    /// Rows, the undamaged scene first.
    pub rows: Vec<Judged>,
}

impl AlignmentFigures {
    /// Damages that count and were called misaligned, of how many.
    #[must_use]
    pub fn recognised(&self) -> (usize, usize) {
        let all = self.rows.iter().filter(|r| r.counts);
        let found = all
            .clone()
            .filter(|r| r.alignment.verdict == AlignmentVerdict::Misaligned);
        (found.count(), all.count())
    }
}

impl Display for AlignmentFigures {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}", self.scene)?;
        for r in &self.rows {
            let a = &r.alignment;
            let best = a.hypotheses.first();
            writeln!(
                f,
                "  {:<30} {:<10} score {:.3} ± {:.3}, peak {:6.1}, weakest {:6.1}, met {:.2}, {:5.1} s; best {:.3} {} (z {:.1}){}",
                r.damage,
                format!("{:?}", a.verdict).to_lowercase(),
                a.score,
                a.standard_error,
                a.peak,
                a.weakest,
                a.met,
                r.seconds,
                best.map_or(0.0, |b| b.score),
                best.map_or("", |b| b.name.as_str()),
                a.winner_significance,
                r.after
                    .map_or(String::new(), |v| format!("; corrected: {v:?}"))
            )?;
            if r.alignment.verdict != AlignmentVerdict::Misaligned {
                writeln!(
                    f,
                    "    {} poses refined: {:.2}° → {:.2}°, {:.3} m → {:.3} m",
                    r.refined, r.degrees[0], r.degrees[1], r.metres[0], r.metres[1]
                )?;
            }
            if r.damage == "none" {
                writeln!(f, "    {:?}", a.parts)?;
                for h in &a.hypotheses {
                    writeln!(f, "    {:.3} {}", h.score, h.name)?;
                }
            }
        }
        let (found, of) = self.recognised();
        writeln!(f, "  recognised: {found} of {of}")
    }
}

/// Damages a scene in memory in every way and asks for the verdict.
///
/// # Errors
/// A scene that cannot be loaded.
pub fn bench_alignment(
    path: &Path,
    load: &LoadOptions,
    bench: &AlignmentBench,
) -> Result<AlignmentFigures> {
    let mut scene = Scene::load(path, load)?;
    if bench.no_labels {
        scene.views.iter_mut().for_each(|v| v.label_path = None);
    }
    let mut rows = Vec::new();
    let all = std::iter::once(("none", Damage::None, false))
        .chain(DAMAGES.iter().map(|d| (d.0, d.1, true)))
        .chain(MORE.iter().map(|d| (d.0, d.1, false)))
        .filter(|d| !bench.undamaged || d.0 == "none")
        .filter(|d| bench.only.as_ref().is_none_or(|t| d.0.contains(t.as_str())));
    for (name, damage, counts) in all {
        let mut damaged = damaged(&scene, damage);
        let tracer = EmbreeTracer::new(&damaged.mesh)?;
        let start = Instant::now();
        let alignment = assess(&damaged, &tracer)?;
        let seconds = start.elapsed().as_secs_f64();
        let after = match &alignment.correction {
            Some(c) if counts => {
                apply(&mut damaged, c, alignment.corrected_distance);
                let tracer = EmbreeTracer::new(&damaged.mesh)?;
                Some(assess(&damaged, &tracer)?.verdict)
            }
            _ => None,
        };
        let mut refining = (0, [0.0; 2], [0.0; 2]);
        if alignment.verdict != AlignmentVerdict::Misaligned {
            let options = AlignmentOptions {
                refine_poses: Switch::On,
                ..AlignmentOptions::default()
            };
            let before = pose_errors(&scene, &damaged);
            let refined = align(&mut damaged, &options)?.refined.len();
            let after = pose_errors(&scene, &damaged);
            refining = (refined, [before.0, after.0], [before.1, after.1]);
        }
        rows.push(Judged {
            damage: name.into(),
            counts,
            alignment,
            seconds,
            after,
            refined: refining.0,
            degrees: refining.1,
            metres: refining.2,
        });
    }
    Ok(AlignmentFigures {
        scene: path.display().to_string(),
        rows,
    })
}

/// Median errors of the training views' poses, degrees and metres.
fn pose_errors(truth: &Scene, scene: &Scene) -> (f64, f64) {
    let pairs = truth.train_views().zip(scene.train_views());
    let (mut turns, mut shifts) = (Vec::new(), Vec::new());
    for (a, b) in pairs {
        let (a, b) = (&a.camera, &b.camera);
        let q = Quat::from_mat3(&(a.world_from_camera.transpose() * b.world_from_camera));
        turns.push(f64::from(q.to_scaled_axis().length().to_degrees()));
        shifts.push(f64::from(a.position.distance(b.position)));
    }
    (super::median(&mut turns), super::median(&mut shifts))
}

fn damaged(scene: &Scene, damage: Damage) -> Scene {
    let mut s = scene.clone();
    let turned = |s: &mut Scene, turn: DMat3, shift: DVec3, scale: f64| {
        let origin = s.origin;
        for v in &mut s.views {
            let c = &mut v.camera;
            c.world_from_camera = (turn * c.world_from_camera.as_dmat3()).as_mat3();
            let at = turn * (origin + c.position.as_dvec3()) * scale + shift;
            c.position = (at - origin).as_vec3();
        }
    };
    let still = DMat3::IDENTITY;
    match damage {
        Damage::None => {}
        Damage::MeshScale(k) => {
            for p in &mut s.mesh.positions {
                *p = (p.as_dvec3() * k).as_vec3();
            }
            for v in &mut s.views {
                let at = scene.origin + v.camera.position.as_dvec3();
                v.camera.position = (at - scene.origin * k).as_vec3();
            }
            s.origin = scene.origin * k;
        }
        Damage::PoseScale(k) => turned(&mut s, still, DVec3::ZERO, k),
        Damage::OpenCv => {
            for v in &mut s.views {
                v.camera.world_from_camera *= Mat3::from_diagonal(glam::Vec3::new(1.0, -1.0, -1.0));
            }
        }
        Damage::WorldToCamera => {
            for v in &mut s.views {
                let c = &mut v.camera;
                let r = c.world_from_camera.as_dmat3().transpose();
                let at = -(r * (scene.origin + c.position.as_dvec3()));
                c.world_from_camera = r.as_mat3();
                c.position = (at - scene.origin).as_vec3();
            }
        }
        Damage::ZUp => {
            let z_up = crate::scene::transforms::y_up_from_z_up().transpose();
            turned(&mut s, z_up, DVec3::ZERO, 1.0);
        }
        Damage::Yaw(d) => turned(
            &mut s,
            DMat3::from_rotation_y(d.to_radians()),
            DVec3::ZERO,
            1.0,
        ),
        Damage::CameraYaw(d) => {
            for v in &mut s.views {
                v.camera.world_from_camera *= Mat3::from_rotation_y(d.to_radians() as f32);
            }
        }
        Damage::Shift(m) => {
            let by = DVec3::new(0.8, 0.0, 0.6) * m;
            turned(&mut s, still, by, 1.0);
        }
        Damage::Jitter(degrees, metres) => {
            for (i, v) in s.views.iter_mut().enumerate() {
                let mut rng = KeyedRng::new(0x71773, i as u64);
                let mut vector = || {
                    let ball = Vec3::from_array(std::array::from_fn(|_| rng.next_f32() - 0.5));
                    ball.normalize_or(Vec3::X)
                };
                let axis = vector() * (degrees.to_radians() as f32);
                v.camera.world_from_camera *= Mat3::from_quat(Quat::from_scaled_axis(axis));
                v.camera.position += vector() * metres as f32;
            }
        }
        Damage::Mirror(mirror) => s.mirror = mirror,
        Damage::MirroredMesh => mirror_mesh(&mut s),
    }
    s
}

/// The mesh's mirror image at x = 0 of the file, faces turned with it.
fn mirror_mesh(scene: &mut Scene) {
    let twice = 2.0 * scene.origin.x as f32;
    for p in &mut scene.mesh.positions {
        p.x = -(p.x + twice);
    }
    for n in &mut scene.mesh.normals {
        n.x = -n.x;
    }
    for t in &mut scene.mesh.triangles {
        t.swap(1, 2);
    }
}
