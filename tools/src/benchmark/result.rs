//! What a benchmark measures, and its table.

use evaluation::Score;
use evaluation::trajectory::StateRow;
use onboard::Summary;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;

/// What a benchmark found.
#[derive(Clone, Debug, Serialize)]
pub struct BenchmarkReport {
    /// Version of the program.
    pub version: String,
    /// Folder of the dataset.
    pub dataset: PathBuf,
    /// The map.
    pub map: MapFigures,
    /// The recordings that were localized in it, by name.
    pub recordings: Vec<LocalizedRecording>,
}

/// The map of a benchmark.
#[derive(Clone, Debug, Serialize)]
pub struct MapFigures {
    /// Name of the recording.
    pub recording: String,
    /// Number of keyframes.
    pub keyframes: usize,
    /// Number of landmarks.
    pub landmarks: usize,
    /// Wall time of building it, seconds.
    pub seconds: f64,
    /// Whether it was moved into the frame of its recording's ground truth, so that poses in it are compared without alignment.
    pub is_in_frame_of_truth: bool,
}

/// A recording that was localized, or could not be.
#[derive(Clone, Debug, Serialize)]
pub struct LocalizedRecording {
    /// Name of the recording.
    pub recording: String,
    /// What was measured; none where it could not be run.
    pub measured: Option<Measured>,
    /// Why it could not be run.
    pub error: Option<String>,
}

/// What is measured of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Time from the first state to the last, seconds.
    pub seconds: f64,
    /// Length of the true path, metres; none without truth.
    pub distance_m: Option<f64>,
    /// Part of the states that have a pose in the map.
    pub localized: f64,
    /// Time from the first state to the first pose in the map, seconds; none where there was none.
    pub first_localized_s: Option<f64>,
    /// Errors of the causal pose in the map, from 5 s after it was initialized on; none without truth.
    pub pose: Option<Score>,
    /// RMSE of the odometry, aligned in yaw and position over the whole run, metres.
    pub odometry_m: Option<f64>,
    /// Why there are no errors.
    pub no_score: Option<String>,
    /// Computing time per frame, milliseconds.
    pub milliseconds_per_frame: f64,
    /// Time of the recording over the duration of its run.
    pub realtime_factor: f64,
    /// Number of alarms.
    pub alarms: usize,
}

impl Measured {
    /// Of a run.
    pub fn of(summary: &Summary, states: &[StateRow]) -> Self {
        let in_map = || states.iter().filter(|state| state.global_from_imu.is_some());
        let seconds_at = |stamp_ns: i64| (stamp_ns - states[0].stamp_ns) as f64 * 1e-9;
        let score = summary.score.as_ref();
        Self {
            seconds: summary.seconds,
            distance_m: score.map(|score| score.distance_m),
            localized: in_map().count() as f64 / states.len().max(1) as f64,
            first_localized_s: in_map().next().map(|state| seconds_at(state.stamp_ns)),
            pose: score.and_then(|score| score.pose),
            odometry_m: score.map(|score| score.odometry_yaw_aligned_m.rmse),
            no_score: summary.no_score.clone(),
            milliseconds_per_frame: summary.milliseconds_per_frame.total,
            realtime_factor: summary.realtime_factor,
            alarms: summary.alarms.len(),
        }
    }
}

impl BenchmarkReport {
    /// The table in Markdown, with what its columns are.
    pub fn table(&self) -> String {
        let map = &self.map;
        let mut text = format!(
            "Map of {}: {} keyframes, {} landmarks, built in {:.0} s.\n\n",
            map.recording, map.keyframes, map.landmarks, map.seconds
        );
        text += "| recording | m | localized | after s | RMSE m | deg | largest m | NEES position | NEES pose | odometry m | ms a frame | times real time |\n";
        text += "|---|---|---|---|---|---|---|---|---|---|---|---|\n";
        for recording in &self.recordings {
            let _ = writeln!(text, "| {} | {} |", recording.recording, recording.cells().join(" | "));
        }
        let compared = if map.is_in_frame_of_truth {
            "The map was aligned once with the truth of its own recording, in yaw and position; the poses of the others are compared \
             as they are."
        } else {
            "The map's recording has no truth: that of each other recording was aligned with its poses in the map, in yaw and position, \
             which removes the constant part of the errors: there is no NEES."
        };
        let _ = writeln!(
            text,
            "\nErrors of the pose in the map at the time of each image (causal), from 5 s after the map initialization on. {compared} NEES: \
             1 is consistent, more is overconfident. The odometry is aligned in yaw and position over the whole run."
        );
        text
    }
}

impl LocalizedRecording {
    /// The cells of its row, behind its name.
    fn cells(&self) -> Vec<String> {
        let Some(measured) = &self.measured else {
            return vec![self.error.clone().unwrap_or_default()];
        };
        let number = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let pose = measured.pose.as_ref();
        vec![
            number(measured.distance_m, 1),
            format!("{:.0} %", 100.0 * measured.localized),
            number(measured.first_localized_s, 1),
            number(pose.map(|pose| pose.rmse_m), 3),
            number(pose.map(|pose| pose.rmse_deg), 2),
            number(pose.map(|pose| pose.max_m), 3),
            number(pose.and_then(|pose| pose.nees_position), 2),
            number(pose.and_then(|pose| pose.nees_pose), 2),
            number(measured.odometry_m, 3),
            number(Some(measured.milliseconds_per_frame), 1),
            number(Some(measured.realtime_factor), 1),
        ]
    }
}
