//! The specular lobe and its derivative: the vector kernel beside its scalar reference.
//!
//! `cargo bench --bench kernel`. `unbake bench kernel` measures the same beside the machine's
//! limits.

use divan::Bencher;
use divan::counter::ItemsCount;
use unbake::core::brdf::{SpecularChunk, specular_chunk, specular_d_roughness};
use unbake::core::sampling::KeyedRng;

/// Elements per call: all slices together stay in a second-level cache.
const COUNT: usize = 4096;

fn main() {
    divan::main();
}

/// n·l, n·v, ‖n×h‖², v·h and R.
fn inputs() -> [Vec<f32>; 5] {
    let mut rng = KeyedRng::new(5, 0);
    std::array::from_fn(|_| (0..COUNT).map(|_| 0.01 + 0.98 * rng.next_f32()).collect())
}

#[divan::bench]
fn vector_kernel(bencher: Bencher<'_, '_>) {
    let [n_l, n_v, sin2_nh, v_h, roughness] = &inputs();
    let (mut value, mut slope) = (vec![0.0; COUNT], vec![0.0; COUNT]);
    bencher.counter(ItemsCount::new(COUNT)).bench_local(|| {
        let input = SpecularChunk {
            n_l,
            n_v,
            sin2_nh,
            v_h,
            roughness,
        };
        specular_chunk(input, &mut value, &mut slope);
        divan::black_box(value[COUNT / 2])
    });
}

#[divan::bench]
fn scalar_reference(bencher: Bencher<'_, '_>) {
    let [n_l, n_v, sin2_nh, v_h, roughness] = &inputs();
    bencher.counter(ItemsCount::new(COUNT)).bench_local(|| {
        (0..COUNT)
            .map(|i| specular_d_roughness(n_l[i], n_v[i], sin2_nh[i], v_h[i], roughness[i]).1)
            .sum::<f32>()
    });
}
