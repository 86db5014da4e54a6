//! Units of an IMU recognized from its readings: accelerometers in g or of another scale, gravity removed, gyroscopes in deg/s.
//!
//! Over half a second the specific force of a robot is gravity and little else, whatever the orientation, so its mean length
//! tells the unit. Between two such means a body-fixed direction moves by `du = -w x u dt`: where the gyroscope claims
//! many turns and the direction of gravity stays, the rates are too large. A drone hides its tilt from the accelerometer
//! (thrust is along a fixed axis), so that alone is no proof: the claimed rates must be ones that no robot keeps up.
//!
//! The newest ten seconds are looked at, as long as readings come. What they cannot tell: at rest a gyroscope reads its bias
//! whatever its unit, so rates in deg/s with a bias below 3 deg/s are recognized only once the robot has turned about a horizontal axis for half of
//! ten seconds; a robot on wheels, which turns about gravity only, is never told apart by its IMU alone.

use super::ImuSample;
use nalgebra::Vector3;
use std::collections::VecDeque;

/// Standard gravity, m/s^2.
pub(crate) const STANDARD_GRAVITY: f64 = 9.806_65;
/// Readings are averaged over this time, nanoseconds.
const PERIOD_NS: i64 = 500_000_000;
/// Periods that are looked at: the newest ten seconds.
const PERIODS: usize = 20;
/// Fewer periods say nothing.
const MIN_PERIODS: usize = 4;
/// A specific force of this part of gravity is in g: 1/9.81 is 0.102.
const G_UNITS: std::ops::Range<f64> = 0.085..0.12;
/// A mean specific force below this part of gravity has no gravity in it.
const NO_GRAVITY: f64 = 0.06;
/// A steady specific force of more than so many times gravity is none of a robot.
const TOO_LARGE: f64 = 1.7;
/// A gyroscope that reads this part of gravity, turning one way, beside an accelerometer that reads less than that one, is one.
const LIKE_GRAVITY: std::ops::Range<f64> = 0.85..1.15;
const NOT_GRAVITY: f64 = 0.5;
/// Median rate from which on gravity must be seen to turn, rad/s: 170 deg/s, half of the time.
const FAST_RATE: f64 = 3.0;
/// Part of the claimed rotation that the direction of gravity follows at least; deg/s leave 1/57.
const MIN_FOLLOWED: f64 = 0.2;
/// Fewest claimed turns of the direction of gravity (sum of squares, rad^2) from which the part is computed.
const MIN_CLAIMED: f64 = 10.0;

/// What is wrong with the readings of an IMU, and what to do.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ImuUnitError {
    /// The accelerometer's unit is g.
    #[error(
        "the accelerometer reads {mean:.2} where gravity is {gravity:.2} m/s^2: it is in g; say so with --accelerometer-unit g"
    )]
    AccelerationInG {
        /// Mean specific force, as read.
        mean: f64,
        /// Gravity that was expected, m/s^2.
        gravity: f64,
    },
    /// Gravity is subtracted from the accelerometer.
    #[error(
        "the accelerometer reads {mean:.2} m/s^2 on average where gravity is {gravity:.2} m/s^2: gravity was subtracted; \
         record the raw specific force (not \"linear acceleration\")"
    )]
    WithoutGravity {
        /// Mean specific force, m/s^2.
        mean: f64,
        /// Gravity that was expected, m/s^2.
        gravity: f64,
    },
    /// The accelerometer reads several times gravity.
    #[error(
        "the accelerometer reads {mean:.2} on average where gravity is {gravity:.2} m/s^2: its unit or its scale is another one \
         (32 would be ft/s^2, 1000 thousandths of g, 9807 mm/s^2, 96 m/s^2 that are taken for g); write m/s^2"
    )]
    TooLarge {
        /// Mean specific force, as read.
        mean: f64,
        /// Gravity that was expected, m/s^2.
        gravity: f64,
    },
    /// The gyroscope reads gravity.
    #[error(
        "the gyroscope reads {rate:.2} on average, which is gravity, and the accelerometer {mean:.2}: they are exchanged; write \
         the angular velocity first, then the specific force"
    )]
    Exchanged {
        /// Mean length of what should be angular velocities.
        rate: f64,
        /// Mean length of what should be specific forces.
        mean: f64,
    },
    /// The gyroscope's unit is deg/s.
    #[error(
        "the gyroscope reads {rate:.1} half of the time, but the direction of gravity follows only {followed:.0} % of that \
         rotation: the rates are in deg/s; say so with --gyroscope-unit deg/s"
    )]
    RatesInDegrees {
        /// Median rate, as read.
        rate: f64,
        /// Part of the claimed rotation that the specific force follows, percent.
        followed: f64,
    },
}

/// Looks at the readings of a recording or a robot; give them in order of time.
///
/// # Example
/// ```
/// use nalgebra::Vector3;
/// use sensors::{ImuCheck, ImuSample, ImuUnitError};
///
/// let mut check = ImuCheck::new(None);
/// let in_g = |k: i64| ImuSample {
///     stamp_ns: k * 5_000_000,
///     gyroscope: Vector3::zeros(),
///     accelerometer: Vector3::new(0.0, 0.0, 1.0),
/// };
/// let found = (0..3000).find_map(|k| check.add(&in_g(k)).err());
/// assert!(matches!(found, Some(ImuUnitError::AccelerationInG { .. })));
/// ```
#[derive(Debug)]
pub struct ImuCheck {
    /// m/s^2.
    gravity: f64,
    periods: VecDeque<Period>,
    current: Option<Sum>,
}

/// Means over one period.
#[derive(Clone, Copy, Debug)]
struct Period {
    specific_force: Vector3<f64>,
    rate: Vector3<f64>,
    /// Mean of the lengths of the rates.
    speed: f64,
}

#[derive(Debug)]
struct Sum {
    begin_ns: i64,
    count: f64,
    specific_force: Vector3<f64>,
    rate: Vector3<f64>,
    speed: f64,
}

impl ImuCheck {
    /// A check without readings.
    ///
    /// # Arguments
    /// * `gravity`: as the calibration states it, m/s^2; standard gravity where it does not.
    pub fn new(gravity: Option<f64>) -> Self {
        let periods = VecDeque::with_capacity(PERIODS);
        Self { gravity: gravity.unwrap_or(STANDARD_GRAVITY), periods, current: None }
    }

    /// Adds a reading.
    ///
    /// # Errors
    /// [`ImuUnitError`]: the newest ten seconds are in another unit.
    pub fn add(&mut self, sample: &ImuSample) -> Result<(), ImuUnitError> {
        let is_complete = |sum: &Sum| sample.stamp_ns - sum.begin_ns >= PERIOD_NS;
        let complete = self.current.take_if(|sum| is_complete(sum));
        if let Some(sum) = &complete {
            if self.periods.len() == PERIODS {
                self.periods.pop_front();
            }
            self.periods.push_back(Period {
                specific_force: sum.specific_force / sum.count,
                rate: sum.rate / sum.count,
                speed: sum.speed / sum.count,
            });
        }
        let sum = self.current.get_or_insert(Sum {
            begin_ns: sample.stamp_ns,
            count: 0.0,
            specific_force: Vector3::zeros(),
            rate: Vector3::zeros(),
            speed: 0.0,
        });
        sum.count += 1.0;
        sum.specific_force += sample.accelerometer;
        sum.rate += sample.gyroscope;
        sum.speed += sample.gyroscope.norm();
        if complete.is_some() && self.periods.len() == PERIODS { self.finish() } else { Ok(()) }
    }

    /// Checks the newest readings of a recording that may be shorter than ten seconds.
    ///
    /// # Errors
    /// [`ImuUnitError`]; readings of less than two seconds pass.
    pub fn finish(&self) -> Result<(), ImuUnitError> {
        if self.periods.len() < MIN_PERIODS {
            return Ok(());
        }
        let gravity = self.gravity;
        let mean = median(self.periods.iter().map(|period| period.specific_force.norm()));
        let turn = median(self.periods.iter().map(|period| period.rate.norm()));
        let is_in_g = G_UNITS.contains(&(mean / gravity)) && self.is_steady();
        if LIKE_GRAVITY.contains(&(turn / gravity)) && mean < NOT_GRAVITY * gravity && !is_in_g {
            return Err(ImuUnitError::Exchanged { rate: turn, mean });
        }
        if is_in_g {
            return Err(ImuUnitError::AccelerationInG { mean, gravity });
        }
        if mean > TOO_LARGE * gravity && self.is_steady() {
            return Err(ImuUnitError::TooLarge { mean, gravity });
        }
        if mean < NO_GRAVITY * gravity {
            return Err(ImuUnitError::WithoutGravity { mean, gravity });
        }
        let rate = median(self.periods.iter().map(|period| period.speed));
        if let Some(followed) = self.followed().filter(|part| rate > FAST_RATE && *part < MIN_FOLLOWED) {
            return Err(ImuUnitError::RatesInDegrees { rate, followed: 100.0 * followed });
        }
        Ok(())
    }

    /// Whether most means have about the same length, as those that are gravity have.
    fn is_steady(&self) -> bool {
        let middle = median(self.periods.iter().map(|period| period.specific_force.norm()));
        let near = |period: &&Period| (period.specific_force.norm() / middle - 1.0).abs() < 0.2;
        2 * self.periods.iter().filter(near).count() > self.periods.len()
    }

    /// The part of the claimed rotation that the direction of the specific force follows, by least squares; `None`
    /// where the claimed rotation is about that direction, or small.
    fn followed(&self) -> Option<f64> {
        let (mut product, mut square) = (0.0, 0.0);
        for (a, b) in self.periods.iter().zip(self.periods.iter().skip(1)) {
            let directions = (a.specific_force.try_normalize(1e-9), b.specific_force.try_normalize(1e-9));
            let (Some(before), Some(after)) = directions else { continue };
            let rotation = (a.rate + b.rate) * (0.5e-9 * PERIOD_NS as f64);
            let claimed = -rotation.cross(&((before + after) * 0.5));
            product += claimed.dot(&(after - before));
            square += claimed.norm_squared();
        }
        (square > MIN_CLAIMED).then(|| (product / square).max(0.0))
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    geometry::median(&mut values.collect::<Vec<f64>>()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    /// A hand-held IMU that swings by `amplitude` (rad), for 20 s.
    fn swinging(amplitude: f64) -> Vec<ImuSample> {
        let rotation = |t: f64| {
            UnitQuaternion::from_scaled_axis(
                Vector3::new((1.1 * t).sin(), (0.8 * t).cos(), 0.4 * t) * amplitude,
            )
        };
        let step = 0.005;
        (0..4000)
            .map(|index| {
                let t = f64::from(index) * step;
                let here = rotation(t);
                let sway = Vector3::new((2.0 * t).sin(), (3.0 * t).cos(), (2.5 * t).sin());
                ImuSample {
                    stamp_ns: (t * 1e9) as i64,
                    gyroscope: (here.inverse() * rotation(t + step)).scaled_axis() / step
                        + Vector3::new(0.02, -0.07, 0.05),
                    accelerometer: here.inverse() * (Vector3::z() * 9.81 + sway),
                }
            })
            .collect()
    }

    fn check(samples: &[ImuSample]) -> Result<(), ImuUnitError> {
        let mut check = ImuCheck::new(None);
        samples.iter().try_for_each(|sample| check.add(sample))?;
        check.finish()
    }

    /// The readings in other units.
    fn scaled(samples: &[ImuSample], rate: f64, force: f64) -> Vec<ImuSample> {
        let scaled = |sample: &ImuSample| ImuSample {
            stamp_ns: sample.stamp_ns,
            gyroscope: sample.gyroscope * rate,
            accelerometer: sample.accelerometer * force,
        };
        samples.iter().map(scaled).collect()
    }

    #[test]
    fn readings_in_si_units_pass_from_rest_to_vigorous_motion() {
        for amplitude in [0.0, 0.1, 0.5, 1.5] {
            assert_eq!(check(&swinging(amplitude)), Ok(()), "{amplitude}");
        }
        assert_eq!(check(&swinging(0.5)[..100]), Ok(()));
    }

    #[test]
    fn a_drone_passes_whose_thrust_hides_its_tilt() {
        let mut samples = swinging(1.0);
        for sample in &mut samples {
            sample.accelerometer = Vector3::z() * 9.9;
        }
        assert_eq!(check(&samples), Ok(()));
    }

    #[test]
    fn other_units_are_recognized() {
        for amplitude in [0.0, 0.3, 1.0] {
            let g = check(&scaled(&swinging(amplitude), 1.0, 1.0 / STANDARD_GRAVITY));
            assert!(matches!(g, Err(ImuUnitError::AccelerationInG { .. })), "{g:?}");
        }
        for amplitude in [0.3, 1.0] {
            let degrees = check(&scaled(&swinging(amplitude), 1_f64.to_degrees(), 1.0));
            assert!(matches!(degrees, Err(ImuUnitError::RatesInDegrees { .. })), "{degrees:?}");
        }
    }

    #[test]
    fn both_sensors_in_other_units_are_not_taken_for_each_other() {
        // Ten deg/s: as much as gravity has in m/s^2.
        let mut samples = swinging(0.1);
        for sample in &mut samples {
            sample.gyroscope.z += 0.17;
        }
        let both = check(&scaled(&samples, 1_f64.to_degrees(), 1.0 / STANDARD_GRAVITY));
        assert!(matches!(both, Err(ImuUnitError::AccelerationInG { .. })), "{both:?}");
    }

    #[test]
    fn an_accelerometer_of_another_scale_is_named() {
        for amplitude in [0.0, 0.3, 1.0] {
            for factor in [2.0, 1.0 / 0.3048, 9.806_65, 1000.0 / 9.806_65, 1000.0] {
                let found = check(&scaled(&swinging(amplitude), 1.0, factor));
                assert!(
                    matches!(found, Err(ImuUnitError::TooLarge { .. })),
                    "{amplitude}, {factor}: {found:?}"
                );
            }
        }
    }

    #[test]
    fn a_gyroscope_that_reads_gravity_is_an_accelerometer() {
        for amplitude in [0.0, 0.3, 1.0] {
            let exchanged: Vec<ImuSample> = swinging(amplitude)
                .into_iter()
                .map(|sample| ImuSample {
                    gyroscope: sample.accelerometer,
                    accelerometer: sample.gyroscope,
                    ..sample
                })
                .collect();
            let found = check(&exchanged);
            assert!(matches!(found, Err(ImuUnitError::Exchanged { .. })), "{amplitude}: {found:?}");
        }
    }

    #[test]
    fn rates_in_degrees_are_recognized_once_a_robot_at_rest_begins_to_move() {
        let at_rest = ImuSample {
            stamp_ns: 0,
            gyroscope: Vector3::new(0.002, -0.007, 0.005),
            accelerometer: Vector3::z() * 9.81,
        };
        // Two minutes at rest, then in motion.
        let rest_ns = 120_000_000_000;
        let rest = (0..rest_ns / 5_000_000).map(|k| ImuSample { stamp_ns: k * 5_000_000, ..at_rest });
        let moving = swinging(0.3)
            .into_iter()
            .map(|sample| ImuSample { stamp_ns: sample.stamp_ns + rest_ns, ..sample });
        let samples = scaled(&rest.chain(moving).collect::<Vec<_>>(), 1_f64.to_degrees(), 1.0);
        let mut check = ImuCheck::new(None);
        let found =
            samples.iter().find_map(|sample| check.add(sample).err().map(|error| (sample.stamp_ns, error)));
        let (stamp_ns, error) = found.unwrap();
        assert!(matches!(error, ImuUnitError::RatesInDegrees { .. }), "{error}");
        assert!((rest_ns..rest_ns + 11_000_000_000).contains(&stamp_ns), "{stamp_ns}");
    }

    #[test]
    fn at_rest_and_about_gravity_the_unit_of_the_rates_cannot_be_known() {
        for speed in [0.0, 40.0] {
            let about_gravity = |k: i64| ImuSample {
                stamp_ns: k * 5_000_000,
                gyroscope: Vector3::new(0.002, -0.007, 0.005 + speed),
                accelerometer: Vector3::z() * 9.81,
            };
            assert_eq!(check(&(0..4000).map(about_gravity).collect::<Vec<_>>()), Ok(()));
        }
    }

    #[test]
    fn subtracted_gravity_is_recognized() {
        let mut samples = swinging(0.3);
        for (index, sample) in samples.iter_mut().enumerate() {
            let t = index as f64 * 0.005;
            sample.accelerometer = Vector3::new((9.0 * t).sin(), (8.0 * t).cos(), (7.0 * t).sin()) * 0.5;
        }
        let error = check(&samples).unwrap_err();
        assert!(matches!(error, ImuUnitError::WithoutGravity { .. }), "{error}");
    }
}
