//! Which record each element of a map has.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::envelope::HEADER_BYTES;
use super::error::RecordError;
use super::layout::{
    AliasesRecord, CommonErrorRecord, CrossCovarianceRecord, ExistenceRecord, ImageRecord, KeyframeRecord,
    LandmarkRecord,
};
use super::table::Table;
use crate::added::KeptImage;
use crate::model::{
    CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark, LandmarkExistence, Observation,
};

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

impl Landmark {
    /// Bytes that it takes on disk: its record with the key and the length.
    pub fn bytes_on_disk(&self) -> u64 {
        const KEY_AND_LENGTH: usize = 12;
        const ANCHOR_POSITION_AND_COUNT: usize = 40;
        const KEYFRAME_PIXEL_AND_LENGTH: usize = 24;
        let of_observation = |seen: &Observation| KEYFRAME_PIXEL_AND_LENGTH + seen.descriptor.len();
        let observations: usize = self.observations.iter().map(of_observation).sum();
        (KEY_AND_LENGTH + HEADER_BYTES + ANCHOR_POSITION_AND_COUNT + observations) as u64
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

impl Element for KeptImage {
    const TABLE: Table = Table::Images;
    type Key = [u64; 1];
    type Record = ImageRecord;

    fn key(&self) -> [u64; 1] {
        [self.keyframe]
    }

    fn to_record(&self) -> ImageRecord {
        ImageRecord::new(self)
    }

    fn from_record([keyframe]: [u64; 1], record: ImageRecord) -> Result<Self, RecordError> {
        Ok(record.into_image(keyframe))
    }
}

impl Element for LandmarkExistence {
    const TABLE: Table = Table::Existence;
    type Key = [u64; 1];
    type Record = ExistenceRecord;

    fn key(&self) -> [u64; 1] {
        [self.landmark]
    }

    fn to_record(&self) -> ExistenceRecord {
        ExistenceRecord::new(self)
    }

    fn from_record([landmark]: [u64; 1], record: ExistenceRecord) -> Result<Self, RecordError> {
        Ok(record.into_existence(landmark))
    }
}
