//! State in a [sled](https://docs.rs/sled/0.34) database.

use std::path::{Path, PathBuf};

use super::{StateError, StateStore};

/// Layout of the database and of its values.
const SCHEMA: u16 = 1;
const SCHEMA_KEY: &str = "schema";
/// Of the database's pages; what is kept is small.
const CACHE_BYTES: u64 = 1 << 20;

/// The state of a server in a folder, of which it is the only user.
pub struct SledStore {
    folder: PathBuf,
    database: sled::Db,
}

impl SledStore {
    /// Opens the database in a folder, or makes an empty one. sled may panic where its files are damaged.
    ///
    /// # Errors
    /// [`StateError::Failed`], for example where another server uses it; [`StateError::Schema`].
    pub fn open(folder: &Path) -> Result<SledStore, StateError> {
        // Each value is on the disk when it was set, so no timer is needed.
        let config = sled::Config::new().path(folder).cache_capacity(CACHE_BYTES).flush_every_ms(None);
        let database = config.open().map_err(|source| failed(folder, source))?;
        let store = SledStore { folder: folder.to_owned(), database };
        match store.get(SCHEMA_KEY)? {
            Some(schema) if schema == SCHEMA.to_le_bytes() => {}
            None if store.database.is_empty() => store.set(SCHEMA_KEY, &SCHEMA.to_le_bytes())?,
            _ => return Err(StateError::Schema { folder: folder.to_owned(), expected: SCHEMA }),
        }
        Ok(store)
    }
}

impl StateStore for SledStore {
    fn get(&self, key: &str) -> Result<Option<Vec<u8>>, StateError> {
        let value = self.database.get(key).map_err(|source| failed(&self.folder, source))?;
        Ok(value.map(|value| value.to_vec()))
    }

    fn set(&self, key: &str, value: &[u8]) -> Result<(), StateError> {
        let set = self.database.insert(key, value).and_then(|_| self.database.flush());
        set.map(drop).map_err(|source| failed(&self.folder, source))
    }
}

fn failed(folder: &Path, source: sled::Error) -> StateError {
    StateError::Failed { folder: folder.to_owned(), source: source.into() }
}
