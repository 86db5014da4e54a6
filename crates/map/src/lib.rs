//! Keyframe maps: their elements, their invariants, and how they are stored.
//!
//! A map holds camera poses with covariances and cross-covariances, and landmarks that are anchored in them. Programs
//! build it with the crate `mapping`, store it with [`store::save_map`], read it with [`store::load_map`], and search it with
//! the crate `recognition`; `map_io` writes and reads it in the files of other programs.
//!
//! | module | what |
//! |---|---|
//! | [`model`] | keyframes, landmarks, observations, cross-covariances, common errors, existence |
//! | `added` | further kinds of features, images of keyframes |
//! | [`contents`] | a whole map in memory and its invariants |
//! | [`file`](mod@file) | the bytes of a map: records, segments, manifest |
//! | [`store`] | maps in folders: written, replaced and read |
//! | [`edit`] | taking keyframes and landmarks out |
//! | [`difference`] | what changed between two versions |
//! | [`sessions`] | the ledger: which recordings a map was made of |
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod added;
pub mod contents;
pub mod difference;
pub mod edit;
pub mod file;
pub mod model;
pub mod sessions;
pub mod store;

pub use added::{AddedFeatures, FeatureKind, KeptImage};
pub use contents::{ContentsError, MapContents};
pub use file::record::RecordError;
pub use model::{
    Alias, CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark, LandmarkExistence,
    MapMetadata, Observation,
};
pub use store::{EXTENDED_STORE_SCHEMA, STORE_SCHEMA, SavedMap, StoreError, StoredMap};
