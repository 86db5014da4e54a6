//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod api;
#[path = "common/browser.rs"]
mod browser;
mod changes;
mod common;
mod fleet;
mod image_upload;
#[path = "common/inspection.rs"]
mod inspection;
mod kept;
mod keyframe_images;
mod live;
mod page;
#[cfg(target_os = "linux")]
mod slow_readers;
