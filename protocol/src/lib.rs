//! The wire: messages, key expressions and bounded codecs.
//!
//! Everything that a robot, a map server, or anybody else says over Zenoh is a type of this crate, is put into bytes
//! by [`encode`], and comes back through [`decode`], which trusts nothing: not the length, not the bytes, not the
//! numbers in them.
//!
//! | module | what |
//! |---|---|
//! | [`matching`] | a robot asks which keyframes its image matches, one keyframe a reply |
//! | [`localize`] | one question, one global pose, for clients without an estimator |
//! | [`map`] | reading a map remotely, and news of its changes |
//! | [`robot`] | what a robot publishes |
//! | [`features`] | pixels and descriptors of one image |
//! | [`error_reply`] | why a query could not be answered |
//! | [`keys`] | key expressions and the names in them |
//! | [`codec`] | bytes: envelope, checksum, limits, schema version |
//! | [`validate`] | what a decoded message must satisfy |
//!
//! # Coordinate systems
//! Poses are named by what they map: `global_from_camera` takes a point in the camera to the map's frame. A pose's
//! covariance is over `[rotation error, position error]` in the pose's parent frame (radians, metres):
//! `R = Exp(dtheta) R^`, `p = p^ + dp`. Times are nanoseconds, pixels are distorted as the camera saw them, with (0, 0)
//! at the centre of the top-left pixel.
//!
//! # JSON
//! Every message is one flat object with `"schema"` (required) and `"type"` (optional, checked when there); optional
//! fields may be left out, unknown ones are ignored, enumerations are `snake_case` strings.
//!
//! | what | how |
//! |---|---|
//! | pose | `{"rotation_wxyz": [w, x, y, z], "translation": [x, y, z], "covariance": [6 rows of 6]}` |
//! | camera | `{"width": 752, "height": 480, "focal": [fx, fy], "centre": [cx, cy], "distortion": ..}` |
//! | distortion | `"none"`, `{"radial_tangential": [k1, k2, p1, p2]}`, `{"equidistant": [k1, k2, k3, k4]}`, `{"fov": omega}` |
//! | descriptors | `{"kind": "binary", "width": 32, "hex": ["76f9e9..", ..]}`; `float` ones are the bytes of little-endian `f32`s |
//!
//! ```
//! use protocol::{Format, LocalizeRequest, decode};
//! let request: LocalizeRequest = decode(Format::Json, br#"{
//!     "schema": 2,
//!     "camera": {"width": 640, "height": 480, "focal": [500, 500], "centre": [319.5, 239.5], "distortion": "none"},
//!     "features": {"pixels": [[10, 20]], "descriptors": {"kind": "binary", "width": 2, "hex": ["a0ff"]}}
//! }"#)?;
//! assert_eq!(request.features.len(), 1);
//! # Ok::<(), protocol::CodecError>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod codec;
pub mod error_reply;
pub mod features;
pub mod keys;
pub mod localize;
pub mod map;
pub mod matching;
pub mod robot;
pub mod validate;
mod wire;

pub use codec::{CodecError, Format, Message, decode, encode};
pub use error_reply::{ErrorCode, ErrorReply};
pub use features::{DescriptorFormat, DescriptorKind, Descriptors, FeatureSet, MAX_EXTRACTOR_BYTES};
pub use localize::{LocalizeReply, LocalizeRequest, LocalizedPose};
pub use map::{Extent, KeyframeLandmark, KeyframeReply, MapChange, MapInfo, StatedChange};
pub use matching::{
    CrossCovariance, KeyframePixel, KeyframeRecord, LandmarkMatch, MatchOutcome, MatchReply, MatchRequest,
    MatchStatus, MatchedKeyframe, PosePrior,
};
pub use robot::{RobotOdometry, RobotPose, RobotState, RobotStatus};
pub use validate::{InvalidField, Validate};

/// Version of everything in this crate that is seen from outside. Grows with every incompatible change.
///
/// 2: features and maps say their extractor, `MatchOutcome::Ambiguous`, signed-byte descriptors, changes say from which
/// version, the names of held keyframes as a sorted list of gaps.
pub const SCHEMA_VERSION: u16 = 2;

/// Longest payload that is encoded or decoded, envelope included.
///
/// An image with 2,000 features of 512 bytes is 1 MiB, and a reply holds one keyframe: 16 MiB is far from both and
/// still harmless to hold in memory.
pub const MAX_MESSAGE_BYTES: usize = 16 << 20;

/// Most features an image may bring. Extractors give 300 to 2,000; matching costs grow with the square.
pub const MAX_FEATURES: usize = 20_000;

/// Longest text for people in a message, bytes.
pub const MAX_TEXT_BYTES: usize = 4096;

/// Number of a keyframe, unique in its map and never used again.
pub type KeyframeId = u64;

/// Number of a landmark, unique in its map and never used again.
pub type LandmarkId = u64;
