//! Measurements that arrive now: late, in bursts, out of order, twice, or not at all.
//!
//! [`LiveSource::new`] gives the inputs, which drivers call from any thread, and the source, which a robot plays.
//!
//! | module | what |
//! |---|---|
//! | `source` | [`LiveInputs`], [`LiveSource`] and [`LiveReport`]: threads and waiting |
//! | `buffer` | all the rest put together, without a clock of its own |
//! | `lane` | what every stream goes through: `clock` (jumps), duplicates, `watch` (silence, rate) |
//! | `reorder`, `assembly` | order of time; stereo pairs |
//! | `image`, `repetition` | [`LiveImage`]: conversion to grey; frozen cameras |
//! | `fault` | [`LiveFault`], what is wrong |
//! | `settings`, `stream` | [`LiveSettings`]; [`Stream`] |

mod assembly;
mod buffer;
mod clock;
mod fault;
mod image;
mod lane;
mod reorder;
mod repetition;
mod settings;
mod side_stream;
mod source;
mod stream;
mod watch;

#[cfg(test)]
mod tests;

pub use crate::original::RawPixels;
pub use fault::{FaultKind, LiveFault};
pub use image::{LiveImage, LiveImageError};
pub use settings::{LiveFrames, LiveSettings};
pub use source::{LiveInputs, LiveReport, LiveSource};
pub use stream::Stream;
