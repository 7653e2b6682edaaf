//! meshoptimizer (crate `meshopt`, which builds the library's sources): its decoders of vertex and
//! index streams, for `EXT_meshopt_compression`, and its simplifier. Called by
//! `core::formats::gltf_compressed`, `prepare` and, for levels of detail, `export`.
//!
//! The crate's own functions take the size of an element as a type; a file states it as a number,
//! so the C functions are called here. They are made for input from strangers: any bytes give an
//! error or numbers, never an access outside the two buffers.

use glam::{Vec2, Vec3};
use meshopt::{SimplifyOptions, ffi};

/// How the elements of a stream are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// Vertices: elements of a multiple of four bytes, at most 256.
    Attributes,
    /// Indices of triangles: elements of two or four bytes, their number a multiple of three.
    Triangles,
    /// Any indices: elements of two or four bytes.
    Indices,
}

/// What was done to the elements before packing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// Unit vectors as octahedral coordinates: elements of four or eight bytes.
    Octahedral,
    /// Quaternions without their largest component: elements of eight bytes.
    Quaternion,
    /// Floats as exponent and mantissa: elements of a multiple of four bytes.
    Exponential,
}

/// Decodes `count` elements of `size` bytes each; `None` where the bytes are damaged or the size
/// does not go with the packing. The caller has judged `count · size` before.
#[must_use]
pub fn decode(packing: Packing, encoded: &[u8], count: usize, size: usize) -> Option<Vec<u8>> {
    let fits = match packing {
        Packing::Attributes => size > 0 && size.is_multiple_of(4) && size <= 256,
        Packing::Triangles => matches!(size, 2 | 4) && count.is_multiple_of(3),
        Packing::Indices => matches!(size, 2 | 4),
    };
    let bytes = count.checked_mul(size).filter(|_| fits)?;
    // words, because the decoders write numbers of up to four bytes
    let mut decoded = vec![0u32; bytes.div_ceil(4)];
    let to = decoded.as_mut_ptr().cast();
    let (from, length) = (encoded.as_ptr(), encoded.len());
    let run = match packing {
        Packing::Attributes => ffi::meshopt_decodeVertexBuffer,
        Packing::Triangles => ffi::meshopt_decodeIndexBuffer,
        Packing::Indices => ffi::meshopt_decodeIndexSequence,
    };
    // SAFETY: `to` has room for `count · size` bytes and is aligned for the elements, `from` for
    // `length`; sizes and counts are those the functions allow (tested above).
    let failed = unsafe { run(to, count, size, from, length) };
    let decoded: &[u8] = bytemuck::cast_slice(&decoded);
    (failed == 0).then(|| decoded[..bytes].to_vec())
}

/// Undoes a filter in place; `None` where the size of an element does not go with it.
#[must_use]
pub fn undo(filter: Filter, elements: &mut [u8], size: usize) -> Option<()> {
    let fits = match filter {
        Filter::Octahedral => matches!(size, 4 | 8),
        Filter::Quaternion => size == 8,
        Filter::Exponential => size > 0 && size.is_multiple_of(4),
    };
    if !fits || !elements.len().is_multiple_of(size) {
        return None;
    }
    let mut words = vec![0u32; elements.len() / 4];
    bytemuck::cast_slice_mut(&mut words).copy_from_slice(elements);
    let count = elements.len() / size;
    let run = match filter {
        Filter::Octahedral => ffi::meshopt_decodeFilterOct,
        Filter::Quaternion => ffi::meshopt_decodeFilterQuat,
        Filter::Exponential => ffi::meshopt_decodeFilterExp,
    };
    // SAFETY: `words` holds `count` elements of `size` bytes, aligned to four; the size is one the
    // function allows (tested above).
    unsafe { run(words.as_mut_ptr().cast(), count, size) };
    elements.copy_from_slice(bytemuck::cast_slice(&words));
    Some(())
}

/// Vertex indices of fewer triangles that leave the surface by about `error` (in the unit of the
/// positions) at most: edges are collapsed by quadric error (Garland and Heckbert 1997). Vertices
/// stay where they are, and some are used no more.
#[must_use]
pub fn simplified(indices: &[u32], positions: &[Vec3], error: f32) -> Vec<u32> {
    let positions: Vec<[f32; 3]> = positions.iter().map(Vec3::to_array).collect();
    let valid = indices.iter().all(|i| (*i as usize) < positions.len());
    if indices.is_empty() || !indices.len().is_multiple_of(3) || !valid {
        return indices.to_vec();
    }
    let options = SimplifyOptions::ErrorAbsolute;
    meshopt::simplify_decoder(indices, &positions, 0, error, options, None)
}

/// A surface with a texture, to be simplified.
#[derive(Clone, Copy, Debug)]
pub struct Textured<'a> {
    /// Vertex numbers, three for each triangle.
    pub indices: &'a [u32],
    /// Places of the vertices.
    pub positions: &'a [Vec3],
    /// Texture coordinates of the vertices.
    pub uvs: &'a [Vec2],
    /// Length of a step of 1 in the texture, in the unit of the positions: what a texture that slides
    /// counts for against a surface that moves.
    pub texture_length: f32,
    /// Vertices that stay.
    pub locked: &'a [bool],
}

/// Vertex indices of about `target` or more triangles that leave the surface by about `error` (in the
/// unit of the positions) at most, textures included: quadrics of attributes (Hoppe 1999). Vertices
/// stay where they are, and some are used no more.
#[must_use]
pub fn simplified_texture(surface: Textured<'_>, target: usize, error: f32) -> Vec<u32> {
    let Textured {
        indices,
        positions,
        uvs,
        texture_length,
        locked,
    } = surface;
    let count = positions.len();
    let valid = indices.iter().all(|i| (*i as usize) < count);
    let fits = uvs.len() == count && locked.len() == count && indices.len().is_multiple_of(3);
    if indices.is_empty() || !valid || !fits {
        return indices.to_vec();
    }
    let mut low_high = [Vec3::INFINITY, Vec3::NEG_INFINITY];
    for p in positions {
        low_high = [low_high[0].min(*p), low_high[1].max(*p)];
    }
    // the library measures in the longest side of the bounding box
    let side = (low_high[1] - low_high[0]).max_element();
    let weights = [texture_length / side.max(f32::MIN_POSITIVE); 2];
    let positions: Vec<[f32; 3]> = positions.iter().map(Vec3::to_array).collect();
    meshopt::simplify_with_attributes_and_locks_decoder(
        indices,
        &positions,
        bytemuck::cast_slice(uvs),
        &weights,
        size_of::<Vec2>(),
        locked,
        3 * target,
        error,
        SimplifyOptions::ErrorAbsolute,
        None,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_library_packs_comes_back() {
        let vertices: Vec<[f32; 3]> = (0..100).map(|i| [i as f32, 0.5, -1.0]).collect();
        let packed = meshopt::encode_vertex_buffer(&vertices).expect("packs");
        let back = decode(Packing::Attributes, &packed, 100, 12).expect("unpacks");
        assert_eq!(back, bytemuck::cast_slice::<_, u8>(&vertices));
        let indices: Vec<u32> = (0..98).flat_map(|i| [i, i + 1, i + 2]).collect();
        let packed = meshopt::encode_index_buffer(&indices, 100).expect("packs");
        let back = decode(Packing::Triangles, &packed, 294, 4).expect("unpacks");
        let word = |b: &[u8]| u32::from_le_bytes(b.try_into().expect("four bytes"));
        let back: Vec<u32> = back.chunks_exact(4).map(word).collect();
        // a triangle may begin at any of its corners
        let turned = |t: &[u32]| {
            let least = t.iter().min().copied();
            let at = t.iter().position(|i| Some(*i) == least).unwrap_or(0);
            [t[at], t[(at + 1) % 3], t[(at + 2) % 3]]
        };
        assert!(
            back.chunks(3)
                .zip(indices.chunks(3))
                .all(|(a, b)| turned(a) == turned(b))
        );
    }

    #[test]
    fn filters_give_back_the_directions_and_numbers() {
        let up = [[0.0, 0.6, 0.8, 0.0]; 2];
        let packed: Vec<[i8; 4]> = meshopt::encode_filter_oct(&up, 8);
        let mut bytes = bytemuck::cast_slice::<_, u8>(&packed).to_vec();
        undo(Filter::Octahedral, &mut bytes, 4).expect("fits");
        let z = f32::from(bytes[2] as i8) / 127.0;
        assert!((z - 0.8).abs() < 0.02, "{z}");
        let numbers = [[1.5f32, -2.25, 1e-3]];
        let packed = meshopt::encode_filter_exp(&numbers, 24, meshopt::EncodeExpMode::Separate);
        let mut bytes = bytemuck::cast_slice::<_, u8>(&packed).to_vec();
        undo(Filter::Exponential, &mut bytes, 12).expect("fits");
        let float = |b: &[u8]| f32::from_le_bytes(b.try_into().expect("four bytes"));
        let back: Vec<f32> = bytes.chunks_exact(4).map(float).collect();
        assert!(
            back.iter()
                .zip(numbers[0])
                .all(|(a, b)| (a - b).abs() < 1e-6)
        );
    }

    #[test]
    fn wrong_sizes_and_damaged_bytes_are_refused() {
        assert!(decode(Packing::Attributes, &[0xa0; 64], 4, 13).is_none());
        assert!(decode(Packing::Triangles, &[0xe1; 64], 4, 4).is_none());
        assert!(decode(Packing::Indices, &[], 3, 4).is_none());
        assert!(undo(Filter::Quaternion, &mut [0; 12], 12).is_none());
    }
}
