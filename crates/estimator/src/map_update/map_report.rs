//! What became of an answer of the map.

use crate::map_update::verification::NotVerified;

/// Why an answer did not correct the state.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Rejection {
    /// The clone of its image is gone: the answer came after its deadline.
    #[error("the answer came too late, the pose of its image is gone")]
    TooLate,
    /// It is of the map as it was before the version in use.
    #[error("it is of map version {answered}, version {held} is in use")]
    OldMap {
        /// The answer's.
        answered: u64,
        /// The filter's.
        held: u64,
    },
    /// It is of a version of the map of which no news came yet.
    #[error("it is of map version {answered}, and nobody said yet how that differs from version {held}")]
    NewMap {
        /// The answer's.
        answered: u64,
        /// The filter's.
        held: u64,
    },
    /// The keyframes' covariances cannot all be true.
    #[error("the map's covariances and cross-covariances contradict each other; build the map again")]
    UnsoundMap,
    /// The mode ignores the map.
    #[error("odometry only, by configuration")]
    Odometry,
    /// Geometry does not support it.
    #[error(transparent)]
    NotVerified(#[from] NotVerified),
    /// Too few landmarks passed their gates.
    #[error("{accepted} of {verified} verified landmarks passed the gate, {need} are needed")]
    FewLandmarks {
        /// Passed.
        accepted: usize,
        /// Verified by geometry.
        verified: usize,
        /// Needed.
        need: usize,
    },
    /// Most of the answer contradicts the state: another place that looks the same, or a state that is off.
    #[error(
        "{plausible} of {verified} verified landmarks agree with the state; the next answer must say the same to be believed"
    )]
    Contradicts {
        /// Not out of the question.
        plausible: usize,
        /// Verified by geometry.
        verified: usize,
    },
    /// The whole contradicts the state.
    #[error("contradicts the state: innovation {innovation:.0} over {rows} rows, {bound:.0} is acceptable")]
    Implausible {
        /// Normalized innovation squared.
        innovation: f64,
        /// Rows.
        rows: usize,
        /// Bound of the gate.
        bound: f64,
    },
}

/// What an answer did.
#[derive(Clone, Debug, PartialEq)]
pub struct MapReport {
    /// Keyframes of the answer that were considered.
    pub keyframes: usize,
    /// Landmarks of the answer.
    pub matches: usize,
    /// Landmarks that one camera pose explains.
    pub verified: usize,
    /// Landmarks that corrected the state.
    pub accepted: usize,
    /// Mean reprojection error of the verified landmarks at the prediction, px.
    pub mean_reprojection_px: Option<f64>,
    /// The linearization point was moved.
    pub relinearized: bool,
    /// `global_from_local` was initialized by this answer.
    pub initialized: bool,
    /// Normalized innovation squared and its rows.
    pub innovation: Option<(f64, usize)>,
    /// Why it did not correct the state.
    pub rejection: Option<Rejection>,
}
