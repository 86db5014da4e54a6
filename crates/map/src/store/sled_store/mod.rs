//! A map in a [sled](https://docs.rs/sled/0.34) database: one directory a map, laid out as described in [`tables`].

mod opening;
mod tables;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;
use sled::transaction::{TransactionError, Transactional};

use super::error::StoreError;
use super::map_store::{MapStore, Records};
use super::record::{self, CrossCovarianceRecord, InfoRecord, KeyframeRecord, LandmarkRecord, RecordError};
use super::{OLDEST_STORE_SCHEMA, STORE_SCHEMA};
use crate::contents::{self, MapContents};
use crate::model::{Keyframe, KeyframeCrossCovariance, Landmark, MapMetadata};
use opening::open_database;
use tables::{INFO_KEY, OBSOLETE_TABLE, SCHEMA_KEY, SCHEMA_MAGIC, Table, Writes, pair_key};

/// A map in a sled database.
pub(super) struct SledStore {
    path: PathBuf,
    database: sled::Db,
    /// In the order of [`Table::ALL`].
    trees: [sled::Tree; 4],
    /// A new version is one more than the stored one, so one is written at a time.
    writer: Mutex<()>,
}

impl SledStore {
    /// See [`super::create`].
    pub(super) fn create(path: &Path, info: &MapMetadata) -> Result<SledStore, StoreError> {
        let empty = || std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
        if path.exists() && !empty() {
            return Err(StoreError::Exists { path: path.to_owned() });
        }
        contents::check_metadata(info)?;
        let store = SledStore::with_tables(path, open_database(path)?)?;
        let mut writes = Writes::default();
        store.write_info(&mut writes, info, 0)?;
        store.commit(&writes)?;
        Ok(store)
    }

    /// See [`super::open`].
    pub(super) fn open(path: &Path) -> Result<SledStore, StoreError> {
        if !path.exists() {
            return Err(StoreError::Missing { path: path.to_owned() });
        }
        // Opening any other directory would make it a database.
        if !(path.join("conf").is_file() && path.join("db").is_file()) {
            return Err(StoreError::NotAMap { path: path.to_owned(), problem: "it holds no database" });
        }
        let database = open_database(path)?;
        check_schema(path, &database)?;
        SledStore::with_tables(path, database)
    }

    fn with_tables(path: &Path, database: sled::Db) -> Result<SledStore, StoreError> {
        let tree = |table: Table| database.open_tree(table.name()).map_err(|source| failed(path, source));
        let [info, keyframes, landmarks, cross_covariances] = Table::ALL.map(tree);
        let trees = [info?, keyframes?, landmarks?, cross_covariances?];
        Ok(SledStore { path: path.to_owned(), database, trees, writer: Mutex::new(()) })
    }

    fn tree(&self, table: Table) -> &sled::Tree {
        &self.trees[table as usize]
    }

    /// All records of a table, each decoded by itself.
    fn records<T: 'static>(
        &self,
        table: Table,
        decode: impl Fn(&[u8], &[u8]) -> Result<T, RecordError> + 'static,
    ) -> Records<'_, T> {
        Box::new(self.tree(table).iter().map(move |entry| {
            let (key, value) = entry.map_err(|source| failed(&self.path, source))?;
            decode(&key, &value).map_err(|problem| self.corrupt(table.describe(&key), problem))
        }))
    }

    fn write<T: Serialize>(
        &self,
        writes: &mut Writes,
        table: Table,
        key: &[u8],
        record: &T,
    ) -> Result<(), StoreError> {
        let bytes = record::seal(table.name(), key, record)
            .map_err(|problem| self.corrupt(table.describe(key), problem))?;
        writes.insert(table, key, bytes);
        Ok(())
    }

    /// Writes the info, and the schema with it: a map of an older schema becomes one of this with its first change.
    fn write_info(&self, writes: &mut Writes, info: &MapMetadata, version: u64) -> Result<(), StoreError> {
        let schema = [SCHEMA_MAGIC, &STORE_SCHEMA.to_le_bytes()].concat();
        writes.insert(Table::Info, SCHEMA_KEY, schema);
        self.write(writes, Table::Info, INFO_KEY, &InfoRecord::new(info, version))
    }

    /// Makes the writes in one transaction over all tables and waits until they are on the disk.
    fn commit(&self, writes: &Writes) -> Result<(), StoreError> {
        let committed = self.trees[..].transaction(|trees| {
            for (tree, batch) in trees.iter().zip(&writes.batches) {
                tree.apply_batch(batch)?;
            }
            Ok(())
        });
        match committed {
            Ok(()) => {}
            Err(TransactionError::Storage(source) | TransactionError::Abort(source)) => {
                return Err(failed(&self.path, source));
            }
        }
        self.database.flush().map_err(|source| failed(&self.path, source))?;
        Ok(())
    }

    fn corrupt(&self, record: String, problem: RecordError) -> StoreError {
        StoreError::Corrupt { path: self.path.clone(), record, problem }
    }
}

impl MapStore for SledStore {
    fn info(&self) -> Result<MapMetadata, StoreError> {
        let bytes = self.tree(Table::Info).get(INFO_KEY).map_err(|source| failed(&self.path, source))?;
        bytes
            .ok_or(RecordError::Missing)
            .and_then(|bytes| record::unseal_info(Table::Info.name(), INFO_KEY, &bytes)?.into_info())
            .map_err(|problem| self.corrupt(Table::Info.describe(INFO_KEY), problem))
    }

    fn keyframes(&self) -> Records<'_, Keyframe> {
        self.records(Table::Keyframes, |key, value| {
            let id = id_of(key)?;
            record::unseal::<KeyframeRecord>(Table::Keyframes.name(), key, value)?.into_keyframe(id)
        })
    }

    fn landmarks(&self) -> Records<'_, Landmark> {
        self.records(Table::Landmarks, |key, value| {
            let id = id_of(key)?;
            let record: LandmarkRecord = record::unseal(Table::Landmarks.name(), key, value)?;
            Ok(record.into_landmark(id))
        })
    }

    fn cross_covariances(&self) -> Records<'_, KeyframeCrossCovariance> {
        self.records(Table::CrossCovariances, |key, value| {
            let (a, b) = key.split_at(key.len() / 2);
            let (a, b) = (id_of(a)?, id_of(b)?);
            let record: CrossCovarianceRecord = record::unseal(Table::CrossCovariances.name(), key, value)?;
            Ok(record.into_cross_covariance(a, b))
        })
    }

    fn replace_all(&self, contents: &MapContents) -> Result<u64, StoreError> {
        contents.validate()?;
        // The lock guards no data, so a writer that panicked left nothing half done.
        let _one_at_a_time = self.writer.lock().unwrap_or_else(PoisonError::into_inner);
        let version = self.info()?.version + 1;
        let mut writes = Writes::default();
        for table in Table::CONTENTS {
            for key in self.tree(table).iter().keys() {
                writes.remove(table, &key.map_err(|source| failed(&self.path, source))?);
            }
        }
        self.write_info(&mut writes, &contents.info, version)?;
        for keyframe in &contents.keyframes {
            let key = keyframe.id.to_be_bytes();
            self.write(&mut writes, Table::Keyframes, &key, &KeyframeRecord::new(keyframe))?;
        }
        for landmark in &contents.landmarks {
            let key = landmark.id.to_be_bytes();
            self.write(&mut writes, Table::Landmarks, &key, &LandmarkRecord::new(landmark))?;
        }
        for cross in contents.cross_covariances.iter().map(KeyframeCrossCovariance::ordered) {
            let key = pair_key(cross.a, cross.b);
            self.write(&mut writes, Table::CrossCovariances, &key, &CrossCovarianceRecord::new(&cross))?;
        }
        self.database.drop_tree(OBSOLETE_TABLE).map_err(|source| failed(&self.path, source))?;
        self.commit(&writes)?;
        Ok(version)
    }

    fn size_on_disk(&self) -> Result<u64, StoreError> {
        self.database.size_on_disk().map_err(|source| failed(&self.path, source))
    }
}

fn id_of(key: &[u8]) -> Result<u64, RecordError> {
    key.try_into().map(u64::from_be_bytes).map_err(|_| RecordError::Key)
}

fn failed(path: &Path, source: sled::Error) -> StoreError {
    StoreError::Database { path: path.to_owned(), source: source.into() }
}

/// Ensures that a database holds a map that this program reads, without writing to it.
fn check_schema(path: &Path, database: &sled::Db) -> Result<(), StoreError> {
    let no_map =
        || StoreError::NotAMap { path: path.to_owned(), problem: "its database holds no map schema" };
    if !database.tree_names().iter().any(|name| name == Table::Info.name().as_bytes()) {
        return Err(no_map());
    }
    let info = database.open_tree(Table::Info.name()).map_err(|source| failed(path, source))?;
    let bytes = info.get(SCHEMA_KEY).map_err(|source| failed(path, source))?.ok_or_else(no_map)?;
    let number = bytes.strip_prefix(SCHEMA_MAGIC).and_then(|number| number.try_into().ok());
    match number.map(u16::from_le_bytes).ok_or_else(no_map)? {
        OLDEST_STORE_SCHEMA..=STORE_SCHEMA => Ok(()),
        found => Err(StoreError::Schema { path: path.to_owned(), found, expected: STORE_SCHEMA }),
    }
}
