//! The tables with one row an instant: IMU, ground truth, reference poses.

use super::stamps::TableStamps;
use crate::gnss_intake::{GnssIntake, GnssProblem};
use crate::pose_columns::{PoseColumns, QuaternionOrder};
use crate::row_order::RowOrder;
use crate::rows::Stamped;
use crate::table::{Row, Table, check_order};
use crate::wheel_intake::{WheelIntake, WheelProblem};
use crate::{
    GnssReading, ImuSample, ReferencePose, ReferencePosition, SequenceError, TruthRow, WheelReading,
};
use geometry::pose::Pose;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use types::MAX_WHEELS;

/// How far a written quaternion's length may be from 1; files round to 4 to 9 decimals.
const QUATERNION_TOLERANCE: f64 = 1e-2;

/// A row of a table that has one row an instant.
pub(crate) trait TimedRow: Stamped + Sized {
    /// What the table is for; part of the error when it is missing.
    const PURPOSE: &'static str;
    /// What to do about a table without rows.
    const IF_EMPTY: &'static str;

    /// Parses a row.
    fn read(row: &Row<'_>) -> Result<Self, SequenceError>;
}

/// Iterates over the rows of a table in order of time. Ends with the first error.
pub(crate) struct TimedRows<T> {
    path: PathBuf,
    /// `None` after the last row or an error.
    table: Option<Table>,
    before: Option<i64>,
    row: PhantomData<T>,
}

impl<T: TimedRow> TimedRows<T> {
    /// Opens the table, and says what is odd about its stamps.
    pub(crate) fn open(path: &Path) -> Result<Self, SequenceError> {
        Self::open_in_order(path, &TableStamps::read(path).order)
    }

    /// Opens the table whose stamps were read.
    pub(super) fn open_in_order(path: &Path, order: &RowOrder) -> Result<Self, SequenceError> {
        let table = Some(Table::open_in_order(path, T::PURPOSE, order)?);
        Ok(Self { path: path.to_path_buf(), table, before: None, row: PhantomData })
    }

    fn read_next(&mut self) -> Result<Option<T>, SequenceError> {
        let Some(table) = &mut self.table else { return Ok(None) };
        if table.next_row()?.is_none() {
            let empty = self.before.is_none();
            return if empty { Err(SequenceError::empty(&self.path, T::IF_EMPTY)) } else { Ok(None) };
        }
        let row = table.row();
        let value = T::read(&row)?;
        check_order(&row, self.before.replace(value.stamp_ns()), value.stamp_ns())?;
        Ok(Some(value))
    }
}

impl<T: TimedRow> Iterator for TimedRows<T> {
    type Item = Result<T, SequenceError>;

    fn next(&mut self) -> Option<Self::Item> {
        let next = self.read_next();
        if !matches!(next, Ok(Some(_))) {
            self.table = None;
        }
        next.transpose()
    }
}

/// A row of the IMU's `data.csv`.
impl TimedRow for ImuSample {
    const PURPOSE: &'static str = "it holds the IMU's samples; delete imu0 altogether if there was no IMU";
    const IF_EMPTY: &'static str = Self::PURPOSE;

    fn read(row: &Row<'_>) -> Result<Self, SequenceError> {
        row.require(7)?;
        let stamp_ns = row.stamp()?;
        let [w_x, w_y, w_z, a_x, a_y, a_z] = row.finite_array(1)?;
        let (gyroscope, accelerometer) = (Vector3::new(w_x, w_y, w_z), Vector3::new(a_x, a_y, a_z));
        Ok(Self { stamp_ns, gyroscope, accelerometer })
    }
}

/// The speeds or counts of the wheels.
pub(super) struct WheelRow {
    stamp_ns: i64,
    values: Vec<f64>,
    line: u64,
}

impl Stamped for WheelRow {
    fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }
}

impl TimedRow for WheelRow {
    const PURPOSE: &'static str =
        "it holds the speeds of the wheels; delete wheels0 altogether if there were none";
    const IF_EMPTY: &'static str = Self::PURPOSE;

    fn read(row: &Row<'_>) -> Result<Self, SequenceError> {
        row.require(3)?;
        let columns = 1..row.len().min(1 + MAX_WHEELS);
        let values = columns.map(|column| row.finite(column)).collect::<Result<_, _>>()?;
        Ok(Self { stamp_ns: row.stamp()?, values, line: row.line() })
    }
}

impl WheelRow {
    /// The row as a reading; none of the first row of counters.
    pub(super) fn wheel_reading(
        self,
        path: &Path,
        intake: &mut WheelIntake,
    ) -> Result<Option<WheelReading>, SequenceError> {
        let wrong = |problem: WheelProblem| SequenceError::Row {
            path: path.to_path_buf(),
            line: self.line,
            problem: problem.to_string(),
        };
        intake.take(self.stamp_ns, &self.values).map_err(wrong)
    }
}

impl TimedRow for TruthRow {
    const PURPOSE: &'static str = "it holds the ground truth";
    const IF_EMPTY: &'static str = "delete it if the truth is not known";

    fn read(row: &Row<'_>) -> Result<Self, SequenceError> {
        row.require(8)?;
        if row.len() > 8 {
            row.require(17)?;
        }
        Ok(Self {
            stamp_ns: row.stamp()?,
            pose: pose_after_stamp(row)?,
            velocity: known(row, 8)?,
            gyroscope_bias: known(row, 11)?,
            accelerometer_bias: known(row, 14)?,
        })
    }
}

impl TimedRow for ReferencePose {
    const PURPOSE: &'static str = "it holds the poses to build a map from";
    const IF_EMPTY: &'static str = "delete it if there are no reference poses";

    fn read(row: &Row<'_>) -> Result<Self, SequenceError> {
        row.require(10)?;
        let stamp_ns = row.stamp()?;
        let [sigma_theta_rad, sigma_p_m] = row.finite_array(8)?;
        if sigma_theta_rad <= 0.0 || sigma_p_m <= 0.0 {
            return Err(row.wrong("a standard deviation is not positive: say how uncertain the pose is"));
        }
        Ok(Self::isotropic(stamp_ns, pose_after_stamp(row)?, sigma_theta_rad, sigma_p_m))
    }
}

/// A position, and its standard deviations along the axes where the table has them.
pub(super) struct PositionRow {
    stamp_ns: i64,
    position: Vector3<f64>,
    sigmas_m: Option<Vector3<f64>>,
    line: u64,
}

impl Stamped for PositionRow {
    fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }
}

impl TimedRow for PositionRow {
    const PURPOSE: &'static str = "it holds positions";
    const IF_EMPTY: &'static str = "lines `ns,x,y,z` or `ns,x,y,z,sigma_x,sigma_y,sigma_z` were expected";

    fn read(row: &Row<'_>) -> Result<Self, SequenceError> {
        row.require(if row.len() > 4 { 7 } else { 4 })?;
        let sigmas_m = (row.len() > 4).then(|| row.finite_array(4)).transpose()?.map(Vector3::from);
        if sigmas_m.is_some_and(|sigmas| sigmas.min() <= 0.0) {
            return Err(row.wrong("a standard deviation is not positive: say how uncertain the position is"));
        }
        Ok(Self {
            stamp_ns: row.stamp()?,
            position: Vector3::from(row.finite_array(1)?),
            sigmas_m,
            line: row.line(),
        })
    }
}

impl PositionRow {
    /// The row of a table of GNSS as a reading.
    pub(super) fn gnss_reading(self, path: &Path, intake: &GnssIntake) -> Result<GnssReading, SequenceError> {
        let reading = intake.take(self.stamp_ns, &self.position, self.sigmas_m.map(covariance_of));
        let wrong = |problem: GnssProblem| SequenceError::Row {
            path: path.to_path_buf(),
            line: self.line,
            problem: problem.to_string(),
        };
        reading.map_err(wrong)
    }
}

/// Of independent errors.
fn covariance_of(sigmas_m: Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_diagonal(&sigmas_m.component_mul(&sigmas_m))
}

/// Reads positions: `ns,x,y,z`, as EuRoC's `leica0/data.csv`, or `ns,x,y,z,sigma_x,sigma_y,sigma_z` (m).
///
/// # Arguments
/// * `sigma_p_m`: standard deviation along each axis, whatever the file states; `None` takes that of the file.
///
/// # Errors
/// [`SequenceError`] with the file and the line, also where no standard deviation is known.
pub fn read_reference_positions(
    path: &Path,
    sigma_p_m: Option<f64>,
) -> Result<Vec<ReferencePosition>, SequenceError> {
    let rows: Vec<PositionRow> = TimedRows::open(path)?.collect::<Result<_, _>>()?;
    let position = |row: PositionRow| {
        let unknown = || SequenceError::Row {
            path: path.to_path_buf(),
            line: row.line,
            problem: "no standard deviations: add three columns of them, or state that of all positions"
                .to_owned(),
        };
        let sigmas = sigma_p_m.map(Vector3::repeat).or(row.sigmas_m).ok_or_else(unknown)?;
        let covariance = covariance_of(sigmas);
        Ok(ReferencePosition { stamp_ns: row.stamp_ns, position: row.position, covariance })
    };
    rows.into_iter().map(position).collect()
}

/// Reads ground truth in EuRoC's layout: time, position, quaternion (w first), and where known velocity and biases.
///
/// Velocities and biases that are `nan` or left out are unknown; a pose that is not finite is an error.
///
/// # Errors
/// [`SequenceError`] with the file and the line.
pub fn read_groundtruth(path: &Path) -> Result<Vec<TruthRow>, SequenceError> {
    TimedRows::open(path)?.collect()
}

/// Reads `reference_poses.csv`.
///
/// # Errors
/// [`SequenceError`] with the file and the line.
pub fn read_reference_poses(path: &Path) -> Result<Vec<ReferencePose>, SequenceError> {
    TimedRows::open(path)?.collect()
}

/// The pose in columns 2 to 8, its quaternion w first unless the table's header says w last.
fn pose_after_stamp(row: &Row<'_>) -> Result<Pose, SequenceError> {
    match row.pose_columns() {
        Some(columns) if columns == PoseColumns::in_order(QuaternionOrder::WLast) => {
            let [x, y, z, q_x, q_y, q_z, q_w] = row.finite_array(1)?;
            pose_of([x, y, z], [q_w, q_x, q_y, q_z]).map_err(|problem| row.wrong(problem.to_string()))
        }
        _ => pose_cells(row, 1),
    }
}

/// Reads a pose from seven cells: position (metres), then Hamilton quaternion, w first.
///
/// # Arguments
/// * `column`: of the first of them, counted from 0.
///
/// # Errors
/// [`SequenceError::Row`]: a cell is missing or not finite, or the quaternion's length is not 1.
pub fn pose_cells(row: &Row<'_>, column: usize) -> Result<Pose, SequenceError> {
    let [p_x, p_y, p_z, q_w, q_x, q_y, q_z] = row.finite_array(column)?;
    pose_of([p_x, p_y, p_z], [q_w, q_x, q_y, q_z]).map_err(|problem| row.wrong(problem.to_string()))
}

/// A pose of written numbers.
///
/// # Arguments
/// * `position`: metres.
/// * `quaternion`: Hamilton, w first.
///
/// # Errors
/// The quaternion's length is not 1, in words.
pub fn pose_of(position: [f64; 3], [q_w, q_x, q_y, q_z]: [f64; 4]) -> Result<Pose, QuaternionLength> {
    let quaternion = Quaternion::new(q_w, q_x, q_y, q_z);
    let norm = quaternion.norm();
    if (norm - 1.0).abs() > QUATERNION_TOLERANCE {
        return Err(QuaternionLength { norm });
    }
    Ok(Pose::new(UnitQuaternion::new_normalize(quaternion), Vector3::from(position)))
}

/// Four numbers that are no rotation.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the quaternion has length {norm:.3} instead of 1: check the order of the columns")]
pub struct QuaternionLength {
    /// Its length.
    pub norm: f64,
}

/// Three numbers from `column` on; `None` where one is `nan` or the columns are absent.
fn known(row: &Row<'_>, column: usize) -> Result<Option<Vector3<f64>>, SequenceError> {
    if row.len() <= column {
        return Ok(None);
    }
    let vector = Vector3::new(row.parse(column)?, row.parse(column + 1)?, row.parse(column + 2)?);
    if vector.iter().any(|value: &f64| value.is_infinite()) {
        return Err(row.wrong("a velocity or bias is infinite: write nan where it is not known"));
    }
    Ok(vector.iter().all(|value| value.is_finite()).then_some(vector))
}
