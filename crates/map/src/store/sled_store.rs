//! A map in a [sled](https://docs.rs/sled/0.34) database: one directory a map, laid out as [`super::tables`] says.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use protocol::{KeyframeId, LandmarkId};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sled::transaction::{TransactionError, Transactional};

use super::pending::Pending;
use super::record::{self, InfoRecord};
use super::tables::{CORRELATED, INFO_KEY, OBSERVES, SCHEMA_KEY, SCHEMA_MAGIC, Table, Writes, pair_key};
use super::{Change, MapStore, OLDEST_STORE_SCHEMA, Records, STORE_SCHEMA, StoreError};
use crate::contents::MapContents;
use crate::model::{CrossCovariance, Keyframe, Landmark, MapInfo};

/// The database's page cache. A map is read once into memory, so a large cache would hold everything twice.
const CACHE_BYTES: u64 = 128 * 1024 * 1024;

/// How long opening waits for the lock of a database. One that was closed a moment ago, even by this process, is
/// locked until sled's background threads have let go of it.
const UNLOCK_TIME: Duration = Duration::from_millis(500);
/// How long to wait before the lock is tried again.
const UNLOCK_POLL: Duration = Duration::from_millis(10);

/// A map in a sled database.
pub struct SledStore {
    path: PathBuf,
    database: sled::Db,
    /// In the order of [`Table::ALL`].
    trees: [sled::Tree; 5],
    /// Batches are checked against what is stored, so one is made at a time.
    writer: Mutex<()>,
}

impl SledStore {
    /// Makes a new, empty map.
    ///
    /// # Arguments
    /// * `path`: a directory that does not exist yet, or is empty.
    ///
    /// # Errors
    /// [`StoreError::Exists`], [`StoreError::Invalid`] for impossible `info`, [`StoreError::Database`].
    pub fn create(path: impl AsRef<Path>, info: &MapInfo) -> Result<SledStore, StoreError> {
        let path = path.as_ref();
        let empty = || std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
        if path.exists() && !empty() {
            return Err(StoreError::Exists { path: path.to_owned() });
        }
        crate::contents::check_info(info)?;
        let store = SledStore::with_tables(path, open_database(path)?)?;
        let mut writes = Writes::default();
        store.write_info(&mut writes, info, 0)?;
        store.commit(&writes)?;
        Ok(store)
    }

    /// Opens a map that exists.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::NotAMap`], [`StoreError::Schema`], [`StoreError::InUse`],
    /// [`StoreError::Database`].
    pub fn open(path: impl AsRef<Path>) -> Result<SledStore, StoreError> {
        let path = path.as_ref();
        if !path.exists() {
            return Err(StoreError::Missing { path: path.to_owned() });
        }
        // Opening any other directory would make it a database.
        if !(path.join("conf").is_file() && path.join("db").is_file()) {
            let problem = "it holds no database".to_owned();
            return Err(StoreError::NotAMap { path: path.to_owned(), problem });
        }
        let database = open_database(path)?;
        check_schema(path, &database)?;
        SledStore::with_tables(path, database)
    }

    /// The directory of the map.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes that the map takes on disk.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub fn size_on_disk(&self) -> Result<u64, StoreError> {
        self.database.size_on_disk().map_err(|source| self.failed(source))
    }

    fn with_tables(path: &Path, database: sled::Db) -> Result<SledStore, StoreError> {
        let tree = |table: Table| {
            let failed = |source| StoreError::Database { path: path.to_owned(), source };
            database.open_tree(table.name()).map_err(failed)
        };
        let [info, keyframes, landmarks, cross_covariances, references] = Table::ALL.map(tree);
        let trees = [info?, keyframes?, landmarks?, cross_covariances?, references?];
        Ok(SledStore { path: path.to_owned(), database, trees, writer: Mutex::new(()) })
    }

    /// Ids of the landmarks that a keyframe observes, as far as references tell.
    pub(super) fn observed_landmarks(&self, keyframe: KeyframeId) -> Result<Vec<LandmarkId>, StoreError> {
        self.references(OBSERVES, keyframe)
    }

    /// Ids of the keyframes with which one has a cross-covariance.
    pub(super) fn correlated_keyframes(&self, keyframe: KeyframeId) -> Result<Vec<KeyframeId>, StoreError> {
        self.references(CORRELATED, keyframe)
    }

    /// Whether there is neither a keyframe nor a landmark.
    pub(super) fn holds_nothing(&self) -> bool {
        self.tree(Table::Keyframes).is_empty() && self.tree(Table::Landmarks).is_empty()
    }

    fn references(&self, kind: u8, keyframe: KeyframeId) -> Result<Vec<u64>, StoreError> {
        let mut prefix = vec![kind];
        prefix.extend(keyframe.to_be_bytes());
        let mut ids = Vec::new();
        for key in self.tree(Table::References).scan_prefix(&prefix).keys() {
            let key = key.map_err(|source| self.failed(source))?;
            let id = key.strip_prefix(prefix.as_slice()).and_then(|id| id.try_into().ok());
            ids.push(id.map(u64::from_be_bytes).ok_or_else(|| {
                self.corrupt(format!("a reference of keyframe {keyframe}"), "its key is malformed".to_owned())
            })?);
        }
        Ok(ids)
    }

    fn tree(&self, table: Table) -> &sled::Tree {
        &self.trees[table as usize]
    }

    fn get(&self, table: Table, key: &[u8]) -> Result<Option<sled::IVec>, StoreError> {
        self.tree(table).get(key).map_err(|source| self.failed(source))
    }

    pub(super) fn seal<T: Serialize>(
        &self,
        table: Table,
        key: &[u8],
        record: &T,
    ) -> Result<Vec<u8>, StoreError> {
        record::seal(table.name(), key, record).map_err(|problem| self.corrupt(table.describe(key), problem))
    }

    pub(super) fn unseal<T: DeserializeOwned>(
        &self,
        table: Table,
        key: &[u8],
        bytes: &[u8],
    ) -> Result<T, StoreError> {
        record::unseal(table.name(), key, bytes).map_err(|problem| self.corrupt(table.describe(key), problem))
    }

    /// All records of a tree, each decoded by itself.
    fn records<T: 'static>(
        &self,
        table: Table,
        decode: impl Fn(&SledStore, &[u8], &[u8]) -> Result<T, StoreError> + 'static,
    ) -> Records<'_, T> {
        Box::new(self.tree(table).iter().map(move |entry| {
            let (key, value) = entry.map_err(|source| self.failed(source))?;
            decode(self, &key, &value)
        }))
    }

    fn locked(&self) -> MutexGuard<'_, ()> {
        // The lock guards no data, so a writer that panicked left nothing half done.
        self.writer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes the writes in one transaction over all trees and waits until they are on the disk.
    fn commit(&self, writes: &Writes) -> Result<(), StoreError> {
        let committed = self.trees[..].transaction(|trees| {
            for (tree, batch) in trees.iter().zip(&writes.batches) {
                tree.apply_batch(batch)?;
            }
            Ok(())
        });
        match committed {
            Ok(()) => {}
            Err(TransactionError::Storage(source)) => return Err(self.failed(source)),
            Err(TransactionError::Abort(never)) => return Err(self.failed(never)),
        }
        self.database.flush().map_err(|source| self.failed(source))?;
        Ok(())
    }

    fn failed(&self, source: sled::Error) -> StoreError {
        StoreError::Database { path: self.path.clone(), source }
    }

    pub(super) fn corrupt(&self, record: String, problem: String) -> StoreError {
        StoreError::Corrupt { path: self.path.clone(), record, problem }
    }
}

impl MapStore for SledStore {
    fn info(&self) -> Result<MapInfo, StoreError> {
        let record = "the map's info".to_owned();
        let Some(bytes) = self.get(Table::Info, INFO_KEY)? else {
            return Err(self.corrupt(record, "it is missing".to_owned()));
        };
        let info = record::unseal_info(Table::Info.name(), INFO_KEY, &bytes);
        info.and_then(InfoRecord::into_info).map_err(|problem| self.corrupt(record, problem))
    }

    fn keyframe(&self, id: KeyframeId) -> Result<Option<Keyframe>, StoreError> {
        let key = id.to_be_bytes();
        self.get(Table::Keyframes, &key)?.map(|value| self.decode_keyframe(&key, &value)).transpose()
    }

    fn landmark(&self, id: LandmarkId) -> Result<Option<Landmark>, StoreError> {
        let key = id.to_be_bytes();
        self.get(Table::Landmarks, &key)?.map(|value| self.decode_landmark(&key, &value)).transpose()
    }

    fn landmarks_of_keyframe(&self, id: KeyframeId) -> Result<Vec<Landmark>, StoreError> {
        let mut landmarks = Vec::new();
        for landmark in self.observed_landmarks(id)? {
            let landmark = self.landmark(landmark)?;
            // References of a landmark that was damaged when it was replaced may point at nothing.
            let observes = |landmark: &Landmark| landmark.observations.iter().any(|seen| seen.keyframe == id);
            landmarks.extend(landmark.filter(observes));
        }
        Ok(landmarks)
    }

    fn cross_covariance(&self, a: KeyframeId, b: KeyframeId) -> Result<Option<CrossCovariance>, StoreError> {
        let key = pair_key(a.min(b), a.max(b));
        let Some(value) = self.get(Table::CrossCovariances, &key)? else { return Ok(None) };
        let cross = self.decode_cross_covariance(&key, &value)?;
        let asked = if a <= b { cross } else { CrossCovariance { a, b, block: cross.block.transpose() } };
        Ok(Some(asked))
    }

    fn keyframes(&self) -> Records<'_, Keyframe> {
        self.records(Table::Keyframes, SledStore::decode_keyframe)
    }

    fn landmarks(&self) -> Records<'_, Landmark> {
        self.records(Table::Landmarks, SledStore::decode_landmark)
    }

    fn cross_covariances(&self) -> Records<'_, CrossCovariance> {
        self.records(Table::CrossCovariances, SledStore::decode_cross_covariance)
    }

    fn apply(&self, batch: &[Change]) -> Result<u64, StoreError> {
        let _one_at_a_time = self.locked();
        let stored = self.info()?;
        let pending = Pending::collect(batch, self)?;
        pending.check(self, &stored)?;
        let version = stored.version + 1;
        let writes = self.writes_of(&pending, pending.info.unwrap_or(&stored), version)?;
        self.commit(&writes)?;
        Ok(version)
    }

    fn replace_all(&self, contents: &MapContents) -> Result<u64, StoreError> {
        contents.validate()?;
        let _one_at_a_time = self.locked();
        let version = self.info()?.version + 1;
        let mut writes = Writes::default();
        for table in Table::CONTENTS {
            for key in self.tree(table).iter().keys() {
                writes.remove(table, key.map_err(|source| self.failed(source))?);
            }
        }
        self.write_info(&mut writes, &contents.info, version)?;
        for keyframe in &contents.keyframes {
            self.write_keyframe(&mut writes, keyframe)?;
        }
        for landmark in &contents.landmarks {
            self.write_landmark(&mut writes, landmark)?;
        }
        for cross in &contents.cross_covariances {
            self.write_cross_covariance(&mut writes, &cross.ordered())?;
        }
        self.commit(&writes)?;
        Ok(version)
    }
}

/// Opens a database, or makes an empty one.
fn open_database(path: &Path) -> Result<sled::Db, StoreError> {
    let config = sled::Config::new()
        .path(path)
        .cache_capacity(CACHE_BYTES)
        // Every batch is flushed before it is acknowledged; nothing is left for a timer.
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
            Err(source) => return Err(StoreError::Database { path: path.to_owned(), source }),
            Ok(database) => return Ok(database),
        }
    }
}

/// Makes sure that a database holds a map that this program reads, without writing to it.
fn check_schema(path: &Path, database: &sled::Db) -> Result<(), StoreError> {
    let failed = |source| StoreError::Database { path: path.to_owned(), source };
    let no_map = || StoreError::NotAMap {
        path: path.to_owned(),
        problem: "its database holds no map schema".to_owned(),
    };
    if !database.tree_names().iter().any(|name| name == Table::Info.name().as_bytes()) {
        return Err(no_map());
    }
    let info = database.open_tree(Table::Info.name()).map_err(failed)?;
    let bytes = info.get(SCHEMA_KEY).map_err(failed)?.ok_or_else(no_map)?;
    let number = bytes.strip_prefix(SCHEMA_MAGIC).and_then(|number| number.try_into().ok());
    match number.map(u16::from_le_bytes).ok_or_else(no_map)? {
        OLDEST_STORE_SCHEMA..=STORE_SCHEMA => Ok(()),
        found => Err(StoreError::Schema { path: path.to_owned(), found, expected: STORE_SCHEMA }),
    }
}
