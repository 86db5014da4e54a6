//! Dense linear algebra of the filter, on memory that is reused.

pub mod dense;
pub mod dependence;
mod error;
pub mod null_space;

pub use error::NotPositiveDefinite;
