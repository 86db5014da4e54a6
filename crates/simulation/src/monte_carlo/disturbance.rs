//! An undetected failure of the filter in the middle of a run, and its rescue by the map.
//!
//! The state is moved without telling the covariance, as a fault would. Where the filter notices and gives up, it is
//! initialized again from IMU and tracks, as on a robot.

use estimator::{Estimator, Localization};
use geometry::Pose;
use nalgebra::Vector3;

/// Chi-square with 6 degrees of freedom at 99.73 %, the confidence of three standard deviations.
pub(super) const THREE_SIGMA: f64 = 20.06;
/// Position error of a rescued pose in G, metres.
const RESCUED_M: f64 = 0.3;
/// Chi-square with 6 degrees of freedom at the confidence of five standard deviations, all but 5.7e-7.
const FIVE_SIGMA: f64 = 39.5;

/// What is moved, in a direction of its own for each seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DisturbedState {
    /// The position, metres.
    Position(f64),
    /// The velocity, m/s.
    Velocity(f64),
    /// The rotation about gravity, rad.
    Yaw(f64),
    /// The rotation about a horizontal axis, rad.
    Tilt(f64),
    /// All biases, standard deviations.
    Biases(f64),
}

/// Failures of the same run, each for itself: until then the run is one.
#[derive(Clone, Debug, PartialEq)]
pub struct Disturbance {
    /// Time, seconds from the first image.
    pub at_s: f64,
    /// What is moved, in one failure each.
    pub states: Vec<DisturbedState>,
}

/// The rescue after a failure.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rescue {
    /// Whether the pose in G was localized and within three sigmas and 0.3 m after each answer since the failure.
    pub right: Vec<bool>,
    /// The longest time in which the pose in G was wrong by more than five sigmas while the status was localized, seconds.
    pub wrong_s: f64,
    wrong_since_ns: Option<i64>,
}

impl DisturbedState {
    /// Moves the state of a filter.
    pub(super) fn apply(self, seed: u64, estimator: &mut Estimator) {
        // Directions by the golden angle: all are covered, whatever the number of seeds.
        let angle = seed as f64 * 2.399_963;
        let horizontal = Vector3::new(angle.cos(), angle.sin(), 0.0);
        let mut error = [0.0; 15];
        let mut put = |begin: usize, value: Vector3<f64>| {
            error[begin..begin + 3].copy_from_slice(value.as_slice());
        };
        match self {
            DisturbedState::Position(metres) => put(3, horizontal * metres),
            DisturbedState::Velocity(speed) => put(6, horizontal * speed),
            DisturbedState::Yaw(rad) => put(0, Vector3::z() * rad),
            DisturbedState::Tilt(rad) => put(0, horizontal * rad),
            DisturbedState::Biases(sigmas) => {
                let (gyroscope, accelerometer) = estimator.sigma_biases();
                let sign = Vector3::new(1.0, -1.0, if seed.is_multiple_of(2) { 1.0 } else { -1.0 });
                put(9, gyroscope.component_mul(&sign) * sigmas);
                put(12, accelerometer.component_mul(&sign) * sigmas);
            }
        }
        estimator.displace(&error);
    }
}

impl Rescue {
    /// Takes in the state after an image.
    ///
    /// # Arguments
    /// * `is_answered`: an answer came with it.
    pub(super) fn note(&mut self, estimator: &Estimator, global_from_imu: &Pose, is_answered: bool) {
        let stamp_ns = estimator.stamp_ns();
        let localized = estimator.status().localization == Localization::Localized;
        let pose = estimator.global_from_imu().filter(|_| localized);
        let squared = pose.and_then(|pose| pose.nees(global_from_imu));
        let metres = pose.map(|pose| (pose.pose.translation - global_from_imu.translation).norm());
        let is_right =
            squared.zip(metres).is_some_and(|(squared, metres)| squared < THREE_SIGMA && metres < RESCUED_M);
        if is_answered {
            self.right.push(is_right);
        }
        if localized && squared.is_none_or(|squared| squared > FIVE_SIGMA) {
            let since_ns = *self.wrong_since_ns.get_or_insert(stamp_ns);
            self.wrong_s = self.wrong_s.max((stamp_ns - since_ns) as f64 * 1e-9);
        } else {
            self.wrong_since_ns = None;
        }
    }
}
