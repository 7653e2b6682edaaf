//! Words of USD's text format.

use std::fmt::Write;

/// A name as USD has them: letters, digits and underscores, no digit first.
pub(super) fn identifier(name: &str) -> String {
    let word: String = name
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
        .collect();
    if word.starts_with(|c: char| c.is_ascii_digit()) {
        format!("_{word}")
    } else {
        word
    }
}

/// A text in quotes.
pub(super) fn quoted(text: &str) -> String {
    let plain = |c: char| if c.is_control() { ' ' } else { c };
    let text: String = text.chars().map(plain).collect();
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

/// Appends an attribute that is a list.
pub(super) fn list(
    s: &mut String,
    name: &str,
    items: impl Iterator<Item = String>,
    metadata: &str,
) {
    let _ = write!(s, "        {name} = [");
    for (i, item) in items.enumerate() {
        if i > 0 {
            s.push_str(if i % 64 == 0 { ",\n" } else { ", " });
        }
        s.push_str(&item);
    }
    let _ = writeln!(s, "]{metadata}");
}
