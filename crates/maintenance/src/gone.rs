//! What is gone: the landmarks that no longer exist by what sessions saw, and the keyframes that show too little of what is left.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use map::{Landmark, LandmarkExistence, MapContents, edit};
use mapping::BuildReport;
use nalgebra::Vector3;
use protocol::{KeyframeId, LandmarkId};

use crate::drive::Drive;
use crate::existence::{ExistenceModel, ThereThen, log_odds, probability, updated};
use crate::position_grid::PositionGrid;
use crate::rates::{DetectionRates, Shown};
use crate::settings::Settings;
use crate::sightings::Sighting;

/// Probability that a landmark which is gone is taken for seen: another one that looks alike is near.
pub(crate) const FALSE_SIGHTING: f64 = 0.03;
/// Landmarks this near to each other may be of one thing that was carried away (m).
const SAME_OBJECT_M: f64 = 0.3;
/// Landmarks that are there with a smaller probability support no keyframe. One that nobody passes keeps at least half of one.
const MIN_SUPPORT: f64 = 0.2;

/// Updates the existence of landmarks by what a session shows of them, unless another piece of its drive showed it. Of one that is handed in
/// late, what it missed says nothing of what was seen since, and what it saw says the less of what was missed since the longer before it was.
///
/// # Arguments
/// * `session`: ids of its keyframes.
/// * `stamp_ns`: when it ended.
/// * `drive`: that it is a piece of.
///
/// # Returns
/// How likely the session saw a landmark that was there.
pub(crate) fn update_existence(
    contents: &mut MapContents,
    sightings: &[Sighting],
    session: &RangeInclusive<KeyframeId>,
    stamp_ns: i64,
    drive: &Drive,
    settings: &Settings,
) -> DetectionRates {
    let assumed = AssumedExistence::before(contents, session, stamp_ns, settings);
    let stated: BTreeMap<LandmarkId, LandmarkExistence> =
        contents.existence.iter().map(|existence| (existence.landmark, *existence)).collect();
    let model = ExistenceModel::new(settings.half_life_ns());
    let before = |sighting: &Sighting| {
        let landmark = &contents.landmarks[sighting.landmark];
        let of = stated.get(&landmark.id).copied().unwrap_or_else(|| assumed.of_landmark(landmark));
        let was_known = assumed.first_ns(landmark).is_some_and(|first_ns| first_ns <= stamp_ns);
        Before::new(of, was_known, stamp_ns, drive, model)
    };
    let expected: Vec<Shown> = sightings
        .iter()
        .filter(|sighting| sighting.exposures > 0)
        .filter_map(|sighting| {
            let log_odds = before(sighting).then?;
            Some(Shown { exposures: sighting.exposures, seen: sighting.seen, log_odds })
        })
        .collect();
    let rates = DetectionRates::learned(&expected, FALSE_SIGHTING);
    let mut existence = stated.clone();
    for landmark in &contents.landmarks {
        // What is new has its time, also when the keyframe that saw it is taken out.
        if landmark.observations.iter().all(|seen| session.contains(&seen.keyframe)) {
            existence.insert(landmark.id, assumed.of_landmark(landmark));
        }
    }
    for sighting in sightings {
        let of = before(sighting).after(sighting.seen, rates.of(sighting.exposures), stamp_ns);
        existence.insert(of.landmark, of);
    }
    contents.existence = existence.into_values().collect();
    rates
}

/// What is known of a landmark before a session, and how the session counts for it.
struct Before {
    of: LandmarkExistence,
    counts: Counts,
    /// The log-odds that it was there when the session passed; `None` where the map knows of it from a later time only.
    then: Option<f64>,
}

/// How a session counts for a landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Counts {
    /// Another piece of its drive has counted, or the landmark was seen later: what it saw or missed before is no news of it.
    Not,
    /// It is the newest one.
    Now,
    /// It is older than one that missed the landmark: it was handed in late.
    Late(ThereThen),
}

impl Before {
    /// # Arguments
    /// * `of`: by the sessions that were taken before.
    /// * `was_known`: whether the map has an observation of it from before the end of the session.
    /// * `stamp_ns`: when the session ended.
    fn new(
        mut of: LandmarkExistence,
        was_known: bool,
        stamp_ns: i64,
        drive: &Drive,
        model: ExistenceModel,
    ) -> Before {
        let is_late = of.stamp_ns > stamp_ns;
        let was_seen_since = is_late && of.seen_ns > stamp_ns;
        let counts = if drive.may_have_counted(of.stamp_ns) || was_seen_since {
            Counts::Not
        } else if is_late {
            Counts::Late(model.in_between([of.seen_ns, stamp_ns, of.stamp_ns]))
        } else {
            of.log_odds = model.predicted(of.log_odds, stamp_ns.saturating_sub(of.stamp_ns));
            of.stamp_ns = stamp_ns;
            Counts::Now
        };
        let then = match counts {
            Counts::Late(then) => Some(then.log_odds(of.log_odds)),
            Counts::Not if was_seen_since => Some(of.log_odds).filter(|_| was_known),
            Counts::Not | Counts::Now => Some(of.log_odds),
        };
        Before { of, counts, then }
    }

    /// What is known of it with the session.
    ///
    /// # Arguments
    /// * `rate`: probability that the session sees it where it is there.
    fn after(self, seen: bool, rate: f64, stamp_ns: i64) -> LandmarkExistence {
        let Before { mut of, counts, .. } = self;
        of.log_odds = match counts {
            Counts::Not => of.log_odds,
            Counts::Now => updated(of.log_odds, seen, rate, FALSE_SIGHTING),
            Counts::Late(then) => then.updated(of.log_odds, seen, rate, FALSE_SIGHTING),
        };
        if seen {
            of.seen_ns = of.seen_ns.max(stamp_ns);
        }
        of
    }
}

/// What is known of the existence of landmarks of which nothing is stated: they are as new as their newest observation.
pub(crate) struct AssumedExistence {
    stamps: BTreeMap<KeyframeId, i64>,
    log_odds: f64,
    now_ns: i64,
}

impl AssumedExistence {
    /// # Arguments
    /// * `now_ns`: when landmarks were seen of which no time is known.
    pub(crate) fn of(contents: &MapContents, now_ns: i64, settings: &Settings) -> AssumedExistence {
        let stamps = contents.keyframes.iter().map(|keyframe| (keyframe.id, keyframe.stamp_ns)).collect();
        AssumedExistence { stamps, log_odds: log_odds(settings.new_existence), now_ns }
    }

    /// Before a session: what its keyframes show is evidence yet.
    fn before(
        contents: &MapContents,
        session: &RangeInclusive<KeyframeId>,
        now_ns: i64,
        settings: &Settings,
    ) -> AssumedExistence {
        let mut assumed = AssumedExistence::of(contents, now_ns, settings);
        assumed.stamps.retain(|keyframe, _| !session.contains(keyframe));
        assumed
    }

    /// When the oldest of the keyframes that observe a landmark was taken; 0 where that is not known.
    fn first_ns(&self, landmark: &Landmark) -> Option<i64> {
        landmark.observations.iter().filter_map(|seen| self.stamps.get(&seen.keyframe)).copied().min()
    }

    pub(crate) fn of_landmark(&self, landmark: &Landmark) -> LandmarkExistence {
        let observed = landmark.observations.iter().filter_map(|seen| self.stamps.get(&seen.keyframe));
        let newest_ns = observed.copied().max().filter(|stamp_ns| *stamp_ns != 0).unwrap_or(self.now_ns);
        LandmarkExistence {
            landmark: landmark.id,
            log_odds: self.log_odds,
            stamp_ns: newest_ns,
            seen_ns: newest_ns,
        }
    }
}

/// What is gone.
#[derive(Debug, Default)]
pub(crate) struct Gone {
    pub(crate) landmarks: BTreeSet<LandmarkId>,
    /// Where they were, in G (m).
    pub(crate) positions_m: Vec<[f64; 3]>,
    /// Keyframes that show too little of what is left.
    pub(crate) keyframes: BTreeSet<KeyframeId>,
}

/// Takes out the landmarks that are gone, and the keyframes that are left with too few: what is hardly there supports nothing either.
pub(crate) fn remove_gone(contents: &mut MapContents, settings: &Settings) -> Gone {
    let is_gone = |of: &&LandmarkExistence| probability(of.log_odds) < settings.min_existence;
    let gone: BTreeSet<LandmarkId> =
        contents.existence.iter().filter(is_gone).map(|existence| existence.landmark).collect();
    let doubtful: BTreeSet<LandmarkId> = contents
        .existence
        .iter()
        .filter(|of| probability(of.log_odds) < MIN_SUPPORT)
        .map(|existence| existence.landmark)
        .collect();
    if doubtful.is_empty() && gone.is_empty() {
        return Gone::default();
    }
    let lost = contents.landmarks_in_global().filter(|(landmark, _)| gone.contains(&landmark.id));
    let positions_m = lost.map(|(_, position)| position.into()).collect();
    let before = landmark_counts(contents, |_| true);
    let after = landmark_counts(contents, |id| !doubtful.contains(&id) && !gone.contains(&id));
    let is_left_poor = |(id, count): (KeyframeId, usize)| {
        let left = after.get(&id).copied().unwrap_or_default();
        (left < count && left < BuildReport::FEW_LANDMARKS).then_some(id)
    };
    let poor: BTreeSet<KeyframeId> = before.into_iter().filter_map(is_left_poor).collect();
    contents.landmarks.retain(|landmark| !gone.contains(&landmark.id));
    contents.drop_existence_of_others();
    edit::remove_keyframes(contents, &poor);
    Gone { landmarks: gone, positions_m, keyframes: poor }
}

/// Takes out the landmarks of added kinds that are gone: no session says what it saw of them, so that they go with the landmark of the
/// primary kind that is nearest to where they are.
///
/// # Arguments
/// * `gone_m`: where landmarks of the primary kind were, in G (m), that are taken out already.
pub(crate) fn remove_gone_of_added_kinds(contents: &mut MapContents, gone_m: &[[f64; 3]]) {
    if gone_m.is_empty() || contents.added_features.is_empty() {
        return;
    }
    let reach_m = 2.0 * SAME_OBJECT_M;
    let gone = PositionGrid::of_positions(gone_m.iter().copied().map(Vector3::from), reach_m);
    let positions = contents.landmarks_in_global().map(|(_, position)| position);
    let left =
        PositionGrid::of_positions(positions.filter(|position| gone.nearest(position) < reach_m), reach_m);
    edit::retain_added_landmarks(contents, |position| {
        let from_gone = gone.nearest(position);
        from_gone > SAME_OBJECT_M || left.nearest(position) <= from_gone
    });
}

/// How many landmarks each keyframe observes of those that a condition holds for.
fn landmark_counts(
    contents: &MapContents,
    holds: impl Fn(LandmarkId) -> bool,
) -> BTreeMap<KeyframeId, usize> {
    let mut counts: BTreeMap<KeyframeId, usize> = BTreeMap::new();
    let landmarks = contents.landmarks.iter().filter(|landmark| holds(landmark.id));
    for observation in landmarks.flat_map(|landmark| &landmark.observations) {
        *counts.entry(observation.keyframe).or_default() += 1;
    }
    counts
}
