//! Specular reflection of a rectangular light against quadrature, for every roughness, by one set
//! of rays.

mod common;

use common::lit::{Lit, Quad, box_quads, quad};
use glam::Vec3;
use unbake::core::brdf::{Reflectance, SpecularLobe, specular_d_roughness};
use unbake::highlight::{LEVELS, LOBES};
use unbake::radiance::Environment;
use unbake::specular::{Levels, Own, Reflector, ShadingPoint};

const ROUGHNESS: [f32; 5] = [0.05, 0.2, 0.5, 0.8, 1.0];

fn lamp() -> Quad {
    quad([1.2, 2.9, 1.5], [1.4, 0.0, 0.0], [0.0, 0.0, 1.8], 7.0, true)
}

fn scene() -> Lit {
    let mut quads = box_quads(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 0.0);
    quads.push(lamp());
    Lit::new(&quads, Environment::black())
}

/// A look at the floor whose mirror direction meets the lamp at `target`, once per key.
fn gazes(target: Vec3, count: u64) -> Vec<ShadingPoint> {
    let position = Vec3::new(1.0, 0.0, 3.9);
    let l = (target - position).normalize();
    let view = Vec3::new(-l.x, l.y, -l.z);
    (0..count)
        .map(|key| ShadingPoint {
            position,
            normal: Vec3::Y,
            face_normal: Vec3::Y,
            view,
            key,
            turn: 0,
        })
        .collect()
}

/// ∫ L f_s (n·l) dω over the lamp and its derivative in R, in f64.
fn quadrature(g: &ShadingPoint, roughness: f32, steps: usize) -> (f64, f64) {
    let q = lamp();
    let (n, v, p) = (
        g.normal.as_dvec3(),
        g.view.as_dvec3(),
        g.position.as_dvec3(),
    );
    let area = f64::from(q.edge_u.cross(q.edge_v).length()) / (steps * steps) as f64;
    let (mut value, mut slope) = (0.0, 0.0);
    for i in 0..steps {
        for j in 0..steps {
            let (s, t) = (
                (i as f64 + 0.5) / steps as f64,
                (j as f64 + 0.5) / steps as f64,
            );
            let d = q.corner.as_dvec3() + q.edge_u.as_dvec3() * s + q.edge_v.as_dvec3() * t - p;
            let (r2, l) = (d.length_squared(), d.normalize());
            let h = (v + l).normalize();
            let n_l = n.dot(l);
            let (f, df) = specular_d_roughness(
                n_l,
                n.dot(v),
                n.cross(h).length_squared(),
                v.dot(h),
                f64::from(roughness),
            );
            let weight = 7.0 * n_l * -q.normal().as_dvec3().dot(l) * area / r2;
            value += f * weight;
            slope += df * weight;
        }
    }
    (value, slope)
}

fn mean_and_error(values: &[f32]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / n;
    let variance = values
        .iter()
        .map(|v| (f64::from(*v) - mean).powi(2))
        .sum::<f64>()
        / (n - 1.0);
    (mean, (variance / n).sqrt())
}

fn column(table: &[Vec3], k: usize, levels: usize) -> Vec<f32> {
    table.chunks(levels).map(|row| row[k].x).collect()
}

/// Where the mirror direction meets the middle of the lamp, its border, and misses it.
const TARGETS: [Vec3; 3] = [
    Vec3::new(1.9, 2.9, 2.4),
    Vec3::new(1.2, 2.9, 2.0),
    Vec3::new(3.2, 2.9, 2.4),
];

#[test]
fn converged_reflection_is_the_quadrature_of_the_model() {
    let lit = scene();
    let bake = lit.bake();
    let reflector = Reflector {
        lit: &bake.lit,
        rays_per_lobe: 64,
        emitter_samples: 64,
        model: unbake::core::brdf::Reflectance::Paper,
        seed: 3,
    };
    for target in TARGETS {
        let all = gazes(target, 400);
        for r in ROUGHNESS {
            let mut own = vec![Vec3::ZERO; all.len()];
            let rays = reflector.reflect(
                &all,
                Levels::Own(Own::dielectric(&vec![r; all.len()])),
                &mut own,
            );
            assert!(rays > 0);
            let (mean, error) = mean_and_error(&column(&own, 0, 1));
            let (expected, _) = quadrature(&all[0], r, if r < 0.1 { 1600 } else { 400 });
            println!("target {target} R {r}: {mean:.6} ± {error:.6} against {expected:.6}");
            assert!(
                (mean - expected).abs() < 4.5 * error + 2e-3 * expected,
                "R {r}: {mean} ± {error} against {expected}"
            );
            assert!(
                error < 0.02 * expected + 1e-4,
                "R {r}: noisy, ± {error} of {expected}"
            );
        }
    }
}

#[test]
fn one_set_of_rays_serves_every_level() {
    let lit = scene();
    let bake = lit.bake();
    let reflector = Reflector {
        lit: &bake.lit,
        rays_per_lobe: 32,
        emitter_samples: 64,
        model: unbake::core::brdf::Reflectance::Paper,
        seed: 9,
    };
    for target in TARGETS {
        let all = gazes(target, 300);
        let mut table = vec![Vec3::ZERO; all.len() * LEVELS.len()];
        reflector.reflect(
            &all,
            Levels::Shared {
                lobes: &LOBES,
                evaluate: &LEVELS,
                models: &[SpecularLobe::dielectric(Reflectance::Paper)],
            },
            &mut table,
        );
        for (k, r) in LEVELS.iter().enumerate() {
            let (mean, error) = mean_and_error(&column(&table, k, LEVELS.len()));
            let (expected, _) = quadrature(&all[0], *r, if *r < 0.1 { 1600 } else { 400 });
            // the far flank of a lobe narrower than all that are sampled is found by light samples
            // alone
            assert!(
                (mean - expected).abs() < 4.5 * error + 4e-3 * expected + 1e-6,
                "R {r}: {mean} ± {error} against {expected}"
            );
            let mut own = vec![Vec3::ZERO; all.len()];
            reflector.reflect(
                &all,
                Levels::Own(Own::dielectric(&vec![*r; all.len()])),
                &mut own,
            );
            let (single, single_error) = mean_and_error(&column(&own, 0, 1));
            let joint = (error * error + single_error * single_error).sqrt();
            assert!(
                (mean - single).abs() < 4.5 * joint + 4e-3 * expected + 1e-6,
                "R {r}: table {mean}, alone {single}"
            );
        }
    }
}

/// Burley's diffuse part under a lamp from one side: the same rays tell how it compares with
/// Lambert's, for every roughness, and seen against the light it is another than seen with it.
#[test]
fn the_diffuse_factor_is_that_of_the_light_that_arrives() {
    let lit = scene();
    let bake = lit.bake();
    let model = unbake::core::brdf::Reflectance::Burley;
    let reflector = Reflector {
        lit: &bake.lit,
        rays_per_lobe: 16,
        emitter_samples: 64,
        model,
        seed: 5,
    };
    let (q, p) = (lamp(), Vec3::new(0.2, 0.0, 4.8));
    let mut factors = Vec::new();
    for view in [Vec3::new(0.9, 0.25, -0.9), Vec3::new(-0.9, 0.25, 0.9)].map(Vec3::normalize) {
        let gaze = |key| ShadingPoint {
            position: p,
            normal: Vec3::Y,
            face_normal: Vec3::Y,
            view,
            key,
            turn: 0,
        };
        let all: Vec<ShadingPoint> = (0..200).map(gaze).collect();
        let mut specular = vec![Vec3::ZERO; all.len()];
        let mut diffuse = vec![[0.0; 3]; all.len()];
        reflector.reflect_and_spread(
            &all,
            Levels::Own(Own::dielectric(&vec![0.8; all.len()])),
            &mut specular,
            &mut diffuse,
        );
        for r in ROUGHNESS {
            let (mut light, mut reflected) = (0.0f64, 0.0f64);
            for (i, j) in (0..100).flat_map(|i| (0..100).map(move |j| (i, j))) {
                let d = q.at((i as f32 + 0.5) / 100.0, (j as f32 + 0.5) / 100.0) - p;
                let l = d.normalize();
                let weight = l.y * -q.normal().dot(l) / d.length_squared();
                light += f64::from(weight);
                reflected += f64::from(weight * model.diffuse(l.y, view.y, view.dot(l), r));
            }
            let (mean, error) = mean_and_error(
                &diffuse
                    .iter()
                    .map(|[a, b, c]| a + r * (b + r * c))
                    .collect::<Vec<f32>>(),
            );
            let expected = reflected / light;
            assert!(
                (mean - expected).abs() < 4.5 * error + 2e-3,
                "R {r}: {mean} ± {error} against {expected}"
            );
            factors.push(expected);
        }
    }
    assert!(
        factors[4] > 1.1 * factors[9],
        "towards the lamp's side a rough surface is brighter: {factors:?}"
    );
}

/// The samples are fixed, so differences of the table are derivatives of one smooth function, equal
/// to the kernel's own.
#[test]
fn differences_of_the_table_are_the_kernels_derivative() {
    let lit = scene();
    let bake = lit.bake();
    let reflector = Reflector {
        lit: &bake.lit,
        rays_per_lobe: 64,
        emitter_samples: 128,
        model: unbake::core::brdf::Reflectance::Paper,
        seed: 4,
    };
    for target in TARGETS {
        let all = gazes(target, 200);
        for r in [0.1f32, 0.2, 0.5, 0.8] {
            let h = 0.01 * r;
            let levels = [r - h, r, r + h];
            let mut table = vec![Vec3::ZERO; all.len() * 3];
            reflector.reflect(
                &all,
                Levels::Shared {
                    lobes: &LOBES,
                    evaluate: &levels,
                    models: &[SpecularLobe::dielectric(Reflectance::Paper)],
                },
                &mut table,
            );
            let slopes: Vec<f32> = table
                .chunks(3)
                .map(|row| (row[2].x - row[0].x) / (2.0 * h))
                .collect();
            let (mean, error) = mean_and_error(&slopes);
            let (value, expected) = quadrature(&all[0], r, 800);
            println!("target {target} R {r}: slope {mean:.5} ± {error:.5} against {expected:.5}");
            assert!(
                (mean - expected).abs()
                    < 4.5 * error + 5e-3 * (expected.abs() + value / f64::from(r)),
                "R {r}: {mean} ± {error}, {expected}"
            );
        }
    }
}

#[test]
fn extremes_of_roughness_and_view_stay_finite() {
    let lit = scene();
    let bake = lit.bake();
    let reflector = Reflector {
        lit: &bake.lit,
        rays_per_lobe: 8,
        emitter_samples: 8,
        model: unbake::core::brdf::Reflectance::Paper,
        seed: 1,
    };
    let mut all = gazes(TARGETS[0], 6);
    for (i, g) in all.iter_mut().enumerate() {
        let grazing = [1.0, 1e-2, 1e-4, 1e-5, 0.0, -1e-6][i];
        g.view = Vec3::new((1.0f32 - grazing * grazing).sqrt(), grazing, 0.0);
    }
    for r in [0.0, 1e-4, 0.01, 0.8, 1.0] {
        let mut out = vec![Vec3::ZERO; all.len()];
        reflector.reflect(
            &all,
            Levels::Own(Own::dielectric(&vec![r; all.len()])),
            &mut out,
        );
        assert!(
            out.iter().all(|v| v.is_finite() && v.min_element() >= 0.0),
            "R {r}: {out:?}"
        );
        let mut table = vec![Vec3::ZERO; all.len() * 2];
        reflector.reflect(
            &all,
            Levels::Shared {
                lobes: &[r, 1.0],
                evaluate: &[r, 0.5],
                models: &[SpecularLobe::dielectric(Reflectance::Paper)],
            },
            &mut table,
        );
        assert!(table.iter().all(|v| v.is_finite()), "R {r}: {table:?}");
    }
    assert_eq!(
        reflector.reflect(&[], Levels::Own(Own::dielectric(&[])), &mut []),
        0
    );
}
