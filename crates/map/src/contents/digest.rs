//! The digest of a map: what a robot sees of it, in 16 bytes.

use protocol::MapIdentity;
use sha2::{Digest as _, Sha256};

use super::MapContents;
use super::sorted::Sorted;
use crate::added::FeatureKind;
use crate::file::record::{Element, kind_to_byte, payload};
use crate::model::MapMetadata;

impl MapContents {
    /// The first 16 bytes of the SHA-256 over all records in the order of their ids, whatever their order here. Equal for
    /// equal maps and different for different ones, but blind to what is only displayed: the name, the creator, the version
    /// and the identity.
    pub fn digest(&self) -> MapIdentity {
        let sorted = Sorted::of(self);
        let mut digest = RunningDigest::new(&self.info);
        sorted.keyframes.iter().for_each(|keyframe| digest.add(*keyframe));
        sorted.cross_covariances.iter().for_each(|cross| digest.add(cross.as_ref()));
        sorted.common_errors.iter().for_each(|common| digest.add(*common));
        sorted.aliases.iter().for_each(|aliases| digest.add(*aliases));
        sorted.existence.iter().for_each(|existence| digest.add(*existence));
        sorted.landmarks.iter().for_each(|landmark| digest.add(landmark.as_ref()));
        for (kind, landmarks) in &sorted.added_features {
            digest.add_kind(kind);
            for landmark in landmarks {
                digest.add(landmark.as_ref());
            }
        }
        sorted.images.iter().for_each(|image| digest.add(*image));
        digest.finish()
    }
}

/// A digest of what is added: all keyframes, all cross-covariances, all common errors, all aliases, what is known of landmarks' existence,
/// all landmarks, each in the order of their keys, then each added kind of features with its landmarks, then all images.
pub(crate) struct RunningDigest(Sha256);

impl RunningDigest {
    pub(crate) fn new(info: &MapMetadata) -> Self {
        let mut digest = Self(Sha256::new());
        let gravity: Option<[f64; 3]> = info.gravity_in_global.map(Into::into);
        let kind = kind_to_byte(info.descriptor_kind);
        let facts =
            (gravity, info.own_frame, kind, info.descriptor_width, info.sigma_px, info.extractor.as_str());
        digest.add_payload("info", &[], &payload(&facts));
        digest
    }

    /// Adds what applies to all features of an added kind.
    pub(crate) fn add_kind(&mut self, kind: &FeatureKind) {
        let byte = kind_to_byte(kind.descriptor_kind);
        let facts = (byte, kind.descriptor_width, kind.sigma_px, kind.extractor.as_str());
        self.add_payload("added_features", &[], &payload(&facts));
    }

    fn add<E: Element>(&mut self, element: &E) {
        self.add_record::<E>(element.key(), &payload(&element.to_record()));
    }

    /// Adds an element by what is stored of it.
    pub(crate) fn add_record<E: Element>(&mut self, key: E::Key, payload: &[u8]) {
        self.add_payload(E::TABLE.name(), key.as_ref(), payload);
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
