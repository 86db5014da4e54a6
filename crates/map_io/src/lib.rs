//! Keyframe maps in files that other programs read and write.
//!
//! | module | what |
//! |---|---|
//! | [`text`] | a map as tables of plain text: import and export |
//! | [`colmap`] | COLMAP models, written and read |
//! | [`occupancy`] | occupancy grids in the plane, for Nav2 |
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod colmap;
pub mod occupancy;
pub mod text;
