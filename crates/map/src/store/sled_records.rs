//! Between the records of a database and the model: decoding, and the writes of a batch.

use super::pending::Pending;
use super::record::{CrossRecord, InfoRecord, KeyframeRecord, LandmarkRecord};
use super::tables::{
    CORRELATED, INFO_KEY, OBSERVES, SCHEMA_KEY, SCHEMA_MAGIC, Table, Writes, pair_key, reference_key,
};
use super::{MapStore, STORE_SCHEMA, SledStore, StoreError};
use crate::model::{CrossCovariance, Keyframe, Landmark, MapInfo};

impl SledStore {
    pub(super) fn decode_keyframe(&self, key: &[u8], value: &[u8]) -> Result<Keyframe, StoreError> {
        let id = self.id_of(Table::Keyframes, key)?;
        let record: KeyframeRecord = self.unseal(Table::Keyframes, key, value)?;
        record.into_keyframe(id).map_err(|problem| self.corrupt(Table::Keyframes.describe(key), problem))
    }

    pub(super) fn decode_landmark(&self, key: &[u8], value: &[u8]) -> Result<Landmark, StoreError> {
        let id = self.id_of(Table::Landmarks, key)?;
        let record: LandmarkRecord = self.unseal(Table::Landmarks, key, value)?;
        Ok(record.into_landmark(id))
    }

    pub(super) fn decode_cross_covariance(
        &self,
        key: &[u8],
        value: &[u8],
    ) -> Result<CrossCovariance, StoreError> {
        let (a, b) = key.split_at(key.len() / 2);
        let (a, b) = (self.id_of(Table::CrossCovariances, a)?, self.id_of(Table::CrossCovariances, b)?);
        let record: CrossRecord = self.unseal(Table::CrossCovariances, key, value)?;
        Ok(record.into_cross(a, b))
    }

    fn id_of(&self, table: Table, key: &[u8]) -> Result<u64, StoreError> {
        let id = key.try_into().map(u64::from_be_bytes);
        id.map_err(|_| self.corrupt(table.describe(key), "its key is malformed".to_owned()))
    }

    /// Turns a checked batch into writes. A damaged old landmark can be replaced or removed: references that it
    /// leaves behind are passed over by [`MapStore::landmarks_of_keyframe`].
    pub(super) fn writes_of(
        &self,
        pending: &Pending<'_>,
        info: &MapInfo,
        version: u64,
    ) -> Result<Writes, StoreError> {
        let mut writes = Writes::default();
        self.write_info(&mut writes, info, version)?;
        for (&id, keyframe) in &pending.keyframes {
            match keyframe {
                Some(keyframe) => self.write_keyframe(&mut writes, keyframe)?,
                None => writes.remove(Table::Keyframes, id.to_be_bytes()),
            }
        }
        for (&id, landmark) in &pending.landmarks {
            if let Ok(Some(old)) = self.landmark(id) {
                for observation in &old.observations {
                    writes.remove(Table::References, reference_key(OBSERVES, observation.keyframe, id));
                }
            }
            match landmark {
                Some(landmark) => self.write_landmark(&mut writes, landmark)?,
                None => writes.remove(Table::Landmarks, id.to_be_bytes()),
            }
        }
        for (&(a, b), cross) in &pending.cross_covariances {
            if let Some(cross) = cross {
                self.write_cross_covariance(&mut writes, cross)?;
            } else {
                writes.remove(Table::CrossCovariances, pair_key(a, b));
                writes.remove(Table::References, reference_key(CORRELATED, a, b));
                writes.remove(Table::References, reference_key(CORRELATED, b, a));
            }
        }
        Ok(writes)
    }

    pub(super) fn write_keyframe(&self, writes: &mut Writes, keyframe: &Keyframe) -> Result<(), StoreError> {
        let key = keyframe.id.to_be_bytes();
        writes.insert(
            Table::Keyframes,
            key,
            self.seal(Table::Keyframes, &key, &KeyframeRecord::new(keyframe))?,
        );
        Ok(())
    }

    pub(super) fn write_landmark(&self, writes: &mut Writes, landmark: &Landmark) -> Result<(), StoreError> {
        let key = landmark.id.to_be_bytes();
        writes.insert(
            Table::Landmarks,
            key,
            self.seal(Table::Landmarks, &key, &LandmarkRecord::new(landmark))?,
        );
        for observation in &landmark.observations {
            writes.insert(
                Table::References,
                reference_key(OBSERVES, observation.keyframe, landmark.id),
                Vec::new(),
            );
        }
        Ok(())
    }

    pub(super) fn write_cross_covariance(
        &self,
        writes: &mut Writes,
        cross: &CrossCovariance,
    ) -> Result<(), StoreError> {
        let key = pair_key(cross.a, cross.b);
        let record = self.seal(Table::CrossCovariances, &key, &CrossRecord::new(cross))?;
        writes.insert(Table::CrossCovariances, key, record);
        writes.insert(Table::References, reference_key(CORRELATED, cross.a, cross.b), Vec::new());
        writes.insert(Table::References, reference_key(CORRELATED, cross.b, cross.a), Vec::new());
        Ok(())
    }

    /// Writes the info, and the schema with it: a map of an older schema becomes one of this with its first change.
    pub(super) fn write_info(
        &self,
        writes: &mut Writes,
        info: &MapInfo,
        version: u64,
    ) -> Result<(), StoreError> {
        let record = self.seal(Table::Info, INFO_KEY, &InfoRecord::new(info, version))?;
        writes.insert(Table::Info, SCHEMA_KEY, [SCHEMA_MAGIC, &STORE_SCHEMA.to_le_bytes()].concat());
        writes.insert(Table::Info, INFO_KEY, record);
        Ok(())
    }
}
