//! TUM trajectories: `t x y z qx qy qz qw`, one pose a line, seconds with 9 decimals.
//!
//! A double cannot hold a time of day to the nanosecond, so seconds are read and written as decimal numbers.

use super::StampedPose;
use geometry::pose::Pose;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use sensors::{SequenceError, read_written_lines};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// How far a written quaternion's length may be from 1.
const QUATERNION_TOLERANCE: f64 = 1e-2;
const NANOSECONDS: i64 = 1_000_000_000;
/// First line of the files that [`TumWriter`] writes.
pub(super) const HEADER: &str = "# timestamp [s] x y z [m] qx qy qz qw";

/// Reads a TUM trajectory. Empty lines, lines that begin with `#` and a header are skipped.
///
/// A file of [`TumWriter`] whose last line has no line feed was cut off by the end of its program: that line is left out,
/// with a warning.
///
/// # Errors
/// [`SequenceError`] with the file and the line: a row that is cut off or not finite, a quaternion without unit length,
/// time stamps out of order, no rows at all.
pub fn read(path: &Path) -> Result<Vec<StampedPose>, SequenceError> {
    let text = text_of(path)?;
    let mut poses: Vec<StampedPose> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        let is_header = poses.is_empty() && line.starts_with("timestamp");
        if line.is_empty() || line.starts_with('#') || is_header {
            continue;
        }
        let wrong = |problem: RowProblem| SequenceError::Row {
            path: path.to_path_buf(),
            line: index as u64 + 1,
            problem: problem.to_string(),
        };
        let pose = parse_line(line).map_err(wrong)?;
        if let Some(before) = poses.last().filter(|before| before.stamp_ns >= pose.stamp_ns) {
            return Err(wrong(RowProblem::Order { before_ns: before.stamp_ns }));
        }
        poses.push(pose);
    }
    if poses.is_empty() {
        return Err(SequenceError::empty(path, "a trajectory has lines `t x y z qx qy qz qw`"));
    }
    Ok(poses)
}

/// The text of a file; of one that a killed program wrote, the complete lines.
fn text_of(path: &Path) -> Result<String, SequenceError> {
    let text = std::fs::read_to_string(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => SequenceError::missing(path, "a trajectory was expected there"),
        _ => SequenceError::io(path, source),
    })?;
    if !text.starts_with(HEADER) || text.ends_with('\n') {
        return Ok(text);
    }
    Ok(read_written_lines(path, "a trajectory was expected there")?.text)
}

/// Writes a TUM trajectory pose by pose while a run goes on.
#[derive(Debug)]
pub struct TumWriter {
    path: PathBuf,
    out: BufWriter<File>,
}

impl TumWriter {
    /// Creates the file and writes its header.
    ///
    /// # Errors
    /// [`SequenceError::Io`] with the file.
    pub fn create(path: &Path) -> Result<Self, SequenceError> {
        let create = || {
            let mut out = BufWriter::new(File::create(path)?);
            writeln!(out, "{HEADER}")?;
            Ok(out)
        };
        let out = create().map_err(|source| SequenceError::io(path, source))?;
        Ok(Self { path: path.to_path_buf(), out })
    }

    /// Appends a pose.
    ///
    /// # Errors
    /// [`SequenceError::Io`] with the file.
    pub fn append(&mut self, pose: &StampedPose) -> Result<(), SequenceError> {
        writeln!(self.out, "{}", line(pose)).map_err(|source| SequenceError::io(&self.path, source))
    }

    /// Writes what is still buffered. Dropping the writer does so too, but cannot say that it failed.
    ///
    /// # Errors
    /// [`SequenceError::Io`] with the file.
    pub fn flush(&mut self) -> Result<(), SequenceError> {
        self.out.flush().map_err(|source| SequenceError::io(&self.path, source))
    }
}

/// Writes a TUM trajectory.
///
/// # Errors
/// [`SequenceError::Io`] with the file that could not be written.
pub fn write(path: &Path, poses: &[StampedPose]) -> Result<(), SequenceError> {
    let mut writer = TumWriter::create(path)?;
    poses.iter().try_for_each(|pose| writer.append(pose))?;
    writer.flush()
}

/// One line, without the line feed.
pub fn line(stamped: &StampedPose) -> String {
    let Pose { rotation, translation: p } = stamped.pose;
    let q = rotation.quaternion();
    let mut text = seconds(stamped.stamp_ns);
    for value in [p.x, p.y, p.z, q.i, q.j, q.k, q.w] {
        // Writing to a string cannot fail.
        let _ = write!(text, " {value:.9}");
    }
    text
}

/// Nanoseconds as seconds with 9 decimals.
pub fn seconds(stamp_ns: i64) -> String {
    let sign = if stamp_ns < 0 { "-" } else { "" };
    let magnitude = stamp_ns.unsigned_abs();
    let nanoseconds = NANOSECONDS.unsigned_abs();
    format!("{sign}{}.{:09}", magnitude / nanoseconds, magnitude % nanoseconds)
}

/// Seconds in decimal, with or without exponent, as nanoseconds; what lies below a nanosecond is rounded.
pub fn nanoseconds(text: &str) -> Option<i64> {
    let (mantissa, exponent) = match text.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok()?),
        None => (text, 0),
    };
    let (negative, mantissa) = match mantissa.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, mantissa.strip_prefix('+').unwrap_or(mantissa)),
    };
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    if whole.is_empty() && fraction.is_empty() {
        return None;
    }
    // The number is 0.d1 d2 d3 ... times 10^point seconds.
    let point = i32::try_from(whole.len()).ok()?.checked_add(exponent)?;
    let last = point.checked_add(9)?;
    let mut value: i64 = 0;
    let mut digits = whole.bytes().chain(fraction.bytes());
    for _ in 0..last.clamp(0, 400) {
        let digit = digits.next().unwrap_or(b'0');
        if !digit.is_ascii_digit() {
            return None;
        }
        value = value.checked_mul(10)?.checked_add(i64::from(digit - b'0'))?;
    }
    let rest: Vec<u8> = digits.collect();
    if !rest.iter().all(u8::is_ascii_digit) {
        return None;
    }
    if last >= 0 && rest.first().is_some_and(|digit| *digit >= b'5') {
        value = value.checked_add(1)?;
    }
    Some(if negative { -value } else { value })
}

/// Why a row is not a pose.
#[derive(Debug, PartialEq, Error)]
enum RowProblem {
    #[error("its time does not come after {}: sort the file by time", seconds(*before_ns))]
    Order { before_ns: i64 },
    #[error(
        "\"{0}\" is no time in seconds: with nanoseconds, separate the columns by commas (EuRoC's layout, q_w first)"
    )]
    Time(String),
    #[error("the row is cut off: `t x y z qx qy qz qw` are 8 numbers")]
    CutOff,
    #[error("column {column}: \"{cell}\": {source}")]
    Number { column: usize, cell: String, source: std::num::ParseFloatError },
    #[error("column {column} is {value}: delete the row")]
    NotFinite { column: usize, value: f64 },
    #[error("the quaternion has length {norm:.3} instead of 1: check the order of the columns")]
    Quaternion { norm: f64 },
}

fn parse_line(line: &str) -> Result<StampedPose, RowProblem> {
    let mut cells = line.split_ascii_whitespace();
    let stamp = cells.next().unwrap_or_default();
    let stamp_ns = nanoseconds(stamp).ok_or_else(|| RowProblem::Time(stamp.to_owned()))?;
    let mut values = [0.0_f64; 7];
    for (index, value) in values.iter_mut().enumerate() {
        let column = index + 2;
        let cell = cells.next().ok_or(RowProblem::CutOff)?;
        *value =
            cell.parse().map_err(|source| RowProblem::Number { column, cell: cell.to_owned(), source })?;
        if !value.is_finite() {
            return Err(RowProblem::NotFinite { column, value: *value });
        }
    }
    let [x, y, z, qx, qy, qz, qw] = values;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    if (quaternion.norm() - 1.0).abs() > QUATERNION_TOLERANCE {
        return Err(RowProblem::Quaternion { norm: quaternion.norm() });
    }
    let pose = Pose::new(UnitQuaternion::new_normalize(quaternion), Vector3::new(x, y, z));
    Ok(StampedPose { stamp_ns, pose })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_nanosecond_is_lost(stamp_ns in any::<i64>()) {
            prop_assume!(stamp_ns != i64::MIN);
            prop_assert_eq!(nanoseconds(&seconds(stamp_ns)), Some(stamp_ns));
        }

        #[test]
        fn no_text_makes_it_panic(text in "[-+0-9.eE]{0,24}") {
            let _ = nanoseconds(&text);
        }

        #[test]
        fn reading_undoes_writing(axis in prop::array::uniform3(-3.0..3.0f64), p in prop::array::uniform3(-1e3..1e3f64)) {
            let pose = Pose::new(UnitQuaternion::from_scaled_axis(axis.into()), p.into());
            let stamped = StampedPose { stamp_ns: 1_403_636_625_938_517_094, pose };
            let read = parse_line(&line(&stamped)).unwrap();
            prop_assert_eq!(read.stamp_ns, stamped.stamp_ns);
            prop_assert!((read.pose.translation - pose.translation).amax() <= 0.5e-9 + 1e-12);
            prop_assert!(read.pose.local(&pose).amax() < 1e-8);
        }
    }

    #[test]
    fn every_spelling_of_a_time_is_understood() {
        for (text, expected) in [
            ("1403636580.838555574", Some(1_403_636_580_838_555_574)),
            ("1.403636580838555574e+09", Some(1_403_636_580_838_555_574)),
            ("1403636580.83855", Some(1_403_636_580_838_550_000)),
            ("12", Some(12_000_000_000)),
            (".5", Some(500_000_000)),
            ("1e-9", Some(1)),
            ("0.0000000015", Some(2)),
            ("1e-12", Some(0)),
            ("-1.5", Some(-1_500_000_000)),
            ("1e99", None),
            ("", None),
            (".", None),
            ("abc", None),
            ("1.2.3", None),
            ("nan", None),
        ] {
            assert_eq!(nanoseconds(text), expected, "{text}");
        }
    }

    #[test]
    fn faults_are_named_with_their_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pose.tum");
        for (text, line, word) in [
            ("# t\n1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0\n", 3, "cut off"),
            ("1 0 0 nan 0 0 0 1\n", 1, "column 4"),
            ("1 0 0 0 1 1 1 1\n", 1, "quaternion"),
            ("2 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", 2, "sort"),
            ("x 0 0 0 0 0 0 1\n", 1, "time"),
        ] {
            std::fs::write(&path, text).unwrap();
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains(&format!("line {line}")) && error.contains(word), "{error}");
        }
        std::fs::write(&path, "# nothing\n").unwrap();
        assert!(matches!(read(&path), Err(SequenceError::Empty { .. })));
    }

    #[test]
    fn a_last_row_that_a_killed_run_cut_off_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pose.tum");
        let pose = |stamp_ns| StampedPose { stamp_ns, pose: Pose::identity() };
        write(&path, &[pose(1), pose(2)]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        // Also where only the last digits are missing: the row looks complete, but is not what was written.
        for cut in [1, 4, 9, 60] {
            std::fs::write(&path, &text[..text.len() - cut]).unwrap();
            assert_eq!(read(&path).unwrap(), [pose(1)], "{cut}");
        }
        std::fs::write(&path, text.replacen(" 1.000000000", "", 1)).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("line 2"));
        // Other programs may end their last line as they like.
        std::fs::write(&path, "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1").unwrap();
        assert_eq!(read(&path).unwrap().len(), 2);
    }
}
