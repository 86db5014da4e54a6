//! What is told of a vehicle is what its robot knows now.

use crate::robot::{odometry, pose, status};
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{UnitQuaternion, Vector3};
use protocol::RobotState;
use std::f64::consts::{FRAC_PI_2, PI};
use std::time::{Duration, Instant};
use vda5050::{AgvPosition, Published, Vehicle, VehicleSettings, deviation_range_m, localization_score};

/// A robot whose pose and state came at a time.
fn localized(settings: &VehicleSettings, now: Instant) -> Vehicle {
    let mut vehicle = Vehicle::new(settings.clone(), now);
    vehicle.note(Published::Pose(Box::new(pose(1, 3.0, 0.3))), now);
    vehicle.note(Published::Odometry(Box::new(odometry(1, FRAC_PI_2))), now);
    vehicle.note(Published::Status(status(RobotState::Localized)), now);
    vehicle
}

fn is_unknown(position: &AgvPosition) -> bool {
    let AgvPosition { position_initialized, localization_score, deviation_range, .. } = position;
    !position_initialized && *localization_score == Some(0.0) && deviation_range.is_none()
}

#[test]
fn a_localized_robot_is_where_its_pose_is() {
    let (settings, now) = (VehicleSettings::default(), Instant::now());
    let position = localized(&settings, now).position(now);
    let known: PoseWithCovariance = pose(1, 3.0, 0.3).global_from_imu;
    assert!(position.position_initialized);
    assert_eq!((position.x, position.y, position.map_id.as_str()), (3.0, -2.0, "hall"));
    assert!((position.theta - 0.3).abs() < 1e-12);
    assert_eq!(position.deviation_range, Some(deviation_range_m(&known)));
    assert!((position.deviation_range.unwrap() - 0.04 * 5.991_464_547_f64.sqrt()).abs() < 1e-9);
    assert_eq!(position.localization_score, Some(localization_score(&known, 0.1)));
}

#[test]
fn the_reference_point_is_that_of_the_vehicle() {
    // The IMU is upside down, 1 m ahead of the reference point and 0.5 m above it.
    let base_from_imu =
        Pose::new(UnitQuaternion::from_euler_angles(PI, 0.0, 0.0), Vector3::new(1.0, 0.0, 0.5));
    let settings = VehicleSettings { imu_from_base: base_from_imu.inverse(), ..VehicleSettings::default() };
    let now = Instant::now();
    let mut vehicle = Vehicle::new(settings, now);
    // The base is at (10, 20, 0), its x axis along y of the map.
    let map_from_base =
        Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.0, FRAC_PI_2), Vector3::new(10.0, 20.0, 0.0));
    let mut known = pose(1, 0.0, 0.0);
    known.global_from_imu.pose = map_from_base * base_from_imu;
    vehicle.note(Published::Pose(Box::new(known)), now);
    vehicle.note(Published::Status(status(RobotState::Localized)), now);
    let position = vehicle.position(now);
    assert!((position.x - 10.0).abs() < 1e-9 && (position.y - 20.0).abs() < 1e-9, "{position:?}");
    assert!((position.theta - FRAC_PI_2).abs() < 1e-9);
    // An error of 0.02 rad of yaw moves the reference point by 2 cm along x, in which the IMU is known within 3 cm.
    let horizontal = position.deviation_range.unwrap() / 5.991_464_547_f64.sqrt();
    assert!((horizontal - 0.04_f64.max((0.03_f64.powi(2) + 0.02_f64.powi(2)).sqrt())).abs() < 1e-3);

    // It turns left on the spot at 0.5 rad/s: the IMU moves, the reference point does not.
    let mut motion = odometry(1, 0.0);
    motion.local_from_imu.pose = map_from_base * base_from_imu;
    motion.velocity_in_local = [-0.5, 0.0, 0.0];
    motion.angular_velocity_in_imu = [0.0, 0.0, -0.5];
    vehicle.note(Published::Odometry(Box::new(motion)), now);
    let velocity = vehicle.velocity(now).unwrap();
    assert!(velocity.vx.abs() < 1e-9 && velocity.vy.abs() < 1e-9, "{velocity:?}");
    assert!((velocity.omega - 0.5).abs() < 1e-9);
}

#[test]
fn velocities_are_in_the_axes_of_the_vehicle() {
    let now = Instant::now();
    let velocity = localized(&VehicleSettings::default(), now).velocity(now).unwrap();
    assert!((velocity.vx - 1.0).abs() < 1e-12 && velocity.vy.abs() < 1e-12, "{velocity:?}");
    assert!((velocity.omega - 0.5).abs() < f64::EPSILON);
}

#[test]
fn what_is_old_is_not_valid() {
    let (settings, now) = (VehicleSettings::default(), Instant::now());
    let mut vehicle = localized(&settings, now);
    let later = now + settings.max_age + Duration::from_millis(1);
    // The state goes on, the pose does not.
    vehicle.note(Published::Status(status(RobotState::Localized)), later);
    let position = vehicle.position(later);
    assert!(is_unknown(&position), "{position:?}");
    assert_eq!((position.x, position.map_id.as_str()), (3.0, "hall"), "the last known place");
    assert!(vehicle.velocity(later).is_none());
    // A repeated message is no news.
    vehicle.note(Published::Pose(Box::new(pose(1, 3.0, 0.3))), later);
    assert!(is_unknown(&vehicle.position(later)));
    vehicle.note(Published::Pose(Box::new(pose(2, 3.1, 0.3))), later);
    assert!(vehicle.position(later).position_initialized);
}

#[test]
fn a_robot_that_is_not_localized_has_no_position() {
    let (settings, now) = (VehicleSettings::default(), Instant::now());
    for state in [RobotState::Lost, RobotState::OdometryOnly, RobotState::Starting] {
        let mut vehicle = localized(&settings, now);
        vehicle.note(Published::Status(status(state)), now);
        assert!(is_unknown(&vehicle.position(now)), "{state:?}");
        assert_eq!(vehicle.velocity(now).is_none(), state == RobotState::Lost);
        // Localized again: the pose from before is not valid, the next one is.
        vehicle.note(Published::Status(status(RobotState::Localized)), now);
        assert!(is_unknown(&vehicle.position(now)), "{state:?}");
        vehicle.note(Published::Pose(Box::new(pose(2, 4.0, 0.3))), now);
        assert!(vehicle.position(now).position_initialized, "{state:?}");
    }
}

#[test]
fn a_robot_without_a_state_has_no_position() {
    let now = Instant::now();
    let mut vehicle = Vehicle::new(VehicleSettings::default(), now);
    assert!(is_unknown(&vehicle.position(now)));
    vehicle.note(Published::Pose(Box::new(pose(1, 3.0, 0.3))), now);
    assert!(is_unknown(&vehicle.position(now)));
}

#[test]
fn a_robot_that_is_gone_has_no_position() {
    let (settings, now) = (VehicleSettings::default(), Instant::now());
    let mut vehicle = localized(&settings, now);
    vehicle.note_token(false, now);
    assert!(!vehicle.is_online(now) && is_unknown(&vehicle.position(now)) && vehicle.velocity(now).is_none());
    // What was on its way is no sign of life.
    vehicle.note(Published::Pose(Box::new(pose(2, 3.0, 0.3))), now);
    assert!(!vehicle.is_online(now));
    vehicle.note_token(true, now);
    assert!(vehicle.is_online(now) && is_unknown(&vehicle.position(now)), "it may be elsewhere");
    vehicle.note(Published::Pose(Box::new(pose(3, 3.0, 0.3))), now);
    assert!(vehicle.position(now).position_initialized);
    assert!(!vehicle.is_online(now + Duration::from_secs(6)), "it is silent");
}

#[test]
fn headings_are_between_minus_pi_and_pi() {
    let now = Instant::now();
    for step in -40..40 {
        let yaw = f64::from(step) * 0.2;
        let mut vehicle = localized(&VehicleSettings::default(), now);
        vehicle.note(Published::Pose(Box::new(pose(2, 0.0, yaw))), now);
        let theta = vehicle.position(now).theta;
        assert!(theta.abs() <= PI && ((theta - yaw).sin()).abs() < 1e-9, "{yaw}: {theta}");
    }
}

#[test]
fn a_position_in_a_map_that_is_not_level_is_not_initialized() {
    let now = Instant::now();
    for (tilt_deg, is_level) in [(4.9_f64, true), (11.3, false), (90.0, false), (180.0, false)] {
        let mut vehicle = localized(&VehicleSettings::default(), now);
        let mut tilted = pose(2, 3.0, 0.3);
        let tilt = UnitQuaternion::from_euler_angles(tilt_deg.to_radians(), 0.0, 0.0);
        tilted.global_from_local.pose.rotation = tilt * tilted.global_from_local.pose.rotation;
        vehicle.note(Published::Pose(Box::new(tilted)), now);
        let position = vehicle.position(now);
        assert_eq!(position.position_initialized, is_level, "{tilt_deg}");
        assert_eq!(is_unknown(&position), !is_level);
        match vehicle.map_tilt() {
            None => assert!(is_level),
            Some((map, stated_deg)) => {
                assert!(map == "hall" && (stated_deg - tilt_deg).abs() < 1e-6, "{stated_deg}");
            }
        }
    }
}
