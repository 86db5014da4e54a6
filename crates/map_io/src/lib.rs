//! Keyframe maps in files that other programs read and write.
//!
//! | module | what |
//! |---|---|
//! | [`text`] | a map as tables of plain text: import and export |
//! | [`colmap`] | COLMAP models, written and read |
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod colmap;
pub mod text;
