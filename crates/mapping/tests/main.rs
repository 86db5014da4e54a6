//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, clippy::missing_panics_doc, missing_docs, dead_code)]

mod common;
mod map_merging;
mod map_pose_priors;
mod map_reference_poses;
mod map_without_poses;
mod maps;
