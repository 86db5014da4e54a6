//! The filter: its members, and its verbs in the files of this module.

mod accessors;
mod gnss_update;
mod iterated_update;
mod map_initialization;
pub mod map_knowledge;
mod map_linearization;
mod map_revision;
mod map_update;
mod outlier_test;
mod rescue;
mod row_motion;
pub mod status;
mod still_pixels;
mod time_update;
mod track_update;
mod wheel_update;

use crate::calibration::{CalibratedCamera, Calibration};
use crate::config::{ConfigError, EstimatorConfig};
use crate::covariance::JointCovariance;
use crate::error::EstimatorError;
use crate::gate::Gate;
use crate::gnss::Gnss;
use crate::health::Health;
use crate::imu::ImuBuffer;
use crate::imu::repetition::Repetition;
use crate::initialization::static_init::InitialState;
use crate::linear_algebra::dense::Dense;
use crate::map_update::map_fix::{MapFix, MapFixes};
use crate::map_update::map_gravity::MapGravity;
use crate::map_update::map_initializer::MapInitializer;
use crate::map_update::map_revision::MapVersion;
use crate::map_update::map_watch::MapWatch;
use crate::map_update::place_evidence::PlaceEvidence;
use crate::map_update::repeated_views::RepeatedViews;
use crate::motion::AngularRate;
use crate::noise_adaptation::NoiseAdaptation;
use crate::odometry::msckf_update::MsckfSettings;
use crate::odometry::tracks::TrackStore;
use crate::odometry::{second_order, slam_update};
use crate::propagation::{IMU_DIM, ImuMatrix, MotionEstimate};
use crate::state::ActiveState;
use crate::wheels::WheelOdometry;
use crate::wheels::calibration::WheelCalibration;
use crate::wheels::config::WheelConfig;
use geometry::Pose;
use nalgebra::{DMatrix, DVector};
use track_update::OdometryUpdate;

/// Confidence of the gate beyond which a landmark of the map contradicts the state. All landmarks of a keyframe share the
/// error of its pose, so they fail the landmark gate together now and then.
const CONTRADICTION_CONFIDENCE: f64 = 0.9999;
/// Residual after triangulation beyond which an observation is an outlier, sigmas, whatever the errors of the clones.
const OUTLIER_SIGMAS: f64 = 5.0;

/// The CS-MSCKF filter.
///
/// Feed it in the order of time; per image: [`Self::imu`], [`Self::time_update`], [`Self::track_update`], and
/// [`Self::map_update`] when the map answered to an image whose clone was pinned with [`Self::pin`].
///
/// # Coordinate systems
/// * L, local: origin at the first pose, z up, no yaw at the first pose. Drifts against the world.
/// * G, global: the frame of the map. `global_from_local` is unknown until the first map update.
/// * IMU: the body. Its pose in L is the state.
///
/// # Example
/// ```
/// use estimator::{CalibratedCamera, Estimator, EstimatorConfig, ImuSample, InitialSigmas, InitialState};
/// use geometry::{Camera, Distortion, Pose};
/// use nalgebra::Vector3;
///
/// let camera = Camera {
///     width: 640,
///     height: 480,
///     focal: [400.0; 2],
///     centre: [320.0, 240.0],
///     distortion: Distortion::None,
/// };
/// let cameras = vec![CalibratedCamera::new(camera, Pose::identity())];
/// // A known pose in a frame with z up, at rest.
/// let start = InitialState::from_truth(
///     0,
///     &Pose::identity(),
///     &Vector3::zeros(),
///     &-Vector3::z(),
///     InitialSigmas::default(),
/// );
/// let mut estimator = Estimator::new(EstimatorConfig::default(), cameras, &start)?;
///
/// // A tenth of a second at rest, then an image.
/// for k in 0..=20 {
///     estimator.imu(ImuSample {
///         stamp_ns: k * 5_000_000,
///         gyroscope: Vector3::zeros(),
///         accelerometer: Vector3::new(0.0, 0.0, 9.81),
///     })?;
/// }
/// let clone = estimator.time_update(100_000_000)?;
/// estimator.track_update(&[])?;
///
/// let pose = estimator.local_from_imu();
/// assert!(pose.pose.translation.norm() < 1e-9);
/// assert!(pose.covariance[(3, 3)] > 0.0); // m^2
/// assert!(estimator.global_from_imu().is_none()); // not yet localized in a map
/// assert!(estimator.gravity_in_camera(clone, 0).is_some());
/// # Ok::<(), estimator::EstimatorError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Estimator {
    config: EstimatorConfig,
    imu: ImuBuffer,
    state: ActiveState,
    /// What the gyroscope measured at the time of the state.
    angular_rate: AngularRate,
    covariance: JointCovariance,
    tracks: TrackStore,
    msckf_settings: MsckfSettings,
    /// What the pixels of a camera err by for long, rad.
    lasting_error_rad: f64,
    odometry_update: OdometryUpdate,
    /// Reused memory of the last correction.
    correction: DVector<f64>,
    /// Reused memory of the Jacobian of features that are added to the state.
    feature_jacobian: Dense,
    landmark_gate: Gate,
    contradiction_gate: Gate,
    frame_gate: Gate,
    next_clone: u64,
    map_version: MapVersion,
    rejections_in_a_row: usize,
    /// `global_from_local` according to the last answer, if most of that contradicted the state.
    contradiction: Option<Pose>,
    /// Poses of answers that contradicted the state.
    map_fixes: MapFixes,
    /// That of the last answer, as long as it is not known whether it updates the state.
    newest_fix: Option<MapFix>,
    /// Evidence for `global_from_local`, since odometry last failed.
    support: PlaceEvidence,
    /// Evidence of the answers against it since the last one that agreed.
    against: PlaceEvidence,
    /// What would initialize `global_from_local`.
    map_initializer: MapInitializer,
    map_gravity: MapGravity,
    map_watch: MapWatch,
    /// Answers from where the robot is now.
    repeated_views: RepeatedViews,
    last_map_update_ns: Option<i64>,
    last_gnss_update_ns: Option<i64>,
    /// Whether the position in G has been known well enough once since its initialization.
    known_in_map: bool,
    last_zero_velocity_ns: Option<i64>,
    /// Consecutive rejections after which `global_from_local` was removed, until the next map update.
    lost_after: Option<usize>,
    health: Health,
    noise: NoiseAdaptation,
    repetition: Repetition,
    wheels: Option<Box<WheelOdometry>>,
    gnss: Option<Box<Gnss>>,
}

impl Estimator {
    /// A filter that starts from `initial`, with `global_from_local` unknown.
    ///
    /// # Arguments
    /// * `cameras`: by [`TrackObservation::camera`](crate::TrackObservation::camera); an answer of the map names the one that it is to.
    /// * `initial`: state and 15x15 covariance at the first image, see [`InitialState`] and
    ///   [`Initializer`](crate::Initializer).
    ///
    /// # Errors
    /// [`EstimatorError::Config`] names the invalid setting or camera.
    pub fn new(
        config: EstimatorConfig,
        cameras: Vec<CalibratedCamera>,
        initial: &InitialState,
    ) -> Result<Self, EstimatorError> {
        config.validate()?;
        if cameras.is_empty() {
            return Err(ConfigError::NoCamera.into());
        }
        for (camera, calibrated) in cameras.iter().enumerate() {
            calibrated.camera.validate().map_err(|source| ConfigError::Camera { camera, source })?;
        }
        let cameras = config.with_readout_times(cameras);
        let calibration = Calibration::new(cameras, config.camera_time_offset_s, config.calibration);
        let covariance = initial_covariance(&initial.covariance, &calibration, config.wheels.as_ref());
        let covariance = JointCovariance::new(covariance, config.max_active_keyframes);
        let health = Health::new(initial, &config);
        let state = ActiveState {
            stamp_ns: initial.stamp_ns,
            imu: initial.imu,
            first_motion: MotionEstimate::of(&initial.imu),
            calibration,
            wheels: config.wheels.as_ref().map(WheelCalibration::new),
            transform: None,
            slam_features: Vec::new(),
            clones: Vec::new(),
        };
        Ok(Self {
            msckf_settings: MsckfSettings {
                sigma_px: config.sigma_track_px,
                first_estimates: config.first_estimates,
                gate: Gate::new(config.track_gate),
                stationary: false,
                outlier_sigmas: OUTLIER_SIGMAS,
                second_order_terms: second_order::terms(&state.calibration),
                learns_noise: config.adaptive_noise.tracks,
                max_tracks: config.max_tracks,
            },
            lasting_error_rad: slam_update::lasting_error_rad(&state.calibration),
            landmark_gate: Gate::new(config.landmark_gate),
            contradiction_gate: Gate::new(CONTRADICTION_CONFIDENCE),
            frame_gate: Gate::new(config.frame_gate),
            noise: NoiseAdaptation::new(&config, None),
            wheels: config.wheels.map(WheelOdometry::new).map(Box::new),
            gnss: config.gnss.map(Gnss::new).map(Box::new),
            config,
            imu: ImuBuffer::default(),
            repetition: Repetition::default(),
            state,
            angular_rate: AngularRate::default(),
            covariance,
            tracks: TrackStore::default(),
            odometry_update: OdometryUpdate::default(),
            correction: DVector::zeros(0),
            feature_jacobian: Dense::default(),
            next_clone: 0,
            map_version: MapVersion::default(),
            rejections_in_a_row: 0,
            contradiction: None,
            map_fixes: MapFixes::default(),
            newest_fix: None,
            support: PlaceEvidence::default(),
            against: PlaceEvidence::default(),
            map_initializer: MapInitializer::default(),
            map_gravity: MapGravity::default(),
            map_watch: MapWatch::default(),
            repeated_views: RepeatedViews::default(),
            last_map_update_ns: None,
            last_gnss_update_ns: None,
            last_zero_velocity_ns: None,
            known_in_map: false,
            lost_after: None,
            health,
        })
    }
}

/// Covariance of the errors of IMU, calibration and wheels, which are independent at first.
fn initial_covariance(
    imu: &ImuMatrix,
    calibration: &Calibration,
    wheels: Option<&WheelConfig>,
) -> DMatrix<f64> {
    let wheels_begin = IMU_DIM + calibration.dim();
    let of_wheels = wheels.map(WheelCalibration::initial_covariance).unwrap_or_default();
    let dim = wheels_begin + of_wheels.nrows();
    let mut covariance = DMatrix::zeros(dim, dim);
    covariance.fixed_view_mut::<IMU_DIM, IMU_DIM>(0, 0).copy_from(imu);
    let of_calibration = calibration.initial_covariance();
    covariance.view_mut((IMU_DIM, IMU_DIM), of_calibration.shape()).copy_from(&of_calibration);
    covariance.view_mut((wheels_begin, wheels_begin), of_wheels.shape()).copy_from(&of_wheels);
    covariance
}
