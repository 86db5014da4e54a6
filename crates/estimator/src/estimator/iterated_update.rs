//! The MSCKF update, linearized again where it moves the state far.
//!
//! A robot with one camera that drives off knows its displacement to half of itself, and its turn to a pixel of the two or three
//! by which its tracks have moved. The landmarks that these poses give are too near on one side and too far on the other, half of
//! them behind the camera; an update with their Jacobians overshoots, and the scale that follows is wrong by half (one of
//! 48 drives: 6 m of error at centimetres of standard deviation). At the corrected poses nearly all tracks can be triangulated.
//!
//! A correction is far where it is larger than its own standard deviation explains. Then the tracks are linearized again at the
//! corrected state, as the prior is still that of the uncorrected one: the Gauss-Newton method for the maximum a posteriori. The
//! point of linearization moves by [`first_estimates::renew`], so that nothing is learned about the gauge. It is not moved
//! without need: a renewal keeps the gauge of translation and rotation, not the scale of one camera, which every renewal makes seem a
//! little better known.
//!
//! Source: Bell & Cathey, "The iterated Kalman filter update as a Gauss-Newton method", IEEE TAC 1993.

use super::Estimator;
use super::track_update::OdometryUpdate;
use crate::error::EstimatorError;
use crate::first_estimates;
use crate::odometry::msckf_update::TrackReport;
use crate::odometry::tracks::Track;
use crate::propagation::GYROSCOPE_BIAS;
use crate::state::ActiveState;
use nalgebra::DVector;

/// Correction of a component of rotation, position or velocity that is far, in its standard deviations: one in a hundred.
const FAR_SIGMAS: f64 = 2.5;
/// A correction that differs less from the one before, in its standard deviations, is final.
const FINAL_SIGMAS: f64 = 0.3;
/// Most linearizations of an update. Most far corrections were final at the third; that of a robot that drives off still changed by half
/// of its standard deviation at the fifth.
const MAX_LINEARIZATIONS: usize = 5;

impl Estimator {
    /// Updates the state with the finished tracks, and initializes SLAM features from those that are still tracked.
    ///
    /// # Arguments
    /// * `in_state`: number of SLAM features.
    pub(super) fn msckf_update(
        &mut self,
        update: &mut OdometryUpdate,
        in_state: usize,
    ) -> Result<TrackReport, EstimatorError> {
        let vacant = self.config.slam_features.saturating_sub(in_state);
        let OdometryUpdate { finished, msckf, there, before, .. } = update;
        let (covariance, settings) = (&self.covariance, &self.msckf_settings);
        let mut report = msckf.collect(&self.state, None, covariance, finished, settings, up_to(vacant));
        for linearization in 1..=MAX_LINEARIZATIONS {
            if msckf.information.rows == 0 {
                break;
            }
            let may_iterate = self.config.first_estimates && linearization < MAX_LINEARIZATIONS;
            let last = (linearization > 1).then_some(before.as_slice());
            let accept = |correction: &DVector<f64>, sigma: &dyn Fn(usize) -> f64| {
                !may_iterate || is_final(correction, last, sigma)
            };
            if self.covariance.information_update_if(&msckf.information, &mut self.correction, accept)? {
                self.state.retract(&self.correction);
                break;
            }
            before.clear();
            before.extend_from_slice(self.correction.as_slice());
            let there = self.corrected(there);
            let (covariance, settings) = (&self.covariance, &self.msckf_settings);
            let ahead = Some(&self.correction);
            report = msckf.collect(there, ahead, covariance, finished, settings, up_to(vacant));
        }
        for nis_per_row in msckf.nis_per_row.drain(..) {
            self.noise.note_track(nis_per_row);
        }
        self.tracks.recycle(finished);
        self.insert_slam_features(msckf);
        Ok(report)
    }

    /// The corrected state as the next point of linearization, to which the covariance is carried.
    ///
    /// # Arguments
    /// * `there`: lends its memory.
    fn corrected<'a>(&mut self, there: &'a mut Option<ActiveState>) -> &'a ActiveState {
        let there = there.get_or_insert_with(|| self.state.clone());
        there.copy_from(&self.state);
        there.retract(&self.correction);
        first_estimates::renew(there, &mut self.covariance);
        first_estimates::adopt(&mut self.state, there);
        there
    }
}

/// Accepts so many SLAM features.
fn up_to(mut vacant: usize) -> impl FnMut(&Track) -> bool {
    move |_| {
        let accepted = vacant > 0;
        vacant -= usize::from(accepted);
        accepted
    }
}

/// Whether the state may be corrected: by what can be expected, or by as much as at the linearization before.
fn is_final(correction: &DVector<f64>, before: Option<&[f64]>, sigma: &dyn Fn(usize) -> f64) -> bool {
    let mut motion = 0..GYROSCOPE_BIAS;
    match before {
        None => motion.all(|k| correction[k].abs() <= FAR_SIGMAS * sigma(k)),
        Some(before) => motion.all(|k| (correction[k] - before[k]).abs() <= FINAL_SIGMAS * sigma(k)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{EstimatorConfig, InitialSigmas};
    use crate::covariance::JointCovariance;
    use crate::gate::Gate;
    use crate::initialization::static_init::InitialState;
    use crate::odometry::msckf_update::MsckfUpdate;
    use crate::odometry::tracks::CloneObservation;
    use crate::state::{Block, POSE_DIM};
    use crate::test_scene::scene;
    use geometry::Pose;
    use nalgebra::{DMatrix, Vector3};

    /// A window whose poses are uncertain by a large part of the parallax, and tracks of 40 landmarks from the true poses.
    fn uncertain_window() -> (Estimator, OdometryUpdate) {
        let scene = scene(false);
        let cameras = scene.state.calibration.cameras.clone();
        let still = InitialState::from_truth(
            0,
            &Pose::identity(),
            &Vector3::zeros(),
            &-Vector3::z(),
            InitialSigmas::default(),
        );
        let mut estimator = Estimator::new(EstimatorConfig::default(), cameras, &still).unwrap();
        estimator.state = scene.state;
        let state = &mut estimator.state;
        for clone in &mut state.clones {
            clone.first_estimate = clone.local_from_imu;
        }
        let dim = state.dim();
        let mut root = DMatrix::from_fn(dim, dim, |i, j| 1e-4 * ((3 * i + 7 * j + i * j) as f64).sin());
        root.fill_diagonal(0.004);
        // The newest clone is the pose of the IMU.
        for k in 0..POSE_DIM {
            let of_clone = root.row(dim - POSE_DIM + k).into_owned();
            root.row_mut(k).copy_from(&of_clone);
        }
        let covariance = &root * root.transpose();
        let error = &root * DVector::from_fn(dim, |k, _| 4.0 * (1.7 * k as f64).cos());
        let mut truth = state.clone();
        truth.retract(&error);
        let mut update = OdometryUpdate::default();
        for feature_id in 0..40 {
            let wave = |k: f64| (k * (feature_id + 1) as f64).sin();
            let landmark = Vector3::new(2.0 * wave(0.7), 2.0 * wave(1.3), 5.0 + wave(2.1));
            let observations = truth.clones.iter().filter_map(|clone| {
                let pixel = truth.calibration.cameras[0].predict(&clone.local_from_imu, &landmark)?;
                Some(CloneObservation { clone: clone.id, camera: 0, pixel })
            });
            update.finished.push(Track { feature_id, observations: observations.collect() });
        }
        estimator.covariance = JointCovariance::new(covariance, 4);
        estimator.config.slam_features = 0;
        // All tracks are used at all linearizations.
        (estimator.msckf_settings.gate, estimator.msckf_settings.outlier_sigmas) =
            (Gate::new(1.0 - 1e-12), 1e3);
        (estimator, update)
    }

    /// Distance of the state after an update from the maximum a posteriori, relative to its correction: there the gradients of
    /// prior and pixels are opposite, so that the state has moved by P times that of the pixels.
    fn distance_from_maximum(iterated: bool) -> f64 {
        let (mut estimator, mut update) = uncertain_window();
        estimator.config.first_estimates = iterated;
        let prior = estimator.clone();
        let mut tracks = update.finished.clone();
        let report = estimator.msckf_update(&mut update, 0).unwrap();
        assert!(report.used > 30, "{report:?}");
        let state = &mut estimator.state;
        let clones = state.range(Block::Clone(0)).unwrap().start..state.dim();
        let mut moved = DVector::zeros(clones.len());
        for (index, (new, old)) in state.clones.iter_mut().zip(&prior.state.clones).enumerate() {
            let step = old.local_from_imu.local(&new.local_from_imu);
            moved.fixed_rows_mut::<POSE_DIM>(POSE_DIM * index).copy_from(&step);
            new.first_estimate = new.local_from_imu;
        }
        let mut msckf = MsckfUpdate::default();
        msckf.collect(state, None, &prior.covariance, &mut tracks, &prior.msckf_settings, |_| false);
        let gradient = DVector::from_column_slice(&msckf.information.vector);
        let of_clones = prior.covariance.active().view();
        let expected = of_clones.view((clones.start, clones.start), (clones.len(), clones.len())) * gradient;
        (&moved - expected).norm() / moved.norm()
    }

    #[test]
    fn the_state_is_the_maximum_a_posteriori_of_prior_and_pixels() {
        let (once, iterated) = (distance_from_maximum(false), distance_from_maximum(true));
        assert!(iterated < 0.05 && once > 4.0 * iterated, "{once} {iterated}");
    }

    #[test]
    fn a_correction_that_its_covariance_explains_is_final() {
        let sigma: &dyn Fn(usize) -> f64 = &|_| 0.1;
        let small = DVector::from_element(20, 0.2);
        assert!(is_final(&small, None, sigma));
        let mut far = small.clone();
        far[2] = 0.3;
        assert!(!is_final(&far, None, sigma));
        // Biases may move as they like: they follow the motion.
        let mut bias = small.clone();
        bias[GYROSCOPE_BIAS] = 1.0;
        assert!(is_final(&bias, None, sigma));
        assert!(
            !is_final(&far, Some(small.as_slice()), sigma) && is_final(&far, Some(far.as_slice()), sigma)
        );
    }
}
