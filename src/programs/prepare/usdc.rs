//! USD in binary form (`.usdc`, "crate" files of version 0.4 and later): the same tree of prims as
//! `usda` reads from text.
//!
//! A crate file is a table of sections: tokens, strings, fields (name, value), sets of fields,
//! paths as a depth-first tree, and specs (path, set of fields, kind). Tables are LZ4 blocks, most
//! of them of integers as differences in one, two or four bytes (OpenUSD, `pxr/usd/sdf`: crateFile,
//! integerCoding, fastCompression; here `usdc_bytes` and `usdc_tables`). Values lie inline in their field or at an offset; only the types
//! that geometry needs are read, others are left out. Called by `usd_files`.
//!
//! Nothing is allocated that the file's own bytes could not stand for, and all values together stay
//! below [`MOST_VALUES`].

use super::usd_layer::{ListEdits, Prim, Specifier, Target, Value};
use super::usdc_bytes::{Bytes, MOST_VALUES, Reading, damaged, number};
use super::usdc_kinds::{Item, Kind, kind_of};
use super::usdc_tables::{Place, Sections, fields, places, specs, tokens};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::rc::Rc;

/// What such a file begins with.
pub const MAGIC: &[u8] = b"PXR-USDC";

/// Deepest path, and deepest dictionary.
const DEEPEST: usize = 64;
/// Arrays shorter than this are stored plainly although marked as packed.
const SHORTEST_PACKED: u64 = 16;

/// Reads a layer.
///
/// # Errors
/// What was expected, and in which section.
pub fn parse(bytes: &[u8]) -> Reading<Prim> {
    let file = Crate::open(bytes)?;
    file.layer()
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

    /// The path with a number; the empty one if the tree does not hold it.
    fn path(&self, index: u32) -> Reading<String> {
        let place = |path: usize| self.places.get(&path);
        let mut names: Vec<&str> = Vec::new();
        let mut at = place(index as usize);
        while let Some(here) = at {
            if names.len() > DEEPEST {
                return damaged("a path nested too deeply");
            }
            if let Some(parent) = here.parent {
                names.push(&here.name);
                at = place(parent);
            } else {
                break;
            }
        }
        let parts = names.iter().rev().map(|n| format!("/{n}"));
        Ok(parts.collect())
    }

    /// The tree of prims with their properties.
    fn layer(&self) -> Reading<Prim> {
        // kinds of specs: 1 attribute, 6 prim, 7 the layer itself, 8 relationship, 10 variant
        let mut prims: BTreeMap<usize, Prim> = BTreeMap::new();
        let mut properties = Vec::new();
        for &[path, set, kind] in &self.specs {
            let Some(place) = self.places.get(&(path as usize)) else {
                return damaged("a spec without a path");
            };
            let fields = self.fields_of(set)?;
            match kind {
                6 | 7 | 10 => {
                    prims.insert(path as usize, prim(place, fields));
                }
                1 | 8 if place.is_property => properties.push((place, fields)),
                _ => {}
            }
        }
        for (place, mut fields) in properties {
            let owner = place.parent.and_then(|p| prims.get_mut(&p));
            let Some(prim) = owner else { continue };
            // samples in time are stronger than a value without time
            let first = fields.remove("timeSamples");
            if first.is_some() {
                prim.sampled.insert(place.name.clone());
            }
            let value = first.or_else(|| {
                let timeless = fields.remove("default");
                timeless.or_else(|| fields.remove("targetPaths"))
            });
            (prim.properties).extend(value.map(|v| (place.name.clone(), v)));
        }
        self.assemble(prims)
    }

    /// Children and variants into their parents, the deepest first.
    fn assemble(&self, mut prims: BTreeMap<usize, Prim>) -> Reading<Prim> {
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
            let Some(mut prim) = prims.remove(&path) else {
                continue;
            };
            in_written_order(&mut prim);
            let Some(above) = prims.get_mut(&above) else {
                continue;
            };
            let name = std::mem::take(&mut prim.name);
            match variant_name(&name) {
                Some((set, variant)) => {
                    prim.name = variant.into();
                    prim.specifier = Specifier::Over;
                    above.add_variant(set, Rc::new(prim));
                }
                None => {
                    prim.name = name;
                    above.children.push(Rc::new(prim));
                }
            }
        }
        let root = prims.into_values().next();
        let Some(mut root) = root else {
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
            if packed {
                let numbers = packed_numbers(kind, &mut from, count)?;
                let numbers = numbers.into_iter().map(Value::Number);
                return Ok(Some(Value::List(numbers.collect())));
            }
            // arrays of dictionaries may hold arrays
            let list = (0..count).map(|_| self.plain(kind, &mut from, depth + 1));
            return list.collect::<Reading<_>>().map(|l| Some(Value::List(l)));
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
            Kind::Token => Value::Text(self.token(payload)?.into()),
            Kind::Asset => asset(self.token(payload)?),
            Kind::Vector(n, ..) => Value::List((0..n.min(4)).map(small).collect()),
            Kind::Block => Value::Text("None".into()),
            // the diagonal
            Kind::Matrix(n) => Value::List(
                (0..n * n)
                    .map(|i| match i % (n + 1) {
                        0 => small(i / (n + 1)),
                        _ => Value::Number(0.0),
                    })
                    .collect(),
            ),
            Kind::Dictionary | Kind::Choices => Value::Map(BTreeMap::new()),
            // too long to lie inline unless they are empty
            Kind::Quaternion(_)
            | Kind::Edits(_)
            | Kind::Items(_)
            | Kind::Payload
            | Kind::Samples => Value::List(Vec::new()),
        })
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
            Kind::Token => Value::Text(self.token(from.u32()?)?.into()),
            Kind::Asset => asset(self.token(from.u32()?)?),
            Kind::Matrix(n) => numbers(from, n * n, 8, true)?,
            Kind::Vector(n, width, float) => numbers(from, n, width, float)?,
            Kind::Quaternion(width) => {
                let Value::List(mut stored) = numbers(from, 4, width, true)? else {
                    return damaged("a rotation");
                };
                stored.rotate_right(1);
                Value::List(stored)
            }
            Kind::Items(item) => Value::List(self.items(item, from, depth)?),
            Kind::Dictionary => self.dictionary(from, depth)?,
            Kind::Choices => {
                let count = from.u64()?;
                let mut map = BTreeMap::new();
                for _ in 0..self.spend(count)? {
                    let set = self.string(from.u32()?)?.to_owned();
                    map.insert(set, Value::Text(self.string(from.u32()?)?.into()));
                }
                Value::Map(map)
            }
            Kind::Edits(item) => self.edits(item, from, depth)?,
            Kind::Payload => self.item(Item::Payload, from, depth)?,
            Kind::Samples => self.first_sample(from, depth)?,
            Kind::Block => Value::Text("None".into()),
        })
    }

    fn dictionary(&self, from: &mut Bytes<'_>, depth: usize) -> Reading<Value> {
        let count = from.u64()?;
        let mut map = BTreeMap::new();
        for _ in 0..self.spend(count)? {
            let key = self.string(from.u32()?)?.to_owned();
            from.jump()?;
            let bits = from.u64()?;
            map.extend(self.value(bits, depth + 1)?.map(|v| (key, v)));
        }
        Ok(Value::Map(map))
    }

    /// The first of the values at times, which the file has in the order of time.
    fn first_sample(&self, from: &mut Bytes<'_>, depth: usize) -> Reading<Value> {
        from.jump()?;
        let _times = from.u64()?;
        from.jump()?;
        if from.u64()? == 0 {
            return Ok(Value::List(Vec::new()));
        }
        let bits = from.u64()?;
        let value = self.value(bits, depth + 1)?;
        Ok(value.unwrap_or_else(|| Value::List(Vec::new())))
    }

    /// What a list adds and deletes.
    fn edits(&self, item: Item, from: &mut Bytes<'_>, depth: usize) -> Reading<Value> {
        let [flags] = from.array()?;
        let mut list = |bit: u8| match flags >> bit & 1 {
            0 => Ok(Vec::new()),
            _ => self.items(item, from, depth),
        };
        // in this order of storage; 0 says that the list is explicit, even if it is empty
        let (explicit, added) = (list(1)?, list(2)?);
        let (prepended, mut appended, deleted) = (list(5)?, list(6)?, list(3)?);
        appended.extend(added);
        Ok(Value::Edits(ListEdits {
            explicit: (flags & 1 == 1).then_some(explicit),
            prepended,
            appended,
            deleted,
        }))
    }

    fn items(&self, item: Item, from: &mut Bytes<'_>, depth: usize) -> Reading<Vec<Value>> {
        let count = from.u64()?;
        let count = self.spend(count)?;
        (0..count).map(|_| self.item(item, from, depth)).collect()
    }

    fn item(&self, item: Item, from: &mut Bytes<'_>, depth: usize) -> Reading<Value> {
        Ok(match item {
            Item::Token => Value::Text(self.token(from.u32()?)?.into()),
            Item::String => Value::Text(self.string(from.u32()?)?.into()),
            Item::Integer(width, signed) => {
                Value::Number(number(from.take(width as u64)?, false, signed))
            }
            Item::Path => Value::Target(Target {
                asset: String::new(),
                prim: self.path(from.u32()?)?,
            }),
            Item::Reference | Item::Payload => {
                let target = Target {
                    asset: self.string(from.u32()?)?.into(),
                    prim: self.path(from.u32()?)?,
                };
                let described = matches!(item, Item::Reference);
                // offset and scale of time
                if described || self.version >= 8 {
                    from.take(16)?;
                }
                if described {
                    self.dictionary(from, depth + 1)?;
                }
                Value::Target(target)
            }
        })
    }
}

/// A prim or variant from its fields, in the words of text.
fn prim(place: &Place, mut fields: BTreeMap<&str, Value>) -> Prim {
    let specifier = fields.remove("specifier").and_then(|v| v.number());
    let kind = fields.remove("typeName");
    let word = |name: &str| match name {
        "inheritPaths" => "inherits".to_owned(),
        "variantSelection" => "variants".to_owned(),
        "variantSetNames" => "variantSets".to_owned(),
        name => name.to_owned(),
    };
    Prim {
        specifier: match specifier {
            Some(1.0) => Specifier::Over,
            Some(2.0) => Specifier::Class,
            _ => Specifier::Def,
        },
        kind: kind.as_ref().and_then(Value::text).unwrap_or("").into(),
        name: place.name.clone(),
        metadata: fields.into_iter().map(|(k, v)| (word(k), v)).collect(),
        ..Prim::default()
    }
}

/// Set and variant of `{set=variant}`.
fn variant_name(name: &str) -> Option<(&str, &str)> {
    name.strip_prefix('{')?.strip_suffix('}')?.split_once('=')
}

fn asset(path: &str) -> Value {
    Value::Target(Target {
        asset: path.into(),
        prim: String::new(),
    })
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
        Kind::Integer(8, _) => {
            let each = |i: i64| i as f64;
            Ok(from.wide_integers(n)?.into_iter().map(each).collect())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_that_holds_itself_is_refused() {
        // an array of one dictionary of one entry, which is the array again
        let (array, dictionary, at) = (1u64 << 63, 31u64 << 48, 8u64);
        let itself = array | dictionary | at;
        let mut bytes = vec![0; 8];
        bytes.extend(1u64.to_le_bytes());
        bytes.extend(1u64.to_le_bytes());
        bytes.extend(0u32.to_le_bytes());
        bytes.extend(8u64.to_le_bytes());
        bytes.extend(itself.to_le_bytes());
        let file = Crate {
            bytes: &bytes,
            version: 8,
            tokens: vec!["key".into()],
            strings: vec![0],
            fields: Vec::new(),
            sets: Vec::new(),
            places: BTreeMap::new(),
            specs: Vec::new(),
            spent: Cell::new(0),
        };
        let found = file.value(itself, 0);
        assert!(found.is_err_and(|e| e.contains("nested too deeply")));
    }
}
