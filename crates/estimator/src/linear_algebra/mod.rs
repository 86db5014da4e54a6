//! Dense linear algebra of the filter on memory that is kept.

pub mod dense;
pub mod null_space;
