//! Where maps are kept: the [`MapStore`] trait, the batches that change a map, and what can go wrong.

mod pending;
mod record;
mod sled_records;
mod sled_store;
mod tables;

use std::path::PathBuf;

use protocol::{KeyframeId, LandmarkId};

pub use sled_store::SledStore;

use crate::contents::{ContentsError, MapContents};
use crate::model::{CrossCovariance, Keyframe, Landmark, MapInfo};

/// Layout of the records on disk. A store of a larger number is refused on opening.
///
/// 1: as in the first release. 2: the info of the map says the extractor. Every change writes the newest.
pub const STORE_SCHEMA: u16 = 2;

/// The oldest layout that is read.
pub const OLDEST_STORE_SCHEMA: u16 = 1;

/// One change of a map; see [`Batch`].
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// Replaces what holds for the map as a whole; its `version` is ignored.
    PutInfo(MapInfo),
    /// Adds a keyframe or replaces that of the same id.
    PutKeyframe(Box<Keyframe>),
    /// Takes a keyframe out, with its cross-covariances. Landmarks must not observe it any more.
    RemoveKeyframe(KeyframeId),
    /// Adds a landmark or replaces that of the same id.
    PutLandmark(Landmark),
    /// Takes a landmark out.
    RemoveLandmark(LandmarkId),
    /// Adds the cross-covariance of a pair of keyframes, or replaces it.
    PutCrossCovariance(CrossCovariance),
    /// Makes a pair of keyframes independent, in whichever order it is named.
    RemoveCrossCovariance(KeyframeId, KeyframeId),
}

/// Changes that happen together or not at all, in their order, and raise the map's version by one.
pub type Batch = Vec<Change>;

/// How much a map holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StoreCounts {
    /// Number of keyframes.
    pub keyframes: usize,
    /// Number of landmarks.
    pub landmarks: usize,
    /// Number of observations, summed over landmarks.
    pub observations: usize,
    /// Number of keyframe pairs with a known cross-covariance.
    pub cross_covariances: usize,
}

/// Why a store could not do what it was asked for.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// There is no map at the path.
    #[error("there is no map at {path}: build one with `driftless build-map` or `driftless import-map`")]
    Missing {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// A new map must not overwrite what is there.
    #[error("{path} exists already: choose another path, or remove it first")]
    Exists {
        /// Where the map should have been made.
        path: PathBuf,
    },
    /// The path holds something else.
    #[error("{path} is not a Driftless map: {problem}")]
    NotAMap {
        /// The path.
        path: PathBuf,
        /// What was found.
        problem: String,
    },
    /// The map was written by an incompatible version of this program.
    #[error(
        "the map {path} has schema {found}, this program reads schema {expected}: \
         export it with the version that wrote it and import it again"
    )]
    Schema {
        /// The path.
        path: PathBuf,
        /// The number in the store.
        found: u16,
        /// [`STORE_SCHEMA`].
        expected: u16,
    },
    /// Another process has the map open.
    #[error("the map {path} is in use by another program (a map_server?): stop it first")]
    InUse {
        /// The path.
        path: PathBuf,
    },
    /// One record cannot be read; all others still can.
    #[error("{record} in the map {path} is damaged: {problem}")]
    Corrupt {
        /// The path.
        path: PathBuf,
        /// Which record, for example `landmark 17`.
        record: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The change would break a law of maps; nothing was written.
    #[error("the map would become invalid: {0}")]
    Invalid(#[from] ContentsError),
    /// The database under the map failed.
    #[error("the database {path} failed: {source}")]
    Database {
        /// The path.
        path: PathBuf,
        /// What the database says.
        source: sled::Error,
    },
}

/// Boxed iterator over records, each of which may be damaged by itself.
pub type Records<'a, T> = Box<dyn Iterator<Item = Result<T, StoreError>> + 'a>;

/// A map at rest.
///
/// All of it is behind this trait so that the database can be exchanged. Reads see the newest acknowledged batch.
/// Iterators return records by ascending id and go on behind a damaged one.
pub trait MapStore: Send + Sync {
    /// What holds for the map as a whole, with the current version.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`], [`StoreError::Database`].
    fn info(&self) -> Result<MapInfo, StoreError>;

    /// One keyframe, `None` where the map has none of that id.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`], [`StoreError::Database`].
    fn keyframe(&self, id: KeyframeId) -> Result<Option<Keyframe>, StoreError>;

    /// One landmark, `None` where the map has none of that id.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`], [`StoreError::Database`].
    fn landmark(&self, id: LandmarkId) -> Result<Option<Landmark>, StoreError>;

    /// All landmarks that a keyframe observes, by id.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] for the first damaged one, [`StoreError::Database`].
    fn landmarks_of_keyframe(&self, id: KeyframeId) -> Result<Vec<Landmark>, StoreError>;

    /// Covariance between two keyframes in the order asked for (rows `a`), `None` where they are independent.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`], [`StoreError::Database`].
    fn cross_covariance(&self, a: KeyframeId, b: KeyframeId) -> Result<Option<CrossCovariance>, StoreError>;

    /// All keyframes by id.
    fn keyframes(&self) -> Records<'_, Keyframe>;

    /// All landmarks by id.
    fn landmarks(&self) -> Records<'_, Landmark>;

    /// All cross-covariances by (a, b), `a < b`.
    fn cross_covariances(&self) -> Records<'_, CrossCovariance>;

    /// Makes all changes or none. When this returns, they are on the disk and survive a crash.
    ///
    /// # Returns
    /// The new version of the map, one more than before.
    ///
    /// # Errors
    /// [`StoreError::Invalid`] where a law of maps would be broken (nothing is written),
    /// [`StoreError::Corrupt`], [`StoreError::Database`].
    fn apply(&self, batch: &[Change]) -> Result<u64, StoreError>;

    /// Replaces the whole map by `contents` in one atomic step; its version is one more than the old one.
    ///
    /// # Returns
    /// The new version of the map.
    ///
    /// # Errors
    /// [`StoreError::Invalid`] (nothing is written), [`StoreError::Database`].
    fn replace_all(&self, contents: &MapContents) -> Result<u64, StoreError>;

    /// Adds `contents` to the map in one atomic step, replacing what has the same id.
    ///
    /// # Returns
    /// The new version of the map.
    ///
    /// # Errors
    /// As [`MapStore::apply`].
    fn write_contents(&self, contents: &MapContents) -> Result<u64, StoreError> {
        let mut batch = vec![Change::PutInfo(contents.info.clone())];
        batch.extend(
            contents.keyframes.iter().cloned().map(|keyframe| Change::PutKeyframe(Box::new(keyframe))),
        );
        batch.extend(contents.landmarks.iter().cloned().map(Change::PutLandmark));
        batch.extend(contents.cross_covariances.iter().cloned().map(Change::PutCrossCovariance));
        self.apply(&batch)
    }

    /// The whole map, sorted by id.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] for the first damaged record, [`StoreError::Database`].
    fn read_contents(&self) -> Result<MapContents, StoreError> {
        let mut contents = MapContents {
            info: self.info()?,
            keyframes: self.keyframes().collect::<Result<_, _>>()?,
            landmarks: self.landmarks().collect::<Result<_, _>>()?,
            cross_covariances: self.cross_covariances().collect::<Result<_, _>>()?,
        };
        contents.sort();
        Ok(contents)
    }

    /// All of the map that can be read, and the errors of what cannot. Landmarks and cross-covariances that name
    /// an unreadable keyframe are left out, an observation in one is dropped, so the result keeps the laws of
    /// maps.
    ///
    /// # Errors
    /// Only where the map's info cannot be read, without which nothing else has a meaning.
    fn read_readable(&self) -> Result<(MapContents, Vec<StoreError>), StoreError> {
        let mut errors = Vec::new();
        let mut contents = MapContents {
            info: self.info()?,
            keyframes: readable(self.keyframes(), &mut errors),
            landmarks: readable(self.landmarks(), &mut errors),
            cross_covariances: readable(self.cross_covariances(), &mut errors),
        };
        contents.sort();
        contents.drop_dangling();
        Ok((contents, errors))
    }

    /// How much the map holds; reads all landmarks.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`], [`StoreError::Database`].
    fn counts(&self) -> Result<StoreCounts, StoreError> {
        let mut counts = StoreCounts {
            keyframes: self.keyframes().count(),
            cross_covariances: self.cross_covariances().count(),
            ..StoreCounts::default()
        };
        for landmark in self.landmarks() {
            counts.landmarks += 1;
            counts.observations += landmark?.observations.len();
        }
        Ok(counts)
    }
}

fn readable<T>(records: Records<'_, T>, errors: &mut Vec<StoreError>) -> Vec<T> {
    records.filter_map(|record| record.map_err(|error| errors.push(error)).ok()).collect()
}
