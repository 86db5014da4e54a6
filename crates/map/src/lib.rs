//! Keyframe maps: what they are made of, the laws that they keep, and how they are stored.
//!
//! | module | what |
//! |---|---|
//! | [`model`] | keyframes, landmarks, observations, cross-covariances |
//! | [`contents`] | a whole map in memory and its invariants |
//! | [`store`] | maps at rest: the [`MapStore`] trait, and its implementation on sled |
//! | [`text`] | import from and export to plain text |
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod contents;
pub mod model;
pub mod store;
pub mod text;

pub use contents::{ContentsError, MapContents};
pub use model::{CrossCovariance, Keyframe, Landmark, MapInfo, Observation};
pub use store::{Batch, Change, MapStore, STORE_SCHEMA, SledStore, StoreCounts, StoreError};
