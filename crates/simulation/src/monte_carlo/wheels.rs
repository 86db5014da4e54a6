//! Readings of the wheels of a run: those of a true calibration that differs from the stated one by a sample of its standard
//! deviations, with the noise that is stated, and with slip.

use crate::random::{Purpose, normal, normal3, stream};
use crate::spline::Spline;
use estimator::wheels::kinematics::ways_of_wheels;
use estimator::{BaseKind, WheelConfig, WheelReading};
use geometry::{Pose, rotation};
use nalgebra::Vector3;
use rand::rngs::StdRng;
use sensors::{Encoder, EncoderCounts, MAX_WHEELS};

/// Below this speed the steering of a car stays where it is, m/s.
const STEERED_M_S: f64 = 0.02;

/// Wheels that slip, or report nonsense.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// When it begins, seconds after the first reading.
    pub from_s: f64,
    /// When it ends.
    pub to_s: f64,
    /// Factors on the numbers of the readings.
    pub factors: [f64; MAX_WHEELS],
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
    /// Encoders: the readings are what they count.
    pub encoder: Option<Encoder>,
}

impl WheelOptions {
    /// 50 readings a second without slip.
    pub fn new(stated: WheelConfig) -> Self {
        Self { stated, rate_hz: 50.0, slips: Vec::new(), encoder: None }
    }

    /// The true calibration of a run. `initial` and `noise` are those of the stated one.
    pub fn truth(&self, seed: u64) -> WheelConfig {
        let mut rng = stream(seed, 1, Purpose::Wheels);
        let (mut truth, initial) = (self.stated, self.stated.initial);
        let sigmas = self.stated.parameter_sigmas().into_iter();
        let steps: Vec<f64> = sigmas.map(|sigma| sigma * normal(&mut rng)).collect();
        truth.base.add(&steps);
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
        let mut wheels = TrueWheels { truth, rng: stream(seed, 2, Purpose::Wheels), steering_rad: 0.0 };
        let dt = 1.0 / self.rate_hz;
        let offset_ns = (truth.time_offset_s * 1e9).round() as i64;
        let count = ((motion.end_ns() - motion.start_ns()) as f64 * 1e-9 * self.rate_hz) as i64;
        let imu_ns = |seconds: f64| motion.start_ns() + (seconds * 1e9).round() as i64;
        let Some(encoder) = self.encoder else {
            let reading = |index: i64| {
                let seconds = index as f64 * dt;
                let values = wheels.values(self, motion, seconds);
                WheelReading { stamp_ns: imu_ns(seconds) - offset_ns, values }
            };
            return (0..count).map(reading).collect();
        };
        // Encoders have no noise but their steps.
        wheels.truth.noise.sigma_speed_rad_s = 0.0;
        let kind = truth.base.kind();
        let (mut counts, mut angles) = (EncoderCounts::new(encoder, kind.wheels()), [0.0; MAX_WHEELS]);
        let per_rad = encoder.counts_per_revolution() / std::f64::consts::TAU;
        let mut counted = |index: i64| {
            let values = wheels.values(self, motion, (index as f64 + 0.5) * dt);
            for (wheel, (angle, value)) in angles.iter_mut().zip(values).enumerate() {
                *angle = if wheel < kind.wheels() { *angle + value * dt } else { value };
            }
            let count = |wheel: usize| {
                let angle = angles[wheel];
                if wheel < kind.wheels() { (angle * per_rad).floor() } else { angle }
            };
            let row: [f64; MAX_WHEELS] = std::array::from_fn(count);
            counts.reading(imu_ns((index + 1) as f64 * dt) - offset_ns, &row)
        };
        (0..count).filter_map(&mut counted).collect()
    }

    /// Factors on the readings at a time.
    fn factors(&self, seconds: f64) -> [f64; MAX_WHEELS] {
        let slip = self.slips.iter().find(|slip| (slip.from_s..slip.to_s).contains(&seconds));
        slip.map_or([1.0; MAX_WHEELS], |slip| slip.factors)
    }
}

/// Wheels that roll.
struct TrueWheels {
    truth: WheelConfig,
    rng: StdRng,
    /// Of a car, without the offset.
    steering_rad: f64,
}

impl TrueWheels {
    /// The numbers of a reading.
    fn values(&mut self, options: &WheelOptions, motion: &Spline, seconds: f64) -> [f64; MAX_WHEELS] {
        let imu_from_base: Pose = self.truth.imu_from_base();
        let now = motion.at(motion.start_ns() + (seconds * 1e9).round() as i64);
        let in_imu = now.pose.rotation.inverse() * now.velocity
            + now.angular_velocity.cross(&imu_from_base.translation);
        let to_base = imu_from_base.rotation.inverse();
        let (moved, turned) = (to_base * in_imu, to_base * now.angular_velocity);
        let motion_of_base = Vector3::new(turned.z, moved.x, moved.y);
        let (base, factors) = (self.truth.base, options.factors(seconds));
        let ways = ways_of_wheels(&base, &motion_of_base);
        let (noise, dt) = (self.truth.noise, 1.0 / options.rate_hz);
        let mut values = [0.0; MAX_WHEELS];
        for wheel in 0..base.kind().wheels() {
            let rolled = ways[wheel];
            let rolling = self.rolling(rolled, dt);
            values[wheel] = (rolled + rolling) * factors[wheel] / base.radius_m(wheel)
                + noise.sigma_speed_rad_s * normal(&mut self.rng);
        }
        if base.kind() == BaseKind::Ackermann {
            let to_side = ways[1] + self.rolling(ways[0], dt);
            if ways[0].abs() > STEERED_M_S {
                self.steering_rad = (to_side / ways[0]).atan();
            }
            let offset_rad = base.parameters()[2];
            let read = self.steering_rad - offset_rad + noise.sigma_steering_rad * normal(&mut self.rng);
            values[1] = read * factors[1];
        }
        values
    }

    /// Noise of the speed of a wheel that rolls, m/s.
    fn rolling(&mut self, rolled: f64, dt: f64) -> f64 {
        self.truth.noise.sigma_rolling_m_sqrt_m * (rolled.abs() / dt).sqrt() * normal(&mut self.rng)
    }
}
