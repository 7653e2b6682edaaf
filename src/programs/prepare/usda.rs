//! USD in text form (`.usda`): prims, their properties and references, as far as rooms need them.
//!
//! A recursive-descent reader of the grammar in USD's documentation: `def Type "name" (metadata)
//! { properties, sets of variants and prims }`. Binary layers are [`super::usdc`]'s. Hand-written because the one
//! maintained Rust reader (`openusd`) asks for a newer compiler than this program's.

use super::usd_layer::{ListEdits, Prim, Specifier, Target, Value};
use std::collections::BTreeMap;
use std::rc::Rc;

/// Nesting beyond this is damage.
const DEEPEST: usize = 64;

/// Reads a layer.
///
/// # Errors
/// What was expected, and the line.
pub fn parse(text: &str) -> Result<Prim, String> {
    let text = text.trim_start_matches('\u{feff}');
    if !text.starts_with("#usda") {
        return Err("line 1: expected #usda 1.0".into());
    }
    let mut reader = Reader {
        bytes: text.as_bytes(),
        at: 0,
    };
    let mut layer = Prim::default();
    reader.space();
    if reader.eat(b'(') {
        layer.metadata = reader.metadata(0)?;
    }
    reader.body(&mut layer, 0, true)?;
    Ok(layer)
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn fail<T>(&self, expected: &str) -> Result<T, String> {
        let line = 1 + self.bytes[..self.at.min(self.bytes.len())]
            .iter()
            .filter(|b| **b == b'\n')
            .count();
        Err(format!("line {line}: expected {expected}"))
    }

    fn peek(&self) -> Option<u8> {
        self.bytes.get(self.at).copied()
    }

    /// Skips blanks and comments.
    fn space(&mut self) {
        while let Some(b) = self.peek() {
            match b {
                b'#' => {
                    while self.peek().is_some_and(|b| b != b'\n') {
                        self.at += 1;
                    }
                }
                b' ' | b'\t' | b'\r' | b'\n' | b';' | b',' => self.at += 1,
                _ => break,
            }
        }
    }

    fn eat(&mut self, wanted: u8) -> bool {
        self.space();
        let found = self.peek() == Some(wanted);
        self.at += usize::from(found);
        found
    }

    /// A word of a name, type or number.
    fn word(&mut self) -> String {
        self.space();
        let start = self.at;
        let part = |b: u8| b.is_ascii_alphanumeric() || b"_:.-+[]".contains(&b) || b >= 0x80;
        while self.peek().is_some_and(part) {
            // a bracket belongs to a word as in `float3[]` only
            if self.peek() == Some(b'[') && self.bytes.get(self.at + 1) != Some(&b']') {
                break;
            }
            if self.peek() == Some(b']') && (self.at == start || self.bytes[self.at - 1] != b'[') {
                break;
            }
            self.at += 1;
        }
        String::from_utf8_lossy(&self.bytes[start..self.at]).into_owned()
    }

    fn delimited(&mut self, end: &[u8]) -> Result<String, String> {
        let start = self.at;
        while self.at < self.bytes.len() {
            if self.bytes[self.at] == b'\\' && end[0] != b'@' {
                self.at += 2;
                continue;
            }
            if self.bytes[self.at..].starts_with(end) {
                let text = String::from_utf8_lossy(&self.bytes[start..self.at]).into_owned();
                self.at += end.len();
                return Ok(text);
            }
            self.at += 1;
        }
        self.at = start;
        self.fail("the end of a text")
    }

    fn string(&mut self) -> Result<String, String> {
        self.space();
        for quote in [&b"\"\"\""[..], b"'''", b"\"", b"'"] {
            if self.bytes[self.at..].starts_with(quote) {
                self.at += quote.len();
                return self.delimited(quote);
            }
        }
        self.fail("a text in quotes")
    }

    fn value(&mut self, depth: usize) -> Result<Value, String> {
        if depth > DEEPEST {
            return self.fail("less nesting");
        }
        self.space();
        match self.peek() {
            Some(b'"' | b'\'') => self.string().map(Value::Text),
            Some(b'@' | b'<') => self.target(depth).map(Value::Target),
            Some(open @ (b'[' | b'(')) => {
                self.at += 1;
                let close = if open == b'[' { b']' } else { b')' };
                let mut list = Vec::new();
                while !self.eat(close) {
                    list.push(self.value(depth + 1)?);
                }
                Ok(Value::List(list))
            }
            Some(b'{') => {
                self.at += 1;
                self.dictionary(depth + 1).map(Value::Map)
            }
            Some(_) => {
                let word = self.word();
                match (word.is_empty(), word.parse::<f64>()) {
                    (true, _) => self.fail("a value"),
                    (false, Ok(n)) => Ok(Value::Number(n)),
                    (false, Err(_)) => Ok(Value::Text(word)),
                }
            }
            None => self.fail("a value"),
        }
    }

    /// `@asset@</Prim> (offset of time)`, each part optional.
    fn target(&mut self, depth: usize) -> Result<Target, String> {
        let mut target = Target::default();
        for quote in [&b"@@@"[..], b"@"] {
            if target.asset.is_empty() && self.bytes[self.at..].starts_with(quote) {
                self.at += quote.len();
                target.asset = self.delimited(quote)?;
                self.space();
            }
        }
        if self.peek() == Some(b'<') {
            self.at += 1;
            target.prim = self.delimited(b">")?;
        }
        if self.eat(b'(') {
            self.metadata(depth + 1)?;
        }
        Ok(target)
    }

    /// `type name = value` entries up to `}`; keys may be quoted (`0.5: value` of time samples
    /// too).
    fn dictionary(&mut self, depth: usize) -> Result<BTreeMap<String, Value>, String> {
        let mut map = BTreeMap::new();
        while !self.eat(b'}') {
            let mut key = String::new();
            while !self.eat(b'=') && !self.eat(b':') {
                self.space();
                key = match self.peek() {
                    Some(b'"' | b'\'') => self.string()?,
                    Some(_) => self.word(),
                    None => return self.fail("}"),
                };
                if key.is_empty() {
                    return self.fail("a key");
                }
                // the colon of a time sample sticks to its word
                if key.ends_with(':') {
                    key.pop();
                    break;
                }
            }
            let value = self.value(depth + 1)?;
            map.insert(key, value);
        }
        Ok(map)
    }

    /// `name = value` entries up to `)`; a lone text is documentation.
    fn metadata(&mut self, depth: usize) -> Result<BTreeMap<String, Value>, String> {
        let mut map = BTreeMap::new();
        while !self.eat(b')') {
            match self.peek() {
                Some(b'"' | b'\'') => {
                    self.string()?;
                }
                Some(_) => {
                    let (mut key, mut edit) = (String::new(), String::new());
                    while !self.eat(b'=') {
                        edit = std::mem::replace(&mut key, self.word());
                        if key.is_empty() {
                            return self.fail("name = value");
                        }
                    }
                    let value = self.value(depth + 1)?;
                    let value = edited(map.remove(&key), &edit, value);
                    map.insert(key, value);
                }
                None => return self.fail(")"),
            }
        }
        Ok(map)
    }

    /// Properties and prims up to `}` (the end of the file at the top).
    fn body(&mut self, prim: &mut Prim, depth: usize, top: bool) -> Result<(), String> {
        if depth > DEEPEST {
            return self.fail("less nesting");
        }
        loop {
            self.space();
            match self.peek() {
                None if top => return Ok(()),
                None => return self.fail("}"),
                Some(b'}') if !top => {
                    self.at += 1;
                    return Ok(());
                }
                Some(_) => {}
            }
            let word = self.word();
            match word.as_str() {
                "def" | "over" | "class" => {
                    let mut child = self.prim(depth + 1)?;
                    child.specifier = match word.as_str() {
                        "def" => Specifier::Def,
                        "over" => Specifier::Over,
                        _ => Specifier::Class,
                    };
                    prim.children.push(Rc::new(child));
                }
                "variantSet" => self.variant_set(prim, depth + 1)?,
                "" => return self.fail("a property or a prim"),
                _ => self.property(word, prim, depth)?,
            }
        }
    }

    /// `"name" = { "variant" (metadata) { body } ... }`.
    fn variant_set(&mut self, prim: &mut Prim, depth: usize) -> Result<(), String> {
        let set = self.string()?;
        self.eat(b'=');
        if !self.eat(b'{') {
            return self.fail("{");
        }
        while !self.eat(b'}') {
            let mut variant = Prim {
                name: self.string()?,
                specifier: Specifier::Over,
                ..Prim::default()
            };
            self.block(&mut variant, depth)?;
            prim.add_variant(&set, Rc::new(variant));
        }
        Ok(())
    }

    fn prim(&mut self, depth: usize) -> Result<Prim, String> {
        let mut prim = Prim::default();
        self.space();
        if self.peek() != Some(b'"') {
            prim.kind = self.word();
        }
        prim.name = self.string()?;
        self.block(&mut prim, depth)?;
        Ok(prim)
    }

    /// `(metadata) { body }`.
    fn block(&mut self, prim: &mut Prim, depth: usize) -> Result<(), String> {
        if self.eat(b'(') {
            prim.metadata = self.metadata(depth)?;
        }
        if !self.eat(b'{') {
            return self.fail("{");
        }
        self.body(prim, depth, false)
    }

    /// The rest of `[uniform] type name = value (metadata)`, its first word read already.
    fn property(&mut self, first: String, prim: &mut Prim, depth: usize) -> Result<(), String> {
        let withdrawn = first == "delete" || first == "reorder";
        let mut name = first;
        loop {
            self.space();
            match self.peek() {
                Some(b'=') => {
                    self.at += 1;
                    let value = self.value(depth + 1)?;
                    if !withdrawn {
                        insert(prim, name, value);
                    }
                    break;
                }
                Some(b) if b.is_ascii_alphabetic() || b == b'_' => {
                    // declared without a value: the next line begins another one
                    let ended = self.bytes[..self.at].iter().rev();
                    let newline = ended
                        .take_while(|b| b.is_ascii_whitespace())
                        .any(|b| *b == b'\n');
                    if newline {
                        return Ok(());
                    }
                    name = self.word();
                }
                _ => break,
            }
        }
        if self.eat(b'(') {
            self.metadata(depth)?;
        }
        Ok(())
    }
}

/// A property's value; of samples in time the first, which is stronger than a value without time.
fn insert(prim: &mut Prim, name: String, value: Value) {
    let Some(name) = name.strip_suffix(".timeSamples") else {
        if !prim.sampled.contains(&name) {
            prim.properties.insert(name, value);
        }
        return;
    };
    let Value::Map(samples) = value else { return };
    let time = |(key, _): &(String, Value)| key.parse().unwrap_or(f64::INFINITY);
    let first = samples
        .into_iter()
        .min_by(|a, b| time(a).total_cmp(&time(b)));
    if let Some((_, value)) = first {
        prim.properties.insert(name.into(), value);
        prim.sampled.insert(name.into());
    }
}

/// A list of metadata with one more line about it.
fn edited(before: Option<Value>, edit: &str, value: Value) -> Value {
    let mut edits = match before {
        Some(Value::Edits(edits)) => edits,
        _ => ListEdits::default(),
    };
    let list = match edit {
        "prepend" => &mut edits.prepended,
        "append" | "add" => &mut edits.appended,
        "delete" => &mut edits.deleted,
        // the order alone does not say what is in it
        "reorder" => return Value::Edits(edits),
        _ => return value,
    };
    list.extend_from_slice(value.list());
    Value::Edits(edits)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYER: &str = r#"#usda 1.0
(
    "a document"
    defaultPrim = "Room"
    upAxis = "Y"
)
def Xform "Room" (
    kind = "assembly"
    prepend references = [
        @./a.usda@,
        @./b.usda@</Inner>
    ]
    customData = {
        string Category = "Wall"
        dictionary deep = { int n = 3 }
    }
)
{
    token outputs:surface
    float[] empty = []
    double3 xformOp:scale = (2, 3.5, -1e-3) (
        doc = "scaled"
    )
    uniform token[] xformOpOrder = ["xformOp:scale"]
    double x.timeSamples = {
        10: 2,
        9: 1.5,
    }
    variantSet "look" = {
        "a" ( doc = "x" ) { double size = 3 }
        "b b" {
            def Cube "Q" { }
        }
    }
    # a comment
    def Mesh "M" { point3f[] points = [(0, 0, 0), (1, 0, 0)] }
    over "Nothing" { }
}
"#;

    #[test]
    fn prims_properties_and_references_are_read() {
        let layer = parse(LAYER).expect("readable");
        assert_eq!(layer.metadata["defaultPrim"].text(), Some("Room"));
        let room = &layer.children[0];
        assert_eq!((room.kind.as_str(), room.name.as_str()), ("Xform", "Room"));
        let target = |asset: &str, prim: &str| {
            Value::Target(Target {
                asset: asset.into(),
                prim: prim.into(),
            })
        };
        assert_eq!(
            room.metadata["references"].edits().prepended,
            [target("./a.usda", ""), target("./b.usda", "/Inner")]
        );
        let mut scale = Vec::new();
        room.properties["xformOp:scale"].numbers(&mut scale);
        assert_eq!(scale, [2.0, 3.5, -1e-3]);
        assert_eq!(room.children.len(), 2);
        assert_eq!(room.children[1].specifier, Specifier::Over);
        // the earliest of the samples, by number and not by text
        assert_eq!(room.properties["x"].number(), Some(1.5));
        assert!(room.sampled.contains("x"));
        let [set] = room.variant_sets.as_slice() else {
            panic!("{:?}", room.variant_sets)
        };
        let names: Vec<&str> = set.variants.iter().map(|v| v.name.as_str()).collect();
        assert_eq!((set.name.as_str(), names), ("look", vec!["a", "b b"]));
        assert_eq!(set.variants[0].properties["size"].number(), Some(3.0));
        assert_eq!(set.variants[1].children[0].name, "Q");
        let mut points = Vec::new();
        room.children[0].properties["points"].numbers(&mut points);
        assert_eq!(points.len(), 6);
    }

    #[test]
    fn edits_of_lists_add_up_in_a_layer_and_over_layers() {
        let layer = parse(
            "#usda 1.0\nover \"a\" (\n prepend references = </p>\n append references = [@@@x@y.usda@@@ (offset = 1; scale = 2), </q>]\n delete references = @gone.usda@\n) {}",
        )
        .expect("readable");
        let edits = layer.children[0].metadata["references"].edits();
        let targets = |list: &[Value]| -> Vec<String> {
            list.iter()
                .map(|v| match v {
                    Value::Target(t) => format!("{}<{}>", t.asset, t.prim),
                    other => panic!("{other:?}"),
                })
                .collect()
        };
        assert_eq!(targets(&edits.prepended), ["</p>"]);
        assert_eq!(targets(&edits.appended), ["x@y.usda<>", "</q>"]);
        let weaker = ["gone.usda", "kept.usda"].map(|asset| {
            Value::Target(Target {
                asset: asset.into(),
                prim: String::new(),
            })
        });
        assert_eq!(
            targets(&edits.applied_to(weaker.to_vec())),
            ["</p>", "kept.usda<>", "x@y.usda<>", "</q>"]
        );
    }

    #[test]
    fn a_mark_of_byte_order_hides_no_metadata() {
        let marked = parse(&format!("\u{feff}{LAYER}"));
        assert_eq!(marked, parse(LAYER));
    }

    #[test]
    fn every_truncation_ends_without_a_panic() {
        for n in 0..LAYER.len() {
            let _ = parse(&LAYER[..n]);
        }
        let deep = format!("#usda 1.0\n{}", "def X \"a\" {".repeat(10_000));
        assert!(parse(&deep).is_err());
        let deep = format!("#usda 1.0\ndef X \"a\" {{ int a = {}", "[".repeat(100_000));
        assert!(parse(&deep).is_err());
        assert!(parse("PXR-USDC").is_err_and(|e| e.contains("#usda")));
    }
}
