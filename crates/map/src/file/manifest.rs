//! The manifest of a stored map: what applies to it as a whole, and its segments.

use protocol::MapIdentity;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::segment::{SegmentName, sha256};
use crate::added::FeatureKind;
use crate::model::MapMetadata;

/// Layout of a map on disk that has features of one kind and no images.
pub const STORE_SCHEMA: u16 = 9;
/// Layout of a map with added features or images. Maps with another number than these two are refused.
pub const EXTENDED_STORE_SCHEMA: u16 = 10;

/// What a folder states of its map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Manifest {
    /// Version and identity among it.
    pub map: MapMetadata,
    /// See [`crate::MapContents::digest`].
    pub digest: MapIdentity,
    /// Segments without landmarks, in the order of their keys ...
    pub frame: Vec<SegmentName>,
    /// ... and behind them in the same file those with landmarks only.
    pub landmarks: Vec<SegmentName>,
    /// Behind them, kind by kind, the landmarks of added features ...
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub added_features: Vec<AddedSegments>,
    /// ... and the images of keyframes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub images: Vec<SegmentName>,
}

/// What a manifest states of an added kind of features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct AddedSegments {
    /// The kind.
    pub kind: FeatureKind,
    /// Segments with its landmarks only.
    pub landmarks: Vec<SegmentName>,
}

/// The file of a manifest.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sealed<'a> {
    schema: u16,
    /// Of the text of `manifest`, as it stands in the file.
    sha256: String,
    #[serde(borrow)]
    manifest: &'a RawValue,
}

/// Why a text is no manifest.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ManifestError {
    /// It is of another layout.
    #[error("it has schema {found}")]
    Schema { found: u16 },
    #[error("{0}")]
    Json(#[from] serde_json::Error),
    #[error("its text has changed since it was written")]
    Checksum,
    #[error("it states no map that was stored")]
    NotStored,
    #[error("it has not the fields of schema {schema}")]
    Fields { schema: u16 },
}

impl Manifest {
    /// The text of the file.
    pub(crate) fn encode(&self) -> Result<Vec<u8>, serde_json::Error> {
        let text = serde_json::to_string_pretty(self)?;
        let sha256 = sha256(text.as_bytes());
        let manifest: &RawValue = serde_json::from_str(&text)?;
        let mut text = serde_json::to_vec_pretty(&Sealed { schema: self.schema(), sha256, manifest })?;
        text.push(b'\n');
        Ok(text)
    }

    /// What a file says.
    pub(crate) fn decode(text: &[u8]) -> Result<Manifest, ManifestError> {
        /// Another layout may have other fields.
        #[derive(Deserialize)]
        struct Numbered {
            schema: u16,
        }
        let Numbered { schema: found } = serde_json::from_slice(text)?;
        if ![STORE_SCHEMA, EXTENDED_STORE_SCHEMA].contains(&found) {
            return Err(ManifestError::Schema { found });
        }
        let Sealed { sha256: stated, manifest, .. } = serde_json::from_slice(text)?;
        if sha256(manifest.get().as_bytes()) != stated {
            return Err(ManifestError::Checksum);
        }
        let manifest: Manifest = serde_json::from_str(manifest.get())?;
        if manifest.map.identity.is_none() || [0, u64::MAX].contains(&manifest.map.version) {
            return Err(ManifestError::NotStored);
        }
        if manifest.schema() != found {
            return Err(ManifestError::Fields { schema: found });
        }
        Ok(manifest)
    }

    /// The layout: programs that know only the first one read maps that need nothing else.
    pub(crate) fn schema(&self) -> u16 {
        let is_extended = !self.added_features.is_empty() || !self.images.is_empty();
        if is_extended { EXTENDED_STORE_SCHEMA } else { STORE_SCHEMA }
    }

    /// In the order in which they are in the file.
    pub(crate) fn segments(&self) -> impl Iterator<Item = &SegmentName> {
        let added = self.added_features.iter().flat_map(|added| &added.landmarks);
        self.frame.iter().chain(&self.landmarks).chain(added).chain(&self.images)
    }

    /// Bytes of all segments.
    pub(crate) fn bytes(&self) -> u64 {
        self.segments().map(|segment| segment.bytes).fold(0, u64::saturating_add)
    }
}
