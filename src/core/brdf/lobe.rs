//! The specular lobe of any opaque surface: how it masks, and what it reflects at normal incidence.

use super::ggx::{F0, fresnel};
use super::reflectance::Reflectance;
use glam::Vec3;

/// Specular reflectance at normal incidence of what is no metal.
pub const DIELECTRIC: Vec3 = Vec3::splat(F0 as f32);

/// What a lobe of reflectance `f0` at normal incidence reflects over what one of [`DIELECTRIC`]
/// does, which is `dielectric` ([`Reflectance::fresnel`]) at that angle: both rise to 1 at grazing
/// angles alike (Schlick 1994).
#[inline]
#[must_use]
pub fn over_dielectric(f0: Vec3, dielectric: f32) -> Vec3 {
    if f0 == DIELECTRIC {
        return Vec3::ONE;
    }
    let grazing = (dielectric - DIELECTRIC.x) / (1.0 - DIELECTRIC.x);
    (f0 + (1.0 - f0) * grazing) / dielectric
}

/// A colour and how much of it is metal's, as glTF 2.0 parts them (Khronos Group 2021, appendix
/// B.3.5): paint scatters its colour below a colourless lobe, metal has a lobe of its colour alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BaseColour {
    /// Linear Rec. 709, [0, 1].
    pub colour: Vec3,
    /// Share of metal, [0, 1].
    pub metallic: f32,
}

impl BaseColour {
    /// Albedo of the diffuse part.
    #[inline]
    #[must_use]
    pub fn diffuse(self) -> Vec3 {
        self.colour * (1.0 - self.metallic)
    }

    /// Specular reflectance at normal incidence.
    #[inline]
    #[must_use]
    pub fn f0(self) -> Vec3 {
        DIELECTRIC.lerp(self.colour, self.metallic)
    }

    /// What a thin sheet lets straight through of light at `cosine` to its normal, [0, 1]:
    /// t · colour · (1 − F), t being the share `transmission` (Khronos Group 2021,
    /// `KHR_materials_transmission`); metal has none.
    #[must_use]
    pub fn transmitted(self, transmission: f32, cosine: f32) -> Vec3 {
        if transmission == 0.0 {
            return Vec3::ZERO;
        }
        self.diffuse() * (transmission * (1.0 - fresnel(cosine.clamp(0.0, 1.0))))
    }
}

/// A specular lobe but for its roughness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpecularLobe {
    /// Which masking it has.
    pub model: Reflectance,
    /// What it reflects at normal incidence, linear Rec. 709, [0, 1].
    pub f0: Vec3,
}

impl SpecularLobe {
    /// That of plastic, wood, paint, stone.
    #[must_use]
    pub const fn dielectric(model: Reflectance) -> Self {
        Self {
            model,
            f0: DIELECTRIC,
        }
    }

    /// That of a metal which reflects everything: with the dielectric's it makes any lobe, as the
    /// model is linear in `f0`.
    #[must_use]
    pub const fn white_metal(model: Reflectance) -> Self {
        Self {
            model,
            f0: Vec3::ONE,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_base_colour_is_paint_or_metal_or_between() {
        let colour = Vec3::new(0.9, 0.6, 0.3);
        let of = |metallic| {
            let base = BaseColour { colour, metallic };
            (base.diffuse(), base.f0())
        };
        assert_eq!(of(0.0), (colour, DIELECTRIC), "to the bit");
        assert_eq!(of(1.0), (Vec3::ZERO, colour));
        let (diffuse, f0) = of(0.25);
        assert!((diffuse - 0.75 * colour).length() < 1e-6);
        assert!((f0 - (0.75 * DIELECTRIC + 0.25 * colour)).length() < 1e-6);
    }

    #[test]
    fn any_metal_lies_between_the_dielectric_and_the_white_one() {
        let gold = Vec3::new(1.0, 0.77, 0.34);
        for (model, v_h) in Reflectance::ALL
            .into_iter()
            .flat_map(|m| [0.02f32, 0.3, 0.7, 1.0].map(|v_h| (m, v_h)))
        {
            let dielectric = model.fresnel(v_h);
            let white = over_dielectric(Vec3::ONE, dielectric);
            assert!((white.x * dielectric - 1.0).abs() < 1e-6, "all of it");
            let t = (gold - DIELECTRIC) / (1.0 - DIELECTRIC);
            let mixed = Vec3::ONE + t * (white - Vec3::ONE);
            let own = over_dielectric(gold, dielectric);
            assert!(
                (own / mixed - 1.0).abs().max_element() < 1e-5,
                "{own} {mixed}"
            );
        }
        let head_on = over_dielectric(gold, 0.04) * 0.04;
        assert!((head_on - gold).abs().max_element() < 1e-6, "{head_on}");
        assert_eq!(over_dielectric(DIELECTRIC, 0.3), Vec3::ONE);
    }
}
