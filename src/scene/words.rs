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

/// Whether a name is that of what emits light: such a word at its end ("ceiling light", not "light
/// oak", "lamp stand", "lightswitch").
#[must_use]
pub fn is_lamp(name: &str) -> bool {
    const LAMPS: [&str; 12] = [
        "lamp",
        "lamps",
        "light",
        "lights",
        "bulb",
        "bulbs",
        "lightbulb",
        "luminaire",
        "downlight",
        "spotlight",
        "chandelier",
        "led",
    ];
    words(name)
        .last()
        .is_some_and(|w| LAMPS.contains(&w.as_str()))
}
