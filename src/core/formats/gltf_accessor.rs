//! The numbers of a glTF file: buffer views, packed or not, and the elements of accessors, dense,
//! sparse or without data (Khronos, *glTF 2.0 Specification*, 3.6.2). Called by `gltf` and
//! `gltf_scene`.

use super::gltf::{Reader, Reading};
use super::gltf_document::{Accessor, Sparse, SparseList};
use super::gltf_numbers::{component, component_size};
use std::borrow::Cow;

/// Most elements of an accessor without data. Derived: 2²⁴ vertices take 0.4 GB here, and nothing
/// in the file's size bounds them.
const MOST_ZEROS: u64 = 1 << 24;

/// Elements of an accessor.
pub(super) struct Elements<'b> {
    /// From the first element on.
    bytes: Cow<'b, [u8]>,
    /// Bytes from one element to the next.
    stride: usize,
    /// How many there are.
    pub(super) count: usize,
}

impl Elements<'_> {
    /// The `size` bytes of an element.
    pub(super) fn element(&self, i: usize, size: usize) -> &[u8] {
        &self.bytes[i * self.stride..i * self.stride + size]
    }
}

impl Reader<'_> {
    pub(super) fn accessor(&self, index: usize) -> Reading<&Accessor> {
        let found = self.document.accessors.get(index);
        found.ok_or_else(|| format!("accessor {index} does not exist; export the mesh again"))
    }

    /// The bytes of a buffer view, unpacked if they are packed.
    pub(super) fn view_bytes(&self, v: usize) -> Reading<&[u8]> {
        let again = "export the mesh again";
        let view = self
            .document
            .buffer_views
            .get(v)
            .ok_or_else(|| format!("buffer view {v} does not exist; {again}"))?;
        let in_buffer = |buffer: usize, offset: u64, length: u64| -> Reading<&[u8]> {
            let bytes = self
                .buffers
                .get(buffer)
                .ok_or_else(|| format!("buffer {buffer} does not exist; {again}"))?;
            let end = offset
                .checked_add(length)
                .filter(|e| *e <= bytes.len() as u64);
            let end = end.ok_or_else(|| {
                format!(
                    "buffer view {v} claims more than its buffer of {} bytes holds; the file is truncated or damaged, {again}",
                    bytes.len()
                )
            })?;
            Ok(&bytes[offset as usize..end as usize])
        };
        let Some(packed) = &view.extensions.packed else {
            return in_buffer(view.buffer, view.byte_offset, view.byte_length);
        };
        if let Some(done) = self.views[v].get() {
            return Ok(done);
        }
        let bytes = in_buffer(packed.buffer, packed.byte_offset, packed.byte_length)?;
        let mut sum = self.unpacked.get();
        let done = packed.unpack(bytes, &mut sum);
        self.unpacked.set(sum);
        let done = done.map_err(|e| format!("buffer view {v}: {e}"))?;
        Ok(self.views[v].get_or_init(|| done))
    }

    /// An accessor's elements of `size` bytes each, checked to lie in the buffer; those that a sparse
    /// accessor puts elsewhere are in their places.
    pub(super) fn elements(&self, index: usize, size: u64) -> Reading<Elements<'_>> {
        let a = self.accessor(index)?;
        let dense = match a.buffer_view {
            Some(view) => self.dense(index, view, size)?,
            // the standard (3.6.2.3): zeros
            None if a.count <= MOST_ZEROS => Elements {
                bytes: Cow::Owned(vec![0; (a.count * size) as usize]),
                stride: size as usize,
                count: a.count as usize,
            },
            None => {
                return Err(format!(
                    "accessor {index} has no data for its {} elements; export the mesh again",
                    a.count
                ));
            }
        };
        match &a.sparse {
            Some(sparse) => (self.with_sparse(dense, a, sparse, size as usize))
                .map_err(|e| format!("accessor {index}, sparse: {e}; export the mesh again")),
            None => Ok(dense),
        }
    }

    /// The elements that lie in a buffer view.
    fn dense(&self, index: usize, view: usize, size: u64) -> Reading<Elements<'_>> {
        let a = self.accessor(index)?;
        let bytes = self.view_bytes(view)?;
        let stated = self.document.buffer_views[view].byte_stride;
        // (some writers say 0 for "close together")
        let stride = stated.filter(|s| *s > 0).unwrap_or(size);
        let needed = if a.count == 0 {
            Some(0)
        } else {
            (a.count - 1)
                .checked_mul(stride)
                .and_then(|n| n.checked_add(size))
                .and_then(|n| n.checked_add(a.byte_offset))
        };
        if needed.is_some_and(|n| n <= bytes.len() as u64) && stride >= size {
            let begin = a.byte_offset.min(bytes.len() as u64) as usize;
            return Ok(Elements {
                bytes: Cow::Borrowed(&bytes[begin..]),
                stride: stride as usize,
                count: a.count as usize,
            });
        }
        Err(format!(
            "accessor {index} claims {} elements, more than its {} bytes hold; the file is truncated or damaged, export the mesh again",
            a.count,
            bytes.len()
        ))
    }

    /// The elements with those put in that a sparse accessor lists by number.
    fn with_sparse<'b>(
        &self,
        mut into: Elements<'b>,
        a: &Accessor,
        sparse: &Sparse,
        size: usize,
    ) -> Reading<Elements<'b>> {
        let kind = sparse.indices.component_type.unwrap_or_default();
        let width = component_size(kind).filter(|_| matches!(kind, 5121 | 5123 | 5125));
        let width = width.ok_or("its numbers are no unsigned integers")?;
        let list = |list: &SparseList, size: usize| -> Reading<&[u8]> {
            let bytes = self.view_bytes(list.buffer_view)?;
            let length = sparse.count.checked_mul(size as u64);
            let end = length.and_then(|n| n.checked_add(list.byte_offset));
            let end = end.filter(|e| *e <= bytes.len() as u64);
            let end = end.ok_or("it claims more elements than its bytes hold")?;
            Ok(&bytes[list.byte_offset as usize..end as usize])
        };
        let numbers = list(&sparse.indices, width)?.chunks_exact(width);
        let values = list(&sparse.values, size)?.chunks_exact(size);
        let bytes = into.bytes.to_mut();
        for (number, value) in numbers.zip(values) {
            let element = word(number) as usize;
            if element >= into.count {
                return Err(format!("it replaces element {element} of {}", a.count));
            }
            let at = element * into.stride;
            bytes[at..at + size].copy_from_slice(value);
        }
        Ok(into)
    }

    /// Elements of `N` numbers (16: matrices, columns first): floats or (`KHR_mesh_quantization`) integers, normalised where the
    /// accessor says so.
    pub(super) fn floats<const N: usize>(&self, index: usize) -> Reading<Vec<[f64; N]>> {
        let a = self.accessor(index)?;
        let expected = match N {
            16 => "MAT4".into(),
            _ => format!("VEC{N}"),
        };
        if a.shape != expected {
            return Err(format!(
                "accessor {index} is {}, expected {expected}; export the mesh again",
                a.shape
            ));
        }
        let width = component_size(a.component_type)
            .ok_or_else(|| format!("accessor {index}: unknown component type"))?;
        let found = self.elements(index, (width * N) as u64)?;
        let number = |b: &[u8]| component(b, a.component_type, a.normalized);
        Ok((0..found.count)
            .map(|i| found.element(i, width * N))
            .map(|e| std::array::from_fn(|k| number(&e[k * width..(k + 1) * width])))
            .collect())
    }

    pub(super) fn indices(&self, index: usize) -> Reading<Vec<u32>> {
        let a = self.accessor(index)?;
        let width = match (a.component_type, a.shape.as_str()) {
            (5121, "SCALAR") => 1,
            (5123, "SCALAR") => 2,
            (5125, "SCALAR") => 4,
            _ => {
                return Err(format!(
                    "accessor {index}: indices must be unsigned integers; export the mesh again"
                ));
            }
        };
        let found = self.elements(index, width as u64)?;
        let each = (0..found.count).map(|i| found.element(i, width));
        Ok(each.map(word).collect())
    }
}

/// An unsigned integer of up to four bytes.
fn word(bytes: &[u8]) -> u32 {
    let high_first = bytes.iter().rev();
    high_first.fold(0, |w, &b| (w << 8) | u32::from(b))
}

#[cfg(test)]
mod tests {
    use super::super::gltf::mesh_from_gltf;
    use base64::engine::Engine;
    use glam::DVec3;
    use std::path::Path;

    /// Positions of a triangle whose accessor and first view say something more.
    fn positions(accessor: &str, view: &str) -> Result<Vec<DVec3>, String> {
        let corners = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let mut bytes: Vec<u8> = corners.iter().flat_map(|f| f.to_le_bytes()).collect();
        // a number of an element, and its value
        bytes.extend([2, 0, 0, 0]);
        bytes.extend([5.0f32, 6.0, 7.0].iter().flat_map(|f| f.to_le_bytes()));
        let text = base64::prelude::BASE64_STANDARD.encode(&bytes);
        let json = format!(
            r#"{{"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "accessors":[{{{accessor}"componentType":5126,"count":3,"type":"VEC3"}}],
            "bufferViews":[{{{view}"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":4}},{{"buffer":0,"byteOffset":40,"byteLength":12}}],
            "buffers":[{{"byteLength":52,"uri":"data:application/octet-stream;base64,{text}"}}]}}"#
        );
        let mesh = mesh_from_gltf(json.as_bytes(), Path::new("t.gltf"));
        mesh.map(|m| m.positions).map_err(|e| e.to_string())
    }

    fn sparse(count: u64, kind: u32, offset: u64) -> String {
        format!(
            r#""sparse":{{"count":{count},"indices":{{"bufferView":1,"byteOffset":{offset},"componentType":{kind}}},"values":{{"bufferView":2}}}},"#
        )
    }

    #[test]
    fn sparse_elements_and_absent_data_are_what_the_standard_says() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let moved = DVec3::new(5.0, 6.0, 7.0);
        let dense = r#""bufferView":0,"#;
        assert_eq!(positions(dense, "").as_deref(), Ok(&corners[..]));
        // together, whatever 0 was meant to say
        let close = positions(dense, r#""byteStride":0,"#);
        assert_eq!(close.as_deref(), Ok(&corners[..]));
        for kind in [5121, 5123, 5125] {
            let replaced = positions(&format!("{dense}{}", sparse(1, kind, 0)), "");
            assert_eq!(replaced, Ok(vec![DVec3::ZERO, DVec3::X, moved]));
        }
        let of_zeros = positions(&sparse(1, 5121, 0), "");
        assert_eq!(of_zeros, Ok(vec![DVec3::ZERO, DVec3::ZERO, moved]));
        assert_eq!(positions("", ""), Ok(vec![DVec3::ZERO; 3]));
    }

    #[test]
    fn damaged_sparse_lists_are_errors() {
        for (list, said) in [
            (sparse(2, 5121, 0), "more elements"),
            (sparse(u64::MAX, 5125, 0), "more elements"),
            (sparse(1, 5121, u64::MAX), "more elements"),
            (sparse(1, 5126, 0), "unsigned"),
            (
                sparse(1, 5121, 0).replace(
                    "\"values\":{\"bufferView\":2",
                    "\"values\":{\"bufferView\":9",
                ),
                "view 9",
            ),
        ] {
            let e = positions(&list, "").expect_err(said);
            assert!(e.contains("accessor 0, sparse") && e.contains(said), "{e}");
        }
    }
}
