//! The messages of Driftless: types, key expressions and bounded codecs. Data only, no Zenoh session.
//!
//! Every payload that a robot, a map server or another program exchanges over Zenoh is a type of this crate.
//! [`encode`] turns it into bytes; [`decode`] turns bytes back into a message and checks the length, the checksum, the
//! structure and the values.
//!
//! | module | what |
//! |---|---|
//! | [`matching`] | a robot asks which keyframes its image matches, one keyframe per reply |
//! | [`localize`] | an image in, its global pose out, for clients without an estimator |
//! | [`map`] | reading a map remotely, and notices of its changes |
//! | [`cells`] | what servers of a map's cells answer to each other |
//! | [`robot`], [`published`] | what a robot publishes |
//! | [`presence`] | whether a robot is there |
//! | [`sensors`] | what drivers send to a robot |
//! | [`features`] | pixels and descriptors of one image |
//! | [`error_reply`] | why a query was not answered |
//! | [`identity`] | which map an answer is from |
//! | [`keys`] | key expressions and the names in them |
//! | [`codec`] | bytes: envelope, checksum, limits, schema version |
//! | [`validate`] | the checks on a decoded message |
//! | [`limits`] | schema version, size limits, ids |
//!
//! # Coordinate systems
//! Poses are named by what they map: `global_from_camera` takes a point in the camera frame to the map's frame. A pose's
//! covariance is over `[rotation error, position error]` in the pose's parent frame (radians, metres):
//! `R = Exp(dtheta) R^`, `p = p^ + dp`. Times are nanoseconds. Pixels are distorted, as measured; (0, 0) is the centre of
//! the top-left pixel. Camera frames have x right, y down, z forward.
//!
//! # JSON
//! Every message is one flat object with `"schema"` (required) and `"type"` (optional, checked if present). Optional
//! fields may be omitted, unknown ones are ignored, enumerations are `snake_case` strings. `examples/json` of this crate
//! has one file per message.
//!
//! | what | how |
//! |---|---|
//! | pose | `{"rotation_wxyz": [w, x, y, z], "translation": [x, y, z], "covariance": [6 rows of 6]}` |
//! | camera | `{"width": 752, "height": 480, "focal": [fx, fy], "centre": [cx, cy], "distortion": ..}` |
//! | distortion | `"none"`, `{"radial_tangential": [k1, k2, p1, p2]}`, `{"equidistant": [k1, k2, k3, k4]}`, `{"fov": omega}`, `{"rational": [12 numbers]}`, `{"thin_prism_fisheye": [8 numbers]}`, `{"double_sphere": {"xi": .., "alpha": ..}}`, `{"eucm": {"alpha": .., "beta": ..}}`, `{"omni": {"xi": .., "distortion": [k1, k2, p1, p2]}}` |
//! | descriptors | `{"kind": "binary", "width": 32, "hex": ["76f9e9..", ..]}`; `float` ones are the bytes of little-endian `f32`s |
//! | standard deviation | `sigma_<what>_<unit>` |
//!
//! ```
//! use protocol::{Format, LocalizeRequest, decode};
//! let request: LocalizeRequest = decode(Format::Json, br#"{
//!     "schema": 10,
//!     "camera": {"width": 640, "height": 480, "focal": [500, 500], "centre": [319.5, 239.5], "distortion": "none"},
//!     "features": {"pixels": [[10, 20]], "descriptors": {"kind": "binary", "width": 2, "hex": ["a0ff"]}}
//! }"#)?;
//! assert_eq!(request.features.len(), 1);
//! # Ok::<(), protocol::CodecError>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

/// The examples of the README run as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

pub mod cells;
pub mod codec;
pub mod error_reply;
pub mod features;
pub mod hand_in;
pub mod identity;
pub mod keys;
pub mod limits;
pub mod localize;
pub mod map;
pub mod matching;
mod messages;
pub mod presence;
pub mod published;
pub mod robot;
pub mod sensors;
pub mod validate;
mod wire;

pub use cells::{CellLocalizeReply, CellMatchReply, CellPlace};
pub use codec::{CodecError, Format, Message, decode, encode};
pub use error_reply::{ErrorCode, ErrorReply};
pub use features::{DescriptorFormat, DescriptorKind, Descriptors, FeatureSet};
pub use hand_in::{MAX_SESSION_BYTES, MAX_SESSION_PART_BYTES, SessionPart, SessionPartReply};
pub use identity::MapIdentity;
pub use limits::{
    KeyframeId, LandmarkId, MAX_ANSWER_KEYFRAMES, MAX_CHANGE_M, MAX_CHANGE_RAD, MAX_EXTRACTOR_BYTES,
    MAX_FEATURES, MAX_HELD_KEYFRAMES, MAX_MESSAGE_BYTES, MAX_QUERY_FEATURES, MAX_TEXT_BYTES, OLDEST_SCHEMA,
    SCHEMA_VERSION,
};
pub use localize::{LocalizeReply, LocalizeRequest, LocalizedPose, PossiblePlace};
pub use map::{
    Extent, FeatureKind, KeyframeLandmark, KeyframeMotion, KeyframeReply, MapChangeNotice, MapInfoReply,
    StatedChange,
};
pub use matching::{
    CrossCovarianceBlock, KeyframePixel, KeyframeRecord, LandmarkMatch, MatchOutcome, MatchReply,
    MatchRequest, MatchStatus, MatchedKeyframe, PosePrior,
};
pub use presence::Presence;
pub use published::Published;
pub use robot::{RobotOdometry, RobotPose, RobotState, RobotStatus};
pub use validate::{InvalidField, Validate};
