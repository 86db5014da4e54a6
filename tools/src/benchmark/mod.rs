//! How well a system localizes in a dataset: one recording is mapped, and the others are localized in its map.
//!
//! | module | |
//! |---|---|
//! | `dataset` | the recordings in a folder |
//! | `result` | what is measured of a recording, and the table |

mod dataset;
mod result;

pub use dataset::recordings;
pub use result::{BenchmarkReport, LocalizedRecording, MapFigures, Measured};

use crate::in_process::run_in_map;
use anyhow::{Context as _, Result};
use evaluation::{Alignment, align};
use map::contents::MapContents;
use mapping::map_in_frame;
use onboard::{RobotArguments, StopSignal};
use recognition::LoadedMap;
use sensors::{CalibrationFiles, Recording, TruthTrack};
use std::path::Path;
use std::sync::Arc;

/// Longest gap of the truth around a keyframe, nanoseconds.
const MAX_GAP_NS: i64 = 100_000_000;

/// A map in the frame of the ground truth of the recording that it was built from: aligned once in yaw and position, by all keyframes.
/// `None` where the recording has no truth.
///
/// # Errors
/// A recording that cannot be read.
pub fn in_frame_of_truth(map: &MapContents, recording: &Recording<'_>) -> Result<Option<MapContents>> {
    let truth = recording.truth()?.collect::<Result<Vec<_>, _>>()?;
    let Some(gravity_in_truth) = recording.truth_gravity()? else { return Ok(None) };
    let Some(gravity_in_map) = map.info.gravity_in_global else { return Ok(None) };
    let track = TruthTrack::new(&truth);
    let cameras = &recording.calibration().cameras;
    let pairs: Vec<_> = map
        .keyframes
        .iter()
        .filter_map(|keyframe| {
            let truth_from_imu = track.pose(keyframe.stamp_ns, MAX_GAP_NS)?;
            let true_pose = truth_from_imu.compose(&cameras.first()?.imu_from_camera);
            Some((true_pose.translation, keyframe.global_from_keyframe.pose.translation))
        })
        .collect();
    let yaw = Alignment::Yaw { gravity_in_reference: gravity_in_truth, gravity_in_estimate: gravity_in_map };
    let Ok(truth_from_map) = align(&pairs, &yaw) else { return Ok(None) };
    let mut moved = map_in_frame(map, &truth_from_map);
    moved.info.own_frame = false;
    Ok(Some(moved))
}

/// Localizes a recording in a map.
///
/// # Arguments
/// * `robot`: how it is run, and into which folder.
///
/// # Errors
/// A recording that cannot be read, a folder that cannot be written, a run that ended early.
pub fn localize(
    recording: &Path,
    files: &CalibrationFiles,
    robot: &RobotArguments,
    map: &Arc<LoadedMap>,
    stop: &StopSignal,
    show: impl Fn(usize),
) -> Result<Measured> {
    let mut robot = robot.clone();
    robot.features = robot.features.or_of_map(&map.info().extractor);
    let outcome = run_in_map(Recording::open_with(recording, files)?, &robot, map, stop, show)?;
    let states = outcome.states().context("the states of the run")?;
    Ok(Measured::of(&outcome.summary, &states))
}
