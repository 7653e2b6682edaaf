//! Numbers of glTF accessors: component types, normalised integers. Called by `gltf` and
//! `gltf_compressed`.

/// Bytes of a component type; `None` for an unknown one.
pub(super) fn component_size(kind: u32) -> Option<usize> {
    match kind {
        5120 | 5121 => Some(1),
        5122 | 5123 => Some(2),
        5125 | 5126 => Some(4),
        _ => None,
    }
}

/// A normalised integer of a component type as the number it stands for; floats stay.
pub(super) fn normalised(value: f64, kind: u32) -> f64 {
    let most = match kind {
        5120 => f64::from(i8::MAX),
        5121 => f64::from(u8::MAX),
        5122 => f64::from(i16::MAX),
        5123 => f64::from(u16::MAX),
        5125 => f64::from(u32::MAX),
        _ => return value,
    };
    (value / most).max(-1.0)
}

/// The number in the bytes of one component.
pub(super) fn component(b: &[u8], kind: u32, normalized: bool) -> f64 {
    let value = match (kind, b) {
        (5120, &[a]) => f64::from(a as i8),
        (5121, &[a]) => f64::from(a),
        (5122, &[a, b]) => f64::from(i16::from_le_bytes([a, b])),
        (5123, &[a, b]) => f64::from(u16::from_le_bytes([a, b])),
        (5125, &[a, b, c, d]) => f64::from(u32::from_le_bytes([a, b, c, d])),
        (5126, &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
        _ => f64::NAN,
    };
    if normalized {
        normalised(value, kind)
    } else {
        value
    }
}
