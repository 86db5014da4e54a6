//! Result of a map update.

use crate::map_update::map_gravity::GravityFault;
use crate::map_update::map_initializer::Waiting;
use crate::map_update::verification::NotVerified;

/// Why an answer of the map did not update the state.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Rejection {
    /// The clone of its image was marginalized: the answer came after its deadline.
    #[error("the answer came too late: the clone of its image was marginalized")]
    TooLate,
    /// It is to an image of a camera that there is not.
    #[error("it is to an image of camera {camera}, which the estimator does not have")]
    NoCamera {
        /// The camera.
        camera: usize,
    },
    /// It is of another map than the one in use, whatever its version.
    #[error(
        "it is of the map {answered:032x}, the map {held:032x} is in use: another map is served under this name; restart the \
         robot to use that one"
    )]
    OtherMap {
        /// Identity of the map of the answer.
        answered: u128,
        /// Identity of the map in use.
        held: u128,
    },
    /// It is of an older map version than the one in use.
    #[error("it is of map version {answered}, version {held} is in use")]
    OldMapVersion {
        /// Version of the answer.
        answered: u64,
        /// Version in use.
        held: u64,
    },
    /// It is of a newer map version whose changes have not been announced yet.
    #[error("it is of map version {answered}, whose changes from version {held} have not been announced yet")]
    UnannouncedMapVersion {
        /// Version of the answer.
        answered: u64,
        /// Version in use.
        held: u64,
    },
    /// Covariances and cross-covariances of the keyframes are inconsistent.
    #[error("the map's covariances and cross-covariances contradict each other; build the map again")]
    InconsistentMap,
    /// The mode ignores the map.
    #[error("odometry only, by configuration")]
    Odometry,
    /// Geometric verification failed.
    #[error(transparent)]
    NotVerified(#[from] NotVerified),
    /// The map's direction of gravity is not that of the images and the IMU; the next answer must show the same.
    #[error(transparent)]
    Gravity(#[from] GravityFault),
    /// The evidence for a first pose in the map is not enough yet.
    #[error("{0}")]
    NotDistinctive(Waiting),
    /// Too few landmarks passed the gate.
    #[error("{used} of {inliers} verified landmarks passed the gate, {need} are needed")]
    FewLandmarks {
        /// Landmarks that passed the gate.
        used: usize,
        /// Inliers of the geometric verification.
        inliers: usize,
        /// Landmarks needed.
        need: usize,
    },
    /// Most of the answer contradicts the state: perceptual aliasing, or a wrong state.
    #[error(
        "{plausible} of {inliers} verified landmarks agree with the state; the next answer must agree with this one"
    )]
    Contradicts {
        /// Landmarks within the contradiction confidence.
        plausible: usize,
        /// Inliers of the geometric verification.
        inliers: usize,
    },
    /// The pose that the matches show is too far from the state.
    #[error("its pose contradicts the state: NIS {nis:.0} over {rows} degrees of freedom")]
    Far {
        /// Normalized innovation squared of the poses.
        nis: f64,
        /// Degrees of freedom.
        rows: usize,
    },
    /// Successive answers agree with each other and not with the state, which was replaced by theirs, `global_from_local`
    /// included.
    #[error(
        "the last {fixes} answers agree with each other and not with the state: it was replaced by theirs"
    )]
    Restarted {
        /// Number of answers.
        fixes: usize,
    },
    /// The update as a whole failed the gate.
    #[error("contradicts the state: NIS {nis:.0} over {rows} rows exceeds {bound:.0}")]
    Implausible {
        /// Normalized innovation squared.
        nis: f64,
        /// Degrees of freedom.
        rows: usize,
        /// Bound of the gate.
        bound: f64,
    },
}

/// Result of [`Estimator::map_update`](crate::Estimator::map_update).
#[derive(Clone, Debug, PartialEq)]
pub struct MapReport {
    /// Keyframes of the answer that the mode allows and that are valid.
    pub keyframes: usize,
    /// Matched landmarks of the answer.
    pub matches: usize,
    /// Inliers of the geometric verification.
    pub inliers: usize,
    /// Landmarks that passed the gate and were used.
    pub used: usize,
    /// Landmarks that do not contradict the state.
    pub plausible: usize,
    /// Mean reprojection error of the inliers at the predicted pose, px; `None` where one of them does not project.
    pub mean_reprojection_px: Option<f64>,
    /// The pose of the answer was further from the state than their covariances allow; that of `global_from_local` was
    /// inflated by the difference.
    pub inflated: bool,
    /// The linearization point was moved.
    pub relinearized: bool,
    /// `global_from_local` was initialized by this answer.
    pub initialized: bool,
    /// Hypotheses about `global_from_local` that were dropped: others have more evidence.
    pub hypotheses_dropped: usize,
    /// Normalized innovation squared and its degrees of freedom.
    pub nis: Option<(f64, usize)>,
    /// Why it did not update the state; `None` where it did.
    pub rejection: Option<Rejection>,
}
