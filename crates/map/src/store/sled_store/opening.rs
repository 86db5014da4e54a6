//! Opening the database of a map, which one process can do at a time.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::store::error::StoreError;

/// The database's page cache. A map is read once into memory, so a large cache would hold everything twice.
const CACHE_BYTES: u64 = 128 * 1024 * 1024;

/// How long opening waits for the lock of a database. One that was closed a moment ago, even by this process, is
/// locked until sled's background threads have let go of it.
const UNLOCK_TIME: Duration = Duration::from_millis(500);
/// How long to wait before the lock is tried again.
const UNLOCK_POLL: Duration = Duration::from_millis(10);

/// Opens a database, or creates an empty one.
pub(super) fn open_database(path: &Path) -> Result<sled::Db, StoreError> {
    let config = sled::Config::new()
        .path(path)
        .cache_capacity(CACHE_BYTES)
        // Every commit is flushed before it is acknowledged, so no timer is needed.
        .flush_every_ms(None);
    let is_locked =
        |error: &sled::Error| matches!(error, sled::Error::Io(error) if error.to_string().contains("lock"));
    let started = Instant::now();
    loop {
        match config.open() {
            Err(source) if is_locked(&source) && started.elapsed() < UNLOCK_TIME => {
                std::thread::sleep(UNLOCK_POLL);
            }
            Err(source) if is_locked(&source) => return Err(StoreError::InUse { path: path.to_owned() }),
            Err(source) => {
                return Err(StoreError::Database { path: path.to_owned(), source: source.into() });
            }
            Ok(database) => return Ok(database),
        }
    }
}
