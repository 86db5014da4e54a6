//! What a claimed pose explains, and what it should explain and does not.
//!
//! A picture that repeats is matched at the wrong place as well as at the right one, and all its matches agree on one pose. But
//! at the wrong place only the picture is: whatever else the map saw there is missing in the image. The module compares the
//! parts of an image in which the map expects landmarks with those in which matches confirm them.

pub(crate) mod aliasing;
mod coverage;
mod expected;
mod grid;
mod likelihood;
mod picture;

pub(crate) use aliasing::OTHER_PLACE;
pub use aliasing::{AliasingRate, likely_alias};
pub(crate) use coverage::coverage;
pub use coverage::{Coverage, PartCounts};
