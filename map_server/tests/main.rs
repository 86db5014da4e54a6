//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../../crates/viewer/tests/common/browser.rs"]
mod browser;
#[cfg(unix)]
mod candidates;
mod cells;
#[cfg(target_os = "linux")]
mod load;
mod page_image;
#[cfg(unix)]
mod program;
#[cfg(unix)]
mod program_releases;
#[cfg(unix)]
mod release_layers;
mod serve;
mod state;
