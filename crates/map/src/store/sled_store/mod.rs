//! A map in a [sled](https://docs.rs/sled/0.34) database, laid out as described in [`tables`].

mod opening;
mod tables;

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::STORE_SCHEMA;
use super::error::DatabaseError;
use super::map_store::{MapStore, OpenDatabase, VisitRecord};
use super::record::{
    self, AliasesRecord, CommonErrorRecord, CrossCovarianceRecord, InfoRecord, KeyframeRecord,
    LandmarkRecord, RecordError,
};
use crate::contents::MapContents;
use crate::model::{KeyframeCrossCovariance, MapMetadata};
use opening::{READING_CACHE_BYTES, WRITING_CACHE_BYTES, close_database, failed, open_database};
use tables::{INFO_KEY, SCHEMA_KEY, SCHEMA_MAGIC, Table, pair_key};

/// Maps in sled databases.
pub(super) struct SledStore;

impl MapStore for SledStore {
    fn write(&self, folder: &Path, contents: &MapContents) -> Result<(), DatabaseError> {
        let database = open_database(folder, WRITING_CACHE_BYTES)?;
        write_tables(&database, contents)?;
        close_database(folder, database)
    }

    fn open(&self, folder: &Path) -> Result<Box<dyn OpenDatabase>, DatabaseError> {
        let database = open_database(folder, READING_CACHE_BYTES)?;
        Ok(Box::new(SledDatabase { folder: folder.to_owned(), database }))
    }
}

/// An open sled database.
struct SledDatabase {
    folder: PathBuf,
    database: sled::Db,
}

impl OpenDatabase for SledDatabase {
    fn read_frame(&self) -> Result<MapContents, DatabaseError> {
        read_frame(&self.database)
    }

    fn visit_landmarks(&self, visit: &mut VisitRecord<'_>) -> Result<(), DatabaseError> {
        Tree::open(&self.database, Table::Landmarks)?
            .visit(|key, value| visit(id_of(key)?, record::open(Table::Landmarks.name(), key, value)?))
    }

    fn close(self: Box<Self>) -> Result<(), DatabaseError> {
        // Nobody needs the copy any more, but its folder must not be removed under a thread of the database.
        close_database(&self.folder, self.database)
    }
}

fn write_tables(database: &sled::Db, contents: &MapContents) -> Result<(), DatabaseError> {
    let keyframes = contents.keyframes.iter();
    Tree::open(database, Table::Keyframes)?
        .write_all(keyframes.map(|keyframe| (keyframe.id.to_be_bytes(), || KeyframeRecord::new(keyframe))))?;
    let landmarks = contents.landmarks.iter();
    Tree::open(database, Table::Landmarks)?
        .write_all(landmarks.map(|landmark| (landmark.id.to_be_bytes(), || LandmarkRecord::new(landmark))))?;
    let cross_covariances = contents.cross_covariances.iter().map(KeyframeCrossCovariance::ordered);
    Tree::open(database, Table::CrossCovariances)?.write_all(
        cross_covariances
            .map(|cross| (pair_key(cross.a, cross.b), move || CrossCovarianceRecord::new(&cross))),
    )?;
    let common_errors = contents.common_errors.iter();
    Tree::open(database, Table::CommonErrors)?.write_all(
        common_errors.map(|common| (common.keyframe.to_be_bytes(), || CommonErrorRecord::new(common))),
    )?;
    let aliases = contents.aliases.iter();
    Tree::open(database, Table::Aliases)?
        .write_all(aliases.map(|aliases| (aliases.keyframe.to_be_bytes(), || AliasesRecord::new(aliases))))?;
    let info = Tree::open(database, Table::Info)?;
    info.write(INFO_KEY, &InfoRecord::new(&contents.info))?;
    let schema = [SCHEMA_MAGIC, &STORE_SCHEMA.to_le_bytes()].concat();
    info.tree.insert(SCHEMA_KEY, schema).map_err(failed)?;
    Ok(())
}

/// Reads all but the landmarks.
fn read_frame(database: &sled::Db) -> Result<MapContents, DatabaseError> {
    check_schema(database)?;
    let mut contents = MapContents::empty(read_info(database)?);
    contents.keyframes = Tree::open(database, Table::Keyframes)?.read(|key, value| {
        let id = id_of(key)?;
        record::unseal::<KeyframeRecord>(Table::Keyframes.name(), key, value)?.into_keyframe(id)
    })?;
    let cross_covariances = Tree::open(database, Table::CrossCovariances)?;
    contents.cross_covariances = cross_covariances.read(|key, value| {
        let (a, b) = key.split_at(key.len() / 2);
        let (a, b) = (id_of(a)?, id_of(b)?);
        let record: CrossCovarianceRecord = record::unseal(Table::CrossCovariances.name(), key, value)?;
        Ok(record.into_cross_covariance(a, b))
    })?;
    contents.common_errors = Tree::open(database, Table::CommonErrors)?.read(|key, value| {
        let record: CommonErrorRecord = record::unseal(Table::CommonErrors.name(), key, value)?;
        Ok(record.into_common_error(id_of(key)?))
    })?;
    contents.aliases = Tree::open(database, Table::Aliases)?.read(|key, value| {
        let record: AliasesRecord = record::unseal(Table::Aliases.name(), key, value)?;
        Ok(record.into_aliases(id_of(key)?))
    })?;
    contents.sort();
    Ok(contents)
}

/// Whether the database has the schema that this program reads.
fn check_schema(database: &sled::Db) -> Result<(), DatabaseError> {
    if !database.tree_names().iter().any(|name| name == Table::Info.name().as_bytes()) {
        return Err(DatabaseError::NoMap);
    }
    let info = Tree::open(database, Table::Info)?;
    let bytes = info.tree.get(SCHEMA_KEY).map_err(failed)?.ok_or(DatabaseError::NoMap)?;
    let number = bytes.strip_prefix(SCHEMA_MAGIC).and_then(|number| number.try_into().ok());
    match number.map(u16::from_le_bytes).ok_or(DatabaseError::NoMap)? {
        STORE_SCHEMA => Ok(()),
        found => Err(DatabaseError::Schema { found }),
    }
}

fn read_info(database: &sled::Db) -> Result<MapMetadata, DatabaseError> {
    let bytes = Tree::open(database, Table::Info)?.tree.get(INFO_KEY).map_err(failed)?;
    bytes
        .ok_or(RecordError::Missing)
        .and_then(|bytes| record::unseal::<InfoRecord>(Table::Info.name(), INFO_KEY, &bytes)?.into_info())
        .map_err(|problem| DatabaseError::Record { record: Table::Info.describe(INFO_KEY), problem })
}

/// A tree of the database with its table.
struct Tree {
    table: Table,
    tree: sled::Tree,
}

impl Tree {
    fn open(database: &sled::Db, table: Table) -> Result<Tree, DatabaseError> {
        Ok(Tree { table, tree: database.open_tree(table.name()).map_err(failed)? })
    }

    fn write<T: Serialize>(&self, key: &[u8], record: &T) -> Result<(), DatabaseError> {
        let bytes = record::seal(self.table.name(), key, record)
            .map_err(|problem| DatabaseError::Record { record: self.table.describe(key), problem })?;
        self.tree.insert(key, bytes).map_err(failed)?;
        Ok(())
    }

    /// Writes records in the order of their keys: first all keys with empty values, then the values.
    ///
    /// sled rewrites a leaf of its tree whenever that is split, and the former versions stay in the file: twice the size
    /// of the records. Splitting empty leaves first costs next to nothing, and a full leaf is not rewritten until it has
    /// been changed more often than it has keys.
    fn write_all<K: AsRef<[u8]>, T: Serialize>(
        &self,
        records: impl Iterator<Item = (K, impl FnOnce() -> T)> + Clone,
    ) -> Result<(), DatabaseError> {
        for (key, _) in records.clone() {
            self.tree.insert(key, &[]).map_err(failed)?;
        }
        for (key, record) in records {
            self.write(key.as_ref(), &record())?;
        }
        Ok(())
    }

    /// All records. The first error ends it: of the database, the iterator would repeat it for ever.
    fn read<T>(
        &self,
        decode: impl Fn(&[u8], &[u8]) -> Result<T, RecordError>,
    ) -> Result<Vec<T>, DatabaseError> {
        let mut records = Vec::new();
        self.visit(|key, value| {
            records.push(decode(key, value)?);
            Ok(())
        })?;
        records.shrink_to_fit();
        Ok(records)
    }

    /// Visits the keys and values of all records in the order of [`Tree::read`].
    fn visit(
        &self,
        mut visit: impl FnMut(&[u8], &[u8]) -> Result<(), RecordError>,
    ) -> Result<(), DatabaseError> {
        let mut previous: Option<sled::IVec> = None;
        for entry in &self.tree {
            let (key, value) = entry.map_err(failed)?;
            if previous.is_some_and(|previous| previous >= key) {
                return Err(DatabaseError::Order { table: self.table.name() });
            }
            visit(&key, &value)
                .map_err(|problem| DatabaseError::Record { record: self.table.describe(&key), problem })?;
            previous = Some(key);
        }
        Ok(())
    }
}

fn id_of(key: &[u8]) -> Result<u64, RecordError> {
    key.try_into().map(u64::from_be_bytes).map_err(|_| RecordError::Key)
}
