//! Several kinds of features in one map: which of them a query is answered with.
//!
//! Each kind has its landmarks, its index and its evidence; all share the keyframes. A query is answered with the kind that it has: by
//! the name of its extractor, or where it names none by the form of its descriptors, the primary kind first.

use map::FeatureKind;
use map::model::MapMetadata;
use protocol::FeatureSet;
use vision::DescriptorView;

use super::loaded_map::LoadedMap;
use super::query::QueryError;

impl LoadedMap {
    /// The kinds of features that queries may have, the primary one first.
    pub fn feature_kinds(&self) -> Vec<FeatureKind> {
        self.kinds().map(|map| map.info.feature_kind()).collect()
    }

    /// The map with each kind of features, the primary one first.
    pub(crate) fn kinds(&self) -> impl Iterator<Item = &LoadedMap> {
        std::iter::once(self).chain(&self.added)
    }

    /// The map with the kind of features that an image has; where none can be compared with it, with the primary kind, whose
    /// [`LoadedMap::view`] says so.
    pub(crate) fn for_features(&self, features: &FeatureSet) -> &LoadedMap {
        let fitting = || self.kinds().filter(|map| fits(&map.info, features));
        let is_named = |map: &&LoadedMap| map.info.extractor == features.extractor;
        fitting().find(is_named).or_else(|| fitting().next()).unwrap_or(self)
    }

    /// A query's descriptors, which must be comparable with those of this kind.
    pub(super) fn view<'a>(&self, features: &'a FeatureSet) -> Result<DescriptorView<'a>, QueryError> {
        view_of(&self.info, features, || self.feature_kinds())
    }
}

/// Whether features can be compared with those of a map.
fn fits(info: &MapMetadata, features: &FeatureSet) -> bool {
    let (stated, wanted) = (&features.extractor, &info.extractor);
    features.descriptors.format() == info.feature_kind().format()
        && (stated.is_empty() || wanted.is_empty() || stated == wanted)
}

/// A query's descriptors, which must be comparable with those of a map.
///
/// # Arguments
/// * `offered`: the kinds that the map has, for the error.
pub(super) fn view_of<'a>(
    info: &MapMetadata,
    features: &'a FeatureSet,
    offered: impl FnOnce() -> Vec<FeatureKind>,
) -> Result<DescriptorView<'a>, QueryError> {
    if !fits(info, features) {
        let (query, offered) = (features.descriptors.format(), offered());
        let is_of_kind = offered.iter().any(|kind| kind.format() == query);
        return Err(if is_of_kind {
            QueryError::ExtractorMismatch { query: features.extractor.clone(), offered }
        } else {
            QueryError::DescriptorMismatch { query, offered }
        });
    }
    let metric = vision::metric_of(info.descriptor_kind);
    let width = usize::from(info.descriptor_width);
    Ok(DescriptorView::new(metric, width, &features.descriptors.bytes)?)
}

/// Kinds of features in words, for an error.
pub(super) fn describe(kinds: &[FeatureKind]) -> String {
    let one = |kind: &FeatureKind| {
        let name = if kind.extractor.is_empty() { "an unknown extractor" } else { &kind.extractor };
        format!("{name} ({}, {} bytes)", kind.descriptor_kind.label(), kind.descriptor_width)
    };
    kinds.iter().map(one).collect::<Vec<_>>().join(" and ")
}
