//! Files that other people made, and folders that this program makes for a while.
//!
//! | module | what |
//! |---|---|
//! | `regular` | [`open`], [`read`], [`read_to_string`]: regular files only, up to a limit |
//! | `temporary` | [`TemporaryFolder`]: removed when it is dropped, and if the program is killed, by the next one |
//! | `whole` | [`write_whole`], [`create_whole_folder`]: there as a whole, or not at all; [`write_new`]: nothing is replaced |
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod regular;
mod temporary;
mod whole;

pub use regular::{MAX_TEXT_BYTES, open, read, read_to_string};
pub use temporary::TemporaryFolder;
pub use whole::{create_whole_folder, write_new, write_new_secret, write_whole, write_whole_secret};
