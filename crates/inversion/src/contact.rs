//! Readings that contacts are looked for in, and what is found.

use dermis_skin::ChannelFlags;
use nalgebra::{Matrix3, Point3, Vector3};

/// What one channel reads, minus its untouched reading, in the unit of the skin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reading {
    /// This.
    Exact(f64),
    /// This or more: it is at the upper end of its range.
    AtLeast(f64),
    /// This or less: it is at the lower end of its range.
    AtMost(f64),
    /// Nothing that could be relied on.
    Missing,
}

impl Reading {
    /// A `signal` (untouched reading subtracted) of a channel with these flags.
    #[must_use]
    pub fn of(signal: f32, flags: ChannelFlags) -> Self {
        let saturated = flags.contains(ChannelFlags::SATURATED);
        match f64::from(signal) {
            v if v.is_nan() || flags.is_invalid() => Self::Missing,
            v if saturated && v > 0.0 => Self::AtLeast(v),
            v if saturated => Self::AtMost(v),
            v => Self::Exact(v),
        }
    }
}

/// One contact that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactEstimate {
    /// \[m\] on the surface.
    pub position: Point3<f64>,
    /// Out of the surface there.
    pub normal: Vector3<f64>,
    /// \[N\] exerted on the skin.
    pub force: Vector3<f64>,
    /// \[m\] of the tip that it is taken for.
    pub diameter: f64,
    /// \[m²\] in the frame of the skin's link.
    pub position_covariance: Matrix3<f64>,
    /// \[N²\] in the frame of the skin's link.
    pub force_covariance: Matrix3<f64>,
}

impl ContactEstimate {
    /// \[N\] with which it presses.
    #[must_use]
    pub fn normal_force(&self) -> f64 {
        -self.force.dot(&self.normal)
    }

    /// \[m\] root of the variance of its place, both directions together.
    #[must_use]
    pub fn deviation(&self) -> f64 {
        self.position_covariance.trace().max(0.0).sqrt()
    }
}

/// What readings say.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Strongest first; empty where nothing stands out of the noise.
    pub contacts: Vec<ContactEstimate>,
    /// The minima that may be true, the likeliest first, with as many contacts in each; empty where they were not looked for everywhere.
    /// Where several are likely, `contacts` are their means.
    pub minima: Vec<Vec<ContactEstimate>>,
    /// Sum of squared deviations from the readings, in units of their noise.
    pub chi2: f64,
    /// Readings that count, less the numbers that were looked for.
    pub freedom: usize,
    /// Share of a signal by which the device differs from its model here (standard deviation), as what is left says; 0 where noise explains
    /// that.
    pub misfit: f64,
}
