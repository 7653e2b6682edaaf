//! Rooms found in synthetic plans and in the shared scenes against their floor plans (`gt/` is read
//! here only, never by the program).

mod shared;

use glam::{DVec3, Mat3, Vec2, Vec3};
use shared::shared;
use std::path::PathBuf;
use unbake::core::geometry::{Camera, Mesh, Projection};
use unbake::core::progress::Progress;
use unbake::core::trace::{BruteForce, EmbreeTracer, Ray, Tracer};
use unbake::programs::prepare::{PrepareOptions, prepare};
use unbake::programs::synth::{SynthOptions, generate};
use unbake::scene::{LoadOptions, RoomGrid, Scene, Split, View, find_rooms, floor_plan};

fn quad(mesh: &mut Mesh, a: Vec3, u: Vec3, v: Vec3) {
    let first = mesh.positions.len() as u32;
    mesh.positions.extend([a, a + u, a + u + v, a + v]);
    mesh.triangles
        .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
}

/// A box 2.5 m high.
fn hall(length: f32, width: f32) -> Mesh {
    let mut mesh = Mesh::default();
    let (x, y, z) = (Vec3::X * length, Vec3::Y * 2.5, Vec3::Z * width);
    for (a, u, v) in [
        (Vec3::ZERO, x, z),
        (y, x, z),
        (Vec3::ZERO, x, y),
        (z, x, y),
        (Vec3::ZERO, z, y),
        (x, z, y),
    ] {
        quad(&mut mesh, a, u, v);
    }
    mesh
}

/// An 8 × 4 m, 2.5 m high box, parted at x = 4 by a wall with a doorway 0.9 m wide and `door`
/// metres high.
fn two_rooms(door: f32, scale: f32) -> Scene {
    let mut mesh = hall(8.0, 4.0);
    let y = Vec3::Y * 2.5;
    let wall = |z0: f32, y0: f32| Vec3::new(4.0, y0, z0);
    quad(&mut mesh, wall(0.0, 0.0), Vec3::Z * 1.5, y);
    quad(&mut mesh, wall(2.4, 0.0), Vec3::Z * 1.6, y);
    if door < 2.5 {
        quad(
            &mut mesh,
            wall(1.5, door),
            Vec3::Z * 0.9,
            Vec3::Y * (2.5 - door),
        );
    }
    mesh.positions
        .iter_mut()
        .for_each(|p| *p = (*p - Vec3::new(4.0, 1.25, 2.0)) * scale);
    watched(mesh, [-2.0, 2.0].map(|x| Vec3::new(x, 0.2, 0.0) * scale))
}

/// A scene with panoramas at these places.
fn watched(mut mesh: Mesh, places: [Vec3; 2]) -> Scene {
    mesh.compute_normals();
    mesh.uvs = vec![Vec2::ZERO; mesh.positions.len()];
    let view = |position: Vec3| View {
        stem: format!("{}", position.x),
        camera: Camera {
            projection: Projection::Equirectangular,
            width: 8,
            height: 4,
            world_from_camera: Mat3::IDENTITY,
            position,
        },
        image_path: PathBuf::new(),
        label_path: None,
        mask_path: None,
        exposure_ev: 0.0,
        split: Split::Train,
        colour_space: None,
        account: Default::default(),
    };
    Scene::from_parts(
        PathBuf::new(),
        DVec3::ZERO,
        mesh,
        Vec::new(),
        places.map(view).to_vec(),
    )
}

/// A 10 × 6 m, 2.5 m high box around the origin, into which two walls of `length` metres reach from
/// its long sides, 2 m high and `thick` metres from one line; turned by `angle`.
fn wing_walls(length: f32, thick: f32, angle: f32) -> Scene {
    let mut mesh = hall(10.0, 6.0);
    for (x, z) in [(5.0, 0.0), (5.0 + thick, 6.0 - length)] {
        quad(
            &mut mesh,
            Vec3::new(x, 0.0, z),
            Vec3::Z * length,
            Vec3::Y * 2.0,
        );
    }
    let turn = Mat3::from_rotation_y(angle);
    let placed = |p: &mut Vec3| *p = turn * (*p - Vec3::new(5.0, 1.25, 3.0));
    mesh.positions.iter_mut().for_each(placed);
    watched(mesh, [-2.5, 2.5].map(|x| turn * Vec3::new(x, 0.2, 0.0)))
}

#[test]
fn wall_ends_that_face_each_other_part_a_room_however_far_apart() {
    let count = |length, thick, angle| {
        let scene = wing_walls(length, thick, angle);
        usize::from(find_rooms(&scene, &BruteForce::new(&scene.mesh)).count())
    };
    for angle in [0.0, 0.5] {
        assert_eq!(count(1.0, 0.0, angle), 2, "angle {angle}");
        assert_eq!(
            count(1.0, 0.2, angle),
            2,
            "in the thickness of a wall, {angle}"
        );
        assert_eq!(count(1.0, 1.0, angle), 1, "not in one line, {angle}");
        assert_eq!(count(0.3, 0.0, angle), 1, "pilasters, {angle}");
    }
}

#[test]
fn a_doorway_parts_two_rooms_with_or_without_a_lintel_and_in_any_unit() {
    for door in [2.0, 2.5] {
        for scale in [1e-3, 1.0, 1e4] {
            let scene = two_rooms(door, scale);
            let grid = find_rooms(&scene, &BruteForce::new(&scene.mesh));
            let at = |x: f32, z: f32| grid.room_at(Vec3::new(x, 0.0, z) * scale);
            assert_eq!(grid.count(), 2, "door {door}, scale {scale}");
            assert_ne!(at(-2.0, 0.0), at(2.0, 0.0));
            assert_eq!(at(-3.9, -1.9), at(-2.0, 0.0));
            assert_eq!(at(-0.3, 0.0), at(-2.0, 0.0), "up to the doorway");
            // both faces of the parting wall belong to the room they face
            let face = |n: f32| grid.room_of_surface(Vec3::new(0.0, 0.0, 1.0) * scale, Vec3::X * n);
            assert_eq!((face(-1.0), face(1.0)), (at(-2.0, 0.0), at(2.0, 0.0)));
        }
    }
}

#[test]
fn an_empty_plan_is_one_room() {
    let mut mesh = Mesh::default();
    quad(&mut mesh, Vec3::ZERO, Vec3::X, Vec3::Z);
    mesh.compute_normals();
    mesh.uvs = vec![Vec2::ZERO; 4];
    let scene = Scene::from_parts(PathBuf::new(), DVec3::ZERO, mesh, Vec::new(), Vec::new());
    assert_eq!(find_rooms(&scene, &BruteForce::new(&scene.mesh)).count(), 1);
}

fn load(name: &str) -> Option<(PathBuf, Scene)> {
    let path = shared(format!("scenes/{name}"))?;
    let scene = Scene::load(&path, &LoadOptions::default()).expect("loads");
    Some((path, scene))
}

fn inside(polygon: &[Vec2], p: Vec2) -> bool {
    let crosses = |i: usize| {
        let (a, b) = (polygon[i], polygon[(i + 1) % polygon.len()]);
        (a.y > p.y) != (b.y > p.y) && p.x < a.x + (b.x - a.x) * (p.y - a.y) / (b.y - a.y)
    };
    (0..polygon.len()).filter(|&i| crosses(i)).count() % 2 == 1
}

/// How drawn rooms cover those of a plan, each counted once: the pairs of largest intersection over
/// union first, none for a room without a partner.
struct Cover {
    /// Per room of the plan.
    share: Vec<f64>,
    /// Rooms drawn without a partner.
    surplus: usize,
}

impl Cover {
    /// `plan` gives the room at x, z of the scene's coordinates, ids from 1, 0 outside.
    fn of(grid: &RoomGrid, rooms: usize, plan: impl Fn(Vec2) -> usize) -> Self {
        let drawn = usize::from(grid.count());
        let mut both = vec![vec![0usize; drawn + 1]; rooms + 1];
        for (i, &id) in grid.cells.data.iter().enumerate() {
            let (column, row) = (i % grid.cells.width, i / grid.cells.width);
            let cell = Vec2::new(column as f32 + 0.5, row as f32 + 0.5) * grid.cell;
            let room = plan(Vec2::new(grid.x_min, grid.z_min) + cell);
            both[room][usize::from(id)] += 1;
        }
        let of_plan = |r: usize| both[r].iter().sum::<usize>();
        let of_drawn = |d: usize| both.iter().map(|row| row[d]).sum::<usize>();
        let pairs = (1..=rooms).flat_map(|r| (1..=drawn).map(move |d| (r, d)));
        let mut pairs: Vec<(f64, usize, usize)> = pairs
            .map(|(r, d)| {
                let either = of_plan(r) + of_drawn(d) - both[r][d];
                (both[r][d] as f64 / either.max(1) as f64, r, d)
            })
            .collect();
        pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut share, mut taken) = (vec![0.0; rooms], vec![false; drawn + 1]);
        for (iou, r, d) in pairs {
            if iou > 0.0 && share[r - 1] == 0.0 && !taken[d] {
                (share[r - 1], taken[d]) = (iou, true);
            }
        }
        let partners = taken.iter().filter(|t| **t).count();
        Self {
            share,
            surplus: drawn - partners,
        }
    }

    /// Mean over the rooms of the plan and those drawn without a partner, which count as 0.
    fn mean(&self) -> f64 {
        self.share.iter().sum::<f64>() / (self.share.len() + self.surplus) as f64
    }

    fn tell(&self, name: &str) {
        let rooms: Vec<String> = self.share.iter().map(|s| format!("{s:.3}")).collect();
        println!(
            "{name}: mean {:.3}, {} without a partner; {}",
            self.mean(),
            self.surplus,
            rooms.join(" ")
        );
    }
}

fn drawn(scene: &Scene) -> RoomGrid {
    floor_plan(scene, &EmbreeTracer::new(&scene.mesh).expect("embree"))
}

#[test]
fn the_rooms_of_the_house_are_those_of_its_plan() {
    let Some((path, scene)) = load("aws-house") else {
        return;
    };
    let text = std::fs::read_to_string(path.join("gt/rooms.json")).expect("plan");
    let plan: serde_json::Value = serde_json::from_str(&text).expect("json");
    let number = |v: &serde_json::Value| v.as_f64().expect("number");
    let corner = |p: &serde_json::Value| {
        let (x, z) = (number(&p[0]), number(&p[1]));
        Vec2::new((x - scene.origin.x) as f32, (z - scene.origin.z) as f32)
    };
    let list = |v: &serde_json::Value| v.as_array().expect("list").clone();
    let polygon = |r: &serde_json::Value| list(&r["polygon_xz"]).iter().map(corner).collect();
    let polygons: Vec<Vec<Vec2>> = list(&plan["rooms"]).iter().map(polygon).collect();
    let room = |p: Vec2| (polygons.iter().position(|o| inside(o, p))).map_or(0, |i| i + 1);
    let cover = Cover::of(&drawn(&scene), polygons.len(), room);
    cover.tell("aws-house");
    assert_eq!(cover.surplus, 0);
    assert!(cover.share.iter().all(|&s| s >= 0.9), "{:?}", cover.share);
}

#[test]
fn the_rooms_of_apartments_are_those_that_were_built() {
    for (seed, rooms) in [(1, 3), (3, 2)] {
        let folder = tempfile::tempdir().expect("folder");
        let options = SynthOptions {
            seed,
            rooms,
            views: 2 * rooms,
            test_views: 1,
            width: 32,
            spp: 1,
            texture: 256,
            ..SynthOptions::default()
        };
        generate(&options, folder.path(), &Progress::silent()).expect("generates");
        let scene = Scene::load(folder.path(), &LoadOptions::default()).expect("loads");
        let grid = drawn(&scene);
        // its own grid gives all the plan to the nearest room: what lies under a ceiling counts, and half
        // a wall around it
        let own = scene.rooms.as_ref().expect("rooms");
        let tracer = EmbreeTracer::new(&scene.mesh).expect("embree");
        let height = 2.4 - scene.origin.y as f32;
        let roofed = |p: Vec2| {
            let rays = [Vec3::Y, Vec3::NEG_Y]
                .map(|d| Ray::new(Vec3::new(p.x, height, p.y), d, f32::INFINITY));
            let mut occluded = [0u8; 2];
            tracer.occluded(&rays, &mut occluded);
            occluded == [1, 1]
        };
        let beside =
            [(-1, -1), (-1, 1), (1, -1), (1, 1)].map(|(x, z)| 0.15 * Vec2::new(x as f32, z as f32));
        let room = |p: Vec2| match beside.iter().any(|b| roofed(p + *b)) {
            true => usize::from(own.room_at(Vec3::new(p.x, 0.0, p.y))),
            false => 0,
        };
        let cover = Cover::of(&grid, rooms, room);
        cover.tell(&format!("apartment {seed}"));
        assert_eq!(cover.surplus, 0);
        assert!(cover.share.iter().all(|&s| s >= 0.9), "{:?}", cover.share);
    }
}

#[test]
fn the_rooms_of_a_tour_are_those_of_its_floor_plan() {
    let Some(tour) = shared("captures/zind-sample-tour") else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let options = PrepareOptions::default();
    prepare(None, &tour, folder.path(), &options, &Progress::silent()).expect("prepared");
    let scene = Scene::load(folder.path(), &LoadOptions::default()).expect("loads");
    let plan = scene.rooms.as_ref().expect("rooms");
    let room = |p: Vec2| usize::from(plan.room_at(Vec3::new(p.x, 0.0, p.y)));
    let cover = Cover::of(&drawn(&scene), usize::from(plan.count()), room);
    cover.tell("tour");
    assert_eq!((plan.count(), cover.surplus), (15, 0));
    // what is missing are closets narrower than a door
    let found = cover.share.iter().filter(|s| **s >= 0.85).count();
    assert!(found >= 12, "{:?}", cover.share);
    // closets are known whichever way the mesh is wound
    let mut turned = scene.clone();
    for corners in &mut turned.mesh.triangles {
        corners.swap(1, 2);
    }
    assert_eq!(drawn(&turned).cells, drawn(&scene).cells);
}

#[test]
fn a_living_room_is_one_room() {
    let Some((_, scene)) = load("grey-white-room") else {
        return;
    };
    let grid = find_rooms(&scene, &EmbreeTracer::new(&scene.mesh).expect("embree"));
    assert_eq!(grid.count(), 1);
    assert!(
        scene
            .views
            .iter()
            .all(|v| grid.room_at(v.camera.position) == 1)
    );
}
