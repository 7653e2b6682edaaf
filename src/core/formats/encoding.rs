//! How display-referred pictures (PNG, JPEG) encode light: the curve of each channel, and primaries.
//!
//! The file says (an ICC profile; PNG's `cICP`, `sRGB`, `gAMA` and `cHRM`, in the order of the PNG
//! specification, third edition, section 4.3), or `color_space` in `transforms.json` says it
//! instead; sRGB where nobody does. Called by the readers of pictures.

use super::curve::Curve;
use super::icc;
use crate::core::image::RgbPlane;
use crate::core::math::colour::{Chromaticities, ColourSpace, DISPLAY_P3, REC709, REC2020};
use crate::core::parallel::prelude::*;
use glam::Vec3;

/// Gammas this near 1/2.2 stand for the sRGB curve, which PNG's writers approximate with it, and
/// this near 1 for none. Derived: two decimals are what old writers kept.
const SAME_GAMMA: f64 = 0.005;

/// What the values of a picture mean.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Encoding {
    /// Of red, green and blue.
    pub(super) curves: [Curve; 3],
    /// Primaries and white.
    pub(super) space: Chromaticities,
    /// Who says so: `ICC profile`, `gAMA`, ….
    pub(super) source: &'static str,
    /// What the file says besides and is not applied.
    pub(super) ignored: Option<String>,
}

impl Encoding {
    pub(super) fn new(curve: Curve, space: Chromaticities, source: &'static str) -> Self {
        Self {
            curves: [curve.clone(), curve.clone(), curve],
            space,
            source,
            ignored: None,
        }
    }

    /// Of a file that says nothing of use.
    fn srgb(ignored: Option<String>) -> Self {
        Self {
            ignored,
            ..Self::new(Curve::Srgb, REC709, "nothing")
        }
    }

    /// What the scene says.
    pub(super) fn declared(space: ColourSpace) -> Self {
        let curve = match space {
            ColourSpace::Srgb => Curve::Srgb,
            _ => Curve::Linear,
        };
        Self::new(curve, space.chromaticities(), "color_space")
    }

    /// What an ICC profile says, if there is one.
    pub(super) fn of_profile(profile: Option<&[u8]>) -> Self {
        match profile.map(icc::parse) {
            None => Self::srgb(None),
            Some(Ok(found)) => Self {
                curves: found.curves,
                space: found.space,
                source: "ICC profile",
                ignored: None,
            },
            Some(Err(why)) => Self::srgb(Some(format!(
                "its ICC profile is not applied ({why}), taken as sRGB"
            ))),
        }
    }

    /// What a PNG's chunks say.
    ///
    /// # Errors
    /// They name a curve of HDR television.
    pub(super) fn of_png(info: &png::Info<'_>) -> Result<Self, String> {
        if let Some(c) = info.coding_independent_code_points {
            return of_cicp(c.color_primaries, c.transfer_function);
        }
        if info.icc_profile.is_some() {
            return Ok(Self::of_profile(info.icc_profile.as_deref()));
        }
        if info.srgb.is_some() {
            return Ok(Self::srgb(None));
        }
        let space = info.chrm_chunk.map_or(Some(REC709), |c| {
            let points = [c.red, c.green, c.blue, c.white];
            let list: Vec<f64> = points
                .iter()
                .flat_map(|p| [p.0, p.1].map(|v| f64::from(v.into_scaled()) / 1e5))
                .collect();
            Chromaticities::from_list(&list)
        });
        let gamma = info
            .gama_chunk
            .map(|g| f64::from(g.into_scaled()) / 1e5)
            .map_or(Ok(Curve::Srgb), of_gamma);
        Ok(match (space, gamma) {
            (Some(space), Ok(curve)) => Self::new(curve, space, "gAMA and cHRM"),
            (None, _) => Self::srgb(Some("its cHRM spans no colours, taken as sRGB".into())),
            (_, Err(why)) => Self::srgb(Some(why)),
        })
    }

    /// What was done to get linear Rec. 709, and what was not; `None` for plain sRGB.
    pub(super) fn account(&self) -> Option<String> {
        let mut said = Vec::new();
        let source = self.source;
        if self.curves[0] != Curve::Srgb {
            said.push(match self.transfer() {
                "linear" => format!("taken as linear light ({source})"),
                _ => format!("the curve of its {source} undone"),
            });
        }
        if self.matrix().is_some() {
            let title = self.space.title();
            said.push(format!("{title} ({source}) converted to Rec. 709"));
        }
        said.extend(self.ignored.clone());
        (!said.is_empty()).then(|| said.join("; "))
    }

    /// The curve's name.
    pub(super) fn transfer(&self) -> &'static str {
        self.curves[0].title()
    }

    fn matrix(&self) -> Option<glam::Mat3> {
        let same = self.space.is_near(&REC709);
        (!same).then(|| self.space.rec709_from_rgb(None).as_mat3())
    }

    /// Stored values in 0…1 to linear Rec. 709.
    pub(super) fn decode(&self, pixels: &mut RgbPlane) {
        let light = |p: Vec3| Vec3::from_array([0, 1, 2].map(|c| self.curves[c].light(p[c])));
        pixels.data.par_iter_mut().for_each(|p| *p = light(*p));
        self.convert(pixels);
    }

    /// Light in the picture's primaries to linear Rec. 709; colours beyond it get values below 0.
    pub(super) fn convert(&self, pixels: &mut RgbPlane) {
        if let Some(m) = self.matrix() {
            pixels.data.par_iter_mut().for_each(|p| *p = m * *p);
        }
    }
}

/// The curve of a `gAMA` chunk: stored values are light to this power.
fn of_gamma(gamma: f64) -> Result<Curve, String> {
    let is = |wanted: f64| (gamma - wanted).abs() < SAME_GAMMA;
    match gamma {
        _ if is(1.0) => Ok(Curve::Linear),
        _ if is(1.0 / 2.2) => Ok(Curve::Srgb),
        // 1/4 to 4: beyond lies no display
        g if (0.25..=4.0).contains(&g) => Ok(Curve::Power((1.0 / g) as f32)),
        g => Err(format!("its gAMA of {g} is not applied, taken as sRGB")),
    }
}

/// Primaries and curve by the numbers of ITU-T H.273, tables 2 and 3.
fn of_cicp(primaries: u8, transfer: u8) -> Result<Encoding, String> {
    let mut ignored = Vec::new();
    let space = match primaries {
        1 => REC709,
        9 => REC2020,
        12 => DISPLAY_P3,
        other => {
            ignored.push(format!(
                "primaries {other} of its cICP are not applied, taken as Rec. 709"
            ));
            REC709
        }
    };
    let curve = match transfer {
        8 => Curve::Linear,
        13 => Curve::Srgb,
        4 => Curve::Power(2.2),
        5 => Curve::Power(2.8),
        16 | 18 => {
            let name = if transfer == 16 { "PQ" } else { "HLG" };
            return Err(format!(
                "its cICP says that values follow the {name} curve of HDR television, which is not read: save it as linear OpenEXR, or overrule it with \"color_space\" in transforms.json"
            ));
        }
        other => {
            ignored.push(format!(
                "curve {other} of its cICP is not applied, taken as sRGB"
            ));
            Curve::Srgb
        }
    };
    Ok(Encoding {
        ignored: (!ignored.is_empty()).then(|| ignored.join("; ")),
        ..Encoding::new(curve, space, "cICP")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_television_are_understood_or_named() {
        let linear = of_cicp(9, 8).expect("linear");
        assert_eq!((linear.transfer(), linear.space), ("linear", REC2020));
        assert_eq!(of_cicp(12, 13).expect("P3").space, DISPLAY_P3);
        assert!(of_cicp(9, 16).is_err_and(|e| e.contains("PQ")));
        let odd = of_cicp(4, 1)
            .expect("taken as sRGB")
            .account()
            .expect("said");
        assert!(
            odd.contains("primaries 4") && odd.contains("curve 1"),
            "{odd}"
        );
        assert_eq!(of_cicp(1, 13).expect("sRGB").account(), None);
        assert_eq!(of_gamma(0.45455), Ok(Curve::Srgb));
        assert_eq!(of_gamma(0.5), Ok(Curve::Power(2.0)));
        assert!(of_gamma(1e-5).is_err());
    }
}
