//! How good an estimate is: how far it is from the truth, and whether it knows.
//!
//! | module | question |
//! |---|---|
//! | [`association`] | which poses belong together |
//! | [`alignment`] | how one trajectory is laid over another |
//! | [`absolute`] | how far poses are from the truth (ATE) |
//! | [`relative`] | how far motions are from the truth (RPE) |
//! | [`consistency`] | whether the error is what the covariance says (NEES) |
//! | [`run`] | all of it for the three poses of a run |
//! | [`ensemble`] | whether many runs together are consistent |
//!
//! ATE and RPE agree with the tool `evo` to 1e-6 on the same files.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod absolute;
pub mod alignment;
pub mod association;
pub mod consistency;
pub mod ensemble;
pub mod relative;
pub mod run;
mod statistics;
pub mod trajectory;

#[cfg(test)]
mod tests;

pub use absolute::{PoseErrors, absolute_errors};
pub use alignment::{Alignment, AlignmentError, align};
pub use association::{Pair, associate};
pub use consistency::{Nees, NeesSum, nees, nees_bounds};
pub use ensemble::{EnsembleNees, NeesSeries, TimePoint, Verdict};
pub use relative::{Delta, relative_errors};
pub use run::{
    ErrorSample, RunErrors, RunScore, Score, ScoreError, ScoreOptions, run_errors, run_errors_in, score_rows,
    score_run,
};
pub use statistics::Statistics;
