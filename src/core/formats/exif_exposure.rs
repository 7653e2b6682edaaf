//! The exposure of a photograph by its EXIF: time × ISO / 100 / aperture², never the bias (which
//! says what was asked of the camera, not what it did). Called by the readers of photographs and by
//! those who merge brackets.

use super::open_regular;
use exif::{Exif, In, Tag, Value};
use std::io::BufReader;
use std::path::Path;

/// `ShutterSpeedValue` (APEX) is the exact time where it differs from `ExposureTime` by the
/// rounding of printed times only (derived: 1/30 stands for 1/32, 1/15 for 1/16: 6.7 %).
const PRINTED_ROUNDING: f64 = 0.08;

/// Seconds · ISO / 100 / f-number²; what is not stated of the last two is taken as 1.
///
/// # Errors
/// The file states no time; says why.
pub fn exif_exposure(path: &Path) -> Result<f64, String> {
    let file = open_regular(path).map_err(|e| e.to_string())?;
    let exif = exif::Reader::new()
        .read_from_container(&mut BufReader::new(file))
        .map_err(|e| format!("no EXIF data ({e})"))?;
    let time = time(&exif).ok_or("its EXIF states no exposure time")?;
    let iso = number(&exif, Tag::PhotographicSensitivity).filter(|&i| i > 0.0);
    let aperture = number(&exif, Tag::FNumber)
        .or_else(|| number(&exif, Tag::ApertureValue).map(|apex| (0.5 * apex).exp2()))
        .filter(|&n| n > 0.0);
    let exposure = time * iso.unwrap_or(100.0) / 100.0 / aperture.unwrap_or(1.0).powi(2);
    (exposure.is_finite() && exposure > 0.0)
        .then_some(exposure)
        .ok_or_else(|| "its EXIF states an exposure that no camera has".into())
}

fn time(exif: &Exif) -> Option<f64> {
    let stated = number(exif, Tag::ExposureTime).filter(|&t| t > 0.0);
    let apex = number(exif, Tag::ShutterSpeedValue).map(|v| (-v).exp2());
    match (stated, apex) {
        (Some(t), Some(a)) if (a / t).ln().abs() < PRINTED_ROUNDING => Some(a),
        (Some(t), _) => Some(t),
        (None, apex) => apex,
    }
}

fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(v) => v.first()?.to_f64(),
        Value::SRational(v) => v.first()?.to_f64(),
        other => f64::from(other.get_uint(0)?),
    };
    value.is_finite().then_some(value)
}
