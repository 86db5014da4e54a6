//! Readings of the wheels of a run: those of a true calibration that differs from the stated one by a sample of its standard
//! deviations, with the noise that is stated, and with slip.

use crate::random::{Purpose, normal, normal3, stream};
use crate::spline::Spline;
use estimator::{WheelConfig, WheelReading};
use geometry::{Pose, rotation};
use nalgebra::Vector3;

/// Wheels that slip, or report nonsense.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// When it begins, seconds after the first reading.
    pub from_s: f64,
    /// When it ends.
    pub to_s: f64,
    /// Factors on the speeds of the left and the right wheel.
    pub factors: [f64; 2],
}

/// The wheels of all runs, for variants whose settings have some.
#[derive(Clone, Debug, PartialEq)]
pub struct WheelOptions {
    /// As the filter is told; the truth is drawn around it.
    pub stated: WheelConfig,
    /// Readings a second.
    pub rate_hz: f64,
    /// Slip, and nonsense.
    pub slips: Vec<Slip>,
}

impl WheelOptions {
    /// 50 readings a second without slip.
    pub fn new(stated: WheelConfig) -> Self {
        Self { stated, rate_hz: 50.0, slips: Vec::new() }
    }

    /// The true calibration of a run. `initial` and `noise` are those of the stated one.
    pub fn truth(&self, seed: u64) -> WheelConfig {
        let mut rng = stream(seed, 1, Purpose::Wheels);
        let (mut truth, initial) = (self.stated, self.stated.initial);
        truth.radius_left_m *= 1.0 + initial.sigma_radius_fraction * normal(&mut rng);
        truth.radius_right_m *= 1.0 + initial.sigma_radius_fraction * normal(&mut rng);
        truth.track_m *= 1.0 + initial.sigma_track_fraction * normal(&mut rng);
        truth.time_offset_s += initial.sigma_time_offset_s * normal(&mut rng);
        let turn = normal3(&mut rng) * initial.sigma_rotation_rad;
        let turned = rotation::exp(&turn) * self.stated.imu_from_base().rotation;
        truth.base_rotation_rad = rotation::log(&turned).into();
        let shift = normal3(&mut rng) * initial.sigma_position_m;
        truth.base_position_m = (Vector3::from(self.stated.base_position_m) + shift).into();
        truth
    }

    /// The readings of a run.
    pub(crate) fn record(&self, seed: u64, motion: &Spline) -> Vec<WheelReading> {
        let truth = self.truth(seed);
        let mut rng = stream(seed, 2, Purpose::Wheels);
        let imu_from_base: Pose = truth.imu_from_base();
        let (noise, dt) = (truth.noise, 1.0 / self.rate_hz);
        let offset_ns = (truth.time_offset_s * 1e9).round() as i64;
        let count = ((motion.end_ns() - motion.start_ns()) as f64 * 1e-9 * self.rate_hz) as i64;
        let reading = |index: i64| {
            let seconds = index as f64 * dt;
            let imu_ns = motion.start_ns() + (seconds * 1e9).round() as i64;
            let now = motion.at(imu_ns);
            let in_imu = now.pose.rotation.inverse() * now.velocity
                + now.angular_velocity.cross(&imu_from_base.translation);
            let to_base = imu_from_base.rotation.inverse();
            let (forward, turn) = ((to_base * in_imu).x, (to_base * now.angular_velocity).z);
            let factors = self
                .slips
                .iter()
                .find(|slip| (slip.from_s..slip.to_s).contains(&seconds))
                .map_or([1.0, 1.0], |slip| slip.factors);
            let mut speed = |radius: f64, side: f64, factor: f64| {
                let rolled = forward + side * turn * truth.track_m / 2.0;
                let rolling = noise.sigma_rolling_m_sqrt_m * (rolled.abs() / dt).sqrt() * normal(&mut rng);
                (rolled + rolling) * factor / radius + noise.sigma_speed_rad_s * normal(&mut rng)
            };
            let left = speed(truth.radius_left_m, -1.0, factors[0]);
            let right = speed(truth.radius_right_m, 1.0, factors[1]);
            WheelReading { stamp_ns: imu_ns - offset_ns, left, right }
        };
        (0..count).map(reading).collect()
    }
}
