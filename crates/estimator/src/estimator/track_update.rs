//! The odometry update of one image: zero velocity, MSCKF tracks, SLAM features.

use super::Estimator;
use super::time_update::clones_beyond_window;
use crate::error::EstimatorError;
use crate::measurement::LinearizedMeasurement;
use crate::noise_adaptation::correction::BeforeUpdate;
use crate::odometry::msckf_update::{MsckfUpdate, TrackReport};
use crate::odometry::slam_update::{self, SlamUpdate, SlamUpdateSettings};
use crate::odometry::tracks::{ShownCameras, Track};
use crate::odometry::zero_velocity;
use crate::state::{ActiveState, CloneId, FEATURE_DIM, SlamFeature};
use nalgebra::{DMatrix, Vector3};
use types::TrackObservation;

/// Memory of the odometry update, reused from image to image.
#[derive(Clone, Debug, Default)]
pub(super) struct OdometryUpdate {
    pub(super) finished: Vec<Track>,
    pub(super) msckf: MsckfUpdate,
    /// The point of an update's next linearization, and the correction at the one before.
    pub(super) there: Option<ActiveState>,
    pub(super) before: Vec<f64>,
    slam: SlamUpdate,
    zero_velocity: LinearizedMeasurement,
}

impl Estimator {
    /// Updates the state with the tracks of the newest image.
    ///
    /// Tracks that ended or reach back to a clone that leaves the window give an MSCKF update; SLAM features are updated
    /// at once; a zero-velocity update is made while the body is stationary. Then clones beyond the window are
    /// marginalized.
    ///
    /// # Arguments
    /// * `observations`: all features of the images of the frame, in any order; pixels as the camera sees them (distorted). A feature
    ///   that is missing in a frame has ended its track, if the frame has others of the camera that first saw it: cameras need not
    ///   be triggered together.
    ///
    /// # Errors
    /// [`EstimatorError::Diverged`]: the filter must be initialized again.
    ///
    /// # Example
    /// A body at rest with twelve features: their tracks show that it is stationary.
    /// ```
    /// # use estimator::{CalibratedCamera, Estimator, EstimatorConfig, ImuSample, InitialSigmas, InitialState};
    /// # use geometry::{Camera, Distortion, Pose};
    /// use estimator::TrackObservation;
    /// use nalgebra::{Vector2, Vector3};
    /// # let camera = Camera {
    /// #     width: 640, height: 480, focal: [400.0; 2], centre: [320.0, 240.0], distortion: Distortion::None,
    /// # };
    /// # let cameras = vec![CalibratedCamera::new(camera, Pose::identity())];
    /// # let (rest, down) = (Vector3::zeros(), -Vector3::z());
    /// # let start = InitialState::from_truth(0, &Pose::identity(), &rest, &down, InitialSigmas::default());
    /// # let mut estimator = Estimator::new(EstimatorConfig::default(), cameras, &start)?;
    /// let tracks: Vec<TrackObservation> = (0..12)
    ///     .map(|feature_id| TrackObservation {
    ///         camera: 0,
    ///         feature_id,
    ///         pixel: Vector2::new(50.0 * feature_id as f64, 240.0),
    ///     })
    ///     .collect();
    /// for image in 0..10 {
    ///     for k in 0..20 {
    ///         estimator.imu(ImuSample {
    ///             stamp_ns: image * 100_000_000 + k * 5_000_000,
    ///             gyroscope: Vector3::zeros(),
    ///             accelerometer: Vector3::new(0.0, 0.0, 9.81),
    ///         })?;
    ///     }
    ///     estimator.time_update(image * 100_000_000)?;
    ///     let report = estimator.track_update(&tracks)?;
    ///     assert_eq!(report.stationary, image >= 5, "half a second is needed to tell");
    /// }
    /// # Ok::<(), estimator::EstimatorError>(())
    /// ```
    pub fn track_update(&mut self, observations: &[TrackObservation]) -> Result<TrackReport, EstimatorError> {
        let Some(newest) = self.state.clones.last().map(|clone| clone.id) else {
            return Ok(TrackReport::default());
        };
        let mut update = std::mem::take(&mut self.odometry_update);
        self.msckf_settings.sigma_px = self.noise.sigma_track_px();
        let before = BeforeUpdate::of(&self.state.imu, &self.covariance);
        let report = self.odometry(newest, observations, &mut update);
        self.odometry_update = update;
        let report = report?;
        // The zero-velocity update states a velocity, whatever the noise of the IMU.
        if !report.stationary && report.used + report.slam_features > 0 {
            self.note_correction(&before);
        }
        self.health.note_tracks(self.state.stamp_ns, &report);
        self.check_health()?;
        self.marginalize_old_clones();
        Ok(report)
    }

    /// Adapts the noise of the IMU to the correction by an update.
    pub(super) fn note_correction(&mut self, before: &BeforeUpdate) {
        for ratio in before.ratios(&self.state.imu, &self.covariance).into_iter().flatten() {
            self.noise.note_correction(ratio);
        }
    }

    fn odometry(
        &mut self,
        newest: CloneId,
        observations: &[TrackObservation],
        update: &mut OdometryUpdate,
    ) -> Result<TrackReport, EstimatorError> {
        update.slam.marginalize_lost(&mut self.state, &mut self.covariance, observations);
        let features = &self.state.slam_features;
        let in_state = features.len();
        let is_slam_feature = |id: u64| features.iter().any(|feature| feature.feature_id == id);
        self.tracks.add(newest, observations, is_slam_feature);
        self.msckf_settings.stationary = self.zero_velocity_update(&mut update.zero_velocity)?;
        self.tracks.take_ended(newest, &ShownCameras::of(observations), &mut update.finished);
        for index in clones_beyond_window(&self.state, self.config.window) {
            self.tracks.take_starting_at(self.state.clones[index].id, &mut update.finished);
        }
        if self.msckf_settings.stationary && self.state.calibration.shows_at_rest() {
            // An image that does not change repeats the same information on the calibration with the same linearization
            // error, which would make the calibration inconsistent.
            self.tracks.recycle(&mut update.finished);
            return Ok(TrackReport { stationary: true, ..TrackReport::default() });
        }
        let mut report = self.msckf_update(update, in_state)?;
        let repeated = update.slam.repetition(self.state.stamp_ns, observations);
        let settings = SlamUpdateSettings {
            sigma_px: self.msckf_settings.sigma_px.hypot(slam_update::COMMON_ERROR_PX * repeated),
            lasting_error_rad: self.lasting_error_rad * repeated,
            first_estimates: self.config.first_estimates,
            gate: &self.msckf_settings.gate,
        };
        let (state, covariance) = (&mut self.state, &mut self.covariance);
        (report.slam_features, report.slam_features_gated) =
            update.slam.update(state, covariance, in_state, observations, &settings, &mut self.correction)?;
        Ok(report)
    }

    /// Delayed initialization: adds the new features of the last update to the state. Their noise is independent of that of the
    /// update, so it makes no difference which comes first.
    pub(super) fn insert_slam_features(&mut self, update: &mut MsckfUpdate) {
        if update.new_features.is_empty() {
            return;
        }
        update.initialization.jacobian(&mut self.feature_jacobian);
        let noise = update
            .initialization
            .noises
            .iter()
            .map(|noise| DMatrix::from_column_slice(3, 3, noise.as_slice()));
        let columns = &update.information.blocks;
        self.covariance.insert(self.state.clones_begin(), columns, &self.feature_jacobian, noise);
        let shifts = update.initialization.shifts.iter().enumerate();
        for (feature, (index, shift)) in update.new_features.iter().zip(shifts) {
            // The update has moved the poses that the feature is seen from.
            let rows = FEATURE_DIM * index..FEATURE_DIM * (index + 1);
            let columns = columns.ranges().flat_map(|(range, here)| range.zip(here));
            let moved = columns.map(|(of_state, column)| {
                Vector3::from_column_slice(&self.feature_jacobian.column(column)[rows.clone()])
                    * self.correction[of_state]
            });
            let moved: Vector3<f64> = moved.sum();
            self.state.slam_features.push(SlamFeature {
                feature_id: feature.feature_id,
                position: feature.position + shift + moved,
                first_estimate: feature.position,
                gated_in_a_row: 0,
                camera: feature.camera,
                last_seen: feature.last_seen,
            });
        }
    }

    /// Whether the tracks show a stationary body and the gate accepts it; a zero-velocity update then, if the last one is as
    /// old as the images that show it.
    fn zero_velocity_update(&mut self, rows: &mut LinearizedMeasurement) -> Result<bool, EstimatorError> {
        let span_ns = zero_velocity::span_ns(&self.state, self.config.window);
        let stationary = self.config.zero_velocity
            && zero_velocity::is_stationary(&self.state, &self.tracks, self.msckf_settings.sigma_px, span_ns);
        if !stationary || !zero_velocity::zero_displacement(&self.state, span_ns, rows) {
            return Ok(false);
        }
        let plausible = self.frame_gate.accepts(self.covariance.nis(rows)?, rows.residual.len());
        let now_ns = self.state.stamp_ns;
        let is_due = self.last_zero_velocity_ns.is_none_or(|last| now_ns - last >= span_ns);
        if plausible && is_due {
            self.last_zero_velocity_ns = Some(now_ns);
            self.covariance.measurement_update(rows, &mut self.correction)?;
            self.state.retract(&self.correction);
        }
        Ok(plausible)
    }
}
