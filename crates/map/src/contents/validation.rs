//! The invariants of maps.

use std::collections::{BTreeMap, BTreeSet};

use geometry::covariance_check::{check_covariance, check_difference};
use geometry::is_coordinate;
use nalgebra::{Matrix6, SMatrix};
use protocol::{DescriptorKind, KeyframeId, LandmarkId, MAX_EXTRACTOR_BYTES};

use super::error::{
    AliasProblem, CommonErrorProblem, ContentsError, CrossCovarianceProblem, ExistenceProblem,
    KeyframeProblem, LandmarkProblem, MetadataProblem,
};
use crate::contents::MapContents;
use crate::model::{
    Alias, CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark, LandmarkExistence,
    MAX_ID, MapMetadata, Observation,
};
use crate::sessions::check_ledger;

/// How far the norm of a quaternion or of the gravity direction may be from 1: a map is computed in `f64`, and text
/// maps are normalized on reading.
const UNIT_TOLERANCE: f64 = 1e-6;

type Keyframes<'a> = BTreeMap<KeyframeId, &'a Keyframe>;
type CommonErrors<'a> = BTreeMap<KeyframeId, &'a CommonError>;

impl MapContents {
    /// Checks every invariant of a map: ids are unique and at most [`MAX_ID`], references exist, numbers are finite, positions are within [`geometry::MAX_COORDINATE_M`], quaternions and gravity
    /// are of unit length, pixels lie in their images, descriptors have the map's width, covariances (of one
    /// keyframe, what its common error leaves of it, and of each pair with a cross-covariance) are symmetric and positive
    /// semi-definite, each landmark is observed by its anchor, aliases are of other keyframes and have finite log-odds, existence is of
    /// landmarks of the map and has finite log-odds, every keyframe has one session, unless the map has no ledger of its sessions, added kinds of features have extractors and ids of their own, and images
    /// are of keyframes.
    ///
    /// # Errors
    /// The first [`ContentsError`] in the order metadata, keyframes, landmarks, common errors, cross-covariances, aliases, existence,
    /// added features, images.
    pub fn validate(&self) -> Result<(), ContentsError> {
        check_metadata(&self.info)?;
        check_ledger(&self.info, &self.keyframes).map_err(|problem| ContentsError::Metadata {
            problem: MetadataProblem::Sessions(Box::new(problem)),
        })?;
        let mut keyframes = Keyframes::new();
        for keyframe in &self.keyframes {
            let first = keyframes.insert(keyframe.id, keyframe).is_none();
            check_keyframe(&self.info, keyframe)
                .and_then(|()| ensure(first, KeyframeProblem::Duplicate))
                .map_err(|problem| ContentsError::Keyframe { id: keyframe.id, problem })?;
        }
        let mut landmark_ids = BTreeSet::new();
        for landmark in &self.landmarks {
            let first = landmark_ids.insert(landmark.id);
            check_landmark(&self.info, landmark, |id| keyframes.get(&id).copied())
                .and_then(|()| ensure(first, LandmarkProblem::Duplicate))
                .map_err(|problem| ContentsError::Landmark { id: landmark.id, problem })?;
        }
        let common = self.check_common_errors(&keyframes)?;
        let mut pairs = BTreeSet::new();
        for cross in &self.cross_covariances {
            let first = pairs.insert((cross.a.min(cross.b), cross.a.max(cross.b)));
            check_cross_covariance(cross, &keyframes, &common)
                .and_then(|()| ensure(first, CrossCovarianceProblem::Duplicate))
                .map_err(|problem| ContentsError::CrossCovariance { a: cross.a, b: cross.b, problem })?;
        }
        self.check_aliases(&keyframes)?;
        self.check_existence()?;
        self.check_added_features(|id| keyframes.get(&id).copied())?;
        self.check_images(|id| keyframes.contains_key(&id))
    }

    fn check_existence(&self) -> Result<(), ContentsError> {
        if self.existence.is_empty() {
            return Ok(());
        }
        let mut unchecked: BTreeSet<LandmarkId> = self.landmarks.iter().map(|landmark| landmark.id).collect();
        let mut checked = BTreeSet::new();
        for &LandmarkExistence { landmark, log_odds, .. } in &self.existence {
            let first = checked.insert(landmark);
            ensure(first, ExistenceProblem::Duplicate)
                .and_then(|()| ensure(unchecked.remove(&landmark), ExistenceProblem::UnknownLandmark))
                .and_then(|()| ensure(log_odds.is_finite(), ExistenceProblem::LogOdds { log_odds }))
                .map_err(|problem| ContentsError::Existence { landmark, problem })?;
        }
        Ok(())
    }

    fn check_aliases(&self, keyframes: &Keyframes<'_>) -> Result<(), ContentsError> {
        let mut checked = BTreeSet::new();
        for aliases in &self.aliases {
            let first = checked.insert(aliases.keyframe);
            check_aliases(aliases, keyframes)
                .and_then(|()| ensure(first, AliasProblem::Duplicate))
                .map_err(|problem| ContentsError::Aliases { keyframe: aliases.keyframe, problem })?;
        }
        Ok(())
    }

    fn check_common_errors(&self, keyframes: &Keyframes<'_>) -> Result<CommonErrors<'_>, ContentsError> {
        let expected = self.common_errors.first().map_or(0, |common| common.factor.ncols());
        let mut checked = CommonErrors::new();
        for common in &self.common_errors {
            let first = checked.insert(common.keyframe, common).is_none();
            check_common_error(common, expected, keyframes)
                .and_then(|()| ensure(first, CommonErrorProblem::Duplicate))
                .map_err(|problem| ContentsError::CommonError { keyframe: common.keyframe, problem })?;
        }
        Ok(checked)
    }
}

/// Checks the invariants of one landmark, see [`MapContents::validate`], but for the uniqueness of its id.
///
/// # Arguments
/// * `keyframe`: the keyframe of an id, `None` where the map has none of it.
///
/// # Errors
/// [`ContentsError::Landmark`].
pub fn validate_landmark<'a>(
    info: &MapMetadata,
    landmark: &Landmark,
    keyframe: impl Fn(KeyframeId) -> Option<&'a Keyframe>,
) -> Result<(), ContentsError> {
    check_landmark(info, landmark, keyframe)
        .map_err(|problem| ContentsError::Landmark { id: landmark.id, problem })
}

pub(super) fn ensure<E>(holds: bool, problem: E) -> Result<(), E> {
    if holds { Ok(()) } else { Err(problem) }
}

/// Checks what applies to the map as a whole.
fn check_metadata(info: &MapMetadata) -> Result<(), ContentsError> {
    metadata_problem(info).map_or(Ok(()), |problem| Err(ContentsError::Metadata { problem }))
}

pub(super) fn metadata_problem(info: &MapMetadata) -> Option<MetadataProblem> {
    let width = info.descriptor_width;
    if width == 0 {
        return Some(MetadataProblem::EmptyDescriptors);
    }
    if info.descriptor_kind == DescriptorKind::Float && !width.is_multiple_of(4) {
        return Some(MetadataProblem::FloatWidth { width });
    }
    if !(info.sigma_px.is_finite() && info.sigma_px > 0.0) {
        return Some(MetadataProblem::PixelSigma { sigma_px: info.sigma_px });
    }
    if info.extractor.len() > MAX_EXTRACTOR_BYTES || info.extractor.chars().any(char::is_control) {
        return Some(MetadataProblem::ExtractorName);
    }
    let norm = info.gravity_in_global.map(|gravity| gravity.norm()).filter(|&norm| !is_unit(norm));
    norm.map(|norm| MetadataProblem::Gravity { norm })
}

/// Checks one keyframe by itself.
fn check_keyframe(info: &MapMetadata, keyframe: &Keyframe) -> Result<(), KeyframeProblem> {
    ensure(keyframe.id <= MAX_ID, KeyframeProblem::Id)?;
    let pose = &keyframe.global_from_keyframe.pose;
    let position: [f64; 3] = pose.translation.into();
    ensure(position.iter().copied().all(is_coordinate), KeyframeProblem::Position { position })?;
    let norm = pose.rotation.quaternion().norm();
    ensure(is_unit(norm), KeyframeProblem::Quaternion { norm })?;
    keyframe.camera.validate().map_err(KeyframeProblem::Camera)?;
    check_covariance(&keyframe.global_from_keyframe.covariance).map_err(KeyframeProblem::Covariance)?;
    let Some(features) = &keyframe.features else { return Ok(()) };
    let descriptors = &features.descriptors;
    let comparable = descriptors.kind == info.descriptor_kind && descriptors.width == info.descriptor_width;
    ensure(comparable, KeyframeProblem::DescriptorFormat)?;
    if !features.extractor.is_empty() && features.extractor != info.extractor {
        let (found, expected) = (features.extractor.clone(), info.extractor.clone());
        return Err(KeyframeProblem::Extractor { found, expected });
    }
    let expected_bytes = features.pixels.len() * usize::from(descriptors.width);
    ensure(descriptors.bytes.len() == expected_bytes, KeyframeProblem::DescriptorCount)?;
    let finite = features.pixels.iter().flatten().all(|value| value.is_finite());
    ensure(finite, KeyframeProblem::FeaturePixel)
}

/// Checks one landmark against the keyframes that it names.
pub(super) fn check_landmark<'a>(
    info: &MapMetadata,
    landmark: &Landmark,
    keyframe: impl Fn(KeyframeId) -> Option<&'a Keyframe>,
) -> Result<(), LandmarkProblem> {
    ensure(landmark.id <= MAX_ID, LandmarkProblem::Id)?;
    let position: [f64; 3] = landmark.position_in_anchor.into();
    ensure(position.iter().copied().all(is_coordinate), LandmarkProblem::Position { position })?;
    let mut observers = BTreeSet::new();
    for observation in &landmark.observations {
        let id = observation.keyframe;
        let observer = keyframe(id).ok_or(LandmarkProblem::UnknownKeyframe { keyframe: id })?;
        check_observation(info, observer, observation)?;
        ensure(observers.insert(id), LandmarkProblem::ObservedTwice { keyframe: id })?;
    }
    let anchor = landmark.anchor;
    ensure(observers.contains(&anchor), LandmarkProblem::AnchorDoesNotObserve { anchor })
}

fn check_observation(
    info: &MapMetadata,
    keyframe: &Keyframe,
    observation: &Observation,
) -> Result<(), LandmarkProblem> {
    let [u, v] = observation.pixel.map(f64::from);
    let inside = (-0.5..=f64::from(keyframe.camera.width) - 0.5).contains(&u)
        && (-0.5..=f64::from(keyframe.camera.height) - 0.5).contains(&v);
    ensure(inside, LandmarkProblem::PixelOutside { keyframe: keyframe.id, pixel: [u, v] })?;
    let (found, expected) = (observation.descriptor.len(), info.descriptor_width);
    let problem = LandmarkProblem::DescriptorWidth { keyframe: keyframe.id, found, expected };
    ensure(found == usize::from(expected), problem)
}

/// Checks one common error against the keyframe whose it is.
///
/// # Arguments
/// * `expected`: columns of its factor.
fn check_common_error(
    common: &CommonError,
    expected: usize,
    keyframes: &Keyframes<'_>,
) -> Result<(), CommonErrorProblem> {
    let keyframe = keyframes.get(&common.keyframe).ok_or(CommonErrorProblem::UnknownKeyframe)?;
    let found = common.factor.ncols();
    ensure(found == expected, CommonErrorProblem::Columns { found, expected })?;
    check_difference(&keyframe.global_from_keyframe.covariance, &common.covariance_with(common))
        .map_err(CommonErrorProblem::Remaining)
}

/// Checks the aliases of one keyframe against the keyframes that they name.
fn check_aliases(aliases: &KeyframeAliases, keyframes: &Keyframes<'_>) -> Result<(), AliasProblem> {
    let is_known = |keyframe: KeyframeId| {
        ensure(keyframes.contains_key(&keyframe), AliasProblem::UnknownKeyframe { keyframe })
    };
    is_known(aliases.keyframe)?;
    for &Alias { keyframe, log_odds } in &aliases.places {
        is_known(keyframe)?;
        ensure(keyframe != aliases.keyframe, AliasProblem::Itself)?;
        ensure(log_odds.is_finite(), AliasProblem::LogOdds { keyframe, log_odds })?;
    }
    Ok(())
}

/// Checks one cross-covariance against the two keyframes that it names.
fn check_cross_covariance(
    cross: &KeyframeCrossCovariance,
    keyframes: &Keyframes<'_>,
    common: &CommonErrors<'_>,
) -> Result<(), CrossCovarianceProblem> {
    ensure(cross.a != cross.b, CrossCovarianceProblem::SameKeyframe)?;
    let (Some(a), Some(b)) = (keyframes.get(&cross.a), keyframes.get(&cross.b)) else {
        return Err(CrossCovarianceProblem::UnknownKeyframe);
    };
    let together = match (common.get(&cross.a), common.get(&cross.b)) {
        (Some(of_a), Some(of_b)) => of_a.covariance_with(of_b),
        _ => Matrix6::zeros(),
    };
    let joint = joint_covariance(
        &a.global_from_keyframe.covariance,
        &b.global_from_keyframe.covariance,
        &(cross.block + together),
    );
    check_covariance(&joint).map_err(CrossCovarianceProblem::JointCovariance)
}

fn joint_covariance(
    covariance_a: &Matrix6<f64>,
    covariance_b: &Matrix6<f64>,
    block: &Matrix6<f64>,
) -> SMatrix<f64, 12, 12> {
    let mut joint = SMatrix::<f64, 12, 12>::zeros();
    joint.fixed_view_mut::<6, 6>(0, 0).copy_from(covariance_a);
    joint.fixed_view_mut::<6, 6>(6, 6).copy_from(covariance_b);
    joint.fixed_view_mut::<6, 6>(0, 6).copy_from(block);
    joint.fixed_view_mut::<6, 6>(6, 0).copy_from(&block.transpose());
    joint
}

fn is_unit(norm: f64) -> bool {
    (norm - 1.0).abs() <= UNIT_TOLERANCE
}
