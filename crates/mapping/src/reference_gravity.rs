//! Direction of gravity in the frame of reference poses, by the recording's own IMU.
//!
//! Over a time `T`, `v1 - v0 = integral of (R f) dt + g T`: the specific force `f` turned by the poses, whose rotation the gyroscope
//! continues between them. The velocities at both ends come from the positions; their errors are divided by `T`.

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
    let mut poses: Vec<&ReferencePose> = references.iter().collect();
    poses.sort_by_key(|known| known.stamp_ns);
    poses.dedup_by_key(|known| known.stamp_ns);
    let (mut change, mut seconds) = (Vector3::zeros(), 0.0);
    let is_covered = |a: &ReferencePose, b: &ReferencePose| {
        b.stamp_ns - a.stamp_ns <= MAX_GAP_NS && force(readings, a, b).is_some()
    };
    for stretch in poses.chunk_by(|a, b| is_covered(a, b)) {
        let [first, second, .., before, last] = stretch else { continue };
        let forces: Vector3<f64> =
            stretch.windows(2).filter_map(|pair| force(readings, pair[0], pair[1])).sum();
        change += velocity(before, last) - velocity(first, second) - forces;
        seconds += (last.stamp_ns + before.stamp_ns - first.stamp_ns - second.stamp_ns) as f64 * 0.5e-9;
    }
    if seconds < MIN_SECONDS { None } else { direction_of_gravity(&(change / seconds)) }
}

/// Mean velocity between two poses, m/s.
fn velocity(from: &ReferencePose, to: &ReferencePose) -> Vector3<f64> {
    (to.pose.translation - from.pose.translation) / ((to.stamp_ns - from.stamp_ns) as f64 * 1e-9)
}

/// Integral of the specific force between two poses in their frame, m/s; `None` where readings are missing.
fn force(readings: &[ImuSample], from: &ReferencePose, to: &ReferencePose) -> Option<Vector3<f64>> {
    let (mut rotation, mut sum) = (from.pose.rotation, Vector3::zeros());
    for step in steps(readings, from.stamp_ns, to.stamp_ns)? {
        let next = rotation * step.turn();
        sum +=
            (rotation * step.first.accelerometer + next * step.second.accelerometer) * (0.5 * step.seconds);
        rotation = next;
    }
    sum.iter().all(|value| value.is_finite()).then_some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::pose::Pose;
    use geometry::rotation::exp;
    use nalgebra::UnitQuaternion;

    /// A ride along a bend in a frame whose gravity has a direction.
    fn ride(down: Vector3<f64>, seconds: i64) -> (Vec<ImuSample>, Vec<ReferencePose>) {
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
        let pose =
            |index: i64| ReferencePose::isotropic(index * 400_000_000, at(index as f64 * 0.4), 0.001, 0.01);
        ((0..seconds * 200).map(reading).collect(), (0..seconds * 5 / 2).map(pose).collect())
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
