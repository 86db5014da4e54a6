//! White noise of the IMU as its readings show it, in motion as at rest.
//!
//! High differences of readings cancel what is smooth, the motion and the biases, and leave the noise. One reading after the
//! other shows it near half the sampling rate only, where the vibration of a motor may be that does not matter: it averages
//! out between two images. So differences of the means of one, two and four readings are taken. White noise has the same
//! density in all of them; vibration of some frequency, and motion that is faster than the means, raise a part of them. The
//! least of the three densities is therefore what the noise is at least.

use nalgebra::SVector;
use types::ImuSample;

/// Numbers of readings that are averaged.
const MEANS: [usize; 3] = [1, 2, 4];
/// Weights of the fourth difference.
const WEIGHTS: [f64; 5] = [1.0, -4.0, 6.0, -4.0, 1.0];
/// Sum of their squares: the variance of the difference of white noise, in units of its own.
const SUM_OF_SQUARES: f64 = 70.0;
/// Time over which variances are averaged, seconds.
const TIME_CONSTANT_S: f64 = 5.0;
/// Readings further apart than so many mean intervals have a gap between them.
const GAP_INTERVALS: f64 = 2.5;
/// Largest squared difference that counts, in units of its mean: one reading is no noise.
const MAX_RATIO: f64 = 16.0;
/// Number of differences of each mean before the noise is known.
const ENOUGH: f64 = 50.0;

/// Gyroscope, then accelerometer: six axes.
type Axes = SVector<f64, 6>;

/// White noise densities of both sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShownNoise {
    /// rad/s/sqrt(Hz).
    pub gyroscope: f64,
    /// m/s^2/sqrt(Hz).
    pub accelerometer: f64,
}

/// The noise of the readings of one IMU.
#[derive(Clone, Debug)]
pub struct ReadingNoise {
    newest_ns: Option<i64>,
    /// Mean time between two readings, seconds.
    interval_s: f64,
    scales: [Scale; 3],
}

impl Default for ReadingNoise {
    fn default() -> Self {
        Self { newest_ns: None, interval_s: 0.0, scales: MEANS.map(Scale::new) }
    }
}

impl ReadingNoise {
    /// Takes the next reading.
    pub fn add(&mut self, reading: &ImuSample) {
        let Some(newest_ns) = self.newest_ns.replace(reading.stamp_ns) else { return };
        let dt = (reading.stamp_ns - newest_ns) as f64 * 1e-9;
        if self.interval_s == 0.0 {
            self.interval_s = dt;
        }
        if dt > GAP_INTERVALS * self.interval_s {
            self.scales.iter_mut().for_each(Scale::restart);
        }
        self.interval_s += (dt - self.interval_s) * (dt / TIME_CONSTANT_S).min(0.1);
        let mut axes = Axes::zeros();
        axes.fixed_rows_mut::<3>(0).copy_from(&reading.gyroscope);
        axes.fixed_rows_mut::<3>(3).copy_from(&reading.accelerometer);
        for scale in &mut self.scales {
            scale.add(&axes, self.interval_s);
        }
    }

    /// What the readings show; zero before there are enough.
    pub fn shown(&self) -> ShownNoise {
        let least = |sensor: usize| {
            let densities = self.scales.iter().map(|scale| scale.density_squared(sensor, self.interval_s));
            densities.fold(f64::INFINITY, f64::min).sqrt()
        };
        ShownNoise { gyroscope: least(0), accelerometer: least(1) }
    }
}

/// Differences of the means of some readings.
#[derive(Clone, Debug)]
struct Scale {
    count: usize,
    sum: Axes,
    summed: usize,
    /// The newest means, oldest first.
    means: [Axes; WEIGHTS.len()],
    filled: usize,
    /// Variance of a mean, of the gyroscope and the accelerometer.
    variances: [f64; 2],
    samples: f64,
}

impl Scale {
    fn new(count: usize) -> Self {
        Self {
            count,
            sum: Axes::zeros(),
            summed: 0,
            means: [Axes::zeros(); WEIGHTS.len()],
            filled: 0,
            variances: [0.0; 2],
            samples: 0.0,
        }
    }

    /// Nothing before a gap is compared with what comes after it.
    fn restart(&mut self) {
        (self.sum, self.summed, self.filled) = (Axes::zeros(), 0, 0);
    }

    fn add(&mut self, axes: &Axes, interval_s: f64) {
        self.sum += axes;
        self.summed += 1;
        if self.summed < self.count {
            return;
        }
        self.means.rotate_left(1);
        self.means[WEIGHTS.len() - 1] = self.sum / self.count as f64;
        (self.sum, self.summed) = (Axes::zeros(), 0);
        self.filled = (self.filled + 1).min(WEIGHTS.len());
        if self.filled < WEIGHTS.len() {
            return;
        }
        let difference: Axes = self.means.iter().zip(WEIGHTS).map(|(mean, weight)| mean * weight).sum();
        self.samples += 1.0;
        let gain = (interval_s * self.count as f64 / TIME_CONSTANT_S).max(1.0 / self.samples).min(1.0);
        for (sensor, variance) in self.variances.iter_mut().enumerate() {
            let seen = difference.fixed_rows::<3>(3 * sensor).norm_squared() / (3.0 * SUM_OF_SQUARES);
            let most = if self.samples < ENOUGH { f64::INFINITY } else { MAX_RATIO * *variance };
            *variance += gain * (seen.min(most) - *variance);
        }
    }

    fn density_squared(&self, sensor: usize, interval_s: f64) -> f64 {
        if self.samples < ENOUGH { 0.0 } else { self.variances[sensor] * self.count as f64 * interval_s }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imu::plausibility::ReadingCheck;
    use nalgebra::Vector3;
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};
    use rand_distr::StandardNormal;

    const INTERVAL_NS: i64 = 5_000_000;
    const DENSITIES: [f64; 2] = [7e-4, 8e-3];

    /// Readings of a hand-held body for some seconds, with white noise of [`DENSITIES`] and a vibration of the accelerometer.
    fn readings(seconds: f64, vibration: f64, hertz: f64) -> Vec<ImuSample> {
        let mut rng = StdRng::seed_from_u64(3);
        let mut normal = |density: f64| {
            Vector3::from_fn(|_, _| density * 200.0_f64.sqrt() * rng.sample::<f64, _>(StandardNormal))
        };
        (0..(seconds * 200.0) as i64)
            .map(|k| {
                let phase = k as f64 * 0.005 * std::f64::consts::TAU;
                let motion = Vector3::new((2.0 * phase).sin(), (1.3 * phase).cos(), 0.3);
                ImuSample {
                    stamp_ns: k * INTERVAL_NS,
                    gyroscope: 1.5 * motion + normal(DENSITIES[0]),
                    accelerometer: 5.0 * motion
                        + Vector3::repeat(vibration * (hertz * phase).sin())
                        + normal(DENSITIES[1]),
                }
            })
            .collect()
    }

    fn shown<'a>(readings: impl IntoIterator<Item = &'a ImuSample>) -> [f64; 2] {
        let mut noise = ReadingNoise::default();
        // As the filter does: what no motion explains does not come here.
        let mut check = ReadingCheck::default();
        let usable = readings.into_iter().filter(|reading| check.check(reading).is_ok());
        usable.for_each(|reading| noise.add(reading));
        let ShownNoise { gyroscope, accelerometer } = noise.shown();
        [gyroscope / DENSITIES[0], accelerometer / DENSITIES[1]]
    }

    #[test]
    fn white_noise_is_shown_in_motion_also_beside_a_vibration() {
        for (vibration, hertz) in [(0.0, 0.0), (1.0, 97.0), (0.5, 60.0)] {
            for (sensor, ratio) in shown(&readings(20.0, vibration, hertz)).into_iter().enumerate() {
                // The least of three estimates is a little low; a vibration raises what it is near.
                let most = if sensor == 1 && vibration > 0.0 { 1.8 } else { 1.1 };
                assert!((0.85..most).contains(&ratio), "{ratio} of sensor {sensor} at {hertz} Hz");
            }
        }
    }

    #[test]
    fn a_wrong_reading_and_a_gap_are_no_noise_and_a_second_shows_nothing() {
        let mut broken = readings(20.0, 0.0, 0.0);
        broken[3950].gyroscope.x = 35.0;
        broken.drain(1000..1200);
        for reading in &mut broken[20..30] {
            (reading.gyroscope.y, reading.accelerometer.z) = (1e300, -1e300);
        }
        for ratio in shown(&broken) {
            assert!((0.85..1.6).contains(&ratio), "{ratio}");
        }
        assert!(shown(&readings(1.0, 0.0, 0.0)).iter().all(|&noise| noise.abs() < 1e-300));
    }

    #[test]
    fn more_noise_is_shown_after_seconds() {
        let mut louder = readings(30.0, 0.0, 0.0);
        let mut rng = StdRng::seed_from_u64(4);
        for reading in &mut louder[3000..] {
            let density = 3.0 * DENSITIES[0] * 200.0_f64.sqrt();
            reading.gyroscope += Vector3::from_fn(|_, _| density * rng.sample::<f64, _>(StandardNormal));
        }
        let [gyroscope, accelerometer] = shown(&louder);
        assert!((2.6..3.5).contains(&gyroscope) && accelerometer < 1.1, "{gyroscope} {accelerometer}");
    }
}
