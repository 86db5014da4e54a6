//! Reads poses from a file of any of the formats, recognized by its content. All commands read poses here.

use super::layout::{Layout, TimeUnit, cells};
use super::rows::{Head, is_kitti, read_kitti};
use super::{StampedPose, StateKind, states, tum};
use nalgebra::Matrix6;
use sensors::{PoseColumns, QuaternionOrder, SequenceError, read_reference_poses};
use std::fmt;
use std::io::Read as _;
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
    /// Another table with times and poses.
    Table {
        /// Order of the quaternion's numbers.
        quaternion: QuaternionOrder,
        /// Whether the header names the columns; else the form of the rows shows them.
        by_header: bool,
    },
    /// KITTI's poses: 12 numbers a row and no times. The stamps are numbers of rows, not times.
    Kitti,
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
            Self::Table { quaternion, by_header: true } => {
                write!(formatter, "a table of poses, {quaternion} by its header")
            }
            Self::Table { quaternion, by_header: false } => {
                write!(formatter, "a table of poses without a header, {quaternion}")
            }
            Self::Kitti => write!(formatter, "KITTI poses (12 columns, no times)"),
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
    /// Rows that repeat the one before them, left out.
    pub repeated_rows: usize,
}

/// Reads a TUM file, EuRoC ground truth (8 or 17 columns), `reference_poses.csv`, one pose of a `states.csv`, KITTI's poses,
/// or any table whose header names the columns.
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
    read_any_with(path, states, None)
}

/// Reads a file as [`read_any`].
///
/// # Arguments
/// * `quaternion`: the order of a quaternion of which neither header nor form of the file tells it.
///
/// # Errors
/// As [`read_any`].
pub fn read_any_with(
    path: &Path,
    states: &[StateKind],
    quaternion: Option<QuaternionOrder>,
) -> Result<TrajectoryFile, SequenceError> {
    let beginning = beginning(path)?;
    let Some(head) = Head::of(&beginning) else {
        return Err(SequenceError::empty(path, "a file of poses was expected"));
    };
    let without = |format, poses| TrajectoryFile { format, poses, covariances: None, repeated_rows: 0 };
    let row = head.first_row.as_str();
    if is_kitti(row) {
        return Ok(without(PoseFormat::Kitti, read_kitti(path, &tum::text_of(path)?)?));
    }
    let cells = cells(row, row.contains(','));
    if row.contains(',') && cells.get(1).is_some_and(|cell| cell.contains("_from_")) {
        return one_state(path, states);
    }
    if row.contains(',') && cells.len() == 10 && has_sigmas(&beginning, &head) {
        return references(path);
    }
    let (rows, layout) = tum::read_text(path, &tum::text_of(path)?, quaternion)?;
    let is_of_run = beginning.starts_with(tum::HEADER);
    let format = format_of(&layout, cells.len(), is_of_run);
    Ok(TrajectoryFile { repeated_rows: rows.repeated, ..without(format, rows.poses) })
}

/// What a table is called.
fn format_of(layout: &Layout, columns: usize, is_of_run: bool) -> PoseFormat {
    let in_order = |order| layout.columns == PoseColumns::in_order(order);
    let in_nanoseconds = layout.unit == TimeUnit::Nanoseconds;
    match columns {
        _ if is_of_run => PoseFormat::TumOfRun,
        8 if layout.with_commas && in_nanoseconds && in_order(QuaternionOrder::WFirst) => {
            PoseFormat::EurocPoses
        }
        17 if layout.with_commas && in_nanoseconds && in_order(QuaternionOrder::WFirst) => {
            PoseFormat::EurocStates
        }
        _ if !layout.with_commas && in_order(QuaternionOrder::WLast) => PoseFormat::Tum,
        _ => PoseFormat::Table { quaternion: layout.columns.quaternion_order(), by_header: layout.by_header },
    }
}

/// Whether the two columns behind a pose are its standard deviations: by the header, where there is one.
fn has_sigmas(beginning: &str, head: &Head) -> bool {
    let mut headers = beginning.lines().take(head.line as usize - 1);
    head.columns.is_none() || headers.any(|line| line.contains("sigma"))
}

fn references(path: &Path) -> Result<TrajectoryFile, SequenceError> {
    let rows = read_reference_poses(path)?;
    let covariances = rows.iter().map(|row| row.covariance).collect();
    let stamped = |row: &sensors::ReferencePose| StampedPose { stamp_ns: row.stamp_ns, pose: row.pose };
    Ok(TrajectoryFile {
        format: PoseFormat::ReferencePoses,
        poses: rows.iter().map(stamped).collect(),
        covariances: Some(covariances),
        repeated_rows: 0,
    })
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
            return Ok(TrajectoryFile { format, poses, covariances: Some(covariances), repeated_rows: 0 });
        }
    }
    let names: Vec<&str> = wanted.iter().map(|kind| kind.name()).collect();
    let advice = format!("of {}: the run never localized, or choose another state", names.join(" and "));
    Err(SequenceError::empty(path, advice))
}

/// The beginning of a file, with its first row.
fn beginning(path: &Path) -> Result<String, SequenceError> {
    let file = files::open(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => SequenceError::missing(path, "a file of poses was expected there"),
        _ => SequenceError::io(path, source),
    })?;
    let mut bytes = Vec::new();
    file.take(HEAD_BYTES).read_to_end(&mut bytes).map_err(|source| SequenceError::io(path, source))?;
    Ok(String::from_utf8_lossy(&bytes).trim_start_matches('\u{feff}').to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::pose::Pose;
    use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};
    use nalgebra::{UnitQuaternion, Vector3};

    const STAMP: i64 = 1_403_636_580_838_555_574;
    const EUROC: &str = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []";

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
            (PoseFormat::EurocPoses, EUROC.to_owned() + "\n" + &rows("")),
            (PoseFormat::EurocStates, EUROC.to_owned() + ", v_x, v_y\n" + &rows(truth)),
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

    /// One pose as other programs write it; all but the ambiguous ones without a switch.
    #[test]
    fn tables_of_other_programs_are_read_by_header_or_form() {
        let (p, q) = (pose().translation, pose().rotation.into_inner());
        let (ns, s) = (STAMP, tum::seconds(STAMP));
        let last =
            |comma: &str| [p.x, p.y, p.z, q.i, q.j, q.k, q.w].map(|value| value.to_string()).join(comma);
        let first = [p.x, p.y, p.z, q.w, q.i, q.j, q.k].map(|value| value.to_string()).join(",");
        let by_header = |quaternion| PoseFormat::Table { quaternion, by_header: true };
        let by_form = |quaternion| PoseFormat::Table { quaternion, by_header: false };
        let (w_first, w_last) = (QuaternionOrder::WFirst, QuaternionOrder::WLast);
        let okvis =
            "timestamp, p_WS_W_x, p_WS_W_y, p_WS_W_z, q_WS_x, q_WS_y, q_WS_z, q_WS_w, v_WS_W_x, v_WS_W_y";
        for (name, format, text) in [
            ("OKVIS2", by_header(w_last), format!("{okvis}\n{ns}, {}, 0, 0\n", last(", "))),
            ("Kimera", by_header(w_first), format!("#timestamp,x,y,z,qw,qx,qy,qz,vx,vy\n{ns},{first},0,0\n")),
            ("Basalt", PoseFormat::EurocPoses, format!("{EUROC}\n{ns},{first}\n")),
            (
                "OpenVINS",
                PoseFormat::Tum,
                format!("# timestamp(s) tx ty tz qx qy qz qw Pr11\n{s} {} 1e-4\n", last(" ")),
            ),
            ("ORB-SLAM3", PoseFormat::Tum, format!("{ns}.000000 {}\n", last(" "))),
            ("VINS", by_form(w_first), format!("{ns},{first},0.1,0,-0.1,\n")),
            ("VINS, loops", PoseFormat::EurocPoses, format!("{ns},{first},\n")),
            ("TUM, commas", by_form(w_last), format!("{s},{}\n", last(","))),
            ("TUM, tabs", PoseFormat::Tum, format!("{s}\t{} \r\n", last("\t"))),
            ("TUM, twice", PoseFormat::Tum, format!("{s} {0}\n{s} {0}\n", last(" "))),
            ("BOM", PoseFormat::Tum, format!("\u{feff}{s} {}\n", last(" "))),
        ] {
            let file = read(&text).unwrap();
            assert_eq!(file.format, format, "{name}");
            assert_eq!(file.repeated_rows, usize::from(name == "TUM, twice"));
            assert_eq!(file.poses.iter().map(|row| row.stamp_ns).collect::<Vec<_>>(), [ns], "{name}");
            assert!(file.poses[0].pose.local(&pose()).amax() < 1e-8, "{name}");
        }

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("poses");
        std::fs::write(&path, format!("{ns},{}\n", last(","))).unwrap();
        assert!(read_any(&path, &[]).is_err());
        let file = read_any_with(&path, &[], Some(w_last)).unwrap();
        assert!(file.poses[0].pose.local(&pose()).amax() < 1e-8);

        let file = read("1 0 0 0 0 1 0 0 0 0 1 0\n0 -1 0 4 1 0 0 5 0 0 1 6\n").unwrap();
        assert_eq!((file.format, file.poses[1].stamp_ns), (PoseFormat::Kitti, 1));
        assert_eq!(file.poses[1].pose.translation, Vector3::new(4.0, 5.0, 6.0));
        assert!((file.poses[1].pose.rotation.angle() - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
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
            ("5,0,0,0,1,0,0,0\n", "line 1", "--quaternion wxyz"),
            ("5,0,0,0,1,0,0,0,0,0,0,0,0,0,0,0,0\n", "line 1", "--quaternion wxyz"),
            ("#t,x,y,z,qw,qx,qy,qz\n5,0,0,0,1,0,0,0\n6,0,nan,0,1,0,0,0\n", "line 3", "column 3 is NaN"),
            ("#t,x,y,z,qw,qx,qy,qz\n5,0,0,0,1,0,0,0\n6,0,0,0,1,0,0\n", "line 3", "cut off: 7 of 8"),
            ("#t,x,y,z,qw,qx,qy,qz\nnan,0,0,0,1,0,0,0\n", "line 2", "column 1"),
            ("5,0,0,0,1,0,0,0,0.1,0.1\n6,0,0,0,1,0,0,0,0.1,nan\n", "line 2", "column 10 is NaN"),
            ("5,0,0,0,1,0,0,0,0.1,0.1\n6,0,0,0,1,0,0,0,0.1\n", "line 2", "cut off: 9 of 10"),
            ("1.0 0 0 0 0 0 0 1\n2.0 0 nan 0 0 0 0 1\n", "line 2", "column 3"),
            ("t;x;y;z;qx;qy;qz;qw\n1.0;0;0;0;0;0;0;1\n", "line 2", "semicolons"),
            ("1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 1\n3.0 0 0 0 0 0 0 1\n", "line 2", "cut off"),
            ("1.0 0 0 0 0 0 0 1\n1.0 0 0 5 0 0 0 1\n", "line 2", "another pose"),
            ("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 2 0\n", "line 2", "KITTI"),
            ("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0\n", "line 2", "cut off: 7 of 12"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(line) && error.contains(word), "{error}");
        }
        assert!(matches!(read("# nothing\n"), Err(SequenceError::Empty { .. })));
    }
}
