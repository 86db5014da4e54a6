//! From the features of an image to the keyframes that it shows.
//!
//! ```text
//! votes of all descriptors   ->  some ten candidates          index
//! descriptor matching        ->  matches with each            verify
//! PnP in the keyframe        ->  verified keyframes           verify
//! do their poses agree?      ->  one place, or none           consensus
//! rules of an answer         ->  replies                      answer
//! or the pose from all       ->  a precise pose               fuse
//! ```
//! `inspect` takes an answer apart for a person who asks why.
//!
//! A prior pose narrows the candidates to keyframes near it. A wrong prior costs time, never the answer: where no
//! keyframe near it is verified, all are searched.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod answer;
mod consensus;
mod fuse;
mod index;
mod inspect;
mod loaded_map;
mod options;
mod query;
mod verify;

pub use inspect::{InspectedKeyframe, InspectedMatch, Inspection, Verdict};
pub use loaded_map::{LoadError, LoadedMap};
pub use options::RecognitionOptions;
pub use query::QueryError;
