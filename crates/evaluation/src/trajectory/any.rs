//! Reads poses from a file of any of the formats, recognized by its content. All commands read poses here.

use super::{StampedPose, StateKind, states, tum};
use nalgebra::Matrix6;
use sensors::{SequenceError, read_groundtruth, read_reference_poses};
use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader, Read as _};
use std::path::Path;

/// The first lines are searched for the first row within this many bytes: headers are shorter.
const HEAD_BYTES: u64 = 1 << 16;

/// The format of a file of poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PoseFormat {
    /// `t x y z qx qy qz qw`, seconds, separated by blanks.
    Tum,
    /// The same, written by a run.
    TumOfRun,
    /// EuRoC's layout with the pose only, as motion capture systems give it: 8 columns.
    EurocPoses,
    /// EuRoC's `state_groundtruth_estimate0/data.csv`, with velocities and biases: 17 columns.
    EurocStates,
    /// `reference_poses.csv`: poses with two standard deviations each, 10 columns.
    ReferencePoses,
    /// One pose of a run's `states.csv`, with covariances.
    States(StateKind),
}

impl fmt::Display for PoseFormat {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tum => write!(formatter, "TUM (t x y z qx qy qz qw, seconds)"),
            Self::TumOfRun => write!(formatter, "TUM (t x y z qx qy qz qw, seconds) of a run"),
            Self::EurocPoses => write!(formatter, "EuRoC ground truth, 8 columns (ns, position, q_w first)"),
            Self::EurocStates => {
                write!(formatter, "EuRoC ground truth, 17 columns (ns, position, q_w first)")
            }
            Self::ReferencePoses => {
                write!(formatter, "reference_poses.csv (ns, position, q_w first, sigmas)")
            }
            Self::States(kind) => {
                write!(formatter, "states.csv of a run, {} with its covariances", kind.name())
            }
        }
    }
}

/// A trajectory, with covariances where the file has them.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryFile {
    /// What the file was recognized as.
    pub format: PoseFormat,
    /// The poses, in order of time.
    pub poses: Vec<StampedPose>,
    /// The covariance of each pose (`[dtheta, dp]`, parent frame), from `states.csv` or `reference_poses.csv`.
    pub covariances: Option<Vec<Matrix6<f64>>>,
}

/// Reads a TUM file, EuRoC ground truth (8 or 17 columns), `reference_poses.csv`, or one pose of a `states.csv`.
///
/// # Arguments
/// * `states`: which pose of a `states.csv`; the first one that the run has is taken. Other formats ignore it.
///
/// # Errors
/// [`SequenceError`] with the file and the line: an unknown format, and whatever its reader refuses.
///
/// ```
/// use evaluation::trajectory::{PoseFormat, StateKind, read_any};
///
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("odometry.tum");
/// std::fs::write(&path, "1403636580.838555574 1 2 3 0 0 0 1\n")?;
/// let file = read_any(&path, &[StateKind::GlobalFromImu])?;
/// assert_eq!((file.format, file.poses[0].stamp_ns), (PoseFormat::Tum, 1_403_636_580_838_555_574));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_any(path: &Path, states: &[StateKind]) -> Result<TrajectoryFile, SequenceError> {
    let Some(row) = first_row(path)? else {
        return Err(SequenceError::empty(path, "a file of poses was expected"));
    };
    let without = |format, poses| TrajectoryFile { format, poses, covariances: None };
    if !row.text.contains(',') {
        let format = if row.is_of_run { PoseFormat::TumOfRun } else { PoseFormat::Tum };
        return Ok(without(format, tum::read(path)?));
    }
    let cells: Vec<&str> = row.text.split(',').map(str::trim).collect();
    if cells.get(1).is_some_and(|cell| cell.contains("_from_")) {
        return one_state(path, states);
    }
    match cells.len() {
        10 => {
            let rows = read_reference_poses(path)?;
            let covariances = rows.iter().map(|row| row.covariance).collect();
            let stamped =
                |row: &sensors::ReferencePose| StampedPose { stamp_ns: row.stamp_ns, pose: row.pose };
            Ok(TrajectoryFile {
                format: PoseFormat::ReferencePoses,
                poses: rows.iter().map(stamped).collect(),
                covariances: Some(covariances),
            })
        }
        columns @ (8 | 17) => {
            let format = if columns == 8 { PoseFormat::EurocPoses } else { PoseFormat::EurocStates };
            let rows = read_groundtruth(path)?;
            let stamped = |row: &sensors::TruthRow| StampedPose { stamp_ns: row.stamp_ns, pose: row.pose };
            Ok(without(format, rows.iter().map(stamped).collect()))
        }
        columns => {
            Err(SequenceError::Row { path: path.to_path_buf(), line: row.line, problem: unknown(columns) })
        }
    }
}

fn unknown(columns: usize) -> String {
    format!(
        "{columns} columns separated by commas are no known file of poses: known are TUM (t x y z qx qy qz qw in seconds, \
         separated by blanks), EuRoC ground truth with 8 or 17 columns (ns, position, quaternion with w first, ...), \
         reference_poses.csv with 10, and states.csv of a run"
    )
}

fn one_state(path: &Path, wanted: &[StateKind]) -> Result<TrajectoryFile, SequenceError> {
    let rows = states::read(path)?;
    for &kind in wanted {
        let chosen = rows.iter().filter_map(|row| row.get(kind).map(|pose| (row.stamp_ns, pose)));
        let (poses, covariances): (Vec<_>, Vec<_>) = chosen
            .map(|(stamp_ns, state)| (StampedPose { stamp_ns, pose: state.pose }, state.covariance))
            .unzip();
        if !poses.is_empty() {
            let format = PoseFormat::States(kind);
            return Ok(TrajectoryFile { format, poses, covariances: Some(covariances) });
        }
    }
    let names: Vec<&str> = wanted.iter().map(|kind| kind.name()).collect();
    let advice = format!("of {}: the run never localized, or choose another state", names.join(" and "));
    Err(SequenceError::empty(path, advice))
}

struct FirstRow {
    text: String,
    /// Counted from 1.
    line: u64,
    /// Whether the file begins with the header of a run's TUM files.
    is_of_run: bool,
}

/// The first line that is neither empty nor a comment nor a header, which begins with the name of a column.
fn first_row(path: &Path) -> Result<Option<FirstRow>, SequenceError> {
    let file = File::open(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => SequenceError::missing(path, "a file of poses was expected there"),
        _ => SequenceError::io(path, source),
    })?;
    let io = |source| SequenceError::io(path, source);
    let mut lines = BufReader::new(file).take(HEAD_BYTES);
    let (mut bytes, mut line, mut is_of_run) = (Vec::new(), 0, false);
    loop {
        bytes.clear();
        if lines.read_until(b'\n', &mut bytes).map_err(io)? == 0 {
            return Ok(None);
        }
        line += 1;
        is_of_run |= line == 1 && bytes.starts_with(tum::HEADER.as_bytes());
        let text = String::from_utf8_lossy(&bytes).trim().trim_start_matches('\u{feff}').to_owned();
        let is_header = text.starts_with(|first: char| first.is_ascii_alphabetic()) && !is_nan(&text);
        if !text.is_empty() && !text.starts_with('#') && !is_header {
            return Ok(Some(FirstRow { text, line, is_of_run }));
        }
    }
}

/// Whether a row begins with a time that is not a number, which its reader is to name.
fn is_nan(text: &str) -> bool {
    let first = text.split([',', ' ', '\t']).next().unwrap_or_default();
    first.eq_ignore_ascii_case("nan") || first.eq_ignore_ascii_case("inf")
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::pose::Pose;
    use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};
    use nalgebra::{UnitQuaternion, Vector3};

    const STAMP: i64 = 1_403_636_580_838_555_574;

    fn pose() -> Pose {
        Pose::new(
            UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.7, 2.0)),
            Vector3::new(4.0, -5.0, 0.5),
        )
    }

    fn read(text: &str) -> Result<TrajectoryFile, SequenceError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("poses");
        std::fs::write(&path, text).unwrap();
        read_any(&path, &[StateKind::GlobalFromImu, StateKind::LocalFromImu])
    }

    /// The same two poses in every format.
    fn texts() -> [(PoseFormat, String); 6] {
        let (p, q) = (pose().translation, pose().rotation.into_inner());
        let position = format!("{},{},{}", p.x, p.y, p.z);
        let euroc = format!("{position},{},{},{},{}", q.w, q.i, q.j, q.k);
        let rows = |rest: &str| format!("{STAMP},{euroc}{rest}\n{},{euroc}{rest}\n", STAMP + 1);
        let stamped = |stamp_ns| tum::line(&StampedPose { stamp_ns, pose: pose() });
        let truth = ",0.1,0.2,0.3,nan,nan,nan,0,0,0";
        [
            (
                PoseFormat::Tum,
                format!("# timestamp tx ty tz qx qy qz qw\n{}\n{}", stamped(STAMP), stamped(STAMP + 1)),
            ),
            (
                PoseFormat::Tum,
                format!("timestamp tx ty tz qx qy qz qw\r\n{}\r\n{}\r\n", stamped(STAMP), stamped(STAMP + 1)),
            ),
            (PoseFormat::TumOfRun, format!("{}\n{}\n{}\n", tum::HEADER, stamped(STAMP), stamped(STAMP + 1))),
            (
                PoseFormat::EurocPoses,
                "#timestamp [ns], p_RS_R_x [m], p, p, q, q, q, q\n".to_owned() + &rows(""),
            ),
            (PoseFormat::EurocStates, "timestamp,p_x\n".to_owned() + &rows(truth)),
            (PoseFormat::ReferencePoses, rows(",0.02,0.1")),
        ]
    }

    #[test]
    fn every_format_is_recognized_by_its_content() {
        for (format, text) in texts() {
            let file = read(&text).unwrap();
            assert_eq!(file.format, format, "{text}");
            assert_eq!(file.poses.iter().map(|row| row.stamp_ns).collect::<Vec<_>>(), [STAMP, STAMP + 1]);
            assert!(file.poses[1].pose.local(&pose()).amax() < 1e-8, "{format}");
            let expected =
                (format == PoseFormat::ReferencePoses).then(|| vec![isotropic_covariance(0.02, 0.1); 2]);
            assert_eq!(file.covariances, expected);
        }
    }

    #[test]
    fn states_give_the_first_pose_that_the_run_has_with_its_covariance() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("any name");
        let local = PoseWithCovariance::new(pose(), isotropic_covariance(0.01, 0.2));
        let global = PoseWithCovariance::new(pose().inverse(), isotropic_covariance(0.03, 0.4));
        for (global, kind, expected) in
            [(None, StateKind::LocalFromImu, local), (Some(global), StateKind::GlobalFromImu, global)]
        {
            let row = |stamp_ns| states::StateRow {
                stamp_ns,
                local_from_imu: local,
                global_from_local: global,
                global_from_imu: global,
            };
            states::write(&path, &[row(1), row(2)]).unwrap();
            let file = read_any(&path, &[StateKind::GlobalFromImu, StateKind::LocalFromImu]).unwrap();
            assert_eq!(file.format, PoseFormat::States(kind));
            assert!((file.covariances.unwrap()[1] - expected.covariance).amax() < 1e-9);
            assert!(file.poses[1].pose.local(&expected.pose).amax() < 1e-8);
        }
    }

    #[test]
    fn bad_rows_are_named_with_their_line() {
        for (text, line, word) in [
            ("1,2,3\n", "line 1", "known are TUM"),
            ("#t\n5,0,0,0,1,0,0,0\n6,0,nan,0,1,0,0,0\n", "line 3", "column 3 is NaN"),
            ("#t\n5,0,0,0,1,0,0,0\n6,0,0,0,1,0,0\n", "line 3", "cut off: 7 of 8"),
            ("nan,0,0,0,1,0,0,0\n", "line 1", "column 1"),
            ("5,0,0,0,1,0,0,0,0.1,0.1\n6,0,0,0,1,0,0,0,0.1,nan\n", "line 2", "column 10 is NaN"),
            ("5,0,0,0,1,0,0,0,0.1,0.1\n6,0,0,0,1,0,0,0,0.1\n", "line 2", "cut off: 9 of 10"),
            ("1.0 0 0 0 0 0 0 1\n2.0 0 nan 0 0 0 0 1\n", "line 2", "column 3"),
            ("1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 1\n3.0 0 0 0 0 0 0 1\n", "line 2", "cut off"),
            ("1403636580.5,0,0,0,1,0,0,0\n", "line 1", "nanoseconds"),
            ("1403636580838555574 0 0 0 0 0 0 1\n", "line 1", "seconds"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(line) && error.contains(word), "{error}");
        }
        assert!(matches!(read("# nothing\n"), Err(SequenceError::Empty { .. })));
    }
}
