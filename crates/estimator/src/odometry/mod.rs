//! The odometry's part of an image: standing still, tracks, and landmarks in the state.

pub mod landmark_rows;
pub mod pixel_rows;
pub mod slam_features;
pub mod track_update;
pub mod tracks;
pub mod zero_velocity;

use crate::measurement::LinearizedMeasurement;
use crate::odometry::pixel_rows::Layout;
use crate::odometry::slam_features::{LandmarkSettings, LandmarkUpdate};
use crate::odometry::track_update::{TrackReport, TrackUpdate};
use crate::odometry::tracks::{Track, TrackObservation};
use crate::state::{CloneId, SlamFeature};
use crate::{Estimator, EstimatorError, surplus};
use nalgebra::DMatrix;

/// What an image's update works with, kept from one image to the next.
#[derive(Clone, Debug, Default)]
pub(crate) struct OdometryUpdate {
    ready: Vec<Track>,
    tracks: TrackUpdate,
    landmarks: LandmarkUpdate,
    zero_velocity: LinearizedMeasurement,
}

impl Estimator {
    /// Takes the tracks of the newest image, corrects the state by those that ended or fill the
    /// window and by the landmarks in the state, and lets the oldest clone go when the window is full.
    ///
    /// # Errors
    /// [`EstimatorError::Diverged`].
    pub fn track_update(&mut self, observations: &[TrackObservation]) -> Result<TrackReport, EstimatorError> {
        let Some(newest) = self.state.clones.last().map(|clone| clone.id) else {
            return Ok(TrackReport::default());
        };
        let mut update = std::mem::take(&mut self.odometry_update);
        let report = self.odometry(newest, observations, &mut update);
        self.odometry_update = update;
        let report = report?;
        self.health.note_tracks(self.state.stamp_ns, &report);
        self.check_health()?;
        self.marginalize_surplus();
        Ok(report)
    }

    fn odometry(
        &mut self,
        newest: CloneId,
        observations: &[TrackObservation],
        update: &mut OdometryUpdate,
    ) -> Result<TrackReport, EstimatorError> {
        update.landmarks.remove_lost(&mut self.state, &mut self.covariance, observations);
        let in_state = self.state.landmarks.len();
        let landmarks = &self.state.landmarks;
        let is_landmark = |id: u64| landmarks.iter().any(|landmark| landmark.feature_id == id);
        self.tracks.add(newest, observations, is_landmark);
        self.track_settings.standing = self.stand_still(&mut update.zero_velocity)?;
        self.tracks.take_ended(newest, &mut update.ready);
        for place in surplus(&self.state, self.config.window) {
            self.tracks.take_seen_by(self.state.clones[place].id, &mut update.ready);
        }
        if self.track_settings.standing && self.state.calibration.dim() > 0 {
            // A view that does not change says the same of the calibration again and again, at a point that is not the
            // truth: the filter would believe it.
            self.tracks.recycle(&mut update.ready);
            return Ok(TrackReport { standing: true, ..TrackReport::default() });
        }
        let mut report = self.track_correction(update, in_state)?;
        let settings = LandmarkSettings {
            sigma_px: self.config.sigma_track_px,
            first_estimates: self.config.first_estimates,
            gate: &self.track_settings.gate,
        };
        let (state, covariance) = (&mut self.state, &mut self.covariance);
        (report.landmarks, report.landmarks_gated) = update.landmarks.update(
            state,
            covariance,
            in_state,
            observations,
            &settings,
            &mut self.correction,
        )?;
        Ok(report)
    }

    /// Corrects the state by the tracks that are ready, and lets landmarks of them enter.
    fn track_correction(
        &mut self,
        update: &mut OdometryUpdate,
        in_state: usize,
    ) -> Result<TrackReport, EstimatorError> {
        let OdometryUpdate { ready, tracks, .. } = update;
        let mut room = self.config.slam_features.saturating_sub(in_state);
        let may_enter = |_: &Track| {
            let enters = room > 0;
            room -= usize::from(enters);
            enters
        };
        let report = tracks.collect(&self.state, &self.covariance, ready, &self.track_settings, may_enter);
        self.tracks.recycle(ready);
        self.insert_landmarks(tracks);
        if tracks.information.rows > 0 {
            self.covariance.information_update(&tracks.information, &mut self.correction)?;
            self.state.retract(&self.correction);
        }
        Ok(report)
    }

    /// Lets the landmarks of an update into the state, and tells the update where its columns stand now.
    fn insert_landmarks(&mut self, update: &mut TrackUpdate) {
        if update.entering.is_empty() {
            return;
        }
        update.entrance.jacobian(&mut self.entering);
        let noise =
            update.entrance.noises.iter().map(|noise| DMatrix::from_column_slice(3, 3, noise.as_slice()));
        let columns = &update.information.blocks;
        self.covariance.insert(self.state.clones_begin(), columns, &self.entering, noise);
        for (entering, shift) in update.entering.iter().zip(&update.entrance.shifts) {
            self.state.landmarks.push(SlamFeature {
                feature_id: entering.feature_id,
                position: entering.position + shift,
                first_estimate: entering.position,
                implausible: 0,
            });
        }
        update.information.blocks.active.clear();
        update.information.blocks.active.extend(Layout::of(&self.state).runs());
    }

    /// Tells the filter that the body stands, where it does and the filter can believe it.
    fn stand_still(&mut self, rows: &mut LinearizedMeasurement) -> Result<bool, EstimatorError> {
        let still = self.config.zero_velocity
            && zero_velocity::stands_still(&self.state, &self.tracks, self.config.sigma_track_px);
        if !still {
            return Ok(false);
        }
        zero_velocity::zero_velocity(&self.state, rows);
        let plausible = self.frame_gate.accepts(self.covariance.nis(rows)?, rows.residual.len());
        if plausible {
            self.covariance.measurement_update(rows, &mut self.correction)?;
            self.state.retract(&self.correction);
        }
        Ok(plausible)
    }
}
