//! Words within names.

/// The words of a name, lower case: letters between others, and at capitals within ("WallPaint").
pub(super) fn words(name: &str) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    let mut before = ' ';
    for c in name.chars() {
        if c.is_alphabetic() {
            if !before.is_alphabetic() || (c.is_uppercase() && before.is_lowercase()) {
                out.push(String::new());
            }
            if let Some(word) = out.last_mut() {
                word.extend(c.to_lowercase());
            }
        }
        before = c;
    }
    out
}
