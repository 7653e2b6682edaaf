//! Lights without extent: bulbs, spots, measured luminaires, and light from one direction.

use super::IesProfile;
use crate::core::math::Frame;
use glam::Vec3;

/// A light without extent.
#[derive(Clone, Debug, PartialEq)]
pub struct PointLight {
    /// Where it is; without meaning for [`Shape::Distant`].
    pub position: Vec3,
    /// Largest radiant intensity per steradian; of [`Shape::Distant`] the irradiance of a surface
    /// that faces it.
    pub intensity: Vec3,
    /// Unit axis, along which the light goes.
    pub axis: Vec3,
    /// How the intensity falls away from the axis.
    pub shape: Shape,
}

/// How a light without extent distributes its intensity.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// The same everywhere.
    Bulb,
    /// A cone with a soft edge: cosines of the angles to the axis at which the light begins to fall
    /// and at which it has ended.
    Spot([f32; 2]),
    /// A measured luminaire, turned about its axis by an angle in radians.
    Measured(IesProfile, f32),
    /// So far away that its light goes along the axis everywhere: the sun.
    Distant,
}

/// What a light without extent sends to a point that nothing hides from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Arriving {
    /// Unit direction towards the light.
    pub(super) direction: Vec3,
    /// How far it is; infinite for [`Shape::Distant`].
    pub(super) distance: f32,
    /// Irradiance of a surface that faces it.
    pub(super) irradiance: Vec3,
}

impl PointLight {
    /// Intensity towards the unit direction `d` (away from the light).
    #[must_use]
    pub fn towards(&self, d: Vec3) -> Vec3 {
        let cosine = self.axis.dot(d);
        match &self.shape {
            Shape::Bulb | Shape::Distant => self.intensity,
            Shape::Spot([inner, outer]) => {
                let t = ((cosine - outer) / (inner - outer).max(1e-6)).clamp(0.0, 1.0);
                self.intensity * (t * t * (3.0 - 2.0 * t))
            }
            Shape::Measured(profile, turn) => {
                let local = Frame::from_normal(self.axis).local_from_world(d);
                self.intensity * profile.share(cosine, local.y.atan2(local.x) - turn)
            }
        }
    }

    /// What arrives at `p`.
    pub(super) fn arriving(&self, p: Vec3) -> Arriving {
        if self.shape == Shape::Distant {
            return Arriving {
                direction: -self.axis,
                distance: f32::INFINITY,
                irradiance: self.intensity,
            };
        }
        let d = self.position - p;
        let distance = d.length();
        let direction = d / distance.max(1e-9);
        Arriving {
            direction,
            distance,
            irradiance: self.towards(-direction) / (distance * distance).max(1e-12),
        }
    }
}
