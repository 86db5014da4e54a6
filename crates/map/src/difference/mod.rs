//! Differences between two versions of a map: the one algorithm that servers, releases and reviews use.
//!
//! A robot's state is correlated with the old errors of the keyframes that it holds, not with the new ones: it has to know which
//! keyframes moved, and how far the map as a whole did ([`VersionChange`]). The size of the motion is the root mean square over
//! the keyframes that both versions have, per axis, of the rotation from the old to the new pose and of the change of position. A
//! rigid motion of the whole map is thus measured at the keyframes, where robots are, and not at the origin of its frame.
//!
//! A person wants to know how many keyframes and landmarks are new, gone or moved, by how much, and where ([`MapDifference`]).
//!
//! | module | what |
//! |---|---|
//! | `compared` | [`Compared`]: what is compared of one version |
//! | `criteria` | when an element counts as changed |
//! | `keyframes` | [`KeyframeDifference`]: which keyframes, and where they are and were |
//! | `motion` | how far a map moved as a whole |
//! | `version_change` | [`VersionChange`]: what robots are told |
//! | `summary` | [`MapDifference`]: numbers and places |

mod compared;
mod criteria;
mod keyframes;
mod motion;
mod summary;
mod version_change;

pub use compared::Compared;
pub use keyframes::{KeyframeDifference, MovedKeyframe, PlacedKeyframe};
pub use summary::{ChangedPlace, ElementCounts, MapDifference, MotionSize, PLACE_SIZE_M};
pub use version_change::VersionChange;
