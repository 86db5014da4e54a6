//! Maps in databases: the [`MapStore`] trait, and the functions that create, open and replace them.
//!
//! | module | what |
//! |---|---|
//! | `error` | [`StoreError`] |
//! | `map_store` | the trait [`MapStore`] |
//! | `record` | the bytes of a record: versions, checksums, layout; independent of the database |
//! | `sled_store` | the trait on the embedded database sled |
//! | `database` | [`create`], [`open`], [`save_map`]: the only place that names an implementation |

mod database;
mod error;
mod map_store;
pub mod record;
mod sled_store;

pub use database::{create, open, save_map};
pub use error::StoreError;
pub use map_store::{MapStore, Records};
pub use record::RecordError;

/// Layout of a map on disk. A database with a larger number is refused on opening.
///
/// 1: as in the first release. 2: the info of the map names the extractor. Every change writes the newest.
pub const STORE_SCHEMA: u16 = 2;

/// The oldest layout that is read.
pub const OLDEST_STORE_SCHEMA: u16 = 1;
