//! The test of alignment on a room whose photographs are computed: a box with a cupboard, walls
//! painted in blotches, lit from one side.

use super::apply::apply;
use super::correction::Correction;
use super::evidence::{EvidenceSize, ViewEvidence};
use super::refine::{RefinedPose, refine};
use super::score::Ground;
use super::verdict::{Alignment, assess_views};
use crate::core::geometry::{Camera, Mesh, Projection, add_box};
use crate::core::image::{Plane, RgbPlane};
use crate::core::trace::{EmbreeTracer, Hit, Ray, Tracer};
use crate::scene::{Mirror, Scene};
use crate::verdict::AlignmentVerdict;
use glam::{DMat3, DVec3, Mat3, Vec2, Vec3};
use std::path::PathBuf;

/// A room of 5 × 2.6 × 4 m with a cupboard, its centre at the origin of the coordinates.
fn room() -> Mesh {
    let mut mesh = Mesh::default();
    add_box(
        &mut mesh,
        Vec3::new(-2.5, -1.3, -2.0),
        Vec3::new(2.5, 1.3, 2.0),
        true,
    );
    add_box(
        &mut mesh,
        Vec3::new(-2.4, -1.3, -1.9),
        Vec3::new(-1.6, 0.5, -0.6),
        true,
    );
    mesh
}

/// Radiance of a surface point: blotches of paint under light that falls off across the room.
fn radiance(p: Vec3, contrast: f32) -> Vec3 {
    let wave = |a: f32, b: f32, c: f32| (a * p.x + b * p.y + c * p.z).sin();
    let paint = wave(3.1, 1.7, -2.3) + wave(-1.3, 4.1, 2.9) + 0.5 * wave(7.0, -5.0, 6.0);
    let light = 0.5 + 0.2 * (p.x + 0.3 * p.y);
    let tint = Vec3::new(1.0, 1.0 + 0.3 * contrast * wave(2.0, 0.0, 1.5), 0.9);
    tint * (light * (contrast * 0.4 * paint).exp())
}

fn places() -> Vec<Vec3> {
    [
        [1.2, 0.2, 0.8],
        [-0.5, 0.3, 1.1],
        [0.4, 0.1, -0.9],
        [1.6, 0.4, -1.1],
        [-1.2, 0.2, 0.6],
        [0.1, 0.3, 0.2],
    ]
    .map(Vec3::from)
    .to_vec()
}

fn photograph(tracer: &dyn Tracer, camera: &Camera, contrast: f32, gain: f32) -> RgbPlane {
    let (w, h) = (camera.width, camera.height);
    let rays: Vec<Ray> = (0..w * h)
        .map(|i| {
            let p = Vec2::new((i % w) as f32 + 0.5, (i / w) as f32 + 0.5);
            Ray::new(camera.position, camera.direction(p), f32::INFINITY)
        })
        .collect();
    let mut hits = vec![Hit::miss(); rays.len()];
    tracer.closest(&rays, &mut hits);
    let data = rays
        .iter()
        .zip(&hits)
        .map(|(r, hit)| {
            let p = Vec3::from(r.origin) + Vec3::from(r.direction) * hit.t;
            radiance(p, contrast) * gain
        })
        .collect();
    Plane {
        width: w,
        height: h,
        data,
    }
}

struct Photographed {
    scene: Scene,
    cameras: Vec<Camera>,
    images: Vec<RgbPlane>,
}

impl Photographed {
    fn new(projection: Projection, size: [usize; 2], contrast: f32) -> Self {
        let mesh = room();
        let tracer = EmbreeTracer::new(&mesh).expect("tracer");
        let cameras: Vec<Camera> = places()
            .into_iter()
            .enumerate()
            .map(|(i, position)| Camera {
                projection,
                width: size[0],
                height: size[1],
                world_from_camera: Mat3::from_rotation_y(0.9 * i as f32),
                position,
            })
            .collect();
        // exposures that drift by a stop must not matter
        let images = cameras
            .iter()
            .enumerate()
            .map(|(i, c)| photograph(&tracer, c, contrast, 1.0 + 0.2 * i as f32))
            .collect();
        let scene = Scene::from_parts(
            PathBuf::new(),
            DVec3::new(3.0, 1.3, -2.0),
            mesh,
            Vec::new(),
            Vec::new(),
        );
        Self {
            scene,
            cameras,
            images,
        }
    }

    fn panoramas(contrast: f32) -> Self {
        Self::new(Projection::Equirectangular, [96, 48], contrast)
    }

    /// The verdict on poses spoilt by `damage`.
    fn judged(&self, damage: impl Fn(&Camera) -> Camera) -> Alignment {
        let views: Vec<ViewEvidence> = self
            .cameras
            .iter()
            .zip(&self.images)
            .map(|(c, image)| {
                ViewEvidence::new("v", &damage(c), image, None, None, EvidenceSize::COARSE)
            })
            .collect();
        let tracer = EmbreeTracer::new(&self.scene.mesh).expect("tracer");
        assess_views(&self.scene, &tracer, &views)
    }

    fn moved(&self, c: &Correction) -> Alignment {
        self.judged(|camera| c.camera(camera, self.scene.origin, false))
    }
}

#[test]
fn usual_mistakes_are_named() {
    let room = Photographed::panoramas(1.0);
    let shift = Correction {
        shift: DVec3::new(0.8, 0.0, 0.6),
        ..Correction::default()
    };
    let opencv = Correction {
        camera_turn: DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
        ..Correction::default()
    };
    for (damage, expected) in [(shift, "shifted"), (opencv, "OpenCV")] {
        let a = room.moved(&damage);
        let winner = a.winner.clone().unwrap_or_default();
        assert_eq!(a.verdict, AlignmentVerdict::Misaligned, "{expected}: {a:?}");
        assert!(winner.contains(expected), "{expected}: {winner}");
        assert!(a.problem().is_some_and(|p| p.contains("--fix-alignment")));
    }
}

#[test]
fn mirrored_photographs_are_told_from_right_ones() {
    let mut room = Photographed::panoramas(1.0);
    for image in &mut room.images {
        image.data.chunks_exact_mut(96).for_each(<[Vec3]>::reverse);
    }
    let a = room.judged(|c| *c);
    assert_eq!(a.verdict, AlignmentVerdict::Misaligned, "{a:?}");
    assert_eq!(a.correction.map(|c| c.mirror), Some(Mirror::All), "{a:?}");
}

/// Photographs that are stored upside down, under labels that are not.
#[test]
fn photographs_upside_down_are_told_from_mirrored_ones() {
    let room = Photographed::panoramas(1.0);
    let tracer = EmbreeTracer::new(&room.scene.mesh).expect("tracer");
    let views: Vec<ViewEvidence> = (room.cameras.iter().zip(&room.images))
        .map(|(camera, image)| {
            let labels = labelled(&tracer, camera);
            let mut image = image.clone();
            image.data.reverse();
            let size = EvidenceSize::COARSE;
            ViewEvidence::new("v", camera, &image, None, Some(&labels), size)
        })
        .collect();
    let a = assess_views(&room.scene, &tracer, &views);
    assert_eq!(a.verdict, AlignmentVerdict::Misaligned, "{a:?}");
    let found = a.correction.map(|c| c.mirror);
    assert_eq!(found, Some(Mirror::UpsideDown), "{a:?}");
}

/// A class for each side of the boxes.
fn labelled(tracer: &dyn Tracer, camera: &Camera) -> Plane<u16> {
    let (w, h) = (camera.width, camera.height);
    let rays: Vec<Ray> = (0..w * h)
        .map(|i| Vec2::new((i % w) as f32 + 0.5, (i / w) as f32 + 0.5))
        .map(|p| Ray::new(camera.position, camera.direction(p), f32::INFINITY))
        .collect();
    let mut hits = vec![Hit::miss(); rays.len()];
    tracer.closest(&rays, &mut hits);
    Plane {
        width: w,
        height: h,
        data: hits.iter().map(|h| 1 + h.triangle as u16 / 2).collect(),
    }
}

/// A room without a pattern says nothing: no verdict of misalignment may come of noise.
#[test]
fn nothing_to_see_is_no_misalignment() {
    let mut blank = Photographed::panoramas(0.0);
    for image in &mut blank.images {
        image.data.fill(Vec3::splat(0.5));
    }
    let a = blank.judged(|c| *c);
    assert_ne!(a.verdict, AlignmentVerdict::Misaligned, "{a:?}");
}

/// Photographs of other rooms: no hypothesis fits, and that they show much and agree with nothing
/// is proof enough.
#[test]
fn photographs_of_another_place_are_refused() {
    let mut room = Photographed::panoramas(1.0);
    for (i, image) in room.images.iter_mut().enumerate() {
        let (w, k) = (image.width, i as f32);
        for (j, p) in image.data.iter_mut().enumerate() {
            let (x, y) = ((j % w) as f32 / w as f32, (j / w) as f32 / w as f32);
            let turn = std::f32::consts::TAU * x;
            let wave =
                |a: f32, b: f32, c: f32| (a * turn.cos() + b * turn.sin() + c * y + k * k).sin();
            let v = wave(3.0 + k, 2.0 - k, 17.0) + wave(1.0, 4.0 - k, 23.0 + k);
            *p = Vec3::splat((0.7 * v).exp());
        }
    }
    let a = room.judged(|c| *c);
    assert_eq!(a.verdict, AlignmentVerdict::Misaligned, "{a:?}");
    assert!(
        a.problem()
            .is_some_and(|p| p.contains("photographs of this mesh")),
        "{a:?}"
    );
}

/// Walls of one paint, lit from one side: little to see, and no reason to call it wrong.
#[test]
fn rooms_without_a_pattern_are_not_misaligned() {
    for contrast in [0.0, 0.05, 0.2] {
        let a = Photographed::panoramas(contrast).judged(|c| *c);
        assert_ne!(a.verdict, AlignmentVerdict::Misaligned, "{contrast}: {a:?}");
    }
}

/// Pixels that are negative or no numbers say nothing, and no figure of the verdict is one of
/// them: what is written as JSON reads back.
#[test]
fn bad_pixels_leave_no_bad_figures() {
    let mut room = Photographed::panoramas(1.0);
    for (i, image) in room.images.iter_mut().enumerate() {
        for (k, p) in image.data.iter_mut().enumerate() {
            match (k + i) % 29 {
                0 => *p = Vec3::splat(-5.0),
                1 => *p = Vec3::new(f32::NAN, 1.0, 1.0),
                2 => *p = Vec3::splat(f32::INFINITY),
                _ => {}
            }
        }
    }
    let a = room.judged(|c| *c);
    let json = serde_json::to_string(&a).expect("json");
    let back: Alignment = serde_json::from_str(&json).expect("numbers");
    assert_eq!(back, a);
    // one view alone has nothing to be compared with
    room.cameras.truncate(1);
    let json = serde_json::to_string(&room.judged(|c| *c)).expect("json");
    serde_json::from_str::<Alignment>(&json).expect("numbers");
}

/// A mesh in millimetres is scaled, and poses that were right keep their metres.
#[test]
fn the_side_that_was_wrong_is_mended() {
    let room = Photographed::panoramas(1.0);
    let mut scene = room.scene.clone();
    for p in &mut scene.mesh.positions {
        *p *= 1000.0;
    }
    scene.origin *= 1000.0;
    let in_millimetres = Correction {
        scale: 1000.0,
        ..Correction::default()
    };
    apply(&mut scene, &in_millimetres, 2000.0);
    assert!((scene.origin - room.scene.origin).length() < 1e-6);
    for (a, b) in scene.mesh.positions.iter().zip(&room.scene.mesh.positions) {
        assert!((*a - *b).length() < 1e-4);
    }
    // poses in millimetres: the mesh stays
    let mut scene = room.scene.clone();
    let c = Correction {
        scale: 0.001,
        ..Correction::default()
    };
    apply(&mut scene, &c, 2.0);
    assert_eq!(scene.mesh, room.scene.mesh);
    // a mirrored mesh keeps its faces to the same side
    let mut scene = room.scene.clone();
    let mirrored = Correction {
        turn: DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)),
        ..Correction::default()
    };
    apply(&mut scene, &mirrored, 2.0);
    let (before, after) = (&room.scene.mesh, &scene.mesh);
    for t in 0..before.triangles.len() {
        let n = before.face_normal(t);
        let flipped = Vec3::new(-n.x, n.y, n.z);
        assert!((after.face_normal(t) - flipped).length() < 1e-5);
    }
}

fn jittered(camera: &Camera, i: usize) -> Camera {
    let k = i as f32;
    let axis = Vec3::new(
        (2.1 * k).sin(),
        (1.3 * k + 1.0).cos(),
        (0.7 * k + 2.0).sin(),
    )
    .normalize();
    let shift = Vec3::new((1.9 * k).cos(), 0.5 * (2.3 * k).sin(), (0.9 * k).cos()).normalize();
    Camera {
        world_from_camera: camera.world_from_camera
            * Mat3::from_axis_angle(axis, 2.0f32.to_radians()),
        position: camera.position + shift * 0.03,
        ..*camera
    }
}

fn fine(room: &Photographed, cameras: &[Camera]) -> Vec<ViewEvidence> {
    cameras
        .iter()
        .zip(&room.images)
        .enumerate()
        .map(|(i, (c, image))| {
            ViewEvidence::new(&i.to_string(), c, image, None, None, EvidenceSize::FINER[1])
        })
        .collect()
}

/// The poses of the photographs that refinement changes if they are given as `cameras`.
fn refined(room: &Photographed, cameras: &[Camera]) -> Vec<RefinedPose> {
    let tracer = EmbreeTracer::new(&room.scene.mesh).expect("tracer");
    let ground = Ground {
        mesh: &room.scene.mesh,
        tracer: &tracer,
    };
    refine(&ground, &fine(room, cameras), || Ok(Vec::new()), true).expect("nothing is read")
}

#[test]
fn right_poses_are_left_alone_and_wrong_ones_come_back() {
    let room = Photographed::new(Projection::Equirectangular, [192, 96], 1.0);
    let none = refined(&room, &room.cameras);
    assert!(none.is_empty(), "{none:?}");

    let spoilt: Vec<Camera> = room
        .cameras
        .iter()
        .enumerate()
        .map(|(i, c)| jittered(c, i))
        .collect();
    let refined = refined(&room, &spoilt);
    assert!(refined.len() >= 5, "{refined:?}");
    for pose in &refined {
        assert!(turn_left(&room, &spoilt, pose) < 0.4, "{pose:?}");
    }
}

/// One pose that is far off comes back, and moves none of those that were right.
#[test]
fn one_wrong_pose_is_the_only_one_changed() {
    let room = Photographed::new(Projection::Equirectangular, [192, 96], 1.0);
    let mut spoilt = room.cameras.clone();
    spoilt[2] = jittered(&jittered(&spoilt[2], 1), 1);
    let refined = refined(&room, &spoilt);
    let stems: Vec<&str> = refined.iter().map(|p| p.stem.as_str()).collect();
    assert_eq!(stems, ["2"], "{refined:?}");
    assert!(turn_left(&room, &spoilt, &refined[0]) < 0.4, "{refined:?}");
}

/// By how many degrees a refined camera is still turned away from the right one.
fn turn_left(room: &Photographed, spoilt: &[Camera], pose: &RefinedPose) -> f32 {
    let i: usize = pose.stem.parse().expect("a number");
    let back = pose.camera(&spoilt[i]);
    let turn = back.world_from_camera.transpose() * room.cameras[i].world_from_camera;
    let cosine = 0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0);
    cosine.clamp(-1.0, 1.0).acos().to_degrees()
}
