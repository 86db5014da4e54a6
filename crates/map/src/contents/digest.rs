//! The digest of a map: what a robot sees of it, in 16 bytes.

use protocol::{LandmarkId, MapIdentity};
use serde::Serialize;
use sha2::{Digest as _, Sha256};

use super::MapContents;
use crate::model::{CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark, MapMetadata};
use crate::store::record::{
    AliasesRecord, CommonErrorRecord, CrossCovarianceRecord, InfoRecord, KeyframeRecord, LandmarkRecord,
    payload,
};

impl MapContents {
    /// The first 16 bytes of the SHA-256 over all records in the order of their ids, whatever their order here. Equal for
    /// equal maps and different for different ones, but blind to what is only displayed: the name, the creator, the version
    /// and the identity.
    pub fn digest(&self) -> MapIdentity {
        let mut digest = RunningDigest::new(&self.info);
        let mut keyframes: Vec<_> = self.keyframes.iter().collect();
        keyframes.sort_by_key(|keyframe| keyframe.id);
        for keyframe in keyframes {
            digest.add_keyframe(keyframe);
        }
        let mut landmarks: Vec<_> = self.landmarks.iter().collect();
        landmarks.sort_by_key(|landmark| landmark.id);
        for landmark in landmarks {
            let mut landmark = landmark.clone();
            landmark.observations.sort_by_key(|observation| observation.keyframe);
            digest.add_landmark(&landmark);
        }
        let mut crosses: Vec<_> =
            self.cross_covariances.iter().map(KeyframeCrossCovariance::ordered).collect();
        crosses.sort_by_key(|cross| (cross.a, cross.b));
        for cross in &crosses {
            digest.add_cross_covariance(cross);
        }
        let mut common_errors: Vec<_> = self.common_errors.iter().collect();
        common_errors.sort_by_key(|common| common.keyframe);
        for common in common_errors {
            digest.add_common_error(common);
        }
        let mut aliases: Vec<_> = self.aliases.iter().collect();
        aliases.sort_by_key(|aliases| aliases.keyframe);
        for aliases in aliases {
            digest.add_aliases(aliases);
        }
        digest.finish()
    }
}

/// A digest of what is added: all keyframes, all landmarks, all cross-covariances, all common errors, all aliases, each in
/// the order of their ids.
pub(crate) struct RunningDigest(Sha256);

impl RunningDigest {
    pub(crate) fn new(info: &MapMetadata) -> Self {
        let mut info = info.clone();
        info.name.clear();
        info.created_by.clear();
        (info.version, info.identity) = (0, None);
        let mut digest = Self(Sha256::new());
        digest.add("info", &[], &InfoRecord::new(&info));
        digest
    }

    pub(crate) fn add_keyframe(&mut self, keyframe: &Keyframe) {
        self.add("keyframes", &[keyframe.id], &KeyframeRecord::new(keyframe));
    }

    /// Adds a landmark whose observations are in the order of their keyframes.
    pub(crate) fn add_landmark(&mut self, landmark: &Landmark) {
        self.add_landmark_record(landmark.id, &payload(&LandmarkRecord::new(landmark)));
    }

    /// Adds the record of a landmark as [`RunningDigest::add_landmark`] adds the landmark.
    pub(crate) fn add_landmark_record(&mut self, id: LandmarkId, payload: &[u8]) {
        self.add_payload("landmarks", &[id], payload);
    }

    /// Adds a cross-covariance with `a < b`.
    pub(crate) fn add_cross_covariance(&mut self, cross: &KeyframeCrossCovariance) {
        self.add("cross_covariances", &[cross.a, cross.b], &CrossCovarianceRecord::new(cross));
    }

    pub(crate) fn add_common_error(&mut self, common: &CommonError) {
        self.add("common_errors", &[common.keyframe], &CommonErrorRecord::new(common));
    }

    pub(crate) fn add_aliases(&mut self, aliases: &KeyframeAliases) {
        self.add("aliases", &[aliases.keyframe], &AliasesRecord::new(aliases));
    }

    fn add<T: Serialize>(&mut self, table: &str, key: &[u64], record: &T) {
        self.add_payload(table, key, &payload(record));
    }

    /// Every part is preceded by its length, so that no two sequences of records have the same bytes.
    fn add_payload(&mut self, table: &str, key: &[u64], payload: &[u8]) {
        let key: Vec<u8> = key.iter().flat_map(|id| id.to_le_bytes()).collect();
        for part in [table.as_bytes(), &key, payload] {
            self.0.update((part.len() as u64).to_le_bytes());
            self.0.update(part);
        }
    }

    pub(crate) fn finish(self) -> MapIdentity {
        let all = self.0.finalize();
        MapIdentity::from_bytes(std::array::from_fn(|at| all[at]))
    }
}
