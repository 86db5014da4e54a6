//! The estimator: visual-inertial odometry in L, and `global_from_local` from answers of a map.
//!
//! An MSCKF whose state is `[IMU | global_from_local | clones]`, with the pulled keyframes of the map
//! as nuisance parameters of a Schmidt-Kalman filter. Pure: it takes measurements and returns states,
//! and knows no network, no clock and no file.
//!
//! Its verbs, in the order of a frame: [`Estimator::imu`] for every reading, [`Estimator::time_update`]
//! to the image, [`Estimator::track_update`] with the image's tracks, and [`Estimator::map_update`]
//! whenever the map answered to an image whose clone was [pinned](Estimator::pin).

pub mod config;
pub mod covariance;
pub mod dynamic_start;
pub mod gate;
pub mod health;
pub mod imu;
pub mod initialization;
pub mod map_answer;
pub mod map_rows;
pub mod map_update;
pub mod nuisance;
pub mod null_space;
pub mod propagation;
pub mod starter;
pub mod state;
pub mod status;
pub mod track_update;
pub mod tracks;
pub mod verification;
pub mod zero_velocity;

pub use config::{EstimatorConfig, ImuNoise, InitialSigmas, MapMode, Relinearization};
pub use imu::ImuSample;
pub use initialization::InitialState;
pub use map_answer::{MapAnswer, MapKeyframe, MatchedLandmark};
pub use map_update::{MapReport, Rejection};
pub use starter::{LastBelieved, Start, StartMethod, Starter, Waiting};
pub use state::CloneId;
pub use status::{Localization, Status};
pub use track_update::{RigCamera, TrackReport};
pub use tracks::TrackObservation;

use covariance::{JointCovariance, NotPositiveDefinite};
use gate::Gate;
use geometry::PoseWithCovariance;
use health::Health;
use imu::ImuBuffer;
use nalgebra::{DMatrix, Matrix6, Vector3};
use propagation::{IMU_DIM, MotionEstimate, propagate};
use state::{ActiveState, Block, ClonedPose, POSE_DIM};
use track_update::TrackSettings;
use tracks::TrackStore;

/// What can go wrong with a measurement or with the filter.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EstimatorError {
    /// A setting cannot work.
    #[error("the estimator's settings: {0}")]
    Config(String),
    /// An IMU reading was dropped.
    #[error("IMU reading at {stamp_ns} ns dropped: {why}")]
    BadImu {
        /// Its time.
        stamp_ns: i64,
        /// What is wrong with it.
        why: &'static str,
    },
    /// The IMU does not cover an interval.
    #[error("no IMU readings from {from_ns} to {to_ns} ns; check the recording for a gap")]
    NoImu {
        /// Begin, nanoseconds.
        from_ns: i64,
        /// End, nanoseconds.
        to_ns: i64,
    },
    /// A frame is older than the state.
    #[error("frame at {stamp_ns} ns dropped: the state is already at {state_ns} ns")]
    OldFrame {
        /// Time of the frame.
        stamp_ns: i64,
        /// Time of the state.
        state_ns: i64,
    },
    /// The filter is broken.
    #[error("the estimator diverged: {0}")]
    Diverged(String),
}

impl From<NotPositiveDefinite> for EstimatorError {
    fn from(error: NotPositiveDefinite) -> Self {
        Self::Diverged(error.to_string())
    }
}

/// How long a missing IMU reading at the end of an interval may be bridged, nanoseconds.
const IMU_SLACK_NS: i64 = 20_000_000;
/// A residual after triangulation beyond this many sigmas is an outlier, whatever the clones' errors.
const OUTLIER_SIGMAS: f64 = 5.0;

/// The filter. See the module's text for its use.
#[derive(Clone, Debug)]
pub struct Estimator {
    config: EstimatorConfig,
    rig: Vec<RigCamera>,
    imu: ImuBuffer,
    state: ActiveState,
    covariance: JointCovariance,
    tracks: TrackStore,
    track_settings: TrackSettings,
    landmark_gate: Gate,
    frame_gate: Gate,
    next_clone: u64,
    map_version: Option<u64>,
    /// Time of the image that first met this version of the map.
    map_version_since_ns: i64,
    rejections_in_a_row: usize,
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
        rig: Vec<RigCamera>,
        initial: &InitialState,
    ) -> Result<Self, EstimatorError> {
        config.validate().map_err(EstimatorError::Config)?;
        if rig.is_empty() {
            return Err(EstimatorError::Config("no camera is configured".into()));
        }
        for eye in &rig {
            eye.camera.validate().map_err(|error| EstimatorError::Config(error.to_string()))?;
        }
        let covariance = JointCovariance::new(
            DMatrix::from_column_slice(IMU_DIM, IMU_DIM, initial.covariance.as_slice()),
            config.max_active_keyframes,
        );
        let health = Health::new(initial, &config);
        let state = ActiveState {
            stamp_ns: initial.stamp_ns,
            imu: initial.imu,
            first_motion: MotionEstimate {
                position: initial.imu.local_from_imu.translation,
                velocity: initial.imu.velocity,
            },
            transform: None,
            clones: Vec::new(),
        };
        Ok(Self {
            track_settings: TrackSettings {
                sigma_px: config.sigma_track_px,
                first_estimates: config.first_estimates,
                gate: Gate::new(config.track_gate),
                standing: false,
                outlier_sigmas: OUTLIER_SIGMAS,
            },
            landmark_gate: Gate::new(config.landmark_gate),
            frame_gate: Gate::new(config.frame_gate),
            config,
            rig,
            imu: ImuBuffer::default(),
            state,
            covariance,
            tracks: TrackStore::default(),
            next_clone: 0,
            map_version: None,
            map_version_since_ns: i64::MIN,
            rejections_in_a_row: 0,
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
    /// # Errors
    /// [`EstimatorError::OldFrame`], [`EstimatorError::NoImu`]: nothing was changed.
    /// [`EstimatorError::Diverged`].
    pub fn time_update(&mut self, stamp_ns: i64) -> Result<CloneId, EstimatorError> {
        let from_ns = self.state.stamp_ns;
        if stamp_ns <= from_ns && !self.state.clones.is_empty() || stamp_ns < from_ns {
            return Err(EstimatorError::OldFrame { stamp_ns, state_ns: from_ns });
        }
        if stamp_ns > from_ns {
            self.propagate_to(stamp_ns)?;
        }
        self.check_health()?;
        // A caller that has no tracks for an image may leave `track_update` out.
        let leaving = self.leaving_clones();
        self.marginalize(&leaving);
        Ok(self.clone_pose())
    }

    fn propagate_to(&mut self, stamp_ns: i64) -> Result<(), EstimatorError> {
        let readings = self.imu.interval(self.state.stamp_ns, stamp_ns, IMU_SLACK_NS)?;
        let newest = MotionEstimate {
            position: self.state.imu.local_from_imu.translation,
            velocity: self.state.imu.velocity,
        };
        let first = if self.config.first_estimates { &self.state.first_motion } else { &newest };
        let moved = propagate(&self.state.imu, first, &readings, &self.config.imu_noise, self.config.gravity);
        let transition = DMatrix::from_column_slice(IMU_DIM, IMU_DIM, moved.transition.as_slice());
        let noise = DMatrix::from_column_slice(IMU_DIM, IMU_DIM, moved.noise.as_slice());
        self.covariance.time_update(&transition, &noise);
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
    fn clone_pose(&mut self) -> CloneId {
        let id = CloneId(self.next_clone);
        self.next_clone += 1;
        let source: Vec<usize> = (0..self.state.dim()).chain(0..POSE_DIM).collect();
        self.covariance.gather(&source);
        let pose = self.state.imu.local_from_imu;
        self.state.clones.push(ClonedPose {
            id,
            stamp_ns: self.state.stamp_ns,
            local_from_imu: pose,
            first_estimate: pose,
            pinned: false,
        });
        id
    }

    /// Takes the tracks of the newest image, corrects the state by those that ended or fill the
    /// window, and lets the oldest clone go when the window is full.
    ///
    /// # Errors
    /// [`EstimatorError::Diverged`].
    pub fn track_update(&mut self, observations: &[TrackObservation]) -> Result<TrackReport, EstimatorError> {
        let Some(newest) = self.state.clones.last().map(|clone| clone.id) else {
            return Ok(TrackReport::default());
        };
        self.tracks.add(newest, observations);
        self.track_settings.standing = self.stand_still()?;
        let mut ready = self.tracks.take_ended(newest);
        let leaving = self.leaving_clones();
        for &place in &leaving {
            ready.extend(self.tracks.take_seen_by(self.state.clones[place].id));
        }
        let (information, report) =
            track_update::collect(&self.state, &self.covariance, &self.rig, &ready, &self.track_settings)?;
        if let Some(information) = information {
            let correction = self.covariance.measurement_update(&information)?;
            self.state.retract(&correction);
        }
        self.health.note_tracks(self.state.stamp_ns, &report);
        self.check_health()?;
        self.marginalize(&leaving);
        Ok(report)
    }

    /// Tells the filter that the body stands, where it does and the filter can believe it.
    fn stand_still(&mut self) -> Result<bool, EstimatorError> {
        let still = self.config.zero_velocity
            && zero_velocity::stands_still(&self.state, &self.rig, &self.tracks, self.config.sigma_track_px);
        if !still {
            return Ok(false);
        }
        let information = zero_velocity::zero_velocity(&self.state);
        let innovation = self.covariance.innovation_squared(&information)?;
        let plausible = self.frame_gate.accepts(innovation, information.rows);
        if plausible {
            let correction = self.covariance.measurement_update(&information)?;
            self.state.retract(&correction);
        }
        Ok(plausible)
    }

    /// Places of the clones that the window has no room for. A pinned one stays beyond it.
    fn leaving_clones(&self) -> Vec<usize> {
        let surplus = self.state.clones.len().saturating_sub(self.config.window);
        (0..surplus).filter(|&place| !self.state.clones[place].pinned).collect()
    }

    fn marginalize(&mut self, places: &[usize]) {
        if places.is_empty() {
            return;
        }
        let gone: Vec<usize> =
            places.iter().filter_map(|&place| self.state.range(Block::Clone(place))).flatten().collect();
        let kept: Vec<usize> = (0..self.state.dim()).filter(|index| !gone.contains(index)).collect();
        self.covariance.gather(&kept);
        let mut place = 0;
        self.state.clones.retain(|_| {
            place += 1;
            !places.contains(&(place - 1))
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
        let exact = PoseWithCovariance { pose: self.rig[0].imu_from_camera, covariance: Matrix6::zeros() };
        Some(global_from_imu.compose(&exact))
    }

    /// Unit vector along gravity in the first camera when a clone was made; `None` for a clone that is gone.
    pub fn gravity_in_first_camera(&self, clone: CloneId) -> Option<Vector3<f64>> {
        let local_from_imu = self.state.clones[self.state.place_of(clone)?].local_from_imu;
        Some(self.gravity_in_camera(&local_from_imu))
    }

    /// Names of the keyframes that it holds.
    pub fn held_keyframes(&self) -> Vec<protocol::KeyframeId> {
        self.covariance.held.ids().collect()
    }

    /// Version of the map that the held keyframes are of.
    pub fn map_version(&self) -> Option<u64> {
        self.map_version
    }

    fn block(&self, row: &Block, column: &Block) -> Matrix6<f64> {
        match (self.state.range(*row), self.state.range(*column)) {
            (Some(rows), Some(columns)) => {
                self.covariance.active.fixed_view::<6, 6>(rows.start, columns.start).into_owned()
            }
            _ => Matrix6::zeros(),
        }
    }
}
