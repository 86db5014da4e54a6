//! Drives of a robot on wheels on a flat floor.

use evaluation::trajectory::StampedPose;
use geometry::Pose;
use nalgebra::{UnitQuaternion, Vector3};

/// Distance between poses, seconds.
const STEP_S: f64 = 0.1;
/// Steps of the integration between two poses.
const SUBSTEPS: usize = 20;
/// Rest before the start, seconds.
const REST_S: f64 = 2.5;
/// Time to reach the speed, seconds.
const SPEED_UP_S: f64 = 2.0;
/// The first part is straight, seconds after the start.
const STRAIGHT_S: f64 = 12.0;
/// How fast a base that moves sideways changes the side, rad/s.
const SWAY_RAD_S: f64 = 0.4;
/// Duration of a turn, and of a turn with the straight part behind it, seconds.
const TURN_S: f64 = 4.0;
const LEG_S: f64 = 9.0;

/// Trajectory of the body of a robot that starts from rest, drives straight for about ten metres, and then turns now to one
/// side, now to the other: in a world with z up, with a base that never moves sideways.
///
/// # Arguments
/// * `speed`: m/s.
/// * `imu_from_base`: where the base is.
pub fn planar_drive(seconds: f64, speed: f64, imu_from_base: &Pose) -> Vec<StampedPose> {
    drive(seconds, [speed, 0.0], imu_from_base)
}

/// The same with a base that also moves sideways, now to the left, now to the right.
///
/// # Arguments
/// * `speeds`: ahead, and most to a side, m/s.
pub fn sideways_drive(seconds: f64, speeds: [f64; 2], imu_from_base: &Pose) -> Vec<StampedPose> {
    drive(seconds, speeds, imu_from_base)
}

fn drive(seconds: f64, [speed, to_side]: [f64; 2], imu_from_base: &Pose) -> Vec<StampedPose> {
    let base_from_imu = imu_from_base.inverse();
    let (mut x, mut y, mut yaw, mut time) = (0.0, 0.0, 0.0_f64, 0.0);
    let count = (seconds / STEP_S).ceil() as i64;
    let mut poses = Vec::new();
    for index in 0..=count {
        let world_from_base =
            Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.0, yaw), Vector3::new(x, y, 0.0));
        let stamp_ns = (index as f64 * STEP_S * 1e9).round() as i64;
        poses.push(StampedPose { stamp_ns, pose: world_from_base * base_from_imu });
        for _ in 0..SUBSTEPS {
            let dt = STEP_S / SUBSTEPS as f64;
            let (forward, turn) = pace(time + dt / 2.0);
            let heading = yaw + turn * dt / 2.0;
            let left = to_side * sideways(time + dt / 2.0);
            x += (speed * forward * heading.cos() - left * heading.sin()) * dt;
            y += (speed * forward * heading.sin() + left * heading.cos()) * dt;
            yaw += turn * dt;
            time += dt;
        }
    }
    poses
}

/// Fraction of the speed, and rate of turn (rad/s), at a time.
fn pace(time: f64) -> (f64, f64) {
    let driving = time - REST_S;
    let up = (driving / SPEED_UP_S).clamp(0.0, 1.0);
    let forward = up * up * (3.0 - 2.0 * up) * (1.0 - 0.15 * (0.9 * driving.max(0.0)).sin());
    let turning = driving - STRAIGHT_S;
    if turning < 0.0 {
        return (forward, 0.0);
    }
    let (leg, within) = ((turning / LEG_S) as i64, turning % LEG_S);
    let side = if leg % 3 == 2 { -1.0 } else { 1.0 };
    let bend = if within < TURN_S { (std::f64::consts::PI * within / TURN_S).sin().powi(2) } else { 0.0 };
    (forward, side * 0.75 * bend)
}

/// Fraction of the speed to the left at a time.
fn sideways(time: f64) -> f64 {
    let driving = (time - REST_S).max(0.0);
    let up = (driving / SPEED_UP_S).min(1.0);
    up * up * (3.0 - 2.0 * up) * (SWAY_RAD_S * driving).sin()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_base_moves_where_it_looks() {
        let imu_from_base = Pose::new(UnitQuaternion::identity(), Vector3::new(-0.1, 0.0, -0.2));
        let drive = planar_drive(40.0, 1.2, &imu_from_base);
        let bases: Vec<Pose> = drive.iter().map(|row| row.pose * imu_from_base).collect();
        let mut way = 0.0;
        for pair in bases.windows(2) {
            let moved = pair[0].inverse() * pair[1];
            let chord = geometry::rotation::log(&moved.rotation).z / 2.0;
            let sideways = -chord.sin() * moved.translation.x + chord.cos() * moved.translation.y;
            assert!(sideways.abs() < 1e-3 && moved.translation.z.abs() < 1e-9, "{moved:?}");
            way += moved.translation.norm();
        }
        assert!((35.0..50.0).contains(&way), "{way}");
        let straight = bases[(10.0 / STEP_S) as usize].translation;
        assert!(straight.x > 6.0 && straight.y.abs() < 1e-9);
    }
}
