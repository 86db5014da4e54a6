//! Why a session is not used.

use map::ContentsError;
use map::sessions::SessionOverlap;
use mapping::{ExtendError, OdometryError};

/// Why a session is not used. The map remains as it was.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The map has it, or a piece of it.
    #[error("it was handed in before: {0}")]
    InMap(#[from] SessionOverlap),
    /// Its odometry fails.
    #[error("its odometry fails: {0}")]
    Odometry(#[from] OdometryError),
    /// The map has a keyframe of one of its images.
    #[error("it was handed in before: {0}")]
    ImageInMap(Box<ExtendError>),
    /// It shows no place of the map.
    #[error("it is of another place, or too little of it is of this one: {0}")]
    OtherPlace(Box<ExtendError>),
    /// What it shows is of this place or of one that looks alike.
    #[error(
        "it may be of another place: {agreeing} of its keyframes agree with a place of the map, of whose views another one explains {:.0} %, and \
         only {told_apart} of them look like no other one; at least {least} must",
        100.0 * repeating
    )]
    Repeating {
        /// Part of the map's views that another place of it explains as well.
        repeating: f64,
        /// Keyframes that agree with its trajectory.
        agreeing: usize,
        /// Those of them that show a place that looks like no other one.
        told_apart: usize,
        /// How many must.
        least: usize,
    },
    /// It cannot be located in the map for another reason.
    #[error("it cannot be located in the map: {0}")]
    Extension(Box<ExtendError>),
    /// The places that it shows do not agree with its trajectory.
    #[error(
        "it contradicts the map: {found} of its keyframes show a place of the map that looks like no other one, and {agreeing} of them \
         agree with its trajectory; at least {wanted} must. Is the calibration the robot's? (`driftless check-calibration`)"
    )]
    Places {
        /// Keyframes that show a place that looks like no other one.
        found: usize,
        /// Those that agree.
        agreeing: usize,
        /// How many must.
        wanted: usize,
    },
    /// Its pixels do not fit its own trajectory.
    #[error(
        "it contradicts itself: its pixels fit its trajectory to {sigma_px:.1} px, those of the map's first session to {map_px:.1} px, and \
         at most {limit:.1} px, and less than {most:.0}, are allowed. Is the calibration the robot's? (`driftless check-calibration`)",
        most = mapping::MAX_SIGMA_PX
    )]
    Pixels {
        /// Pixel noise of the session (px).
        sigma_px: f64,
        /// That of the session that the map began with (px).
        map_px: f64,
        /// The largest that is allowed (px).
        limit: f64,
    },
    /// The map moves its keyframes relative to each other by more than both state.
    #[error(
        "it contradicts the map, which moves its keyframes relative to each other by a chi-square of {chi_square:.0} with {freedom:.0} \
         degrees of freedom; at most {limit:.0} is allowed. Is the calibration the robot's? (`driftless check-calibration`)"
    )]
    Moved {
        /// How far the map moves them, squared, in units of what both state.
        chi_square: f64,
        /// Mean of that where both are as stated.
        freedom: f64,
        /// The largest that is allowed.
        limit: f64,
    },
    /// Nothing would be left of the map.
    #[error("no keyframe of the map would be left: is the session of this place?")]
    NothingLeft,
    /// The result violates an invariant of maps.
    #[error("the map that it gives is invalid, which is a fault of this program: {0}")]
    Contents(#[from] ContentsError),
}

impl Refusal {
    /// [`Refusal::kind`] of a session that shows too little of the map, which may grow to its place.
    pub const OTHER_PLACE: &'static str = "other-place";

    /// That of one that contradicts the map, or itself.
    pub const CONTRADICTION: &'static str = "contradiction";
    /// That of one that cannot be used for another reason.
    pub const UNUSABLE: &'static str = "unusable";

    /// The reason in one word, for programs: `twice`, `other-place`, `contradiction`, `unusable`.
    pub fn kind(&self) -> &'static str {
        match self {
            Refusal::InMap(_) | Refusal::ImageInMap(_) => "twice",
            Refusal::OtherPlace(_) | Refusal::Repeating { .. } => Self::OTHER_PLACE,
            Refusal::Places { .. } | Refusal::Pixels { .. } | Refusal::Moved { .. } => Self::CONTRADICTION,
            Refusal::Odometry(_) | Refusal::Extension(_) | Refusal::NothingLeft | Refusal::Contents(_) => {
                Self::UNUSABLE
            }
        }
    }
}

impl From<ExtendError> for Refusal {
    fn from(error: ExtendError) -> Self {
        match error {
            ExtendError::SessionInMap(overlap) => Refusal::InMap(overlap),
            ExtendError::AlreadyInMap { .. } => Refusal::ImageInMap(Box::new(error)),
            // Images that show the map everywhere, and a trajectory that is nowhere in it.
            ExtendError::NotConnected { told_apart, agreeing, wanted, .. } if told_apart >= 2 * wanted => {
                Refusal::Places { found: told_apart, agreeing, wanted }
            }
            ExtendError::NotConnected { .. } => Refusal::OtherPlace(Box::new(error)),
            error => Refusal::Extension(Box::new(error)),
        }
    }
}
