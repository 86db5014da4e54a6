//! The initial state of a filter, from ground truth, at rest (static) or in motion (dynamic).

pub mod continuation;
pub mod dynamic;
mod image_motion;
pub mod initializer;
pub mod static_init;
