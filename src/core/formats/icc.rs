//! ICC colour profiles of the matrix kind: three curves and three primaries, what cameras, phones and
//! editors put into photographs. Profiles of tables (printers, scanners) are named, not applied.
//!
//! Source: ICC.1:2022, sections 7 (header, table of tags), 8.4 (three-component matrix-based
//! profiles), 10.6 (`curv`), 10.18 (`para`) and 10.31 (`XYZ `). Called by the readers of pictures.

use super::curve::Curve;
use crate::core::math::colour::{Chromaticities, REC709};
use glam::DVec3;

/// Bytes before the table of tags.
const HEADER: usize = 128;
/// Tags and entries of a curve that real profiles stay far below.
const MOST_TAGS: usize = 256;
const MOST_ENTRIES: usize = 65_536;

/// What a profile says of a picture's values.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Of red, green and blue.
    pub curves: [Curve; 3],
    /// Primaries, and D65 as their white.
    pub space: Chromaticities,
}

/// Reads a profile; the error says why it cannot be used.
pub fn parse(profile: &[u8]) -> Result<Profile, String> {
    if profile.get(36..40) != Some(b"acsp") {
        return Err("it is damaged".into());
    }
    let space = profile.get(16..20).unwrap_or_default();
    match space {
        b"GRAY" => {
            let grey = curve(profile, b"kTRC")?;
            Ok(Profile {
                curves: [grey.clone(), grey.clone(), grey],
                space: REC709,
            })
        }
        b"RGB " => {
            let columns = [
                xyz(profile, b"rXYZ")?,
                xyz(profile, b"gXYZ")?,
                xyz(profile, b"bXYZ")?,
            ];
            let space = Chromaticities::from_d50(columns).ok_or("its primaries span no colours")?;
            let curves = [
                curve(profile, b"rTRC")?,
                curve(profile, b"gTRC")?,
                curve(profile, b"bTRC")?,
            ];
            Ok(Profile { curves, space })
        }
        other => Err(format!(
            "it is of {} values",
            String::from_utf8_lossy(other).trim()
        )),
    }
}

fn u32_at(bytes: &[u8], at: usize) -> Option<usize> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_be_bytes(four.try_into().ok()?) as usize)
}

/// A number with 16 bits behind the point.
fn fixed_at(bytes: &[u8], at: usize) -> Option<f64> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(f64::from(i32::from_be_bytes(four.try_into().ok()?)) / 65536.0)
}

/// The bytes of a tag.
fn tag<'a>(profile: &'a [u8], name: &[u8; 4]) -> Result<&'a [u8], String> {
    let title = || String::from_utf8_lossy(name).into_owned();
    let count = u32_at(profile, HEADER).unwrap_or(0).min(MOST_TAGS);
    let entry = (0..count)
        .map(|i| HEADER + 4 + 12 * i)
        .find(|at| profile.get(*at..at + 4) == Some(name))
        .ok_or_else(|| format!("it has no {}: it is no matrix profile", title()))?;
    let bytes = u32_at(profile, entry + 4)
        .zip(u32_at(profile, entry + 8))
        .and_then(|(from, size)| profile.get(from..from.checked_add(size)?));
    bytes.ok_or_else(|| format!("its {} is cut short", title()))
}

fn xyz(profile: &[u8], name: &[u8; 4]) -> Result<DVec3, String> {
    let bytes = tag(profile, name)?;
    let at = |i: usize| fixed_at(bytes, 8 + 4 * i);
    match (bytes.get(..4), at(0), at(1), at(2)) {
        (Some(b"XYZ "), Some(x), Some(y), Some(z)) => Ok(DVec3::new(x, y, z)),
        _ => Err(format!("its {} is damaged", String::from_utf8_lossy(name))),
    }
}

fn curve(profile: &[u8], name: &[u8; 4]) -> Result<Curve, String> {
    let bytes = tag(profile, name)?;
    let found = match bytes.get(..4) {
        Some(b"curv") => sampled(bytes),
        Some(b"para") => parametric(bytes),
        _ => None,
    };
    let found = found.filter(|c| {
        let at = |x: f32| c.light(x);
        // light rises, from about nothing to about everything
        at(0.0).abs() < 0.1 && (at(1.0) - 1.0).abs() < 0.1 && at(0.5).is_finite()
    });
    found
        .map(Curve::named)
        .ok_or_else(|| format!("its {} is damaged", String::from_utf8_lossy(name)))
}

/// `curv`: nothing is identity, one entry a power with 8 bits behind the point, more are a table.
fn sampled(bytes: &[u8]) -> Option<Curve> {
    let count = u32_at(bytes, 8).filter(|n| *n <= MOST_ENTRIES)?;
    let entries: Vec<u16> = bytes
        .get(12..12 + 2 * count)?
        .chunks_exact(2)
        .map(|b| u16::from_be_bytes([b[0], b[1]]))
        .collect();
    Some(match entries[..] {
        [] => Curve::Linear,
        [one] => Curve::Power(f32::from(one) / 256.0),
        _ => Curve::Table(entries.iter().map(|v| f32::from(*v) / 65535.0).collect()),
    })
}

/// `para`: five functions, all of them cases of the last.
fn parametric(bytes: &[u8]) -> Option<Curve> {
    let kind = usize::from(u16::from_be_bytes([*bytes.get(8)?, *bytes.get(9)?]));
    let count = *[1, 3, 4, 5, 7].get(kind)?;
    let p: Vec<f32> = (0..count)
        .map(|i| fixed_at(bytes, 12 + 4 * i).map(|v| v as f32))
        .collect::<Option<_>>()?;
    let g = p[0];
    let curve = |ab, c, d, ef| Some(Curve::Parametric { g, ab, c, d, ef });
    match p[..] {
        [_] => Some(Curve::Power(g)),
        [_, a, b] if a != 0.0 => curve([a, b], 0.0, -b / a, [0.0; 2]),
        [_, a, b, c] if a != 0.0 => curve([a, b], 0.0, -b / a, [c; 2]),
        [_, a, b, c, d] => curve([a, b], c, d, [0.0; 2]),
        [_, a, b, c, d, e, f] => curve([a, b], c, d, [e, f]),
        _ => None,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::core::math::colour::DISPLAY_P3;
    use crate::core::math::linear_from_srgb;

    /// Display P3's primaries, adapted to D50, as Apple's profile states them.
    const P3: [[f64; 3]; 3] = [
        [0.5151, 0.2412, -0.0011],
        [0.2920, 0.6922, 0.0419],
        [0.1571, 0.0666, 0.7841],
    ];

    fn fixed(values: &[f64]) -> Vec<u8> {
        let bytes = |v: &f64| ((v * 65536.0).round() as i32).to_be_bytes();
        values.iter().flat_map(bytes).collect()
    }

    /// A profile of these primaries with one curve for all channels.
    pub(in super::super) fn profile(primaries: [[f64; 3]; 3], curve: &[u8]) -> Vec<u8> {
        let mut tags: Vec<(&[u8; 4], Vec<u8>)> = Vec::new();
        for (name, p) in [b"rXYZ", b"gXYZ", b"bXYZ"].into_iter().zip(primaries) {
            tags.push((name, [b"XYZ \0\0\0\0".to_vec(), fixed(&p)].concat()));
        }
        for name in [b"rTRC", b"gTRC", b"bTRC"] {
            tags.push((name, curve.to_vec()));
        }
        let mut bytes = vec![0; HEADER];
        bytes[16..24].copy_from_slice(b"RGB XYZ ");
        bytes[36..40].copy_from_slice(b"acsp");
        bytes.extend((tags.len() as u32).to_be_bytes());
        let mut at = bytes.len() + 12 * tags.len();
        for (name, data) in &tags {
            bytes.extend(*name);
            bytes.extend((at as u32).to_be_bytes());
            bytes.extend((data.len() as u32).to_be_bytes());
            at += data.len();
        }
        tags.iter().for_each(|t| bytes.extend(&t.1));
        bytes
    }

    /// sRGB's curve as Apple writes it.
    fn srgb_curve() -> Vec<u8> {
        let mut curve = b"para\0\0\0\0\0\x03\0\0".to_vec();
        curve.extend(fixed(&[
            2.4,
            1.0 / 1.055,
            0.055 / 1.055,
            1.0 / 12.92,
            0.04045,
        ]));
        curve
    }

    /// The profile that an iPhone puts into its photographs.
    pub(in super::super) fn display_p3() -> Vec<u8> {
        profile(P3, &srgb_curve())
    }

    #[test]
    fn a_telephone_s_profile_is_display_p3() {
        let found = parse(&display_p3()).expect("a matrix profile");
        assert!(found.space.is_near(&DISPLAY_P3), "{:?}", found.space);
        assert_eq!(found.curves, [Curve::Srgb, Curve::Srgb, Curve::Srgb]);
    }

    #[test]
    fn srgb_s_own_profile_changes_nothing() {
        let srgb = [
            [0.4361, 0.2225, 0.0139],
            [0.3851, 0.7169, 0.0971],
            [0.1431, 0.0606, 0.7141],
        ];
        let mut table = b"curv\0\0\0\0\0\0\x04\0".to_vec();
        for i in 0..1024 {
            let v = (linear_from_srgb(i as f32 / 1023.0) * 65535.0).round() as u16;
            table.extend(v.to_be_bytes());
        }
        let found = parse(&profile(srgb, &table)).expect("a matrix profile");
        assert!(found.space.is_near(&REC709), "{:?}", found.space);
        assert_eq!(found.curves, [Curve::Srgb, Curve::Srgb, Curve::Srgb]);
    }

    #[test]
    fn powers_and_functions_are_evaluated() {
        let gamma = b"curv\0\0\0\0\0\0\0\x01\x02\x33";
        let found = parse(&profile(P3, gamma)).expect("a matrix profile");
        assert!((found.curves[1].light(0.5) - 0.5f32.powf(563.0 / 256.0)).abs() < 1e-6);
        let identity = b"curv\0\0\0\0\0\0\0\0";
        let found = parse(&profile(P3, identity)).expect("a matrix profile");
        assert_eq!(found.curves[0], Curve::Linear);
        let mut offset = b"para\0\0\0\0\0\x02\0\0".to_vec();
        // (0.9·x + 0.05)² + 0.0025, its start at the very bottom
        offset.extend(fixed(&[2.0, 0.9, 0.05, 0.0025]));
        let found = parse(&profile(P3, &offset)).expect("a matrix profile");
        assert!((found.curves[0].light(0.5) - 0.2525).abs() < 1e-4);
    }

    #[test]
    fn what_cannot_be_applied_is_named_and_no_byte_stops_the_program() {
        let whole = display_p3();
        let mut cmyk = whole.clone();
        cmyk[16..20].copy_from_slice(b"CMYK");
        assert!(parse(&cmyk).is_err_and(|e| e.contains("CMYK")));
        let mut table = whole.clone();
        table[HEADER + 4..HEADER + 8].copy_from_slice(b"A2B0");
        assert!(parse(&table).is_err_and(|e| e.contains("no matrix profile")));
        for n in 0..whole.len() {
            assert!(parse(&whole[..n]).is_err(), "{n} bytes");
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = whole.clone();
                damaged[n] ^= flip;
                let _ = parse(&damaged);
            }
        }
    }
}
