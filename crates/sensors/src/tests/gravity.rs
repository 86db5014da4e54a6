//! The direction of gravity is found in the truth's frame, however that frame is oriented.

use super::*;

/// A recording of a swinging IMU, in a frame where gravity pulls along `gravity` (m/s^2).
fn swinging(gravity: Vector3<f64>, with_velocity: bool) -> Sequence {
    let mut sequence = sequence(1);
    let position = |t: f64| Vector3::new((0.9 * t).sin(), (1.3 * t).cos(), 0.5 * (0.7 * t).sin());
    let velocity =
        |t: f64| Vector3::new(0.9 * (0.9 * t).cos(), -1.3 * (1.3 * t).sin(), 0.35 * (0.7 * t).cos());
    let acceleration =
        |t: f64| Vector3::new(-0.81 * (0.9 * t).sin(), -1.69 * (1.3 * t).cos(), -0.245 * (0.7 * t).sin());
    let rotation = |t: f64| UnitQuaternion::from_scaled_axis(Vector3::new(0.4 * t.sin(), 0.3 * t, 1.0));
    let stamp = |t: f64| START_NS + (t * 1e9).round() as i64;
    sequence.imu_samples = (0..6000)
        .map(|index| f64::from(index) / 200.0)
        .map(|t| ImuSample {
            stamp_ns: stamp(t),
            gyroscope: Vector3::zeros(),
            accelerometer: rotation(t).inverse() * (acceleration(t) - gravity),
        })
        .collect();
    let truth = (-2..320).map(|index| f64::from(index) / 10.0 + 0.013).map(|t| TruthRow {
        stamp_ns: stamp(t),
        pose: Pose::new(rotation(t), position(t)),
        velocity: with_velocity.then(|| velocity(t)),
        gyroscope_bias: None,
        accelerometer_bias: None,
    });
    sequence.groundtruth = Some(truth.collect());
    sequence
}

#[test]
fn gravity_is_found_along_any_axis_with_and_without_velocities() {
    for with_velocity in [true, false] {
        for axis in [Vector3::x(), Vector3::y(), Vector3::z(), -Vector3::x(), -Vector3::y(), -Vector3::z()] {
            let found = swinging(axis * 9.81, with_velocity).truth_gravity().unwrap();
            assert_eq!(found, axis);
        }
    }
}

#[test]
fn a_frame_levelled_by_hand_counts_as_level_and_a_tilted_one_as_tilted() {
    let tilted =
        |degrees: f64| UnitQuaternion::from_scaled_axis(Vector3::x() * degrees.to_radians()) * -Vector3::z();
    assert_eq!(swinging(tilted(0.55) * 9.81, true).truth_gravity().unwrap(), -Vector3::z());
    let found = swinging(tilted(10.0) * 9.81, true).truth_gravity().unwrap();
    assert!(found.angle(&tilted(10.0)).to_degrees() < 0.1, "{found}");
}

#[test]
fn truth_and_imu_that_contradict_each_other_give_no_gravity() {
    assert!(swinging(-Vector3::z() * 5.0, true).truth_gravity().is_none());
}
