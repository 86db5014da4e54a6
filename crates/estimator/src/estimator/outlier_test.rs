//! Outlier test of an answer that contradicts the state: perceptual aliasing, or a wrong state.

use super::Estimator;
use crate::state::CloneId;
use geometry::{Pose, PoseWithCovariance};

/// Squared Mahalanobis distance beyond which an answer is far from the state: ten sigmas in each of six directions. A state
/// propagated by the IMU alone for seconds is wrong by five now and then, and must still accept answers; perceptual aliasing
/// with a place ten metres away gives fifty.
const MAX_MAHALANOBIS_SQUARED: f64 = 6.0 * 100.0;
/// Two answers agree when their distance is at most this fraction of that to the state.
const AGREEMENT_FRACTION: f64 = 0.25;
/// Or, for the rotation, at most this angle, rad: about the rotation errors between keyframes of a map.
const AGREEMENT_RAD: f64 = 0.05;

impl Estimator {
    /// Whether an answer may update the state.
    ///
    /// The verified landmarks of an answer are consistent with each other, so they are right or wrong together. Where fewer
    /// than half of them agree with the state and their pose is far from it, either the place is another one or the state
    /// is wrong. Two consecutive answers that agree with each other much better than with the state show that it is the
    /// state.
    ///
    /// # Arguments
    /// * `agrees`: at least half of the landmarks agree with the state.
    /// * `clone`, `camera`: of the image.
    /// * `measured`: the camera in G at `clone` according to the answer, with the covariance of the keyframe.
    pub(super) fn passes_outlier_test(
        &mut self,
        agrees: bool,
        (clone, camera): (CloneId, usize),
        measured: &PoseWithCovariance,
    ) -> bool {
        let (Some(index), Some(state), Some(calibrated)) =
            (self.state.clone_index(clone), self.global_from_camera(clone, camera), self.camera(camera))
        else {
            return true;
        };
        let predicted =
            PoseWithCovariance { pose: state.pose, covariance: state.covariance + measured.covariance };
        if agrees || predicted.nees(&measured.pose).is_some_and(|squared| squared <= MAX_MAHALANOBIS_SQUARED)
        {
            self.contradiction = None;
            return true;
        }
        let local_from_camera = self.state.clones[index].local_from_imu * calibrated.imu_from_camera;
        let before = self.contradiction.replace(measured.pose * local_from_camera.inverse());
        let confirmed = before.is_some_and(|before| {
            let distances = |other: &Pose| {
                let error = measured.pose.local(other);
                (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm())
            };
            let (from_state, from_before) =
                (distances(&state.pose), distances(&(before * local_from_camera)));
            from_before.0 <= (AGREEMENT_FRACTION * from_state.0).max(AGREEMENT_RAD)
                && from_before.1 <= AGREEMENT_FRACTION * from_state.1
        });
        if !confirmed {
            // Answers that contradict each other are no evidence against the state.
            self.rejections_in_a_row = 0;
        }
        confirmed
    }
}
