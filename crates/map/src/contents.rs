//! A whole map in memory, and the laws that every map keeps.

use std::collections::{BTreeMap, BTreeSet};

use geometry::covariance_check::check_covariance;
use nalgebra::{Matrix6, SMatrix};
use protocol::{KeyframeId, LandmarkId, MAX_EXTRACTOR_BYTES};

use crate::model::{CrossCovariance, Keyframe, Landmark, MapInfo, Observation};

/// How far the norm of a quaternion or of the gravity direction may be from 1.
const UNIT_TOLERANCE: f64 = 1e-6;

/// A map in memory: what import, export and map building work on.
///
/// [`MapContents::sort`] brings it into the one order that a store returns, so two equal maps compare equal.
#[derive(Clone, Debug, PartialEq)]
pub struct MapContents {
    /// What holds for the map as a whole.
    pub info: MapInfo,
    /// All keyframes, by id.
    pub keyframes: Vec<Keyframe>,
    /// All landmarks, by id; the observations of each by keyframe.
    pub landmarks: Vec<Landmark>,
    /// All known cross-covariances, `a < b`, by (a, b).
    pub cross_covariances: Vec<CrossCovariance>,
}

/// A law that a map breaks.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ContentsError {
    /// The map's info is impossible.
    #[error("map info: {0}")]
    Info(String),
    /// A keyframe is impossible.
    #[error("keyframe {id}: {problem}")]
    Keyframe {
        /// Which keyframe.
        id: KeyframeId,
        /// What is wrong with it.
        problem: String,
    },
    /// A landmark is impossible.
    #[error("landmark {id}: {problem}")]
    Landmark {
        /// Which landmark.
        id: LandmarkId,
        /// What is wrong with it.
        problem: String,
    },
    /// A cross-covariance is impossible.
    #[error("cross-covariance of keyframes {a} and {b}: {problem}")]
    CrossCovariance {
        /// Keyframe of the rows.
        a: KeyframeId,
        /// Keyframe of the columns.
        b: KeyframeId,
        /// What is wrong with it.
        problem: String,
    },
}

impl MapContents {
    /// A map without keyframes.
    pub fn empty(info: MapInfo) -> MapContents {
        MapContents { info, keyframes: Vec::new(), landmarks: Vec::new(), cross_covariances: Vec::new() }
    }

    /// Sorts everything by id, the observations of a landmark by keyframe, and cross-covariances to `a < b`.
    pub fn sort(&mut self) {
        self.keyframes.sort_by_key(|keyframe| keyframe.id);
        self.landmarks.sort_by_key(|landmark| landmark.id);
        for landmark in &mut self.landmarks {
            landmark.observations.sort_by_key(|observation| observation.keyframe);
        }
        for cross in &mut self.cross_covariances {
            *cross = cross.ordered();
        }
        self.cross_covariances.sort_by_key(|cross| (cross.a, cross.b));
    }

    /// Leaves out landmarks whose anchor is not there, observations in keyframes that are not there, and
    /// cross-covariances of keyframes that are not there.
    pub(crate) fn drop_dangling(&mut self) {
        let keyframes: BTreeSet<KeyframeId> = self.keyframes.iter().map(|keyframe| keyframe.id).collect();
        self.landmarks.retain(|landmark| keyframes.contains(&landmark.anchor));
        for landmark in &mut self.landmarks {
            landmark.observations.retain(|observation| keyframes.contains(&observation.keyframe));
        }
        self.cross_covariances.retain(|cross| keyframes.contains(&cross.a) && keyframes.contains(&cross.b));
    }

    /// Number of observations over all landmarks.
    pub fn observation_count(&self) -> usize {
        self.landmarks.iter().map(|landmark| landmark.observations.len()).sum()
    }

    /// Checks every law of a map: ids are unique, references exist, numbers are finite, quaternions and gravity
    /// are of unit length, pixels lie in their images, descriptors have the map's width, covariances (of one
    /// keyframe, and of each pair with a cross-covariance) are symmetric and positive semi-definite, and each
    /// landmark is observed by its anchor.
    ///
    /// # Errors
    /// The first [`ContentsError`] in the order info, keyframes, landmarks, cross-covariances.
    pub fn validate(&self) -> Result<(), ContentsError> {
        check_info(&self.info)?;
        let mut keyframes = BTreeMap::new();
        for keyframe in &self.keyframes {
            check_keyframe(&self.info, keyframe)?;
            if keyframes.insert(keyframe.id, keyframe).is_some() {
                let problem = "the id occurs twice".to_owned();
                return Err(ContentsError::Keyframe { id: keyframe.id, problem });
            }
        }
        let mut landmark_ids = BTreeSet::new();
        for landmark in &self.landmarks {
            check_landmark(&self.info, landmark, |id| keyframes.get(&id).copied())?;
            if !landmark_ids.insert(landmark.id) {
                let problem = "the id occurs twice".to_owned();
                return Err(ContentsError::Landmark { id: landmark.id, problem });
            }
        }
        let mut pairs = BTreeSet::new();
        for cross in &self.cross_covariances {
            check_cross_covariance(cross, |id| keyframes.get(&id).copied())?;
            let ordered = cross.ordered();
            if !pairs.insert((ordered.a, ordered.b)) {
                let problem = "the pair occurs twice".to_owned();
                return Err(ContentsError::CrossCovariance { a: cross.a, b: cross.b, problem });
            }
        }
        Ok(())
    }
}

/// Checks what holds for the map as a whole.
pub(crate) fn check_info(info: &MapInfo) -> Result<(), ContentsError> {
    let fail = |problem: String| Err(ContentsError::Info(problem));
    if info.descriptor_width == 0 {
        return fail("descriptors must have at least one byte".to_owned());
    }
    if info.descriptor_kind == protocol::DescriptorKind::Float && !info.descriptor_width.is_multiple_of(4) {
        return fail(format!(
            "a float descriptor of {} bytes is no whole number of f32",
            info.descriptor_width
        ));
    }
    if !(info.sigma_px.is_finite() && info.sigma_px > 0.0) {
        return fail(format!("pixel sigma must be positive, it is {}", info.sigma_px));
    }
    if info.extractor.len() > MAX_EXTRACTOR_BYTES || info.extractor.chars().any(char::is_control) {
        return fail(format!(
            "the extractor's name must be at most {MAX_EXTRACTOR_BYTES} bytes without control characters"
        ));
    }
    if let Some(gravity) = info.gravity_in_global
        && !is_unit(gravity.norm())
    {
        return fail(format!("gravity must be a unit vector, its length is {}", gravity.norm()));
    }
    Ok(())
}

/// Checks one keyframe by itself.
pub(crate) fn check_keyframe(info: &MapInfo, keyframe: &Keyframe) -> Result<(), ContentsError> {
    let fail = |problem: String| Err(ContentsError::Keyframe { id: keyframe.id, problem });
    let pose = &keyframe.global_from_keyframe.pose;
    if !pose.translation.iter().all(|value| value.is_finite()) {
        return fail("its position is not finite".to_owned());
    }
    if !is_unit(pose.rotation.quaternion().norm()) {
        return fail(format!("its quaternion has length {}, not 1", pose.rotation.quaternion().norm()));
    }
    if let Err(error) = keyframe.camera.validate() {
        return fail(format!("its camera is unusable: {error}"));
    }
    let covariance = &keyframe.global_from_keyframe.covariance;
    if let Err(problem) = check_covariance(covariance) {
        return fail(format!("its covariance {problem}"));
    }
    if let Some(features) = &keyframe.features {
        let descriptors = &features.descriptors;
        if descriptors.kind != info.descriptor_kind || descriptors.width != info.descriptor_width {
            return fail("its features have descriptors of another kind or width than the map".to_owned());
        }
        if !features.extractor.is_empty() && features.extractor != info.extractor {
            return fail(format!(
                "its features come from the extractor {:?}, the map says {:?}",
                features.extractor, info.extractor
            ));
        }
        if descriptors.bytes.len() != features.pixels.len() * usize::from(descriptors.width) {
            return fail("the numbers of its features and of their descriptors differ".to_owned());
        }
        if !features.pixels.iter().flatten().all(|value| value.is_finite()) {
            return fail("a feature's pixel is not finite".to_owned());
        }
    }
    Ok(())
}

/// Checks one landmark against the keyframes that it names.
pub(crate) fn check_landmark<'a>(
    info: &MapInfo,
    landmark: &Landmark,
    keyframe_of: impl Fn(KeyframeId) -> Option<&'a Keyframe>,
) -> Result<(), ContentsError> {
    let fail = |problem: String| Err(ContentsError::Landmark { id: landmark.id, problem });
    if !landmark.position_in_anchor.iter().all(|value| value.is_finite()) {
        return fail("its position is not finite".to_owned());
    }
    let mut observers = BTreeSet::new();
    for observation in &landmark.observations {
        let Some(keyframe) = keyframe_of(observation.keyframe) else {
            return fail(format!(
                "it is observed by keyframe {}, which is not in the map",
                observation.keyframe
            ));
        };
        if let Err(problem) = check_observation(info, keyframe, observation) {
            return fail(problem);
        }
        if !observers.insert(observation.keyframe) {
            return fail(format!("keyframe {} observes it twice", observation.keyframe));
        }
    }
    if !observers.contains(&landmark.anchor) {
        return fail(format!("its anchor, keyframe {}, does not observe it", landmark.anchor));
    }
    Ok(())
}

fn check_observation(info: &MapInfo, keyframe: &Keyframe, observation: &Observation) -> Result<(), String> {
    let [u, v] = observation.pixel.map(f64::from);
    let inside = (-0.5..=f64::from(keyframe.camera.width) - 0.5).contains(&u)
        && (-0.5..=f64::from(keyframe.camera.height) - 0.5).contains(&v);
    if !inside {
        return Err(format!("its pixel ({u}, {v}) lies outside the image of keyframe {}", keyframe.id));
    }
    if observation.descriptor.len() != usize::from(info.descriptor_width) {
        return Err(format!(
            "its descriptor in keyframe {} has {} bytes, the map's have {}",
            keyframe.id,
            observation.descriptor.len(),
            info.descriptor_width
        ));
    }
    Ok(())
}

/// Checks one cross-covariance against the two keyframes that it names.
pub(crate) fn check_cross_covariance<'a>(
    cross: &CrossCovariance,
    keyframe_of: impl Fn(KeyframeId) -> Option<&'a Keyframe>,
) -> Result<(), ContentsError> {
    let fail = |problem: String| Err(ContentsError::CrossCovariance { a: cross.a, b: cross.b, problem });
    if cross.a == cross.b {
        return fail("a keyframe's own covariance belongs into the keyframe".to_owned());
    }
    let (Some(a), Some(b)) = (keyframe_of(cross.a), keyframe_of(cross.b)) else {
        return fail("one of them is not in the map".to_owned());
    };
    let joint = joint_covariance(
        &a.global_from_keyframe.covariance,
        &b.global_from_keyframe.covariance,
        &cross.block,
    );
    check_covariance(&joint).or_else(|problem| fail(format!("the joint covariance of the two {problem}")))
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
