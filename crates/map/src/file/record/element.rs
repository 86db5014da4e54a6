//! Which record each element of a map has.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::RecordError;
use super::layout::{
    AliasesRecord, CommonErrorRecord, CrossCovarianceRecord, KeyframeRecord, LandmarkRecord,
};
use super::table::Table;
use crate::model::{CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark};

/// An element of a map, which is stored as one record.
pub trait Element: Sized {
    /// What such records are.
    const TABLE: Table;
    /// One id, or two; records ascend by it.
    type Key: Copy + Default + Ord + AsRef<[u64]> + AsMut<[u64]>;
    /// What the payload of the record holds.
    type Record: Serialize + DeserializeOwned;

    /// Where it belongs.
    fn key(&self) -> Self::Key;

    /// What is stored.
    fn to_record(&self) -> Self::Record;

    /// What was stored.
    ///
    /// # Errors
    /// A value that no such element can have.
    fn from_record(key: Self::Key, record: Self::Record) -> Result<Self, RecordError>;
}

/// A key as it is stored: ids big-endian.
pub fn key_bytes(key: &[u64]) -> Vec<u8> {
    key.iter().flat_map(|id| id.to_be_bytes()).collect()
}

impl Element for Keyframe {
    const TABLE: Table = Table::Keyframes;
    type Key = [u64; 1];
    type Record = KeyframeRecord;

    fn key(&self) -> [u64; 1] {
        [self.id]
    }

    fn to_record(&self) -> KeyframeRecord {
        KeyframeRecord::new(self)
    }

    fn from_record([id]: [u64; 1], record: KeyframeRecord) -> Result<Self, RecordError> {
        record.into_keyframe(id)
    }
}

/// Its observations are in the order of their keyframes.
impl Element for Landmark {
    const TABLE: Table = Table::Landmarks;
    type Key = [u64; 1];
    type Record = LandmarkRecord;

    fn key(&self) -> [u64; 1] {
        [self.id]
    }

    fn to_record(&self) -> LandmarkRecord {
        LandmarkRecord::new(self)
    }

    fn from_record([id]: [u64; 1], record: LandmarkRecord) -> Result<Self, RecordError> {
        Ok(record.into_landmark(id))
    }
}

/// `a < b`.
impl Element for KeyframeCrossCovariance {
    const TABLE: Table = Table::CrossCovariances;
    type Key = [u64; 2];
    type Record = CrossCovarianceRecord;

    fn key(&self) -> [u64; 2] {
        [self.a, self.b]
    }

    fn to_record(&self) -> CrossCovarianceRecord {
        CrossCovarianceRecord::new(self)
    }

    fn from_record([a, b]: [u64; 2], record: CrossCovarianceRecord) -> Result<Self, RecordError> {
        Ok(record.into_cross_covariance(a, b))
    }
}

impl Element for CommonError {
    const TABLE: Table = Table::CommonErrors;
    type Key = [u64; 1];
    type Record = CommonErrorRecord;

    fn key(&self) -> [u64; 1] {
        [self.keyframe]
    }

    fn to_record(&self) -> CommonErrorRecord {
        CommonErrorRecord::new(self)
    }

    fn from_record([keyframe]: [u64; 1], record: CommonErrorRecord) -> Result<Self, RecordError> {
        Ok(record.into_common_error(keyframe))
    }
}

impl Element for KeyframeAliases {
    const TABLE: Table = Table::Aliases;
    type Key = [u64; 1];
    type Record = AliasesRecord;

    fn key(&self) -> [u64; 1] {
        [self.keyframe]
    }

    fn to_record(&self) -> AliasesRecord {
        AliasesRecord::new(self)
    }

    fn from_record([keyframe]: [u64; 1], record: AliasesRecord) -> Result<Self, RecordError> {
        Ok(record.into_aliases(keyframe))
    }
}
