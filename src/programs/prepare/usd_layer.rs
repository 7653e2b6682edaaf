//! A layer of USD as a tree of prims, whatever form it was stored in: what `usda` and `usdc` give to
//! `roomplan`.

use std::collections::BTreeMap;

/// A value of a property or of metadata.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Any number.
    Number(f64),
    /// A string, token, path or asset.
    Text(String),
    /// A tuple, or a list of values.
    List(Vec<Value>),
    /// A dictionary.
    Map(BTreeMap<String, Value>),
}

impl Value {
    /// The number, if it is one.
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Number(n) => Some(*n),
            _ => None,
        }
    }

    /// The text, if it is one.
    pub fn text(&self) -> Option<&str> {
        match self {
            Self::Text(t) => Some(t),
            _ => None,
        }
    }

    /// The elements; a single value is a list of itself.
    pub fn list(&self) -> &[Value] {
        match self {
            Self::List(l) => l,
            other => std::slice::from_ref(other),
        }
    }

    /// All numbers in it, in order.
    pub fn numbers(&self, into: &mut Vec<f64>) {
        match self {
            Self::Number(n) => into.push(*n),
            Self::List(l) => l.iter().for_each(|v| v.numbers(into)),
            _ => {}
        }
    }
}

/// A prim or, at the top, the whole layer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Prim {
    /// `Xform`, `Mesh`, ...; empty where none is stated.
    pub kind: String,
    /// Name without its path.
    pub name: String,
    /// Metadata in parentheses.
    pub metadata: BTreeMap<String, Value>,
    /// Properties by name (type and `uniform` left out).
    pub properties: BTreeMap<String, Value>,
    /// Prims inside.
    pub children: Vec<Prim>,
}
