//! Yaw and position of the odometry's frame L in the frame G of pose priors. Both have z up.
//!
//! Some priors may be wrong, and the odometry drifts, so the hypothesis with the least median distance is taken.
//!
//! Source: Rousseeuw, "Least median of squares regression", J. Am. Stat. Assoc. 1984.

use geometry::median;
use geometry::pose::Pose;
use geometry::rotation;
use nalgebra::{Matrix6, UnitQuaternion, Vector3};

use crate::error::BuildError;

/// This many pairs of measurements are tried, at most twice.
const PAIRS: usize = 200;
/// Distances within this many medians are those of correct measurements: 2.5 standard deviations of a Gaussian.
const INLIER_MEDIANS: f64 = 3.7;
/// Largest standard deviation of yaw (rad): the adjustment is linear in it.
const MAX_SIGMA_YAW: f64 = 0.2;

/// A measurement, and where the odometry saw the IMU then.
#[derive(Clone, Debug)]
pub(crate) struct LocatedPrior {
    /// Time (ns).
    pub(crate) stamp_ns: i64,
    /// The IMU in the frame of the odometry.
    pub(crate) odometry_from_imu: Pose,
    /// The point that was measured, in the frame of the IMU (m).
    pub(crate) point_in_imu: Vector3<f64>,
    /// Its measured position in G (m).
    pub(crate) position: Vector3<f64>,
    /// Measured rotation of `global_from_imu`.
    pub(crate) rotation: Option<UnitQuaternion<f64>>,
    /// Covariance of the error `[δθ, δp]` in G; of a position, zero for the rotation.
    pub(crate) covariance: Matrix6<f64>,
}

impl LocatedPrior {
    fn in_local(&self) -> Vector3<f64> {
        self.odometry_from_imu.transform(&self.point_in_imu)
    }

    /// Variance of the position along an axis, the mean of the horizontal ones (m^2).
    fn variance(&self) -> f64 {
        0.5 * (self.covariance[(3, 3)] + self.covariance[(4, 4)])
    }
}

/// The transform `global_from_local`, a rotation about z and a translation.
///
/// # Errors
/// [`BuildError::YawUnknown`] for positions that are too close together.
pub(crate) fn align(known: &[LocatedPrior]) -> Result<Pose, BuildError> {
    let best = hypotheses(known)
        .map(|hypothesis| (median_distance(known, &hypothesis), hypothesis))
        .min_by(|(a, _), (b, _)| a.total_cmp(b));
    let Some((median, best)) = best else { return Err(yaw_unknown(known)) };
    let inlier = |known: &&LocatedPrior| distance(known, &best) <= INLIER_MEDIANS * median;
    let inliers: Vec<&LocatedPrior> = known.iter().filter(inlier).collect();
    if inliers.iter().any(|known| known.rotation.is_some()) {
        return Ok(best);
    }
    let moment = |known: &[&LocatedPrior]| {
        let middle = mean(known.iter().map(|known| known.in_local()));
        let spread = |known: &&LocatedPrior| (known.in_local() - middle).xy().norm_squared();
        known.iter().map(|known| spread(known) / known.variance()).sum::<f64>()
    };
    if moment(&inliers) < MAX_SIGMA_YAW.powi(-2) {
        return Err(yaw_unknown(known));
    }
    Ok(least_squares(&inliers))
}

/// One for each rotation, and one for each of some pairs of positions far apart in time.
fn hypotheses(known: &[LocatedPrior]) -> impl Iterator<Item = Pose> + '_ {
    let of_rotations = known.iter().filter_map(|known| {
        let turn = known.rotation? * known.odometry_from_imu.rotation.inverse();
        let matrix = turn.to_rotation_matrix();
        let yaw = (matrix[(1, 0)] - matrix[(0, 1)]).atan2(matrix[(0, 0)] + matrix[(1, 1)]);
        Some(transform(yaw, &known.in_local(), &known.position))
    });
    let count = known.len();
    let of_pairs = (0..count).step_by(count.div_ceil(PAIRS)).flat_map(move |first| {
        [count / 2, count / 3].into_iter().filter_map(move |apart| {
            let pair = [&known[first], &known[(first + apart) % count]];
            (apart > 0 && pair[0].stamp_ns != pair[1].stamp_ns).then(|| least_squares(&pair))
        })
    });
    of_rotations.chain(of_pairs)
}

/// The rotation about z and the translation that fit best.
fn least_squares(known: &[&LocatedPrior]) -> Pose {
    let local = mean(known.iter().map(|known| known.in_local()));
    let global = mean(known.iter().map(|known| known.position));
    let (mut sine, mut cosine) = (0.0, 0.0);
    for known in known {
        let (from, to) = (known.in_local() - local, known.position - global);
        sine += from.x * to.y - from.y * to.x;
        cosine += from.x * to.x + from.y * to.y;
    }
    transform(sine.atan2(cosine), &local, &global)
}

fn transform(yaw: f64, local: &Vector3<f64>, global: &Vector3<f64>) -> Pose {
    let rotation = rotation::exp(&Vector3::new(0.0, 0.0, yaw));
    Pose::new(rotation, global - rotation * local)
}

fn distance(known: &LocatedPrior, global_from_local: &Pose) -> f64 {
    (global_from_local.transform(&known.in_local()) - known.position).norm()
}

fn median_distance(known: &[LocatedPrior], global_from_local: &Pose) -> f64 {
    let mut distances: Vec<f64> = known.iter().map(|known| distance(known, global_from_local)).collect();
    median(&mut distances).unwrap_or(f64::INFINITY)
}

fn mean(vectors: impl ExactSizeIterator<Item = Vector3<f64>>) -> Vector3<f64> {
    let count = vectors.len() as f64;
    vectors.sum::<Vector3<f64>>() / count
}

fn yaw_unknown(known: &[LocatedPrior]) -> BuildError {
    let middle = mean(known.iter().map(LocatedPrior::in_local));
    let extent = |known: &LocatedPrior| (known.in_local() - middle).xy().norm();
    BuildError::YawUnknown {
        positions: known.len(),
        extent_m: known.iter().map(extent).fold(0.0, f64::max),
        sigma_m: known.iter().map(LocatedPrior::variance).fold(0.0, f64::max).sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions on an arc, every `wrong`th 20 m off.
    fn known(radius: f64, wrong: usize) -> (Pose, Vec<LocatedPrior>) {
        let truth = transform(2.5, &Vector3::new(1.0, 2.0, 3.0), &Vector3::new(100.0, -40.0, 7.0));
        let of = |index: usize| {
            let (sine, cosine) = (0.05 * index as f64).sin_cos();
            let odometry_from_imu = Pose::new(
                rotation::exp(&Vector3::new(0.1, 0.2, cosine)),
                Vector3::new(sine, cosine, 0.1) * radius,
            );
            let point_in_imu = Vector3::new(0.1, 0.0, 0.3);
            let off = if index % wrong == 1 { 20.0 } else { 0.0 };
            LocatedPrior {
                stamp_ns: index as i64,
                odometry_from_imu,
                point_in_imu,
                position: truth.transform(&odometry_from_imu.transform(&point_in_imu)) + Vector3::repeat(off),
                rotation: None,
                covariance: Matrix6::identity() * 1e-4,
            }
        };
        (truth, (0..40).map(of).collect())
    }

    #[test]
    fn a_third_of_wrong_positions_does_not_move_the_frame() {
        for wrong in [3, 7, 100] {
            let (truth, known) = known(5.0, wrong);
            let found = align(&known).unwrap();
            assert!(found.local(&truth).amax() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn a_single_pose_gives_yaw_and_positions_too_close_together_are_refused() {
        let (truth, mut known) = known(0.01, 100);
        known.truncate(10);
        let error = align(&known).unwrap_err().to_string();
        assert!(error.contains("yaw") && error.contains("0.010"), "{error}");
        known.truncate(1);
        assert!(matches!(align(&known), Err(BuildError::YawUnknown { .. })));
        known[0].rotation = Some(truth.rotation * known[0].odometry_from_imu.rotation);
        assert!(align(&known).unwrap().local(&truth).amax() < 1e-9);
    }
}
