//! USD in binary form (`.usdc`, "crate" files of version 0.4 and later): the same tree of prims as
//! `usda` reads from text.
//!
//! A crate file is a table of sections: tokens, strings, fields (name, value), sets of fields,
//! paths as a depth-first tree, and specs (path, set of fields, kind). Tables are LZ4 blocks, most
//! of them of integers as differences in one, two or four bytes (OpenUSD, `pxr/usd/sdf`: crateFile,
//! integerCoding, fastCompression). Values lie inline in their field or at an offset; only the types
//! that geometry needs are read, others are left out. Called by `roomplan`.
//!
//! Nothing is allocated that the file's own bytes could not stand for, and all values together stay
//! below [`MOST_VALUES`].

use super::usd_layer::{Prim, Value};
use std::cell::Cell;
use std::collections::BTreeMap;

/// What such a file begins with.
pub const MAGIC: &[u8] = b"PXR-USDC";

/// Most numbers, names and paths in all: a room has thousands. Derived: 2²⁶ take 2 GiB as values.
const MOST_VALUES: u64 = 1 << 26;
/// Bytes that one byte of an LZ4 block can become (the format's largest match length per byte).
const LZ4_EXPANSION: usize = 255;
/// Deepest path, and deepest dictionary.
const DEEPEST: usize = 64;
/// Arrays shorter than this are stored plainly although marked as packed.
const SHORTEST_PACKED: u64 = 16;

type Reading<T> = Result<T, String>;

/// Reads a layer.
///
/// # Errors
/// What was expected, and in which section.
pub fn parse(bytes: &[u8]) -> Reading<Prim> {
    let file = Crate::open(bytes)?;
    file.layer()
}

fn damaged<T>(what: &str) -> Reading<T> {
    Err(format!(
        "damaged binary USD ({what}); copy the file again or convert it to text (`usdcat -o out.usda`)"
    ))
}

/// Bytes with a place in them.
#[derive(Clone, Copy)]
struct Bytes<'a> {
    all: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    fn take(&mut self, count: u64) -> Reading<&'a [u8]> {
        let end = usize::try_from(count)
            .ok()
            .and_then(|n| self.at.checked_add(n));
        match end.and_then(|e| self.all.get(self.at..e)) {
            Some(found) => {
                self.at += found.len();
                Ok(found)
            }
            None => damaged("it ends early"),
        }
    }

    fn array<const N: usize>(&mut self) -> Reading<[u8; N]> {
        let found = self.take(N as u64)?;
        found.try_into().or_else(|_| damaged("it ends early"))
    }

    fn u32(&mut self) -> Reading<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Reading<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// A block of at most `most` bytes, its packed length before it.
    fn packed(&mut self, most: usize) -> Reading<Vec<u8>> {
        let length = self.u64()?;
        unpack(self.take(length)?, most)
    }

    /// `count` integers, packed.
    fn integers(&mut self, count: u64) -> Reading<Vec<u32>> {
        let length = self.u64()?;
        unpack_integers(self.take(length)?, count)
    }
}

/// LZ4 blocks behind a number of chunks; 0 = one block without lengths.
fn unpack(packed: &[u8], most: usize) -> Reading<Vec<u8>> {
    let Some((&chunks, mut rest)) = packed.split_first() else {
        return damaged("an empty block");
    };
    let mut out = Vec::new();
    for chunk in 0..usize::from(chunks).max(1) {
        let block = if chunks == 0 {
            rest
        } else {
            let mut bytes = Bytes { all: rest, at: 0 };
            let length = bytes.u32()?;
            let block = bytes.take(u64::from(length))?;
            rest = &rest[bytes.at..];
            block
        };
        let room = block.len().saturating_mul(LZ4_EXPANSION).saturating_add(64);
        let start = out.len();
        out.resize(start + room.min(most - start), 0);
        match lz4_flex::block::decompress_into(block, &mut out[start..]) {
            Ok(n) => out.truncate(start + n),
            Err(_) => return damaged(&format!("block {chunk} is no LZ4")),
        }
    }
    Ok(out)
}

/// Integers as differences: the most frequent one first, then two bits each that say whether it is
/// that one or stored in one, two or four bytes.
fn unpack_integers(packed: &[u8], count: u64) -> Reading<Vec<u32>> {
    if count > MOST_VALUES {
        return damaged("too many numbers");
    }
    let count = count as usize;
    let codes = count.div_ceil(4);
    let plain = unpack(packed, 4 + codes + 4 * count)?;
    let mut bytes = Bytes { all: &plain, at: 0 };
    if count == 0 {
        return Ok(Vec::new());
    }
    let common = i32::from_le_bytes(bytes.array()?);
    let codes = bytes.take(codes as u64)?;
    let mut previous = 0i32;
    let mut out = Vec::with_capacity(count);
    for i in 0..count {
        let difference = match codes[i / 4] >> (2 * (i % 4)) & 3 {
            0 => common,
            1 => i32::from(i8::from_le_bytes(bytes.array()?)),
            2 => i32::from(i16::from_le_bytes(bytes.array()?)),
            _ => i32::from_le_bytes(bytes.array()?),
        };
        previous = previous.wrapping_add(difference);
        out.push(previous as u32);
    }
    Ok(out)
}

/// Types of values by their number in the file (OpenUSD, crateDataTypes.h).
#[derive(Clone, Copy)]
enum Kind {
    /// Integers and enumerations of so many bytes, signed or not.
    Integer(usize, bool),
    /// A float of so many bytes.
    Float(usize),
    String,
    Token,
    Asset,
    /// A square matrix of doubles.
    Matrix(usize),
    /// Components of so many bytes, floats or integers.
    Vector(usize, usize, bool),
    Dictionary,
    References,
    Payloads,
    TokenVector,
}

fn kind_of(number: u64) -> Option<Kind> {
    Some(match number {
        1 | 2 => Kind::Integer(1, false),
        3 => Kind::Integer(4, true),
        4 => Kind::Integer(4, false),
        5 => Kind::Integer(8, true),
        6 => Kind::Integer(8, false),
        7 => Kind::Float(2),
        8 => Kind::Float(4),
        9 | 56 => Kind::Float(8),
        10 => Kind::String,
        11 => Kind::Token,
        12 => Kind::Asset,
        13..=15 => Kind::Matrix(number as usize - 11),
        16 => Kind::Vector(4, 8, true),
        17 => Kind::Vector(4, 4, true),
        18 => Kind::Vector(4, 2, true),
        19..=30 => {
            let (n, form) = (2 + (number as usize - 19) / 4, (number - 19) % 4);
            match form {
                0 => Kind::Vector(n, 8, true),
                1 => Kind::Vector(n, 4, true),
                2 => Kind::Vector(n, 2, true),
                _ => Kind::Vector(n, 4, false),
            }
        }
        31 => Kind::Dictionary,
        35 => Kind::References,
        55 => Kind::Payloads,
        41 => Kind::TokenVector,
        42..=44 => Kind::Integer(4, false),
        _ => return None,
    })
}

/// A number of `width` bytes.
fn number(b: &[u8], float: bool, signed: bool) -> f64 {
    match (b, float) {
        (&[a], _) if signed => f64::from(a as i8),
        (&[a], _) => f64::from(a),
        (&[a, b], _) => half::f16::from_le_bytes([a, b]).to_f64(),
        (&[a, b, c, d], true) => f64::from(f32::from_le_bytes([a, b, c, d])),
        (&[a, b, c, d], false) if signed => f64::from(i32::from_le_bytes([a, b, c, d])),
        (&[a, b, c, d], false) => f64::from(u32::from_le_bytes([a, b, c, d])),
        (b, float) => match b.try_into().map(u64::from_le_bytes) {
            Ok(bits) if float => f64::from_bits(bits),
            Ok(bits) if signed => bits as i64 as f64,
            Ok(bits) => bits as f64,
            Err(_) => f64::NAN,
        },
    }
}

/// Where a path stands: its parent and its last name; a property begins with a dot in text.
struct Place {
    parent: Option<usize>,
    name: String,
    is_property: bool,
}

struct Crate<'a> {
    bytes: &'a [u8],
    /// The n of version 0.n: lengths of arrays have eight bytes since 7, payloads an offset of time
    /// since 8.
    version: u8,
    tokens: Vec<String>,
    /// Token of every string.
    strings: Vec<u32>,
    /// Token of the name, and the value.
    fields: Vec<(u32, u64)>,
    /// Fields of all sets, each set ended by `u32::MAX`.
    sets: Vec<u32>,
    /// Paths by their number.
    places: BTreeMap<usize, Place>,
    /// Path, first field of its set, kind.
    specs: Vec<[u32; 3]>,
    /// Values read so far.
    spent: Cell<u64>,
}

impl<'a> Crate<'a> {
    fn open(bytes: &'a [u8]) -> Reading<Self> {
        let mut head = Bytes { all: bytes, at: 0 };
        if head.take(8)? != MAGIC {
            return Err("no binary USD layer".into());
        }
        let version: [u8; 8] = head.array()?;
        if version[0] != 0 || version[1] < 4 {
            return Err(format!(
                "binary USD of version {}.{}; expected 0.4 or later: convert it to text (`usdcat -o out.usda`)",
                version[0], version[1]
            ));
        }
        let sections = Sections::read(bytes, head.u64()?)?;
        let mut file = Self {
            bytes,
            version: version[1],
            tokens: tokens(&mut sections.get("TOKENS")?)?,
            strings: Vec::new(),
            fields: Vec::new(),
            sets: Vec::new(),
            places: BTreeMap::new(),
            specs: Vec::new(),
            spent: Cell::new(0),
        };
        let mut strings = sections.get("STRINGS")?;
        let count = strings.u64()?;
        file.strings = match count.checked_mul(4) {
            Some(length) => strings.take(length)?.as_chunks::<4>().0,
            None => return damaged("strings"),
        }
        .iter()
        .map(|b| u32::from_le_bytes(*b))
        .collect();
        file.fields = fields(&mut sections.get("FIELDS")?)?;
        let mut sets = sections.get("FIELDSETS")?;
        let count = sets.u64()?;
        file.sets = sets.integers(count)?;
        file.places = places(&mut sections.get("PATHS")?, &file.tokens)?;
        file.specs = specs(&mut sections.get("SPECS")?)?;
        Ok(file)
    }

    fn token(&self, index: u32) -> Reading<&str> {
        match self.tokens.get(index as usize) {
            Some(t) => Ok(t),
            None => damaged("a name that is not in its table"),
        }
    }

    fn string(&self, index: u32) -> Reading<&str> {
        match self.strings.get(index as usize) {
            Some(&t) => self.token(t),
            None => damaged("a text that is not in its table"),
        }
    }

    /// The fields of a spec by name.
    fn fields_of(&self, set: u32) -> Reading<BTreeMap<&str, Value>> {
        let mut found = BTreeMap::new();
        let rest = self.sets.get(set as usize..).unwrap_or_default();
        for &field in rest.iter().take_while(|f| **f != u32::MAX) {
            let Some(&(name, value)) = self.fields.get(field as usize) else {
                return damaged("a field that is not in its table");
            };
            let name = self.token(name)?;
            if let Some(value) = self.value(value, 0)? {
                found.insert(name, value);
            }
        }
        Ok(found)
    }

    /// The tree of prims with their properties.
    fn layer(&self) -> Reading<Prim> {
        // kinds of specs: 1 attribute, 6 prim, 7 the layer itself, 8 relationship
        let mut prims: BTreeMap<usize, (u64, Prim)> = BTreeMap::new();
        let mut properties = Vec::new();
        for &[path, set, kind] in &self.specs {
            let Some(place) = self.places.get(&(path as usize)) else {
                return damaged("a spec without a path");
            };
            let mut fields = self.fields_of(set)?;
            match kind {
                6 | 7 => {
                    let number = |v: Value| v.number().map_or(0, |n| n as u64);
                    let specifier = fields.remove("specifier").map_or(0, number);
                    let kind = fields.remove("typeName");
                    let prim = Prim {
                        kind: kind.as_ref().and_then(Value::text).unwrap_or("").into(),
                        name: place.name.clone(),
                        metadata: fields.into_iter().map(|(k, v)| (k.into(), v)).collect(),
                        ..Prim::default()
                    };
                    prims.insert(path as usize, (specifier, prim));
                }
                1 | 8 if place.is_property => {
                    let value = fields.remove("default");
                    properties.extend(value.map(|v| (place, v)));
                }
                _ => {}
            }
        }
        for (place, value) in properties {
            let owner = place.parent.and_then(|p| prims.get_mut(&p));
            if let Some((_, prim)) = owner {
                prim.properties.insert(place.name.clone(), value);
            }
        }
        self.assemble(prims)
    }

    /// Children into their parents, the deepest first; classes (specifier 2) are no geometry.
    fn assemble(&self, mut prims: BTreeMap<usize, (u64, Prim)>) -> Reading<Prim> {
        let parent = |path: usize| self.places.get(&path).and_then(|p| p.parent);
        let depth = |path: usize| {
            std::iter::successors(Some(path), |&p| parent(p))
                .take(DEEPEST + 1)
                .count()
        };
        let mut order: Vec<(usize, usize)> = prims.keys().map(|&p| (depth(p), p)).collect();
        if order.iter().any(|o| o.0 > DEEPEST) {
            return damaged("prims nested too deeply");
        }
        order.sort_by_key(|&(depth, path)| (std::cmp::Reverse(depth), path));
        for (_, path) in order {
            let Some(above) = parent(path) else { continue };
            let Some((specifier, mut prim)) = prims.remove(&path) else {
                continue;
            };
            in_written_order(&mut prim);
            if let Some((_, above)) = prims.get_mut(&above).filter(|_| specifier != 2) {
                above.children.push(prim);
            }
        }
        let root = prims.into_values().next();
        let Some((_, mut root)) = root else {
            return damaged("no root");
        };
        in_written_order(&mut root);
        Ok(root)
    }

    /// Counts values against the most there may be.
    fn spend(&self, count: u64) -> Reading<usize> {
        let all = self.spent.get().saturating_add(count);
        self.spent.set(all);
        if all > MOST_VALUES {
            return Err(format!(
                "more than {MOST_VALUES} values; simplify the model"
            ));
        }
        Ok(count as usize)
    }

    /// A value from its 64 bits: flags, a type, and 48 bits of payload; `None` for types that are
    /// not read.
    fn value(&self, bits: u64, depth: usize) -> Reading<Option<Value>> {
        let Some(kind) = kind_of(bits >> 48 & 0xff) else {
            return Ok(None);
        };
        if depth > DEEPEST {
            return damaged("dictionaries nested too deeply");
        }
        let (is_array, inlined) = (bits >> 63 & 1 == 1, bits >> 62 & 1 == 1);
        let payload = bits & 0xffff_ffff_ffff;
        if inlined && !is_array {
            return self.inline(kind, payload as u32).map(Some);
        }
        let at = usize::try_from(payload).unwrap_or(usize::MAX);
        if is_array && payload == 0 {
            return Ok(Some(Value::List(Vec::new())));
        }
        let mut from = Bytes {
            all: self.bytes,
            at,
        };
        if is_array {
            let length = match self.version >= 7 {
                true => from.u64()?,
                false => u64::from(from.u32()?),
            };
            let count = self.spend(length)?;
            let packed = bits >> 61 & 1 == 1 && length >= SHORTEST_PACKED;
            return self.array_of(kind, &mut from, count, packed).map(Some);
        }
        self.plain(kind, &mut from, depth).map(Some)
    }

    fn inline(&self, kind: Kind, payload: u32) -> Reading<Value> {
        let bytes = payload.to_le_bytes();
        let small = |n: usize| Value::Number(f64::from(bytes[n] as i8));
        Ok(match kind {
            Kind::Integer(1, _) => Value::Number(f64::from(bytes[0])),
            Kind::Integer(_, true) => Value::Number(f64::from(payload as i32)),
            Kind::Integer(..) => Value::Number(f64::from(payload)),
            Kind::Float(2) => Value::Number(number(&bytes[..2], true, true)),
            Kind::Float(_) => Value::Number(f64::from(f32::from_bits(payload))),
            Kind::String => Value::Text(self.string(payload)?.into()),
            Kind::Token | Kind::Asset => Value::Text(self.token(payload)?.into()),
            Kind::Vector(n, ..) => Value::List((0..n.min(4)).map(small).collect()),
            // the diagonal
            Kind::Matrix(n) => Value::List(
                (0..n * n)
                    .map(|i| match i % (n + 1) {
                        0 => small(i / (n + 1)),
                        _ => Value::Number(0.0),
                    })
                    .collect(),
            ),
            Kind::Dictionary => Value::Map(BTreeMap::new()),
            Kind::References | Kind::Payloads | Kind::TokenVector => Value::List(Vec::new()),
        })
    }

    fn array_of(
        &self,
        kind: Kind,
        from: &mut Bytes<'_>,
        count: usize,
        packed: bool,
    ) -> Reading<Value> {
        if packed {
            let numbers = packed_numbers(kind, from, count)?;
            return Ok(Value::List(
                numbers.into_iter().map(Value::Number).collect(),
            ));
        }
        (0..count)
            .map(|_| self.plain(kind, from, 0))
            .collect::<Reading<_>>()
            .map(Value::List)
    }

    fn plain(&self, kind: Kind, from: &mut Bytes<'_>, depth: usize) -> Reading<Value> {
        let numbers =
            |from: &mut Bytes<'_>, n: usize, width: usize, float: bool| -> Reading<Value> {
                let bytes = from.take((n * width) as u64)?;
                let one = |b: &[u8]| Value::Number(number(b, float, true));
                Ok(Value::List(bytes.chunks_exact(width).map(one).collect()))
            };
        Ok(match kind {
            Kind::Integer(width, signed) => {
                Value::Number(number(from.take(width as u64)?, false, signed))
            }
            Kind::Float(width) => Value::Number(number(from.take(width as u64)?, true, true)),
            Kind::String => Value::Text(self.string(from.u32()?)?.into()),
            Kind::Token | Kind::Asset => Value::Text(self.token(from.u32()?)?.into()),
            Kind::Matrix(n) => numbers(from, n * n, 8, true)?,
            Kind::Vector(n, width, float) => numbers(from, n, width, float)?,
            Kind::TokenVector => {
                let count = from.u64()?;
                let count = self.spend(count)?;
                let each = |_| Ok(Value::Text(self.token(from.u32()?)?.into()));
                Value::List((0..count).map(each).collect::<Reading<_>>()?)
            }
            Kind::Dictionary => {
                let count = from.u64()?;
                let count = self.spend(count)?;
                let mut map = BTreeMap::new();
                for _ in 0..count {
                    let key = self.string(from.u32()?)?.to_owned();
                    // the value's bits stand behind what the value itself has written
                    let start = from.at;
                    let offset = usize::try_from(from.u64()?).ok();
                    let Some(at) = offset.and_then(|o| start.checked_add(o)) else {
                        return damaged("a dictionary");
                    };
                    from.at = at;
                    let bits = from.u64()?;
                    map.extend(self.value(bits, depth + 1)?.map(|v| (key, v)));
                }
                Value::Map(map)
            }
            Kind::References => self.references(from, true, depth)?,
            Kind::Payloads => self.references(from, false, depth)?,
        })
    }

    /// Paths of the assets that a list of references or payloads adds; what it deletes is left out.
    fn references(&self, from: &mut Bytes<'_>, described: bool, depth: usize) -> Reading<Value> {
        let timed = described || self.version >= 8;
        let [flags] = from.array()?;
        let mut assets = Vec::new();
        // explicit, added, prepended, appended: bits 1, 2, 5, 6 in this order of storage
        for bit in [1, 2, 5, 6] {
            if flags >> bit & 1 == 0 {
                continue;
            }
            let count = from.u64()?;
            for _ in 0..self.spend(count)? {
                assets.push(Value::Text(self.string(from.u32()?)?.into()));
                // path of the prim, offset and scale of time, a dictionary
                from.take(if timed { 4 + 16 } else { 4 })?;
                if described {
                    self.plain(Kind::Dictionary, from, depth + 1)?;
                }
            }
        }
        Ok(Value::List(assets))
    }
}

/// Children as their author listed them; the file's tree has its own order.
fn in_written_order(prim: &mut Prim) {
    let Some(listed) = prim.metadata.remove("primChildren") else {
        return;
    };
    let names = listed.list().iter().filter_map(Value::text);
    let place: BTreeMap<&str, usize> = names.enumerate().map(|(i, name)| (name, i)).collect();
    let children = &mut prim.children;
    children.sort_by_key(|c| place.get(c.name.as_str()).copied().unwrap_or(usize::MAX));
}

/// Arrays of integers as differences; arrays of floats as such integers, or as numbers in a table.
fn packed_numbers(kind: Kind, from: &mut Bytes<'_>, count: usize) -> Reading<Vec<f64>> {
    let n = count as u64;
    match kind {
        Kind::Integer(4, signed) => {
            let each = |i: u32| {
                if signed {
                    f64::from(i as i32)
                } else {
                    f64::from(i)
                }
            };
            Ok(from.integers(n)?.into_iter().map(each).collect())
        }
        Kind::Float(width) => match from.array()? {
            [b'i'] => {
                let each = |i: u32| f64::from(i as i32);
                Ok(from.integers(n)?.into_iter().map(each).collect())
            }
            [b't'] => {
                let entries = u64::from(from.u32()?);
                let table = from.take(entries.saturating_mul(width as u64))?;
                let indices = from.integers(n)?;
                let entry = |i: u32| {
                    let at = i as usize * width;
                    match table.get(at..at + width) {
                        Some(b) => Ok(number(b, true, true)),
                        None => damaged("a number that is not in its table"),
                    }
                };
                indices.into_iter().map(entry).collect()
            }
            _ => damaged("an unknown packing of floats"),
        },
        _ => damaged("an unknown packing"),
    }
}

/// The table of contents.
struct Sections<'a> {
    bytes: &'a [u8],
    found: BTreeMap<String, (u64, u64)>,
}

impl<'a> Sections<'a> {
    fn read(bytes: &'a [u8], at: u64) -> Reading<Self> {
        let at = usize::try_from(at).unwrap_or(usize::MAX);
        let mut table = Bytes { all: bytes, at };
        let mut found = BTreeMap::new();
        for _ in 0..table.u64()?.min(bytes.len() as u64) {
            let name: [u8; 16] = table.array()?;
            let end = name.iter().position(|b| *b == 0).unwrap_or(16);
            let name = String::from_utf8_lossy(&name[..end]).into_owned();
            found.insert(name, (table.u64()?, table.u64()?));
        }
        Ok(Self { bytes, found })
    }

    fn get(&self, name: &str) -> Reading<Bytes<'a>> {
        let Some(&(start, length)) = self.found.get(name) else {
            return damaged(&format!("no section {name}"));
        };
        let at = usize::try_from(start).unwrap_or(usize::MAX);
        let all = Bytes {
            all: self.bytes,
            at,
        }
        .take(length)?;
        Ok(Bytes { all, at: 0 })
    }
}

fn tokens(from: &mut Bytes<'_>) -> Reading<Vec<String>> {
    let (count, length) = (from.u64()?, from.u64()?);
    let most = usize::try_from(length).unwrap_or(usize::MAX);
    let text = from.packed(most)?;
    let count = usize::try_from(count).unwrap_or(usize::MAX);
    let all: Vec<String> = text
        .split(|b| *b == 0)
        .take(count)
        .map(|t| String::from_utf8_lossy(t).into_owned())
        .collect();
    if all.len() < count {
        return damaged("names");
    }
    Ok(all)
}

fn fields(from: &mut Bytes<'_>) -> Reading<Vec<(u32, u64)>> {
    let count = from.u64()?;
    let names = from.integers(count)?;
    let values = from.packed(8 * names.len())?;
    let values = values.as_chunks::<8>().0;
    if values.len() != names.len() {
        return damaged("values of fields");
    }
    let values = values.iter().map(|b| u64::from_le_bytes(*b));
    Ok(names.into_iter().zip(values).collect())
}

fn specs(from: &mut Bytes<'_>) -> Reading<Vec<[u32; 3]>> {
    let count = from.u64()?;
    let (paths, sets) = (from.integers(count)?, from.integers(count)?);
    let kinds = from.integers(count)?;
    Ok(paths
        .into_iter()
        .zip(sets)
        .zip(kinds)
        .map(|((p, s), k)| [p, s, k])
        .collect())
}

/// Paths from their tree, stored depth first: a jump of −1 goes on to a child, 0 to a sibling, a
/// positive one to a child, with the sibling that many entries on; −2 ends the branch.
fn places(from: &mut Bytes<'_>, tokens: &[String]) -> Reading<BTreeMap<usize, Place>> {
    // the first number counts the empty path too, which the tree does not hold
    let (_, count) = (from.u64()?, from.u64()?);
    let indices = from.integers(count)?;
    let names = from.integers(count)?;
    let jumps = from.integers(count)?;
    let mut places = BTreeMap::new();
    let mut branches = vec![(0usize, None)];
    while let Some((mut at, mut parent)) = branches.pop() {
        loop {
            let (Some(&index), Some(&name), Some(&jump)) =
                (indices.get(at), names.get(at), jumps.get(at))
            else {
                return damaged("the tree of paths");
            };
            let (jump, name) = (jump as i32, name as i32);
            let Some(token) = tokens.get(name.unsigned_abs() as usize) else {
                return damaged("the tree of paths");
            };
            let place = Place {
                parent,
                name: match parent {
                    Some(_) => token.clone(),
                    None => String::new(),
                },
                is_property: name < 0,
            };
            // an entry met twice would be a circle
            if places.insert(index as usize, place).is_some() {
                return damaged("a path stored twice");
            }
            let (child, sibling) = (jump > 0 || jump == -1, jump >= 0);
            if child {
                if sibling {
                    branches.push((at.saturating_add(jump as usize), parent));
                }
                parent = Some(index as usize);
            } else if !sibling {
                break;
            }
            at += 1;
        }
    }
    Ok(places)
}
