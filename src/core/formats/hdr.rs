//! Radiance HDR (`.hdr`, `.pic`): header, scan lines, and what the header says of exposure and
//! colour.
//!
//! Stored values are radiance times the product of all `EXPOSURE` lines and, by channel, of all
//! `COLORCORR` lines: both are divided out. Sources: Ward, "The RADIANCE Picture File Format"
//! (refer/filefmts.pdf), sections on headers and on run-length coding; `color.c` for the old
//! run-length form. Called by the readers of linear images.

use super::{checked_size, open_regular};
use crate::core::image::{Plane, RgbPlane};
use crate::core::math::colour::Chromaticities;
use crate::{Error, Result};
use glam::{DVec3, Vec3};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Longest header worth reading: real ones have a few lines of the programs that made the file.
const LONGEST_HEADER: u64 = 1 << 16;

/// What a Radiance file says before its pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct HdrHeader {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Product of all `EXPOSURE` lines.
    pub exposure: f64,
    /// Product of all `COLORCORR` lines.
    pub correction: DVec3,
    /// `PRIMARIES`, if given.
    pub primaries: Option<Chromaticities>,
    /// Pixels are CIE XYZ (`32-bit_rle_xyze`) rather than RGB.
    pub xyz: bool,
}

impl HdrHeader {
    /// What stored values are multiplied with to become radiance.
    #[must_use]
    pub fn gain(&self) -> Vec3 {
        (1.0 / (self.exposure * self.correction)).as_vec3()
    }
}

/// The header of a file.
///
/// # Errors
/// It cannot be read, or its header is damaged or says what is not supported.
pub fn header(path: &Path) -> Result<HdrHeader> {
    read_header(path).map(|(header, _)| header)
}

fn read_header(path: &Path) -> Result<(HdrHeader, BufReader<std::fs::File>)> {
    let mut file = BufReader::new(open_regular(path)?);
    let lines = header_lines(&mut file).map_err(|e| damaged(path, &e))?;
    let (size, lines) = lines
        .split_last()
        .ok_or_else(|| damaged(path, "no header"))?;
    let words: Vec<&str> = size.split_whitespace().collect();
    let (width, height) = match words[..] {
        ["-Y", h, "+X", w] => match (w.parse::<i64>(), h.parse::<i64>()) {
            (Ok(w), Ok(h)) => checked_size(path, w, h)?,
            _ => return Err(damaged(path, "its size is no number")),
        },
        [y, _, x, _] if y.starts_with(['+', '-']) && x.starts_with(['+', '-']) => {
            return Err(Error::input(
                path,
                "its rows or columns are stored in another order than -Y +X; save it in the usual order",
            ));
        }
        _ => return Err(damaged(path, "no line with its size")),
    };
    let mut header = HdrHeader {
        width,
        height,
        exposure: 1.0,
        correction: DVec3::ONE,
        primaries: None,
        xyz: false,
    };
    let mut format = false;
    for line in lines {
        let Some((key, value)) = line.split_once('=') else {
            continue;
        };
        let numbers: Vec<f64> = value
            .split_whitespace()
            .filter_map(|v| v.parse().ok())
            .collect();
        let positive =
            |n: usize| numbers.len() == n && numbers.iter().all(|v| *v > 1e-30 && *v < 1e30);
        match key.trim() {
            "EXPOSURE" if positive(1) => header.exposure *= numbers[0],
            "COLORCORR" if positive(3) => header.correction *= DVec3::from_slice(&numbers),
            key @ ("EXPOSURE" | "COLORCORR") => {
                return Err(damaged(path, &format!("{key}={}", value.trim())));
            }
            "PRIMARIES" => {
                header.primaries = Chromaticities::from_list(&numbers);
                if header.primaries.is_none() {
                    return Err(damaged(path, &format!("PRIMARIES={}", value.trim())));
                }
            }
            "FORMAT" => match value.trim() {
                "32-bit_rle_rgbe" => format = true,
                "32-bit_rle_xyze" => (format, header.xyz) = (true, true),
                other => return Err(damaged(path, &format!("unknown FORMAT {other}"))),
            },
            _ => {}
        }
    }
    match format {
        true => Ok((header, file)),
        false => Err(damaged(path, "no FORMAT specifier found")),
    }
}

/// The lines up to the empty one, and the one with the size after it.
fn header_lines(file: &mut impl BufRead) -> std::result::Result<Vec<String>, String> {
    let mut limited = file.by_ref().take(LONGEST_HEADER);
    let mut lines = Vec::new();
    let mut ended = false;
    loop {
        let mut line = Vec::new();
        let n = limited
            .read_until(b'\n', &mut line)
            .map_err(|e| e.to_string())?;
        if n == 0 {
            return Err("it ends within its header".into());
        }
        let line = String::from_utf8_lossy(&line).trim_end().to_owned();
        if ended {
            lines.push(line);
            return Ok(lines);
        }
        ended = line.is_empty();
        if !ended {
            lines.push(line);
        }
    }
}

/// Reads a file: its pixels with exposure and colour correction divided out, and its header.
///
/// Memory grows with what is there, not with what the header states.
///
/// # Errors
/// As [`header`]; or the pixels are damaged or cut short.
pub fn read(path: &Path) -> Result<(RgbPlane, HdrHeader)> {
    let (header, mut file) = read_header(path)?;
    let gain = header.gain();
    let plain = gain == Vec3::ONE;
    let mut data: Vec<Vec3> = Vec::new();
    let mut row = vec![[0u8; 4]; header.width];
    for y in 0..header.height {
        scan_line(&mut file, &mut row).map_err(|e| damaged(path, &format!("row {y}: {e}")))?;
        data.try_reserve(header.width)
            .map_err(|e| Error::Failed(format!("{}: no memory: {e}", path.display())))?;
        data.extend(row.iter().map(|p| match plain {
            true => radiance(*p),
            false => gain * radiance(*p),
        }));
    }
    let plane = Plane {
        width: header.width,
        height: header.height,
        data,
    };
    Ok((plane, header))
}

/// Mantissas times 2^(exponent − 136).
fn radiance([r, g, b, e]: [u8; 4]) -> Vec3 {
    if e == 0 {
        return Vec3::ZERO;
    }
    let unit = (i32::from(e) - 136) as f32;
    Vec3::new(f32::from(r), f32::from(g), f32::from(b)) * unit.exp2()
}

/// Fills one row: run-length coded by channel, or pixels one after the other, of which (1, 1, 1, n)
/// repeats the one before (the old form).
fn scan_line(file: &mut impl Read, row: &mut [[u8; 4]]) -> std::result::Result<(), String> {
    let width = row.len();
    let mut first = [0u8; 4];
    fill(file, &mut first)?;
    let by_channel = first[..2] == [2, 2] && first[2] < 128 && (8..1 << 15).contains(&width);
    if by_channel {
        if usize::from(first[2]) << 8 | usize::from(first[3]) != width {
            return Err("a row of another length".into());
        }
        return (0..4).try_for_each(|c| runs(file, row, c));
    }
    let (mut x, mut shift) = (0usize, 0u32);
    let mut pixel = first;
    loop {
        if pixel[..3] == [1, 1, 1] && x > 0 {
            let n = usize::from(pixel[3]) << shift;
            let end = x
                .checked_add(n)
                .filter(|e| *e <= width)
                .ok_or("a run too long")?;
            let before = row[x - 1];
            row[x..end].fill(before);
            (x, shift) = (end, (shift + 8).min(24));
        } else {
            row[x] = pixel;
            (x, shift) = (x + 1, 0);
        }
        if x == width {
            return Ok(());
        }
        fill(file, &mut pixel)?;
    }
}

/// One channel of a row: a count above 128 repeats the next byte, others are followed by as many.
fn runs(file: &mut impl Read, row: &mut [[u8; 4]], c: usize) -> std::result::Result<(), String> {
    let mut x = 0;
    let mut bytes = [0u8; 128];
    while x < row.len() {
        fill(file, &mut bytes[..1])?;
        let count = usize::from(bytes[0]);
        let (n, repeat) = if count > 128 {
            (count - 128, true)
        } else {
            (count, false)
        };
        if n == 0 || x + n > row.len() {
            return Err("a run of wrong length".into());
        }
        fill(file, &mut bytes[..if repeat { 1 } else { n }])?;
        for (i, pixel) in row[x..x + n].iter_mut().enumerate() {
            pixel[c] = bytes[if repeat { 0 } else { i }];
        }
        x += n;
    }
    Ok(())
}

fn fill(file: &mut impl Read, bytes: &mut [u8]) -> std::result::Result<(), String> {
    file.read_exact(bytes)
        .map_err(|_| "the file ends here".into())
}

fn damaged(path: &Path, reason: &str) -> Error {
    Error::input(
        path,
        format!("damaged or cut short: {reason}; copy, render or download it again"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, pixels: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
        let dir = tempfile::tempdir().expect("temp");
        let path = dir.path().join("a.hdr");
        let mut bytes = format!("#?RADIANCE\n{header}\n").into_bytes();
        bytes.extend(pixels);
        std::fs::write(&path, bytes).expect("file");
        (dir, path)
    }

    const RGBE: &str = "FORMAT=32-bit_rle_rgbe\n";

    #[test]
    fn exposures_and_corrections_are_divided_out() {
        let header = format!("EXPOSURE=2\n{RGBE}EXPOSURE= 4.0\nCOLORCORR=1 2 0.5\n\n-Y 1 +X 1");
        let (_dir, path) = file(&header, &[128, 128, 128, 136]);
        let (plane, header) = read(&path).expect("read");
        assert_eq!(plane.data[0], Vec3::new(16.0, 8.0, 32.0));
        assert_eq!((header.exposure, header.xyz), (8.0, false));
        let (_dir, path) = file(&format!("EXPOSURE=0\n{RGBE}\n-Y 1 +X 1"), &[1; 4]);
        assert!(read(&path).is_err_and(|e| e.to_string().contains("EXPOSURE")));
    }

    #[test]
    fn all_three_codings_give_the_same_pixels() {
        // eight pixels: five of one colour, three of another
        let (a, b) = ([10u8, 20, 30, 140], [40u8, 50, 60, 141]);
        let flat: Vec<u8> = [a, a, a, a, a, b, b, b].concat();
        let old: Vec<u8> = [a, [1, 1, 1, 4], b, [1, 1, 1, 2]].concat();
        let mut new = vec![2, 2, 0, 8];
        for c in 0..4 {
            new.extend([128 + 5, a[c], 3, b[c], b[c], b[c]]);
        }
        let head = format!("{RGBE}\n-Y 1 +X 8");
        let pixels = |bytes: &[u8]| {
            let (_dir, path) = file(&head, bytes);
            read(&path).map(|r| r.0.data)
        };
        let expected = pixels(&flat).expect("flat");
        assert_eq!(expected[7], Vec3::new(40.0, 50.0, 60.0) * 32.0);
        assert_eq!(pixels(&old).expect("old"), expected);
        assert_eq!(pixels(&new).expect("new"), expected);
        for n in 0..new.len() {
            assert!(pixels(&new[..n]).is_err(), "{n} bytes");
        }
        assert!(pixels(&[2, 2, 0, 8, 255]).is_err(), "runs beyond the row");
        assert!(pixels(&[2, 2, 0, 8, 0]).is_err(), "empty runs");
    }

    #[test]
    fn a_small_file_that_states_a_large_size_costs_nothing() {
        let (_dir, path) = file(&format!("{RGBE}\n-Y 11585 +X 23170"), &[]);
        assert!(read(&path).is_err_and(|e| e.to_string().contains("row 0")));
        let (_dir, path) = file(&format!("{RGBE}\n+X 4 -Y 4"), &[]);
        assert!(read(&path).is_err_and(|e| e.to_string().contains("order")));
    }
}
