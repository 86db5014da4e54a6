//! What a server keeps from one run to the next: small values that change, in an embedded database.
//!
//! Maps are not in it: they are files that never change ([`map::store`]), and the database says which of them is served.
//!
//! | key | value |
//! |---|---|
//! | `served/{map}` | [`ServedVersion`] as JSON |
//!
//! | module | what |
//! |---|---|
//! | `map_version` | [`MapVersion`]: what tells versions of a map from each other |
//! | `sled_store` | [`SledStore`]: the trait on sled |

mod map_version;
mod sled_store;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use protocol::MapIdentity;
use serde::{Deserialize, Serialize};

pub use map_version::MapVersion;
pub use sled_store::SledStore;

/// A database of small values by their names. What was set before the program was killed is there again.
pub trait StateStore: Send + Sync {
    /// A value; `None` where none was set.
    ///
    /// # Errors
    /// [`StateError::Failed`].
    fn get(&self, key: &str) -> Result<Option<Vec<u8>>, StateError>;

    /// Sets a value. When this returns, it is on the disk.
    ///
    /// # Errors
    /// [`StateError::Failed`], for example of a full disk.
    fn set(&self, key: &str, value: &[u8]) -> Result<(), StateError>;
}

/// Why the state of a server cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StateError {
    /// The database failed.
    #[error(
        "the state of the server in {folder} cannot be used: {source}; each server needs a folder of its own (--state), and a damaged \
         one can be removed: what was served last is then not known"
    )]
    Failed {
        /// Folder of the database.
        folder: PathBuf,
        /// The error of the database.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The folder holds something else, or was written by another version of this program.
    #[error(
        "{folder} holds no state of a server that this program reads (schema {expected}): choose another folder (--state)"
    )]
    Schema {
        /// Folder of the database.
        folder: PathBuf,
        /// What is read.
        expected: u16,
    },
    /// A value has another form.
    #[error("the state of the server has an unreadable value of {key}: {source}")]
    Value {
        /// Its name.
        key: String,
        /// What is wrong with it.
        source: serde_json::Error,
    },
}

/// Which version of a map a server has served.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServedVersion {
    /// Of the map.
    pub identity: MapIdentity,
    /// The number under which it was served.
    pub version: u64,
    /// Digest of what was in it, where that was known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub digest: Option<MapIdentity>,
    /// Since when, seconds since 1970.
    pub since_unix_s: u64,
}

impl ServedVersion {
    /// Without the time.
    pub fn map_version(&self) -> MapVersion {
        MapVersion { identity: self.identity, version: self.version, digest: self.digest }
    }
}

/// The state of a server.
///
/// # Example
/// ```
/// use map_server::state::{MapVersion, ServerState, SledStore};
/// use protocol::MapIdentity;
///
/// let folder = tempfile::tempdir()?;
/// let state = ServerState::new(SledStore::open(folder.path())?);
/// let third = MapVersion { identity: MapIdentity::from_bytes([7; 16]), version: 3, digest: None };
/// assert_eq!(state.note_served("hall", &third)?, None);
/// let before = state.note_served("hall", &MapVersion { version: 4, ..third })?.ok_or("served before")?;
/// assert_eq!(before.version, 3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct ServerState {
    store: Box<dyn StateStore>,
}

impl ServerState {
    /// The state in a database.
    pub fn new(store: impl StateStore + 'static) -> ServerState {
        ServerState { store: Box::new(store) }
    }

    /// The version of a map that was served last; `None` where none is known.
    ///
    /// # Errors
    /// [`StateError::Failed`], [`StateError::Value`].
    pub fn last_served(&self, map: &str) -> Result<Option<ServedVersion>, StateError> {
        let key = key_of(map);
        let Some(value) = self.store.get(&key)? else { return Ok(None) };
        serde_json::from_slice(&value).map(Some).map_err(|source| StateError::Value { key, source })
    }

    /// Notes which version of a map is served from now on.
    ///
    /// # Returns
    /// The one that was served before. One that cannot be read is replaced.
    ///
    /// # Errors
    /// [`StateError::Failed`].
    pub fn note_served(&self, map: &str, served: &MapVersion) -> Result<Option<ServedVersion>, StateError> {
        let before = match self.last_served(map) {
            Err(error @ StateError::Value { .. }) => {
                tracing::warn!("{error}");
                None
            }
            before => before?,
        };
        if before.as_ref().is_some_and(|before| before.map_version() == *served) {
            return Ok(before);
        }
        let MapVersion { identity, version, digest } = *served;
        let since_unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        let key = key_of(map);
        let value = serde_json::to_vec(&ServedVersion { identity, version, digest, since_unix_s })
            .map_err(|source| StateError::Value { key: key.clone(), source })?;
        self.store.set(&key, &value)?;
        Ok(before)
    }
}

fn key_of(map: &str) -> String {
    format!("served/{map}")
}

/// Notes which version of a map is served from now on, and says where it is not a later one of the same map. A state that fails is
/// logged: the map is served all the same.
pub(crate) async fn note_served(state: Option<&Arc<ServerState>>, map: &str, served: MapVersion) {
    let Some(state) = state.cloned() else { return };
    let name = map.to_owned();
    let noting = tokio::task::spawn_blocking(move || state.note_served(&name, &served));
    let before = match noting.await.map_err(anyhow::Error::from).and_then(|noted| Ok(noted?)) {
        Ok(Some(before)) => before,
        Ok(None) => return,
        Err(error) => return tracing::warn!(name = map, "what is served is not kept: {error}"),
    };
    let MapVersion { identity, version, .. } = served;
    if before.identity != identity {
        tracing::warn!(
            name = map,
            %identity,
            served_before = %before.identity,
            "the map is not the one that this server served under the name before: robots that hold parts of that one refuse its answers"
        );
    } else if before.version > version {
        tracing::warn!(
            name = map,
            version,
            served_before = before.version,
            since_unix_s = before.since_unix_s,
            "the map is older than the version that this server served before: was a backup restored, or a release taken away?"
        );
    } else if served.number_after(&before.map_version()) > version {
        tracing::warn!(
            name = map,
            version,
            "the map has the version that this server served before and other contents: robots that hold parts of that one take them for \
             parts of this one; make it the next version"
        );
    }
}
