//! Poses in the map that an operator sets: where the map is searched first, and nothing else.
//!
//! The pose becomes the prior of map queries, moved on by odometry, until the map has answered one of them. It never is a
//! measurement of the filter: the pose that is published comes from what the images show, with their covariance.

use super::query_cameras::QueryImage;
use estimator::Estimator;
use geometry::covariance_check::{CovarianceError, check_covariance};
use geometry::{MAX_COORDINATE_M, Pose, PoseWithCovariance, is_coordinate};
use nalgebra::Vector3;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Standard deviations of what a pose in the plane leaves out, with a variance of zero: height (metres), roll and pitch (rad).
const SIGMA_HEIGHT_M: f64 = 1.0;
const SIGMA_TILT_RAD: f64 = 0.2;
/// Quaternions shorter than this have no direction.
const MIN_QUATERNION_NORM: f64 = 1e-6;
/// 99.9 % of the squared difference of two poses that agree, by their covariances (chi-square, 6 degrees of freedom).
const AGREEMENT: f64 = 22.46;
/// A pose waits so long for the estimator to be initialized: the robot moves meanwhile, and nobody knows where to.
const MAX_WAIT: Duration = Duration::from_secs(10);
/// A pose that contradicts the estimate is given up where the map has not decided after so long, nanoseconds.
const MAX_DOUBT_NS: i64 = 30_000_000_000;
/// The status names a refused pose for so long.
const SHOWN: Duration = Duration::from_secs(10);

/// Why a pose that an operator set is not used. To be read after "the operator's pose is refused: ".
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InitialPoseError {
    /// It is of another frame.
    #[error("it is in the frame {given:?}, not in {wanted:?}: choose {wanted:?} as the fixed frame")]
    Frame {
        /// The frame of the message.
        given: String,
        /// The frame of the map.
        wanted: String,
    },
    /// A number is not finite.
    #[error("its position or orientation is not finite")]
    NotFinite,
    /// The position cannot be in a map.
    #[error("its position is beyond {MAX_COORDINATE_M:e} m")]
    Far,
    /// The quaternion has no direction.
    #[error("its orientation is no rotation: the quaternion has length {norm:.1e}")]
    NoRotation {
        /// Length of the quaternion.
        norm: f64,
    },
    /// The covariance is not valid.
    #[error("its covariance {0}")]
    Covariance(#[from] CovarianceError),
    /// Position in the plane or heading is stated to be exact.
    #[error("its covariance is zero for {0}: state how sure you are of x, y and heading")]
    Exact(&'static str),
    /// The bytes are no message.
    #[error("it cannot be read: {0}")]
    Unreadable(String),
    /// There is no map to search.
    #[error("there is no map in this run")]
    NoMap,
    /// The estimator was not initialized in time.
    #[error("the estimator was not initialized within {} s; set it again", MAX_WAIT.as_secs())]
    Waited,
    /// The estimator diverged.
    #[error("the estimator diverged since; set it again")]
    Diverged,
}

/// Where the poses of an operator wait for the run; the newest one replaces the one before. Clones share it.
///
/// ```
/// use geometry::uncertain_pose::isotropic_covariance;
/// use geometry::{Pose, PoseWithCovariance};
/// use robot::initial_pose::{InitialPoseError, InitialPoses};
///
/// let (poses, body_from_imu) = (InitialPoses::default(), Pose::identity());
/// let global_from_body = PoseWithCovariance::new(Pose::identity(), isotropic_covariance(0.3, 0.5));
/// assert!(poses.set(global_from_body, &body_from_imu).is_ok());
/// let exact = PoseWithCovariance::exact(Pose::identity());
/// assert_eq!(poses.set(exact, &body_from_imu), Err(InitialPoseError::Exact("x")));
/// ```
#[derive(Clone, Debug, Default)]
pub struct InitialPoses {
    newest: Arc<Mutex<Option<Result<PoseWithCovariance, InitialPoseError>>>>,
}

impl InitialPoses {
    /// Sets the pose of the robot now.
    ///
    /// # Arguments
    /// * `global_from_body`: of the robot's frame. Height, roll and pitch may have a variance of zero, as of a pose that was
    ///   set in the plane; they are then taken for uncertain by 1 m and 0.2 rad.
    /// * `body_from_imu`: pose of the IMU in the robot's frame.
    ///
    /// # Errors
    /// [`InitialPoseError`], which the status of the robot names as well.
    pub fn set(
        &self,
        global_from_body: PoseWithCovariance,
        body_from_imu: &Pose,
    ) -> Result<(), InitialPoseError> {
        let checked = checked(global_from_body).map(|checked| checked.change_of_child(body_from_imu));
        self.put(checked.clone());
        checked.map(drop)
    }

    /// Tells the operator that a pose cannot be used.
    pub fn refuse(&self, error: InitialPoseError) {
        self.put(Err(error));
    }

    fn put(&self, pose: Result<PoseWithCovariance, InitialPoseError>) {
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(pose);
    }

    /// Takes out the newest pose, or why it cannot be used; `None` where there is none since the last time.
    pub fn take(&self) -> Option<Result<PoseWithCovariance, InitialPoseError>> {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// A quaternion of any length as a rotation.
///
/// # Arguments
/// * `coordinates`: x, y, z, w.
///
/// # Errors
/// [`InitialPoseError::NotFinite`], [`InitialPoseError::NoRotation`].
pub fn rotation_of(coordinates: [f64; 4]) -> Result<geometry::Rotation, InitialPoseError> {
    let [x, y, z, w] = coordinates;
    let quaternion = nalgebra::Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if !norm.is_finite() {
        return Err(InitialPoseError::NotFinite);
    }
    if norm < MIN_QUATERNION_NORM {
        return Err(InitialPoseError::NoRotation { norm });
    }
    Ok(geometry::Rotation::from_quaternion(quaternion))
}

/// The pose with what it leaves out.
fn checked(mut given: PoseWithCovariance) -> Result<PoseWithCovariance, InitialPoseError> {
    if !given.pose.is_finite() {
        return Err(InitialPoseError::NotFinite);
    }
    if !given.pose.translation.iter().all(|coordinate| is_coordinate(*coordinate)) {
        return Err(InitialPoseError::Far);
    }
    check_covariance(&given.covariance)?;
    for (index, name) in [(3, "x"), (4, "y"), (2, "heading")] {
        if given.covariance[(index, index)] <= 0.0 {
            return Err(InitialPoseError::Exact(name));
        }
    }
    for (index, sigma) in [(5, SIGMA_HEIGHT_M), (0, SIGMA_TILT_RAD), (1, SIGMA_TILT_RAD)] {
        if given.covariance[(index, index)] <= 0.0 {
            given.covariance[(index, index)] = sigma * sigma;
        }
    }
    Ok(given)
}

/// A pose that the map is searched at.
#[derive(Clone, Copy, Debug)]
struct Prior {
    /// Where the operator said that the robot was ...
    global_from_imu: PoseWithCovariance,
    /// ... when odometry had it here.
    local_from_imu: PoseWithCovariance,
    /// Time of that state, nanoseconds.
    stamp_ns: i64,
    /// How far from the estimate it is, metres and rad, where that contradicts it.
    apart: Option<(f64, f64)>,
}

impl Prior {
    /// The pose of a camera in the map at an image: as set, moved on by odometry. Errors of odometry are counted twice at most.
    fn global_from_camera(&self, estimator: &Estimator, image: QueryImage) -> Option<PoseWithCovariance> {
        let local_from_camera = estimator.local_from_camera(image.clone, image.camera)?;
        let moved = self.local_from_imu.inverse().compose(&local_from_camera);
        Some(self.global_from_imu.compose(&moved))
    }
}

/// Where the pose of an operator is.
#[derive(Debug, Default)]
enum Stage {
    #[default]
    None,
    /// It waits for the first state.
    Waiting(Instant, Box<PoseWithCovariance>),
    Searched(Box<Prior>),
}

/// What a run makes of the poses of an operator.
#[derive(Debug, Default)]
pub(crate) struct InitialPoseSearch {
    poses: InitialPoses,
    stage: Stage,
    /// The last refusal, and when.
    refused: Option<(Instant, InitialPoseError)>,
}

impl InitialPoseSearch {
    pub(crate) fn new(poses: InitialPoses) -> Self {
        Self { poses, ..Self::default() }
    }

    /// Takes in the newest pose, and what has happened since.
    ///
    /// # Arguments
    /// * `estimator`: `None` while it is being initialized.
    /// * `has_map`: whether there is something to search.
    pub(crate) fn update(&mut self, estimator: Option<&mut Estimator>, has_map: bool) {
        match self.poses.take() {
            Some(Ok(_)) if !has_map => self.refuse(InitialPoseError::NoMap),
            Some(Ok(pose)) => self.stage = Stage::Waiting(Instant::now(), Box::new(pose)),
            Some(Err(error)) => self.refuse(error),
            None => {}
        }
        match (&self.stage, estimator) {
            (Stage::Waiting(since, _), None) if since.elapsed() > MAX_WAIT => {
                self.end(InitialPoseError::Waited);
            }
            (Stage::Waiting(_, pose), Some(estimator)) => self.stage = begun(pose, estimator),
            (Stage::Searched(prior), Some(estimator))
                if prior.apart.is_some() && estimator.stamp_ns() - prior.stamp_ns > MAX_DOUBT_NS =>
            {
                tracing::warn!(
                    "the map has neither confirmed nor refuted the operator's pose; it is forgotten"
                );
                estimator.forget_expected_pose();
                self.stage = Stage::None;
            }
            _ => {}
        }
    }

    /// The prior of a query: the pose of the operator where there is one.
    pub(crate) fn prior(&self, estimator: &Estimator, image: QueryImage) -> Option<PoseWithCovariance> {
        match &self.stage {
            Stage::Searched(prior) => prior.global_from_camera(estimator, image),
            _ => None,
        }
    }

    /// The map corrected the pose by its answer to a query: the search is over.
    ///
    /// # Arguments
    /// * `stamp_ns`: of the image, nanoseconds. One from before the pose was set decides nothing.
    pub(crate) fn answered(&mut self, estimator: &mut Estimator, image: QueryImage, stamp_ns: i64) {
        let Stage::Searched(prior) = &self.stage else { return };
        if stamp_ns < prior.stamp_ns {
            return;
        }
        let found = estimator.global_from_camera(image.clone, image.camera);
        let expected = prior.global_from_camera(estimator, image);
        let (Some(found), Some(expected)) = (found, expected) else { return };
        let (metres, radians) = distance(&found.pose, &expected.pose);
        let degrees = radians.to_degrees();
        if agree(&found, &expected) {
            tracing::info!(
                "the map confirms the operator's pose, {metres:.2} m and {degrees:.0} deg beside it"
            );
        } else {
            tracing::warn!(
                "the map puts the robot {metres:.1} m and {degrees:.0} deg from the operator's pose, which is forgotten"
            );
        }
        estimator.forget_expected_pose();
        self.stage = Stage::None;
    }

    /// The estimator diverged: where the robot went since the pose was set is not known.
    pub(crate) fn diverged(&mut self) {
        if matches!(self.stage, Stage::Searched(_)) {
            self.end(InitialPoseError::Diverged);
        }
    }

    /// For the status.
    pub(crate) fn describe(&self) -> Option<String> {
        let refused = self.refused.as_ref().filter(|(since, _)| since.elapsed() < SHOWN);
        if let Some((_, error)) = refused {
            return Some(format!("the operator's pose is refused: {error}"));
        }
        match &self.stage {
            Stage::None => None,
            Stage::Waiting(..) => Some("the operator's pose waits for the estimator".to_owned()),
            Stage::Searched(prior) => Some(match prior.apart {
                None => "the map is searched at the operator's pose first".to_owned(),
                Some((metres, radians)) => format!(
                    "the operator's pose is {metres:.1} m and {:.0} deg from the estimate: the map is asked there",
                    radians.to_degrees()
                ),
            }),
        }
    }

    fn refuse(&mut self, error: InitialPoseError) {
        tracing::warn!("the operator's pose is refused: {error}");
        self.refused = Some((Instant::now(), error));
    }

    fn end(&mut self, error: InitialPoseError) {
        self.refuse(error);
        self.stage = Stage::None;
    }
}

/// Begins to search at a pose, unless the estimate has it. A pose that was set before is replaced.
fn begun(global_from_imu: &PoseWithCovariance, estimator: &mut Estimator) -> Stage {
    estimator.forget_expected_pose();
    let mut prior = Prior {
        global_from_imu: *global_from_imu,
        local_from_imu: estimator.local_from_imu(),
        stamp_ns: estimator.stamp_ns(),
        apart: None,
    };
    if let Some(estimate) = estimator.global_from_imu() {
        let (metres, radians) = distance(&estimate.pose, &global_from_imu.pose);
        if agree(&estimate, global_from_imu) {
            tracing::info!("the operator's pose is that of the estimate, {metres:.2} m beside it");
            return Stage::None;
        }
        prior.apart = Some((metres, radians));
        let degrees = radians.to_degrees();
        tracing::warn!(
            "the operator's pose is {metres:.1} m and {degrees:.0} deg from the estimate: the map is asked there"
        );
    } else {
        tracing::info!("the map is searched at the operator's pose first");
    }
    estimator.expect_pose(global_from_imu);
    Stage::Searched(Box::new(prior))
}

/// Whether two poses differ by no more than their covariances explain.
fn agree(one: &PoseWithCovariance, other: &PoseWithCovariance) -> bool {
    let together = PoseWithCovariance::new(one.pose, one.covariance + other.covariance);
    together.nees(&other.pose).is_some_and(|squared| squared < AGREEMENT)
}

/// Metres and rad between two poses.
fn distance(one: &Pose, other: &Pose) -> (f64, f64) {
    let apart: Vector3<f64> = one.translation - other.translation;
    (apart.norm(), one.rotation.angle_to(&other.rotation))
}
