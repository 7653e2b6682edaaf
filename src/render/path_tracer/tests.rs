//! Closed forms and an independent brute-force estimator for the path tracer.

use super::*;
use crate::core::brdf::BaseColour;
use crate::core::geometry::Mesh;
use crate::core::geometry::Projection;
use crate::core::image::RgbPlane;
use crate::core::math::luminance;
use crate::core::sampling::KeyedRng;
use crate::core::trace::BruteForce;
use crate::core::trace::Tracer;
use glam::Mat3;

/// Constant material and emission per triangle.
struct PerTriangle(Vec<Surface>);
impl SurfaceModel for PerTriangle {
    fn surface(&self, t: usize, _: f32, _: f32) -> Surface {
        self.0[t]
    }
    fn mean_emission(&self, t: usize) -> Vec3 {
        self.0[t].emission
    }
    fn label(&self, t: usize) -> u16 {
        t as u16 + 1
    }
}

struct Sky(Vec3);
impl Environment for Sky {
    fn radiance(&self, d: Vec3) -> Vec3 {
        self.0 * (1.0 + 0.5 * d.y)
    }
}

fn add_quad(mesh: &mut Mesh, corner: Vec3, a: Vec3, b: Vec3) {
    let i = mesh.positions.len() as u32;
    mesh.positions
        .extend([corner, corner + a, corner + a + b, corner + b]);
    mesh.normals.extend([a.cross(b).normalize(); 4]);
    mesh.uvs.extend([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]);
    mesh.triangles
        .extend([[i, i + 1, i + 2], [i, i + 2, i + 3]]);
}

/// A box seen from inside, normals inwards: 12 triangles, the last two the ceiling; optionally
/// without the +x wall.
fn add_room(mesh: &mut Mesh, s: Vec3, closed: bool) {
    let (x, y, z) = (Vec3::X * s.x, Vec3::Y * s.y, Vec3::Z * s.z);
    add_quad(mesh, Vec3::ZERO, z, x);
    add_quad(mesh, Vec3::ZERO, x, y);
    add_quad(mesh, z, y, x);
    add_quad(mesh, Vec3::ZERO, y, z);
    if closed {
        add_quad(mesh, x, z, y);
    }
    add_quad(mesh, y, x, z);
}

fn camera(width: usize, height: usize, position: Vec3) -> Camera {
    Camera {
        projection: Projection::Equirectangular,
        width,
        height,
        world_from_camera: Mat3::IDENTITY,
        position,
    }
}

fn surface(albedo: f32, roughness: f32, emission: f32) -> Surface {
    let material = Material {
        albedo: Vec3::splat(albedo),
        roughness,
    };
    Surface::dielectric(material, Vec3::splat(emission))
}

#[test]
fn white_furnace_radiates_e_over_one_minus_a() {
    let mut mesh = Mesh::default();
    add_room(&mut mesh, Vec3::new(2.0, 1.5, 1.0), true);
    let model = PerTriangle(vec![surface(0.6, 0.5, 0.7); mesh.triangles.len()]);
    let tracer = BruteForce::new(&mesh);
    let options = PathTracerOptions {
        samples: 256,
        lambertian: true,
        ..Default::default()
    };
    let renderer = PathTracer::new(&mesh, &tracer, &model, &BlackEnvironment, options);
    let image = renderer
        .render(
            &camera(16, 8, Vec3::new(0.7, 0.6, 0.4)),
            0,
            &Progress::silent(),
        )
        .radiance();
    let mean = image.data.iter().map(|p| f64::from(p.x)).sum::<f64>() / image.data.len() as f64;
    assert!(
        (mean / (0.7 / 0.4) - 1.0).abs() < 4e-3,
        "furnace shows {mean}"
    );
    let worst = image
        .data
        .iter()
        .map(|p| (p.x / (0.7 / 0.4) - 1.0).abs())
        .fold(0.0, f32::max);
    assert!(worst < 0.15, "a pixel is off by {worst}");
}

/// A metal floor under an even sky, seen head-on by a camera whose last row looks down.
fn over_metal(f0: Vec3, metallic: f32, known: KnownLight<'_>) -> Frame {
    struct Even;
    impl Environment for Even {
        fn radiance(&self, _: Vec3) -> Vec3 {
            Vec3::splat(2.0)
        }
    }
    let mut mesh = Mesh::default();
    add_quad(
        &mut mesh,
        Vec3::new(-5.0, 0.0, -5.0),
        Vec3::Z * 10.0,
        Vec3::X * 10.0,
    );
    let metal = Surface {
        base: BaseColour {
            colour: f0,
            metallic,
        },
        transmission: 0.0,
        roughness: 0.1,
        emission: Vec3::ZERO,
    };
    let model = PerTriangle(vec![metal; 2]);
    let tracer = BruteForce::new(&mesh);
    let options = PathTracerOptions {
        samples: 256,
        ..Default::default()
    };
    let renderer = PathTracer::new(&mesh, &tracer, &model, &Even, options);
    renderer.render_with(&camera(8, 32, Vec3::Y), 0, known, &Progress::silent())
}

/// F0·L head-on, nothing from the diffuse lobe, whatever irradiance is known; and the mixture's
/// share of each.
#[test]
fn metal_mirrors_its_colour_and_has_no_diffuse_part() {
    struct Bright;
    impl IndirectCache for Bright {
        fn irradiance(&self, _: usize, _: f32, _: f32) -> Vec3 {
            Vec3::splat(PI * 100.0)
        }
    }
    let f0 = Vec3::new(0.91, 0.78, 0.42);
    let bright = KnownLight {
        first: Some(&Bright),
        later: Some(&Bright),
    };
    for known in [KnownLight::default(), bright] {
        let frame = over_metal(f0, 1.0, known);
        for i in 31 * 8..32 * 8 {
            let shown = frame.specular.data[i] / 2.0;
            assert!((shown / f0 - 1.0).abs().max_element() < 0.02, "{shown}");
            assert_eq!(frame.diffuse.data[i], Vec3::ZERO);
            assert_eq!(frame.albedo.data[i], Vec3::ZERO);
            assert!((frame.class_albedo.data[i] - f0).length() < 1e-5);
            assert_eq!(frame.class_metallic.data[i], 1.0);
        }
    }
    let half = over_metal(f0, 0.5, bright);
    let i = 31 * 8 + 3;
    assert!((half.diffuse.data[i] - 50.0 * f0).length() < 1e-3);
    let shown = half.specular.data[i] / 2.0;
    let expected = 0.5 * (f0 + DIELECTRIC);
    assert!(
        (shown / expected - 1.0).abs().max_element() < 0.02,
        "{shown}"
    );
}

/// Beside a mirror that reflects everything a floor receives as much as without it under an even
/// sky, whatever diffuse irradiance is known of the mirror; beside a black wall, less.
#[test]
fn a_mirror_sends_on_what_it_receives_and_no_known_irradiance() {
    struct Smooth(PerTriangle);
    impl SurfaceModel for Smooth {
        fn surface(&self, t: usize, u: f32, v: f32) -> Surface {
            self.0.surface(t, u, v)
        }
        fn mean_emission(&self, t: usize) -> Vec3 {
            self.0.mean_emission(t)
        }
        fn label(&self, t: usize) -> u16 {
            self.0.label(t)
        }
        // the paper's masking takes light from smooth metals too
        fn reflectance(&self) -> crate::core::brdf::Reflectance {
            crate::core::brdf::Reflectance::Smith
        }
    }
    struct Even;
    impl Environment for Even {
        fn radiance(&self, _: Vec3) -> Vec3 {
            Vec3::ONE
        }
    }
    struct Bright;
    impl IndirectCache for Bright {
        fn irradiance(&self, _: usize, _: f32, _: f32) -> Vec3 {
            Vec3::splat(1000.0)
        }
    }
    let mut mesh = Mesh::default();
    add_quad(
        &mut mesh,
        Vec3::new(0.0, 0.0, -50.0),
        Vec3::Y * 50.0,
        Vec3::Z * 100.0,
    );
    let received = |colour: f32, metallic: f32| {
        let wall = Surface {
            base: BaseColour {
                colour: Vec3::splat(colour),
                metallic,
            },
            transmission: 0.0,
            roughness: 0.05,
            emission: Vec3::ZERO,
        };
        let model = Smooth(PerTriangle(vec![wall; 2]));
        let tracer = BruteForce::new(&mesh);
        let options = PathTracerOptions::default();
        let renderer = PathTracer::new(&mesh, &tracer, &model, &Even, options);
        let points: Vec<IrradiancePoint> = (0..16)
            .map(|i| IrradiancePoint {
                position: Vec3::new(0.5, 0.0, 0.1 * i as f32),
                face_normal: Vec3::Y,
                normal: Vec3::Y,
            })
            .collect();
        let silent = Progress::silent();
        let light = renderer.irradiance_with(&points, 512, 0, Some(&Bright), &silent);
        light.iter().map(|e| e.x / PI).sum::<f32>() / points.len() as f32
    };
    let (mirror, black) = (received(1.0, 1.0), received(0.0, 1.0));
    assert!((mirror - 1.0).abs() < 0.02, "{mirror}");
    assert!(black < 0.8, "{black}: the wall takes half of the light");
}

#[test]
fn irradiance_of_a_small_lamp_follows_the_inverse_square() {
    let mut mesh = Mesh::default();
    add_quad(
        &mut mesh,
        Vec3::new(-2.0, 0.0, -2.0),
        Vec3::Z * 4.0,
        Vec3::X * 4.0,
    );
    add_quad(
        &mut mesh,
        Vec3::new(-0.005, 2.0, -0.005),
        Vec3::X * 0.01,
        Vec3::Z * 0.01,
    );
    let model = PerTriangle(vec![
        surface(0.5, 0.5, 0.0),
        surface(0.5, 0.5, 0.0),
        surface(0.0, 0.5, 1e4),
        surface(0.0, 0.5, 1e4),
    ]);
    let tracer = BruteForce::new(&mesh);
    let renderer = PathTracer::new(
        &mesh,
        &tracer,
        &model,
        &BlackEnvironment,
        PathTracerOptions::default(),
    );
    for x in [0.0f32, 0.5, 1.5] {
        let point = IrradiancePoint {
            position: Vec3::new(x, 0.0, 0.0),
            face_normal: Vec3::Y,
            normal: Vec3::Y,
        };
        let e = f64::from(renderer.irradiance(&[point], 64, 0, &Progress::silent())[0].x);
        let d2 = f64::from(4.0 + x * x);
        // L·A·cosθ·cosθ'/d², both cosines 2/d
        let expected = 1e4 * 1e-4 * 4.0 / (d2 * d2);
        assert!(
            (e / expected - 1.0).abs() < 1e-3,
            "at {x}: {e} against {expected}"
        );
    }
}

/// Scene of the z-tests: a glossy room with a lamp, a block that casts shadows, one wall open to
/// the sky.
fn small_scene() -> (Mesh, PerTriangle) {
    let mut mesh = Mesh::default();
    let size = Vec3::new(3.0, 2.0, 2.0);
    add_room(&mut mesh, size, false);
    add_quad(
        &mut mesh,
        Vec3::new(0.5, 1.9, 0.5),
        Vec3::X * 0.8,
        Vec3::Z * 0.8,
    );
    add_quad(&mut mesh, Vec3::new(0.4, 0.7, 0.3), Vec3::Z, Vec3::X);
    let mut surfaces = vec![surface(0.5, 0.9, 0.0); mesh.triangles.len()];
    surfaces[0] = surface(0.3, 0.25, 0.0);
    surfaces[1] = surface(0.3, 0.4, 0.0);
    surfaces[4] = surface(0.7, 0.6, 0.0);
    surfaces[10] = surface(0.1, 0.5, 4.0);
    surfaces[11] = surface(0.1, 0.5, 4.0);
    (mesh, PerTriangle(surfaces))
}

/// The plainest estimator there is: uniform directions, no light sampling, no roulette.
fn brute_radiance(
    mesh: &Mesh,
    model: &PerTriangle,
    sky: &Sky,
    o: Vec3,
    d: Vec3,
    rng: &mut KeyedRng,
) -> f64 {
    let tracer = BruteForce::new(mesh);
    let (mut o, mut d, mut beta, mut sum) = (o, d, 1.0f64, 0.0f64);
    for _ in 0..24 {
        let mut hit = [Hit::miss()];
        tracer.closest(&[Ray::new(o, d, f32::INFINITY)], &mut hit);
        let hit = hit[0];
        if !hit.is_hit() {
            return sum + beta * f64::from(sky.radiance(d).x);
        }
        let t = hit.triangle as usize;
        let s = model.0[t];
        sum += beta * f64::from(s.emission.x);
        let face = mesh.face_normal(t);
        let n = if face.dot(d) > 0.0 { -face } else { face };
        let l = crate::core::math::Frame::from_normal(n).world_from_local(
            crate::core::sampling::square_to_uniform_hemisphere([rng.next_f32(), rng.next_f32()]),
        );
        beta *= f64::from(s.material().eval(n, -d, l).x) * 2.0 * std::f64::consts::PI;
        o = mesh.position(t, hit.u, hit.v) + n * 1e-4;
        d = l;
        if beta == 0.0 {
            break;
        }
    }
    sum
}

fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

#[test]
fn agrees_with_brute_force_in_a_glossy_room() {
    let (mesh, model) = small_scene();
    let tracer = BruteForce::new(&mesh);
    let eye = Vec3::new(1.6, 1.2, 1.4);
    let mut z_values = Vec::new();
    for seed in [0, 1] {
        let sky = Sky(Vec3::splat(1.0));
        // sixteen one-pixel runs with different keys give independent means
        let options = PathTracerOptions {
            samples: 256,
            roulette_from: 1,
            seed,
            ..Default::default()
        };
        let renderer = PathTracer::new(&mesh, &tracer, &model, &sky, options);
        let view = camera(4, 2, eye);
        let frames: Vec<RgbPlane> = (0..24)
            .map(|k| renderer.render(&view, k, &Progress::silent()).radiance())
            .collect();
        for pixel in 0..8 {
            let ours: Vec<f64> = frames.iter().map(|f| f64::from(f.data[pixel].x)).collect();
            let (a, ea) = mean_and_error(&ours);
            let samples: Vec<f64> = (0..16)
                .flat_map(|block| {
                    let mut rng = KeyedRng::new(77, (pixel * 16 + block) as u64);
                    (0..1500)
                        .map(|_| {
                            let p = Vec2::new(
                                (pixel % 4) as f32 + rng.next_f32(),
                                (pixel / 4) as f32 + rng.next_f32(),
                            );
                            brute_radiance(&mesh, &model, &sky, eye, view.direction(p), &mut rng)
                        })
                        .collect::<Vec<f64>>()
                })
                .collect();
            let (b, eb) = mean_and_error(&samples);
            z_values.push((a - b) / (ea * ea + eb * eb).sqrt());
            assert!((a / b - 1.0).abs() < 0.08, "pixel {pixel}: {a} against {b}");
        }
    }
    // 16 tests at 1 % together: Šidák bound 3.42 for the largest
    let worst = z_values.iter().fold(0.0f64, |m, z| m.max(z.abs()));
    assert!(worst < 3.6, "z-values {z_values:.2?}");
}

#[test]
fn an_exact_cache_changes_nothing_but_the_noise() {
    struct Constant(f32);
    impl IndirectCache for Constant {
        fn irradiance(&self, _: usize, _: f32, _: f32) -> Vec3 {
            Vec3::splat(self.0)
        }
    }
    let mut mesh = Mesh::default();
    add_room(&mut mesh, Vec3::splat(2.0), true);
    let model = PerTriangle(vec![surface(0.5, 0.5, 1.0); mesh.triangles.len()]);
    let tracer = BruteForce::new(&mesh);
    let options = PathTracerOptions {
        samples: 64,
        lambertian: true,
        ..Default::default()
    };
    let renderer = PathTracer::new(&mesh, &tracer, &model, &BlackEnvironment, options);
    // furnace: L = 2 everywhere, E = 2π
    let cache = Constant(2.0 * PI);
    let image = renderer
        .render_with(
            &camera(8, 4, Vec3::ONE),
            0,
            KnownLight {
                first: None,
                later: Some(&cache),
            },
            &Progress::silent(),
        )
        .radiance();
    let mean = image.data.iter().map(|p| p.x).sum::<f32>() / 32.0;
    assert!((mean - 2.0).abs() < 0.01, "{mean}");
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let (mesh, model) = small_scene();
    let tracer = BruteForce::new(&mesh);
    let sky = Sky(Vec3::ONE);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("pool");
        pool.install(|| {
            let options = PathTracerOptions {
                samples: 16,
                ..Default::default()
            };
            let renderer = PathTracer::new(&mesh, &tracer, &model, &sky, options);
            renderer
                .render(&camera(24, 12, Vec3::ONE), 5, &Progress::silent())
                .radiance()
                .data
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn first_hit_features_follow_the_class_at_the_centre() {
    let (mesh, model) = small_scene();
    let tracer = BruteForce::new(&mesh);
    let sky = Sky(Vec3::ONE);
    let options = PathTracerOptions {
        samples: 8,
        ..Default::default()
    };
    let frame = PathTracer::new(&mesh, &tracer, &model, &sky, options).render(
        &camera(32, 16, Vec3::ONE),
        0,
        &Progress::silent(),
    );
    let mut empty = 0;
    for i in 0..frame.label.data.len() {
        match frame.label.data[i] {
            0 => empty += 1,
            l => {
                let m = model.0[usize::from(l) - 1].material();
                assert!((frame.class_albedo.data[i] - m.albedo).length() < 1e-5);
                assert!((frame.class_roughness.data[i] - m.roughness).abs() < 1e-5);
            }
        }
    }
    assert!(empty > 0, "the open wall shows the sky");
}

/// The specular part differs from the reference's by no more than both variances explain, in at
/// least `fewest` pixels.
fn assert_specular_unbiased(frame: &Frame, reference: &Frame, fewest: usize) {
    let scores: Vec<f64> = (0..frame.label.data.len())
        .filter(|&p| frame.variance.data[p][1] > 0.0)
        .map(|p| {
            let difference =
                luminance(frame.specular.data[p]) - luminance(reference.specular.data[p]);
            f64::from(
                difference / (frame.variance.data[p][1] + reference.variance.data[p][1]).sqrt(),
            )
        })
        .collect();
    let (mean, _) = mean_and_error(&scores);
    let square = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
    assert!(scores.len() >= fewest, "{}", scores.len());
    assert!(
        mean.abs() < 4.0 / (scores.len() as f64).sqrt() && square < 1.6,
        "mean {mean}, mean square {square} of {}",
        scores.len()
    );
}

/// Passes that follow the specular lobe alone show the same image with less noise, and touch
/// nothing else.
#[test]
fn samples_of_the_specular_lobe_alone_add_to_it_without_bias() {
    let (mesh, model) = small_scene();
    let tracer = BruteForce::new(&mesh);
    let sky = Sky(Vec3::splat(1.5));
    let eye = camera(16, 8, Vec3::new(1.6, 1.1, 0.9));
    let options = PathTracerOptions {
        samples: 2048,
        max_bounces: 4,
        ..Default::default()
    };
    let renderer = PathTracer::new(&mesh, &tracer, &model, &sky, options);
    let reference = renderer.render(&eye, 7, &Progress::silent());
    let adaptive = |most: u32| {
        let goal = Adaptive {
            first: 16,
            most,
            error: 0.0,
            noise: Noise::Specular,
        };
        renderer
            .render_adaptive(
                &eye,
                8,
                &goal,
                KnownLight::default(),
                &Progress::silent(),
                |_, _| Ok(()),
            )
            .expect("no errors from the callback")
    };
    let (before, after) = (adaptive(16), adaptive(256));
    assert_eq!(
        [&before.diffuse, &before.emission, &before.albedo],
        [&after.diffuse, &after.emission, &after.albedo]
    );
    let variance = |f: &Frame| f.variance.data.iter().map(|v| f64::from(v[1])).sum::<f64>();
    // sixteen times the samples, and all of the new ones follow the lobe
    assert!(
        variance(&after) < variance(&before) / 16.0,
        "{} {}",
        variance(&after),
        variance(&before)
    );
    assert_specular_unbiased(&after, &reference, 1);
}

/// Where the light at first hits is known, the diffuse part has no noise and the specular part no
/// bias, adaptively or not.
#[test]
fn known_light_at_first_hits_leaves_only_the_specular_part_to_sample() {
    struct Constant;
    impl IndirectCache for Constant {
        fn irradiance(&self, _: usize, _: f32, _: f32) -> Vec3 {
            Vec3::splat(2.0)
        }
    }
    let (mesh, model) = small_scene();
    let tracer = BruteForce::new(&mesh);
    let sky = Sky(Vec3::splat(1.5));
    let eye = camera(16, 8, Vec3::new(1.6, 1.1, 0.9));
    let options = PathTracerOptions {
        samples: 1024,
        max_bounces: 4,
        ..Default::default()
    };
    let renderer = PathTracer::new(&mesh, &tracer, &model, &sky, options);
    let reference = renderer.render(&eye, 7, &Progress::silent());
    let known = KnownLight {
        first: Some(&Constant),
        later: None,
    };
    let goal = Adaptive {
        first: 16,
        most: 512,
        error: 0.0,
        noise: Noise::Specular,
    };
    let adaptive = renderer
        .render_adaptive(&eye, 8, &goal, known, &Progress::silent(), |_, _| Ok(()))
        .expect("no errors");
    for frame in [
        adaptive,
        renderer.render_with(&eye, 9, known, &Progress::silent()),
    ] {
        for p in 0..frame.label.data.len() {
            let hits = frame.normal.data[p].length();
            // (pixels on an edge mix two surfaces)
            if hits > 0.999 {
                let want = frame.albedo.data[p] * 2.0 / PI;
                assert!(
                    (frame.diffuse.data[p] - want).abs().max_element() < 1e-4,
                    "{} not {want}",
                    frame.diffuse.data[p]
                );
            }
            assert_eq!(frame.variance.data[p][0], 0.0);
        }
        assert_specular_unbiased(&frame, &reference, 61);
    }
}

/// An even sky of radiance 1.
struct One;
impl Environment for One {
    fn radiance(&self, _: Vec3) -> Vec3 {
        Vec3::ONE
    }
}

/// Surfaces of which some let light through.
struct WithPanes(PerTriangle);
impl SurfaceModel for WithPanes {
    fn surface(&self, t: usize, u: f32, v: f32) -> Surface {
        self.0.surface(t, u, v)
    }
    fn mean_emission(&self, t: usize) -> Vec3 {
        self.0.mean_emission(t)
    }
    fn label(&self, t: usize) -> u16 {
        self.0.label(t)
    }
    fn has_panes(&self) -> bool {
        true
    }
}

fn sheet(colour: Vec3, transmission: f32) -> Surface {
    Surface {
        base: BaseColour {
            colour,
            metallic: 0.0,
        },
        transmission,
        roughness: 0.05,
        emission: Vec3::ZERO,
    }
}

/// 1 − F of a dielectric, written out.
fn not_reflected(cosine: f32) -> f32 {
    0.96 * (1.0 - f32::exp2((-5.55473 * cosine - 6.98316) * cosine))
}

/// A wide quad at height `y`, its normal up.
fn add_ceiling(mesh: &mut Mesh, y: f32) {
    let corner = Vec3::new(-500.0, y, -500.0);
    add_quad(mesh, corner, Vec3::Z * 1000.0, Vec3::X * 1000.0);
}

/// Under an even sky of radiance 1 a camera sees t · tint · (1 − F) of it through a pane, without
/// noise, beside the reflection of a black sheet and 1 − t of the diffuse light; through two panes
/// the square.
#[test]
fn a_camera_sees_through_panes_what_they_let_through() {
    let tint = Vec3::new(0.9, 0.95, 0.8);
    let shown = |of: Surface, layers: usize| {
        let mut mesh = Mesh::default();
        (0..layers).for_each(|i| add_ceiling(&mut mesh, -(i as f32)));
        let model = WithPanes(PerTriangle(vec![of; 2 * layers]));
        let tracer = BruteForce::new(&mesh);
        let options = PathTracerOptions {
            samples: 512,
            ..Default::default()
        };
        PathTracer::new(&mesh, &tracer, &model, &One, options).render(
            &camera(4, 32, Vec3::Y),
            0,
            &Progress::silent(),
        )
    };
    let black = shown(sheet(Vec3::ZERO, 0.0), 1);
    let [clear, cloudy, double] =
        [(1.0, 1), (0.25, 1), (1.0, 2)].map(|(t, n)| shown(sheet(tint, t), n));
    let view = camera(4, 32, Vec3::Y);
    for row in [20, 24, 28, 31] {
        let i = row * 4 + 1;
        let cosine = -view.direction(Vec2::new(1.5, row as f32 + 0.5)).y;
        let through = tint * not_reflected(cosine);
        let close = |shown: Vec3, expected: Vec3, off: f32| {
            let error = (shown - expected).abs().max_element();
            assert!(error < off, "row {row}: {shown} instead of {expected}");
        };
        close(clear.emission.data[i], through, 0.006);
        close(cloudy.emission.data[i], 0.25 * through, 0.002);
        close(double.emission.data[i], through * through, 0.012);
        close(clear.specular.data[i], black.specular.data[i], 0.004);
        close(cloudy.diffuse.data[i], 0.75 * tint, 0.05);
        assert_eq!(clear.diffuse.data[i], Vec3::ZERO);
        assert_eq!(clear.class_transmission.data[i], 1.0);
    }
}

/// A lamp behind a coloured pane lights a floor with T(θ) of what it sends without it in every channel, whether the tables of
/// lights or directions drawn by the surface find it.
#[test]
fn a_lamp_behind_a_pane_lights_a_floor_by_its_transmittance() {
    let tint = Vec3::new(0.9, 0.6, 0.3);
    let received = |degrees: f32, transmission: f32| {
        let angle = degrees.to_radians();
        let lamp = Vec3::new(2.0 * angle.tan(), 2.0, 0.0);
        let mut mesh = Mesh::default();
        let half = Vec3::new(0.05, 0.0, 0.05);
        add_quad(&mut mesh, lamp - half, Vec3::X * 0.1, Vec3::Z * 0.1);
        add_ceiling(&mut mesh, 1.0);
        let shine = surface(0.0, 1.0, 50.0);
        let pane = sheet(tint, transmission);
        let model = WithPanes(PerTriangle(vec![shine, shine, pane, pane]));
        if transmission == 0.0 {
            mesh.triangles.truncate(2);
        }
        let tracer = BruteForce::new(&mesh);
        let renderer = PathTracer::new(
            &mesh,
            &tracer,
            &model,
            &BlackEnvironment,
            PathTracerOptions::default(),
        );
        let points: Vec<IrradiancePoint> = (0..32)
            .map(|i| IrradiancePoint {
                position: Vec3::new(0.0, 0.0, 1e-3 * i as f32),
                face_normal: Vec3::Y,
                normal: Vec3::Y,
            })
            .collect();
        let light = renderer.irradiance(&points, 1024, 3, &Progress::silent());
        light.iter().sum::<Vec3>() / points.len() as f32
    };
    for degrees in [0.0, 40.0, 65.0] {
        let share = received(degrees, 1.0) / received(degrees, 0.0);
        let expected = tint * not_reflected(f32::cos(f32::to_radians(degrees)));
        assert!(
            (share / expected - 1.0).abs().max_element() < 0.015,
            "{degrees}°: {share} instead of {expected}"
        );
    }
}

/// Between an even sky on both sides a pane adds to what a black sheet reflects the integral of its
/// transmittance: a path that it stops stands for those that went through.
#[test]
fn what_a_pane_stops_counts_for_what_it_lets_through() {
    let received = |of: Surface| {
        let mut mesh = Mesh::default();
        add_ceiling(&mut mesh, 1.0);
        let model = WithPanes(PerTriangle(vec![of; 2]));
        let tracer = BruteForce::new(&mesh);
        let options = PathTracerOptions::default();
        let renderer = PathTracer::new(&mesh, &tracer, &model, &One, options);
        let points: Vec<IrradiancePoint> = (0..64)
            .map(|i| IrradiancePoint {
                position: Vec3::new(0.0, 0.0, 0.1 * i as f32),
                face_normal: Vec3::Y,
                normal: Vec3::Y,
            })
            .collect();
        let light = renderer.irradiance(&points, 2048, 5, &Progress::silent());
        light.iter().sum::<Vec3>() / PI / points.len() as f32
    };
    let tint = Vec3::new(0.9, 0.6, 0.3);
    let reflected = received(sheet(Vec3::ZERO, 0.0));
    let steps = 1000;
    let through: Vec3 = (0..steps)
        .map(|i| (i as f32 + 0.5) / steps as f32)
        .map(|c| tint * not_reflected(c) * 2.0 * c / steps as f32)
        .sum();
    let both = received(sheet(tint, 1.0));
    assert!(
        reflected.min_element() > 0.03,
        "{reflected}: enough to tell"
    );
    assert!(
        (both / (reflected + through) - 1.0).abs().max_element() < 0.01,
        "{both} instead of {reflected} + {through}"
    );
}
