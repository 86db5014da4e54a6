//! How much of a map looks like other parts of it: its perceptual aliasing.
//!
//! A picture that repeats is in the map more than once, or it is in the map once and in a part of the building that the map
//! does not know. What repeats within the map tells how often the second happens: a keyframe is localized in the map with all
//! keyframes left out that share landmarks with it, and what is found is another place that looks alike.

use std::sync::OnceLock;

use geometry::{Pose, PoseWithCovariance};
use map::{Alias, KeyframeAliases};
use protocol::{Descriptors, FeatureSet, KeyframeId};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::consensus::{agree_by, group_places};
use crate::loaded_map::LoadedMap;
use crate::options::RecognitionOptions;
use crate::query::QueryError;
use crate::report::Hypothesis;
use crate::verification::{Image, VerifiedKeyframe};

/// Keyframes that are compared with the rest of the map, at most, evenly among all.
const SAMPLED_KEYFRAMES: usize = 24;
/// Keyframes that each of them is compared with: one that looks like it is among those of the most votes.
const COMPARED_KEYFRAMES: usize = 4;
/// A pose this far from that of the keyframe is another place, as a part of the map's viewing distance, or as an angle (rad).
/// Nearer ones are the keyframe itself, by landmarks that the map has twice.
pub(crate) const OTHER_PLACE: f64 = 0.1;
/// Shape of the prior of the rate, a beta distribution with two equal ones (Jeffreys).
const PRIOR_SHAPE: f64 = 0.5;
/// Part of a map's keyframes that may be others than those of the version whose rate was measured.
const RENEWED_KEYFRAMES: f64 = 0.1;
/// Chance that what an image shows of a place has been carried elsewhere since the map was built, or is a copy of it that stands
/// where the map has not been: a map cannot tell.
const MOVED: f64 = 0.15;

/// How many of the views of a map could be taken for another place of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct AliasingRate {
    /// Views that were compared with the rest of the map. Neighbouring keyframes see the same: those count as one.
    pub views: f64,
    /// Those that another place explains as well.
    pub aliased: f64,
    /// Part of the map's keyframes that are others than those of the version that was measured, at most.
    #[serde(default)]
    renewed: f64,
}

impl AliasingRate {
    /// Chance that a view can be taken for another place: that something of it was moved, or that it repeats, in the mean of what
    /// the counts leave possible.
    pub fn chance(&self) -> f64 {
        let repeats = (self.aliased + PRIOR_SHAPE) / (self.views + 2.0 * PRIOR_SHAPE);
        MOVED + (1.0 - MOVED) * repeats
    }

    /// Part of the views that could be taken for another place.
    pub fn part_aliased(&self) -> f64 {
        if self.views > 0.0 { self.aliased / self.views } else { 0.0 }
    }

    /// Natural logarithm of the odds of the right place over one that looks alike, before an image is seen.
    pub fn log_odds(&self) -> f64 {
        -self.chance().ln()
    }
}

impl LoadedMap {
    /// How many of the map's views could be taken for another place of it. Of a map that does not state its aliases it is
    /// measured with the first call, which takes some tenths of a second.
    pub fn aliasing_rate(&self) -> AliasingRate {
        *self.aliasing.get_or_init(|| self.measure_aliasing())
    }

    /// Measures the rates of all kinds of features that are not known yet, so that no query waits for it.
    pub fn measure_aliasing_rates(&self) {
        for map in self.kinds() {
            map.aliasing_rate();
        }
    }

    /// Takes the rate of a former version of the map where this one does not state its own and has the same keyframes, but for a
    /// few, as the version that the rate was measured of. Without effect once the rate is known.
    pub fn keep_aliasing_rate(&self, former: &LoadedMap) {
        if self.identity != former.identity {
            return;
        }
        // Of the larger version. It is a metric: from version to version it adds up to no less than what it is between the ends.
        let most = self.poses.keyframes.len().max(former.poses.keyframes.len());
        let kept =
            self.poses.keyframes.iter().filter(|keyframe| former.index_of(keyframe.id).is_some()).count();
        let renewed = (most - kept) as f64 / most.max(1) as f64;
        for map in self.kinds() {
            let same_kind = former.kinds().find(|of| of.info.feature_kind() == map.info.feature_kind());
            let Some(rate) = same_kind.and_then(|of| of.aliasing.get()) else { continue };
            let rate = AliasingRate { renewed: rate.renewed + renewed, ..*rate };
            if rate.renewed <= RENEWED_KEYFRAMES {
                let _ = map.aliasing.set(rate);
            }
        }
    }

    /// Takes the aliases that a map states, and the rate from them where it does so for most of its keyframes.
    ///
    /// # Arguments
    /// * `stated`: by keyframe.
    pub(crate) fn set_aliases(&mut self, mut stated: Vec<KeyframeAliases>) {
        stated.retain(|aliases| self.index_of(aliases.keyframe).is_some());
        let compared = stated.len();
        stated.retain(|aliases| !aliases.places.is_empty());
        if compared > 0 && 2 * compared >= self.poses.keyframes.len() {
            let is_aliased = |aliases: &&KeyframeAliases| likely_alias(aliases).is_some();
            let aliased = stated.iter().filter(is_aliased).count() as f64 / compared as f64;
            let views = self.disjoint_views();
            self.aliasing = OnceLock::from(AliasingRate { views, aliased: aliased * views, renewed: 0.0 });
        }
        self.aliases = stated;
    }

    /// The places that the map states a keyframe could be taken for.
    pub fn stated_aliases(&self, keyframe: KeyframeId) -> &[Alias] {
        let found = self.aliases.binary_search_by_key(&keyframe, |aliases| aliases.keyframe);
        found.map_or(&[], |at| &self.aliases[at].places)
    }

    /// How often what one keyframe sees fits into the map.
    fn disjoint_views(&self) -> f64 {
        let observations = self.observation_count();
        if observations == 0 {
            return 0.0;
        }
        (self.landmark_count() * self.poses.keyframes.len()) as f64 / observations as f64
    }

    fn measure_aliasing(&self) -> AliasingRate {
        if self.observation_count() == 0 {
            return AliasingRate::default();
        }
        let options = alias_options();
        let count = self.poses.keyframes.len().min(SAMPLED_KEYFRAMES);
        let is_aliased = |sample: usize| {
            let keyframe = sample * self.poses.keyframes.len() / count;
            let found = self.places_like(keyframe, &options).unwrap_or_default();
            found.iter().any(|place| place.log_odds >= options.min_log_odds)
        };
        let aliased = (0..count).filter(|&sample| is_aliased(sample)).count() as f64;
        let views = self.disjoint_views().min(count as f64);
        AliasingRate { views, aliased: aliased / count as f64 * views, renewed: 0.0 }
    }

    /// The places that the image of a keyframe could be taken for, besides its own; their odds are by the image alone. None
    /// where the map has no such keyframe.
    ///
    /// # Errors
    /// [`QueryError`] where the map's descriptors cannot be compared.
    pub fn keyframe_aliases(&self, keyframe: KeyframeId) -> Result<KeyframeAliases, QueryError> {
        let own = self.index_of(keyframe);
        let mut places = own.map_or(Ok(Vec::new()), |at| self.places_like(at, &alias_options()))?;
        places.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
        Ok(KeyframeAliases { keyframe, places })
    }

    fn places_like(&self, own: usize, options: &RecognitionOptions) -> Result<Vec<Alias>, QueryError> {
        let observed = self.observations.of(own);
        let features = FeatureSet {
            pixels: observed.pixels.to_vec(),
            descriptors: Descriptors {
                kind: self.info.descriptor_kind,
                width: self.info.descriptor_width,
                bytes: observed.descriptors.to_vec(),
            },
            extractor: self.info.extractor.clone(),
        };
        let global_from_camera = &self.poses.keyframes[own].global_from_keyframe;
        let gravity = self.info.gravity_in_global;
        let image = Image {
            camera: &self.poses.keyframes[own].camera,
            features: &features,
            descriptors: self.view(&features)?,
            gravity_in_camera: gravity
                .map(|gravity| global_from_camera.pose.rotation.inverse_transform_vector(&gravity)),
        };
        let mut sees_the_same = vec![false; self.poses.keyframes.len()];
        sees_the_same[own] = true;
        for &landmark in observed.landmarks {
            for &observer in self.landmarks.observers.of(landmark as usize) {
                sees_the_same[observer as usize] = true;
            }
        }
        let mut verified = self.verified_keyframes(&image, |at| !sees_the_same[at], options)?;
        verified.retain(|found| self.is_another_place(own, found, options));
        let places = group_places(self, &mut verified, options);
        let hypotheses = self.hypotheses(&image, &verified, &places, 0.0);
        let alias = |(members, place): (&Vec<usize>, &Hypothesis)| Alias {
            keyframe: self.poses.keyframes[verified[members[0]].keyframe].id,
            log_odds: place.log_odds(),
        };
        Ok(places.iter().zip(&hypotheses).map(alias).collect())
    }

    /// Whether what was found for the image of a keyframe is not its own pose.
    fn is_another_place(&self, own: usize, found: &VerifiedKeyframe, options: &RecognitionOptions) -> bool {
        let own_pose = &self.poses.keyframes[own].global_from_keyframe.pose;
        let difference = own_pose.inverse().compose(&found.global_from_camera.pose);
        let is_far = difference.translation.norm() > OTHER_PLACE * self.viewing_distance()
            || difference.rotation.angle() > OTHER_PLACE;
        let itself = PoseWithCovariance::exact(Pose::identity());
        is_far && !agree_by(self, &(own, itself), &(found.keyframe, found.keyframe_from_camera), options)
    }
}

/// The place that the image of a keyframe is taken for most easily, where its odds are enough for an answer.
pub fn likely_alias(aliases: &KeyframeAliases) -> Option<&Alias> {
    let strongest = aliases.places.iter().max_by(|a, b| a.log_odds.total_cmp(&b.log_odds));
    strongest.filter(|place| place.log_odds >= RecognitionOptions::default().min_log_odds)
}

/// How keyframes are compared with the rest of the map.
fn alias_options() -> RecognitionOptions {
    RecognitionOptions { candidates: COMPARED_KEYFRAMES, ..RecognitionOptions::default() }
}

/// Writes a rate, if it was measured already.
pub(crate) fn serialize<S: Serializer>(
    rate: &OnceLock<AliasingRate>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    rate.get().serialize(serializer)
}

/// Reads what [`serialize`] wrote.
pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<OnceLock<AliasingRate>, D::Error> {
    let rate: Option<AliasingRate> = Option::deserialize(deserializer)?;
    Ok(rate.map_or_else(OnceLock::new, OnceLock::from))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use map::edit::remove_keyframes;
    use testing::{Place, PlaceOptions};

    use super::*;

    #[test]
    fn a_rate_is_kept_until_a_tenth_of_the_keyframes_are_others_than_when_it_was_measured() {
        let options = PlaceOptions { keyframes: 40, landmarks: 100, ..PlaceOptions::default() };
        let mut contents = Place::new(&options).map;
        let measured = AliasingRate { views: 8.0, aliased: 3.0, renewed: 0.0 };
        let mut former = LoadedMap::from_contents(contents.clone()).unwrap();
        former.aliasing.set(measured).unwrap();
        for removed in 1..=4 {
            let last = contents.keyframes.last().unwrap().id;
            remove_keyframes(&mut contents, &BTreeSet::from([last]));
            let version = LoadedMap::from_contents(contents.clone()).unwrap();
            version.keep_aliasing_rate(&former);
            let kept = version.aliasing.get();
            assert_eq!(kept.is_some(), removed < 4, "{removed}: {kept:?}");
            assert!(kept.is_none_or(|rate| (rate.log_odds() - measured.log_odds()).abs() < 1e-12));
            former = version;
        }
    }

    #[test]
    fn the_more_distinctive_views_the_better_the_odds() {
        let of = |views: f64, aliased: f64| AliasingRate { views, aliased, renewed: 0.0 }.log_odds();
        assert!((0.0..2_f64.ln()).contains(&of(0.0, 0.0)));
        assert!((1..32).all(|views| of(f64::from(views), 0.0) > of(f64::from(views - 1), 0.0)));
        assert!((0..32).all(|aliased| of(32.0, f64::from(aliased)) > of(32.0, f64::from(aliased + 1))));
        assert!((0.0..0.05).contains(&of(32.0, 32.0)));
        assert!(of(1e9, 0.0) < -MOVED.ln());
    }
}
