//! Visual place recognition: from the features of an image to the keyframes of a map that it shows, and to its pose.
//!
//! | module | step | result |
//! |---|---|---|
//! | `index` | votes of all descriptors | some ten candidates |
//! | `comparisons` | which candidates are compared, and with how many of other places | |
//! | `verification` | descriptor matching and PnP with each candidate | verified keyframes |
//! | `consensus` | do their poses agree? | one place, or none |
//! | `answer` | rules of an answer | replies to a match query |
//! | `fusion` | the pose from all verified keyframes | reply to a localization query |
//! | `place` | | a recognized place in short |
//! | `places` | keyframes that show an image's place, each for itself | for map building |
//! | `report` | candidates and why they were refused | for each query, kept by a server |
//! | `coarse` | votes for the parts of a large map | which of them are searched |
//! | `parts` | do parts that were searched by themselves agree? | one of them, or none |
//! | `inspection` | all intermediate results | for diagnosis |
//! | `kinds` | the kind of features that an image has | which of a map's kinds is searched |
//!
//! [`LoadedMap`] holds a map in memory (`loaded_map`, `loading`, `poses`, `elements`) and answers the queries (`query`, `search`).
//!
//! A prior pose restricts the candidates to keyframes near it that do not look the other way, and ends their comparison
//! once enough of them agree with it. A wrong prior costs time, never the answer: where no keyframe near it is verified,
//! all are searched.
//!
//! The example `recognize` builds a small map and localizes an image in it:
//! `cargo run -p driftless-recognition --example recognize`.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod answer;
mod coarse;
mod comparisons;
mod consensus;
mod cross_covariances;
mod elements;
mod evidence;
mod extractor_statistics;
mod frozen;
mod fusion;
mod index;
mod inspection;
mod kinds;
mod loaded_map;
mod loading;
mod options;
mod parts;
mod place;
mod places;
mod poses;
mod query;
mod relative_pose;
mod report;
mod search;
mod verification;

pub use coarse::{CoarseIndex, CoarseIndexBuilder, RankedPart};
pub use evidence::{AliasingRate, Coverage, PartCounts, likely_alias};
pub use frozen::FrozenError;
pub use inspection::{InspectedKeyframe, InspectedMatch, Inspection, KeyframeVerdict};
pub use loaded_map::{LoadError, LoadedMap};
pub use options::RecognitionOptions;
pub use parts::{PartResult, choose_part};
pub use place::RecognizedPlace;
pub use places::VerifiedPlace;
pub use query::QueryError;
pub use report::{Candidate, Hypothesis, MAX_HYPOTHESES, SearchReport};
pub use search::{is_supported, prior_radius};
