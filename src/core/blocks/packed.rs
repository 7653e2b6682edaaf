//! Results as bytes and back, bit for bit: columns of plain numbers behind a hash. What is kept for
//! a run that stops (`pipeline::Checkpoints`) and what processes tell each other is written so.

use bytemuck::{NoUninit, Pod};

/// Columns of plain numbers, little-endian as in memory.
pub type Columns = Vec<Vec<u8>>;

/// A result that can be written as columns of plain numbers.
pub trait Packed: Sized {
    /// The columns as bytes.
    fn columns(&self) -> Columns;
    /// The result of `columns`; `None` if they are not its own.
    fn restored(columns: &[Vec<u8>]) -> Option<Self>;
}

impl<T: Packed> Packed for Vec<T> {
    /// The number of columns of every element, then all columns.
    fn columns(&self) -> Columns {
        let each: Vec<Columns> = self.iter().map(T::columns).collect();
        let counts: Vec<u64> = each.iter().map(|c| c.len() as u64).collect();
        std::iter::once(column(&counts))
            .chain(each.into_iter().flatten())
            .collect()
    }

    fn restored(columns: &[Vec<u8>]) -> Option<Self> {
        let (counts, mut rest) = columns.split_first()?;
        let one = |count: &u64| {
            let (own, after) = rest.split_at_checked(usize::try_from(*count).ok()?)?;
            rest = after;
            T::restored(own)
        };
        values::<u64>(counts)?.iter().map(one).collect()
    }
}

/// Hash of `label` and content, number of columns, then each column with its length.
#[must_use]
pub fn sealed(label: &str, columns: &[Vec<u8>]) -> Vec<u8> {
    let mut body = (columns.len() as u64).to_le_bytes().to_vec();
    for c in columns {
        body.extend((c.len() as u64).to_le_bytes());
        body.extend(c);
    }
    let mut out = hash(label, &body).as_bytes().to_vec();
    out.extend(body);
    out
}

/// The columns of bytes sealed with the same `label`; `None` if anything about them is damaged.
#[must_use]
pub fn opened(label: &str, bytes: &[u8]) -> Option<Columns> {
    let (sum, body) = bytes.split_at_checked(blake3::OUT_LEN)?;
    if hash(label, body).as_bytes() != sum {
        return None;
    }
    let number = |at: &mut &[u8]| -> Option<usize> {
        let (n, rest) = at.split_at_checked(8)?;
        *at = rest;
        usize::try_from(u64::from_le_bytes(n.try_into().ok()?)).ok()
    };
    let mut rest = body;
    let count = number(&mut rest)?;
    (0..count)
        .map(|_| {
            let length = number(&mut rest)?;
            let (column, after) = rest.split_at_checked(length)?;
            rest = after;
            Some(column.to_vec())
        })
        .collect()
}

fn hash(label: &str, body: &[u8]) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&(label.len() as u64).to_le_bytes());
    hasher.update(label.as_bytes());
    hasher.update(body).finalize()
}

/// Numbers as a column.
#[must_use]
pub fn column<T: NoUninit>(values: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(values).to_vec()
}

/// Truths as a column, a byte each.
#[must_use]
pub fn truths(values: &[bool]) -> Vec<u8> {
    values.iter().map(|v| u8::from(*v)).collect()
}

/// The truths of a column.
#[must_use]
pub fn flags(column: &[u8]) -> Vec<bool> {
    column.iter().map(|c| *c != 0).collect()
}

/// The numbers of a column; `None` if it holds no whole number of them.
#[must_use]
pub fn values<T: Pod>(column: &[u8]) -> Option<Vec<T>> {
    let size = size_of::<T>();
    column.len().is_multiple_of(size).then(|| {
        column
            .chunks_exact(size)
            .map(bytemuck::pod_read_unaligned)
            .collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_opened_by_their_own_label_and_undamaged_only() {
        let columns = vec![column(&[1.5f32, f32::NAN]), Vec::new(), truths(&[true])];
        let whole = sealed("a", &columns);
        assert_eq!(opened("a", &whole), Some(columns));
        assert_eq!(opened("b", &whole), None);
        for cut in 0..whole.len() {
            assert_eq!(opened("a", &whole[..cut]), None, "{cut}");
            let mut flipped = whole.clone();
            flipped[cut] ^= 4;
            assert_eq!(opened("a", &flipped), None, "{cut}");
        }
        assert_eq!(values::<f32>(&[0; 6]), None);
    }
}
