//! Types of values in a binary USD file by their numbers (OpenUSD, crateDataTypes.h), as far as geometry
//! needs them. Called by `usdc`.

/// Types of values by their number in the file (OpenUSD, crateDataTypes.h).
#[derive(Clone, Copy)]
pub enum Kind {
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
    /// Stored as (x, y, z, w), given as text has it: (w, x, y, z).
    Quaternion(usize),
    Dictionary,
    /// A list as changes of a weaker one.
    Edits(Item),
    /// A plain list.
    Items(Item),
    /// A single payload, as files before version 0.8 have it.
    Payload,
    /// Selected variants by set.
    Choices,
    /// Values at times.
    Samples,
    /// Takes away what weaker opinions say.
    Block,
}

/// Elements of lists.
#[derive(Clone, Copy)]
pub enum Item {
    Token,
    String,
    Path,
    Reference,
    Payload,
    /// An integer of so many bytes, signed or not.
    Integer(usize, bool),
}

/// The type with this number; `None` for those that are not read.
pub fn kind_of(number: u64) -> Option<Kind> {
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
        16 => Kind::Quaternion(8),
        17 => Kind::Quaternion(4),
        18 => Kind::Quaternion(2),
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
        32 => Kind::Edits(Item::Token),
        33 => Kind::Edits(Item::String),
        34 => Kind::Edits(Item::Path),
        35 => Kind::Edits(Item::Reference),
        36 => Kind::Edits(Item::Integer(4, true)),
        37 => Kind::Edits(Item::Integer(8, true)),
        38 => Kind::Edits(Item::Integer(4, false)),
        39 => Kind::Edits(Item::Integer(8, false)),
        40 => Kind::Items(Item::Path),
        41 => Kind::Items(Item::Token),
        42..=44 => Kind::Integer(4, false),
        45 => Kind::Choices,
        46 => Kind::Samples,
        47 => Kind::Payload,
        50 => Kind::Items(Item::String),
        51 | 60 => Kind::Block,
        55 => Kind::Edits(Item::Payload),
        _ => return None,
    })
}
