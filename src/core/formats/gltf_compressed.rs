//! Compressed geometry of glTF: buffer views packed by meshoptimizer (`EXT_meshopt_compression` and
//! its successor `KHR_meshopt_compression`) and primitives packed by Draco
//! (`KHR_draco_mesh_compression`). Called by `gltf`.
//!
//! What a file claims is judged before anything is allocated for it: no packing can stand for more
//! than [`MOST_EXPANSION`] times its bytes, Draco for no more vertices and triangles than the
//! accessors state.

use super::gltf_numbers::{component_size, normalised};
use crate::ffi::meshopt::{Filter, Packing, decode, undo};
use draco_core::{DecodeLimits, DecoderBuffer, Mesh, MeshDecoder};
use serde::Deserialize;
use std::collections::BTreeMap;

/// Bytes that one byte of a packed buffer view can become. Derived: version 1 of the vertex codec
/// spends two bits on a block of at most 256 equal bytes; index codecs stay below 12.
const MOST_EXPANSION: u64 = 1024;
/// Bytes that all packed buffer views of a file may become. Derived: 2²⁷ vertices (the most that
/// `gltf` reads) of position, normal and texture coordinates in single precision.
const MOST_UNPACKED: u64 = 32 << 27;
/// Bytes per vertex that a Draco primitive may take. Derived: sixteen attributes of four floats.
const MOST_VERTEX_BYTES: u64 = 256;

/// The extension object of a packed buffer view.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct PackedView {
    /// Buffer of the packed bytes.
    pub buffer: usize,
    /// First packed byte.
    #[serde(default)]
    pub byte_offset: u64,
    /// Number of packed bytes.
    pub byte_length: u64,
    byte_stride: u64,
    count: u64,
    mode: String,
    filter: Option<String>,
}

impl PackedView {
    /// The unpacked bytes; what they take is added to `unpacked`, the sum over the file.
    ///
    /// # Errors
    /// An unknown mode or filter, damaged bytes, or more than a file may ask for.
    pub(super) fn unpack(&self, packed: &[u8], unpacked: &mut u64) -> Result<Vec<u8>, String> {
        let packing = match self.mode.as_str() {
            "ATTRIBUTES" => Packing::Attributes,
            "TRIANGLES" => Packing::Triangles,
            "INDICES" => Packing::Indices,
            other => return Err(format!("unknown packing {other}; {AGAIN}")),
        };
        let filter = match self.filter.as_deref() {
            None | Some("NONE") => None,
            Some("OCTAHEDRAL") => Some(Filter::Octahedral),
            Some("QUATERNION") => Some(Filter::Quaternion),
            Some("EXPONENTIAL") => Some(Filter::Exponential),
            Some(other) => return Err(format!("unknown filter {other}; {AGAIN}")),
        };
        let possible = (packed.len() as u64).saturating_mul(MOST_EXPANSION);
        let asked = self.count.checked_mul(self.byte_stride);
        let bytes = asked.filter(|b| *b <= possible).ok_or_else(|| {
            format!(
                "its packed bytes cannot stand for {} elements of {} bytes; {AGAIN}",
                self.count, self.byte_stride
            )
        })?;
        *unpacked = unpacked.saturating_add(bytes);
        if *unpacked > MOST_UNPACKED {
            return Err(format!(
                "the packed data unfolds to more than {MOST_UNPACKED} bytes; simplify the mesh"
            ));
        }
        let (count, stride) = (self.count as usize, self.byte_stride as usize);
        let damaged = || format!("its packed bytes are damaged; copy the file again or {AGAIN}");
        let mut out = decode(packing, packed, count, stride).ok_or_else(damaged)?;
        if let Some(filter) = filter {
            undo(filter, &mut out, stride).ok_or_else(damaged)?;
        }
        Ok(out)
    }
}

/// The way out of every error here.
const AGAIN: &str = "export the mesh again without compression";

/// The extension object of a primitive packed by Draco.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct DracoPrimitive {
    /// Buffer view of the packed bytes.
    pub buffer_view: usize,
    /// Draco's number of every attribute by its name in glTF.
    pub attributes: BTreeMap<String, u32>,
}

/// A primitive unpacked by Draco.
pub(super) struct Unpacked(Mesh);

impl Unpacked {
    /// Unpacks at most `vertices` vertices and `triangles` triangles.
    ///
    /// # Errors
    /// Damaged bytes, or other numbers of vertices or triangles than stated.
    pub(super) fn new(packed: &[u8], vertices: u64, triangles: u64) -> Result<Self, String> {
        let limits = DecodeLimits::default()
            .with_max_points(vertices)
            .with_max_faces(triangles)
            .with_max_decoded_bytes(vertices.saturating_mul(MOST_VERTEX_BYTES));
        let mut buffer = DecoderBuffer::new(packed).with_limits(limits);
        let mut mesh = Mesh::new();
        MeshDecoder::new()
            .decode(&mut buffer, &mut mesh)
            .map_err(|e| format!("Draco: {e}; copy the file again or {AGAIN}"))?;
        let (found, faces) = (mesh.num_points() as u64, mesh.num_faces() as u64);
        if found != vertices || faces != triangles {
            return Err(format!(
                "Draco: {found} vertices and {faces} triangles where the file states {vertices} and {triangles}; {AGAIN}"
            ));
        }
        Ok(Self(mesh))
    }

    /// The vectors of attribute `id`, one per vertex, as the accessor of type `component` has them.
    ///
    /// # Errors
    /// There is no such attribute, or its elements have another length.
    pub(super) fn vectors<const N: usize>(
        &self,
        id: u32,
        component: u32,
        normalized: bool,
    ) -> Result<Vec<[f64; N]>, String> {
        let attribute = self.0.attribute_by_unique_id(id);
        let attribute = attribute
            .filter(|a| usize::from(a.num_components()) == N)
            .ok_or_else(|| format!("Draco: no attribute {id} of {N} numbers; {AGAIN}"))?;
        if component_size(component).is_none() {
            return Err(format!("unknown component type {component}; {AGAIN}"));
        }
        let flat = attribute.read_f32s(self.0.num_points(), N);
        let number = |v: f32| match normalized {
            true => normalised(f64::from(v), component),
            false => f64::from(v),
        };
        Ok(flat
            .chunks_exact(N)
            .map(|c| std::array::from_fn(|k| number(c[k])))
            .collect())
    }

    /// Vertex numbers per triangle.
    pub(super) fn triangles(&self) -> Vec<[u32; 3]> {
        self.0.faces().iter().map(|f| f.map(|p| p.0)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(count: u64, stride: u64, more: &str) -> PackedView {
        let text = format!(
            r#"{{"buffer": 0, "byteLength": 8, "byteStride": {stride}, "count": {count}, "mode": "ATTRIBUTES"{more}}}"#
        );
        serde_json::from_str(&text).expect("a view")
    }

    #[test]
    fn nothing_is_allocated_that_the_bytes_cannot_stand_for() {
        for (count, stride) in [(1 << 40, 16), (u64::MAX, 2), (8193, 1)] {
            let e = view(count, stride, "")
                .unpack(&[0xa0; 8], &mut 0)
                .expect_err("too many");
            assert!(e.contains("cannot stand for"), "{e}");
        }
        let mut asked = MOST_UNPACKED;
        let e = view(4, 16, "")
            .unpack(&[0xa0; 8], &mut asked)
            .expect_err("too many in all");
        assert!(e.contains("unfolds"), "{e}");
        let e = view(4, 16, r#", "filter": "NEW""#)
            .unpack(&[0xa0; 8], &mut 0)
            .expect_err("filter");
        assert!(e.contains("NEW"), "{e}");
    }

    #[test]
    fn draco_must_hold_what_the_file_states() {
        let e = Unpacked::new(b"DRACO\x02\x02\x01\x00", 3, 1)
            .err()
            .expect("too short");
        assert!(e.contains("Draco"), "{e}");
    }
}
