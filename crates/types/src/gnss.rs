//! Positions by satellites.

use nalgebra::{Matrix3, Vector3};

/// A position of the antenna in the frame of the map, G.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GnssReading {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// Antenna in G, metres.
    pub position: Vector3<f64>,
    /// Covariance of its error, m^2.
    pub covariance: Matrix3<f64>,
}

impl GnssReading {
    /// Whether all of its numbers are finite, and the covariance is one.
    pub fn is_valid(&self) -> bool {
        self.position.iter().all(|value| value.is_finite()) && self.covariance.cholesky().is_some()
    }
}
