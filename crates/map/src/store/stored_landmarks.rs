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
    pub(super) count: usize,
    pub(super) observation_counts: Vec<u32>,
}

impl StoredLandmarks {
    /// Number of landmarks.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Number of observations by each keyframe, in the order of the map's keyframes.
    pub fn observation_counts(&self) -> &[u32] {
        &self.observation_counts
    }

    /// Calls `visit` with each landmark by id, the observations of each sorted by keyframe.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], [`StoreError::Read`] where the file fails now.
    pub fn read(mut self, mut visit: impl FnMut(Landmark)) -> Result<(), StoreError> {
        self.file.visit_landmarks(false, |id, payload| {
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
