//! Maps in folders: writing, replacing and reading them.
//!
//! ```text
//! manifest.json         which version is the map, and the SHA-256 of its segments; written last
//! version-7.segments    the segments of version 7; never changed
//! lock                  held by the program that writes
//! ```
//! A new version is written beside the present one and becomes the map by renaming the manifest over the old one; then the old
//! version is removed. A folder without a manifest is unfinished: nobody reads it, and the next map that is written to it replaces
//! it. Reading writes nothing.
//!
//! | module | what |
//! |---|---|
//! | `error` | [`StoreError`] |
//! | `folder` | what a folder holds |
//! | `reading` | [`load_map`], [`open_map`]: verified once, before anything of it is used |
//! | `stored_images` | [`StoredImages`], read one at a time |
//! | `stored_landmarks` | [`StoredLandmarks`], read one at a time |
//! | `stored_map` | [`StoredMap`], [`SavedMap`] |
//! | `target` | [`MapTarget`], [`save_map`]: what is replaced is what was there at the begin |
//! | `version_file` | the segments of one version, open for reading |
//! | `writing` | the next version |

mod error;
mod folder;
mod reading;
mod stored_images;
mod stored_landmarks;
mod stored_map;
mod target;
mod version_file;
mod writing;

pub use crate::file::{EXTENDED_STORE_SCHEMA, STORE_SCHEMA};
pub use error::{Damage, StoreError, WriteProblem};
pub use folder::{ensure_free, is_map};
pub use reading::{load_map, open_map};
pub use stored_images::StoredImages;
pub use stored_landmarks::StoredLandmarks;
pub use stored_map::{SavedMap, StoredMap};
pub use target::{MapTarget, save_map};
