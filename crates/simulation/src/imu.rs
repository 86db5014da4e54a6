//! IMU readings along a trajectory: exact values, white noise, and biases that walk.

use super::random::Purpose;
use super::random::{normal3, stream};
use super::spline::Spline;
use super::{GRAVITY, SimulationOptions};
use nalgebra::Vector3;
use sensors::ImuSample;

/// Standard deviation of the gyroscope's initial bias, rad/s.
const FIRST_GYROSCOPE_BIAS: f64 = 0.002;
/// Standard deviation of the accelerometer's initial bias, m/s^2.
const FIRST_ACCELEROMETER_BIAS: f64 = 0.01;

/// Samples, and the true biases at each of them.
pub(crate) struct ImuRecord {
    pub(crate) samples: Vec<ImuSample>,
    pub(crate) gyroscope_biases: Vec<Vector3<f64>>,
    pub(crate) accelerometer_biases: Vec<Vector3<f64>>,
}

/// Records the whole motion.
///
/// White noise of density `n` (unit/sqrt(Hz)) is `n * sqrt(rate)` a sample; a bias of density `w` walks by
/// `w / sqrt(rate)` from sample to sample.
pub(crate) fn record(options: &SimulationOptions, motion: &Spline, run: u64) -> ImuRecord {
    let mut rng = stream(options.seed, run, Purpose::Imu);
    let noise = options.imu_noise.inflated(options.imu_noise_scale);
    let root_rate = options.imu_rate_hz.sqrt();
    let gravity = -Vector3::z() * GRAVITY;
    let mut record =
        ImuRecord { samples: Vec::new(), gyroscope_biases: Vec::new(), accelerometer_biases: Vec::new() };
    let noise_gain = if options.noise_free_imu { 0.0 } else { 1.0 };
    let mut gyroscope_bias = normal3(&mut rng) * (noise_gain * FIRST_GYROSCOPE_BIAS);
    let mut accelerometer_bias = normal3(&mut rng) * (noise_gain * FIRST_ACCELEROMETER_BIAS);
    let stamps = (0_i64..)
        .map(|index| motion.start_ns() + (index as f64 * 1e9 / options.imu_rate_hz).round() as i64)
        .take_while(|stamp_ns| *stamp_ns <= motion.end_ns());
    for stamp_ns in stamps {
        let now = motion.at(stamp_ns);
        let specific_force = now.pose.rotation.inverse() * (now.acceleration - gravity);
        let white = (normal3(&mut rng), normal3(&mut rng));
        record.samples.push(ImuSample {
            stamp_ns,
            gyroscope: now.angular_velocity
                + gyroscope_bias
                + white.0 * (noise_gain * noise.gyroscope * root_rate),
            accelerometer: specific_force
                + accelerometer_bias
                + white.1 * (noise_gain * noise.accelerometer * root_rate),
        });
        record.gyroscope_biases.push(gyroscope_bias);
        record.accelerometer_biases.push(accelerometer_bias);
        gyroscope_bias += normal3(&mut rng) * (noise_gain * noise.gyroscope_walk / root_rate);
        accelerometer_bias += normal3(&mut rng) * (noise_gain * noise.accelerometer_walk / root_rate);
    }
    record
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scenario;
    use crate::path::{Style, built_in};
    use geometry::rotation;

    #[test]
    fn exact_measurements_integrate_to_the_motion() {
        let motion = built_in(Scenario::Block, 0, 4.0, &Style::of_run(1, 1)).unwrap();
        let options = SimulationOptions { noise_free_imu: true, ..SimulationOptions::default() };
        let samples = record(&options, &motion, 1).samples;
        let start = motion.at(0);
        let (mut turned, mut position, mut velocity) =
            (start.pose.rotation, start.pose.translation, start.velocity);
        for pair in samples.windows(2) {
            let dt = (pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9;
            let next = turned * rotation::exp(&((pair[0].gyroscope + pair[1].gyroscope) * (0.5 * dt)));
            let acceleration = (turned * pair[0].accelerometer + next * pair[1].accelerometer) * 0.5
                - Vector3::z() * GRAVITY;
            position += velocity * dt + acceleration * (0.5 * dt * dt);
            velocity += acceleration * dt;
            turned = next;
        }
        let end = motion.at(samples[samples.len() - 1].stamp_ns);
        assert!(end.pose.rotation.angle_to(&turned) < 1e-4);
        assert!((end.pose.translation - position).norm() < 0.1, "{}", end.pose.translation - position);
    }

    #[test]
    fn noise_has_the_stated_density_and_biases_walk() {
        let motion = built_in(Scenario::Block, 0, 4.0, &Style::of_run(1, 0)).unwrap();
        let options = SimulationOptions::default();
        let noisy = record(&options, &motion, 0);
        let exact = record(&SimulationOptions { noise_free_imu: true, ..options.clone() }, &motion, 0);
        let count = noisy.samples.len() as f64;
        let (mut gyroscope, mut walk) = (0.0, 0.0);
        for (index, (a, b)) in noisy.samples.iter().zip(&exact.samples).enumerate() {
            gyroscope += (a.gyroscope - b.gyroscope - noisy.gyroscope_biases[index]).norm_squared() / 3.0;
            if index > 0 {
                let step = noisy.accelerometer_biases[index] - noisy.accelerometer_biases[index - 1];
                walk += step.norm_squared() / 3.0;
            }
        }
        let density = (gyroscope / count / options.imu_rate_hz).sqrt();
        assert!((density / options.imu_noise.gyroscope - 1.0).abs() < 0.05, "{density}");
        let walk_density = (walk / count * options.imu_rate_hz).sqrt();
        assert!((walk_density / options.imu_noise.accelerometer_walk - 1.0).abs() < 0.05, "{walk_density}");
    }
}
