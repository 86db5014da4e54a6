//! Maps in databases: reading and writing them, and the [`MapStore`] trait of the database under them.
//!
//! | module | what |
//! |---|---|
//! | `error` | [`StoreError`] |
//! | `database` | [`load_map`], [`open_map`], [`save_map`]: the only place that names an implementation |
//! | `folder` | the folder of a map: versions, checksums, verified copies; independent of the database |
//! | `guarded` | calls that may panic |
//! | `map_store` | the trait [`MapStore`] |
//! | `record` | the bytes of a record: versions, checksums, layout; independent of the database |
//! | `sled_store` | the trait on the embedded database sled |
//! | `stored_map` | [`StoredMap`], [`SavedMap`] |
//! | `target` | [`MapTarget`]: what is replaced is what was there at the begin |
//! | `stored_landmarks` | [`StoredLandmarks`], read one at a time |

mod database;
mod error;
mod folder;
mod guarded;
mod map_store;
pub mod record;
mod sled_store;
mod stored_landmarks;
mod stored_map;
mod target;

pub use database::{ensure_free, is_map, load_map, open_map, save_map};
pub use error::{Damage, DatabaseError, StoreError, WriteProblem};
pub use map_store::{MapStore, OpenDatabase};
pub use record::RecordError;
pub use stored_landmarks::StoredLandmarks;
pub use stored_map::{SavedMap, StoredMap};
pub use target::MapTarget;

/// Layout of a map on disk. Maps with another number are refused.
pub const STORE_SCHEMA: u16 = 7;
