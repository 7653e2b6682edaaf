//! The whole header of an OpenEXR file, vetted before any library sees it.
//!
//! An OpenEXR file starts with a magic number and a version word; then come, for every part,
//! attributes (name, type, byte count, value) until an empty name. OpenImageIO 2.4 *asserts* on
//! pixel types it does not know, and a hostile data window makes a library allocate tables for
//! billions of rows on opening: neither can be caught, hence this look at every attribute that
//! either of them acts on. What a file says of its colours is read here as well.
//!
//! Source: "OpenEXR File Layout" of the OpenEXR documentation (3.x).

use crate::core::math::colour::Chromaticities;
use std::io::Read;

/// First four bytes of every OpenEXR file.
pub const MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Bytes of a header worth looking at: real ones have hundreds, some carry a preview picture.
const LIMIT: u64 = 16 << 20;

/// Parts and channels a file may have before it is called damaged.
const MOST_PARTS: usize = 256;
const MOST_CHANNELS: usize = 1024;

/// Flags of the version word.
const TILED: u32 = 0x200;
const LONG_NAMES: u32 = 0x400;
const DEEP: u32 = 0x800;
const MULTI_PART: u32 = 0x1000;

/// Compressions of OpenEXR 2 and 3.0 to 3.3, by their number: name, scan lines per chunk, and the
/// most bytes that one stored byte can stand for.
///
/// Ratios are derived: Deflate's longest match is 258 bytes in 2 bits (1032), RLE's 127 in 2;
/// B44A stores flat 4 × 4 blocks of halves in 3 bytes (32 / 3). PIZ's and DWA's coders have no
/// useful bound.
const COMPRESSIONS: [(&str, i64, f64); 10] = [
    ("none", 1, 1.0),
    ("RLE", 1, 64.0),
    ("ZIPS", 1, 1032.0),
    ("ZIP", 16, 1032.0),
    ("PIZ", 32, f64::INFINITY),
    // 24 of a float's 32 bits
    ("PXR24", 16, 1032.0 * 4.0 / 3.0),
    ("B44", 32, 32.0 / 14.0),
    ("B44A", 32, 32.0 / 3.0),
    ("DWAA", 32, f64::INFINITY),
    ("DWAB", 256, f64::INFINITY),
];

/// Compressions of later releases.
const LATER: [&str; 4] = [
    "HTJ2K256 (OpenEXR 3.4)",
    "HTJ2K32 (OpenEXR 3.4)",
    "LJ2K (OpenEXR 3.5)",
    "ZSTD (OpenEXR 3.5)",
];

/// Why a file is not read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Its header cannot be right.
    Damaged(String),
    /// It is whole, and of a kind that is not read; says the way out.
    Unsupported(String),
}

impl From<String> for Refusal {
    fn from(reason: String) -> Self {
        Self::Damaged(reason)
    }
}

impl From<&str> for Refusal {
    fn from(reason: &str) -> Self {
        Self::Damaged(reason.into())
    }
}

/// A channel of a part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExrChannel {
    /// Name, layer included: `R`, `diffuse.R`.
    pub name: String,
    /// Bytes per sample: 2 for half precision, 4 for single precision and for integers.
    pub bytes: u32,
    /// Whether every pixel has a sample of its own.
    pub full: bool,
}

/// One part of a file; a single-part file has one, without a name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExrPart {
    /// `name`, if given.
    pub name: Option<String>,
    /// `view` (`left`, `right`), if given.
    pub view: Option<String>,
    /// `type`, if given.
    pub kind: Option<String>,
    /// Channels in the order of the file.
    pub channels: Vec<ExrChannel>,
    /// Columns and rows of the data window; may be nonsense until judged.
    pub size: (i64, i64),
    /// `chromaticities`, if given.
    pub chromaticities: Option<Chromaticities>,
    /// `adoptedNeutral`: CIE (x, y) of what the picture's author calls white.
    pub neutral: Option<[f64; 2]>,
    /// `whiteLuminance`: candelas per m² of the pixel (1, 1, 1).
    pub white_luminance: Option<f64>,
    /// Text attributes, by name: the program's own marks among them.
    pub texts: Vec<(String, String)>,
    /// Number of the compression.
    pub(super) compression: usize,
    /// Size of the tiles.
    pub(super) tile: Option<(u32, u32)>,
    /// A data window was stated.
    pub(super) has_window: bool,
}

impl ExrPart {
    /// A text attribute by name.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<&str> {
        let found = self.texts.iter().find(|t| t.0 == name);
        found.map(|t| t.1.as_str())
    }

    /// Whether the part is a flat image rather than deep data.
    #[must_use]
    pub fn is_flat(&self) -> bool {
        !matches!(self.kind.as_deref(), Some("deepscanline" | "deeptile"))
    }

    /// Whether it holds luminance and chroma (Y, RY, BY) instead of red, green and blue.
    #[must_use]
    pub fn is_luminance_chroma(&self) -> bool {
        let has = |name: &str| self.channels.iter().any(|c| c.name == name);
        has("RY") && has("BY")
    }

    /// Why its samples cannot be taken pixel by pixel: channels that only every n-th pixel has,
    /// which OpenImageIO reads or refuses depending on its release.
    #[must_use]
    pub fn sampled_apart(&self) -> Option<String> {
        let coarse: Vec<&str> = (self.channels.iter().filter(|c| !c.full))
            .map(|c| c.name.as_str())
            .collect();
        let what = match self.is_luminance_chroma() {
            true => "luminance-chroma channels",
            false => "channels",
        };
        (!coarse.is_empty()).then(|| {
            format!(
                "{what} of which {} are subsampled, which is not supported: save the image as R, G, B",
                coarse.join(", ")
            )
        })
    }

    /// How a message calls it.
    #[must_use]
    pub fn title(&self) -> String {
        let names: Vec<&str> = self.channels.iter().map(|c| c.name.as_str()).collect();
        let shown = match names.len() {
            0..=6 => names.join(", "),
            n => format!("{}, ... {n} in all", names[..6].join(", ")),
        };
        let view = self.view.as_deref();
        let view = view.map_or(String::new(), |v| format!(", view {v}"));
        match &self.name {
            Some(name) => format!("\"{name}\"{view} ({shown})"),
            None => shown,
        }
    }

    /// Bytes a file of this part must at least have: one offset and one chunk header per chunk, and
    /// pixels compressed as far as their coder can.
    fn least_bytes(&self) -> f64 {
        let (w, h) = (self.size.0 as f64, self.size.1 as f64);
        let (_, lines, ratio) = COMPRESSIONS[self.compression];
        let chunks = match self.tile {
            Some((tw, th)) => (w / f64::from(tw)).ceil() * (h / f64::from(th)).ceil(),
            None => (h / lines as f64).ceil(),
        };
        let sample: u32 = self
            .channels
            .iter()
            .filter(|c| c.full)
            .map(|c| c.bytes)
            .sum();
        16.0 * chunks + w * h * f64::from(sample) / ratio
    }
}

/// Reads and vets the header of an OpenEXR file of `file_bytes` bytes; the parts in file order, or
/// what is wrong and where.
///
/// # Errors
/// If the header is damaged, or asks for more than the file holds.
pub fn vetted(file: impl Read, file_bytes: u64) -> Result<Vec<ExrPart>, Refusal> {
    let mut bytes = Vec::new();
    file.take(LIMIT)
        .read_to_end(&mut bytes)
        .map_err(|e| e.to_string())?;
    let mut rest = bytes
        .strip_prefix(&MAGIC)
        .ok_or("it does not start like an OpenEXR file")?;
    let version = u32::from_le_bytes(word(&mut rest).ok_or(CUT)?);
    let unknown = version & !(0xff | TILED | LONG_NAMES | DEEP | MULTI_PART);
    if version & 0xff != 2 || unknown != 0 {
        return Err(format!("version word {version:#x} is not one of OpenEXR 2").into());
    }
    if version & MULTI_PART != 0 && version & TILED != 0 {
        return Err("its version word calls it both multi-part and single tiled".into());
    }
    let mut parts = Vec::new();
    loop {
        let mut part = part(&mut rest, parts.len())?;
        if version & MULTI_PART == 0 {
            if version & DEEP != 0 && part.kind.is_none() {
                part.kind = Some("deepscanline".into());
            }
            if version & TILED != 0 && part.tile.is_none() {
                return Err("it is called tiled but says nothing of its tiles".into());
            }
        }
        let place = place(&part, parts.len());
        whole(&part, version).map_err(|e| format!("{place}{e}"))?;
        if let Some(name) = later_compression(&part) {
            return Err(Refusal::Unsupported(format!(
                "{place}its compression {name} is newer than this OpenImageIO: save it with ZIP, as by `oiiotool IN.exr --compression zip -o OUT.exr` of a newer one"
            )));
        }
        parts.push(part);
        if version & MULTI_PART == 0 {
            break;
        }
        if parts.len() > MOST_PARTS {
            return Err(format!("more than {MOST_PARTS} parts").into());
        }
        // an empty header ends the list
        if rest.first() == Some(&0) {
            break;
        }
    }
    // sizes beyond the limit are judged by the caller, in its own words
    let sane = |p: &&ExrPart| p.size.0 > 0 && p.size.1 > 0;
    let least: f64 = parts.iter().filter(sane).map(ExrPart::least_bytes).sum();
    if least > file_bytes as f64
        && parts
            .iter()
            .all(|p| p.size.0.checked_mul(p.size.1).is_some_and(|n| n <= 1 << 28))
    {
        let (w, h) = parts[0].size;
        return Err(format!(
            "its header states {w} × {h} pixels, which take at least {least:.0} bytes, but the file has {file_bytes}"
        )
        .into());
    }
    Ok(parts)
}

/// The compression of a part, if only later releases have it.
fn later_compression(part: &ExrPart) -> Option<&'static str> {
    let number = part.compression.checked_sub(COMPRESSIONS.len())?;
    LATER.get(number).copied()
}

const CUT: &str = "it ends within its header";

fn place(part: &ExrPart, index: usize) -> String {
    match &part.name {
        Some(name) => format!("part {index} \"{name}\": "),
        None => String::new(),
    }
}

/// The attributes of one header.
fn part(rest: &mut &[u8], index: usize) -> Result<ExrPart, String> {
    let mut part = ExrPart {
        compression: usize::MAX,
        ..ExrPart::default()
    };
    loop {
        let name = text(rest).ok_or(CUT)?;
        if name.is_empty() {
            return Ok(part);
        }
        let kind = text(rest).ok_or(CUT)?;
        let size = i32::from_le_bytes(word(rest).ok_or(CUT)?);
        let size =
            usize::try_from(size).map_err(|_| "an attribute of its header has a negative size")?;
        let value = take(rest, size).ok_or(CUT)?;
        attribute(&mut part, name, kind, value)
            .map_err(|e| format!("{}{e}", place(&part, index)))?;
    }
}

/// Takes in one attribute; those nothing depends on are passed over.
fn attribute(part: &mut ExrPart, name: &[u8], kind: &[u8], value: &[u8]) -> Result<(), String> {
    let shown = String::from_utf8_lossy(name).into_owned();
    let wrong = || format!("its attribute {shown} is not of the type it must have");
    let float = |at: usize| -> Option<f64> {
        Some(f64::from(f32::from_le_bytes(
            value.get(4 * at..4 * at + 4)?.try_into().ok()?,
        )))
    };
    let floats = |n: usize, of: &[u8]| (kind == of && value.len() == 4 * n).then_some(());
    match name {
        b"channels" => {
            if kind != b"chlist" {
                return Err(wrong());
            }
            part.channels = channels(value)?;
        }
        b"compression" => match value {
            &[n] if kind == b"compression" => part.compression = usize::from(n),
            _ => return Err(wrong()),
        },
        b"dataWindow" => {
            if kind != b"box2i" || value.len() != 16 {
                return Err("its data window is not a box of integers".into());
            }
            let edge = |i: usize| i64::from(i32_at(value, 4 * i));
            part.size = (edge(2) - edge(0) + 1, edge(3) - edge(1) + 1);
            part.has_window = true;
        }
        b"tiles" => {
            if kind != b"tiledesc" || value.len() != 9 {
                return Err(wrong());
            }
            let side = |i: usize| i32_at(value, 4 * i) as u32;
            let (w, h, mode) = (side(0), side(1), value[8]);
            if w == 0 || h == 0 || w > 1 << 16 || h > 1 << 16 || mode & 15 > 2 || mode >> 4 > 1 {
                return Err(format!("tiles of {w} × {h} pixels, mode {mode}"));
            }
            part.tile = Some((w, h));
        }
        b"lineOrder" if kind != b"lineOrder" || value.len() != 1 || value[0] > 2 => {
            return Err(wrong());
        }
        b"chromaticities" if floats(8, b"chromaticities").is_some() => {
            let v: Vec<f64> = (0..8).filter_map(float).collect();
            part.chromaticities = Chromaticities::from_list(&v);
        }
        b"adoptedNeutral" if floats(2, b"v2f").is_some() => {
            part.neutral = float(0).zip(float(1)).map(|(x, y)| [x, y]);
        }
        b"whiteLuminance" if floats(1, b"float").is_some() => part.white_luminance = float(0),
        b"name" | b"type" | b"view" if kind != b"string" => return Err(wrong()),
        _ if kind == b"string" && value.len() < 1 << 16 => {
            let text = String::from_utf8_lossy(value).into_owned();
            match name {
                b"name" => part.name = Some(text),
                b"type" => part.kind = Some(text),
                b"view" => part.view = Some(text),
                _ => part.texts.push((shown, text)),
            }
        }
        _ => {}
    }
    Ok(())
}

/// The list of channels: name, pixel type, linearity, sampling; ended by an empty name.
fn channels(mut value: &[u8]) -> Result<Vec<ExrChannel>, String> {
    let mut found = Vec::new();
    loop {
        let name = text(&mut value).ok_or("its list of channels is cut short")?;
        let name = String::from_utf8_lossy(name).into_owned();
        if name.is_empty() {
            break;
        }
        let body = take(&mut value, 16).ok_or("its list of channels is cut short")?;
        let (kind, x, y) = (i32_at(body, 0), i32_at(body, 8), i32_at(body, 12));
        let bytes = match kind {
            0 | 2 => 4,
            1 => 2,
            _ => {
                return Err(format!(
                    "channel {name} has pixel type {kind}; expected 0 (integer), 1 (half) or 2 (float)"
                ));
            }
        };
        if x < 1 || y < 1 {
            return Err(format!("channel {name} is sampled every {x} × {y} pixels"));
        }
        let full = (x, y) == (1, 1);
        found.push(ExrChannel { name, bytes, full });
        if found.len() > MOST_CHANNELS {
            return Err(format!("more than {MOST_CHANNELS} channels"));
        }
    }
    match found.len() {
        0 => Err("it has no channels".into()),
        _ => Ok(found),
    }
}

/// Whether a part says all that a reader needs, and nothing it could stumble over.
fn whole(part: &ExrPart, version: u32) -> Result<(), String> {
    if !part.has_window {
        return Err("its header has no data window".into());
    }
    if part.channels.is_empty() {
        return Err("its header lists no channels".into());
    }
    match part.compression {
        usize::MAX => return Err("its header names no compression".into()),
        n if n >= COMPRESSIONS.len() + LATER.len() => {
            return Err(format!("unknown compression {n}"));
        }
        _ => {}
    }
    let kinds = ["scanlineimage", "tiledimage", "deepscanline", "deeptile"];
    match part.kind.as_deref() {
        Some(kind) if !kinds.contains(&kind) => {
            return Err(format!(
                "its type is \"{kind}\"; expected one of {}",
                kinds.join(", ")
            ));
        }
        Some(kind) if kind.contains("tile") && part.tile.is_none() => {
            return Err("it is called tiled but says nothing of its tiles".into());
        }
        None if version & MULTI_PART != 0 => return Err("a part does not state its type".into()),
        _ => {}
    }
    if version & MULTI_PART != 0 && part.name.is_none() {
        return Err("a part has no name".into());
    }
    Ok(())
}

/// The next `n` bytes.
fn take<'a>(rest: &mut &'a [u8], n: usize) -> Option<&'a [u8]> {
    let (head, tail) = rest.split_at_checked(n)?;
    *rest = tail;
    Some(head)
}

fn word(rest: &mut &[u8]) -> Option<[u8; 4]> {
    take(rest, 4)?.try_into().ok()
}

/// The next zero-terminated string, of at most 255 characters.
fn text<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let n = rest.iter().take(256).position(|&b| b == 0)?;
    let name = take(rest, n)?;
    take(rest, 1)?;
    Some(name)
}

fn i32_at(bytes: &[u8], at: usize) -> i32 {
    i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A header of one part: channel R of pixel type `kind`, this compression and data window.
    fn header(kind: u8, compression: u8, window: [i32; 4]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([2, 0, 0, 0]);
        bytes.extend(b"channels\0chlist\0\x13\0\0\0R\0");
        bytes.extend([kind, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0]);
        bytes.extend(b"compression\0compression\0\x01\0\0\0");
        bytes.push(compression);
        bytes.extend(b"dataWindow\0box2i\0\x10\0\0\0");
        window.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes.push(0);
        bytes
    }

    fn size(bytes: &[u8]) -> Result<(i64, i64), Refusal> {
        vetted(bytes, u64::MAX).map(|p| p[0].size)
    }

    fn is_damaged(found: Result<impl Sized, Refusal>, said: &str) -> bool {
        matches!(found, Err(Refusal::Damaged(e)) if e.contains(said))
    }

    #[test]
    fn sizes_are_read_without_overflow() {
        let of = |window| size(&header(1, 3, window));
        assert_eq!(of([0, 0, 1023, 511]), Ok((1024, 512)));
        assert_eq!(of([-5, -7, 4, 2]), Ok((10, 10)));
        assert_eq!(
            of([i32::MIN, i32::MIN, i32::MAX, i32::MAX]),
            Ok((1 << 32, 1 << 32))
        );
        assert_eq!(of([3, 3, 2, 2]), Ok((0, 0)));
    }

    #[test]
    fn every_truncation_is_noticed() {
        let whole = header(1, 3, [0, 0, 9, 9]);
        for n in 0..whole.len() {
            assert!(size(&whole[..n]).is_err(), "{n} bytes");
        }
        let mut endless = MAGIC.to_vec();
        endless.resize(1000, b'a');
        assert!(size(&endless).is_err());
        let mut negative = whole;
        let at = negative.iter().position(|&b| b == 0x10).expect("size");
        negative[at + 3] = 0xff;
        assert!(size(&negative).is_err());
    }

    #[test]
    fn what_a_library_would_stumble_over_is_named() {
        for (bytes, said) in [
            (header(3, 3, [0, 0, 9, 9]), "channel R has pixel type 3"),
            (header(1, 77, [0, 0, 9, 9]), "unknown compression 77"),
        ] {
            assert!(is_damaged(size(&bytes), said), "{said}");
        }
        let mut other = header(1, 3, [0, 0, 9, 9]);
        other[4] = 3;
        assert!(is_damaged(size(&other), "version"));
    }

    #[test]
    fn what_later_releases_write_is_no_damage() {
        for (number, said) in [
            (10, "HTJ2K256"),
            (11, "HTJ2K32"),
            (12, "LJ2K"),
            (13, "ZSTD"),
        ] {
            let Err(Refusal::Unsupported(e)) = size(&header(1, number, [0, 0, 9, 9])) else {
                panic!("{number} is read, or called damaged");
            };
            assert!(e.contains(said) && e.contains("ZIP"), "{e}");
        }
    }

    #[test]
    fn subsampled_channels_are_named() {
        let of = |names: [&str; 3], every: i32| {
            let mut list = Vec::new();
            for (i, name) in names.into_iter().enumerate() {
                list.extend(name.as_bytes());
                list.extend([0, 1, 0, 0, 0, 0, 0, 0, 0]);
                let step = if i < 2 { every } else { 1 };
                list.extend([step.to_le_bytes(), step.to_le_bytes()].concat());
            }
            list.push(0);
            ExrPart {
                channels: channels(&list).expect("a list"),
                ..ExrPart::default()
            }
        };
        let coarse = of(["BY", "RY", "Y"], 2).sampled_apart().expect("refused");
        assert!(
            coarse.starts_with("luminance-chroma channels of which BY, RY are subsampled"),
            "{coarse}"
        );
        let other = of(["B", "G", "R"], 2).sampled_apart().expect("refused");
        assert!(other.starts_with("channels of which B, G are"), "{other}");
        assert_eq!(of(["BY", "RY", "Y"], 1).sampled_apart(), None);
    }

    #[test]
    fn a_stated_size_must_fit_the_file() {
        // ZIP packs 1032 to 1 at most: 23170 × 11585 halves need half a megabyte
        let bytes = header(1, 3, [0, 0, 23169, 11584]);
        assert!(is_damaged(vetted(&bytes[..], 1000), "at least"));
        assert!(vetted(&bytes[..], 1 << 20).is_ok());
    }
}
