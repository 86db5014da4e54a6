//! A recording is located in the part of a large map that it shows: what that costs depends on the part.
//!
//! | module | what |
//! |---|---|
//! | `selection` | the keyframes about the places that a recording shows |
//! | `located` | how the errors of new keyframes depend on those of all keyframes of the map |
//! | `put_back` | the part, with the recording, put back into the map |
//! | `former` | the map as it was before that, where it gives no valid map |

mod former;
mod located;
mod put_back;
mod selection;
#[cfg(test)]
mod tests;

pub use former::Former;
pub use located::{LocatedErrors, located_errors};
pub use put_back::put_back;
pub use selection::{PartShown, part_shown};
