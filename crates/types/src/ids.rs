//! Numbers of what a map holds.

/// Number of a keyframe, unique in its map and never reused.
pub type KeyframeId = u64;

/// Number of a landmark, unique in its map and never reused.
pub type LandmarkId = u64;
