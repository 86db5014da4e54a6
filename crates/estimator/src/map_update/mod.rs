//! Map updates: answers of the map, their verification, linearization and versions.

pub mod fixed_pose;
pub mod map_answer;
pub mod map_fix;
pub mod map_gravity;
pub mod map_initializer;
pub mod map_measurement;
pub mod map_report;
pub mod map_revision;
pub mod map_watch;
pub mod place_evidence;
pub(crate) mod repeated_views;
pub mod solved_pose;
pub mod verification;
