//! Pixels as integers.

use crate::error::ChunkError;

/// Largest pixel of either sign: a camera has at most 65,536 columns.
pub(super) const MOST_PIXEL: f64 = 1e6;

/// A pixel in steps that another one and a difference give.
pub(super) fn stepped(value: i64, step: i64, steps: f64) -> Result<i64, ChunkError> {
    let next = value.checked_add(step).ok_or(ChunkError::Range("a pixel"))?;
    if next.unsigned_abs() as f64 > MOST_PIXEL * steps { Err(ChunkError::Range("a pixel")) } else { Ok(next) }
}
