//! The test of alignment on a room whose photographs are computed: a box with a cupboard, walls
//! painted in blotches, lit from one side.

use super::apply::apply;
use super::correction::Correction;
use super::evidence::{EvidenceSize, ViewEvidence};
use super::verdict::{Alignment, assess_views};
use crate::core::geometry::{Camera, Mesh, Projection};
use crate::core::image::{Plane, RgbPlane};
use crate::core::trace::{EmbreeTracer, Hit, Ray, Tracer};
use crate::scene::Scene;
use crate::verdict::AlignmentVerdict;
use glam::{DMat3, DVec3, Mat3, Vec2, Vec3};
use std::path::PathBuf;

fn add_box(mesh: &mut Mesh, lo: Vec3, hi: Vec3) {
    let first = mesh.positions.len() as u32;
    for i in 0..8 {
        let pick = |bit: u32, k: usize| if i >> bit & 1 == 1 { hi[k] } else { lo[k] };
        mesh.positions
            .push(Vec3::new(pick(0, 0), pick(1, 1), pick(2, 2)));
    }
    for q in [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ] {
        let q = q.map(|i: u32| first + i);
        mesh.triangles
            .extend([[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
    }
    mesh.normals = vec![Vec3::Y; mesh.positions.len()];
    mesh.uvs = vec![Vec2::ZERO; mesh.positions.len()];
}

/// A room of 5 × 2.6 × 4 m with a cupboard, its centre at the origin of the coordinates.
fn room() -> Mesh {
    let mut mesh = Mesh::default();
    add_box(
        &mut mesh,
        Vec3::new(-2.5, -1.3, -2.0),
        Vec3::new(2.5, 1.3, 2.0),
    );
    add_box(
        &mut mesh,
        Vec3::new(-2.4, -1.3, -1.9),
        Vec3::new(-1.6, 0.5, -0.6),
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
