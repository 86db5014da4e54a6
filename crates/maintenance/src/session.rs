//! One session worked into a map.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use map::{Keyframe, Landmark, MapContents, edit};
use mapping::{
    BuildOptions, ExtendError, ExtensionReport, Former, LocatedErrors, MAX_SIGMA_PX, MapPoses, PartShown,
    Progress, SearchedMap, Stage, check_new_recording, extend_map, extend_part, find_aliases_of_independent,
    located_errors, part_shown, put_back, run_odometry,
};
use protocol::{FeatureSet, KeyframeId, LandmarkId};
use sensors::Sequence;
use statrs::distribution::{ChiSquared, ContinuousCDF as _};

use crate::coverage::surplus;
use crate::drive::Drive;
use crate::gone::{remove_gone, remove_gone_of_added_kinds, update_existence};
use crate::refusal::Refusal;
use crate::report::{RemovedKeyframes, SessionReport};
use crate::settings::Settings;
use crate::sightings::sightings;

/// A session contradicts the map where what it sees is less likely than this.
const CONFIDENCE: f64 = 0.9999;

/// Keyframes whose place looks like no other one, at least, that locate a session where most of what it shows repeats.
const LEAST_TOLD_APART: usize = 3;
/// A map repeats where another place explains this part of its views, or more. A drive through an aisle that was never mapped and looks like
/// mapped ones agrees with one of these everywhere, so that in such a map some of its places must look like no other one. The
/// session of a rendered warehouse that was hardest to locate had seven of them.
const REPEATING: f64 = 0.2;

/// Which maps are worked on in parts, and how large these are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PartSizes {
    /// Maps with more keyframes are worked on in the part that the session shows.
    pub(crate) large: usize,
    /// Keyframes of such a part, at least and at most; between them, [`PART_KEYFRAMES_AN_IMAGE`].
    pub(crate) keyframes: [usize; 2],
}

pub(crate) const PART_SIZES: PartSizes = PartSizes { large: 400, keyframes: [300, 600] };
/// Keyframes of a part for each image of the session that has features.
const PART_KEYFRAMES_AN_IMAGE: usize = 3;

/// Works a session into a map.
///
/// In a large map, what it costs depends on the part of the map that the session shows, but for the search for that part.
///
/// # Arguments
/// * `map`: whole and valid, sorted, in a frame with z up. Becomes its next version, with the session in its ledger, also where none of its
///   keyframes stays.
/// * `sequence`: the session, with features as the map's; a session that a robot handed in, or a recording.
/// * `build`: its robot and identity, for the ledger.
/// * `progress`: called with the stage and its steps.
///
/// # Errors
/// [`Refusal`]: the session is not used, and the map remains as it was.
pub fn take_session(
    map: &mut MapContents,
    sequence: &mut Sequence,
    build: &BuildOptions,
    settings: &Settings,
    progress: Progress<'_>,
) -> Result<SessionReport, Refusal> {
    take_session_by_parts(map, sequence, build, settings, PART_SIZES, progress)
}

/// [`take_session`] with other sizes of parts.
pub(crate) fn take_session_by_parts(
    map: &mut MapContents,
    sequence: &mut Sequence,
    build: &BuildOptions,
    settings: &Settings,
    sizes: PartSizes,
    progress: Progress<'_>,
) -> Result<SessionReport, Refusal> {
    // Odometry would take minutes to get to the same.
    check_new_recording(&map.info, sequence, build)?;
    let mut work = Work { sequence, build, settings, progress };
    if map.keyframes.len() <= sizes.large {
        let Taken { mut contents, report, .. } = work.take(map, None)?;
        remove_gone_of_added_kinds(&mut contents, &report.gone_m);
        contents.count_sessions();
        contents.info.sigma_px = contents.info.covering_sigma_px();
        contents.validate()?;
        *map = contents;
        return Ok(report);
    }
    let images: usize = work.sequence.frames.iter().map(|frame| frame.features.len()).sum();
    let [least, most] = sizes.keyframes;
    let count = (PART_KEYFRAMES_AN_IMAGE * images).clamp(least, most);
    let PartShown { keyframes, whole } = part_shown(map, work.sequence, count, work.progress)?;
    let mut part = edit::part_of(map, &keyframes);
    // The ids of new keyframes come after all of the map's, also where it has no ledger.
    part.info.sessions = map.sessions_or_one(&map.info.name);
    let Taken { contents, errors, lost, mut report } =
        work.take(&part, Some(Whole { map, part: &keyframes, searched: whole }))?;
    contents.validate()?;
    let former = Former::of(map, &part, &contents);
    put_back(map, &part, contents, &lost, errors);
    match complete(map, &report, work.progress) {
        Ok(()) => {
            (report.keyframes, report.landmarks) = (map.keyframes.len(), map.landmarks.len());
            Ok(report)
        }
        Err(refusal) => {
            former.restore(map);
            Err(refusal)
        }
    }
}

/// Completes a map that a part was put back into, and checks it.
fn complete(map: &mut MapContents, report: &SessionReport, progress: Progress<'_>) -> Result<(), Refusal> {
    map.info.sigma_px = map.info.covering_sigma_px();
    remove_gone_of_added_kinds(map, &report.gone_m);
    if report.kept_keyframes > 0 {
        find_aliases_of_independent(map, progress).map_err(ExtendError::from)?;
    }
    Ok(map.validate()?)
}

/// What a session makes of a map, or of a part of it.
struct Taken {
    /// Sorted.
    contents: MapContents,
    /// Of the new keyframes, in a larger map.
    errors: LocatedErrors,
    /// Landmarks that were taken out, new ones among them.
    lost: BTreeSet<LandmarkId>,
    report: SessionReport,
}

/// The map that a session is worked into a part of.
struct Whole<'a> {
    map: &'a MapContents,
    /// The keyframes of the part.
    part: &'a BTreeSet<KeyframeId>,
    searched: SearchedMap,
}

/// A session that is to be worked into a map.
struct Work<'a, 'p> {
    sequence: &'a mut Sequence,
    build: &'a BuildOptions,
    settings: &'a Settings,
    progress: Progress<'p>,
}

impl Work<'_, '_> {
    /// Works the session into a map.
    ///
    /// # Arguments
    /// * `whole`: what it is a part of.
    fn take(&mut self, map: &MapContents, whole: Option<Whole<'_>>) -> Result<Taken, Refusal> {
        let (settings, progress) = (self.settings, &mut *self.progress);
        let cameras = self.sequence.cameras.len();
        let odometry =
            run_odometry(self.sequence, cameras, |done, all| progress(Stage::Odometry, done, all))?;
        let mut build = self.build.clone();
        build.map_poses = MapPoses::Considered;
        build.sigma_px = None;
        let sequence = &*self.sequence;
        let (searched, whole) = whole.map(|of| (of.searched, (of.map, of.part))).unzip();
        let (mut contents, extension) = match searched {
            Some(searched) => extend_part(map, searched, sequence, &odometry, &build, progress)?,
            None => extend_map(map, sequence, &odometry, None, &build, progress)?,
        };
        check_consistency(map, &extension, settings)?;
        let Some(ids) = ids_of_new(map, &contents) else { return Err(Refusal::NothingLeft) };
        let errors = whole.map(|(whole, part)| located_errors(whole, part, &contents));
        let errors = errors.unwrap_or_else(|| Some(LocatedErrors::default()));
        let errors = errors.ok_or(ExtendError::Indefinite)?;
        let added = contents.info.sessions.last();
        let stamp_ns = added.map_or(0, |session| session.end_ns);
        let drive = added.map(|session| Drive::of(session, &contents.info.sessions)).unwrap_or_default();
        let features = features_of(&contents, &extension.cameras, sequence);
        let sightings = sightings(&contents, &ids, &features);
        let detection_rates = update_existence(&mut contents, &sightings, &ids, stamp_ns, &drive, settings);
        let removed = remove_gone(&mut contents, settings);
        let outside = whole.map(|(whole, part)| observed_outside(whole, part)).unwrap_or_default();
        let surplus = surplus(&contents, &ids, &outside, stamp_ns, settings);
        let all: BTreeSet<KeyframeId> = surplus.replaced.union(&surplus.unused).copied().collect();
        edit::remove_keyframes(&mut contents, &all);
        contents.landmarks.retain(|landmark| !surplus.landmarks.contains(&landmark.id));
        contents.drop_existence_of_others();
        if contents.keyframes.is_empty() {
            return Err(Refusal::NothingLeft);
        }
        contents.sort();
        let of_map = |removed: &BTreeSet<KeyframeId>| removed.iter().filter(|id| !ids.contains(id)).count();
        let kept = contents.keyframes.iter().filter(|keyframe| ids.contains(&keyframe.id));
        let report = SessionReport {
            kept_keyframes: kept.count(),
            session_keyframes: extension.new_keyframes,
            agreeing_places: extension.agreeing_places,
            map_ratio: extension.map_chi_square / extension.map_freedom,
            sigma_px: extension.sigma_px,
            seen: sightings.iter().filter(|sighting| sighting.seen).count(),
            missed: sightings.iter().filter(|sighting| !sighting.seen).count(),
            detection_rates,
            gone_m: removed.positions_m,
            surplus_landmarks: surplus.landmarks.len(),
            removed: RemovedKeyframes {
                gone: of_map(&removed.keyframes),
                replaced: of_map(&surplus.replaced),
                unused: of_map(&surplus.unused),
            },
            keyframes: contents.keyframes.len(),
            landmarks: contents.landmarks.len(),
        };
        let lost = removed.landmarks.into_iter().chain(surplus.landmarks).collect();
        Ok(Taken { contents, errors, lost, report })
    }
}

/// All features of the images that became keyframes.
///
/// # Arguments
/// * `contents`: with the keyframes of the session.
/// * `cameras`: the camera of each of these.
fn features_of<'a>(
    contents: &MapContents,
    cameras: &BTreeMap<KeyframeId, usize>,
    sequence: &'a Sequence,
) -> BTreeMap<KeyframeId, &'a FeatureSet> {
    let features = |keyframe: &Keyframe| {
        let camera = cameras.get(&keyframe.id)?;
        let stamp_ns = keyframe.stamp_ns;
        let at = sequence.frames.binary_search_by_key(&stamp_ns, |frame| frame.stamp_ns).ok()?;
        Some((keyframe.id, sequence.frames[at].features.get(camera)?))
    };
    contents.keyframes.iter().filter_map(features).collect()
}

/// The landmarks of a map that keyframes outside of a part observe.
fn observed_outside(map: &MapContents, part: &BTreeSet<KeyframeId>) -> BTreeSet<LandmarkId> {
    let is_outside =
        |landmark: &&Landmark| landmark.observations.iter().any(|seen| !part.contains(&seen.keyframe));
    map.landmarks.iter().filter(is_outside).map(|landmark| landmark.id).collect()
}

/// The ids of the keyframes that a map has beyond those of another one.
fn ids_of_new(before: &MapContents, after: &MapContents) -> Option<RangeInclusive<KeyframeId>> {
    let known: BTreeSet<KeyframeId> = before.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let new = || after.keyframes.iter().map(|keyframe| keyframe.id).filter(|id| !known.contains(id));
    Some(new().min()?..=new().max()?)
}

/// Checks that the places of the map that a session shows agree with its trajectory: most of all, of which in a map that repeats some look like
/// no other one, or most of those that do. Where a place repeats, a drive that begins beyond the map looks like the map wherever that looks alike.
fn check_places(extension: &ExtensionReport, settings: &Settings) -> Result<(), Refusal> {
    let ExtensionReport {
        places, agreeing_places, places_told_apart, agreeing_told_apart, repeating, ..
    } = *extension;
    let wanted = |found: usize| (settings.min_agreeing * found as f64).ceil() as usize;
    let of_told_apart = wanted(places_told_apart).max(LEAST_TOLD_APART);
    if agreeing_told_apart >= of_told_apart {
        return Ok(());
    }
    if agreeing_places >= wanted(places) {
        let may_be_elsewhere = repeating >= REPEATING && agreeing_told_apart < LEAST_TOLD_APART;
        let (agreeing, told_apart, least) = (agreeing_places, agreeing_told_apart, LEAST_TOLD_APART);
        return if may_be_elsewhere {
            Err(Refusal::Repeating { repeating, agreeing, told_apart, least })
        } else {
            Ok(())
        };
    }
    if places_told_apart >= 2 * LEAST_TOLD_APART {
        return Err(Refusal::Places {
            found: places_told_apart,
            agreeing: agreeing_told_apart,
            wanted: of_told_apart,
        });
    }
    Err(Refusal::OtherPlace(Box::new(ExtendError::NotConnected {
        keyframes: extension.new_keyframes,
        found: places,
        told_apart: places_told_apart,
        agreeing: agreeing_places,
        wanted: wanted(places),
    })))
}

/// Checks that a session agrees with the map, as far as both state it.
///
/// Its pixels are compared with those of the session that the map began with, not with the noise that the map states: that covers the noisiest
/// session of which there are keyframes, so that each could let in one that is noisier by the same factor again.
fn check_consistency(
    map: &MapContents,
    extension: &ExtensionReport,
    settings: &Settings,
) -> Result<(), Refusal> {
    check_places(extension, settings)?;
    let sigma_px = extension.sigma_px;
    let map_px = map.info.first_sigma_px();
    let limit = settings.max_pixel_ratio * map_px;
    // More is not estimated: the largest may stand for any noise.
    let is_at_limit = sigma_px >= MAX_SIGMA_PX && map_px < MAX_SIGMA_PX;
    if sigma_px > limit || is_at_limit {
        return Err(Refusal::Pixels { sigma_px, map_px, limit });
    }
    let (chi_square, freedom) = (extension.map_chi_square, extension.map_freedom);
    let quantile = ChiSquared::new(freedom).map_or(0.0, |distribution| distribution.inverse_cdf(CONFIDENCE));
    let limit = quantile.max(settings.max_map_ratio * freedom);
    if chi_square > limit {
        return Err(Refusal::Moved { chi_square, freedom, limit });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use testing::{Place, PlaceOptions};

    use super::*;

    /// Half of the places of a map are like another one.
    #[test]
    fn in_a_map_that_repeats_some_places_must_look_like_no_other_one() {
        let mut extension = ExtensionReport::default();
        extension.new_keyframes = 30;
        (extension.places, extension.agreeing_places) = (20, 20);
        let mut judged = |repeating: f64, told_apart: usize| {
            extension.repeating = repeating;
            (extension.places_told_apart, extension.agreeing_told_apart) = (told_apart, told_apart);
            check_places(&extension, &Settings::default())
        };
        judged(0.0, 0).unwrap();
        judged(0.1, 1).unwrap();
        judged(0.5, 3).unwrap();
        let refusal = judged(0.5, 2).unwrap_err();
        assert_eq!(refusal.kind(), Refusal::OTHER_PLACE);
        assert!(refusal.to_string().contains("50 %"), "{refusal}");
    }

    /// A session of 30 keyframes.
    fn judged(places: usize, agreeing: usize, told_apart: usize, of_them: usize) -> Result<(), Refusal> {
        let mut extension = ExtensionReport::default();
        extension.new_keyframes = 30;
        extension.places = places;
        extension.agreeing_places = agreeing;
        extension.places_told_apart = told_apart;
        extension.agreeing_told_apart = of_them;
        check_places(&extension, &Settings::default())
    }

    #[test]
    fn places_that_repeat_say_nothing_against_a_session() {
        judged(20, 10, 0, 0).unwrap();
        judged(20, 7, 6, 6).unwrap();
        judged(20, 4, 3, 3).unwrap();
        for [agreeing, told_apart, of_them] in [[3, 2, 2], [9, 0, 0], [3, 5, 2]] {
            let refusal = judged(20, agreeing, told_apart, of_them).unwrap_err();
            assert_eq!(refusal.kind(), "other-place", "{refusal}");
            assert!(!refusal.to_string().contains("calibration"), "{refusal}");
        }
    }

    /// A session of some noise, to a map that began with one of `first_px` and states 2.9 px since another one came.
    fn judged_by_pixels(first_px: f64, sigma_px: f64) -> Result<(), Refusal> {
        let mut map =
            Place::new(&PlaceOptions { keyframes: 4, landmarks: 20, ..PlaceOptions::default() }).map;
        map.ensure_sessions("first");
        map.info.sessions[0].sigma_px = Some(first_px);
        map.info.sigma_px = 2.9;
        let mut extension = ExtensionReport::default();
        extension.sigma_px = sigma_px;
        check_consistency(&map, &extension, &Settings::default())
    }

    #[test]
    fn a_noisy_session_lets_no_noisier_one_in() {
        judged_by_pixels(1.0, 2.9).unwrap();
        let refusal = judged_by_pixels(1.0, 3.1).unwrap_err();
        assert!(matches!(refusal, Refusal::Pixels { map_px: 1.0, .. }), "{refusal}");
        // It may be of any noise.
        judged_by_pixels(2.0, 4.9).unwrap();
        assert!(judged_by_pixels(2.0, MAX_SIGMA_PX).is_err());
        judged_by_pixels(MAX_SIGMA_PX, MAX_SIGMA_PX).unwrap();
    }

    #[test]
    fn places_that_look_like_no_other_one_contradict_a_session() {
        let refusal = judged(20, 5, 15, 5).unwrap_err();
        assert_eq!(refusal.kind(), "contradiction");
        assert!(
            refusal.to_string().contains("15") && refusal.to_string().contains("at least 8"),
            "{refusal}"
        );
    }
}
