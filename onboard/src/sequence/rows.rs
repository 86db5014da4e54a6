//! The tables with one row an instant: IMU, ground truth, reference poses.

use super::error::SequenceError;
use super::table::{Row, Table, check_order};
use crate::estimator::ImuSample;
use geometry::pose::Pose;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::path::Path;

/// How far a written quaternion's length may be from 1; files round to 4 to 9 decimals.
const QUATERNION_TOLERANCE: f64 = 1e-2;

/// One row of ground truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthRow {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// The IMU in the truth's frame: `truth_from_imu`.
    pub pose: Pose,
    /// Velocity of the IMU in the truth's frame, m/s, where known.
    pub velocity: Option<Vector3<f64>>,
    /// Bias of the gyroscope, rad/s, where known.
    pub gyroscope_bias: Option<Vector3<f64>>,
    /// Bias of the accelerometer, m/s^2, where known.
    pub accelerometer_bias: Option<Vector3<f64>>,
}

/// A pose of the IMU in the map's frame as a mapping system gave it, imperfect by the stated sigmas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferencePose {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// The IMU in the map's frame: `global_from_imu`.
    pub pose: Pose,
    /// Standard deviation of the rotation about each axis, rad.
    pub sigma_theta: f64,
    /// Standard deviation of the position along each axis, metres.
    pub sigma_p: f64,
}

/// Reads the IMU's `data.csv`.
pub(crate) fn read_imu_samples(path: &Path) -> Result<Vec<ImuSample>, SequenceError> {
    let advice = "it holds the IMU's samples; delete imu0 altogether if there was no IMU";
    let mut table = Table::open(path, advice)?;
    let mut samples: Vec<ImuSample> = Vec::new();
    while let Some(row) = table.next_row()? {
        row.require(7)?;
        let stamp_ns = row.stamp()?;
        check_order(&row, samples.last().map(|sample| sample.stamp_ns), stamp_ns)?;
        let [w_x, w_y, w_z, a_x, a_y, a_z] = row.finite_array(1)?;
        samples.push(ImuSample {
            stamp_ns,
            gyroscope: Vector3::new(w_x, w_y, w_z),
            accelerometer: Vector3::new(a_x, a_y, a_z),
        });
    }
    if samples.is_empty() {
        return Err(SequenceError::empty(path, advice));
    }
    Ok(samples)
}

/// Reads ground truth in EuRoC's layout: time, position, quaternion (w first), and where known velocity and biases.
///
/// Velocities and biases that are `nan` or left out are unknown; a pose that is not finite is an error.
///
/// # Errors
/// [`SequenceError`] with the file and the line.
pub fn read_groundtruth(path: &Path) -> Result<Vec<TruthRow>, SequenceError> {
    let mut table = Table::open(path, "it holds the ground truth")?;
    let mut rows: Vec<TruthRow> = Vec::new();
    while let Some(row) = table.next_row()? {
        row.require(8)?;
        if row.len() > 8 {
            row.require(17)?;
        }
        let stamp_ns = row.stamp()?;
        check_order(&row, rows.last().map(|before| before.stamp_ns), stamp_ns)?;
        rows.push(TruthRow {
            stamp_ns,
            pose: pose(&row, 1)?,
            velocity: known(&row, 8)?,
            gyroscope_bias: known(&row, 11)?,
            accelerometer_bias: known(&row, 14)?,
        });
    }
    if rows.is_empty() {
        return Err(SequenceError::empty(path, "delete it if the truth is not known"));
    }
    Ok(rows)
}

/// Reads `reference_poses.csv`.
///
/// # Errors
/// [`SequenceError`] with the file and the line.
pub fn read_reference_poses(path: &Path) -> Result<Vec<ReferencePose>, SequenceError> {
    let mut table = Table::open(path, "it holds the poses to build a map from")?;
    let mut poses: Vec<ReferencePose> = Vec::new();
    while let Some(row) = table.next_row()? {
        row.require(10)?;
        let stamp_ns = row.stamp()?;
        check_order(&row, poses.last().map(|before| before.stamp_ns), stamp_ns)?;
        let [sigma_theta, sigma_p] = row.finite_array(8)?;
        if sigma_theta <= 0.0 || sigma_p <= 0.0 {
            return Err(row.wrong("a standard deviation is not positive: say how uncertain the pose is"));
        }
        poses.push(ReferencePose { stamp_ns, pose: pose(&row, 1)?, sigma_theta, sigma_p });
    }
    if poses.is_empty() {
        return Err(SequenceError::empty(path, "delete it if there are no reference poses"));
    }
    Ok(poses)
}

/// Position and Hamilton quaternion (w first) from `column` on.
pub(crate) fn pose(row: &Row<'_>, column: usize) -> Result<Pose, SequenceError> {
    let [p_x, p_y, p_z, q_w, q_x, q_y, q_z] = row.finite_array(column)?;
    let quaternion = Quaternion::new(q_w, q_x, q_y, q_z);
    if (quaternion.norm() - 1.0).abs() > QUATERNION_TOLERANCE {
        return Err(row.wrong(format!(
            "the quaternion has length {:.3} instead of 1: check the order of the columns",
            quaternion.norm()
        )));
    }
    Ok(Pose::new(UnitQuaternion::new_normalize(quaternion), Vector3::new(p_x, p_y, p_z)))
}

/// Three numbers from `column` on, or nothing where one is `nan` or the columns are not there.
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
