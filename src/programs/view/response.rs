//! What surfaces send towards a viewer under even light, by the solution's reflection model, as a texture of the page.

use crate::core::brdf::Reflectance;
use crate::core::parallel::prelude::*;
use crate::specular::under_even_light;
use half::f16;

/// Cells over n·v and over the roughness; their middles are tabulated.
const SIZE: usize = 32;

/// Rows of rising roughness, columns of rising n·v, per cell four half floats: specular radiance of what is no metal, that of a white
/// metal, the factor on the diffuse radiance πL/(A·E), and 1.
#[must_use]
pub fn table(model: Reflectance) -> Vec<u8> {
    let middle = |i: usize| (i as f32 + 0.5) / SIZE as f32;
    let cells: Vec<[f32; 4]> = (0..SIZE * SIZE)
        .into_par_iter()
        .map(|i| {
            let (n_v, roughness) = (middle(i % SIZE), middle(i / SIZE));
            let [dielectric, metal] = under_even_light(model, n_v, roughness);
            [dielectric, metal, model.diffuse_factor(n_v, roughness), 1.0]
        })
        .collect();
    let halves = cells.as_flattened().iter().map(|&x| f16::from_f32(x));
    halves.flat_map(f16::to_le_bytes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_complete() {
        let bytes = table(Reflectance::Burley);
        let values: Vec<f32> = (bytes.chunks_exact(2))
            .map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32())
            .collect();
        assert_eq!(values.len(), SIZE * SIZE * 4);
        assert!(values.iter().all(|x| (0.0..2.0).contains(x)));
        // smooth and seen head-on: F0, and all of it
        let [dielectric, metal] = [0, 1].map(|k| values[(SIZE - 1) * 4 + k]);
        assert!((dielectric - 0.04).abs() < 1e-3, "{dielectric}");
        assert!((metal - 1.0).abs() < 1e-2, "{metal}");
    }
}
