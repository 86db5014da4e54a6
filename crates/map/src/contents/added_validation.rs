//! The invariants of what a map has beside its keyframes and landmarks.

use std::collections::BTreeSet;

use protocol::{KeyframeId, LandmarkId};

use super::error::{AddedFeaturesProblem, ContentsError, ImageProblem};
use super::validation::{check_landmark, ensure, metadata_problem};
use crate::added::{AddedFeatures, JPEG_MARKER, KeptImage};
use crate::contents::MapContents;
use crate::model::{Keyframe, Landmark, MapMetadata};

impl MapContents {
    /// Checks all added kinds of features.
    pub(super) fn check_added_features<'a>(
        &self,
        keyframe: impl Fn(KeyframeId) -> Option<&'a Keyframe>,
    ) -> Result<(), ContentsError> {
        let mut extractors = BTreeSet::from([self.info.extractor.as_str()]);
        let mut last = self.landmarks.iter().map(|landmark| landmark.id).max();
        for added in &self.added_features {
            check_added(&self.info, added, &mut extractors, &mut last, &keyframe).map_err(|problem| {
                ContentsError::AddedFeatures { extractor: added.kind.extractor.clone(), problem }
            })?;
        }
        Ok(())
    }

    /// Checks all images.
    pub(super) fn check_images(&self, is_keyframe: impl Fn(KeyframeId) -> bool) -> Result<(), ContentsError> {
        let mut seen = BTreeSet::new();
        for KeptImage { keyframe, jpeg } in &self.images {
            let checked = ensure(is_keyframe(*keyframe), ImageProblem::UnknownKeyframe)
                .and_then(|()| ensure(seen.insert(*keyframe), ImageProblem::Duplicate))
                .and_then(|()| ensure(jpeg.starts_with(&JPEG_MARKER), ImageProblem::NotJpeg));
            checked.map_err(|problem| ContentsError::Image { keyframe: *keyframe, problem })?;
        }
        Ok(())
    }
}

/// Checks one added kind of features.
///
/// # Arguments
/// * `extractors`: of the kinds before.
/// * `last`: the largest id of the landmarks before, of all kinds.
fn check_added<'a, 'e>(
    info: &MapMetadata,
    added: &'e AddedFeatures,
    extractors: &mut BTreeSet<&'e str>,
    last: &mut Option<LandmarkId>,
    keyframe: impl Fn(KeyframeId) -> Option<&'a Keyframe>,
) -> Result<(), AddedFeaturesProblem> {
    ensure(!added.kind.extractor.is_empty(), AddedFeaturesProblem::Unnamed)?;
    ensure(extractors.insert(&added.kind.extractor), AddedFeaturesProblem::Duplicate)?;
    let info = info.with_kind(&added.kind);
    metadata_problem(&info).map_or(Ok(()), |problem| Err(AddedFeaturesProblem::Kind(Box::new(problem))))?;
    let (first, before) = (added.landmarks.iter().map(|landmark| landmark.id).min(), *last);
    for landmark in &added.landmarks {
        let id = landmark.id;
        check_landmark(&info, landmark, &keyframe)
            .map_err(|problem| AddedFeaturesProblem::Landmark { id, problem })?;
    }
    let unordered = first.filter(|&first| before.is_some_and(|before| first <= before));
    let mut ids = BTreeSet::new();
    let twice = added.landmarks.iter().map(|landmark| landmark.id).find(|&id| !ids.insert(id));
    unordered.or(twice).map_or(Ok(()), |id| Err(AddedFeaturesProblem::Order { id }))?;
    *last = ids.last().copied().or(before);
    Ok(())
}

/// Checks one landmark of an added kind, see [`MapContents::validate`].
///
/// # Arguments
/// * `info`: of the map with the kind, see [`MapMetadata::with_kind`].
/// * `before`: the id of the landmark before it, of this or a former kind.
///
/// # Errors
/// [`ContentsError::AddedFeatures`].
pub fn validate_added_landmark<'a>(
    info: &MapMetadata,
    before: Option<LandmarkId>,
    landmark: &Landmark,
    keyframe: impl Fn(KeyframeId) -> Option<&'a Keyframe>,
) -> Result<(), ContentsError> {
    let id = landmark.id;
    ensure(before.is_none_or(|before| before < id), AddedFeaturesProblem::Order { id })
        .and_then(|()| {
            check_landmark(info, landmark, keyframe)
                .map_err(|problem| AddedFeaturesProblem::Landmark { id, problem })
        })
        .map_err(|problem| ContentsError::AddedFeatures { extractor: info.extractor.clone(), problem })
}
