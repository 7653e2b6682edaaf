//! The bytes of a glTF file: the chunks of a `.glb`, buffers and pictures within or beside it. Called by
//! `gltf` and `gltf_scene`.

use super::gltf_document::{Buffer, OLD_STANDARD};
use super::surface_look::beside;
use super::{MOST_DATA, read_input, without_mark};
use crate::{Error, Result};
use base64::engine::Engine;
use std::borrow::Cow;
use std::path::Path;

/// The JSON of a `.glb` or `.gltf`, and the binary chunk if there is one.
pub(super) fn split<'a>(bytes: &'a [u8], path: &Path) -> Result<(&'a [u8], Option<&'a [u8]>)> {
    let (json, blob) = match bytes.starts_with(b"glTF") {
        true => split_glb(bytes).map_err(|m| Error::input(path, m))?,
        false => (bytes, None),
    };
    // some writers fill the chunk up with zeros, some editors put a mark before the first letter
    let json = without_mark(json);
    let end = json
        .iter()
        .rposition(|b| *b != 0)
        .map_or(0, |last| last + 1);
    Ok((&json[..end], blob))
}

/// The JSON and binary chunks of a `.glb`.
fn split_glb(bytes: &[u8]) -> std::result::Result<(&[u8], Option<&[u8]>), String> {
    let word = |at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(
            bytes.get(at..at.checked_add(4)?)?.try_into().ok()?,
        ))
    };
    let truncated = || {
        format!(
            "truncated .glb ({} bytes); copy the file again",
            bytes.len()
        )
    };
    let version = word(4).ok_or_else(truncated)?;
    if version == 1 {
        return Err(OLD_STANDARD.into());
    }
    if version != 2 {
        return Err(format!(
            "glTF binary version {version}; only version 2 is supported"
        ));
    }
    if word(8).ok_or_else(truncated)? as usize > bytes.len() {
        return Err(truncated());
    }
    let (mut at, mut json, mut blob) = (12usize, None, None);
    while at + 8 <= bytes.len() {
        let (length, kind) = (
            word(at).ok_or_else(truncated)? as usize,
            word(at + 4).ok_or_else(truncated)?,
        );
        let chunk = at
            .checked_add(8)
            .and_then(|b| bytes.get(b..b.checked_add(length)?))
            .ok_or_else(truncated)?;
        match kind {
            0x4E4F_534A if json.is_none() => json = Some(chunk),
            0x004E_4942 if blob.is_none() => blob = Some(chunk),
            _ => {}
        }
        at += 8 + length;
    }
    Ok((
        json.ok_or("the .glb has no JSON chunk; export the mesh again")?,
        blob,
    ))
}

/// The bytes of buffer `i`.
pub(super) fn load_buffer<'a>(
    i: usize,
    buffer: &Buffer,
    blob: Option<&'a [u8]>,
    path: &Path,
) -> Result<Cow<'a, [u8]>> {
    let fail = |m: String| Error::input(path, m);
    if buffer
        .extensions
        .packed
        .as_ref()
        .is_some_and(|p| p.fallback)
    {
        return Ok(Cow::Borrowed(&[]));
    }
    let Some(uri) = &buffer.uri else {
        return blob.map(Cow::Borrowed).ok_or_else(|| {
            fail(format!(
                "buffer {i} has neither a uri nor a binary chunk; export the mesh again"
            ))
        });
    };
    load_uri(&format!("buffer {i}"), uri, path).map(Cow::Owned)
}

/// The bytes that a uri stands for: embedded, or those of a file beside the glTF file or below.
/// `what` is named in errors.
pub(super) fn load_uri(what: &str, uri: &str, path: &Path) -> Result<Vec<u8>> {
    let fail = |m: String| Error::input(path, m);
    if let Some(data) = uri.strip_prefix("data:") {
        let encoded = data
            .split_once(";base64,")
            .ok_or_else(|| fail(format!("{what}: the data uri is not base64")))?
            .1;
        return decode_base64(encoded)
            .ok_or_else(|| fail(format!("{what}: damaged base64; export the mesh again")));
    }
    let name = decode_percent(uri);
    // a scene from a stranger must not put the bytes of any file into what its user publishes
    let file = beside(path, &name).filter(|_| !uri.contains("://"));
    let file = file.ok_or_else(|| {
        fail(format!(
            "{what} lies at {uri}; only files beside the mesh or below are read. Export with embedded buffers"
        ))
    })?;
    read_input(&file, MOST_DATA).map_err(|e| {
        e.advise(&format!(
            "it is {what} of {}: keep it beside the .gltf or export a .glb",
            path.display()
        ))
    })
}

/// Padding and line breaks as they come: what exporters write differs in both.
fn decode_base64(text: &str) -> Option<Vec<u8>> {
    use base64::alphabet::STANDARD;
    use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
    const LENIENT: GeneralPurpose = GeneralPurpose::new(
        &STANDARD,
        GeneralPurposeConfig::new()
            .with_decode_padding_mode(DecodePaddingMode::Indifferent)
            .with_decode_allow_trailing_bits(true),
    );
    let text: Vec<u8> = text
        .bytes()
        .filter(|c| !c.is_ascii_whitespace())
        .map(|c| match c {
            b'-' => b'+', // the alphabet for addresses
            b'_' => b'/',
            c => c,
        })
        .collect();
    LENIENT.decode(text).ok()
}

fn decode_percent(uri: &str) -> String {
    let (bytes, mut out, mut i) = (uri.as_bytes(), Vec::with_capacity(uri.len()), 0);
    while i < bytes.len() {
        let hex = |c: u8| (c as char).to_digit(16).map(|d| d as u8);
        let escaped = (bytes[i] == b'%' && i + 2 < bytes.len())
            .then(|| Some(hex(bytes[i + 1])? * 16 + hex(bytes[i + 2])?))
            .flatten();
        out.push(escaped.unwrap_or(bytes[i]));
        i += if escaped.is_some() { 3 } else { 1 };
    }
    String::from_utf8_lossy(&out).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fillings_and_marks_around_the_json_do_not_matter() {
        let split = |bytes: &[u8]| {
            let found = split(bytes, Path::new("m.glb"));
            found
                .map(|(json, _)| json.to_vec())
                .map_err(|e| e.to_string())
        };
        assert_eq!(split(b"\xef\xbb\xbf{}"), Ok(b"{}".to_vec()));
        let mut glb = b"glTF\x02\0\0\0\x18\0\0\0\x04\0\0\0JSON{}\0\0".to_vec();
        assert_eq!(split(&glb), Ok(b"{}".to_vec()));
        glb[4] = 1;
        let old = split(&glb).expect_err("glTF 1.0");
        assert!(old.contains("glTF 1.0") && old.contains("convert"), "{old}");
        assert_eq!(split(b"\0\0"), Ok(Vec::new()));
    }
}
