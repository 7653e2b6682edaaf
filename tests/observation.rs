//! What views see of a surface: clean pixels, visibility, orientation, and the fusion of many looks into one radiance.

mod common;

use common::lit::{Quad, box_quads, mesh_of};
use glam::{Mat3, Quat, Vec3};
use unbake::gbuffer::{Observation, ObservedView, Observer, Orientation, ViewBuffer};
use unbake::geometry::{Camera, Lens, Mesh, Projection};
use unbake::image::Plane;
use unbake::lighting::{Fusion, UNSEEN, fuse_radiance};
use unbake::math::luminance;
use unbake::progress::Progress;
use unbake::sampling::KeyedRng;
use unbake::texture::Texels;
use unbake::trace::{BruteForce, EmbreeTracer, Hit, Ray, Tracer};

/// A room with a solid block in it; each quad has a radiance of its own.
fn room() -> Vec<Quad> {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 1.0);
    quads.extend(box_quads(Vec3::new(1.5, 0.0, 2.0), Vec3::new(2.5, 1.2, 3.0), 1.0).into_iter().map(Quad::flipped));
    for (i, q) in quads.iter_mut().enumerate() {
        q.radiance = Vec3::new(0.5 + 0.1 * i as f32, 1.0, 1.5 - 0.1 * i as f32);
    }
    quads
}

fn panorama(position: Vec3, width: usize) -> Camera {
    let projection = Projection::Equirectangular;
    Camera { projection, width, height: width / 2, world_from_camera: Mat3::from_rotation_y(0.4), position }
}

fn pinhole(position: Vec3) -> Camera {
    let lens = Lens { fl_x: 120.0, fl_y: 120.0, cx: 96.0, cy: 64.0, k: [0.0; 2], p: [0.0; 2] };
    let world_from_camera = Mat3::from_quat(Quat::from_rotation_y(0.7));
    Camera { projection: Projection::Pinhole(lens), width: 192, height: 128, world_from_camera, position }
}

fn cameras() -> Vec<Camera> {
    vec![
        panorama(Vec3::new(0.7, 1.4, 0.8), 256),
        panorama(Vec3::new(3.3, 1.6, 1.0), 256),
        panorama(Vec3::new(3.2, 1.5, 4.2), 256),
        panorama(Vec3::new(0.6, 1.7, 4.3), 256),
        pinhole(Vec3::new(2.0, 1.5, 4.5)),
    ]
}

/// A photograph: every pixel shows the radiance of its quad, `taken` from a camera that may differ from the stated one.
fn photograph(mesh: &Mesh, quads: &[Quad], tracer: &dyn Tracer, stated: Camera, taken: Camera) -> ObservedView {
    let seen = ViewBuffer::trace(&taken, tracer);
    let radiance = seen.triangle.map(|t| if *t == Hit::MISS { Vec3::ZERO } else { quads[*t as usize / 2].radiance });
    let buffer = ViewBuffer::trace(&stated, tracer);
    let clean = buffer.clean_pixels(mesh, None);
    ObservedView { buffer, radiance, clean, labels: None, valid: None }
}

#[test]
fn clean_pixels_have_all_neighbours_on_their_own_wall() {
    let quads = room();
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    for camera in cameras() {
        let b = ViewBuffer::trace(&camera, &tracer);
        let clean = b.clean_pixels(&mesh, None);
        let (w, h) = (camera.width as i64, camera.height as i64);
        let wraps = camera.projection == Projection::Equirectangular;
        let (mut yes, mut no) = (0, 0);
        for y in 0..h {
            for x in 0..w {
                let wall = |x: i64, y: i64| {
                    let x = if wraps { x.rem_euclid(w) } else { x };
                    let inside = x >= 0 && x < w && y >= 0 && y < h;
                    inside.then(|| b.triangle[(x as usize, y as usize)] / 2)
                };
                let own = wall(x, y).expect("inside");
                let alone = (-1..=1).any(|dy| (-1..=1).any(|dx| wall(x + dx, y + dy).is_some_and(|o| o != own)));
                assert_eq!(clean[(x as usize, y as usize)], !alone, "pixel {x}, {y}");
                *(if alone { &mut no } else { &mut yes }) += 1;
            }
        }
        assert!(yes > 10_000 && no > 500, "{yes} {no}");
        // a border between labels counts as an edge, at any resolution of the labels
        let halves = Plane { width: 4, height: 2, data: vec![1u16, 1, 2, 2, 1, 1, 2, 2] };
        let split = b.clean_pixels(&mesh, Some(&halves));
        for y in 0..h as usize {
            let middle = w as usize / 2;
            assert!(!split[(middle - 1, y)] && !split[(middle, y)]);
        }
    }
}

/// Points spread over all quads with their normals.
fn points(quads: &[Quad], count: usize) -> Vec<(usize, Vec3, Vec3)> {
    let mut rng = KeyedRng::new(8, 1);
    (0..count)
        .map(|i| {
            let q = i % quads.len();
            (q, quads[q].at(rng.next_f32(), rng.next_f32()), quads[q].normal())
        })
        .collect()
}

#[test]
fn visibility_is_that_of_brute_force() {
    let quads = room();
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let brute = BruteForce::new(&mesh);
    let views: Vec<ObservedView> = cameras().into_iter().map(|c| photograph(&mesh, &quads, &tracer, c, c)).collect();
    let observer = Observer { mesh: &mesh, views: &views };
    let (mut seen, mut missed, mut invented, mut clean, mut hidden_count) = (0, 0, 0, 0, 0);
    let mut found: Vec<Observation> = Vec::new();
    for (q, p, n) in points(&quads, 6_000) {
        observer.observe(p, n, &mut found);
        for (v, view) in views.iter().enumerate() {
            let camera = &view.buffer.camera;
            let d = camera.position - p;
            let n_v = n.dot(d.normalize());
            let mut hidden = [0u8];
            brute.occluded(&[Ray::new(p + n * 1e-4, d.normalize(), d.length() * 0.999)], &mut hidden);
            let visible = hidden[0] == 0 && n_v > 0.05 && camera.project(p).is_some();
            let here = found.iter().find(|o| o.view as usize == v);
            match here {
                Some(o) => {
                    invented += usize::from(!visible && n_v > 0.05);
                    // a clean look shows the point's own wall, to the last bits of the interpolation
                    if o.clean {
                        clean += 1;
                        assert!((o.radiance - quads[q].radiance).abs().max_element() < 1e-5, "{p} in view {v}: {}", o.radiance);
                    }
                    assert!((o.n_v - n_v).abs() < 1e-4 && o.footprint > 0.0 && o.footprint.is_finite());
                }
                None => missed += usize::from(visible),
            }
            seen += usize::from(visible);
            hidden_count += usize::from(!visible);
        }
    }
    println!("{seen} visible, {missed} missed, {hidden_count} hidden, {invented} invented, {clean} clean looks");
    assert!(seen > 8_000 && hidden_count > 2_000);
    assert!(missed * 50 < seen, "{missed} of {seen} visible points are missed");
    assert!(invented * 100 < hidden_count, "{invented} of {hidden_count} hidden points are seen");
    assert!(clean * 2 > seen, "{clean} of {seen} looks are clean");
}

/// Poses wrong by a few millimetres: clean looks may show another wall only within the error of an edge.
/// The wall behind a picture that hangs a millimetre before it is as hidden as one a metre behind.
#[test]
fn a_layer_hides_what_lies_right_behind_it() {
    let mut quads = room();
    let wall = 0;
    let part = |from: f32, to: f32| Quad {
        corner: quads[wall].at(from, from) + quads[wall].normal() * 1e-3,
        edge_u: quads[wall].edge_u * (to - from),
        edge_v: quads[wall].edge_v * (to - from),
        radiance: Vec3::splat(9.0),
        emits: false,
    };
    let front = part(0.05, 0.3);
    quads.push(front);
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let views: Vec<ObservedView> = cameras().into_iter().map(|c| photograph(&mesh, &quads, &tracer, c, c)).collect();
    let observer = Observer { mesh: &mesh, views: &views };
    let (mut looks, mut seen) = (Vec::new(), [0, 0]);
    for k in 0..400u32 {
        let [u, v] = unbake::sampling::hammersley(k, 400);
        let (u, v) = (0.1 + 0.8 * u, 0.1 + 0.8 * v);
        observer.observe(front.at(u, v), front.normal(), &mut looks);
        seen[0] += looks.len();
        observer.observe(front.at(u, v) - front.normal() * 1e-3, front.normal(), &mut looks);
        seen[1] += looks.len();
    }
    assert!(seen[0] > 800, "the picture is seen {} times", seen[0]);
    assert_eq!(seen[1], 0, "the wall behind it is not");
}

#[test]
fn small_errors_of_pose_hardly_mix_surfaces() {
    let quads = room();
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let views: Vec<ObservedView> = cameras()
        .into_iter()
        .map(|c| {
            let shifted = Camera {
                position: c.position + Vec3::new(0.004, -0.003, 0.005),
                world_from_camera: c.world_from_camera * Mat3::from_rotation_x(0.003),
                ..c
            };
            photograph(&mesh, &quads, &tracer, c, shifted)
        })
        .collect();
    let observer = Observer { mesh: &mesh, views: &views };
    let (mut wrong, mut all) = (0, 0);
    let mut found = Vec::new();
    for (q, p, n) in points(&quads, 4_000) {
        observer.observe(p, n, &mut found);
        for o in found.iter().filter(|o| o.clean) {
            all += 1;
            wrong += usize::from((o.radiance - quads[q].radiance).abs().max_element() > 0.01);
        }
    }
    println!("{wrong} of {all}");
    assert!(all > 5_000 && wrong * 200 < all, "{wrong} of {all} clean looks show another wall");
}

#[test]
fn orientation_is_what_the_cameras_see() {
    let mut quads = room();
    let mut expected = vec![1.0f32; quads.len()];
    for i in [1usize, 4, 7] {
        quads[i] = quads[i].flipped();
        expected[i] = -1.0;
    }
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let buffers: Vec<ViewBuffer> = cameras().iter().map(|c| ViewBuffer::trace(c, &tracer)).collect();
    let orientation = Orientation::vote(&mesh, &buffers.iter().collect::<Vec<_>>());
    for (q, sign) in expected.iter().enumerate() {
        // the block's underside lies on the floor: nobody sees it, it keeps its winding
        assert_eq!((orientation.sign(2 * q), orientation.sign(2 * q + 1)), (*sign, *sign), "quad {q}");
    }
    assert_eq!(orientation.flipped(), 6);
    assert_eq!(Orientation::vote(&mesh, &[]).flipped(), 0);
}

fn fuse(quads: &[Quad], views: &[ObservedView], mesh: &Mesh, side: usize) -> (Texels, Fusion) {
    let texels = Texels::rasterize(mesh, side, side);
    let orientation = Orientation::of_winding(mesh.triangles.len());
    let fusion = fuse_radiance(&Observer { mesh, views }, &orientation, &texels, &Progress::silent());
    assert_eq!(fusion.radiance.len(), texels.len());
    assert!(fusion.radiance.iter().all(|r| r.is_finite() && r.min_element() >= 0.0));
    assert!(quads.len() * 2 == mesh.triangles.len());
    (texels, fusion)
}

/// One of five views sees a highlight twenty times as bright on half of everything: what three or more views see stays.
#[test]
fn a_highlight_in_one_view_does_not_become_light() {
    let quads = room();
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let mut views: Vec<ObservedView> = cameras()[..4].iter().map(|c| photograph(&mesh, &quads, &tracer, *c, *c)).collect();
    views[1].radiance.data.iter_mut().enumerate().for_each(|(i, p)| *p *= if i % 256 < 128 { 20.0 } else { 1.0 });
    let (texels, fusion) = fuse(&quads, &views, &mesh, 128);
    let (mut checked, mut lowest) = (0, 0);
    for i in 0..texels.len() {
        let truth = luminance(quads[texels.point[i].triangle as usize / 2].radiance);
        if fusion.clean[i] && fusion.views[i] >= 3 {
            let got = luminance(fusion.radiance[i]);
            assert!((got / truth - 1.0).abs() < 0.1, "texel {i}: {got} against {truth} from {} views", fusion.views[i]);
            checked += 1;
        }
        if fusion.clean[i] && fusion.views[i] >= 2 {
            assert!((fusion.floor[i] / truth - 1.0).abs() < 1e-3, "the darkest look is free of the highlight");
            lowest += 1;
        }
    }
    assert!(checked > 2_000 && lowest > checked, "{checked} {lowest}");
}

#[test]
fn unseen_texels_say_so() {
    let quads = room();
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let mut views: Vec<ObservedView> = cameras().iter().map(|c| photograph(&mesh, &quads, &tracer, *c, *c)).collect();
    for v in &mut views {
        v.labels = Some(v.buffer.triangle.map(|t| (*t / 2) as u16 + 100));
    }
    let (texels, fusion) = fuse(&quads, &views, &mesh, 128);
    let mut under = 0;
    for i in 0..texels.len() {
        let quad = texels.point[i].triangle as usize / 2;
        if quad == 6 {
            // the block's underside
            assert_eq!((fusion.views[i], fusion.label[i], fusion.radiance[i]), (0, UNSEEN, Vec3::ZERO));
            under += 1;
        } else if fusion.clean[i] {
            assert_eq!(fusion.label[i] as usize, quad + 100, "texel {i}");
        }
    }
    assert!(under > 50);
    // no view at all, and views masked altogether
    let (_, none) = fuse(&quads, &[], &mesh, 32);
    assert!(none.views.iter().all(|v| *v == 0) && none.label.iter().all(|l| *l == UNSEEN));
    for v in &mut views {
        v.valid = Some(v.clean.map(|_| false));
    }
    let (_, masked) = fuse(&quads, &views, &mesh, 32);
    assert!(masked.views.iter().all(|v| *v == 0) && masked.radiance.iter().all(|r| *r == Vec3::ZERO));
}
