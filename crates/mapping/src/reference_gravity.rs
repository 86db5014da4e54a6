//! Direction of gravity in the frame of reference poses, by the recording's own IMU.
//!
//! The mean velocities of the first and of the last interval of a stretch of poses differ by
//! ```text
//! v_last - v_first = integral of w (R f) dt + g integral of w dt
//! ```
//! with the specific force `f` turned by the poses, whose rotation the gyroscope continues between them, and a weight `w` that rises
//! from 0 to 1 in the first interval, is 1 up to the last one, and falls to 0 there: the mean velocity of an interval from `t0` to `t1`
//! is `v(t1) - integral of (t - t0) / (t1 - t0) a dt`, whatever the acceleration `a` is. The errors of the velocities are divided by the
//! integral of `w`, the time from the middle of the first interval to that of the last one.

use nalgebra::Vector3;
use sensors::{ImuSample, ReferencePose, direction_of_gravity};

use super::reading_steps::steps;

/// Longest time between two poses that the gyroscope bridges (ns).
const MAX_GAP_NS: i64 = 1_000_000_000;
/// Shorter recordings tell too little (s).
const MIN_SECONDS: f64 = 5.0;

/// Unit vector of the direction of gravity in the frame of reference poses; `None` where poses and readings do not overlap for long
/// enough, or do not give gravity its known strength.
///
/// # Arguments
/// * `readings`: in order of time.
pub(super) fn gravity_of(readings: &[ImuSample], references: &[ReferencePose]) -> Option<Vector3<f64>> {
    gravity(readings, references).and_then(|gravity| direction_of_gravity(&gravity))
}

/// Gravity in the frame of reference poses as they and the readings give it (m/s^2); `None` where they do not overlap for long enough.
fn gravity(readings: &[ImuSample], references: &[ReferencePose]) -> Option<Vector3<f64>> {
    let mut poses: Vec<&ReferencePose> = references.iter().collect();
    poses.sort_by_key(|known| known.stamp_ns);
    poses.dedup_by_key(|known| known.stamp_ns);
    let (mut change, mut seconds) = (Vector3::zeros(), 0.0);
    let is_covered = |a: &ReferencePose, b: &ReferencePose| {
        b.stamp_ns - a.stamp_ns <= MAX_GAP_NS && force(readings, [a, b], [1.0, 1.0]).is_some()
    };
    for stretch in poses.chunk_by(|a, b| is_covered(a, b)) {
        let [first, second, .., before, last] = stretch else { continue };
        let final_interval = stretch.len() - 2;
        let of_interval = |(at, pair): (usize, &[&ReferencePose])| {
            let begins = if at == 0 { 0.0 } else { 1.0 };
            let ends = if at == final_interval { 0.0 } else { 1.0 };
            force(readings, [pair[0], pair[1]], [begins, ends])
        };
        let forces: Vector3<f64> = stretch.windows(2).enumerate().filter_map(of_interval).sum();
        change += velocity(before, last) - velocity(first, second) - forces;
        seconds += (last.stamp_ns + before.stamp_ns - first.stamp_ns - second.stamp_ns) as f64 * 0.5e-9;
    }
    (seconds >= MIN_SECONDS).then(|| change / seconds)
}

/// Mean velocity between two poses, m/s.
fn velocity(from: &ReferencePose, to: &ReferencePose) -> Vector3<f64> {
    (to.pose.translation - from.pose.translation) / ((to.stamp_ns - from.stamp_ns) as f64 * 1e-9)
}

/// Integral of the weighted specific force between two poses in their frame, m/s; `None` where readings are missing.
///
/// # Arguments
/// * `weights`: at the two poses; linear in time between them.
fn force(
    readings: &[ImuSample],
    [from, to]: [&ReferencePose; 2],
    [begin, end]: [f64; 2],
) -> Option<Vector3<f64>> {
    let whole = (to.stamp_ns - from.stamp_ns) as f64 * 1e-9;
    let (mut rotation, mut seconds, mut sum) = (from.pose.rotation, 0.0, Vector3::zeros());
    for step in steps(readings, from.stamp_ns, to.stamp_ns)? {
        let next = rotation * step.turn();
        let weight = |seconds: f64| begin + (end - begin) * seconds / whole;
        sum += (rotation * step.first.accelerometer * weight(seconds)
            + next * step.second.accelerometer * weight(seconds + step.seconds))
            * (0.5 * step.seconds);
        rotation = next;
        seconds += step.seconds;
    }
    sum.iter().all(|value| value.is_finite()).then_some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::pose::Pose;
    use geometry::rotation::exp;
    use nalgebra::UnitQuaternion;

    /// A ride along a bend in a frame whose gravity has a direction, with poses at 2.5 Hz.
    fn ride(down: Vector3<f64>, seconds: i64) -> (Vec<ImuSample>, Vec<ReferencePose>) {
        ride_with_poses(down, seconds, 400_000_000)
    }

    /// The same with poses that are so far apart (ns).
    fn ride_with_poses(
        down: Vector3<f64>,
        seconds: i64,
        period_ns: i64,
    ) -> (Vec<ImuSample>, Vec<ReferencePose>) {
        let (rate, radius) = (0.4_f64, 3.0);
        let upright = UnitQuaternion::rotation_between(&-Vector3::z(), &down).unwrap();
        let at = |time: f64| {
            let (sine, cosine) = (rate * time).sin_cos();
            let rotation = upright * exp(&(Vector3::z() * (rate * time)));
            Pose { rotation, translation: upright * Vector3::new(radius * sine, -radius * cosine, 0.0) }
        };
        let reading = |index: i64| ImuSample {
            stamp_ns: index * 5_000_000,
            gyroscope: Vector3::z() * rate,
            // Towards the centre, and against gravity; a bias.
            accelerometer: Vector3::new(0.02, radius * rate * rate, 9.81),
        };
        let pose = |index: i64| {
            let stamp_ns = index * period_ns;
            ReferencePose::isotropic(stamp_ns, at(stamp_ns as f64 * 1e-9), 0.001, 0.01)
        };
        let poses = seconds * 1_000_000_000 / period_ns;
        ((0..seconds * 200).map(reading).collect(), (0..poses).map(pose).collect())
    }

    #[test]
    fn gravity_is_found_in_any_frame_and_along_an_axis_where_it_nearly_is() {
        for (down, expected) in [
            (-Vector3::z(), -Vector3::z()),
            (Vector3::new(0.02, 1.0, 0.0).normalize(), Vector3::y()),
            (Vector3::new(1.0, 1.0, -1.0).normalize(), Vector3::new(1.0, 1.0, -1.0).normalize()),
        ] {
            let (readings, poses) = ride(down, 20);
            let found = gravity_of(&readings, &poses).unwrap();
            assert!(found.angle(&expected) < 0.01, "{found} for {down}");
        }
    }

    #[test]
    fn gravity_has_its_strength_whatever_the_rate_of_the_poses() {
        for (period_ns, seconds) in
            [(1_000_000_000, 20), (1_000_000_000, 15), (500_000_000, 9), (50_000_000, 9)]
        {
            let (readings, poses) = ride_with_poses(-Vector3::z(), seconds, period_ns);
            let found = gravity(&readings, &poses).unwrap();
            assert!((found.norm() - 9.81).abs() < 0.05, "{found} of poses every {period_ns} ns");
        }
    }

    #[test]
    fn a_body_that_starts_with_an_acceleration_leaves_gravity_vertical() {
        // Its speed is 2 (1 - exp(-t)).
        let reading = |index: i64| ImuSample {
            stamp_ns: index * 5_000_000,
            gyroscope: Vector3::zeros(),
            accelerometer: Vector3::new(2.0 * (-0.005 * index as f64).exp(), 0.0, 9.81),
        };
        let pose = |index: i64| {
            let t = index as f64;
            let translation = Vector3::new(2.0 * (t - 1.0 + (-t).exp()), 0.0, 0.0);
            let pose = Pose { rotation: UnitQuaternion::identity(), translation };
            ReferencePose::isotropic(index * 1_000_000_000, pose, 0.001, 0.01)
        };
        let (readings, poses): (Vec<_>, Vec<_>) =
            ((0..3000).map(reading).collect(), (0..15).map(pose).collect());
        let found = gravity(&readings, &poses).unwrap();
        assert!((found + Vector3::z() * 9.81).norm() < 1e-3, "{found}");
    }

    #[test]
    fn poses_from_before_the_readings_began_take_nothing_away() {
        let (readings, poses) = ride(-Vector3::z(), 30);
        // Readings of the middle only, with a hole.
        let some: Vec<ImuSample> = readings[1000..4800]
            .iter()
            .copied()
            .filter(|at| at.stamp_ns % 17_000_000_000 > 1_000_000_000)
            .collect();
        let found = gravity_of(&some, &poses).unwrap();
        assert!(found.angle(&-Vector3::z()) < 0.01, "{found}");
    }

    #[test]
    fn what_tells_nothing_of_gravity_gives_none() {
        let (readings, poses) = ride(-Vector3::z(), 20);
        assert_eq!(gravity_of(&[], &poses), None);
        assert_eq!(gravity_of(&readings, &poses[..8]), None, "too short");
        let in_g: Vec<ImuSample> = readings
            .iter()
            .map(|reading| ImuSample { accelerometer: reading.accelerometer / 9.81, ..*reading })
            .collect();
        assert_eq!(gravity_of(&in_g, &poses), None, "of another strength");
    }
}
