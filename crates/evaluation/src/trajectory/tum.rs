//! TUM trajectories: `t x y z qx qy qz qw`, one pose a line, seconds with 9 decimals.
//!
//! A double cannot hold a time of day to the nanosecond, so seconds are read and written as decimal numbers.

use super::StampedPose;
pub use super::decimal::{nanoseconds, seconds};
use super::layout::{Layout, LayoutError};
use super::rows::{self, Head, ReadRows};
use geometry::pose::Pose;
use sensors::{QuaternionOrder, SequenceError, read_written_lines};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// First line of the files that [`TumWriter`] writes.
pub(super) const HEADER: &str = "# timestamp [s] x y z [m] qx qy qz qw";

/// Reads a TUM trajectory. Empty lines, lines that begin with `#` and a header are skipped; so are rows that repeat the one
/// before. Times in nanoseconds are recognized by their size, columns that a header names by their names.
///
/// A file of [`TumWriter`] whose last line has no line feed was cut off by the end of its program: that line is left out,
/// with a warning.
///
/// # Errors
/// [`SequenceError`] with the file and the line: a row that is cut off or not finite, a quaternion without unit length,
/// time stamps out of order, no rows at all.
pub fn read(path: &Path) -> Result<Vec<StampedPose>, SequenceError> {
    read_text(path, &text_of(path)?, None).map(|(rows, _)| rows.poses)
}

/// Reads the text of a table of poses whose layout its header or its form shows.
///
/// # Arguments
/// * `quaternion`: the order of a quaternion of which neither tells it.
pub(super) fn read_text(
    path: &Path,
    text: &str,
    quaternion: Option<QuaternionOrder>,
) -> Result<(ReadRows, Layout), SequenceError> {
    let Some(head) = Head::of(text) else {
        return Err(SequenceError::empty(path, "a trajectory has lines `t x y z qx qy qz qw`"));
    };
    let wrong = |error: LayoutError| SequenceError::Row {
        path: path.to_path_buf(),
        line: head.line,
        problem: error.to_string(),
    };
    let layout = Layout::of(&head.first_row, head.columns, quaternion).map_err(wrong)?;
    Ok((rows::read(path, text, &layout)?, layout))
}

/// The text of a file; of one that a killed program wrote, the complete lines.
pub(super) fn text_of(path: &Path) -> Result<String, SequenceError> {
    let text = files::read_to_string(path).map_err(|source| match source.kind() {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajectory::layout::Layout;
    use crate::trajectory::rows::parse;
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn reading_undoes_writing(axis in prop::array::uniform3(-3.0..3.0f64), p in prop::array::uniform3(-1e3..1e3f64)) {
            let pose = Pose::new(UnitQuaternion::from_scaled_axis(axis.into()), p.into());
            let stamped = StampedPose { stamp_ns: 1_403_636_625_938_517_094, pose };
            let read = parse(&line(&stamped), &Layout::TUM).unwrap();
            prop_assert_eq!(read.stamp_ns, stamped.stamp_ns);
            prop_assert!((read.pose.translation - pose.translation).amax() <= 0.5e-9 + 1e-12);
            prop_assert!(read.pose.local(&pose).amax() < 1e-8);
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
            ("2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", 2, "sort"),
            ("2 0 0 0 0 0 0 1\n2 0 0 1 0 0 0 1\n", 2, "another pose"),
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
