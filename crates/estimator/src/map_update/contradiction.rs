//! An answer that contradicts the state: another place that looks the same, or a state that is off.

use crate::Estimator;
use crate::state::CloneId;
use geometry::{Pose, PoseWithCovariance};

/// An answer is far from the state from this normalized distance squared on: ten deviations in each of six directions. A
/// state that was carried by its IMU alone for seconds is wrong by five now and then, and must still take answers; a place
/// that looks the same ten metres away is wrong by fifty.
const FAR: f64 = 6.0 * 100.0;
/// Two answers agree with each other when they are this part of the way apart that they are from the state.
const AGREE: f64 = 0.25;
/// Or, in their rotation, this far, rad: about what the keyframes of a map differ by.
const ALWAYS_AGREE: f64 = 0.05;

impl Estimator {
    /// Whether an answer may correct the state although most of it contradicts it.
    ///
    /// The verified landmarks of an answer fit together, so they are right together or wrong together. Where fewer than
    /// half of them agree with the state and what they say is far from it, the place is another one or the state is wrong;
    /// two answers in a row that agree with each other much better than with the state say that it is the state.
    ///
    /// # Arguments
    /// * `agrees`: at least half of the landmarks agree with the state.
    /// * `said`: the first camera in G at `clone` by the answer, with the keyframe's covariance.
    pub(crate) fn is_believable(&mut self, agrees: bool, clone: CloneId, said: &PoseWithCovariance) -> bool {
        let (Some(place), Some(state)) = (self.state.place_of(clone), self.global_from_camera(clone)) else {
            return true;
        };
        let apart = PoseWithCovariance { pose: state.pose, covariance: state.covariance + said.covariance };
        if agrees || apart.nees(&said.pose).is_some_and(|squared| squared <= FAR) {
            self.contradiction = None;
            return true;
        }
        let local_from_camera = self.state.clones[place].local_from_imu * self.first_camera().imu_from_camera;
        let before = self.contradiction.replace(said.pose * local_from_camera.inverse());
        let confirmed = before.is_some_and(|before| {
            let lengths = |other: &Pose| {
                let apart = said.pose.local(other);
                (apart.fixed_rows::<3>(0).norm(), apart.fixed_rows::<3>(3).norm())
            };
            let (of_state, of_before) = (lengths(&state.pose), lengths(&(before * local_from_camera)));
            of_before.0 <= (AGREE * of_state.0).max(ALWAYS_AGREE) && of_before.1 <= AGREE * of_state.1
        });
        if !confirmed {
            // Answers that contradict each other say nothing against the state.
            self.rejections_in_a_row = 0;
        }
        confirmed
    }
}
