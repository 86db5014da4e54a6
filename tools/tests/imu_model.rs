//! An IMU with scale and misalignment, as Kalibr calibrates it: a run with that calibration is the run of an ideal IMU.

use crate::scratch::Scratch;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::path::Path;

/// What Kalibr writes of an IMU, with readings of these matrices.
struct Model {
    accelerometer: Matrix3<f64>,
    gyroscope: Matrix3<f64>,
    gyroscope_from_imu: Matrix3<f64>,
    g_sensitivity: Matrix3<f64>,
}

impl Model {
    /// One percent of scale, half a degree of misalignment, 3e-4 rad/s for 1 m/s^2.
    fn new() -> Self {
        Self {
            accelerometer: Matrix3::new(1.01, 0.0, 0.0, 0.008, 0.988, 0.0, -0.01, 0.006, 1.012),
            gyroscope: Matrix3::new(0.99, 0.0, 0.0, -0.006, 1.011, 0.0, 0.009, 0.005, 0.985),
            gyroscope_from_imu: Rotation3::new(Vector3::new(0.008, -0.01, 0.012)).into_inner(),
            g_sensitivity: Matrix3::from_element(3e-4),
        }
    }

    fn yaml(&self) -> String {
        let rows = |matrix: &Matrix3<f64>| {
            let row = |k: usize| format!("[{}, {}, {}]", matrix[(k, 0)], matrix[(k, 1)], matrix[(k, 2)]);
            format!("[{}, {}, {}]", row(0), row(1), row(2))
        };
        format!(
            "imu0:\n  accelerometer_noise_density: 0.002\n  accelerometer_random_walk: 0.003\n  gyroscope_noise_density: 0.00016968\n  \
             gyroscope_random_walk: 1.9393e-05\n  update_rate: 200.0\n  model: scale-misalignment\n  accelerometers:\n    M: {}\n  \
             gyroscopes:\n    M: {}\n    A: {}\n    C_gyro_i: {}\n",
            rows(&self.accelerometer),
            rows(&self.gyroscope),
            rows(&self.g_sensitivity),
            rows(&self.gyroscope_from_imu)
        )
    }

    /// Rewrites readings as this IMU gives them.
    fn distort(&self, data: &Path) {
        let text = std::fs::read_to_string(data).unwrap();
        let distorted = |line: &str| {
            if line.starts_with('#') {
                return line.to_owned();
            }
            let (stamp, numbers) = line.split_once(',').unwrap();
            let numbers: Vec<f64> = numbers.split(',').map(|number| number.parse().unwrap()).collect();
            let (rate, force) =
                (Vector3::from_row_slice(&numbers[..3]), Vector3::from_row_slice(&numbers[3..]));
            let gyroscope = self.gyroscope * (self.gyroscope_from_imu * rate)
                + self.g_sensitivity * (self.gyroscope_from_imu * force);
            let accelerometer = self.accelerometer * force;
            let all: Vec<String> = gyroscope.iter().chain(&accelerometer).map(f64::to_string).collect();
            format!("{stamp},{}", all.join(","))
        };
        let lines: Vec<String> = text.lines().map(distorted).collect();
        std::fs::write(data, lines.join("\n") + "\n").unwrap();
    }
}

/// Error of the odometry, yaw-aligned (m), and by how much the filter finds the IMU noisier than its data sheet.
fn odometry(scratch: &Scratch, switches: &str, out: &str) -> (f64, f64) {
    scratch.run(&format!("run town/live --mode odometry --init truth {switches} --out {out}"));
    let summary = std::fs::read_to_string(scratch.path(out).join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    let error_m = summary["score"]["odometry_yaw_aligned_m"]["rmse"].as_f64().unwrap();
    (error_m, summary["learned_noise"]["imu_noise_scale"].as_f64().unwrap())
}

#[test]
fn a_calibrated_scale_gives_the_run_of_an_ideal_imu() {
    let scratch = Scratch::new();
    scratch.run("simulate --out town --seed 3 --duration 20");
    let ideal = odometry(&scratch, "", "ideal");
    let model = Model::new();
    model.distort(&scratch.path("town/live/mav0/imu0/data.csv"));
    std::fs::write(scratch.path("imu.yaml"), model.yaml()).unwrap();
    let calibrated = odometry(&scratch, "--imu-calibration imu.yaml", "calibrated");
    let uncalibrated = odometry(&scratch, "", "uncalibrated");
    println!("ideal {ideal:?}, calibrated {calibrated:?}, uncalibrated {uncalibrated:?}");
    assert!((calibrated.0 - ideal.0).abs() < 1e-3 + 0.01 * ideal.0);
    assert!((calibrated.1 - ideal.1).abs() < 0.02 * ideal.1);
    // Tracks hold the position of a short run; what its readings lack shows as noise.
    assert!(uncalibrated.1 > 1.5 * ideal.1);
}
