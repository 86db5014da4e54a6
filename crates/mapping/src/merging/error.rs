//! Why two maps cannot be merged.

use map::contents::ContentsError;
use map::sessions::SessionOverlap;
use protocol::KeyframeId;

use crate::error::BuildError;

/// Why two maps cannot be merged. Both remain as they were.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MergeError {
    /// Places cannot be searched.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// A map has no keyframes.
    #[error("a map without keyframes cannot be merged")]
    Empty,
    /// The vertical of a map is unknown or another axis than z.
    #[error(
        "the frame of the {which} map must have z up, but its direction of gravity is {}: build it without poses, or with --gravity \
         0,0,-1 and poses in a frame with z up, or import its COLMAP model with --gravity",
        gravity.map_or("unknown".to_owned(), |[x, y, z]| format!("{x:.4}, {y:.4}, {z:.4}"))
    )]
    Vertical {
        /// Which one.
        which: &'static str,
        /// Direction of gravity in its frame, where the map states one.
        gravity: Option<[f64; 3]>,
    },
    /// The features of the maps cannot be compared.
    #[error(
        "the maps have features of different extractors: {first} and {second}; build one of them anew with --extractor"
    )]
    Extractors {
        /// That of the first map.
        first: String,
        /// That of the second map.
        second: String,
    },
    /// Both maps have a session, or pieces of one.
    #[error(
        "both maps are made of one recording, or extended from one map: of the second map, {0}. Build one of them without this \
         recording, or extend the other one by the recordings that it lacks"
    )]
    SharedSession(#[from] SessionOverlap),
    /// Both maps are made of the same recording.
    #[error(
        "keyframe {keyframe} of the second map was taken at {stamp_ns} ns, as one of the first: are both made of one recording, or \
         extended from one map? Used twice, it would make the map look more accurate than it is"
    )]
    InBoth {
        /// A keyframe of the second map.
        keyframe: KeyframeId,
        /// Its time (ns).
        stamp_ns: i64,
    },
    /// Both maps are made of one image, whose time is not known.
    #[error(
        "keyframe {keyframe} of the second map sees the same pixels as keyframe {other} of the first: both are made of one image. Used \
         twice, it would make the map look more accurate than it is"
    )]
    SameImage {
        /// A keyframe of the second map.
        keyframe: KeyframeId,
        /// The keyframe of the first map.
        other: KeyframeId,
    },
    /// Too few keyframes show a place of the other map.
    #[error(
        "the maps are not connected: {found} of the second one's {keyframes} keyframes show a place of the first, and {agreeing} of \
         these agree on where; {wanted} are needed. Extend one of them by a recording that leads from one to the other"
    )]
    NotConnected {
        /// Keyframes of the second map.
        keyframes: usize,
        /// Those for which recognition found a place.
        found: usize,
        /// Those that agree with each other.
        agreeing: usize,
        /// How many must.
        wanted: usize,
    },
    /// The places that look alike lie elsewhere.
    #[error(
        "the maps contradict each other: of {alike} landmarks that look alike in the places that both show, {refused} lie elsewhere by \
         more than the maps state. Is one of them deformed, or built with a wrong calibration or too small sigmas?"
    )]
    Contradiction {
        /// Landmarks that look alike.
        alike: usize,
        /// Those that contradict the rest.
        refused: usize,
    },
    /// The covariance of a map's poses is none.
    #[error("the cross-covariances of a map's keyframes contradict each other: import or build it again")]
    Indefinite,
    /// The result violates an invariant of maps.
    #[error("the merged map is invalid, which is a fault of this program: {0}")]
    Contents(#[from] ContentsError),
}
