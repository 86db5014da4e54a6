//! The landmarks of a stored map, read one at a time.

use protocol::LandmarkId;

use super::error::StoreError;
use super::version_file::VersionFile;
use crate::file::record::{Element as _, RecordError, decode};
use crate::model::Landmark;

/// The landmarks of a stored map that was opened with [`open_map`](super::open_map): by far most of its bytes.
///
/// They were read once already, to verify and to count them. Whoever keeps them in a form of its own can so make room for all
/// of them first, and never has them in memory twice.
pub struct StoredLandmarks {
    pub(super) file: VersionFile,
    /// By kind of features, the primary one first.
    pub(super) counted: Vec<LandmarkCounts>,
}

/// What was counted of the landmarks of one kind of features.
pub(super) struct LandmarkCounts {
    pub(super) landmarks: usize,
    /// By keyframe.
    pub(super) observations: Vec<u32>,
}

impl StoredLandmarks {
    /// Number of landmarks of a kind.
    ///
    /// # Arguments
    /// * `kind`: 0 the primary one, then the added ones in their order; one that the map has.
    pub fn count(&self, kind: usize) -> usize {
        self.counted[kind].landmarks
    }

    /// Number of observations of a kind's landmarks by each keyframe, in the order of the map's keyframes.
    ///
    /// # Arguments
    /// * `kind`: as of [`StoredLandmarks::count`].
    pub fn observation_counts(&self, kind: usize) -> &[u32] {
        &self.counted[kind].observations
    }

    /// Calls `visit` with each landmark of a kind by id, the observations of each sorted by keyframe.
    ///
    /// # Arguments
    /// * `kind`: as of [`StoredLandmarks::count`].
    ///
    /// # Errors
    /// [`StoreError::Damaged`], [`StoreError::Read`] where the file fails now.
    pub fn read(&mut self, kind: usize, mut visit: impl FnMut(Landmark)) -> Result<(), StoreError> {
        self.file.visit_landmarks(kind.checked_sub(1), false, |id, payload| {
            visit(decode_landmark(id, payload)?);
            Ok(())
        })
    }
}

/// A landmark of the payload of its record.
pub(super) fn decode_landmark(id: LandmarkId, payload: &[u8]) -> Result<Landmark, RecordError> {
    let mut landmark = Landmark::from_record([id], decode(payload)?)?;
    landmark.observations.sort_by_key(|observation| observation.keyframe);
    Ok(landmark)
}
