//! A drive in one map: as a robot, and image by image from cold.

use crate::in_process::run_in_map;
use crate::plotting::RunFiles;
use crate::query_image::{RecordedQuery, read_queries};
use anyhow::{Context as _, Result};
use evaluation::trajectory::StateRow;
use geometry::PoseWithCovariance;
use onboard::arguments::CalibrationArguments;
use onboard::{Event, RobotArguments, StopSignal};
use protocol::MatchOutcome;
use recognition::{LoadedMap, RecognitionOptions};
use sensors::{CalibrationFiles, Recording, TruthRow};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A recording with which maps are reviewed.
pub struct Drive {
    recording: PathBuf,
    name: String,
    files: CalibrationFiles,
    robot: RobotArguments,
    queries: Vec<RecordedQuery>,
}

/// A drive in one map.
pub struct DriveRun {
    pub(super) states: Vec<StateRow>,
    pub(super) events: Vec<Event>,
    /// Truth in the map's frame, where the recording has it.
    pub(super) truth: Option<Vec<TruthRow>>,
    /// Images that were localized without any prior.
    pub(super) images: Vec<ColdImage>,
}

/// An image that was localized by itself.
pub(super) struct ColdImage {
    pub(super) stamp_ns: i64,
    pub(super) outcome: MatchOutcome,
    /// The IMU in the map, where the image was localized.
    pub(super) global_from_imu: Option<PoseWithCovariance>,
}

impl Drive {
    /// Reads the images of a recording.
    ///
    /// # Arguments
    /// * `robot`: how it is run.
    /// * `map`: names the extractor of the features.
    /// * `period_s`: images are localized from cold at this distance, seconds.
    ///
    /// # Errors
    /// A recording that cannot be read, or has neither images nor features; a topic of wheels or GNSS that cannot be
    /// used.
    pub fn read(
        recording: &Path,
        calibration: &CalibrationArguments,
        robot: &RobotArguments,
        map: &LoadedMap,
        period_s: f64,
    ) -> Result<Self> {
        let mut robot = robot.clone();
        robot.features = robot.features.or_of_map(&map.info().extractor);
        let files = robot.recording_files(calibration)?;
        let end_s = robot.duration.map_or(f64::INFINITY, |duration_s| robot.start_at + duration_s);
        let queries = read_queries(recording, &files, robot.start_at..end_s, period_s, &robot.features)?;
        let name = recording.display().to_string();
        Ok(Self { recording: recording.to_owned(), name, files, robot, queries })
    }

    /// The recording.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Localizes the drive in a map.
    ///
    /// # Arguments
    /// * `out`: folder for what the robot writes.
    ///
    /// # Errors
    /// A recording that cannot be read, a folder that cannot be written, features of another extractor than the map's.
    pub fn run_in(&self, map: &Arc<LoadedMap>, out: &Path) -> Result<DriveRun> {
        let mut robot = self.robot.clone();
        out.clone_into(&mut robot.out);
        let recording = Recording::open_with(&self.recording, &self.files)?;
        run_in_map(recording, &robot, map, &StopSignal::default(), |_| {})
            .with_context(|| self.name.clone())?;
        let run = RunFiles::read(out, None, None)?;
        let images = self.cold_images(map)?;
        let truth = run.truth.map(|truth| truth.rows);
        Ok(DriveRun { states: run.states, events: run.events.unwrap_or_default(), truth, images })
    }

    fn cold_images(&self, map: &LoadedMap) -> Result<Vec<ColdImage>> {
        let options = RecognitionOptions::default();
        let mut images = Vec::new();
        for RecordedQuery { stamp_ns, imu_from_camera, request } in &self.queries {
            let reply = map.localize(request, &options).with_context(|| self.name.clone())?;
            let camera_from_imu = imu_from_camera.inverse();
            let global_from_imu =
                reply.fix.map(|fix| fix.global_from_camera.change_of_child(&camera_from_imu));
            images.push(ColdImage { stamp_ns: *stamp_ns, outcome: reply.outcome, global_from_imu });
        }
        Ok(images)
    }
}

impl DriveRun {
    /// Positions in the plane of the map (m), where the drive was localized.
    pub(super) fn path(&self) -> Vec<[f64; 2]> {
        let poses = self.states.iter().filter_map(|state| state.global_from_imu.as_ref());
        poses.map(|pose| [pose.pose.translation.x, pose.pose.translation.y]).collect()
    }
}
