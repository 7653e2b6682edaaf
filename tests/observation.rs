//! What views see of a surface: clean pixels, visibility, orientation, and the fusion of many looks
//! into one radiance.

mod common;

use common::lit::{Quad, box_quads, mesh_of};
use glam::{Mat3, Quat, Vec3};
use unbake::core::geometry::{Camera, Lens, Mesh, Projection};
use unbake::core::image::Plane;
use unbake::core::math::luminance;
use unbake::core::progress::Progress;
use unbake::core::sampling::KeyedRng;
use unbake::core::texture::Texels;
use unbake::core::trace::{BruteForce, EmbreeTracer, Hit, Ray, Tracer};
use unbake::gbuffer::{Observation, ObservedView, Observer, Orientation, ViewBuffer};
use unbake::observed::estimate_gains;
use unbake::observed::{Fusion, UNSEEN, fuse_radiance};

/// A room with a solid block in it; each quad has a radiance of its own.
fn room() -> Vec<Quad> {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 1.0);
    quads.extend(
        box_quads(Vec3::new(1.5, 0.0, 2.0), Vec3::new(2.5, 1.2, 3.0), 1.0)
            .into_iter()
            .map(Quad::flipped),
    );
    for (i, q) in quads.iter_mut().enumerate() {
        q.radiance = Vec3::new(0.5 + 0.1 * i as f32, 1.0, 1.5 - 0.1 * i as f32);
    }
    quads
}

fn panorama(position: Vec3, width: usize) -> Camera {
    let projection = Projection::Equirectangular;
    Camera {
        projection,
        width,
        height: width / 2,
        world_from_camera: Mat3::from_rotation_y(0.4),
        position,
    }
}

fn pinhole(position: Vec3) -> Camera {
    let lens = Lens {
        fl_x: 120.0,
        fl_y: 120.0,
        cx: 96.0,
        cy: 64.0,
        k: [0.0; 2],
        p: [0.0; 2],
    };
    let world_from_camera = Mat3::from_quat(Quat::from_rotation_y(0.7));
    Camera {
        projection: Projection::Pinhole(lens),
        width: 192,
        height: 128,
        world_from_camera,
        position,
    }
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

/// A photograph: every pixel shows the radiance of its quad, `taken` from a camera that may differ
/// from the stated one.
fn photograph(
    mesh: &Mesh,
    quads: &[Quad],
    tracer: &dyn Tracer,
    stated: Camera,
    taken: Camera,
) -> ObservedView {
    let seen = ViewBuffer::trace(&taken, tracer);
    let radiance = seen.triangle.map(|t| {
        if *t == Hit::MISS {
            Vec3::ZERO
        } else {
            quads[*t as usize / 2].radiance
        }
    });
    let buffer = ViewBuffer::trace(&stated, tracer);
    let clean = buffer.clean_pixels(mesh, None);
    ObservedView {
        buffer,
        radiance,
        clean,
        labels: None,
        valid: None,
    }
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
                let alone = (-1..=1)
                    .any(|dy| (-1..=1).any(|dx| wall(x + dx, y + dy).is_some_and(|o| o != own)));
                assert_eq!(clean[(x as usize, y as usize)], !alone, "pixel {x}, {y}");
                *(if alone { &mut no } else { &mut yes }) += 1;
            }
        }
        assert!(yes > 10_000 && no > 500, "{yes} {no}");
        // a border between labels counts as an edge, at any resolution of the labels
        let halves = Plane {
            width: 4,
            height: 2,
            data: vec![1u16, 1, 2, 2, 1, 1, 2, 2],
        };
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
            (
                q,
                quads[q].at(rng.next_f32(), rng.next_f32()),
                quads[q].normal(),
            )
        })
        .collect()
}

#[test]
fn visibility_is_that_of_brute_force() {
    let quads = room();
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let brute = BruteForce::new(&mesh);
    let views: Vec<ObservedView> = cameras()
        .into_iter()
        .map(|c| photograph(&mesh, &quads, &tracer, c, c))
        .collect();
    let observer = Observer {
        mesh: &mesh,
        views: &views,
    };
    let (mut seen, mut missed, mut invented, mut clean, mut hidden_count) = (0, 0, 0, 0, 0);
    let mut found: Vec<Observation> = Vec::new();
    for (q, p, n) in points(&quads, 6_000) {
        observer.observe(p, n, &mut found);
        for (v, view) in views.iter().enumerate() {
            let camera = &view.buffer.camera;
            let d = camera.position - p;
            let n_v = n.dot(d.normalize());
            let mut hidden = [0u8];
            brute.occluded(
                &[Ray::new(p + n * 1e-4, d.normalize(), d.length() * 0.999)],
                &mut hidden,
            );
            let visible = hidden[0] == 0 && n_v > 0.05 && camera.project(p).is_some();
            let here = found.iter().find(|o| o.view as usize == v);
            match here {
                Some(o) => {
                    invented += usize::from(!visible && n_v > 0.05);
                    // a clean look shows the point's own wall, to the last bits of the
                    // interpolation
                    if o.clean {
                        clean += 1;
                        assert!(
                            (o.radiance - quads[q].radiance).abs().max_element() < 1e-5,
                            "{p} in view {v}: {}",
                            o.radiance
                        );
                    }
                    assert!(
                        (o.n_v - n_v).abs() < 1e-4 && o.footprint > 0.0 && o.footprint.is_finite()
                    );
                }
                None => missed += usize::from(visible),
            }
            seen += usize::from(visible);
            hidden_count += usize::from(!visible);
        }
    }
    println!(
        "{seen} visible, {missed} missed, {hidden_count} hidden, {invented} invented, {clean} clean looks"
    );
    assert!(seen > 8_000 && hidden_count > 2_000);
    assert!(
        missed * 50 < seen,
        "{missed} of {seen} visible points are missed"
    );
    assert!(
        invented * 100 < hidden_count,
        "{invented} of {hidden_count} hidden points are seen"
    );
    assert!(clean * 2 > seen, "{clean} of {seen} looks are clean");
}

/// A beam under the ceiling, seen from afar: its upright side is a few pixels high, and none of
/// them is the ceiling that it hides.
#[test]
fn a_beam_does_not_lend_its_side_to_the_ceiling_behind() {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(20.0, 2.7, 4.0), 1.0);
    let beam = box_quads(Vec3::new(10.0, 2.52, 0.0), Vec3::new(10.3, 2.7, 4.0), 5.0);
    quads.extend(beam.into_iter().map(Quad::flipped));
    let ceiling = quads[1];
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let views: Vec<ObservedView> = [1.5, 2.2, 3.0, 17.0, 18.1, 19.0]
        .into_iter()
        .map(|x| panorama(Vec3::new(x, 1.5, 2.1), 1024))
        .map(|c| photograph(&mesh, &quads, &tracer, c, c))
        .collect();
    let observer = Observer {
        mesh: &mesh,
        views: &views,
    };
    let (mut looks, mut clean) = (Vec::new(), 0);
    for k in 0..4000u32 {
        let [u, v] = unbake::core::sampling::hammersley(k, 4000);
        let x = if k % 2 == 0 {
            9.4 + 0.6 * u
        } else {
            10.3 + 0.6 * u
        };
        observer.observe(Vec3::new(x, 2.7, 4.0 * v), ceiling.normal(), &mut looks);
        for look in looks.iter().filter(|o| o.clean) {
            clean += 1;
            assert_eq!(look.radiance, ceiling.radiance, "{look:?} at {x}");
        }
    }
    assert!(clean > 1000, "{clean} clean looks");
}

/// Poses wrong by a few millimetres: clean looks may show another wall only within the error of an
/// edge. The wall behind a picture that hangs a millimetre before it is as hidden as one a metre
/// behind.
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
    let views: Vec<ObservedView> = cameras()
        .into_iter()
        .map(|c| photograph(&mesh, &quads, &tracer, c, c))
        .collect();
    let observer = Observer {
        mesh: &mesh,
        views: &views,
    };
    let (mut looks, mut seen) = (Vec::new(), [0, 0]);
    for k in 0..400u32 {
        let [u, v] = unbake::core::sampling::hammersley(k, 400);
        let (u, v) = (0.1 + 0.8 * u, 0.1 + 0.8 * v);
        observer.observe(front.at(u, v), front.normal(), &mut looks);
        seen[0] += looks.len();
        observer.observe(
            front.at(u, v) - front.normal() * 1e-3,
            front.normal(),
            &mut looks,
        );
        seen[1] += looks.len();
    }
    assert!(seen[0] > 800, "the picture is seen {} times", seen[0]);
    assert_eq!(seen[1], 0, "the wall behind it is not");
}

/// A frame right behind a lamp's field may be seen by its rim; it is then called what the rim is, not
/// the lamp that hides it.
#[test]
fn what_is_hidden_takes_no_label_of_what_hides_it() {
    const FRAME: u16 = 1;
    const LAMP: u16 = 2;
    let mut quads = room();
    let wall = quads[0];
    let field = Quad {
        corner: wall.at(0.3, 0.3) + wall.normal() * 1e-3,
        edge_u: wall.edge_u * 0.4,
        edge_v: wall.edge_v * 0.4,
        radiance: Vec3::splat(9.0),
        emits: false,
    };
    let of_field = quads.len() as u32;
    quads.push(field);
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let views: Vec<ObservedView> = cameras()
        .into_iter()
        .map(|c| {
            let mut view = photograph(&mesh, &quads, &tracer, c, c);
            let class = |t: &u32| if t / 2 == of_field { LAMP } else { FRAME };
            view.labels = Some(view.buffer.triangle.map(class));
            view
        })
        .collect();
    let observer = Observer {
        mesh: &mesh,
        views: &views,
    };
    let (mut looks, mut seen, mut of_lamp) = (Vec::new(), 0, 0);
    for k in 0..4000u32 {
        let [u, v] = unbake::core::sampling::hammersley(k, 4000);
        let hidden = field.at(u, v) - field.normal() * 1e-3;
        observer.observe(hidden, field.normal(), &mut looks);
        seen += looks.len();
        of_lamp += looks.iter().filter(|o| o.label == LAMP).count();
    }
    assert!(seen > 20, "the rim is seen beside the field {seen} times");
    assert_eq!(of_lamp, 0, "of {seen}");
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
    let observer = Observer {
        mesh: &mesh,
        views: &views,
    };
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
    assert!(
        all > 5_000 && wrong * 200 < all,
        "{wrong} of {all} clean looks show another wall"
    );
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
    let buffers: Vec<ViewBuffer> = cameras()
        .iter()
        .map(|c| ViewBuffer::trace(c, &tracer))
        .collect();
    let orientation = Orientation::vote(&mesh, &buffers.iter().collect::<Vec<_>>());
    for (q, sign) in expected.iter().enumerate() {
        // the block's underside lies on the floor: nobody sees it, it keeps its winding
        assert_eq!(
            (orientation.sign(2 * q), orientation.sign(2 * q + 1)),
            (*sign, *sign),
            "quad {q}"
        );
    }
    assert_eq!(orientation.flipped(), 6);
    assert_eq!(Orientation::vote(&mesh, &[]).flipped(), 0);
}

fn fuse(quads: &[Quad], views: &[ObservedView], mesh: &Mesh, side: usize) -> (Texels, Fusion) {
    let texels = Texels::rasterize(mesh, side, side);
    let orientation = Orientation::of_winding(mesh.triangles.len());
    let fusion = fuse_radiance(
        &Observer { mesh, views },
        &orientation,
        &texels,
        &Progress::silent(),
    );
    assert_eq!(fusion.radiance.len(), texels.len());
    assert!(
        fusion
            .radiance
            .iter()
            .all(|r| r.is_finite() && r.min_element() >= 0.0)
    );
    assert!(quads.len() * 2 == mesh.triangles.len());
    (texels, fusion)
}

/// One of four views sees a highlight twenty times as bright on half of everything: what another
/// view sees as well stays.
#[test]
fn a_highlight_in_one_view_does_not_become_light() {
    let quads = room();
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let mut views: Vec<ObservedView> = cameras()[..4]
        .iter()
        .map(|c| photograph(&mesh, &quads, &tracer, *c, *c))
        .collect();
    views[1]
        .radiance
        .data
        .iter_mut()
        .enumerate()
        .for_each(|(i, p)| *p *= if i % 256 < 128 { 20.0 } else { 1.0 });
    let (texels, fusion) = fuse(&quads, &views, &mesh, 128);
    let (mut checked, mut pairs) = (0, 0);
    for i in 0..texels.len() {
        let truth = luminance(quads[texels.point[i].triangle as usize / 2].radiance);
        if fusion.clean[i] && fusion.views[i] >= 2 {
            let got = luminance(fusion.radiance[i]);
            assert!(
                (got / truth - 1.0).abs() < 0.1,
                "texel {i}: {got} against {truth} from {} views",
                fusion.views[i]
            );
            checked += 1;
            pairs += usize::from(fusion.views[i] == 2);
            assert!(
                (fusion.floor[i] / truth - 1.0).abs() < 1e-3,
                "the darkest look is free of the highlight"
            );
        }
    }
    assert!(checked > 2_000 && pairs > 100, "{checked} {pairs}");
}

#[test]
fn unseen_texels_say_so() {
    let quads = room();
    let mesh = mesh_of(&quads);
    let tracer = EmbreeTracer::new(&mesh).expect("Embree");
    let mut views: Vec<ObservedView> = cameras()
        .iter()
        .map(|c| photograph(&mesh, &quads, &tracer, *c, *c))
        .collect();
    for v in &mut views {
        v.labels = Some(v.buffer.triangle.map(|t| (*t / 2) as u16 + 100));
    }
    let (texels, fusion) = fuse(&quads, &views, &mesh, 128);
    let mut under = 0;
    for i in 0..texels.len() {
        let quad = texels.point[i].triangle as usize / 2;
        if quad == 6 {
            // the block's underside
            assert_eq!(
                (fusion.views[i], fusion.label[i], fusion.radiance[i]),
                (0, UNSEEN, Vec3::ZERO)
            );
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
    assert!(
        masked.views.iter().all(|v| *v == 0) && masked.radiance.iter().all(|r| *r == Vec3::ZERO)
    );
}

/// Paint from dark to bright, a wall ten times its neighbour, with a gentle pattern on it.
fn paint(quad: usize, p: Vec3) -> Vec3 {
    let base = [0.2, 2.0, 0.5, 1.2, 0.3, 0.8, 0.6, 1.5, 0.25, 1.0, 0.4, 0.7][quad % 12];
    base * Vec3::new(
        1.0 + 0.1 * (2.0 * p.x + p.y).sin(),
        1.0 + 0.1 * (2.0 * p.z).cos(),
        1.0 - 0.1 * (1.5 * p.y - p.z).sin(),
    )
}

/// Photographs by four cameras of the painted surfaces of `real`, looked up on the stated mesh.
fn painted(real: &[Quad], stated: &Mesh, shade: impl Fn(usize, Vec3) -> Vec3) -> Vec<ObservedView> {
    let real = EmbreeTracer::new(&mesh_of(real)).expect("Embree");
    let tracer = EmbreeTracer::new(stated).expect("Embree");
    let view = |camera: &Camera| {
        let seen = ViewBuffer::trace(camera, &real);
        let (w, h) = (camera.width, camera.height);
        let shade = |i: usize| match seen.triangle.data[i] {
            Hit::MISS => Vec3::ZERO,
            t => shade(t as usize / 2, seen.position(i % w, i / w)),
        };
        let radiance = Plane {
            width: w,
            height: h,
            data: (0..w * h).map(shade).collect(),
        };
        let buffer = ViewBuffer::trace(camera, &tracer);
        let clean = buffer.clean_pixels(stated, None);
        ObservedView {
            buffer,
            radiance,
            clean,
            labels: None,
            valid: None,
        }
    };
    cameras()[..4].iter().map(view).collect()
}

/// Relative errors of the fused radiance of clean texels against the paint: root mean square, 99 %
/// quantile, worst.
fn off_paint(fusion: &Fusion, texels: &Texels, mesh: &Mesh) -> [f32; 3] {
    let off = |i: usize| {
        let truth = paint(
            texels.point[i].triangle as usize / 2,
            texels.position(mesh, i),
        );
        ((fusion.radiance[i] - truth) / truth).abs().max_element()
    };
    let mut all: Vec<f32> = (0..texels.len())
        .filter(|&i| fusion.clean[i])
        .map(off)
        .collect();
    assert!(all.len() > 4_000, "{} clean texels", all.len());
    all.sort_by(f32::total_cmp);
    let rms = (all.iter().map(|e| e * e).sum::<f32>() / all.len() as f32).sqrt();
    [rms, all[all.len() * 99 / 100], all[all.len() - 1]]
}

/// One view's image lies a pixel beside its geometry, beside walls ten times as bright.
#[test]
fn a_view_off_by_a_pixel_hardly_changes_the_fused_radiance() {
    let quads = room();
    let mesh = mesh_of(&quads);
    let views = painted(&quads, &mesh, paint);
    let error = |views: &[ObservedView]| {
        let (texels, fusion) = fuse(&quads, views, &mesh, 128);
        off_paint(&fusion, &texels, &mesh)
    };
    let still = error(&views);
    println!("registered: {still:.4?}");
    assert!(still[0] < 0.005 && still[2] < 0.03, "{still:?}");
    for (v, (dx, dy)) in [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1)]
        .into_iter()
        .enumerate()
    {
        let mut shifted = views.clone();
        let image = &views[v % 4].radiance;
        let (w, h) = (image.width as i32, image.height as i32);
        let from =
            |i: i32| ((i % w + dx).rem_euclid(w) + w * (i / w + dy).clamp(0, h - 1)) as usize;
        shifted[v % 4].radiance.data = (0..w * h).map(|i| image.data[from(i)]).collect();
        let moved = error(&shifted);
        println!("view {} by ({dx}, {dy}): {moved:.4?}", v % 4);
        assert!(
            moved[0] < 0.01 && moved[1] < 0.03 && moved[2] < 0.15,
            "view {} by ({dx}, {dy}): {moved:?}",
            v % 4
        );
    }
}

/// The mesh is a centimetre off the room that was photographed: a block beside its place, a wall
/// before it.
#[test]
fn a_mesh_off_by_a_centimetre_hardly_changes_the_fused_radiance() {
    let stated = room();
    let mesh = mesh_of(&stated);
    let mut real = room();
    real[6..]
        .iter_mut()
        .for_each(|q| q.corner += Vec3::new(0.0071, 0.0, -0.0071));
    real[5].corner += Vec3::Z * 0.01;
    real[2].corner -= Vec3::X * 0.01;
    let (texels, fusion) = fuse(&stated, &painted(&real, &mesh, paint), &mesh, 128);
    let off = off_paint(&fusion, &texels, &mesh);
    println!("a centimetre off: {off:.4?}");
    assert!(off[0] < 0.02 && off[1] < 0.05, "{off:?}");
}

/// Views of different exposure and white balance, through the estimate of their gains: up to one
/// factor for all, the radiance is as if all had been exposed alike.
#[test]
fn views_of_different_exposure_fuse_to_one_radiance() {
    let quads = room();
    let mesh = mesh_of(&quads);
    let mut views = painted(&quads, &mesh, paint);
    let gains = [
        Vec3::new(1.5, 1.4, 1.3),
        Vec3::new(0.7, 0.75, 0.8),
        Vec3::new(1.2, 1.2, 1.2),
        Vec3::new(0.8, 0.8, 0.75),
    ];
    for (view, gain) in views.iter_mut().zip(gains) {
        view.radiance.data.iter_mut().for_each(|l| *l *= gain);
    }
    let orientation = Orientation::of_winding(mesh.triangles.len());
    // what is common to all views stays
    let common = gains.iter().fold(Vec3::ONE, |a, g| a * *g).powf(0.25);
    let error = |views: &[ObservedView]| {
        let (texels, mut fusion) = fuse(&quads, views, &mesh, 128);
        fusion.radiance.iter_mut().for_each(|l| *l /= common);
        off_paint(&fusion, &texels, &mesh)
    };
    let before = error(&views);
    let found = estimate_gains(
        &Observer {
            mesh: &mesh,
            views: &views,
        },
        &orientation,
    );
    assert!(found.is_needed(), "{found:?}");
    for (v, view) in views.iter_mut().enumerate() {
        view.radiance
            .data
            .iter_mut()
            .for_each(|l| *l *= found.correction(v));
    }
    let after = error(&views);
    println!("as photographed {before:.4?}, balanced {after:.4?}");
    assert!(before[0] > 0.1, "{before:?}");
    assert!(after[0] < 0.01 && after[1] < 0.02, "{after:?}");
}

/// A wall of two charts of different density, photographed with noise: texels that meet at the seam
/// agree as far as the noise lets them.
#[test]
fn both_sides_of_a_seam_agree() {
    let mut quads = room();
    let (wall, share) = (quads[2], 0.27);
    quads[2].edge_v = wall.edge_v * share;
    quads.push(Quad {
        corner: wall.corner + wall.edge_v * share,
        edge_v: wall.edge_v * (1.0 - share),
        ..wall
    });
    let mesh = mesh_of(&quads);
    let of = |q: usize| if q == 12 { 2 } else { q };
    let noise = |p: Vec3| {
        let mut rng = KeyedRng::new(4, u64::from((p.x * 3.1 + p.y * 7.7 + p.z * 1.3).to_bits()));
        1.0 + 0.05 * 12f32.sqrt() * (rng.next_f32() - 0.5)
    };
    let views = painted(&quads, &mesh, |q, p| paint(of(q), p) * noise(p));
    let (texels, fusion) = fuse(&quads, &views, &mesh, 256);
    let at = |i: usize| texels.position(&mesh, i);
    let relative = |i: usize| luminance(fusion.radiance[i]) / luminance(paint(2, at(i))) - 1.0;
    let seam = (wall.corner + wall.edge_v * share).z;
    let near = |quad: usize| -> Vec<usize> {
        let of = |i: &usize| {
            texels.point[*i].triangle as usize / 2 == quad
                && (at(*i).z - seam).abs() < 0.05
                && fusion.clean[*i]
        };
        (0..texels.len()).filter(of).collect()
    };
    let (left, right) = (near(2), near(12));
    assert!(
        left.len() > 50 && right.len() > 25,
        "{} {}",
        left.len(),
        right.len()
    );
    let squares = |x: &[f32]| x.iter().map(|e| e * e).sum::<f32>() / x.len() as f32;
    let own = squares(
        &left
            .iter()
            .chain(&right)
            .map(|&i| relative(i))
            .collect::<Vec<_>>(),
    );
    let steps: Vec<f32> = right
        .iter()
        .map(|&i| {
            let closest = left
                .iter()
                .min_by(|a, b| at(**a).distance(at(i)).total_cmp(&at(**b).distance(at(i))))
                .expect("some");
            relative(i) - relative(*closest)
        })
        .collect();
    let mean = steps.iter().sum::<f32>() / steps.len() as f32;
    println!(
        "{} pairs: noise {:.4}, steps {:.4}, their mean {mean:.4}",
        steps.len(),
        own.sqrt(),
        squares(&steps).sqrt()
    );
    assert!(own.sqrt() < 0.05, "noise {:.4}", own.sqrt());
    assert!(
        squares(&steps) < 1.5 * 2.0 * own && mean.abs() < 0.01,
        "steps {:.4}, mean {mean:.4}",
        squares(&steps).sqrt()
    );
}
