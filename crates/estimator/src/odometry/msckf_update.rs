//! The MSCKF update: tracks as measurements of the clones that observe them.
//!
//! A track is triangulated from the newest estimates of its clones, and its residuals are those; its Jacobians are evaluated
//! at the first estimates of the clones, as those of propagation and SLAM features are. The landmark is eliminated; the
//! chi-square gate decides. Outlying observations are dropped, not whole tracks.
//!
//! Jacobians at other estimates than those of the propagation would make a tilt observable that is not: a robot that drives
//! straight from rest cannot tell it from an accelerometer bias.

use crate::calibration::Projection;
use crate::covariance::JointCovariance;
use crate::gate::Gate;
use crate::measurement::Information;
use crate::noise_adaptation::TRACKS_PER_IMAGE;
use crate::odometry::delayed_initialization::DelayedInitialization;
use crate::odometry::feature_measurement::FeatureMeasurement;
use crate::odometry::pixel_measurement::{Layout, linearize_pixel};
use crate::odometry::second_order::second_order_px;
use crate::odometry::track_triangulation::{
    MIN_CLONES, distant_point, has_accurate_depth, triangulate_robustly,
};
use crate::odometry::tracks::{CloneObservation, Track};
use crate::state::{ActiveState, Block, CloneId};
use nalgebra::{DVector, Matrix2x3, Matrix2x6, Vector2, Vector3};

/// Result of the odometry update of one image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrackReport {
    /// Tracks used by the MSCKF update.
    pub used: usize,
    /// Tracks that could not be triangulated.
    pub not_triangulated: usize,
    /// Tracks rejected by the gate.
    pub gated: usize,
    /// Tracks beyond [`EstimatorConfig::max_tracks`](crate::EstimatorConfig::max_tracks).
    pub left_out: usize,
    /// Observations dropped as outliers.
    pub dropped_observations: usize,
    /// SLAM features used.
    pub slam_features: usize,
    /// SLAM features rejected by the gate.
    pub slam_features_gated: usize,
    /// The body is stationary: a zero-velocity update was made.
    pub stationary: bool,
}

/// Settings of the MSCKF update.
#[derive(Clone, Debug)]
pub struct MsckfSettings {
    /// Pixel noise, px.
    pub sigma_px: f64,
    /// Evaluate Jacobians at the first estimates of the clones.
    pub first_estimates: bool,
    /// The gate on a track.
    pub gate: Gate,
    /// The body is stationary: tracks without parallax are used for its rotation.
    pub stationary: bool,
    /// Residual after triangulation beyond which an observation is an outlier, sigmas. Wide, because the residual contains
    /// the errors of the clones.
    pub outlier_sigmas: f64,
    /// Number of terms of second order of a track that are counted as noise: 0 for one camera or stereo pair, of which they are small against
    /// the noise of all tracks together.
    pub second_order_terms: f64,
    /// Note the NIS of some tracks.
    pub learns_noise: bool,
    /// Maximum number of tracks; the longest are preferred.
    pub max_tracks: usize,
}

/// Angular velocity for which the pixel error of an uncertain time offset is allowed, rad/s.
const MAX_ANGULAR_VELOCITY: f64 = 1.0;

/// Linearization error of an uncertain calibration, added to the pixel noise, as a fraction of the pixel error that the
/// calibration may cause. Tuned on 20 simulated runs each of a hand and of a street with cameras that are 2 degrees off:
/// without it the NEES of a monocular pose is 2.3 in the street, with it 1.25; with five times as much, 0.5 for the position
/// in the room.
const NONLINEAR_FRACTION: f64 = 0.02;

/// A SLAM feature to be initialized.
#[derive(Clone, Debug)]
pub struct NewFeature {
    /// The front end's identity of the feature.
    pub feature_id: u64,
    /// Linearization point in L, metres.
    pub position: Vector3<f64>,
    /// The camera that it was first seen by.
    pub camera: u8,
    /// The last clone that observed it.
    pub last_seen: CloneId,
}

/// The linearized update, with reused memory.
#[derive(Clone, Debug, Default)]
pub struct MsckfUpdate {
    /// Sum of all tracks, over calibration and clones.
    pub information: Information,
    /// SLAM features to be initialized.
    pub new_features: Vec<NewFeature>,
    /// Their initialization.
    pub initialization: DelayedInitialization,
    /// Normalized innovation squared of some tracks before their gate, for each degree of freedom.
    pub nis_per_row: Vec<f64>,
    feature: FeatureMeasurement,
    /// Observations of a track without outliers.
    observations: Vec<CloneObservation>,
}

impl MsckfUpdate {
    /// Linearizes and sums up `tracks`.
    ///
    /// # Arguments
    /// * `state`: the point of linearization.
    /// * `ahead`: its error, as seen from the estimate to which `covariance` belongs; `None` where it is that estimate.
    /// * `tracks`: sorted by this function in the order of their use.
    /// * `accept_slam_feature`: whether a track of the newest clone becomes a SLAM feature; called once for each candidate.
    pub fn collect(
        &mut self,
        state: &ActiveState,
        ahead: Option<&DVector<f64>>,
        covariance: &JointCovariance,
        tracks: &mut [Track],
        settings: &MsckfSettings,
        mut accept_slam_feature: impl FnMut(&Track) -> bool,
    ) -> TrackReport {
        let mut report = TrackReport { stationary: settings.stationary, ..TrackReport::default() };
        let layout = Layout::of(state);
        self.begin(&layout);
        let calibration_error = calibration_error_px(state, covariance);
        let largest_error = settings.outlier_sigmas * settings.sigma_px + calibration_error;
        let sigma_px = settings.sigma_px.hypot(NONLINEAR_FRACTION * calibration_error);
        // Long tracks have most information; the feature makes the order unique.
        tracks.sort_unstable_by_key(|track| (std::cmp::Reverse(track.observations.len()), track.feature_id));
        let mut observations = std::mem::take(&mut self.observations);
        for track in tracks.iter().filter(|track| track.clones() >= MIN_CLONES) {
            if report.used >= settings.max_tracks {
                report.left_out += 1;
                continue;
            }
            let triangulated = triangulate_robustly(
                state,
                track,
                &mut observations,
                sigma_px,
                largest_error,
                &mut report.dropped_observations,
            );
            let mut landmark = triangulated.as_ref().map(|found| found.position);
            self.feature.prior = None;
            if landmark.is_none()
                && settings.stationary
                && let Some(distant) = distant_point(state, &observations)
            {
                landmark = Some(distant.position);
                self.feature.prior = Some(distant.information);
            }
            let terms = settings.second_order_terms;
            let neglected_px = triangulated.as_ref().filter(|_| terms > 0.0).map_or(0.0, |found| {
                terms * second_order_px(state, covariance, &observations, &found.position)
            });
            let noise_px = sigma_px.hypot(neglected_px);
            if landmark
                .is_none_or(|landmark| !self.linearize(state, &observations, &landmark, settings, noise_px))
            {
                report.not_triangulated += 1;
                continue;
            }
            if let Some(ahead) = ahead {
                self.feature.seen_from(state, &layout, ahead);
            }
            let bound = settings.gate.bound(self.feature.free_rows());
            // The exact NIS, where the noise is adapted to it.
            let is_noted = settings.learns_noise && self.nis_per_row.len() < TRACKS_PER_IMAGE;
            let enough = if is_noted { 0.0 } else { bound };
            let nis = self.feature.nis(state, covariance.active(), &layout, enough);
            if let (true, Ok(nis)) = (is_noted, &nis) {
                self.nis_per_row.push(nis / self.feature.free_rows() as f64);
            }
            let plausible = nis.is_ok_and(|nis| nis <= bound);
            if !plausible || self.feature.add_to(&mut self.information, state, &layout).is_err() {
                report.gated += 1;
                continue;
            }
            report.used += 1;
            if let Some(found) = triangulated.filter(|found| has_accurate_depth(found, state, &observations))
                && let (Some(first), Some(last)) = (track.observations.first(), track.observations.last())
                && accept_slam_feature(track)
                && self.feature.initialize(&mut self.initialization, state, &layout).is_ok()
            {
                let (feature_id, position) = (track.feature_id, found.position);
                let (camera, last_seen) = (first.camera, last.clone);
                self.new_features.push(NewFeature { feature_id, position, camera, last_seen });
            }
        }
        self.observations = observations;
        report
    }

    fn begin(&mut self, layout: &Layout) {
        self.new_features.clear();
        self.nis_per_row.clear();
        self.initialization.clear();
        self.information.blocks.active.clear();
        self.information.blocks.active.extend(layout.runs());
        self.information.clear();
    }

    /// Linearizes all pixels of a track; `false` where the landmark does not project into one of them.
    fn linearize(
        &mut self,
        state: &ActiveState,
        observations: &[CloneObservation],
        landmark: &Vector3<f64>,
        settings: &MsckfSettings,
        sigma_px: f64,
    ) -> bool {
        let first = settings.first_estimates.then_some(landmark);
        self.feature.pixels.clear();
        for observation in observations {
            let observed = (observation.clone, usize::from(observation.camera), observation.pixel);
            match linearize_pixel(state, observed, landmark, first, sigma_px) {
                Some(pixel) => self.feature.pixels.push(pixel),
                None => return false,
            }
        }
        self.feature.pixels.len() >= 2
    }
}

/// Pixel error that the uncertain calibration may cause (three sigmas), px.
///
/// A calibration error moves all pixels of a track together, so its part of a residual is smaller. The chi-square gate with
/// the covariance of the calibration decides afterwards.
fn calibration_error_px(state: &ActiveState, covariance: &JointCovariance) -> f64 {
    let Some(range) = state.range(Block::Calibration).filter(|range| !range.is_empty()) else { return 0.0 };
    let Some(camera) = state.calibration.cameras.first().map(|calibrated| &calibrated.camera) else {
        return 0.0;
    };
    let corner = [f64::from(camera.width) * 0.5, f64::from(camera.height) * 0.5, 0.0];
    let projection = Projection {
        pixel: Vector2::zeros(),
        in_camera: Vector3::new(corner[0] / camera.focal[0], corner[1] / camera.focal[1], 1.0),
        wrt_body: Matrix2x6::zeros(),
        wrt_landmark: Matrix2x3::zeros(),
        wrt_extrinsics: Matrix2x6::identity() * camera.focal[0],
    };
    let jacobian = state.calibration.camera_jacobian(0, &projection);
    let own = state.calibration.camera_range(0);
    let variance = |k: usize| covariance.active()[(range.start + k, range.start + k)];
    let of_camera =
        own.clone().map(|k| variance(k) * jacobian.column(k - own.start).norm_squared()).sum::<f64>();
    let of_clock = if state.calibration.estimates_time_offset() {
        variance(0) * (MAX_ANGULAR_VELOCITY * camera.focal[0]).powi(2)
    } else {
        0.0
    };
    let of_readout = state.calibration.readout_index(0).map_or(0.0, |index| {
        // That of the first and the last row.
        variance(index) * (0.5 * MAX_ANGULAR_VELOCITY * camera.focal[0]).powi(2)
    });
    3.0 * (of_camera + of_clock + of_readout).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linear_algebra::dense::Dense;
    use crate::state::CloneId;
    use crate::test_scene::scene;
    use geometry::{Pose, rotation};
    use nalgebra::DMatrix;

    fn settings() -> MsckfSettings {
        MsckfSettings {
            second_order_terms: 0.0,
            learns_noise: true,
            sigma_px: 1.2,
            first_estimates: true,
            gate: Gate::new(0.95),
            stationary: false,
            outlier_sigmas: 5.0,
            max_tracks: 10,
        }
    }

    #[test]
    fn an_outlying_observation_is_dropped_and_a_pixel_that_is_not_finite_affects_its_track_only() {
        let scene = scene(false);
        let mut dropped = 0;
        let mut outlying = scene.observations.clone();
        outlying[3].pixel.x += 60.0;
        let outlying = Track { feature_id: 0, observations: outlying };
        let mut left = Vec::new();
        let found = triangulate_robustly(&scene.state, &outlying, &mut left, 1.2, 6.0, &mut dropped).unwrap();
        assert_eq!((dropped, left.len()), (1, 7));
        assert!(left.iter().all(|observation| observation.clone != CloneId(3)));
        assert!((found.position - scene.landmark).norm() < 0.1);

        let mut broken = scene.observations.clone();
        broken[3].pixel.x = f64::NAN;
        let dim = scene.state.dim();
        let covariance = JointCovariance::new(DMatrix::identity(dim, dim) * 1e-4, 4);
        let mut tracks = [
            Track { feature_id: 1, observations: broken },
            Track { feature_id: 2, observations: scene.observations.clone() },
        ];
        let mut update = MsckfUpdate::default();
        let report = update.collect(&scene.state, None, &covariance, &mut tracks, &settings(), |_| true);
        assert_eq!((report.used, report.not_triangulated, update.new_features.len()), (1, 1, 1));
        assert_eq!(update.information.rows, 2 * 8 - 3);

        let few = MsckfSettings { max_tracks: 1, ..settings() };
        let mut tracks =
            [3, 2].map(|feature_id| Track { feature_id, observations: scene.observations.clone() });
        let report = update.collect(&scene.state, None, &covariance, &mut tracks, &few, |_| false);
        assert_eq!((report.used, report.left_out, update.new_features.len()), (1, 1, 0));
    }

    #[test]
    fn tracks_show_nothing_of_the_frame_that_they_are_in_where_estimates_differ_from_the_first_ones() {
        for calibrating in [false, true] {
            let scene = scene(calibrating);
            let dim = scene.state.dim();
            let covariance = JointCovariance::new(DMatrix::identity(dim, dim) * 1e-4, 4);
            let mut tracks = [Track { feature_id: 1, observations: scene.observations.clone() }];
            let mut update = MsckfUpdate::default();
            let report = update.collect(&scene.state, None, &covariance, &mut tracks, &settings(), |_| true);
            assert_eq!((report.used, update.new_features.len()), (1, 1));

            // Rotations and translations of L.
            let layout = Layout::of(&scene.state);
            let mut gauge = DMatrix::zeros(layout.len(), 6);
            let mut of_landmark = DMatrix::zeros(3, 6);
            let put = |row: usize, target: &mut DMatrix<f64>, point: &Vector3<f64>| {
                target.fixed_view_mut::<3, 3>(row, 0).copy_from(&-rotation::skew(point));
                target.fixed_view_mut::<3, 3>(row, 3).fill_with_identity();
            };
            for (index, clone) in scene.state.clones.iter().enumerate() {
                let column = layout.clone_column(index);
                gauge.fixed_view_mut::<3, 3>(column, 0).fill_with_identity();
                put(column + 3, &mut gauge, &clone.first_estimate.translation);
            }
            put(0, &mut of_landmark, &update.new_features[0].position);

            let information = &mut update.information.matrix;
            information.mirror_lower();
            let information = information.view().into_owned();
            let seen = (&information * &gauge).amax();
            assert!(seen < 1e-6 * information.amax(), "{seen} of {}", information.amax());

            // A landmark that is added to the state moves with the frame.
            let mut jacobian = Dense::default();
            update.initialization.jacobian(&mut jacobian);
            let moved = jacobian.view() * &gauge - of_landmark;
            assert!(moved.amax() < 1e-6, "{moved}");
        }
    }

    #[test]
    fn distant_points_of_a_body_at_rest_show_nothing_of_its_position_and_attitude() {
        let mut scene = scene(false);
        let count = scene.state.clones.len();
        let newest = scene.state.clones[count - 1].local_from_imu;
        for (k, clone) in scene.state.clones.iter_mut().enumerate() {
            // Its estimates differ by as much as the noise of the IMU makes them.
            let turned = rotation::exp(&(1e-4 * Vector3::new((k as f64).sin(), 0.3, (k as f64).cos())));
            let shift = 1e-5 * Vector3::new(0.2, (2.0 * k as f64).sin(), (3.0 * k as f64).cos());
            clone.local_from_imu = Pose::new(turned * newest.rotation, newest.translation + shift);
            clone.first_estimate = clone.local_from_imu;
        }
        let pixels = [[100.0, 80.0], [320.0, 240.0], [600.0, 400.0], [50.0, 300.0]];
        let mut tracks: Vec<Track> = (0..)
            .zip(pixels)
            .map(|(feature_id, [x, y])| {
                let mut observations = scene.observations.clone();
                for (k, observation) in observations.iter_mut().enumerate() {
                    let noise = Vector2::new((7.0 * k as f64 + x).sin(), (5.0 * k as f64 + y).cos());
                    observation.pixel = Vector2::new(x, y) + noise;
                }
                Track { feature_id, observations }
            })
            .collect();
        let dim = scene.state.dim();
        let covariance = JointCovariance::new(DMatrix::identity(dim, dim) * 1e-4, 4);
        let mut update = MsckfUpdate::default();
        let at_rest = MsckfSettings { stationary: true, ..settings() };
        let report = update.collect(&scene.state, None, &covariance, &mut tracks, &at_rest, |_| true);
        assert_eq!((report.used, report.not_triangulated), (pixels.len(), 0));

        let information = &mut update.information.matrix;
        information.mirror_lower();
        let information = information.view().into_owned();
        let largest = information.amax();
        let least = information.clone().symmetric_eigenvalues().min();
        assert!(least > -1e-9 * largest, "{least} of {largest}: no information is negative");
        let mut gauge = DMatrix::zeros(6 * count, 6);
        for (index, clone) in scene.state.clones.iter().enumerate() {
            gauge.fixed_view_mut::<3, 3>(6 * index, 0).fill_with_identity();
            let lever = rotation::skew(&clone.local_from_imu.translation);
            gauge.fixed_view_mut::<3, 3>(6 * index + 3, 0).copy_from(&-lever);
            gauge.fixed_view_mut::<3, 3>(6 * index + 3, 3).fill_with_identity();
        }
        let seen = gauge.transpose() * &information * &gauge;
        assert!(seen.amax() < 1e-4, "1/sigma^2 of a common rotation (rad) and shift (m): {seen}");
    }
}
