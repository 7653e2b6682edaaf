//! The operator against closed forms and the path tracer.

use super::error::Reference;
use super::links::links;
use super::operator::{LightEdit, LiveLight};
use super::patches::{areas, describe, divide};
use super::radiosity::FormFactors;
use super::store::{OPERATOR, open_or_build, trace};
use super::{LightGroup, factors_of, light_groups};
use crate::core::brdf::Reflectance;
use crate::core::geometry::Mesh;
use crate::core::image::Plane;
use crate::core::math::luminance;
use crate::core::progress::Progress;
use crate::core::trace::BruteForce;
use crate::render::{EditableScene, LampChange, Lighting, LightmapTexels};
use crate::solution::{Solution, find_lamps};
use glam::{DVec3, Vec2, Vec3};
use std::collections::BTreeMap;
use std::f32::consts::PI;

/// Quads along a side of the test rooms' atlas.
const QUADS: usize = 4;
/// Texels of a quad's cell in all textures.
const CELL: usize = 12;

/// A quad of a test room: a corner and two edges, whose cross product is its front; class, diffuse
/// albedo and emitted radiance.
#[derive(Clone, Copy)]
struct Quad {
    corner: Vec3,
    edges: [Vec3; 2],
    class: u16,
    albedo: Vec3,
    emission: Vec3,
}

/// The six faces of a box, seen from within, of classes 1 to 6 (−x, +x, −y, +y, −z, +z).
fn inside_of_box(low: Vec3, high: Vec3, albedo: Vec3) -> Vec<Quad> {
    let d = high - low;
    let (x, y, z) = (Vec3::X * d.x, Vec3::Y * d.y, Vec3::Z * d.z);
    let faces = [
        (low, [y, z]),
        (low + x, [z, y]),
        (low, [z, x]),
        (low + y, [x, z]),
        (low, [x, y]),
        (low + z, [y, x]),
    ];
    let quad = |((corner, edges), class)| Quad {
        corner,
        edges,
        class,
        albedo,
        emission: Vec3::ZERO,
    };
    faces.into_iter().zip(1..).map(quad).collect()
}

/// A lamp of half a metre below the ceiling's middle.
fn lamp(centre: Vec3) -> Quad {
    let half = 0.25;
    Quad {
        corner: centre - Vec3::new(half, 0.0, half),
        edges: [Vec3::X * (2.0 * half), Vec3::Z * (2.0 * half)],
        class: 9,
        albedo: Vec3::ZERO,
        emission: Vec3::splat(5.0),
    }
}

fn room(quads: &[Quad]) -> Solution {
    let side = QUADS * CELL;
    let mut mesh = Mesh::default();
    let (mut albedo, mut emission) = (
        Plane::filled(side, side, Vec3::ZERO),
        Plane::filled(side, side, Vec3::ZERO),
    );
    let mut labels = Plane::filled(side, side, 0u16);
    for (k, quad) in quads.iter().enumerate() {
        let (column, row) = (k % QUADS, k / QUADS);
        let [u, v] = quad.edges;
        let base = mesh.positions.len() as u32;
        let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        for (a, b) in corners {
            mesh.positions.push(quad.corner + u * a + v * b);
            mesh.normals.push(u.cross(v).normalize());
            // two texels between quads
            let at = |cell: usize, x: f32| {
                (cell as f32 + (1.0 + x * (CELL as f32 - 2.0)) / CELL as f32) / QUADS as f32
            };
            mesh.uvs.push(Vec2::new(at(column, a), at(row, b)));
        }
        mesh.triangles
            .extend([[0, 1, 2], [0, 2, 3]].map(|t: [u32; 3]| t.map(|i| i + base)));
        for y in row * CELL..(row + 1) * CELL {
            for x in column * CELL..(column + 1) * CELL {
                let i = y * side + x;
                (albedo.data[i], emission.data[i]) = (quad.albedo, quad.emission);
                labels.data[i] = quad.class;
            }
        }
    }
    Solution {
        lamps: find_lamps(&mesh, &emission, DVec3::ZERO),
        portals: Vec::new(),
        mesh,
        origin: DVec3::ZERO,
        albedo,
        roughness: Plane::filled(1, 1, 1.0),
        irradiance: Plane::filled(side, side, Vec3::splat(2.0)),
        radiance: Plane::filled(1, 1, Vec3::ZERO),
        emission,
        confidence: Plane::filled(1, 1, Vec2::ZERO),
        metallic: None,
        transmission: None,
        irradiance_error: None,
        camera_masks: Vec::new(),
        labels,
        rooms: Plane::filled(1, 1, 1),
        reflectance: Reflectance::Paper,
        environment: Plane::filled(4, 2, Vec3::ZERO),
    }
}

fn operator(solution: &Solution) -> LiveLight {
    let tracer = BruteForce::new(&solution.mesh);
    let texels = LightmapTexels::new(&solution.mesh, QUADS * CELL);
    let groups = light_groups(solution);
    let traced = trace(solution, &groups, &texels, &tracer, &Progress::silent());
    LiveLight::assemble(solution, &texels, groups, traced)
}

fn relative(a: f32, b: f32) -> f32 {
    (a - b).abs() / b.abs().max(1e-6)
}

fn lights(factors: &[f32]) -> LightEdit {
    LightEdit {
        lights: factors.iter().map(|f| Vec3::splat(*f)).collect(),
        classes: BTreeMap::new(),
    }
}

/// In a closed box whose walls all emit M = πL and reflect ρ, E = M / (1 − ρ) everywhere; so too
/// after the walls' colour has been changed.
#[test]
fn a_furnace_is_as_bright_as_its_closed_form() {
    let mut quads = inside_of_box(Vec3::ZERO, Vec3::new(3.0, 2.5, 4.0), Vec3::splat(0.5));
    for quad in &mut quads {
        (quad.emission, quad.class) = (Vec3::ONE, 1);
    }
    let live = operator(&room(&quads));
    for factor in [1.0, 0.4, 1.5] {
        let edit = LightEdit {
            lights: Vec::new(),
            classes: BTreeMap::from([(1, Vec3::splat(factor))]),
        };
        // paint of roughness 1 reflects some hundredths specularly, too
        let specular = live.patches()[0].specular.x;
        assert!((0.005..0.1).contains(&specular), "{specular}");
        let expected = PI / (1.0 - 0.5 * factor - specular);
        let model = live.modelled(&edit);
        assert!(model.remainder < 2e-3 && (factor == 1.0 || model.bounces > 2));
        let mean =
            model.irradiance.iter().map(|e| e.x).sum::<f32>() / model.irradiance.len() as f32;
        assert!(
            relative(mean, expected) < 0.01,
            "{factor}: {mean} for {expected}"
        );
        let off = model
            .irradiance
            .iter()
            .map(|e| relative(e.x, expected).powi(2));
        let rms = (off.sum::<f32>() / model.irradiance.len() as f32).sqrt();
        assert!(rms < 0.04, "{rms}");
    }
}

/// Rows sum to 1 in a closed box; between its faces the form factors are those of the tables, and
/// reciprocal: A_i F_ij = A_j F_ji.
#[test]
fn form_factors_are_those_of_a_box() {
    let solution = room(&inside_of_box(
        Vec3::ZERO,
        Vec3::new(2.0, 1.0, 1.0),
        Vec3::ONE,
    ));
    let tracer = BruteForce::new(&solution.mesh);
    let texels = LightmapTexels::new(&solution.mesh, QUADS * CELL);
    let of_texels = divide(&solution, &texels, &tracer, 60);
    let links = links(&solution, &texels, &of_texels, &tracer, &Progress::silent()).links;
    let areas = areas(&texels);
    let patches = describe(&solution, &texels, &of_texels, &areas);
    assert!((40..=90).contains(&patches.len()), "{}", patches.len());
    let factors = FormFactors::of_links(&links, &of_texels, &areas, patches.len());
    let mut flux = [[0.0f32; 7]; 7];
    let mut area = [0.0f32; 7];
    for (i, patch) in patches.iter().enumerate() {
        let sum: f32 = factors.row(i).map(|(_, share)| share).sum();
        assert!((0.995..1.0001).contains(&sum), "row {i} sums to {sum}");
        let class = usize::from(patch.class);
        area[class] += patch.area;
        for (j, share) in factors.row(i) {
            assert_ne!(patches[j].class, patch.class, "a plane does not see itself");
            flux[class][usize::from(patches[j].class)] += patch.area * share;
        }
    }
    // opposite unit squares one or two metres apart, and 2:1 rectangles one metre apart: Hottel and
    // Sarofim 1967; squares at an edge
    for (from, to, expected) in [(1, 2, 0.0686), (3, 4, 0.2859), (1, 3, 0.2329)] {
        let found = flux[from][to] / area[from];
        assert!((found - expected).abs() < 0.012, "{from} to {to}: {found}");
    }
    for (i, row) in flux.iter().enumerate() {
        for (j, there) in row.iter().enumerate().filter(|(j, _)| *j < i) {
            let back = flux[j][i];
            assert!(relative(*there, back) < 0.08, "{i} {j}: {there} {back}");
        }
    }
    // with a face taken away, what it was seen by sums to less
    let open = room(&inside_of_box(Vec3::ZERO, Vec3::ONE, Vec3::ONE)[..5]);
    let tracer = BruteForce::new(&open.mesh);
    let texels = LightmapTexels::new(&open.mesh, QUADS * CELL);
    let of_texels = divide(&open, &texels, &tracer, 60);
    let links = super::links::links(&open, &texels, &of_texels, &tracer, &Progress::silent()).links;
    let areas = super::patches::areas(&texels);
    let patches = describe(&open, &texels, &of_texels, &areas);
    let factors = FormFactors::of_links(&links, &of_texels, &areas, patches.len());
    let opposite = patches.iter().position(|p| p.class == 5).expect("a patch");
    let sum: f32 = factors.row(opposite).map(|(_, share)| share).sum();
    assert!(sum < 0.9, "{sum}");
}

/// A room of 4 × 2.5 × 3 m with two lamps of unlike strength.
fn two_lamps() -> Solution {
    let mut quads = inside_of_box(
        Vec3::ZERO,
        Vec3::new(4.0, 2.5, 3.0),
        Vec3::new(0.7, 0.6, 0.5),
    );
    quads[2].albedo = Vec3::new(0.7, 0.2, 0.1);
    quads.push(lamp(Vec3::new(1.0, 2.4, 1.5)));
    quads.push(lamp(Vec3::new(3.0, 2.4, 1.5)));
    quads[7].emission = Vec3::new(2.0, 3.0, 8.0);
    room(&quads)
}

#[test]
fn lamps_add_up_and_the_base_is_kept() {
    let solution = two_lamps();
    let live = operator(&solution);
    assert_eq!(live.groups().len(), 2);
    let [one, other, both, twice] = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 2.0]]
        .map(|factors| live.modelled(&lights(&factors)).irradiance);
    for i in 0..both.len() {
        let sum = one[i] + other[i];
        assert!(sum.abs_diff_eq(both[i], 1e-4 * both[i].max_element()));
        assert!((2.0 * sum).abs_diff_eq(twice[i], 2e-4 * sum.max_element()));
    }
    // they light different halves in different colours
    assert!(one.iter().zip(&other).any(|(a, b)| a.x > 3.0 * b.x));
    assert_eq!(live.answer(&LightEdit::default()).irradiance, live.base());
    let scaled = live.answer(&lights(&[3.0, 3.0])).irradiance;
    let lit = |i: &usize| both[*i].min_element() > 0.0;
    for i in (0..scaled.len()).filter(lit) {
        assert!(scaled[i].abs_diff_eq(3.0 * live.base()[i], 1e-3), "{i}");
    }
    let dark = live.answer(&lights(&[0.0, 0.0])).irradiance;
    assert!((0..dark.len()).filter(lit).all(|i| dark[i] == Vec3::ZERO));
}

/// A change of a class's colour and of the lamps, against the path tracer.
#[test]
fn an_edit_is_what_the_path_tracer_says() {
    let solution = two_lamps();
    let live = operator(&solution);
    let tracer = BruteForce::new(&solution.mesh);
    let texels = LightmapTexels::new(&solution.mesh, QUADS * CELL);
    let groups = light_groups(&solution);
    let reference = Reference {
        solution: &solution,
        texels: &texels,
        groups: &groups,
        tracer: &tracer,
    };
    let edit = LightEdit {
        lights: vec![Vec3::new(1.0, 0.5, 0.2), Vec3::splat(1.5)],
        classes: BTreeMap::from([
            (3, Vec3::new(0.2, 3.0, 4.0)),
            (1, Vec3::splat(0.3)),
            (4, Vec3::splat(1.3)),
        ]),
    };
    // the walls and the floor, not the corners behind the lamps
    let chosen: Vec<usize> = (0..texels.points().len())
        .filter(|i| texels.texels().interior[*i] && texels.points()[*i].position.y < 2.3)
        .step_by(7)
        .collect();
    let truth = reference.irradiance(&edit, &chosen, 512, 1);
    let unedited = reference.irradiance(&LightEdit::default(), &chosen, 512, 2);
    let off = |of: &[Vec3]| {
        let (mut wrong, mut all) = (0.0, 0.0);
        for (&i, t) in chosen.iter().zip(of) {
            let model = live.modelled(&edit).irradiance[i];
            wrong += (luminance(model) - luminance(*t)).powi(2);
            all += luminance(*t).powi(2);
        }
        (wrong / all).sqrt()
    };
    assert!(off(&truth) < 0.05, "{}", off(&truth));
    assert!(
        off(&unedited) > 0.15,
        "the edit does something: {}",
        off(&unedited)
    );
    let error = reference.error(&live);
    assert!(error.model > 0.0 && error.model < 0.06, "{error:?}");
}

/// Two rooms with a wall of two centimetres between them on one floor: no light comes through, though
/// floor and ceiling are one chart and cells of the grid straddle the wall.
#[test]
fn no_light_goes_through_a_wall() {
    let mut quads = inside_of_box(Vec3::ZERO, Vec3::new(4.0, 2.5, 3.0), Vec3::splat(0.8));
    let wall = |x: f32, edges: [Vec3; 2]| Quad {
        corner: Vec3::new(x, 0.0, 0.0),
        edges,
        class: 7,
        ..quads[0]
    };
    let (y, z) = (Vec3::Y * 2.5, Vec3::Z * 3.0);
    let walls = [wall(2.01, [y, z]), wall(1.99, [z, y])];
    quads.extend(walls);
    quads.push(lamp(Vec3::new(1.0, 2.4, 1.5)));
    let solution = room(&quads);
    let live = operator(&solution);
    let texels = LightmapTexels::new(&solution.mesh, QUADS * CELL);
    let edit = LightEdit {
        lights: vec![Vec3::splat(2.0)],
        classes: BTreeMap::from([(3, Vec3::splat(1.2))]),
    };
    let model = live.modelled(&edit).irradiance;
    let (mut lit, mut dark) = (0, 0);
    for (e, point) in model.iter().zip(texels.points()) {
        if point.position.x > 2.05 || (point.position.x > 2.005 && point.normal.x > 0.5) {
            assert_eq!(*e, Vec3::ZERO, "at {}", point.position);
            dark += 1;
        } else if point.position.x < 1.9 {
            lit += usize::from(e.x > 0.1);
        }
    }
    assert!(lit > 300 && dark > 300, "{lit} {dark}");
}

#[test]
fn the_file_is_used_while_it_is_whole_and_of_the_same_result() {
    let folder = tempfile::tempdir().expect("temp");
    let mut solution = two_lamps();
    let tracer = BruteForce::new(&solution.mesh);
    let open = |s: &Solution| open_or_build(s, Some(folder.path()), &tracer, &Progress::silent());
    let edit = LightEdit {
        lights: vec![Vec3::splat(0.5)],
        classes: BTreeMap::from([(1, Vec3::splat(0.5))]),
    };
    let built = open(&solution);
    let file = folder.path().join(OPERATOR);
    let bytes = std::fs::read(&file).expect("kept");
    let read = open(&solution);
    assert_eq!(
        built.answer(&edit).irradiance,
        read.answer(&edit).irradiance
    );
    assert_eq!(built.error(), read.error());
    assert!(built.error().relative > 0.0);
    // damaged, cut short, empty: traced anew, to the same bytes
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 1;
    for wrong in [&damaged[..], &bytes[..bytes.len() / 2], &[]] {
        std::fs::write(&file, wrong).expect("writes");
        let again = open(&solution);
        assert_eq!(
            again.answer(&edit).irradiance,
            built.answer(&edit).irradiance
        );
        assert_eq!(std::fs::read(&file).expect("kept"), bytes);
    }
    // of another result
    solution.albedo.data[0] = Vec3::splat(0.123);
    let _ = open(&solution);
    assert_ne!(std::fs::read(&file).expect("kept"), bytes);
    // a folder that cannot be written to is no failure
    let nowhere = folder.path().join("nowhere");
    let live = open_or_build(&solution, Some(&nowhere), &tracer, &Progress::silent());
    assert!(!live.cells().is_empty());
}

/// What a lighting file does to lamps and sky, as factors on the groups; what it adds or moves has
/// none.
#[test]
fn lightings_are_factors_where_they_change_no_geometry() {
    let solution = two_lamps();
    let groups = light_groups(&solution);
    let factors = |lighting: &Lighting| {
        let mut world = EditableScene::new(&solution);
        lighting
            .apply(&mut world, &solution.lamps)
            .expect("applies");
        factors_of(&world, &solution, &groups)
    };
    let change = LampChange {
        group: Some(2),
        scale: Some(0.5),
        colour: Some([1.0, 0.5, 0.0]),
        ..LampChange::default()
    };
    let mut lighting = Lighting {
        lamps: vec![change],
        ..Lighting::default()
    };
    let found = factors(&lighting).expect("factors");
    assert_eq!(found.len(), 2);
    assert!(found[0].abs_diff_eq(Vec3::ONE, 1e-5));
    assert!(found[1].abs_diff_eq(Vec3::new(0.5, 0.25, 0.0), 1e-5));
    lighting.lamps[0].shift = Some([0.0, -0.1, 0.0]);
    assert_eq!(factors(&lighting), None);
    lighting.lamps.clear();
    lighting.environment.constant = Some([1.0; 3]);
    assert_eq!(factors(&lighting), None);
}

#[test]
fn a_scene_without_lights_stays_as_it_is() {
    let solution = room(&inside_of_box(Vec3::ZERO, Vec3::ONE, Vec3::splat(0.5)));
    let live = operator(&solution);
    assert_eq!(live.groups(), &[] as &[LightGroup]);
    let edit = LightEdit {
        lights: vec![Vec3::splat(3.0)],
        classes: BTreeMap::from([(1, Vec3::splat(0.1))]),
    };
    assert_eq!(live.answer(&edit).irradiance, live.base());
}
