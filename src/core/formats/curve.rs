//! Curves of pictures for displays: from stored values to light (transfer functions). Called by the
//! readers of colour profiles and of what pictures say of their encoding.

use crate::core::math::linear_from_srgb;

/// From a stored value in 0…1 to light.
#[derive(Clone, Debug, PartialEq)]
pub enum Curve {
    /// IEC 61966-2-1.
    Srgb,
    /// Stored as light.
    Linear,
    /// A power.
    Power(f32),
    /// ICC's function 4: (a·x + b)^g + e from x = d, c·x + f below.
    Parametric {
        /// The exponent.
        g: f32,
        /// Factor and offset within the power.
        ab: [f32; 2],
        /// Slope of the linear piece.
        c: f32,
        /// Where the linear piece ends.
        d: f32,
        /// Offsets of the power and of the linear piece.
        ef: [f32; 2],
    },
    /// Values at equal steps, at least two.
    Table(Vec<f32>),
}

impl Curve {
    /// Light of a stored value.
    pub fn light(&self, x: f32) -> f32 {
        match self {
            Self::Srgb => linear_from_srgb(x),
            Self::Linear => x,
            Self::Power(g) => x.max(0.0).powf(*g),
            Self::Parametric { g, ab, c, d, ef } => match x >= *d {
                true => (ab[0] * x + ab[1]).max(0.0).powf(*g) + ef[0],
                false => c * x + ef[1],
            },
            Self::Table(values) => {
                let last = values.len() - 1;
                let at = x.clamp(0.0, 1.0) * last as f32;
                let i = (at as usize).min(last - 1);
                values[i] + (values[i + 1] - values[i]) * (at - i as f32)
            }
        }
    }

    /// The curve by its proper name, where it is one that has a name: profiles write sRGB's in many
    /// ways.
    pub fn named(self) -> Self {
        // half a step of 8 bits where the curve is steepest, a tenth of one in the dark
        let near = |other: &Self| {
            (0..=64).map(|i| i as f32 / 64.0).all(|x| {
                let (own, its) = (self.light(x), other.light(x));
                (own - its).abs() < 4e-4 + 2e-3 * its
            })
        };
        match self {
            named @ (Self::Srgb | Self::Linear) => named,
            _ if near(&Self::Srgb) => Self::Srgb,
            _ if near(&Self::Linear) => Self::Linear,
            other => other,
        }
    }

    /// Its name.
    pub fn title(&self) -> &'static str {
        match self {
            Self::Srgb => "sRGB",
            Self::Linear => "linear",
            _ => "own curve",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_that_is_srgb_by_another_name_is_found() {
        let table: Vec<f32> = (0..1024)
            .map(|i| (linear_from_srgb(i as f32 / 1023.0) * 65535.0).round() / 65535.0)
            .collect();
        assert_eq!(Curve::Table(table).named(), Curve::Srgb);
        let parts = Curve::Parametric {
            g: 2.4,
            ab: [1.0 / 1.055, 0.055 / 1.055],
            c: 1.0 / 12.92,
            d: 0.04045,
            ef: [0.0; 2],
        };
        assert_eq!(parts.named(), Curve::Srgb);
        assert_eq!(Curve::Table(vec![0.0, 1.0]).named(), Curve::Linear);
        let power = Curve::Power(2.2);
        assert_eq!(power.clone().named(), power, "2.2 is not sRGB");
        assert!((Curve::Table(vec![0.0, 0.25, 1.0]).light(0.75) - 0.625).abs() < 1e-6);
    }
}
