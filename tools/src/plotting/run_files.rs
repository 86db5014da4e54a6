//! The output folder of a run, and its ground truth.

use anyhow::Context as _;
use evaluation::trajectory::{StateKind, StateRow, read_any_with, states};
use evaluation::{MapFromTruth, RunErrors, RunScore, ScoreError, ScoreOptions, run_errors, score_run};
use nalgebra::Vector3;
use onboard::Event;
use sensors::{QuaternionOrder, Recording, TruthRow, read_written_lines};
use std::path::{Path, PathBuf};

/// The ground truth of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Pose of the IMU in G.
    pub rows: Vec<TruthRow>,
    /// Unit direction of gravity in G.
    pub gravity: Vector3<f64>,
}

/// The data of a run.
#[derive(Clone, Debug)]
pub struct RunFiles {
    /// Its name in titles.
    pub name: String,
    /// Its outputs.
    pub states: Vec<StateRow>,
    /// Its queries, if it kept a record of them.
    pub events: Option<Vec<Event>>,
    /// Its ground truth, if known.
    pub truth: Option<Truth>,
    /// Positions of the map's keyframes in G, metres; empty where they are not known.
    pub keyframes: Vec<Vector3<f64>>,
    /// Identity of the map that the run was localized in.
    pub map_identity: Option<String>,
    /// Whether the truth is aligned with the map, whose frame is its own.
    pub truth_is_aligned: bool,
    /// What is missing; whole sentences.
    pub missing: Vec<String>,
}

impl RunFiles {
    /// Reads an output folder.
    ///
    /// # Arguments
    /// * `groundtruth`: file of the ground truth; `None` takes it from the recording that `summary.json` names.
    /// * `gravity`: its direction in the frame of the ground truth; `None` computes it from the recording, with -z where
    ///   that is not possible.
    ///
    /// # Errors
    /// `states.csv` is missing, or a file cannot be understood.
    pub fn read(
        folder: &Path,
        groundtruth: Option<&Path>,
        gravity: Option<Vector3<f64>>,
    ) -> anyhow::Result<Self> {
        let mut missing = Vec::new();
        let states = states::read(&folder.join("states.csv"))?;
        let events_path = folder.join("events.csv");
        let events = events_path.exists().then(|| read_events(&events_path)).transpose()?;
        if events.is_none() {
            missing.push("There is no events.csv, so nothing about queries is drawn.".to_owned());
        }
        let truth = match groundtruth {
            Some(path) => Some(truth_from_file(path, gravity, &mut missing)?),
            None => truth_from_summary(&folder.join("summary.json"), gravity, &mut missing)?,
        };
        let summary = read_summary(&folder.join("summary.json"))?;
        // The truth may be another file than the one that the run was compared with.
        let aligned = truth.as_ref().zip(gravity_in_own_frame(&summary)).and_then(|(truth, gravity)| {
            let options = ScoreOptions { gravity_in_own_frame: Some(gravity), ..ScoreOptions::default() };
            score_run(&states, &truth.rows, truth.gravity, &options).ok()?.map_from_truth
        });
        let truth = truth.map(|truth| match &aligned {
            Some(aligned) => {
                missing.push(format!("Note: {aligned}."));
                Truth {
                    rows: truth.rows.iter().map(|row| aligned.apply(row)).collect(),
                    gravity: aligned.gravity(),
                }
            }
            None => truth,
        });
        let map_identity = summary.get("map_identity").and_then(serde_json::Value::as_str).map(str::to_owned);
        let truth_is_aligned = aligned.is_some();
        let name =
            folder.file_name().map_or_else(|| "run".to_owned(), |name| name.to_string_lossy().into_owned());
        Ok(Self {
            name,
            states,
            events,
            truth,
            keyframes: Vec::new(),
            map_identity,
            truth_is_aligned,
            missing,
        })
    }

    /// Time of the first state, nanoseconds: the zero of all time axes.
    pub(crate) fn start_ns(&self) -> i64 {
        self.states.first().map_or(0, |state| state.stamp_ns)
    }

    /// Seconds since the first state.
    pub(crate) fn seconds(&self, stamp_ns: i64) -> f64 {
        (stamp_ns - self.start_ns()) as f64 * 1e-9
    }

    /// Length of the run, seconds.
    pub(crate) fn duration(&self) -> f64 {
        self.states.last().map_or(1.0, |state| self.seconds(state.stamp_ns)).max(1e-3)
    }

    /// The truth within the time of the run.
    pub(crate) fn truth_rows(&self) -> &[TruthRow] {
        let Some(truth) = &self.truth else { return &[] };
        let end_ns = self.states.last().map_or(0, |state| state.stamp_ns);
        let from = truth.rows.partition_point(|row| row.stamp_ns < self.start_ns());
        let to = truth.rows.partition_point(|row| row.stamp_ns <= end_ns);
        truth.rows.get(from..to).unwrap_or_default()
    }

    /// The score of the run, if its truth is known.
    pub(crate) fn score(&self) -> Option<RunScore> {
        let truth = self.truth.as_ref()?;
        let score = score_run(&self.states, &truth.rows, truth.gravity, &ScoreOptions::default()).ok()?;
        Some(if self.truth_is_aligned { score.without_nees_in_map() } else { score })
    }

    /// The errors of the run, if its truth is known.
    pub(crate) fn errors(&self) -> Option<Result<RunErrors, ScoreError>> {
        let truth = self.truth.as_ref()?;
        Some(run_errors(&self.states, &truth.rows, truth.gravity))
    }
}

/// Positions of keyframes from the `keyframes.csv` of a map in plain text, metres.
///
/// # Errors
/// The file cannot be read, or has a row without a position.
pub fn read_keyframes(path: &Path) -> anyhow::Result<Vec<Vector3<f64>>> {
    let text = ::files::read_to_string(path).with_context(|| path.display().to_string())?;
    let rows = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
    rows.map(|(index, line)| {
        let cells: Vec<f64> =
            line.split(',').skip(2).take(3).map_while(|cell| cell.trim().parse().ok()).collect();
        let position = <[f64; 3]>::try_from(cells).ok().map(Vector3::from);
        position.with_context(|| {
            format!("{}: line {}: columns 3 to 5 are no position", path.display(), index + 1)
        })
    })
    .collect()
}

/// Reads `events.csv`. A last row that is cut off, as when a run is killed, is left out with a warning.
pub(crate) fn read_events(path: &Path) -> anyhow::Result<Vec<Event>> {
    let lines = read_written_lines(path, "a run writes it to its --out folder")?;
    let reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(lines.text.as_bytes());
    let rows: Result<_, _> = reader.into_deserialize().collect();
    rows.with_context(|| path.display().to_string())
}

fn truth_from_file(
    path: &Path,
    gravity: Option<Vector3<f64>>,
    missing: &mut Vec<String>,
) -> anyhow::Result<Truth> {
    // REC/mav0/state_groundtruth_estimate0/data.csv
    let recording = path.ancestors().nth(3).filter(|root| root.join("mav0/imu0").is_dir());
    // EuRoC's folder has w first, with a header or without.
    let order = recording.map(|_| QuaternionOrder::WFirst);
    let file = read_any_with(path, &[StateKind::GlobalFromImu], order)?;
    let rows = file.poses.iter().map(|row| TruthRow::of_pose(row.stamp_ns, row.pose)).collect();
    let measured = || recording.and_then(|root| Recording::open(root).ok()?.truth_gravity().ok().flatten());
    let gravity = gravity.or_else(measured).unwrap_or_else(|| {
        missing.push(
            "Where gravity pulls in the truth's frame cannot be worked out; it is taken along -z (see --gravity)."
                .to_owned(),
        );
        -Vector3::z()
    });
    Ok(Truth { rows, gravity })
}

/// The summary of a run; null where the run was killed before it was written.
fn read_summary(path: &Path) -> anyhow::Result<serde_json::Value> {
    match ::files::read_to_string(path) {
        Ok(text) => serde_json::from_str(&text).with_context(|| path.display().to_string()),
        Err(_) => Ok(serde_json::Value::Null),
    }
}

/// Direction of gravity in the map of a run whose truth was aligned with it.
fn gravity_in_own_frame(summary: &serde_json::Value) -> Option<Vector3<f64>> {
    let aligned = summary.get("score")?.get("map_from_truth")?;
    Some(serde_json::from_value::<MapFromTruth>(aligned.clone()).ok()?.gravity())
}

/// The truth of the recording that a summary names.
fn truth_from_summary(
    path: &Path,
    gravity: Option<Vector3<f64>>,
    missing: &mut Vec<String>,
) -> anyhow::Result<Option<Truth>> {
    let Ok(text) = ::files::read_to_string(path) else {
        missing.push(
            "There is no summary.json to name the recording, so no truth and no errors are drawn.".to_owned(),
        );
        return Ok(None);
    };
    let summary: serde_json::Value =
        serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    let Some(root) = summary.get("sequence").and_then(serde_json::Value::as_str).map(PathBuf::from) else {
        missing.push(
            "summary.json does not name the recording, so no truth and no errors are drawn.".to_owned(),
        );
        return Ok(None);
    };
    let truth = root.join("mav0/state_groundtruth_estimate0/data.csv");
    if !truth.exists() {
        missing.push(format!(
            "{} is not there, so no truth and no errors are drawn (name it with --groundtruth).",
            truth.display()
        ));
        return Ok(None);
    }
    truth_from_file(&truth, gravity, missing).map(Some)
}
