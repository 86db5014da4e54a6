//! Motion of the IMU about the time of an image, from its readings.

use crate::propagation::{ImuState, advance};
use geometry::{Pose, rotation};
use nalgebra::Vector3;
use smallvec::SmallVec;
use types::ImuSample;

/// Poses of the IMU in its own frame at the time of the image, with their times after it, seconds. Those of 20 ms at 400 Hz are stored
/// without further heap allocation.
pub type TimedPoses = SmallVec<[(f64, Pose); 12]>;

/// The motion about the time of an image, linear in time between the readings.
#[derive(Clone, Debug, Default)]
pub struct MotionAround {
    /// In the order of time.
    segments: SmallVec<[Segment; 16]>,
    /// Seconds since the clone before, and the pose at the image in the frame of the IMU then.
    pub since_before: Option<(f64, Pose)>,
}

/// From one reading to the next, with constant angular velocity in the IMU's frame and constant velocity in the clone's.
#[derive(Clone, Copy, Debug)]
struct Segment {
    /// Begin, seconds after the image.
    begin_s: f64,
    /// IMU pose at the begin in the frame of the IMU at the image.
    clone_from_imu: Pose,
    /// In the frame of the IMU at the begin, rad/s.
    angular_velocity: Vector3<f64>,
    /// In the frame of the IMU at the image, m/s.
    velocity: Vector3<f64>,
}

/// Pose and velocities of the IMU in its own frame at the time of the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativeMotion {
    /// Pose.
    pub clone_from_imu: Pose,
    /// Angular velocity, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Velocity, m/s.
    pub velocity: Vector3<f64>,
}

impl MotionAround {
    /// The motion through poses before the image, of it, and after it.
    ///
    /// # Arguments
    /// * `before`, `after`: nearest to the image first, as [`poses_from`] gives them.
    /// * `since_before`: see [`Self::since_before`].
    pub fn new(before: &[(f64, Pose)], after: &[(f64, Pose)], since_before: Option<(f64, Pose)>) -> Self {
        let image = [(0.0, Pose::identity())];
        let poses: TimedPoses = before.iter().rev().chain(&image).chain(after).copied().collect();
        let segment = |pair: &[(f64, Pose)]| {
            let [(begin_s, begin), (end_s, end)] = [pair[0], pair[1]];
            let rate = 1.0 / (end_s - begin_s);
            Segment {
                begin_s,
                clone_from_imu: begin,
                angular_velocity: rotation::log(&(begin.rotation.inverse() * end.rotation)) * rate,
                velocity: (end.translation - begin.translation) * rate,
            }
        };
        Self { segments: poses.windows(2).map(segment).collect(), since_before }
    }

    /// The same with other poses after the image.
    #[must_use]
    pub fn followed_by(&self, after: &[(f64, Pose)]) -> Self {
        let before = self.segments.iter().rev().filter(|segment| segment.begin_s < 0.0);
        let before: TimedPoses = before.map(|segment| (segment.begin_s, segment.clone_from_imu)).collect();
        Self::new(&before, after, self.since_before)
    }

    /// The motion at a time, which goes on as it is beyond the first and the last reading.
    ///
    /// # Arguments
    /// * `seconds`: after the image.
    pub fn at(&self, seconds: f64) -> RelativeMotion {
        let next = self.segments.partition_point(|segment| segment.begin_s <= seconds);
        let Some(segment) = self.segments.get(next.saturating_sub(1)) else {
            let still = Vector3::zeros();
            return RelativeMotion {
                clone_from_imu: Pose::identity(),
                angular_velocity: still,
                velocity: still,
            };
        };
        let since = seconds - segment.begin_s;
        let begin = &segment.clone_from_imu;
        RelativeMotion {
            clone_from_imu: Pose::new(
                begin.rotation * rotation::exp(&(segment.angular_velocity * since)),
                begin.translation + segment.velocity * since,
            ),
            angular_velocity: begin.rotation * segment.angular_velocity,
            velocity: segment.velocity,
        }
    }
}

/// Integrates readings from a state on, forward or backward in time.
///
/// # Arguments
/// * `readings`: the first one at the time of the state.
/// * `gravity`: in L, m/s^2.
///
/// # Returns
/// The poses at the other readings in the IMU's frame at the state, with their times after it, seconds.
pub fn poses_from<'a>(
    state: &ImuState,
    mut readings: impl Iterator<Item = &'a ImuSample>,
    gravity: &Vector3<f64>,
) -> TimedPoses {
    let mut poses = TimedPoses::new();
    let Some(first) = readings.next() else { return poses };
    let imu_from_local = state.local_from_imu.inverse();
    let (mut now, mut last) = (*state, first);
    for reading in readings.filter(|reading| reading.stamp_ns != first.stamp_ns) {
        if reading.stamp_ns == last.stamp_ns {
            continue;
        }
        now = advance(&now, last, reading, gravity);
        let seconds = (reading.stamp_ns - first.stamp_ns) as f64 * 1e-9;
        poses.push((seconds, imu_from_local * now.local_from_imu));
        last = reading;
    }
    poses
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

    /// A body that turns faster and faster on a bow.
    fn readings() -> Vec<ImuSample> {
        let reading = |k: i64| {
            let t = k as f64 * 5e-3;
            ImuSample {
                stamp_ns: k * 5_000_000,
                gyroscope: Vector3::new(0.4 + 5.0 * t, -0.7, 3.0 * t),
                accelerometer: Vector3::new(2.0, 9.0 + 20.0 * t, -1.0),
            }
        };
        (-4..=4).map(reading).collect()
    }

    fn state() -> ImuState {
        ImuState {
            local_from_imu: Pose::new(
                rotation::exp(&Vector3::new(0.3, -0.8, 0.4)),
                Vector3::new(1.0, 2.0, 3.0),
            ),
            velocity: Vector3::new(0.8, -1.1, 0.3),
            gyroscope_bias: Vector3::new(0.01, 0.02, -0.01),
            accelerometer_bias: Vector3::new(0.1, 0.0, -0.1),
        }
    }

    fn motion() -> MotionAround {
        let readings = readings();
        let before = poses_from(&state(), readings[..5].iter().rev(), &GRAVITY);
        let after = poses_from(&state(), readings[4..].iter(), &GRAVITY);
        assert_eq!((before.len(), after.len()), (4, 4));
        MotionAround::new(&before, &after, None)
    }

    #[test]
    fn the_way_back_is_the_way_there() {
        let readings = readings();
        let there =
            readings.windows(2).fold(state(), |now, pair| advance(&now, &pair[0], &pair[1], &GRAVITY));
        let poses = poses_from(&there, readings.iter().rev(), &GRAVITY);
        let back = there.local_from_imu * poses.last().unwrap().1;
        assert!(back.local(&state().local_from_imu).amax() < 1e-8);
    }

    #[test]
    fn the_motion_passes_through_the_integrated_poses_and_its_velocities_are_its_derivative() {
        let motion = motion();
        assert_eq!(motion.at(0.0).clone_from_imu, Pose::identity());
        let readings = readings();
        let after = poses_from(&state(), readings[4..].iter(), &GRAVITY);
        for (seconds, pose) in &after {
            assert!(motion.at(*seconds).clone_from_imu.local(pose).amax() < 1e-12);
        }
        // Within the readings, and beyond them.
        for seconds in [-0.03, -0.012, -0.001, 0.004, 0.013, 0.025] {
            let at = motion.at(seconds);
            let step = 1e-6;
            let (low, high) = (motion.at(seconds - step), motion.at(seconds + step));
            let rate = low.clone_from_imu.local(&high.clone_from_imu) / (2.0 * step);
            assert!((rate.fixed_rows::<3>(0) - at.angular_velocity).amax() < 1e-6, "{seconds}");
            assert!((rate.fixed_rows::<3>(3) - at.velocity).amax() < 1e-6, "{seconds}");
        }
    }

    #[test]
    fn poses_after_the_image_are_replaced_by_better_ones() {
        let motion = motion();
        let replaced = motion.followed_by(&[(0.004, Pose::identity())]);
        assert_eq!(replaced.at(0.003).clone_from_imu, Pose::identity());
        assert_eq!(replaced.at(-0.017), motion.at(-0.017));
        assert_eq!(MotionAround::default().at(0.01).clone_from_imu, Pose::identity());
    }
}
