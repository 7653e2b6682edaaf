//! NeRF's encoding of positions and directions (Mildenhall et al. 2020, eq. 4, without π): x, then
//! sin 2ᵏx and cos 2ᵏx.

use glam::Vec3;
use nalgebra::DMatrix;

/// Numbers of a position encoded with so many octaves.
#[must_use]
pub const fn encoded_size(octaves: usize) -> usize {
    3 + 6 * octaves
}

/// Writes the encoding of `p` with as many octaves as `out` has room for ([`encoded_size`]).
pub fn encode(p: Vec3, out: &mut [f32]) {
    let (own, octaves) = out.split_at_mut(3);
    own.copy_from_slice(&p.to_array());
    for (k, octave) in octaves.chunks_exact_mut(6).enumerate() {
        for axis in 0..3 {
            (octave[axis], octave[3 + axis]) = (p[axis] * (1u32 << k) as f32).sin_cos();
        }
    }
}

/// The encodings of some positions, a column each.
#[must_use]
pub fn encoded(positions: impl ExactSizeIterator<Item = Vec3>, octaves: usize) -> DMatrix<f32> {
    let mut x = DMatrix::zeros(encoded_size(octaves), positions.len());
    let columns = x.as_mut_slice().chunks_mut(encoded_size(octaves));
    columns
        .zip(positions)
        .for_each(|(column, p)| encode(p, column));
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_where_the_paper_has_them() {
        let mut e = vec![0.0; encoded_size(10)];
        encode(Vec3::new(0.5, -1.0, 2.0), &mut e);
        assert_eq!(e[..3], [0.5, -1.0, 2.0]);
        assert!((e[3] - 0.5f32.sin()).abs() < 1e-7 && (e[7] - (-1.0f32).cos()).abs() < 1e-7);
        assert!((e[3 + 6 * 9 + 2] - (2.0f32 * 512.0).sin()).abs() < 1e-6);
        assert_eq!(e.len(), 63);
    }
}
