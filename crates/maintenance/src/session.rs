//! One session worked into a map.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use map::{MapContents, edit};
use mapping::{
    BuildOptions, ExtensionReport, MapPoses, Progress, Stage, check_new_recording, extend_map, run_odometry,
};
use protocol::{FeatureSet, KeyframeId};
use sensors::Sequence;
use statrs::distribution::{ChiSquared, ContinuousCDF as _};

use crate::coverage::surplus;
use crate::gone::{remove_gone, update_existence};
use crate::refusal::Refusal;
use crate::report::{RemovedKeyframes, SessionReport};
use crate::settings::Settings;
use crate::sightings::sightings;

/// A session contradicts the map where what it sees is less likely than this.
const CONFIDENCE: f64 = 0.9999;

/// Works a session into a map.
///
/// # Arguments
/// * `map`: whole and valid, in a frame with z up.
/// * `sequence`: the session, with features as the map's; a session that a robot handed in, or a recording.
/// * `build`: its robot and identity, for the ledger.
/// * `progress`: called with the stage and its steps.
///
/// # Returns
/// The next version of the map. The session is in its ledger, also where none of its keyframes stays.
///
/// # Errors
/// [`Refusal`]: the session is not used, and the map remains as it was.
pub fn take_session(
    map: &MapContents,
    sequence: &mut Sequence,
    build: &BuildOptions,
    settings: &Settings,
    progress: Progress<'_>,
) -> Result<(MapContents, SessionReport), Refusal> {
    // Odometry would take minutes to get to the same.
    check_new_recording(&map.info, sequence, build)?;
    let cameras = sequence.cameras.len();
    let odometry = run_odometry(sequence, cameras, |done, all| progress(Stage::Odometry, done, all))?;
    let mut build = build.clone();
    build.map_poses = MapPoses::Considered;
    build.sigma_px = None;
    let (mut contents, extension) = extend_map(map, sequence, &odometry, None, &build, progress)?;
    check_consistency(map, &extension, settings)?;
    let Some(ids) = ids_of_new(map, &contents) else { return Err(Refusal::NothingLeft) };
    let stamp_ns = contents.info.sessions.last().map_or(0, |session| session.end_ns);
    let features: BTreeMap<i64, &FeatureSet> =
        sequence.frames.iter().filter_map(|frame| Some((frame.stamp_ns, frame.features.as_ref()?))).collect();
    let sightings = sightings(&contents, &ids, &features);
    let detection_rates = update_existence(&mut contents, &sightings, &ids, stamp_ns, settings);
    let (gone_m, left_poor) = remove_gone(&mut contents, settings);
    let surplus = surplus(&contents, &ids, stamp_ns, settings);
    let all: BTreeSet<KeyframeId> = surplus.replaced.union(&surplus.unused).copied().collect();
    edit::remove_keyframes(&mut contents, &all);
    if contents.keyframes.is_empty() {
        return Err(Refusal::NothingLeft);
    }
    if !contents.keyframes.iter().any(|keyframe| ids.contains(&keyframe.id)) {
        contents.info.sigma_px = map.info.sigma_px;
    }
    contents.sort();
    contents.count_sessions();
    contents.validate()?;
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
        gone_m,
        removed: RemovedKeyframes {
            gone: of_map(&left_poor),
            replaced: of_map(&surplus.replaced),
            unused: of_map(&surplus.unused),
        },
        keyframes: contents.keyframes.len(),
        landmarks: contents.landmarks.len(),
    };
    Ok((contents, report))
}

/// The ids of the keyframes that a map has beyond those of another one.
fn ids_of_new(before: &MapContents, after: &MapContents) -> Option<RangeInclusive<KeyframeId>> {
    let known: BTreeSet<KeyframeId> = before.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let new = || after.keyframes.iter().map(|keyframe| keyframe.id).filter(|id| !known.contains(id));
    Some(new().min()?..=new().max()?)
}

/// Checks that a session agrees with the map, as far as both state it.
fn check_consistency(
    map: &MapContents,
    extension: &ExtensionReport,
    settings: &Settings,
) -> Result<(), Refusal> {
    let ExtensionReport { places, agreeing_places, sigma_px, .. } = *extension;
    let wanted = settings.min_agreeing * places as f64;
    if (agreeing_places as f64) < wanted {
        return Err(Refusal::Places { found: places, agreeing: agreeing_places, wanted });
    }
    let limit = settings.max_pixel_ratio * map.info.sigma_px;
    if sigma_px > limit {
        return Err(Refusal::Pixels { sigma_px, map_px: map.info.sigma_px, limit });
    }
    let (chi_square, freedom) = (extension.map_chi_square, extension.map_freedom);
    let quantile = ChiSquared::new(freedom).map_or(0.0, |distribution| distribution.inverse_cdf(CONFIDENCE));
    let limit = quantile.max(settings.max_map_ratio * freedom);
    if chi_square > limit {
        return Err(Refusal::Moved { chi_square, freedom, limit });
    }
    Ok(())
}
