//! What a JPEG file says before its picture: how it is coded, and its colour profile.
//!
//! Segments of a marker (0xFF and a letter), two bytes of length and their data, up to the start of
//! the scan. Sources: ITU-T T.81, annex B; ICC.1:2022, annex B.4 (profiles in pieces of APP2).
//! Damage is not judged here: the decoder does.

use super::open_regular;
use crate::{Error, Result};
use std::io::{BufReader, Read};
use std::path::Path;

/// What the pieces of a profile begin with; their number and the count of all follow.
const PROFILE: &[u8] = b"ICC_PROFILE\0";

/// What is read of a file's segments.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct JpegHeader {
    /// The process (the letter of SOF, 0xC0 is baseline) and the bits of a sample.
    frame: Option<(u8, u8)>,
    /// The ICC profile; `None` without one.
    pub profile: Option<Vec<u8>>,
}

/// The segments of the file at `path`.
///
/// # Errors
/// It cannot be opened.
pub fn read(path: &Path) -> Result<JpegHeader> {
    Ok(of_segments(&mut BufReader::new(open_regular(path)?)))
}

impl JpegHeader {
    /// Refuses processes that libjpeg does not decode to 8 bits.
    ///
    /// # Errors
    /// Names the process.
    pub fn supported(&self, path: &Path) -> Result<()> {
        let what = match self.frame {
            // sequential and progressive, by Huffman's or arithmetic codes
            Some((0xc0..=0xc2 | 0xc9 | 0xca, 8)) | None => return Ok(()),
            Some((0xc3 | 0xcb, _)) => "a lossless JPEG".to_owned(),
            Some((_, bits)) if bits != 8 => format!("a JPEG of {bits} bits per channel"),
            Some((process, _)) => format!("a JPEG of process 0x{process:02X}"),
        };
        Err(Error::input(
            path,
            format!(
                "{what}, which is not read: save it as 16-bit PNG, OpenEXR or a JPEG of 8 bits"
            ),
        ))
    }
}

fn of_segments(file: &mut impl Read) -> JpegHeader {
    let mut header = JpegHeader::default();
    let mut pieces: Vec<(u8, Vec<u8>)> = Vec::new();
    while let Some((marker, data)) = segment(file) {
        match marker {
            0xe2 if data.starts_with(PROFILE) && data.len() > PROFILE.len() + 2 => {
                pieces.push((data[PROFILE.len()], data[PROFILE.len() + 2..].to_vec()));
            }
            // DHT, JPG and DAC lie among the frames' letters
            0xc0..=0xcf if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                header.frame = data.first().map(|bits| (marker, *bits));
            }
            0xda => break,
            _ => {}
        }
    }
    pieces.sort_by_key(|p| p.0);
    if !pieces.is_empty() {
        header.profile = Some(pieces.into_iter().flat_map(|p| p.1).collect());
    }
    header
}

/// The next segment that has data; `None` at the picture's end, the file's, or where neither a
/// marker nor a segment stands.
fn segment(file: &mut impl Read) -> Option<(u8, Vec<u8>)> {
    let mut byte = || {
        let mut one = [0];
        file.read_exact(&mut one).ok().map(|()| one[0])
    };
    let marker = loop {
        if byte()? != 0xff {
            return None;
        }
        // any number of 0xFF may go before a letter
        let letter = loop {
            match byte()? {
                0xff => {}
                letter => break letter,
            }
        };
        match letter {
            // start of image, restarts and TEM stand alone
            0xd8 | 0xd0..=0xd7 | 0x01 => {}
            0xd9 | 0x00 => return None,
            letter => break letter,
        }
    };
    let length = usize::from(u16::from_be_bytes([byte()?, byte()?]));
    let mut data = vec![0; length.checked_sub(2)?];
    file.read_exact(&mut data).ok()?;
    Some((marker, data))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(marker: u8, data: &[u8]) -> Vec<u8> {
        let length = (data.len() + 2) as u16;
        let mut bytes = vec![0xff, marker];
        bytes.extend(length.to_be_bytes());
        bytes.extend(data);
        bytes
    }

    fn profile_piece(number: u8, data: &[u8]) -> Vec<u8> {
        piece(0xe2, &[PROFILE, &[number, 2], data].concat())
    }

    #[test]
    fn a_profile_is_joined_from_its_pieces_in_their_order() {
        let bytes = [
            vec![0xff, 0xd8],
            profile_piece(2, b"cd"),
            piece(0xe2, b"MPF\0"),
            vec![0xff],
            profile_piece(1, b"ab"),
            piece(0xc4, &[9]),
            piece(0xc2, &[8, 0, 1, 0, 1]),
            piece(0xda, &[]),
            profile_piece(3, b"behind the scan's start"),
        ]
        .concat();
        let header = of_segments(&mut &bytes[..]);
        assert_eq!(header.profile.as_deref(), Some(&b"abcd"[..]));
        assert_eq!(header.frame, Some((0xc2, 8)));
        for n in 0..bytes.len() {
            let _ = of_segments(&mut &bytes[..n]);
        }
    }

    #[test]
    fn processes_that_are_not_read_are_named() {
        let of = |process: u8, bits: u8| {
            let bytes = [vec![0xff, 0xd8], piece(process, &[bits])].concat();
            of_segments(&mut &bytes[..]).supported(Path::new("a.jpg"))
        };
        for process in [0xc0, 0xc1, 0xc2, 0xc9, 0xca] {
            assert!(of(process, 8).is_ok(), "{process:x}");
        }
        for (process, bits, said) in [
            (0xc1, 12, "12 bits"),
            (0xc3, 8, "lossless"),
            (0xc5, 8, "0xC5"),
        ] {
            let refused = of(process, bits).is_err_and(|e| e.to_string().contains(said));
            assert!(refused, "{said}");
        }
    }
}
