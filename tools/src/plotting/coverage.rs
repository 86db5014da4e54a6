//! Plan view of a map: keyframes, their viewing directions, landmarks, keyframes with too few of them, and places that look alike.

use super::canvas::{self, BAD, ESTIMATE, Mark, ODOMETRY, TRUTH, entry};
use super::panel::Series;
use super::trajectory::{PlanView, plan};
use map::contents::MapContents;
use nalgebra::Vector3;
use protocol::KeyframeId;
use recognition::likely_alias;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use mapping::BuildReport;

/// Length of a viewing direction, as a fraction of the keyframes' extent.
const STROKE: f64 = 0.1;
/// Landmarks further from the keyframes' centre than this many times their extent are not drawn.
const REACH: f64 = 3.0;

/// Draws the plan view of a map, along gravity where the map states it, else along its z axis.
///
/// # Errors
/// The picture cannot be written.
pub fn draw_coverage(map: &MapContents, path: &Path) -> anyhow::Result<PathBuf> {
    let view = PlanView::along(&map.info.gravity_in_global.unwrap_or_else(|| -Vector3::z()));
    let poses = map.keyframe_poses();
    let positions: Vec<(f64, f64)> = poses.values().map(|pose| view.project(&pose.translation)).collect();
    let (middle, extent) = middle_and_extent(&positions);
    let mut seen: HashMap<u64, usize> = HashMap::new();
    let mut landmarks = Vec::new();
    for landmark in &map.landmarks {
        for observation in &landmark.observations {
            *seen.entry(observation.keyframe).or_default() += 1;
        }
        if let Some(pose) = poses.get(&landmark.anchor) {
            let point = view.project(&pose.transform(&landmark.position_in_anchor));
            if (point.0 - middle.0).hypot(point.1 - middle.1) <= REACH * extent {
                landmarks.push(point);
            }
        }
    }
    let (mut good, mut poor, mut series) = (Vec::new(), Vec::new(), Vec::new());
    for (id, pose) in &poses {
        let is_poor = seen.get(id).is_none_or(|&count| count < BuildReport::FEW_LANDMARKS);
        let at = view.project(&pose.translation);
        let ahead = view.project(&(pose.translation + pose.rotation * Vector3::z() * (STROKE * extent)));
        let colour = if is_poor { BAD } else { ESTIMATE };
        series.push(Series::line(vec![at, ahead], colour, 1));
        if is_poor { &mut poor } else { &mut good }.push(at);
    }
    let aliased = aliased_keyframes(map);
    for (keyframe, other) in &aliased {
        let ends = [keyframe, other].map(|id| view.project(&poses[id].translation));
        series.push(Series::line(ends.to_vec(), ODOMETRY, 1));
    }
    let alike = match (map.aliases.len(), aliased.len()) {
        (0, _) => "places that look alike were not searched: driftless map-info --aliases".to_owned(),
        (_, count) => format!("could be taken for another place: {count} keyframes"),
    };
    let few = format!("fewer than {} landmarks: {} keyframes", BuildReport::FEW_LANDMARKS, poor.len());
    let legend = [
        entry(Mark::Dot, TRUTH, &format!("{} landmarks", map.landmarks.len())),
        entry(Mark::Dot, ESTIMATE, &format!("{} keyframes with viewing direction", good.len())),
        entry(Mark::Dot, BAD, &few),
        entry(Mark::Line, ODOMETRY, &alike),
    ];
    series.push(Series::dots(landmarks, TRUTH, 1));
    series.push(Series::dots(good, ESTIMATE, 3));
    series.push(Series::dots(poor, BAD, 4));
    let title = format!("{} \u{2013} coverage, plan view", map.info.name);
    canvas::draw(path, (1000, 900), &title, &legend, |body| plan(body, series))
}

/// The keyframes that could be taken for another place, with the keyframe next to it.
fn aliased_keyframes(map: &MapContents) -> Vec<(KeyframeId, KeyframeId)> {
    map.aliases
        .iter()
        .filter_map(|aliases| Some((aliases.keyframe, likely_alias(aliases)?.keyframe)))
        .collect()
}

/// Middle of some points, and how far the farthest is from it (at least 1 m).
fn middle_and_extent(points: &[(f64, f64)]) -> ((f64, f64), f64) {
    let count = points.len().max(1) as f64;
    let sum = points.iter().fold((0.0, 0.0), |sum, point| (sum.0 + point.0, sum.1 + point.1));
    let middle = (sum.0 / count, sum.1 / count);
    let distance = |point: &(f64, f64)| (point.0 - middle.0).hypot(point.1 - middle.1);
    (middle, points.iter().map(distance).fold(1.0, f64::max))
}
