//! Wrong calibrations are named, right ones agree.

use geometry::rotation;
use mapping::odometry_config;
use nalgebra::Vector3;
use sensors::Sequence;
use simulation::{Scenario, SimulationOptions, simulate};
use tools::calibration_check::{Agreement, CalibrationCheck, check_calibration};

/// Hand-held in a room.
fn recording(seconds: f64) -> Sequence {
    let scenario = Scenario::Room;
    let options = SimulationOptions {
        seed: 4,
        scenario,
        speed: scenario.usual_speed(),
        depth_m: scenario.depth_m(),
        duration_s: Some(seconds),
        max_tracks: 60,
        live_feature_period_s: 1e9,
        ..SimulationOptions::default()
    };
    simulate(&options).unwrap().live
}

fn check(sequence: &mut Sequence, cameras: usize) -> CalibrationCheck {
    let config = odometry_config(sequence).unwrap();
    let check = check_calibration(sequence, cameras, &config, |_, _| {}).unwrap();
    println!("{check:#?}");
    check
}

/// Names of what differs.
fn differing(check: &CalibrationCheck) -> Vec<&str> {
    let differs = check.parameters.iter().filter(|parameter| parameter.agreement == Agreement::Differs);
    differs.map(|parameter| parameter.name.as_str()).collect()
}

#[test]
fn a_right_calibration_agrees() {
    for cameras in [1, 2] {
        let check = check(&mut recording(20.0), cameras);
        assert!(check.agrees && differing(&check).is_empty());
        assert!(check.parameters.iter().all(|parameter| parameter.agreement == Agreement::Agrees));
        assert!(check.coarse_time_offset.offset_s().unwrap().abs() < 0.01);
    }
}

#[test]
fn late_images_are_named_with_how_late_they_are() {
    let mut sequence = recording(20.0);
    for frame in &mut sequence.frames {
        frame.stamp_ns += 30_000_000;
    }
    let check = check(&mut sequence, 2);
    assert_eq!(differing(&check), ["time offset"]);
    assert!((check.parameters[0].difference[0] + 30.0).abs() < 1.0, "ms");
    assert!(!check.agrees);
}

#[test]
fn clocks_that_differ_by_tenths_of_a_second_are_named() {
    for (cameras, offset_s) in [(1, 0.25), (2, -0.6)] {
        let mut sequence = recording(20.0);
        for frame in &mut sequence.frames {
            frame.stamp_ns -= (offset_s * 1e9) as i64;
        }
        let stamps =
            |sequence: &Sequence| sequence.frames.iter().map(|frame| frame.stamp_ns).collect::<Vec<_>>();
        let before = stamps(&sequence);
        let check = check(&mut sequence, cameras);
        let coarse_s = check.coarse_time_offset.offset_s().unwrap();
        assert!((coarse_s - offset_s).abs() < 0.05, "an image period");
        assert_eq!(differing(&check), ["time offset"]);
        assert!((check.parameters[0].difference[0] - 1e3 * offset_s).abs() < 2.0, "ms");
        assert!(!check.agrees && check.checked && check.mistake.is_none());
        assert_eq!(stamps(&sequence), before);
    }
}

#[test]
fn wrong_extrinsics_and_a_wrong_focal_length_are_named() {
    let mut sequence = recording(20.0);
    for sensor in &mut sequence.cameras {
        let turned = rotation::exp(&Vector3::new(0.0, 3.0_f64.to_radians(), 0.0));
        sensor.imu_from_camera.rotation = turned * sensor.imu_from_camera.rotation;
    }
    let found = check(&mut sequence, 2);
    assert_eq!(differing(&found), ["cam0 rotation in the IMU's frame", "cam1 rotation in the IMU's frame"]);
    assert!((found.parameters[1].difference[1] + 3.0).abs() < 0.2, "deg");

    let mut sequence = recording(20.0);
    sequence.cameras[0].camera.focal.iter_mut().for_each(|focal| *focal *= 1.03);
    let found = check(&mut sequence, 1);
    assert_eq!(differing(&found), ["cam0 focal length"]);
}

#[test]
fn gross_mistakes_are_named() {
    let mut inverted = recording(10.0);
    for sensor in &mut inverted.cameras {
        sensor.imu_from_camera = sensor.imu_from_camera.inverse();
    }
    let mut swapped = recording(10.0);
    swapped.cameras.reverse();
    for (mut sequence, word) in [(inverted, "inverted"), (swapped, "swapped")] {
        let found = check(&mut sequence, 2);
        assert!(!found.agrees && found.mistake.is_some_and(|mistake| mistake.contains(word)));
    }
}
