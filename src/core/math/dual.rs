//! Forward-mode dual numbers: the oracle that analytic derivatives are checked against.

use super::Real;
use std::cmp::Ordering;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A value with its derivatives in `N` directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<const N: usize> {
    /// Value.
    pub x: f64,
    /// Partial derivatives.
    pub d: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// An independent variable: derivative 1 in direction `i`.
    ///
    /// # Panics
    /// If `i >= N`.
    #[must_use]
    pub fn variable(x: f64, i: usize) -> Self {
        let mut d = [0.0; N];
        d[i] = 1.0;
        Self { x, d }
    }

    fn chain(self, x: f64, slope: f64) -> Self {
        Self {
            x,
            d: self.d.map(|d| d * slope),
        }
    }

    fn zip(self, other: Self, x: f64, f: impl Fn(f64, f64) -> f64) -> Self {
        Self {
            x,
            d: std::array::from_fn(|i| f(self.d[i], other.d[i])),
        }
    }
}

impl<const N: usize> PartialOrd for Dual<N> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        self.x.partial_cmp(&other.x)
    }
}
impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        self.zip(o, self.x + o.x, |a, b| a + b)
    }
}
impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        self.zip(o, self.x - o.x, |a, b| a - b)
    }
}
#[allow(clippy::suspicious_arithmetic_impl, reason = "the product rule")]
impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        self.zip(o, self.x * o.x, |a, b| a * o.x + self.x * b)
    }
}
#[allow(clippy::suspicious_arithmetic_impl, reason = "the quotient rule")]
impl<const N: usize> Div for Dual<N> {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        let q = self.x / o.x;
        self.zip(o, q, |a, b| (a - q * b) / o.x)
    }
}
impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    fn neg(self) -> Self {
        self.chain(-self.x, -1.0)
    }
}
impl<const N: usize> Real for Dual<N> {
    fn lit(x: f64) -> Self {
        Self { x, d: [0.0; N] }
    }
    fn sqrt(self) -> Self {
        let r = self.x.sqrt();
        self.chain(r, 0.5 / r)
    }
    fn exp2(self) -> Self {
        let e = self.x.exp2();
        self.chain(e, e * std::f64::consts::LN_2)
    }
    fn value(self) -> f64 {
        self.x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_of_a_composite_match_the_closed_form() {
        let x = Dual::<1>::variable(0.7, 0);
        let y = (x.sq() + Dual::lit(1.0)).sqrt() / x - x.exp2();
        let s = (0.49f64 + 1.0).sqrt();
        let dy = (0.7 / s) / 0.7 - s / 0.49 - 0.7f64.exp2() * std::f64::consts::LN_2;
        assert!((y.d[0] - dy).abs() < 1e-14);
        assert!(((-y).d[0] + dy).abs() < 1e-14);
    }
}
