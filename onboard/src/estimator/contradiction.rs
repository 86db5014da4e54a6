//! An answer that contradicts the state: another place that looks the same, or a state that is off.

use super::Estimator;
use super::map_rows::MapPoint;
use geometry::Pose;

/// Two answers agree with each other when they are this part of the way apart that they are from the state.
const AGREE: f64 = 0.25;
/// Or, in their rotation, this far, rad: about what the keyframes of a map differ by.
const ALWAYS_AGREE: f64 = 0.05;

impl Estimator {
    /// Whether an answer may correct the state although most of it contradicts it.
    ///
    /// The verified landmarks of an answer fit together, so they are right together or wrong together. Where fewer than
    /// half of them agree with the state, the place is another one or the state is off; two answers in a row that agree
    /// with each other much better than with the state say that it is the state.
    pub(super) fn is_believable(
        &mut self,
        contradicts: bool,
        solved: &MapPoint,
        estimate: &MapPoint,
    ) -> bool {
        if !contradicts {
            self.contradiction = None;
            return true;
        }
        let body = |transform: &Pose| *transform * solved.local_from_imu;
        let now = body(&solved.global_from_local);
        let before = self.contradiction.replace(solved.global_from_local);
        let [of_state, of_before] = [Some(estimate.global_from_local), before].map(|transform| {
            let apart = now.local(&body(&transform?));
            Some((apart.fixed_rows::<3>(0).norm(), apart.fixed_rows::<3>(3).norm()))
        });
        of_state.zip(of_before).is_some_and(|(state, before)| {
            before.0 <= (AGREE * state.0).max(ALWAYS_AGREE) && before.1 <= AGREE * state.1
        })
    }
}
