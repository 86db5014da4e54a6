//! The error of every factorization in this crate.

/// A covariance or information matrix without a Cholesky factor: the filter has diverged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the covariance is no longer positive definite; the filter has diverged and must be started again")]
pub struct NotPositiveDefinite;
