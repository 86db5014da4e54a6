//! Rows of a recording in order of time.

use super::{Frame, GnssReading, ImuSample, ReferencePose, SequenceError, TruthRow, WheelReading};
use std::sync::Arc;

/// Rows of a recording in order of time, read one after the other. They end with the first error.
pub type Rows<'a, T> = Box<dyn Iterator<Item = Result<T, SequenceError>> + 'a>;

/// The elements of a list in memory, one after the other.
pub(crate) fn rows_of<T: Clone + 'static>(all: &Arc<[T]>) -> Rows<'static, T> {
    let all = Arc::clone(all);
    Box::new((0..all.len()).map(move |at| Ok(all[at].clone())))
}

/// Something that was measured at one instant.
pub(crate) trait Stamped {
    /// The instant, nanoseconds.
    fn stamp_ns(&self) -> i64;
}

macro_rules! stamped {
    ($($row:ty),*) => {$(
        impl Stamped for $row {
            fn stamp_ns(&self) -> i64 {
                self.stamp_ns
            }
        }
    )*};
}

stamped!(GnssReading, ImuSample, WheelReading, Frame, TruthRow, ReferencePose);
