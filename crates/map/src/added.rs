//! What a map may have beside its keyframes and landmarks: features of further kinds, and the images of its keyframes.
//!
//! A map is adjusted by the features of one kind, the primary one, whose landmarks are [`MapContents::landmarks`]. Landmarks of an
//! added kind are triangulated from the same keyframes with the poses held, so that no pose and no covariance changes by them: what a
//! query with either kind learns of a keyframe's pose is what the primary kind alone has told, and is counted once.
//!
//! [`MapContents::landmarks`]: crate::MapContents::landmarks

use protocol::{DescriptorFormat, DescriptorKind, KeyframeId, LandmarkId};
use serde::{Deserialize, Serialize};

use crate::contents::MapContents;
use crate::model::{Landmark, MapMetadata};

/// First two bytes of a JPEG file.
pub(crate) const JPEG_MARKER: [u8; 2] = [0xff, 0xd8];

/// A kind of features: what computed them, and how their descriptors are compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FeatureKind {
    /// Name and version of the extractor, like `edgepoint2-1`; of a kind that was added not empty.
    pub extractor: String,
    /// The kind of all descriptors.
    pub descriptor_kind: DescriptorKind,
    /// Bytes in each descriptor.
    pub descriptor_width: u16,
    /// Standard deviation of the pixels (px), one value for both axes.
    pub sigma_px: f64,
}

impl FeatureKind {
    /// What a query's descriptors must have to be compared.
    pub fn format(&self) -> DescriptorFormat {
        DescriptorFormat { kind: self.descriptor_kind, width: self.descriptor_width }
    }
}

/// Landmarks of a further kind of features in the keyframes of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct AddedFeatures {
    /// The kind; no two of a map have one extractor.
    pub kind: FeatureKind,
    /// By id, the observations of each by keyframe. Ids ascend from kind to kind, beyond those of the map's own landmarks: an id names
    /// one landmark, of whatever kind.
    pub landmarks: Vec<Landmark>,
}

/// The image that a keyframe was made of.
#[derive(Clone, PartialEq)]
pub struct KeptImage {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// A JPEG file of the size of the keyframe's camera, grey.
    pub jpeg: Vec<u8>,
}

impl std::fmt::Debug for KeptImage {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "KeptImage of keyframe {}, {} bytes", self.keyframe, self.jpeg.len())
    }
}

/// Ids that stay free before the landmarks of an added kind where these get others: for new ones of the kinds before.
const FREE_IDS: LandmarkId = 1 << 20;

impl MapContents {
    /// Gives the landmarks of each added kind ids beyond those of the kinds before, where they have not. Within a kind their order stays.
    /// Ids beyond [`MAX_ID`](crate::model::MAX_ID), which the map is then refused for, end at the largest number.
    pub fn renumber_added(&mut self) {
        let mut last = self.landmarks.iter().map(|landmark| landmark.id).max();
        for added in &mut self.added_features {
            let ids = || added.landmarks.iter().map(|landmark| landmark.id);
            let (Some(first), Some(end)) = (ids().min(), ids().max()) else { continue };
            let shift = match last {
                Some(before) if first <= before => (before - first).saturating_add(1 + FREE_IDS),
                _ => 0,
            };
            added.landmarks.iter_mut().for_each(|landmark| landmark.id = landmark.id.saturating_add(shift));
            last = Some(end.saturating_add(shift));
        }
    }
}

impl MapMetadata {
    /// The primary kind of the map's features.
    pub fn feature_kind(&self) -> FeatureKind {
        FeatureKind {
            extractor: self.extractor.clone(),
            descriptor_kind: self.descriptor_kind,
            descriptor_width: self.descriptor_width,
            sigma_px: self.sigma_px,
        }
    }

    /// The same map with another kind as the primary one, without the ledger, which counts observations of the primary kind.
    #[must_use]
    pub fn with_kind(&self, kind: &FeatureKind) -> MapMetadata {
        MapMetadata {
            name: self.name.clone(),
            created_by: self.created_by.clone(),
            version: self.version,
            identity: self.identity,
            gravity_in_global: self.gravity_in_global,
            own_frame: self.own_frame,
            descriptor_kind: kind.descriptor_kind,
            descriptor_width: kind.descriptor_width,
            sigma_px: kind.sigma_px,
            extractor: kind.extractor.clone(),
            sessions: Vec::new(),
        }
    }
}
