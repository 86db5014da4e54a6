//! Why a map cannot be extended.

use map::contents::ContentsError;
use map::sessions::SessionOverlap;
use protocol::KeyframeId;

use crate::error::BuildError;

/// Why a map cannot be extended by a recording. The map remains as it was.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExtendError {
    /// The recording itself gives no map.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// The map has no keyframes.
    #[error("the map has no keyframes: build it from the recording instead of extending it")]
    Empty,
    /// The vertical of the map is unknown or another axis than z.
    #[error(
        "the map's frame must have z up, so that the IMU can be used, but its direction of gravity is {}: build the map without \
         poses, or with --gravity 0,0,-1 and poses in a frame with z up",
        gravity.map_or("unknown".to_owned(), |[x, y, z]| format!("{x:.4}, {y:.4}, {z:.4}"))
    )]
    Vertical {
        /// Direction of gravity in G, where the map states one.
        gravity: Option<[f64; 3]>,
    },
    /// The map has the recording, or a piece of it.
    #[error(
        "the recording is in the map already: {0}. Extend the map by another recording, or by the part of this one that the map \
         lacks: --from and --until"
    )]
    SessionInMap(#[from] SessionOverlap),
    /// The recording is part of the map.
    #[error(
        "keyframe {keyframe} of the map was taken at {stamp_ns} ns, when the recording has an image too: is it in the map already? \
         Used twice, it would make the map look more accurate than it is"
    )]
    AlreadyInMap {
        /// A keyframe of the map.
        keyframe: KeyframeId,
        /// Its time (ns).
        stamp_ns: i64,
    },
    /// Too few images show a place of the map.
    #[error(
        "the recording is not connected to the map: {found} of its {keyframes} keyframes look like a place of the map ({told_apart} of \
         them like no other one), and {agreeing} of these agree on where; {wanted} are needed. Record from a place in the map, with \
         similar views"
    )]
    NotConnected {
        /// Keyframes of the recording.
        keyframes: usize,
        /// Those for which recognition found a place.
        found: usize,
        /// Those that look like one place and like no other one.
        told_apart: usize,
        /// Those that agree with each other.
        agreeing: usize,
        /// How many must.
        wanted: usize,
    },
    /// The covariance of the map's poses is none.
    #[error(
        "the cross-covariances of the map's keyframes contradict each other: import or build the map again"
    )]
    Indefinite,
    /// The covariance of the recording's own trajectory is not positive definite.
    #[error(
        "the recording cannot be compared with the map: the covariance of its own trajectory is not positive definite"
    )]
    Incomparable,
    /// The result violates an invariant of maps.
    #[error("the extended map is invalid, which is a fault of this program: {0}")]
    Contents(#[from] ContentsError),
}
