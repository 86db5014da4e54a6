//! The rows of a table of poses whose layout is known.

use super::StampedPose;
use super::decimal::{decimal, seconds};
use super::layout::{KITTI_COLUMNS, Layout, cells};
use geometry::pose::Pose;
use nalgebra::{Matrix3, Matrix3x4, Rotation3, UnitQuaternion};
use sensors::{PoseColumns, QuaternionLength, SequenceError, pose_of};
use std::path::Path;
use thiserror::Error;

/// How far the columns of a written rotation matrix may be from unit length and right angles.
const ROTATION_TOLERANCE: f64 = 1e-2;
/// Two poses at one time that differ by less (rad, m) are one pose that was written twice.
const SAME_POSE: f64 = 1e-6;

/// The rows of a table.
#[derive(Debug)]
pub(super) struct ReadRows {
    /// The poses, in order of time.
    pub(super) poses: Vec<StampedPose>,
    /// Rows that repeat the one before, left out.
    pub(super) repeated: usize,
}

/// The beginning of a table.
#[derive(Debug)]
pub(super) struct Head {
    pub(super) first_row: String,
    /// Line of the first row, counted from 1.
    pub(super) line: u64,
    /// The columns that the header names.
    pub(super) columns: Option<PoseColumns>,
}

impl Head {
    /// The header and the first row of a text; `None` without any row.
    pub(super) fn of(text: &str) -> Option<Self> {
        let (index, first_row) = rows(text).next()?;
        let columns = text.lines().take(index).filter_map(PoseColumns::of_header).last();
        Some(Self { first_row: first_row.to_owned(), line: index as u64 + 1, columns })
    }
}

/// Why a row is not a pose.
#[derive(Debug, PartialEq, Error)]
pub(super) enum RowProblem {
    #[error("its time does not come after {}: sort the file by time", seconds(*before_ns))]
    Order { before_ns: i64 },
    #[error("it is another pose at the time of the row before it, {}: delete one of them", seconds(*stamp_ns))]
    TwoPoses { stamp_ns: i64 },
    #[error("column {column}: \"{cell}\" is no time")]
    Time { column: usize, cell: String },
    #[error("the row is cut off: {found} of {wanted} columns are there; delete it or copy the file again")]
    CutOff { found: usize, wanted: usize },
    #[error("the columns are separated by semicolons: separate them by commas or blanks")]
    Semicolons,
    #[error("column {column}: \"{cell}\": {source}")]
    Number { column: usize, cell: String, source: std::num::ParseFloatError },
    #[error("column {column} is {value}: delete the row")]
    NotFinite { column: usize, value: f64 },
    #[error(transparent)]
    Quaternion(#[from] QuaternionLength),
    #[error("it is no rotation and position: KITTI has three rows of [R | t], 12 numbers")]
    Rotation,
}

/// Reads all rows of a layout.
///
/// # Errors
/// [`SequenceError`] with the file and the line.
pub(super) fn read(path: &Path, text: &str, layout: &Layout) -> Result<ReadRows, SequenceError> {
    let mut poses: Vec<StampedPose> = Vec::new();
    let mut repeated = 0;
    for (index, line) in rows(text) {
        let wrong = |problem: RowProblem| row_error(path, index, &problem);
        let row = parse(line, layout).map_err(wrong)?;
        match poses.last() {
            Some(before) if before.stamp_ns > row.stamp_ns => {
                return Err(wrong(RowProblem::Order { before_ns: before.stamp_ns }));
            }
            Some(before) if before.stamp_ns == row.stamp_ns => {
                if before.pose.local(&row.pose).amax() > SAME_POSE {
                    return Err(wrong(RowProblem::TwoPoses { stamp_ns: row.stamp_ns }));
                }
                repeated += 1;
            }
            _ => poses.push(row),
        }
    }
    if poses.is_empty() {
        return Err(SequenceError::empty(path, "a trajectory has lines `t x y z qx qy qz qw`"));
    }
    Ok(ReadRows { poses, repeated })
}

/// Reads poses without times, as KITTI has them. Each is stamped with the number of its row, from 0.
///
/// # Errors
/// [`SequenceError`] with the file and the line.
pub(super) fn read_kitti(path: &Path, text: &str) -> Result<Vec<StampedPose>, SequenceError> {
    let mut poses = Vec::new();
    for (index, line) in rows(text) {
        let pose = kitti_pose(line).map_err(|problem| row_error(path, index, &problem))?;
        poses.push(StampedPose { stamp_ns: poses.len() as i64, pose });
    }
    Ok(poses)
}

/// Whether a first row is KITTI's: a rotation matrix and a position, without a time.
pub(super) fn is_kitti(first: &str) -> bool {
    !first.contains(',')
        && first.split_ascii_whitespace().count() == KITTI_COLUMNS
        && !matches!(kitti_pose(first), Err(RowProblem::Rotation))
}

/// The lines that are neither empty nor a comment nor, before the first of them, a header.
fn rows(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut is_first = true;
    text.lines().enumerate().map(|(index, line)| (index, line.trim())).filter(move |(_, line)| {
        let is_row = !(is_comment(line) || is_first && is_header(line));
        is_first &= !is_row;
        is_row
    })
}

/// Whether a line is empty or a comment.
fn is_comment(line: &str) -> bool {
    line.is_empty() || line.trim_start_matches('\u{feff}').starts_with(['#', '%'])
}

/// Whether a line names columns: it begins with a letter and has no numbers.
fn is_header(line: &str) -> bool {
    let line = line.trim_start_matches(['\u{feff}', '"']);
    let is_number = |cell: &str| cell.parse::<f64>().is_ok();
    line.starts_with(|letter: char| letter.is_ascii_alphabetic())
        && !line.split([',', ' ', '\t']).any(is_number)
}

fn row_error(path: &Path, index: usize, problem: &RowProblem) -> SequenceError {
    SequenceError::Row { path: path.to_path_buf(), line: index as u64 + 1, problem: problem.to_string() }
}

/// One row.
pub(super) fn parse(line: &str, layout: &Layout) -> Result<StampedPose, RowProblem> {
    let cells = cells(line.trim_start_matches('\u{feff}'), layout.with_commas);
    let columns = &layout.columns;
    if let [cell] = cells[..]
        && cell.contains(';')
    {
        return Err(RowProblem::Semicolons);
    }
    if cells.len() < columns.width() {
        return Err(RowProblem::CutOff { found: cells.len(), wanted: columns.width() });
    }
    let stamp = cells[columns.stamp];
    let stamp_ns = decimal(stamp, layout.unit.places())
        .ok_or_else(|| RowProblem::Time { column: columns.stamp + 1, cell: stamp.to_owned() })?;
    let pose = pose_of(numbers(&cells, columns.position)?, numbers(&cells, columns.quaternion)?)?;
    Ok(StampedPose { stamp_ns, pose })
}

/// Finite numbers in some columns.
fn numbers<const N: usize>(cells: &[&str], columns: [usize; N]) -> Result<[f64; N], RowProblem> {
    let mut values = [0.0_f64; N];
    for (value, index) in values.iter_mut().zip(columns) {
        let (cell, column) = (cells[index], index + 1);
        *value =
            cell.parse().map_err(|source| RowProblem::Number { column, cell: cell.to_owned(), source })?;
        if !value.is_finite() {
            return Err(RowProblem::NotFinite { column, value: *value });
        }
    }
    Ok(values)
}

fn kitti_pose(line: &str) -> Result<Pose, RowProblem> {
    let cells: Vec<&str> = line.split_ascii_whitespace().collect();
    if cells.len() != KITTI_COLUMNS {
        return Err(RowProblem::CutOff { found: cells.len(), wanted: KITTI_COLUMNS });
    }
    let values: [f64; KITTI_COLUMNS] = numbers(&cells, std::array::from_fn(|column| column))?;
    let rows = Matrix3x4::from_row_slice(&values);
    let rotation: Matrix3<f64> = rows.fixed_columns::<3>(0).into_owned();
    let deviation = (rotation * rotation.transpose() - Matrix3::identity()).amax();
    if deviation > ROTATION_TOLERANCE || rotation.determinant() < 0.0 {
        return Err(RowProblem::Rotation);
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&rotation));
    Ok(Pose::new(rotation, rows.column(3).into_owned()))
}
