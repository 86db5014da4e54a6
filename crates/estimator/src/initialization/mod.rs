//! Where a filter starts: at rest, or in motion.

pub mod dynamic;
pub mod initializer;
pub mod static_initialization;
