//! A whole map in memory, and the invariants that every map satisfies.

mod added_validation;
mod digest;
mod error;
mod observation_counts;
mod sorted;
mod validation;

use std::collections::{BTreeMap, BTreeSet};

use geometry::Pose;
use nalgebra::Vector3;
use protocol::{KeyframeId, LandmarkId};

pub use added_validation::validate_added_landmark;
pub(crate) use digest::RunningDigest;
pub use error::{
    AddedFeaturesProblem, AliasProblem, CommonErrorProblem, ContentsError, CrossCovarianceProblem,
    ExistenceProblem, ImageProblem, KeyframeProblem, LandmarkProblem, MetadataProblem,
};
pub use observation_counts::ObservationCounts;
pub(crate) use sorted::Sorted;
pub use validation::validate_landmark;

use crate::added::{AddedFeatures, FeatureKind, KeptImage};
use crate::file::{EXTENDED_STORE_SCHEMA, STORE_SCHEMA};
use crate::model::{
    CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark, LandmarkExistence, MapMetadata,
};

/// A map in memory: what import, export and map building work on.
///
/// [`MapContents::sort`] brings it into the order in which a store returns it, so that two equal maps compare equal.
///
/// # Example
/// ```
/// use map::{MapContents, MapMetadata};
/// use protocol::DescriptorKind;
///
/// let contents = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// contents.validate()?;
/// assert_eq!(contents.observation_count(), 0);
/// # Ok::<(), map::ContentsError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct MapContents {
    /// What applies to the map as a whole.
    pub info: MapMetadata,
    /// All keyframes, by id.
    pub keyframes: Vec<Keyframe>,
    /// All landmarks, by id; the observations of each by keyframe.
    pub landmarks: Vec<Landmark>,
    /// All known cross-covariances, `a < b`, by (a, b).
    pub cross_covariances: Vec<KeyframeCrossCovariance>,
    /// Parts of the common error, by keyframe; zero for those without one.
    pub common_errors: Vec<CommonError>,
    /// Which other places keyframes could be taken for, by keyframe; of those without an entry, it is not known.
    pub aliases: Vec<KeyframeAliases>,
    /// Features of further kinds in the same keyframes.
    pub added_features: Vec<AddedFeatures>,
    /// Images of keyframes, by keyframe; of those without one, none was kept.
    pub images: Vec<KeptImage>,
    /// Whether landmarks are still there, by landmark; those without an entry were never expected since they entered the map.
    pub existence: Vec<LandmarkExistence>,
}

impl MapContents {
    /// A map without keyframes.
    pub fn empty(info: MapMetadata) -> MapContents {
        MapContents {
            info,
            keyframes: Vec::new(),
            landmarks: Vec::new(),
            cross_covariances: Vec::new(),
            common_errors: Vec::new(),
            aliases: Vec::new(),
            added_features: Vec::new(),
            images: Vec::new(),
            existence: Vec::new(),
        }
    }

    /// The kinds of features of the map, the primary one first.
    pub fn feature_kinds(&self) -> impl Iterator<Item = FeatureKind> {
        let added = self.added_features.iter().map(|added| added.kind.clone());
        std::iter::once(self.info.feature_kind()).chain(added)
    }

    /// The kinds of features with their landmarks, the primary one first.
    pub fn landmarks_of_kinds(&self) -> impl Iterator<Item = (FeatureKind, &[Landmark])> {
        let added = self.added_features.iter().map(|added| added.landmarks.as_slice());
        self.feature_kinds().zip(std::iter::once(self.landmarks.as_slice()).chain(added))
    }

    /// The layout in which the map is stored: that of older programs where it has features of one kind and no images.
    pub fn store_schema(&self) -> u16 {
        let is_extended = !self.added_features.is_empty() || !self.images.is_empty();
        if is_extended { EXTENDED_STORE_SCHEMA } else { STORE_SCHEMA }
    }

    /// The poses of the keyframes.
    pub fn keyframe_poses(&self) -> BTreeMap<KeyframeId, Pose> {
        self.keyframes.iter().map(|keyframe| (keyframe.id, keyframe.global_from_keyframe.pose)).collect()
    }

    /// The landmarks with their positions in G (m); without those whose anchor is missing, which no valid map has.
    pub fn landmarks_in_global(&self) -> impl Iterator<Item = (&Landmark, Vector3<f64>)> {
        let poses = self.keyframe_poses();
        self.landmarks.iter().filter_map(move |landmark| {
            Some((landmark, poses.get(&landmark.anchor)?.transform(&landmark.position_in_anchor)))
        })
    }

    /// Sorts everything by id, the observations of a landmark by keyframe, and cross-covariances to `a < b`.
    pub fn sort(&mut self) {
        self.keyframes.sort_by_key(|keyframe| keyframe.id);
        for landmarks in self.landmarks_of_kinds_mut() {
            landmarks.sort_by_key(|landmark| landmark.id);
            for landmark in landmarks {
                landmark.observations.sort_by_key(|observation| observation.keyframe);
            }
        }
        for cross in &mut self.cross_covariances {
            *cross = cross.ordered();
        }
        self.cross_covariances.sort_by_key(|cross| (cross.a, cross.b));
        self.common_errors.sort_by_key(|common| common.keyframe);
        self.aliases.sort_by_key(|aliases| aliases.keyframe);
        self.existence.sort_by_key(|existence| existence.landmark);
        self.images.sort_by_key(|image| image.keyframe);
    }

    /// The landmarks of all kinds of features, those of the primary kind first.
    pub(crate) fn landmarks_of_kinds_mut(&mut self) -> impl Iterator<Item = &mut Vec<Landmark>> {
        let added = self.added_features.iter_mut().map(|added| &mut added.landmarks);
        std::iter::once(&mut self.landmarks).chain(added)
    }

    /// Removes landmarks whose anchor is missing, observations in missing keyframes, and cross-covariances, common errors, aliases and
    /// images of missing keyframes, and the existence of missing landmarks.
    pub(crate) fn drop_dangling(&mut self) {
        let keyframes: BTreeSet<KeyframeId> = self.keyframes.iter().map(|keyframe| keyframe.id).collect();
        for landmarks in self.landmarks_of_kinds_mut() {
            landmarks.retain(|landmark| keyframes.contains(&landmark.anchor));
            for landmark in landmarks {
                landmark.observations.retain(|observation| keyframes.contains(&observation.keyframe));
            }
        }
        self.images.retain(|image| keyframes.contains(&image.keyframe));
        self.cross_covariances.retain(|cross| keyframes.contains(&cross.a) && keyframes.contains(&cross.b));
        self.common_errors.retain(|common| keyframes.contains(&common.keyframe));
        self.aliases.retain(|aliases| keyframes.contains(&aliases.keyframe));
        for aliases in &mut self.aliases {
            aliases.places.retain(|place| keyframes.contains(&place.keyframe));
        }
        self.drop_existence_of_others();
    }

    /// Removes the existence of landmarks that the map does not have.
    pub fn drop_existence_of_others(&mut self) {
        let landmarks: BTreeSet<LandmarkId> = self.landmarks.iter().map(|landmark| landmark.id).collect();
        self.existence.retain(|existence| landmarks.contains(&existence.landmark));
    }

    /// Number of observations over all landmarks of the primary kind.
    pub fn observation_count(&self) -> usize {
        self.landmarks.iter().map(|landmark| landmark.observations.len()).sum()
    }
}
