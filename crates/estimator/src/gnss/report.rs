//! What GNSS did.

use serde::Serialize;

/// Counts of readings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct GnssCounts {
    /// Readings that corrected the state.
    pub used: usize,
    /// Readings that the gate rejected: reflections, jumps.
    pub gated: usize,
    /// Readings while GNSS was left out.
    pub left_out: usize,
    /// Readings before `global_from_local` was known.
    pub before_initialization: usize,
    /// Readings that came too late, or where there are no images.
    pub late: usize,
    /// Readings that were refused.
    pub refused: usize,
    /// How often GNSS initialized `global_from_local`.
    pub initializations: usize,
}
