//! Main memory: what the machine has, how sizes are read and written, and how many photographs may be
//! decoded at once.

use super::formats::number_and_unit;
use super::parallel::prelude::*;
use std::path::Path;

/// Bytes that decoding a photograph takes per pixel of it. Derived: three channels in single precision
/// as the file's reader gives them, as they are returned and with the exposure applied, a byte of
/// ceilings, two of labels as read and two as kept, one of mask.
const PER_DECODED_PIXEL: u64 = 3 * 12 + 6;
/// Part of the memory that photographs under decoding may take in all, if it holds one. Derived: a
/// machine has some 4 GiB a core, of which two photographs of 6720 × 3360, the largest panoramas of
/// cameras for rooms, take half.
const DECODING_PART: u64 = 8;
/// Photographs decoded at once, however small.
const MOST_AT_ONCE: u64 = 64;

/// Photographs that are decoded at once: what they take must not grow with the number of threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Decoding {
    /// How many.
    pub at_once: usize,
    /// Bytes that each takes at most.
    pub each: u64,
}

impl Decoding {
    /// Within so many bytes of memory, where the largest photograph has so many pixels.
    #[must_use]
    pub fn within(memory: u64, pixels: usize) -> Self {
        let each = (pixels as u64 * PER_DECODED_PIXEL).max(1);
        let at_once = (memory / DECODING_PART / each).clamp(1, MOST_AT_ONCE) as usize;
        Self { at_once, each }
    }

    /// `look` at photographs, or at images of their sizes, in parallel; the results in order.
    pub fn map<T: Sync, R: Send>(
        self,
        photographs: &[T],
        look: impl Fn(&T) -> R + Sync + Send,
    ) -> Vec<R> {
        let together = |some: &[T]| some.par_iter().map(&look).collect::<Vec<_>>();
        photographs
            .chunks(self.at_once)
            .flat_map(together)
            .collect()
    }
}

/// Bytes of main memory that this process may use: the machine's, or what its control group
/// (cgroups(7), versions 1 and 2) allows; `None` where the kernel does not tell.
#[must_use]
pub fn machine_bytes() -> Option<u64> {
    let mut limits = vec![kibibytes("/proc/meminfo", "MemTotal:")?];
    let groups = std::fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    for line in groups.lines() {
        let mut fields = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(group)) = (fields.next(), fields.next()) else {
            continue;
        };
        let (root, file) = match controllers {
            "" => ("/sys/fs/cgroup", "memory.max"),
            "memory" => ("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
            _ => continue,
        };
        // what an outer group forbids no inner one allows
        for group in Path::new(group.trim_start_matches('/')).ancestors() {
            let file = Path::new(root).join(group).join(file);
            let text = std::fs::read_to_string(file).unwrap_or_default();
            limits.extend(text.trim().parse::<u64>());
        }
    }
    limits.into_iter().min()
}

/// A size that a file of the kernel states in kibibytes behind `key`.
#[must_use]
pub fn kibibytes(path: &str, key: &str) -> Option<u64> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix(key))?;
    Some(line.split_ascii_whitespace().next()?.parse::<u64>().ok()? * 1024)
}

/// Bytes in GiB.
#[must_use]
pub fn gibibytes(bytes: u64) -> f64 {
    bytes as f64 / (1u64 << 30) as f64
}

/// A size for people.
#[must_use]
pub fn written_bytes(bytes: u64) -> String {
    let gib = gibibytes(bytes);
    if gib < 1.0 {
        format!("{:.0} MiB", 1024.0 * gib)
    } else {
        format!("{gib:.2} GiB")
    }
}

/// A size as people write it: `16GiB`, `16G`, `1.5 TiB`, `500MB`; a bare number is bytes. K, M, G and T
/// alone are powers of 1024, as the kernel's limits take them. Below a MiB it is a unit forgotten.
///
/// # Errors
/// Why it is no size.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    const HOW: &str = "expected a size such as 16GiB, 16G or 500MB";
    let (number, unit) = number_and_unit(text);
    let unit = unit.to_ascii_lowercase();
    let power = |letter: Option<char>| match letter {
        Some('k') => Some(1),
        Some('m') => Some(2),
        Some('g') => Some(3),
        Some('t') => Some(4),
        _ => None,
    };
    let scale = match (unit.as_str(), power(unit.chars().next())) {
        ("" | "b", _) => 1.0,
        (u, Some(p)) if u.len() == 1 || &u[1..] == "ib" => 1024f64.powi(p),
        (u, Some(p)) if &u[1..] == "b" => 1000f64.powi(p),
        _ => return Err(HOW.into()),
    };
    let bytes = number.parse::<f64>().map(|n| n * scale);
    match bytes {
        Ok(n) if (1024f64.powi(2)..1e18).contains(&n) => Ok(n as u64),
        _ => Err(HOW.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_with_their_unit() {
        for (text, bytes) in [
            ("17179869184", 16 << 30),
            ("16GiB", 16 << 30),
            ("16 g", 16 << 30),
            ("0.5TiB", 1 << 39),
            ("500MB", 500_000_000),
            ("3000000kb", 3_000_000_000),
            ("7000000B", 7_000_000),
        ] {
            assert_eq!(parse_bytes(text), Ok(bytes), "{text}");
        }
        for wrong in [
            "", "G", "0", "16", "3kb", "-1G", "4 GiBi", "1e30", "NaN", "3 apples", "4é",
        ] {
            assert!(parse_bytes(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn sizes_are_written_in_the_unit_of_their_order() {
        assert_eq!(written_bytes(5 << 20), "5 MiB");
        assert_eq!(written_bytes(3 << 30), "3.00 GiB");
    }

    #[test]
    fn many_small_photographs_are_decoded_at_once_and_large_ones_apart() {
        let at_once = |gib: u64, pixels| Decoding::within(gib << 30, pixels).at_once;
        assert_eq!(at_once(16, 6720 * 3360), 2);
        assert_eq!(at_once(256, 6720 * 3360), 36);
        assert_eq!(at_once(1, 1 << 28), 1);
        assert_eq!(at_once(16, 1024 * 512), 64);
        let numbers: Vec<usize> = (0..100).collect();
        let doubled: Vec<usize> = (0..200).step_by(2).collect();
        for pixels in [0, 1 << 20, 1 << 28] {
            let decoding = Decoding::within(1 << 30, pixels);
            assert_eq!(decoding.map(&numbers, |n| 2 * n), doubled);
        }
    }

    #[test]
    fn the_machine_has_memory() {
        let bytes = machine_bytes().expect("a kernel with /proc");
        assert!(bytes > 1 << 26, "{bytes}");
    }
}
