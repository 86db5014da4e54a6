//! The estimator: visual-inertial odometry in L, and `global_from_local` from answers of a map.
//!
//! An MSCKF whose state is `[IMU | calibration | global_from_local | landmarks | clones]`, with the pulled keyframes of the map
//! as nuisance parameters of a Schmidt-Kalman filter. Pure: it takes measurements and returns states,
//! and knows no network, no clock and no file.
//!
//! Its verbs, in the order of a frame: [`Estimator::imu`] for every reading, [`Estimator::time_update`]
//! to the image, [`Estimator::track_update`] with the image's tracks, and [`Estimator::map_update`]
//! whenever the map answered to an image whose clone was [pinned](Estimator::pin). [`Estimator::map_changed`] takes in
//! news of a map that is served anew.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod calibration;
pub mod config;
pub mod covariance;
mod error;
pub mod gate;
pub mod health;
pub mod imu;
pub mod initialization;
pub mod linear_algebra;
pub mod map_update;
pub mod measurement;
pub mod odometry;
pub mod propagation;
pub mod schmidt;
pub mod state;
pub mod status;
#[cfg(test)]
mod test_scene;

pub use calibration::{CalibratedCamera, Calibration, OnlineCalibration};
pub use config::{EstimatorConfig, ImuNoise, InitialSigmas, MapMode, Relinearization};
pub use error::EstimatorError;
pub use imu::ImuSample;
pub use initialization::initializer::{InitMethod, InitStatus, Initializer, LastTrustedPose, Start};
pub use initialization::static_initialization::InitialState;
pub use map_update::map_answer::{MapAnswer, MapKeyframe, MatchedLandmark};
pub use map_update::map_report::{MapReport, Rejection};
pub use map_update::map_version::{ChangeSize, MapRevision, RevisionEffect};
pub use odometry::track_update::TrackReport;
pub use odometry::tracks::TrackObservation;
pub use state::CloneId;
pub use status::{Localization, Status};

use covariance::JointCovariance;
use gate::Gate;
use geometry::{Pose, PoseWithCovariance};
use health::Health;
use imu::ImuBuffer;
use linear_algebra::dense::Dense;
use map_update::map_version::MapVersion;
use nalgebra::{DMatrix, DVector, Matrix6, Vector3};
use odometry::OdometryUpdate;
use odometry::track_update::TrackSettings;
use odometry::tracks::TrackStore;
use propagation::{IMU_DIM, ImuMatrix, MotionEstimate, propagate};
use smallvec::SmallVec;
use state::{ActiveState, Block, ClonedPose, POSE_DIM};
use std::ops::Range;

/// Identity of a keyframe within its map.
pub type KeyframeId = u64;

/// How long a missing IMU reading at the end of an interval may be bridged, nanoseconds.
const IMU_SLACK_NS: i64 = 20_000_000;
/// Significance of the gate beyond which a landmark of the map speaks against the state. All landmarks of a keyframe share
/// the error of its pose, so they fail the usual gate together once in a while.
const CONTRADICTION_CONFIDENCE: f64 = 0.9999;
/// A residual after triangulation beyond this many sigmas is an outlier, whatever the clones' errors.
const OUTLIER_SIGMAS: f64 = 5.0;

/// The filter. See the module's text for its use.
#[derive(Clone, Debug)]
pub struct Estimator {
    config: EstimatorConfig,
    imu: ImuBuffer,
    state: ActiveState,
    /// Angular velocity of the body in L at the state's time, rad/s.
    angular_velocity: Vector3<f64>,
    covariance: JointCovariance,
    tracks: TrackStore,
    track_settings: TrackSettings,
    odometry_update: OdometryUpdate,
    correction: DVector<f64>,
    entering: Dense,
    landmark_gate: Gate,
    contradiction_gate: Gate,
    frame_gate: Gate,
    next_clone: u64,
    map_version: MapVersion,
    rejections_in_a_row: usize,
    /// `G_T_L` by the last answer, if most of that contradicted the state.
    contradiction: Option<Pose>,
    last_map_update_ns: Option<i64>,
    lost: Option<String>,
    health: Health,
}

impl Estimator {
    /// A filter that starts from `initial`.
    ///
    /// # Arguments
    /// * `rig`: cameras by their number in [`TrackObservation::camera`]; the map is matched with the first.
    ///
    /// # Errors
    /// [`EstimatorError::Config`] names the setting that cannot work.
    pub fn new(
        config: EstimatorConfig,
        rig: Vec<CalibratedCamera>,
        initial: &InitialState,
    ) -> Result<Self, EstimatorError> {
        config.validate().map_err(EstimatorError::Config)?;
        if rig.is_empty() {
            return Err(EstimatorError::Config("no camera is configured".into()));
        }
        for eye in &rig {
            eye.camera.validate().map_err(|error| EstimatorError::Config(error.to_string()))?;
        }
        let calibration = Calibration::new(rig, config.camera_time_offset, config.calibration);
        let covariance = with_calibration(&initial.covariance, &calibration);
        let covariance = JointCovariance::new(covariance, config.max_active_keyframes);
        let health = Health::new(initial, &config);
        let state = ActiveState {
            stamp_ns: initial.stamp_ns,
            imu: initial.imu,
            first_motion: MotionEstimate {
                position: initial.imu.local_from_imu.translation,
                velocity: initial.imu.velocity,
            },
            calibration,
            transform: None,
            landmarks: Vec::new(),
            clones: Vec::new(),
        };
        Ok(Self {
            track_settings: TrackSettings {
                sigma_px: config.sigma_track_px,
                first_estimates: config.first_estimates,
                gate: Gate::new(config.track_gate),
                standing: false,
                outlier_sigmas: OUTLIER_SIGMAS,
                max_tracks: config.max_tracks,
            },
            landmark_gate: Gate::new(config.landmark_gate),
            contradiction_gate: Gate::new(CONTRADICTION_CONFIDENCE),
            frame_gate: Gate::new(config.frame_gate),
            config,
            imu: ImuBuffer::default(),
            state,
            angular_velocity: Vector3::zeros(),
            covariance,
            tracks: TrackStore::default(),
            odometry_update: OdometryUpdate::default(),
            correction: DVector::zeros(0),
            entering: Dense::default(),
            next_clone: 0,
            map_version: MapVersion::default(),
            rejections_in_a_row: 0,
            contradiction: None,
            last_map_update_ns: None,
            lost: None,
            health,
        })
    }

    /// Takes an IMU reading. Readings come in the order of time.
    ///
    /// # Errors
    /// [`EstimatorError::BadImu`]: this reading was dropped, the rest goes on.
    pub fn imu(&mut self, sample: ImuSample) -> Result<(), EstimatorError> {
        self.imu.push(sample)
    }

    /// Carries the state to the time of an image and clones its pose.
    ///
    /// # Arguments
    /// * `stamp_ns`: by the camera's clock. What the time offset adds is added here.
    ///
    /// # Errors
    /// [`EstimatorError::OldFrame`], [`EstimatorError::NoImu`]: nothing was changed.
    /// [`EstimatorError::Diverged`].
    pub fn time_update(&mut self, stamp_ns: i64) -> Result<CloneId, EstimatorError> {
        let from_ns = self.state.stamp_ns;
        let to_ns = self.imu_stamp_ns(stamp_ns);
        if to_ns <= from_ns && !self.state.clones.is_empty() || to_ns < from_ns {
            return Err(EstimatorError::OldFrame { stamp_ns, state_ns: from_ns });
        }
        if to_ns > from_ns {
            self.propagate_to(to_ns)?;
        }
        self.check_health()?;
        // A caller that has no tracks for an image may leave `track_update` out.
        self.marginalize_surplus();
        Ok(self.clone_pose(stamp_ns))
    }

    /// Time of an image by the IMU's clock, as far as the offset is known. Readings are needed up to there.
    pub fn imu_stamp_ns(&self, image_stamp_ns: i64) -> i64 {
        image_stamp_ns + (self.state.calibration.time_offset * 1e9).round() as i64
    }

    /// The cameras and their clock, as far as they are known.
    pub fn calibration(&self) -> &Calibration {
        &self.state.calibration
    }

    fn propagate_to(&mut self, stamp_ns: i64) -> Result<(), EstimatorError> {
        let readings = self.imu.interval(self.state.stamp_ns, stamp_ns, IMU_SLACK_NS)?;
        let newest = MotionEstimate {
            position: self.state.imu.local_from_imu.translation,
            velocity: self.state.imu.velocity,
        };
        let first = if self.config.first_estimates { &self.state.first_motion } else { &newest };
        let moved = propagate(&self.state.imu, first, &readings, &self.config.imu_noise, self.config.gravity);
        if let Some(last) = readings.last() {
            let rate = last.gyroscope - moved.state.gyroscope_bias;
            self.angular_velocity = moved.state.local_from_imu.rotation * rate;
        }
        self.covariance.time_update(&moved.transition, &moved.noise);
        self.state.imu = moved.state;
        self.state.stamp_ns = stamp_ns;
        self.state.first_motion = MotionEstimate {
            position: moved.state.local_from_imu.translation,
            velocity: moved.state.velocity,
        };
        self.imu.forget_before(stamp_ns);
        Ok(())
    }

    /// Stochastic cloning: the newest pose enters the window with all its correlations.
    fn clone_pose(&mut self, stamp_ns: i64) -> CloneId {
        let id = CloneId(self.next_clone);
        self.next_clone += 1;
        let dim = self.state.dim();
        self.covariance.gather(&[0..dim, 0..POSE_DIM]);
        if self.state.calibration.estimates_time_offset() {
            // The image was taken where the body was, not where the offset's estimate says: later by its error.
            let (turn, velocity) = (self.angular_velocity, self.state.imu.velocity);
            let motion = [turn.x, turn.y, turn.z, velocity.x, velocity.y, velocity.z];
            self.covariance.add_dependence(dim, &motion, IMU_DIM);
        }
        let pose = self.state.imu.local_from_imu;
        self.state.clones.push(ClonedPose {
            id,
            stamp_ns,
            local_from_imu: pose,
            first_estimate: pose,
            pinned: false,
        });
        id
    }

    /// Lets the clones go that the window has no room for.
    fn marginalize_surplus(&mut self) {
        let leaving: SmallVec<[usize; 4]> = surplus(&self.state, self.config.window).collect();
        if leaving.is_empty() {
            return;
        }
        let mut kept = SmallVec::<[Range<usize>; 32]>::new();
        kept.push(0..self.state.clones_begin());
        kept.extend(
            (0..self.state.clones.len())
                .filter(|place| !leaving.contains(place))
                .filter_map(|place| self.state.range(Block::Clone(place))),
        );
        self.covariance.gather(&kept);
        let mut place = 0;
        self.state.clones.retain(|_| {
            place += 1;
            !leaving.contains(&(place - 1))
        });
    }

    /// Keeps the clone of an image that the map was asked about.
    pub fn pin(&mut self, clone: CloneId) {
        if let Some(place) = self.state.place_of(clone) {
            self.state.clones[place].pinned = true;
        }
    }

    /// Lets a pinned clone go with its time: the answer was taken, or will not come.
    pub fn unpin(&mut self, clone: CloneId) {
        if let Some(place) = self.state.place_of(clone) {
            self.state.clones[place].pinned = false;
        }
    }

    fn first_camera(&self) -> &CalibratedCamera {
        &self.state.calibration.rig[0]
    }

    fn check_health(&self) -> Result<(), EstimatorError> {
        self.health.check(&self.state, &self.covariance)
    }

    /// Whether the newest tracks contradict the state: not yet a divergence, but a pose not to be built on.
    pub fn is_suspicious(&self) -> bool {
        self.health.is_suspicious()
    }

    /// Settings it runs with.
    pub fn config(&self) -> &EstimatorConfig {
        &self.config
    }

    /// Time of the state, nanoseconds.
    pub fn stamp_ns(&self) -> i64 {
        self.state.stamp_ns
    }

    /// The body in L.
    pub fn local_from_imu(&self) -> PoseWithCovariance {
        PoseWithCovariance {
            pose: self.state.imu.local_from_imu,
            covariance: self.block(&Block::ImuPose, &Block::ImuPose),
        }
    }

    /// Velocity of the body in L, m/s.
    pub fn velocity(&self) -> Vector3<f64> {
        self.state.imu.velocity
    }

    /// Biases of gyroscope (rad/s) and accelerometer (m/s^2).
    pub fn biases(&self) -> (Vector3<f64>, Vector3<f64>) {
        (self.state.imu.gyroscope_bias, self.state.imu.accelerometer_bias)
    }

    /// `G_T_L`, once the map gave it.
    pub fn global_from_local(&self) -> Option<PoseWithCovariance> {
        let pose = self.state.transform?;
        let turned = state::turned(&pose);
        let covariance = turned * self.block(&Block::Transform, &Block::Transform) * turned.transpose();
        Some(PoseWithCovariance { pose, covariance })
    }

    /// The body in G, with the correlation of both parts.
    pub fn global_from_imu(&self) -> Option<PoseWithCovariance> {
        let transform = self.global_from_local()?;
        Some(transform.compose_correlated(
            &self.local_from_imu(),
            &(state::turned(&transform.pose) * self.block(&Block::Transform, &Block::ImuPose)),
        ))
    }

    /// The first camera in G when a clone was made, for a query's prior. `None` for a clone that is gone, and before
    /// the map gave `G_T_L`.
    pub fn global_from_camera(&self, clone: CloneId) -> Option<PoseWithCovariance> {
        let transform = self.global_from_local()?;
        let pose = self.state.clones[self.state.place_of(clone)?].local_from_imu;
        let block = Block::Clone(self.state.place_of(clone)?);
        let global_from_imu = transform.compose_correlated(
            &PoseWithCovariance { pose, covariance: self.block(&block, &block) },
            &(state::turned(&transform.pose) * self.block(&Block::Transform, &block)),
        );
        let exact =
            PoseWithCovariance { pose: self.first_camera().imu_from_camera, covariance: Matrix6::zeros() };
        Some(global_from_imu.compose(&exact))
    }

    /// Unit vector along gravity in the first camera when a clone was made; `None` for a clone that is gone.
    pub fn gravity_in_first_camera(&self, clone: CloneId) -> Option<Vector3<f64>> {
        let local_from_imu = self.state.clones[self.state.place_of(clone)?].local_from_imu;
        Some(self.gravity_in_camera(&local_from_imu))
    }

    /// Names of the keyframes that it holds.
    pub fn held_keyframes(&self) -> Vec<crate::KeyframeId> {
        self.covariance.held.ids().collect()
    }

    /// Bytes that holding them takes.
    pub fn held_bytes(&self) -> usize {
        self.covariance.held.heap_bytes()
    }

    /// Version of the map that the held keyframes are of.
    pub fn map_version(&self) -> Option<u64> {
        self.map_version.held
    }

    fn block(&self, row: &Block, column: &Block) -> Matrix6<f64> {
        match (self.state.range(*row), self.state.range(*column)) {
            (Some(rows), Some(columns)) => {
                self.covariance.active().view().fixed_view::<6, 6>(rows.start, columns.start).into_owned()
            }
            _ => Matrix6::zeros(),
        }
    }
}

/// Places of the clones that the window has no room for. A pinned one stays beyond it.
fn surplus(state: &ActiveState, window: usize) -> impl Iterator<Item = usize> + '_ {
    (0..state.clones.len().saturating_sub(window)).filter(|&place| !state.clones[place].pinned)
}

/// Covariance of the IMU's error, and of the calibration's, which nothing is known to depend on yet.
fn with_calibration(imu: &ImuMatrix, calibration: &Calibration) -> DMatrix<f64> {
    let dim = IMU_DIM + calibration.dim();
    let mut covariance = DMatrix::zeros(dim, dim);
    covariance.fixed_view_mut::<IMU_DIM, IMU_DIM>(0, 0).copy_from(imu);
    let of_calibration = calibration.initial_covariance();
    covariance.view_mut((IMU_DIM, IMU_DIM), of_calibration.shape()).copy_from(&of_calibration);
    covariance
}
