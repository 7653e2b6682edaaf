//! Rooms found in synthetic plans and in the shared scenes against their floor plans (`gt/` is read
//! here only, never by the program).

mod shared;

use glam::{DVec3, Mat3, Vec2, Vec3};
use shared::shared;
use std::path::PathBuf;
use unbake::core::geometry::{Camera, Mesh, Projection};
use unbake::core::trace::{BruteForce, EmbreeTracer};
use unbake::scene::{LoadOptions, Scene, Split, View, find_rooms, floor_plan};

fn quad(mesh: &mut Mesh, a: Vec3, u: Vec3, v: Vec3) {
    let first = mesh.positions.len() as u32;
    mesh.positions.extend([a, a + u, a + u + v, a + v]);
    mesh.triangles
        .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
}

/// An 8 × 4 m, 2.5 m high box, parted at x = 4 by a wall with a doorway 0.9 m wide and `door`
/// metres high.
fn two_rooms(door: f32, scale: f32) -> Scene {
    let mut mesh = Mesh::default();
    let (x, y, z) = (Vec3::X * 8.0, Vec3::Y * 2.5, Vec3::Z * 4.0);
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
    mesh.compute_normals();
    mesh.uvs = vec![Vec2::ZERO; mesh.positions.len()];
    let view = |x: f32| View {
        stem: format!("{x}"),
        camera: Camera {
            projection: Projection::Equirectangular,
            width: 8,
            height: 4,
            world_from_camera: Mat3::IDENTITY,
            position: Vec3::new(x, 0.2, 0.0) * scale,
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
        vec![view(-2.0), view(2.0)],
    )
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

#[test]
fn the_rooms_of_the_house_are_found() {
    let Some((path, scene)) = load("aws-house") else {
        return;
    };
    let text = std::fs::read_to_string(path.join("gt/rooms.json")).expect("plan");
    let plan: serde_json::Value = serde_json::from_str(&text).expect("json");
    let number = |v: &serde_json::Value| v.as_f64().expect("number");
    let corner = |p: &serde_json::Value| {
        Vec2::new(
            (number(&p[0]) - scene.origin.x) as f32,
            (number(&p[1]) - scene.origin.z) as f32,
        )
    };
    let polygons: Vec<Vec<Vec2>> = plan["rooms"]
        .as_array()
        .expect("rooms")
        .iter()
        .map(|r| {
            r["polygon_xz"]
                .as_array()
                .expect("polygon")
                .iter()
                .map(corner)
                .collect()
        })
        .collect();
    let grid = find_rooms(&scene, &EmbreeTracer::new(&scene.mesh).expect("embree"));
    let mut table = vec![vec![0usize; grid.count() as usize + 1]; polygons.len()];
    for row in 0..grid.cells.height {
        for column in 0..grid.cells.width {
            let p = Vec2::new(grid.x_min, grid.z_min)
                + Vec2::new(column as f32 + 0.5, row as f32 + 0.5) * grid.cell;
            for (counts, _) in table
                .iter_mut()
                .zip(&polygons)
                .filter(|(_, polygon)| inside(polygon, p))
            {
                counts[grid.room_at(Vec3::new(p.x, 0.0, p.y)) as usize] += 1;
            }
        }
    }
    let found: Vec<usize> = table
        .iter()
        .map(|counts| {
            let (room, n) = counts
                .iter()
                .enumerate()
                .max_by_key(|(_, n)| **n)
                .expect("rooms");
            let share = *n as f64 / counts.iter().sum::<usize>() as f64;
            assert!(share > 0.98, "{table:?}");
            room
        })
        .collect();
    // the plan parts living room and kitchen by use; in the building a 6 m wide opening joins them,
    // with nothing above it
    let [bedroom, lounge, living, sunroom, kitchen] = found[..] else {
        panic!("five rooms in the plan")
    };
    assert_eq!(living, kitchen);
    let apart = std::collections::BTreeSet::from([bedroom, lounge, living, sunroom]);
    assert_eq!((apart.len(), grid.count()), (4, 4), "{table:?}");
    drawn_rooms_cover_the_plan(&scene, &polygons);
}

/// Intersection over union of every drawn room with the rooms of the plan that lie in it.
fn drawn_rooms_cover_the_plan(scene: &Scene, polygons: &[Vec<Vec2>]) {
    let grid = floor_plan(scene, &EmbreeTracer::new(&scene.mesh).expect("embree"));
    let centre = |i: usize| {
        let (x, y) = (i % grid.cells.width, i / grid.cells.width);
        Vec2::new(grid.x_min, grid.z_min) + Vec2::new(x as f32 + 0.5, y as f32 + 0.5) * grid.cell
    };
    let cells = 0..grid.cells.data.len();
    let of_plan: Vec<Option<usize>> = cells
        .map(|i| polygons.iter().position(|p| inside(p, centre(i))))
        .collect();
    // the drawn room that holds most of each room of the plan
    let drawn = |room: usize| {
        let mut counts = vec![0usize; usize::from(grid.count()) + 1];
        let both = of_plan.iter().zip(&grid.cells.data);
        both.filter(|(p, _)| **p == Some(room))
            .for_each(|(_, &id)| counts[usize::from(id)] += 1);
        (1..counts.len()).max_by_key(|&id| counts[id])
    };
    let home: Vec<Option<usize>> = (0..polygons.len()).map(drawn).collect();
    for id in 1..=usize::from(grid.count()) {
        let (mut both, mut either) = (0usize, 0usize);
        for (plan, &cell) in of_plan.iter().zip(&grid.cells.data) {
            let (in_plan, in_drawn) = (
                plan.is_some_and(|p| home[p] == Some(id)),
                usize::from(cell) == id,
            );
            both += usize::from(in_plan && in_drawn);
            either += usize::from(in_plan || in_drawn);
        }
        let share = both as f64 / either as f64;
        println!("drawn room {id}: {share:.3} of its union with the plan");
        assert!(share >= 0.9, "room {id}: {share}");
    }
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
