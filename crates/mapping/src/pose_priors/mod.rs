//! Poses and positions that are known besides the recording: of a total station, GNSS, surveyed marks, tags.
//!
//! They define G, whose z axis must point up. A measurement between two views holds for the nearest one: readings of the
//! IMU bridge the time from the image before it.

mod alignment;

use adjustment::MeasuredPose;
use estimator::imu::ImuBuffer;
use estimator::propagation::{MotionEstimate, propagate};
use geometry::pose::Pose;
use nalgebra::{Matrix3, Matrix6, Vector3};
use sensors::{ImuSample, ReferencePose, ReferencePosition};

use super::error::BuildError;
use super::keyframe_view::KeyframeView;
use super::odometry::Odometry;
use super::readings::{IMU_SLACK_NS, buffered};
use alignment::{LocatedPrior, align};

/// A measurement further than this behind an image is left out (ns): readings alone do not bridge more.
const MAX_BRIDGED_NS: i64 = 1_000_000_000;
/// What the odometry between a view and a measurement adds to the standard deviations of the measurement, a metre of
/// distance (m) and a second (rad, m): it drifts less.
const SIGMA_A_METRE: f64 = 0.01;
const SIGMAS_A_SECOND: [f64; 2] = [1e-4, 1e-3];

/// Poses and positions in G that are known at some times.
///
/// # Example
/// ```
/// use mapping::PosePriors;
/// use nalgebra::{Matrix3, Vector3};
///
/// let mut priors = PosePriors::default();
/// priors.lever_arm = Vector3::new(0.0, 0.1, 0.2);
/// priors.positions.push(sensors::ReferencePosition {
///     stamp_ns: 1_403_636_580_838_555_574,
///     position: Vector3::new(4.0, -1.5, 0.7),
///     covariance: Matrix3::identity() * 0.05_f64.powi(2),
/// });
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct PosePriors {
    /// Positions of a point of the robot, for example of an antenna or a prism, with independent errors.
    pub positions: Vec<ReferencePosition>,
    /// That point in the frame of the IMU (m).
    pub lever_arm: Vector3<f64>,
    /// Poses of the IMU, with independent errors.
    pub poses: Vec<ReferencePose>,
}

impl PosePriors {
    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of poses and positions.
    pub fn len(&self) -> usize {
        self.positions.len() + self.poses.len()
    }

    /// Takes the errors of positions for correlated in time: each states its covariance times the number of positions
    /// within the correlation time, so that together they are worth one. Sorts the positions by time.
    ///
    /// # Arguments
    /// * `seconds`: for example 60 for GNSS without corrections.
    pub fn correlate_positions(&mut self, seconds: f64) {
        self.positions.sort_by_key(|known| known.stamp_ns);
        let half_ns = (seconds * 0.5e9) as i64;
        let stamps_ns: Vec<i64> = self.positions.iter().map(|known| known.stamp_ns).collect();
        for known in &mut self.positions {
            let begin = stamps_ns.partition_point(|&stamp_ns| stamp_ns < known.stamp_ns - half_ns);
            let end = stamps_ns.partition_point(|&stamp_ns| stamp_ns <= known.stamp_ns + half_ns);
            known.covariance *= (end - begin).max(1) as f64;
        }
    }

    /// Aligns the odometry with them; `None` without any.
    ///
    /// # Errors
    /// [`BuildError::PosePriorsOutside`], [`BuildError::YawUnknown`].
    pub(super) fn aligned(
        &self,
        odometry: &Odometry,
        readings: &[ImuSample],
    ) -> Result<Option<AlignedPriors>, BuildError> {
        if self.is_empty() {
            return Ok(None);
        }
        let mut located = self.located(odometry, &buffered(readings))?;
        let global_from_local = align(&located)?;
        for known in &mut located {
            known.odometry_from_imu = global_from_local.compose(&known.odometry_from_imu);
        }
        Ok(Some(AlignedPriors { odometry: odometry.moved(&global_from_local), located }))
    }

    /// The measurements at times that the odometry covers, each with the pose of the IMU in L then.
    ///
    /// # Errors
    /// [`BuildError::PosePriorsOutside`] where there is none.
    fn located(&self, odometry: &Odometry, readings: &ImuBuffer) -> Result<Vec<LocatedPrior>, BuildError> {
        let positions = self.positions.iter().map(|known| LocatedPrior {
            stamp_ns: known.stamp_ns,
            odometry_from_imu: Pose::identity(),
            point_in_imu: self.lever_arm,
            position: known.position,
            rotation: None,
            covariance: with_position_covariance(&known.covariance),
        });
        let poses = self.poses.iter().map(|known| LocatedPrior {
            stamp_ns: known.stamp_ns,
            odometry_from_imu: Pose::identity(),
            point_in_imu: Vector3::zeros(),
            position: known.pose.translation,
            rotation: Some(known.pose.rotation),
            covariance: known.covariance,
        });
        let locate = |known: LocatedPrior| {
            let odometry_from_imu = pose_at(odometry, readings, known.stamp_ns)?;
            Some(LocatedPrior { odometry_from_imu, ..known })
        };
        let located: Vec<LocatedPrior> = positions.chain(poses).filter_map(locate).collect();
        if located.is_empty() {
            let of = |state: Option<&(i64, _)>| state.map_or(0, |(stamp_ns, _)| *stamp_ns);
            return Err(BuildError::PosePriorsOutside {
                given: self.len(),
                from_ns: of(odometry.states.first()),
                until_ns: of(odometry.states.last()),
            });
        }
        Ok(located)
    }
}

/// Odometry in the frame of pose priors.
pub(super) struct AlignedPriors {
    /// The odometry in G.
    pub(super) odometry: Odometry,
    /// The priors at its times.
    located: Vec<LocatedPrior>,
}

impl AlignedPriors {
    /// The priors as measurements of views.
    ///
    /// # Arguments
    /// * `views`: in order of time.
    pub(super) fn factors(&self, views: &[KeyframeView<'_>], imu_from_camera: &Pose) -> Vec<MeasuredPose> {
        let factor = |known: &LocatedPrior| known.factor(views, &self.odometry, imu_from_camera);
        self.located.iter().filter_map(factor).collect()
    }
}

impl LocatedPrior {
    /// The measurement as one of the nearest view in time.
    ///
    /// # Arguments
    /// * `views`: in order of time, at least one.
    /// * `odometry`: states at the views.
    fn factor(
        &self,
        views: &[KeyframeView<'_>],
        odometry: &Odometry,
        imu_from_camera: &Pose,
    ) -> Option<MeasuredPose> {
        let next = views.partition_point(|view| view.stamp_ns < self.stamp_ns);
        let distance_ns = |view: &usize| views[*view].stamp_ns.abs_diff(self.stamp_ns);
        let view = (next.saturating_sub(1)..(next + 1).min(views.len())).min_by_key(distance_ns)?;
        let at_view = odometry.at(views[view].stamp_ns)?.local_from_imu.compose(imu_from_camera);
        let camera_from_imu = at_view.inverse().compose(&self.odometry_from_imu);
        let seconds = distance_ns(&view) as f64 * 1e-9;
        let moved = (at_view.translation - self.odometry_from_imu.transform(&self.point_in_imu)).norm();
        let mut covariance = self.covariance;
        let sigma_p = (SIGMA_A_METRE * moved).hypot(SIGMAS_A_SECOND[1] * seconds);
        for index in 0..3 {
            covariance[(index, index)] += (SIGMAS_A_SECOND[0] * seconds).powi(2);
            covariance[(index + 3, index + 3)] += sigma_p.powi(2);
        }
        Some(MeasuredPose {
            view,
            point_in_body: camera_from_imu.transform(&self.point_in_imu),
            position: self.position,
            rotation: self.rotation.map(|rotation| rotation * camera_from_imu.rotation.inverse()),
            information: information(&covariance, self.rotation.is_some())?,
        })
    }
}

/// The pose of the IMU in L at a time that the odometry covers.
fn pose_at(odometry: &Odometry, readings: &ImuBuffer, stamp_ns: i64) -> Option<Pose> {
    let next = odometry.states.partition_point(|(state_ns, _)| *state_ns <= stamp_ns);
    let (state_ns, state) = &odometry.states[next.checked_sub(1)?];
    if *state_ns == stamp_ns {
        return Some(state.local_from_imu);
    }
    if stamp_ns - state_ns > MAX_BRIDGED_NS {
        return None;
    }
    let between = readings.interval(*state_ns, stamp_ns, IMU_SLACK_NS).ok()?;
    let config = &odometry.config;
    let first = MotionEstimate::of(state);
    let end = propagate(state, &first, &between, &config.imu_noise, config.gravity).state;
    Some(end.local_from_imu)
}

fn with_position_covariance(covariance: &Matrix3<f64>) -> Matrix6<f64> {
    let mut all = Matrix6::zeros();
    all.fixed_view_mut::<3, 3>(3, 3).copy_from(covariance);
    all
}

/// The inverse covariance; of a position alone, that of the position.
fn information(covariance: &Matrix6<f64>, of_pose: bool) -> Option<Matrix6<f64>> {
    if of_pose {
        return Some(covariance.cholesky()?.inverse());
    }
    let position: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into();
    Some(with_position_covariance(&position.cholesky()?.inverse()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correlated_positions_state_the_same_in_any_order() {
        let known = |second: i64| ReferencePosition {
            stamp_ns: second * 1_000_000_000,
            position: Vector3::zeros(),
            covariance: Matrix3::identity(),
        };
        let correlated = |seconds: &[i64]| {
            let positions = seconds.iter().map(|second| known(*second)).collect();
            let mut priors = PosePriors { positions, ..PosePriors::default() };
            priors.correlate_positions(4.0);
            priors.positions
        };
        let in_order = correlated(&[0, 1, 2, 3, 100]);
        let factors: Vec<f64> = in_order.iter().map(|known| known.covariance[(0, 0)]).collect();
        assert_eq!(factors, [3.0, 4.0, 4.0, 3.0, 1.0]);
        assert_eq!(correlated(&[100, 3, 1, 0, 2]), in_order);
    }
}
