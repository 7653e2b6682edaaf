//! A layer of USD as a tree of prims, whatever form it was stored in: what `usda` and `usdc` give to
//! `usd_stage`, which composes layers.

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

/// A value of a property or of metadata.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Any number.
    Number(f64),
    /// A string or token.
    Text(String),
    /// A file, a prim, or a prim in a file.
    Target(Target),
    /// A tuple, or a list of values.
    List(Vec<Value>),
    /// A dictionary.
    Map(BTreeMap<String, Value>),
    /// A list said by what changes in the weaker opinions' list.
    Edits(ListEdits),
}

/// `@asset@</Prim>`, either part possibly empty.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Target {
    /// A layer's file; empty = the layer that says so.
    pub asset: String,
    /// Path of a prim; empty = the layer's default prim.
    pub prim: String,
}

/// Changes of a list, as `prepend references = ...` says them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ListEdits {
    /// The whole list, whatever weaker opinions say.
    pub explicit: Option<Vec<Value>>,
    /// Put before.
    pub prepended: Vec<Value>,
    /// Put behind.
    pub appended: Vec<Value>,
    /// Taken out of the weaker ones.
    pub deleted: Vec<Value>,
}

impl ListEdits {
    /// The list that these changes make of `weaker`.
    #[must_use]
    pub fn applied_to(&self, weaker: Vec<Value>) -> Vec<Value> {
        if let Some(all) = &self.explicit {
            return all.clone();
        }
        let mentioned = [&self.prepended, &self.appended, &self.deleted];
        let kept = weaker
            .into_iter()
            .filter(|v| !mentioned.iter().any(|list| list.contains(v)));
        let mut out = self.prepended.clone();
        out.extend(kept);
        out.extend(self.appended.iter().cloned());
        out
    }
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

    /// Whether it says no: a word in text, a number in binary.
    pub fn is_false(&self) -> bool {
        self.text() == Some("false") || self.number() == Some(0.0)
    }

    /// The elements; a single value is a list of itself.
    pub fn list(&self) -> &[Value] {
        match self {
            Self::List(l) => l,
            other => std::slice::from_ref(other),
        }
    }

    /// The list as changes of weaker opinions' list.
    pub fn edits(&self) -> ListEdits {
        match self {
            Self::Edits(edits) => edits.clone(),
            other => ListEdits {
                explicit: Some(other.list().to_vec()),
                ..ListEdits::default()
            },
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

/// What a layer says about a prim's being there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Specifier {
    /// It is there.
    #[default]
    Def,
    /// Only opinions about one that another layer defines.
    Over,
    /// It is there for others to inherit from.
    Class,
}

/// A choice of opinions about a prim.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VariantSet {
    /// Name by which a variant is selected.
    pub name: String,
    /// The variants; `name` is each one's own, children and properties are the prim's.
    pub variants: Vec<Rc<Prim>>,
}

/// A prim of one layer or, at the top, the whole layer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Prim {
    /// Whether it is defined here.
    pub specifier: Specifier,
    /// `Xform`, `Mesh`, ...; empty where none is stated.
    pub kind: String,
    /// Name without its path.
    pub name: String,
    /// Metadata in parentheses.
    pub metadata: BTreeMap<String, Value>,
    /// Properties by name (type and `uniform` left out); of those that change in time their first
    /// sample.
    pub properties: BTreeMap<String, Value>,
    /// Properties that change in time.
    pub sampled: BTreeSet<String>,
    /// Sets of variants in written order.
    pub variant_sets: Vec<VariantSet>,
    /// Prims inside.
    pub children: Vec<Rc<Prim>>,
}

impl Prim {
    /// Puts a variant into its set.
    pub fn add_variant(&mut self, set: &str, variant: Rc<Prim>) {
        match self.variant_sets.iter_mut().find(|s| s.name == set) {
            Some(found) => found.variants.push(variant),
            None => self.variant_sets.push(VariantSet {
                name: set.into(),
                variants: vec![variant],
            }),
        }
    }
}
