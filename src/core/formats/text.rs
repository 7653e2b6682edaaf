//! Numbers as people read them.

/// 1234567 as "1,234,567"; of a whole number that is not negative.
#[must_use]
pub fn grouped(n: impl std::fmt::Display) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(c);
    }
    out
}

/// A quantity such as "1.5 min" as its number and its unit, either of which may be empty or wrong.
#[must_use]
pub fn number_and_unit(text: &str) -> (&str, &str) {
    let unit = text.find(|c: char| c.is_ascii_alphabetic());
    let (number, unit) = text.split_at(unit.unwrap_or(text.len()));
    (number.trim(), unit.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_begins_with_the_first_letter() {
        let parts = ["1.5 min", "90", " 2m ", "GiB", "4é"].map(number_and_unit);
        let expected = [
            ("1.5", "min"),
            ("90", ""),
            ("2", "m"),
            ("", "GiB"),
            ("4é", ""),
        ];
        assert_eq!(parts, expected);
    }

    #[test]
    fn thousands_stand_apart() {
        assert_eq!(
            [0u64, 999, 1000, 1_234_567].map(grouped),
            ["0", "999", "1,000", "1,234,567"]
        );
    }
}
