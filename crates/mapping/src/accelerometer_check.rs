//! Reference poses against the accelerometer: positions of another unit or scale, or in axes of another order or handedness than
//! their rotations, accelerate otherwise than the IMU did.
//!
//! From three positions `p0, p1, p2` at `t0 < t1 < t2` follows the mean of the acceleration with the weight of a triangle that peaks
//! at `t1`. The specific force `f`, turned by the poses, has the same mean but for gravity and a bias `b` of the accelerometer:
//! ```text
//! 2 ((p2 - p1) / (t2 - t1) - (p1 - p0) / (t1 - t0)) / (t2 - t0) = mean(R f) + g - mean(R) b
//! ```
//! What gravity and a bias can explain is taken from both sides; the rest correlates, and is as large on one side as on the other.
//! Poses that are smoothed, late or noisy correlate less, but not better with their axes exchanged.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use sensors::{ImuSample, ReferencePose};

use super::error::BuildError;
use super::reading_steps::steps;

/// Time between two of the three positions, at least (ns).
const SPAN_NS: i64 = 500_000_000;
/// Longest time between two poses that the gyroscope bridges (ns): its bias is not known.
const MAX_GAP_NS: i64 = 200_000_000;
/// With fewer means there is no verdict.
const LEAST_MEANS: usize = 20;
/// Nor where the two sides correlate less.
const LEAST_CORRELATION: f64 = 0.8;
/// The axes are refused where the variance that is not explained is so many times smaller with others.
const BETTER_AXES: f64 = 1.5;
/// Accelerations by the positions over those by the accelerometer that are accepted. Noise of the positions makes them larger, by a
/// quarter at most where both correlate, smoothing makes them smaller.
const SCALES: [f64; 2] = [0.6, 1.6];
/// Directions of gravity and bias whose singular value is a smaller part of the largest one are not told apart.
const LEAST_SINGULAR: f64 = 1e-6;

/// Refuses reference poses whose positions accelerate otherwise than the accelerometer says.
///
/// # Arguments
/// * `readings`: in order of time; without any nothing is compared.
///
/// # Errors
/// [`BuildError::ReferencesOnOtherAxes`], [`BuildError::ReferencesOfOtherScale`].
pub(super) fn check_accelerations(
    readings: &[ImuSample],
    references: &[ReferencePose],
) -> Result<(), BuildError> {
    let compared = Compared::of(readings, references);
    if compared.by_poses.len() < LEAST_MEANS {
        return Ok(());
    }
    let explained = compared.by_gravity_and_bias();
    let forces = rest(&explained, &stacked(&compared.by_forces));
    let fit = |axes: &Axes| {
        let accelerations: Vec<Vector3<f64>> = compared.by_poses.iter().map(|of| axes.of(of)).collect();
        let accelerations = rest(&explained, &stacked(&accelerations));
        let correlation = accelerations.dot(&forces) / (accelerations.norm() * forces.norm());
        (correlation, accelerations.norm() / forces.norm())
    };
    let (as_given, scale) = fit(&Axes::AS_GIVEN);
    let fits = Axes::all().map(|axes| (axes, fit(&axes).0));
    let Some((axes, best)) = fits.max_by(|(_, one), (_, other)| one.total_cmp(other)) else { return Ok(()) };
    // NaN, where nothing moves, is below.
    if best.partial_cmp(&LEAST_CORRELATION).is_none_or(std::cmp::Ordering::is_lt) {
        return Ok(());
    }
    let unexplained = |correlation: f64| 1.0 - correlation.max(0.0).powi(2);
    if unexplained(as_given) > BETTER_AXES * unexplained(best) {
        return Err(BuildError::ReferencesOnOtherAxes {
            axes: axes.to_string(),
            correlation: as_given,
            correlation_on_others: best,
        });
    }
    if as_given > LEAST_CORRELATION && !(SCALES[0]..SCALES[1]).contains(&scale) {
        return Err(BuildError::ReferencesOfOtherScale { scale });
    }
    Ok(())
}

/// Means of the acceleration, by the poses and by the readings.
#[derive(Default)]
struct Compared {
    /// By the positions, m/s^2.
    by_poses: Vec<Vector3<f64>>,
    /// Specific force, turned by the rotations, m/s^2.
    by_forces: Vec<Vector3<f64>>,
    /// Rotations, with the same weights.
    rotations: Vec<Matrix3<f64>>,
}

impl Compared {
    fn of(readings: &[ImuSample], references: &[ReferencePose]) -> Self {
        let mut poses: Vec<&ReferencePose> = references.iter().collect();
        poses.sort_by_key(|known| known.stamp_ns);
        poses.dedup_by_key(|known| known.stamp_ns);
        let after = |at: usize| poses.partition_point(|known| known.stamp_ns < poses[at].stamp_ns + SPAN_NS);
        let mut compared = Self::default();
        let mut first = 0;
        while first < poses.len() {
            let middle = after(first);
            let last = if middle < poses.len() { after(middle) } else { break };
            let Some(stretch) = poses.get(first..=last) else { break };
            if let Some((force, rotation)) = mean_force(readings, stretch, middle - first) {
                compared.by_poses.push(acceleration([stretch[0], poses[middle], poses[last]]));
                compared.by_forces.push(force);
                compared.rotations.push(rotation);
            }
            first = middle;
        }
        compared
    }

    /// Orthonormal columns that span what gravity and a bias do to all means.
    fn by_gravity_and_bias(&self) -> DMatrix<f64> {
        let mut columns = DMatrix::zeros(3 * self.rotations.len(), 6);
        for (index, rotation) in self.rotations.iter().enumerate() {
            columns.fixed_view_mut::<3, 3>(3 * index, 0).fill_with_identity();
            columns.fixed_view_mut::<3, 3>(3 * index, 3).copy_from(rotation);
        }
        let svd = columns.svd(true, false);
        let (values, vectors) = (svd.singular_values, svd.u.unwrap_or_default());
        let kept: Vec<usize> =
            (0..values.len()).filter(|index| values[*index] > LEAST_SINGULAR * values.max()).collect();
        vectors.select_columns(&kept)
    }
}

/// What orthonormal columns do not explain.
fn rest(columns: &DMatrix<f64>, values: &DVector<f64>) -> DVector<f64> {
    values - columns * columns.tr_mul(values)
}

fn stacked(vectors: &[Vector3<f64>]) -> DVector<f64> {
    DVector::from_iterator(3 * vectors.len(), vectors.iter().flatten().copied())
}

/// The axes of a frame in another order, or with other signs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Axes {
    order: [usize; 3],
    negative: [bool; 3],
}

impl Axes {
    const AS_GIVEN: Self = Self { order: [0, 1, 2], negative: [false; 3] };

    /// All 48.
    fn all() -> impl Iterator<Item = Self> {
        let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        orders.into_iter().flat_map(|order| {
            (0..8).map(move |signs| Self { order, negative: [0, 1, 2].map(|axis| (signs >> axis) & 1 == 1) })
        })
    }

    fn of(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        let of = |axis: usize| vector[self.order[axis]] * if self.negative[axis] { -1.0 } else { 1.0 };
        Vector3::from_fn(|axis, _| of(axis))
    }
}

impl std::fmt::Display for Axes {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let of = |axis: usize| {
            format!("{}{}", if self.negative[axis] { "-" } else { "" }, ["x", "y", "z"][self.order[axis]])
        };
        write!(formatter, "({}, {}, {})", of(0), of(1), of(2))
    }
}

/// Mean acceleration along three poses, m/s^2.
fn acceleration(poses: [&ReferencePose; 3]) -> Vector3<f64> {
    let [first, middle, last] = poses;
    let velocity = |from: &ReferencePose, to: &ReferencePose| {
        (to.pose.translation - from.pose.translation) / seconds(from.stamp_ns, to.stamp_ns)
    };
    (velocity(middle, last) - velocity(first, middle)) * (2.0 / seconds(first.stamp_ns, last.stamp_ns))
}

/// Means along poses of the specific force in their frame (m/s^2) and of the rotation, with the weight of a triangle that peaks at the
/// middle one; `None` where poses or readings are missing.
fn mean_force(
    readings: &[ImuSample],
    stretch: &[&ReferencePose],
    middle: usize,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let [begin_ns, middle_ns, end_ns] =
        [stretch.first()?, stretch.get(middle)?, stretch.last()?].map(|known| known.stamp_ns);
    let weight = |stamp_ns: i64| {
        if stamp_ns < middle_ns {
            seconds(begin_ns, stamp_ns) / seconds(begin_ns, middle_ns)
        } else {
            seconds(stamp_ns, end_ns) / seconds(middle_ns, end_ns)
        }
    };
    let (mut force, mut turned) = (Vector3::zeros(), Matrix3::zeros());
    for pair in stretch.windows(2) {
        if pair[1].stamp_ns - pair[0].stamp_ns > MAX_GAP_NS {
            return None;
        }
        let (mut rotation, mut stamp_ns) = (pair[0].pose.rotation, pair[0].stamp_ns);
        for step in steps(readings, pair[0].stamp_ns, pair[1].stamp_ns)? {
            let next = rotation * step.turn();
            let next_ns = stamp_ns + (step.seconds * 1e9).round() as i64;
            let half = 0.5 * step.seconds;
            let [before, after] = [weight(stamp_ns), weight(next_ns)];
            force += (rotation * step.first.accelerometer * before
                + next * step.second.accelerometer * after)
                * half;
            turned += (rotation.to_rotation_matrix().into_inner() * before
                + next.to_rotation_matrix().into_inner() * after)
                * half;
            (rotation, stamp_ns) = (next, next_ns);
        }
    }
    let whole = 2.0 / seconds(begin_ns, end_ns);
    let is_finite = force.iter().chain(&turned).all(|value| value.is_finite());
    is_finite.then(|| (force * whole, turned * whole))
}

fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    (to_ns - from_ns) as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pose;
    use geometry::rotation::exp;
    use nalgebra::UnitQuaternion;

    type Change = fn(Vector3<f64>) -> Vector3<f64>;

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
                accelerometer: rotation(t).inverse() * force + Vector3::new(0.4, -0.4, 0.7),
            }
        };
        let pose = |index: i64| {
            let t = index as f64 * 0.05;
            let off = Vector3::new((37.0 * t).sin(), (41.0 * t).cos(), (43.0 * t).sin()) * 0.01;
            let pose = Pose { rotation: rotation(t), translation: position(t) + off };
            ReferencePose::isotropic(index * 50_000_000, pose, 0.01, 0.02)
        };
        ((0..6000).map(reading).collect(), (0..600).map(pose).collect())
    }

    fn moved(poses: &[ReferencePose], change: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Vec<ReferencePose> {
        let moved = |known: &ReferencePose| {
            let mut known = *known;
            known.pose.translation = change(known.pose.translation);
            known
        };
        poses.iter().map(moved).collect()
    }

    fn later(poses: &[ReferencePose], by_ns: i64) -> Vec<ReferencePose> {
        poses.iter().map(|known| ReferencePose { stamp_ns: known.stamp_ns + by_ns, ..*known }).collect()
    }

    #[test]
    fn positions_in_metres_pass_wherever_their_frame_is() {
        let (readings, poses) = carried();
        check_accelerations(&readings, &poses).unwrap();
        check_accelerations(&readings, &moved(&poses, |at| at + Vector3::new(1e4, -2e3, 50.0))).unwrap();
        let turn: UnitQuaternion<f64> = exp(&Vector3::new(0.3, -1.0, 2.0));
        let turned: Vec<ReferencePose> = poses
            .iter()
            .map(|known| {
                let pose =
                    Pose { rotation: turn * known.pose.rotation, translation: turn * known.pose.translation };
                ReferencePose { pose, ..*known }
            })
            .collect();
        check_accelerations(&readings, &turned).unwrap();
    }

    #[test]
    fn there_is_no_verdict_on_poses_that_tell_nothing_or_follow_late() {
        let (readings, poses) = carried();
        check_accelerations(&[], &poses).unwrap();
        check_accelerations(&readings, &moved(&poses[..150], |at| at * 1000.0)).unwrap();
        check_accelerations(&readings[..1], &moved(&poses, |at| at * 1000.0)).unwrap();
        check_accelerations(&readings, &moved(&poses, |_| Vector3::zeros())).unwrap();
        for by_ms in [100, 300, 1000, 3000] {
            check_accelerations(&readings, &later(&poses, by_ms * 1_000_000)).unwrap();
        }
    }

    #[test]
    fn positions_of_another_unit_or_scale_are_refused() {
        let (readings, poses) = carried();
        for factor in [1000.0, 100.0, 1.0 / 0.3048, 0.5, 0.3048, 0.1] {
            let error =
                check_accelerations(&readings, &moved(&poses, |at| at * factor)).unwrap_err().to_string();
            assert!(error.contains("times as much as the IMU"), "{error}");
        }
    }

    #[test]
    fn positions_on_other_axes_are_refused_with_those_that_fit() {
        let (readings, poses) = carried();
        let changes: [(Change, &str); 4] = [
            (|at| Vector3::new(at.x, at.y, -at.z), "(x, y, -z)"),
            (|at| Vector3::new(at.y, at.x, -at.z), "(y, x, -z)"),
            (|at| Vector3::new(at.y, -at.x, at.z) * 1000.0, "(-y, x, z)"),
            (|at| Vector3::new(at.y, at.z, at.x), "(z, x, y)"),
        ];
        for (change, axes) in changes {
            let error = check_accelerations(&readings, &moved(&poses, change)).unwrap_err().to_string();
            assert!(error.contains(axes), "{error}");
        }
    }

    /// Its poses are exact in the plane; its accelerometer has a bias and is tilted.
    #[test]
    fn a_robot_that_drives_slowly_in_circles_passes() {
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
    }
}
