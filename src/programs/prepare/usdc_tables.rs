//! Tables of a binary USD file: its sections, and in them names, fields, specs and the tree of paths
//! (OpenUSD, `pxr/usd/sdf`: crateFile). Called by `usdc`.

use super::usdc_bytes::{Bytes, Reading, damaged};
use std::collections::BTreeMap;

/// Where a path stands: its parent and its last name; a property begins with a dot in text.
pub struct Place {
    /// Number of the path above; `None` at the root.
    pub parent: Option<usize>,
    /// The last name; a variant's is `{set=variant}`.
    pub name: String,
    /// Whether it is a property.
    pub is_property: bool,
}

/// The table of contents.
pub struct Sections<'a> {
    bytes: &'a [u8],
    found: BTreeMap<String, (u64, u64)>,
}

impl<'a> Sections<'a> {
    /// Reads the table at `at`.
    pub fn read(bytes: &'a [u8], at: u64) -> Reading<Self> {
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

    /// The bytes of a section.
    pub fn get(&self, name: &str) -> Reading<Bytes<'a>> {
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

/// All names.
pub fn tokens(from: &mut Bytes<'_>) -> Reading<Vec<String>> {
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

/// Token of the name, and the value, of every field.
pub fn fields(from: &mut Bytes<'_>) -> Reading<Vec<(u32, u64)>> {
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

/// Path, first field of its set, and kind of every spec.
pub fn specs(from: &mut Bytes<'_>) -> Reading<Vec<[u32; 3]>> {
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
pub fn places(from: &mut Bytes<'_>, tokens: &[String]) -> Reading<BTreeMap<usize, Place>> {
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
