//! Reference poses against the accelerometer: positions of another unit or in axes of another order or handedness accelerate otherwise
//! than the IMU did.
//!
//! From three positions `p0, p1, p2` at `t0 < t1 < t2` follows the mean of the acceleration with the weight of a triangle that peaks at
//! `t1`, and the specific force, turned by the poses, has the same mean but for gravity:
//! ```text
//! 2 ((p2 - p1) / (t2 - t1) - (p1 - p0) / (t1 - t0)) / (t2 - t0) = s * (mean of R f) + g
//! ```
//! The scale `s` of each axis is one. It is the slope of a line through all such means, so that neither gravity nor a bias that stays
//! in its axis matters.

use nalgebra::Vector3;
use sensors::{ImuSample, ReferencePose};

use super::error::BuildError;
use super::reading_steps::steps;

/// Time between two of the three positions, at least (ns).
const SPAN_NS: i64 = 500_000_000;
/// Longest time between two poses that the gyroscope bridges (ns): its bias is not known.
const MAX_GAP_NS: i64 = 200_000_000;
/// With fewer means there is no verdict.
const LEAST_MEANS: usize = 10;
/// A scale that differs from one by more is refused,
const TOLERANCE: f64 = 0.35;
/// where that is as many of its standard deviations,
const SIGMAS: f64 = 6.0;
/// and where both differ by more on average (root mean square, m/s^2): a bias of 0.2 m/s^2 and poses that are tilted by a degree, which
/// turn with a robot that hardly accelerates, would change the slope, too.
const LEAST_DIFFERENCE: f64 = 0.4;

/// Refuses reference poses whose positions accelerate otherwise than the accelerometer says.
///
/// # Arguments
/// * `readings`: in order of time; without any nothing is compared.
///
/// # Errors
/// [`BuildError::ReferencesAccelerateOtherwise`].
pub(super) fn check_accelerations(
    readings: &[ImuSample],
    references: &[ReferencePose],
) -> Result<(), BuildError> {
    let mut poses: Vec<&ReferencePose> = references.iter().collect();
    poses.sort_by_key(|known| known.stamp_ns);
    poses.dedup_by_key(|known| known.stamp_ns);
    let (mut by_poses, mut by_forces) = (Vec::new(), Vec::new());
    let mut first = 0;
    loop {
        let after = |at: usize| poses.partition_point(|known| known.stamp_ns < poses[at].stamp_ns + SPAN_NS);
        let middle = if first < poses.len() { after(first) } else { break };
        let last = if middle < poses.len() { after(middle) } else { break };
        let Some(stretch) = poses.get(first..=last) else { break };
        if let Some(force) = mean_force(readings, stretch, middle - first) {
            by_poses.push(acceleration([stretch[0], poses[middle], poses[last]]));
            by_forces.push(force);
        }
        first = middle;
    }
    if by_poses.len() < LEAST_MEANS {
        return Ok(());
    }
    for axis in 0..3 {
        let of = |means: &[Vector3<f64>]| means.iter().map(|mean| mean[axis]).collect::<Vec<f64>>();
        let (by_forces, by_poses) = (of(&by_forces), of(&by_poses));
        let (scale, sigma) = slope(&by_forces, &by_poses);
        let off = (scale - 1.0).abs();
        if off > TOLERANCE && off > SIGMAS * sigma && difference(&by_forces, &by_poses) > LEAST_DIFFERENCE {
            let axis = ["x", "y", "z"][axis];
            return Err(BuildError::ReferencesAccelerateOtherwise { axis, scale, sigma });
        }
    }
    Ok(())
}

/// Mean acceleration along three poses, m/s^2.
fn acceleration(poses: [&ReferencePose; 3]) -> Vector3<f64> {
    let [first, middle, last] = poses;
    let velocity = |from: &ReferencePose, to: &ReferencePose| {
        (to.pose.translation - from.pose.translation) / seconds(from.stamp_ns, to.stamp_ns)
    };
    (velocity(middle, last) - velocity(first, middle)) * (2.0 / seconds(first.stamp_ns, last.stamp_ns))
}

/// The mean of the specific force along poses in their frame, with the weight of a triangle that peaks at the middle one, m/s^2; `None`
/// where poses or readings are missing.
fn mean_force(readings: &[ImuSample], stretch: &[&ReferencePose], middle: usize) -> Option<Vector3<f64>> {
    let [begin_ns, middle_ns, end_ns] =
        [stretch.first()?, stretch.get(middle)?, stretch.last()?].map(|known| known.stamp_ns);
    let weight = |stamp_ns: i64| {
        if stamp_ns < middle_ns {
            seconds(begin_ns, stamp_ns) / seconds(begin_ns, middle_ns)
        } else {
            seconds(stamp_ns, end_ns) / seconds(middle_ns, end_ns)
        }
    };
    let mut sum = Vector3::zeros();
    for pair in stretch.windows(2) {
        if pair[1].stamp_ns - pair[0].stamp_ns > MAX_GAP_NS {
            return None;
        }
        let (mut rotation, mut stamp_ns) = (pair[0].pose.rotation, pair[0].stamp_ns);
        for step in steps(readings, pair[0].stamp_ns, pair[1].stamp_ns)? {
            let next = rotation * step.turn();
            let next_ns = stamp_ns + (step.seconds * 1e9).round() as i64;
            sum += (rotation * step.first.accelerometer * weight(stamp_ns)
                + next * step.second.accelerometer * weight(next_ns))
                * (0.5 * step.seconds);
            (rotation, stamp_ns) = (next, next_ns);
        }
    }
    sum.iter().all(|value| value.is_finite()).then(|| sum * (2.0 / seconds(begin_ns, end_ns)))
}

fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    (to_ns - from_ns) as f64 * 1e-9
}

/// Root mean square of the differences of two series from their mean difference.
fn difference(x: &[f64], y: &[f64]) -> f64 {
    let differences = || x.iter().zip(y).map(|(x, y)| y - x);
    let count = x.len() as f64;
    let mean = differences().sum::<f64>() / count;
    (differences().map(|of| (of - mean).powi(2)).sum::<f64>() / count).sqrt()
}

/// Slope of a line through points, and its standard deviation by their distances from it; infinite where they tell nothing.
fn slope(x: &[f64], y: &[f64]) -> (f64, f64) {
    let count = x.len() as f64;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / count;
    let (x_mean, y_mean) = (mean(x), mean(y));
    let square: f64 = x.iter().map(|x| (x - x_mean).powi(2)).sum();
    let product: f64 = x.iter().zip(y).map(|(x, y)| (x - x_mean) * (y - y_mean)).sum();
    let slope = product / square;
    let rest: f64 = x.iter().zip(y).map(|(x, y)| (y - y_mean - slope * (x - x_mean)).powi(2)).sum();
    // Neighbours share half of their time.
    let variance = rest / (0.5 * count - 2.0).max(1.0) / square;
    if slope.is_finite() && variance.is_finite() { (slope, variance.sqrt()) } else { (1.0, f64::INFINITY) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::pose::Pose;
    use geometry::rotation::exp;

    /// A hand that moves a camera about, for 30 s; poses at 20 Hz that are off by centimetres, readings with biases.
    fn carried() -> (Vec<ImuSample>, Vec<ReferencePose>) {
        let position = |t: f64| Vector3::new((1.3 * t).sin(), 0.7 * (1.7 * t).cos(), 0.3 * (2.1 * t).sin());
        let rotation =
            |t: f64| exp(&Vector3::new(0.4 * (0.9 * t).sin(), 0.3 * (0.7 * t).cos(), 0.6 * (0.5 * t).sin()));
        let h = 1e-3;
        let reading = |index: i64| {
            let t = index as f64 * 0.005;
            let force =
                (position(t + h) - position(t) * 2.0 + position(t - h)) / (h * h) + Vector3::z() * 9.81;
            ImuSample {
                stamp_ns: index * 5_000_000,
                gyroscope: (rotation(t - h).inverse() * rotation(t + h)).scaled_axis() / (2.0 * h)
                    + Vector3::new(0.05, -0.06, 0.02),
                accelerometer: rotation(t).inverse() * force + Vector3::new(0.2, -0.1, 0.1),
            }
        };
        let pose = |index: i64| {
            let t = index as f64 * 0.05;
            let off = Vector3::new((37.0 * t).sin(), (41.0 * t).cos(), (43.0 * t).sin()) * 0.02;
            let pose = Pose { rotation: rotation(t), translation: position(t) + off };
            ReferencePose::isotropic(index * 50_000_000, pose, 0.01, 0.02)
        };
        ((0..6000).map(reading).collect(), (0..600).map(pose).collect())
    }

    /// A robot that drives slowly in circles on a floor; its poses are exact in the plane, its accelerometer has a bias and is tilted.
    #[test]
    fn poses_in_a_plane_and_robots_that_hardly_accelerate_pass() {
        let (rate, speed) = (0.3_f64, 0.2);
        let pose = |index: i64| {
            let heading = rate * index as f64 * 0.05;
            let at = Vector3::new(heading.sin(), -heading.cos(), 0.0) * (speed / rate);
            let pose = Pose { rotation: exp(&(Vector3::z() * heading)), translation: at };
            ReferencePose::isotropic(index * 50_000_000, pose, 0.01, 0.02)
        };
        let tilted = exp(&Vector3::new(0.017, -0.017, 0.0));
        let reading = |index: i64| ImuSample {
            stamp_ns: index * 5_000_000,
            gyroscope: Vector3::z() * rate,
            accelerometer: tilted * Vector3::new(0.0, speed * rate, 9.81)
                + Vector3::new(0.2, -0.1, 0.1 * (0.7 * index as f64).sin()),
        };
        let (readings, poses): (Vec<_>, Vec<_>) =
            ((0..12_000).map(reading).collect(), (0..1200).map(pose).collect());
        check_accelerations(&readings, &poses).unwrap();
        let in_millimetres = moved(&poses, |at| at * 1000.0);
        check_accelerations(&readings, &in_millimetres).unwrap_err();
    }

    fn moved(poses: &[ReferencePose], change: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Vec<ReferencePose> {
        let moved = |known: &ReferencePose| {
            let mut known = *known;
            known.pose.translation = change(known.pose.translation);
            known
        };
        poses.iter().map(moved).collect()
    }

    #[test]
    fn positions_in_metres_pass_wherever_their_frame_is() {
        let (readings, poses) = carried();
        check_accelerations(&readings, &poses).unwrap();
        check_accelerations(&readings, &moved(&poses, |at| at + Vector3::new(1e4, -2e3, 50.0))).unwrap();
        let turn = exp(&Vector3::new(0.3, -1.0, 2.0));
        let turned: Vec<ReferencePose> = poses
            .iter()
            .map(|known| {
                let pose =
                    Pose { rotation: turn * known.pose.rotation, translation: turn * known.pose.translation };
                ReferencePose { pose, ..*known }
            })
            .collect();
        check_accelerations(&readings, &turned).unwrap();
        // Nothing to compare with, and nothing that moves.
        check_accelerations(&[], &poses).unwrap();
        check_accelerations(&readings, &poses[..150]).unwrap();
        check_accelerations(&readings[..1], &moved(&poses, |at| at * 1000.0)).unwrap();
    }

    #[test]
    fn positions_of_another_unit_scale_or_handedness_are_refused() {
        let (readings, poses) = carried();
        let changes: [fn(Vector3<f64>) -> Vector3<f64>; 5] = [
            |at| at * 1000.0,
            |at| at * 0.5,
            |at| at * 0.3048,
            |at| Vector3::new(at.x, at.y, -at.z),
            |at| Vector3::new(at.y, at.x, -at.z),
        ];
        for change in changes {
            let error = check_accelerations(&readings, &moved(&poses, change)).unwrap_err();
            assert!(matches!(error, BuildError::ReferencesAccelerateOtherwise { .. }), "{error}");
        }
    }
}
