//! Readings of GNSS of a run: errors that are alike for a while, as stated, and jumps and outages, which are not.

use crate::random::{Purpose, normal3, stream};
use crate::spline::Spline;
use estimator::{GnssConfig, GnssReading};
use geometry::Pose;
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// Positions that are off: reflections.
#[derive(Clone, Debug, PartialEq)]
pub struct GnssJump {
    /// When, seconds after the first reading.
    pub span_s: Range<f64>,
    /// By how much, metres in the world's frame (z up).
    pub offset_m: [f64; 3],
}

/// GNSS of all runs, for variants whose settings have an antenna.
#[derive(Clone, Debug, PartialEq)]
pub struct GnssOptions {
    /// The antenna; the errors of readings have the correlation time that it states.
    pub antenna: GnssConfig,
    /// Readings a second.
    pub rate_hz: f64,
    /// Standard deviation east, north and up, metres; stated with each reading.
    pub sigma_m: [f64; 3],
    /// Reflections.
    pub jumps: Vec<GnssJump>,
    /// Stretches without readings, seconds after the first one.
    pub outages_s: Vec<Range<f64>>,
}

impl GnssOptions {
    /// One reading a second of a receiver with a standard deviation of 0.5 m, 1 m up.
    pub fn new(antenna: GnssConfig) -> Self {
        Self { antenna, rate_hz: 1.0, sigma_m: [0.5, 0.5, 1.0], jumps: Vec::new(), outages_s: Vec::new() }
    }

    /// The readings of a run.
    ///
    /// # Arguments
    /// * `global_from_world`: the frame of the positions.
    pub(crate) fn record(&self, seed: u64, motion: &Spline, global_from_world: &Pose) -> Vec<GnssReading> {
        let mut rng = stream(seed, 1, Purpose::Gnss);
        let (dt, sigma) = (1.0 / self.rate_hz, Vector3::from(self.sigma_m));
        let correlation = (-dt / self.antenna.correlation_time_s).exp();
        let rotation = global_from_world.rotation.to_rotation_matrix().into_inner();
        let variance = Matrix3::from_diagonal(&sigma.component_mul(&sigma));
        let covariance = rotation * variance * rotation.transpose();
        let count = ((motion.end_ns() - motion.start_ns()) as f64 * 1e-9 * self.rate_hz) as i64;
        let mut error = normal3(&mut rng);
        let mut readings = Vec::new();
        // Off the times of the images.
        let first_s = 0.013;
        for index in 0..count {
            let seconds = index as f64 * dt;
            let imu_ns = motion.start_ns() + ((first_s + seconds) * 1e9).round() as i64;
            let antenna = motion.at(imu_ns).pose.transform(&self.antenna.antenna_position_m.into());
            let off: Vector3<f64> = self
                .jumps
                .iter()
                .filter(|jump| jump.span_s.contains(&seconds))
                .map(|jump| Vector3::from(jump.offset_m))
                .sum();
            let position = global_from_world.transform(&(antenna + error.component_mul(&sigma) + off));
            let stamp_ns = imu_ns - (self.antenna.time_offset_s * 1e9).round() as i64;
            if !self.outages_s.iter().any(|outage| outage.contains(&seconds)) {
                readings.push(GnssReading { stamp_ns, position, covariance });
            }
            error = error * correlation + normal3(&mut rng) * (1.0 - correlation * correlation).sqrt();
        }
        readings
    }
}
