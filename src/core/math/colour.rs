//! Colour spaces as matrices: chromaticities, CIE XYZ and the working space, linear Rec. 709.
//!
//! Sources: SMPTE RP 177 (XYZ from primaries and white); Bradford's chromatic adaptation as in
//! Lindbloom, "Chromatic Adaptation"; primaries of ITU-R BT.709 and BT.2020, of Display P3 and
//! Adobe RGB (1998), of ACES AP0 (SMPTE ST 2065-1) and AP1 (ACEScg, S-2014-004). Called by the
//! readers of images.

use glam::{DMat3, DVec2, DVec3};

/// CIE 1931 (x, y) of three primaries and of white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chromaticities {
    /// Red, green, blue.
    pub primaries: [DVec2; 3],
    /// White.
    pub white: DVec2,
}

/// D65 as ITU-R BT.709 and BT.2020 state it.
pub const D65: DVec2 = DVec2::new(0.3127, 0.3290);
/// The white of ICC's connection space, CIE XYZ (ICC.1, section 7.2.16).
const D50: DVec3 = DVec3::new(0.9642, 1.0, 0.8249);
/// The white of ACES, near D60.
const ACES_WHITE: DVec2 = DVec2::new(0.32168, 0.33767);

/// ITU-R BT.709: the working space.
pub const REC709: Chromaticities = Chromaticities {
    primaries: [
        DVec2::new(0.64, 0.33),
        DVec2::new(0.30, 0.60),
        DVec2::new(0.15, 0.06),
    ],
    white: D65,
};
/// ITU-R BT.2020.
pub const REC2020: Chromaticities = Chromaticities {
    primaries: [
        DVec2::new(0.708, 0.292),
        DVec2::new(0.170, 0.797),
        DVec2::new(0.131, 0.046),
    ],
    white: D65,
};
/// SMPTE EG 432-1 with the white of displays (Display P3).
pub const DISPLAY_P3: Chromaticities = Chromaticities {
    primaries: [
        DVec2::new(0.680, 0.320),
        DVec2::new(0.265, 0.690),
        DVec2::new(0.150, 0.060),
    ],
    white: D65,
};
/// Adobe RGB (1998).
const ADOBE_RGB: Chromaticities = Chromaticities {
    primaries: [
        DVec2::new(0.64, 0.33),
        DVec2::new(0.21, 0.71),
        DVec2::new(0.15, 0.06),
    ],
    white: D65,
};
/// ACES AP1.
const ACESCG: Chromaticities = Chromaticities {
    primaries: [
        DVec2::new(0.713, 0.293),
        DVec2::new(0.165, 0.830),
        DVec2::new(0.128, 0.044),
    ],
    white: ACES_WHITE,
};
/// ACES AP0.
const ACES2065: Chromaticities = Chromaticities {
    primaries: [
        DVec2::new(0.7347, 0.2653),
        DVec2::new(0.0, 1.0),
        DVec2::new(0.0001, -0.077),
    ],
    white: ACES_WHITE,
};
/// CIE XYZ itself, whose white is equal energy.
const XYZ: Chromaticities = Chromaticities {
    primaries: [
        DVec2::new(1.0, 0.0),
        DVec2::new(0.0, 1.0),
        DVec2::new(0.0, 0.0),
    ],
    white: DVec2::new(1.0 / 3.0, 1.0 / 3.0),
};

/// A colour space that `color_space` in `transforms.json` may name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourSpace {
    /// Linear, primaries of BT.709.
    Rec709,
    /// Primaries of BT.709 with the curve of IEC 61966-2-1.
    Srgb,
    /// Linear, ACES AP1.
    AcesCg,
    /// Linear, ACES AP0.
    Aces2065,
    /// Linear, primaries of BT.2020.
    Rec2020,
    /// CIE XYZ.
    Xyz,
}

impl ColourSpace {
    /// All of them, with the names of the key.
    pub const NAMES: [(&'static str, Self); 6] = [
        ("rec709", Self::Rec709),
        ("srgb", Self::Srgb),
        ("acescg", Self::AcesCg),
        ("aces2065-1", Self::Aces2065),
        ("rec2020", Self::Rec2020),
        ("xyz", Self::Xyz),
    ];

    /// The space of this name; capitals do not count.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let found = Self::NAMES
            .iter()
            .find(|(n, _)| n.eq_ignore_ascii_case(name));
        found.map(|f| f.1)
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES
            .iter()
            .find(|(_, s)| *s == self)
            .map_or("rec709", |f| f.0)
    }

    /// Its primaries and white.
    #[must_use]
    pub fn chromaticities(self) -> Chromaticities {
        match self {
            Self::Rec709 | Self::Srgb => REC709,
            Self::AcesCg => ACESCG,
            Self::Aces2065 => ACES2065,
            Self::Rec2020 => REC2020,
            Self::Xyz => XYZ,
        }
    }
}

impl Chromaticities {
    /// From (x, y) of red, green, blue and white in a row; `None` unless they span a space.
    #[must_use]
    pub fn from_list(list: &[f64]) -> Option<Self> {
        let &[rx, ry, gx, gy, bx, by, wx, wy] = list else {
            return None;
        };
        let found = Self {
            primaries: [DVec2::new(rx, ry), DVec2::new(gx, gy), DVec2::new(bx, by)],
            white: DVec2::new(wx, wy),
        };
        let sane = list.iter().all(|v| v.is_finite() && v.abs() <= 2.0) && wy > 1e-3;
        let matrix = found.xyz_from_rgb();
        (sane && matrix.is_finite() && matrix.determinant().abs() > 1e-6).then_some(found)
    }

    /// From the CIE XYZ of red, green and blue that an ICC profile states: adapted to D50 there, and
    /// brought back to D65 here. `None` unless they span a space.
    #[must_use]
    pub fn from_d50(columns: [DVec3; 3]) -> Option<Self> {
        let to_d65 = bradford(xy_of(D50), D65);
        let [r, g, b] = columns.map(|c| to_d65 * c);
        let list: Vec<f64> = [r, g, b, r + g + b]
            .into_iter()
            .flat_map(|c| xy_of(c).to_array())
            .collect();
        Self::from_list(&list)
    }

    /// CIE XYZ of linear RGB, white at Y = 1 (RP 177).
    #[must_use]
    pub fn xyz_from_rgb(&self) -> DMat3 {
        // columns x, y, z = 1 − x − y: primaries whose y is 0 (XYZ itself) are fine that way
        let columns = self
            .primaries
            .map(|p| DVec3::new(p.x, p.y, 1.0 - p.x - p.y));
        let m = DMat3::from_cols(columns[0], columns[1], columns[2]);
        let scale = m.inverse() * xyz_of(self.white);
        m * DMat3::from_diagonal(scale)
    }

    /// Linear Rec. 709 of linear RGB in this space, whites adapted by Bradford's transform.
    ///
    /// `neutral` is what the picture's author calls white, if other than the space's own white.
    /// CIE XYZ has no white that a picture would mean by it: without `neutral` it is taken as it
    /// is, D65 staying D65.
    #[must_use]
    pub fn rec709_from_rgb(&self, neutral: Option<DVec2>) -> DMat3 {
        let to_xyz = self.xyz_from_rgb();
        let own = if self.is_near(&XYZ) { D65 } else { self.white };
        REC709.xyz_from_rgb().inverse() * bradford(neutral.unwrap_or(own), D65) * to_xyz
    }

    /// Weights of the luminance Y: the second row of [`Self::xyz_from_rgb`].
    #[must_use]
    pub fn luminance_weights(&self) -> DVec3 {
        self.xyz_from_rgb().row(1)
    }

    /// Whether both are the same to the precision files state them with.
    #[must_use]
    pub fn is_near(&self, other: &Self) -> bool {
        let close = |a: DVec2, b: DVec2| (a - b).abs().max_element() < 2e-3;
        let primaries = self.primaries.iter().zip(other.primaries);
        primaries.fold(close(self.white, other.white), |all, (a, b)| {
            all && close(*a, b)
        })
    }

    /// The name of a known space, else the numbers.
    #[must_use]
    pub fn title(&self) -> String {
        let known = [
            ("Rec. 709", REC709),
            ("Rec. 2020", REC2020),
            ("Display P3", DISPLAY_P3),
            ("Adobe RGB", ADOBE_RGB),
            ("ACEScg (AP1)", ACESCG),
            ("ACES2065-1 (AP0)", ACES2065),
            ("CIE XYZ", XYZ),
        ];
        if let Some((name, _)) = known.iter().find(|(_, c)| self.is_near(c)) {
            return (*name).into();
        }
        let point = |p: DVec2| format!("({:.4}, {:.4})", p.x, p.y);
        let [r, g, b] = self.primaries.map(point);
        format!("red {r}, green {g}, blue {b}, white {}", point(self.white))
    }
}

/// The chromaticity of a colour.
fn xy_of(xyz: DVec3) -> DVec2 {
    DVec2::new(xyz.x, xyz.y) / xyz.element_sum()
}

/// XYZ at Y = 1 of a chromaticity.
fn xyz_of(xy: DVec2) -> DVec3 {
    DVec3::new(xy.x, xy.y, 1.0 - xy.x - xy.y) / xy.y
}

/// Bradford's adaptation from one white to another: von Kries in sharpened cone responses.
fn bradford(from: DVec2, to: DVec2) -> DMat3 {
    if from == to {
        return DMat3::IDENTITY;
    }
    let cone = DMat3::from_cols(
        DVec3::new(0.8951, -0.7502, 0.0389),
        DVec3::new(0.2664, 1.7135, -0.0685),
        DVec3::new(-0.1614, 0.0367, 1.0296),
    );
    let gain = (cone * xyz_of(to)) / (cone * xyz_of(from));
    cone.inverse() * DMat3::from_diagonal(gain) * cone
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(found: DMat3, rows: [[f64; 3]; 3], tolerance: f64) {
        for (i, row) in rows.iter().enumerate() {
            let off = (found.row(i) - DVec3::from_array(*row)).abs().max_element();
            assert!(off < tolerance, "row {i}: {} for {row:?}", found.row(i));
        }
    }

    /// ITU-R BT.2087-0 for Rec. 2020, the ACES reference (Bradford) for AP1.
    #[test]
    fn published_matrices_are_found() {
        assert_near(
            ColourSpace::Rec2020.chromaticities().rec709_from_rgb(None),
            [
                [1.6605, -0.5876, -0.0728],
                [-0.1246, 1.1329, -0.0083],
                [-0.0182, -0.1006, 1.1187],
            ],
            1e-4,
        );
        assert_near(
            ColourSpace::AcesCg.chromaticities().rec709_from_rgb(None),
            [
                [1.70505, -0.62179, -0.08326],
                [-0.13026, 1.14080, -0.01055],
                [-0.02400, -0.12897, 1.15297],
            ],
            2e-4,
        );
        assert_near(
            ColourSpace::Xyz.chromaticities().rec709_from_rgb(None),
            [
                [3.2410, -1.5374, -0.4986],
                [-0.9692, 1.8760, 0.0416],
                [0.0556, -0.2040, 1.0570],
            ],
            1e-3,
        );
    }

    #[test]
    fn white_stays_white_and_rec709_stays_itself() {
        for (name, space) in ColourSpace::NAMES {
            assert_eq!(ColourSpace::named(&name.to_uppercase()), Some(space));
            let c = space.chromaticities();
            let white = c.rec709_from_rgb(Some(c.white)) * DVec3::ONE;
            assert!((white - DVec3::ONE).abs().max_element() < 1e-9, "{name}");
        }
        let own = REC709.rec709_from_rgb(None);
        assert!((own - DMat3::IDENTITY).abs_diff_eq(DMat3::ZERO, 1e-12));
        let y = REC709.luminance_weights();
        assert!((y - DVec3::new(0.2126, 0.7152, 0.0722)).abs().max_element() < 1e-4);
        assert!(Chromaticities::from_list(&[0.3; 8]).is_none(), "no space");
    }
}
