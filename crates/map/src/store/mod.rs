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
pub use map_store::{MapStore, OpenDatabase, ReadMap};
pub use record::RecordError;
pub use stored_landmarks::StoredLandmarks;
pub use stored_map::{SavedMap, StoredMap};
pub use target::MapTarget;

/// Layout of a map on disk. A map with a larger number is refused.
///
/// 1: as in the first release. 2: the info of the map names the extractor. 3: a folder with a manifest and checksums around
/// the database; the info has the identity. 4: a table of common errors. 5: a table of aliases. Every change
/// writes the newest.
pub const STORE_SCHEMA: u16 = 5;

/// The oldest layout that is read.
pub const OLDEST_STORE_SCHEMA: u16 = 1;
