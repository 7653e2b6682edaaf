//! Gradient rows across modules: the analytic derivative of everything the estimators
//! differentiate, against dual numbers and central differences. Rows that need private parts stand
//! beside their code: `brdf::ggx` (lobe and masking in R), `brdf::chunk` (the vector kernel),
//! `lighting::nirf` (network), `inverse::roughness` (objective of the search), `gbuffer::gains`
//! (exposure).

use unbake::core::brdf::{SpecularChunk, specular, specular_chunk};
use unbake::core::math::{Dual, Real};
use unbake::core::sampling::KeyedRng;

/// The estimator L_s(R) = Σ w f_s(R): its derivative is that of the lobe, summed. Kernel in f32,
/// duals and central differences in f64.
#[test]
fn the_estimators_slope_is_the_sum_of_the_kernels() {
    let mut rng = KeyedRng::new(7, 1);
    const N: usize = 257;
    let (mut n_l, mut n_v, mut sin2, mut v_h, mut weight) =
        (vec![], vec![], vec![], vec![], vec![]);
    for _ in 0..N {
        n_l.push(0.02 + 0.97 * rng.next_f32());
        n_v.push(0.05 + 0.9 * rng.next_f32());
        sin2.push(0.3 * rng.next_f32().powi(3));
        v_h.push(0.05 + 0.9 * rng.next_f32());
        weight.push(f64::from(rng.next_f32()));
    }
    for r in [0.05f32, 0.12, 0.3, 0.5, 0.8, 1.0] {
        let rough = vec![r; N];
        let (mut value, mut slope) = (vec![0.0; N], vec![0.0; N]);
        specular_chunk(
            SpecularChunk {
                n_l: &n_l,
                n_v: &n_v,
                sin2_nh: &sin2,
                v_h: &v_h,
                roughness: &rough,
            },
            &mut value,
            &mut slope,
        );
        let sum = |f: &dyn Fn(usize) -> f64| (0..N).map(|i| weight[i] * f(i)).sum::<f64>();
        let at = |r: f64| {
            let c = |x: f32| Dual::<1>::lit(f64::from(x));
            move |i: usize, n_l: &[f32], n_v: &[f32], s: &[f32], v_h: &[f32]| {
                specular(
                    c(n_l[i]),
                    c(n_v[i]),
                    c(s[i]),
                    c(v_h[i]),
                    Dual::variable(r, 0),
                )
            }
        };
        let dual = |r: f64, i: usize| at(r)(i, &n_l, &n_v, &sin2, &v_h);
        let r = f64::from(r);
        let (kernel, exact) = (sum(&|i| f64::from(slope[i])), sum(&|i| dual(r, i).d[0]));
        let h = 1e-5;
        let central = (sum(&|i| dual(r + h, i).x) - sum(&|i| dual(r - h, i).x)) / (2.0 * h);
        let size = sum(&|i| dual(r, i).d[0].abs());
        assert!(
            (kernel - exact).abs() < 2e-5 * size,
            "R {r}: kernel {kernel}, dual {exact}"
        );
        assert!(
            (central - exact).abs() < 1e-6 * size,
            "R {r}: central {central}, dual {exact}"
        );
        assert!((sum(&|i| f64::from(value[i])) / sum(&|i| dual(r, i).x) - 1.0).abs() < 1e-5);
    }
}
