//! Schema version, size limits, and the numbers that name keyframes and landmarks.

/// Version of everything in this crate that is seen from outside. Grows with every incompatible change.
///
/// * 2: features and maps name their extractor, `MatchOutcome::Ambiguous`, descriptors of signed bytes, changes name the
///   version that they start from, held keyframes as a sorted list of gaps.
/// * 3: standard deviations are named `sigma_<what>_<unit>`: `sigma_map_px` in the status of a match (was
///   `map_pixel_sigma`) and in the info of a map (was `pixel_sigma`), `sigma_theta_rad` and `sigma_p_m` in the stated
///   change of a map (were `sigma_theta` and `sigma_p`). In JSON, `"type"` is `map_info_reply` (was `map_info`) and
///   `map_change_notice` (was `map_change`). The bincode payloads are those of schema 2. Covariances are checked with a
///   tolerance of 1e-6 (was 1e-5).
/// * 4: answers, the info of a map, its changes and the poses of robots name the identity of the map; coordinates of positions
///   are at most 1e7 m.
/// * 5: keyframes of an answer have a `common_error`, and where the request names the version of the map in
///   `map_version_held`, correlations among the held keyframes are not sent again.
/// * 6: the status of a match has `log_odds` and `log_prior_odds`, the reply to a localization query has `places`.
/// * 7: the state of a robot that only starts is `starting` (was `lost`).
/// * 8: cameras have the distortions `rational`, `thin_prism_fisheye`, `double_sphere`, `eucm` and `omni`.
/// * 9: the notice of a change has `keyframe_motions`.
/// * 10: the info of a map has `feature_kinds`; a robot that shuts down in order states `off`.
///
/// Messages of the schema before, from [`OLDEST_SCHEMA`] on, and of the one after are read as well: what a new schema adds is
/// appended to the end of a message, and zero there means that it is not stated.
pub const SCHEMA_VERSION: u16 = 10;

/// The first schema that is read by the programs of the next one; those before were never released.
pub const OLDEST_SCHEMA: u16 = 8;

/// Longest payload that is encoded or decoded, envelope included.
///
/// An image with 2,000 features of 512 bytes is 1 MiB, and a reply holds one keyframe: 16 MiB leaves a factor of ten and
/// is harmless to hold in memory.
pub const MAX_MESSAGE_BYTES: usize = 16 << 20;

pub use types::features::MAX_FEATURES;

/// Most features in one query: matching one costs milliseconds a thousand, and no extractor gives more of a camera's image.
pub const MAX_QUERY_FEATURES: usize = 5_000;

/// Most keyframes that a query may say are held: four times what an estimator holds by default (5,000).
///
/// Each costs the server a look-up (0.1 µs); a list that is only limited by its bytes has 16 million.
pub const MAX_HELD_KEYFRAMES: usize = 20_000;

/// Most keyframes that may be asked for in one answer.
pub const MAX_ANSWER_KEYFRAMES: u16 = 64;

/// Most numbers that the errors of all keyframes of a map may have in common.
pub const MAX_COMMON_ERRORS: usize = 4096;

/// Largest stated change of a map: rotation about each axis, rad. A map that turned by more is another map.
pub const MAX_CHANGE_RAD: f64 = std::f64::consts::PI;

/// The same for the translation, metres: the extent of a city.
pub const MAX_CHANGE_M: f64 = 1e4;

/// Longest name of an extractor, bytes.
pub const MAX_EXTRACTOR_BYTES: usize = 64;

/// Longest human-readable text in a message, bytes.
pub const MAX_TEXT_BYTES: usize = 4096;

pub use types::{KeyframeId, LandmarkId};
