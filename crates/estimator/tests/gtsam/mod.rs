//! Preintegrated IMU factors beside those of GTSAM 4.3, which `make.py` wrote.

use estimator::ImuNoise;
use estimator::preintegration::PreintegratedImu;
use estimator::propagation::ImuState;
use estimator::{EstimatorConfig, ImuSample};
use geometry::{Pose, Rotation};
use nalgebra::{Quaternion, Vector3};
use serde::Deserialize;

/// Rate of the readings; GTSAM integrated at a higher one.
const RATE_HZ: f64 = 2000.0;

#[derive(Deserialize)]
struct Goldens {
    gravity: f64,
    noise: ImuNoise,
    factors: Vec<Factor>,
}

#[derive(Deserialize)]
struct Factor {
    seconds: f64,
    integrated_at: Biases,
    begin: State,
    /// By the factor, at the biases of the begin.
    predicted: State,
    /// Away from the predicted state by its noise.
    end: State,
    chi_square: f64,
}

#[derive(Deserialize)]
struct Biases {
    gyroscope: [f64; 3],
    accelerometer: [f64; 3],
}

#[derive(Deserialize)]
struct State {
    quaternion_wxyz: [f64; 4],
    position: [f64; 3],
    velocity: [f64; 3],
    gyroscope_bias: [f64; 3],
    accelerometer_bias: [f64; 3],
}

impl State {
    fn imu(&self) -> ImuState {
        let [w, x, y, z] = self.quaternion_wxyz;
        let rotation = Rotation::from_quaternion(Quaternion::new(w, x, y, z));
        ImuState {
            local_from_imu: Pose::new(rotation, self.position.into()),
            velocity: self.velocity.into(),
            gyroscope_bias: self.gyroscope_bias.into(),
            accelerometer_bias: self.accelerometer_bias.into(),
        }
    }
}

/// The reading of `make.py` at a time.
fn reading(index: u32) -> ImuSample {
    let t = f64::from(index) / RATE_HZ;
    ImuSample {
        stamp_ns: (t * 1e9).round() as i64,
        gyroscope: Vector3::new(0.1 + 0.3 * (2.0 * t).sin(), -0.4 * (3.0 * t).cos(), 0.5 + 0.2 * t.sin()),
        accelerometer: Vector3::new(
            1.2 * (2.5 * t).cos(),
            0.7 * (1.7 * t).sin() - 0.3,
            9.6 + 0.8 * (4.0 * t).sin(),
        ),
    }
}

#[test]
fn preintegrated_factors_are_those_of_gtsam() {
    let goldens: Goldens = serde_json::from_str(include_str!("factors.json")).unwrap();
    let mut config = EstimatorConfig::default();
    config.gravity = goldens.gravity;
    config.imu_noise = goldens.noise;
    for factor in &goldens.factors {
        let last = (factor.seconds * RATE_HZ).round() as u32;
        let readings: Vec<ImuSample> = (0..=last).map(reading).collect();
        let Biases { gyroscope, accelerometer } = factor.integrated_at;
        let integrated =
            PreintegratedImu::new(&readings, &gyroscope.into(), &accelerometer.into(), &config).unwrap();
        let begin = factor.begin.imu();

        // The biases of the begin are not those of the integration: their Jacobians are in the prediction.
        let residual = integrated.residual(&begin, &factor.predicted.imu());
        let chi_square = |end: &State| {
            let residual = integrated.residual(&begin, &end.imu());
            (residual.transpose() * integrated.information * residual).x
        };
        let (at_prediction, at_end) = (chi_square(&factor.predicted), chi_square(&factor.end));
        println!(
            "{} s: residual {:.1e}, chi-square {at_end} of {}",
            factor.seconds,
            residual.amax(),
            factor.chi_square
        );
        assert!(residual.amax() < 1e-6, "{} s: {residual}", factor.seconds);
        assert!(at_prediction < 1e-4, "{} s: {at_prediction}", factor.seconds);
        assert!((at_end / factor.chi_square - 1.0).abs() < 0.01, "{at_end} of {}", factor.chi_square);
    }
}
