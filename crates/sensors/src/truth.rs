//! Ground truth and its interpolation, and the reference poses of a mapping run.

use geometry::pose::Pose;
use geometry::uncertain_pose::isotropic_covariance;
use nalgebra::{Matrix3, Matrix6, Vector3};

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

impl TruthRow {
    /// A row of which only the pose is known.
    pub fn of_pose(stamp_ns: i64, pose: Pose) -> Self {
        Self { stamp_ns, pose, velocity: None, gyroscope_bias: None, accelerometer_bias: None }
    }
}

/// A pose of the IMU in the map's frame as a mapping system estimated it, with its stated covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferencePose {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// The IMU in the map's frame: `global_from_imu`.
    pub pose: Pose,
    /// Covariance of its error `[dtheta, dp]` in the map's frame (rad^2, rad m, m^2).
    pub covariance: Matrix6<f64>,
}

impl ReferencePose {
    /// A pose with the same standard deviation about each axis (rad), and along each axis (m).
    pub fn isotropic(stamp_ns: i64, pose: Pose, sigma_theta_rad: f64, sigma_p_m: f64) -> Self {
        Self { stamp_ns, pose, covariance: isotropic_covariance(sigma_theta_rad, sigma_p_m) }
    }

    /// The same pose, as certain as stated here: a standard deviation replaces the block of the rotation (rad) or of the position (m), and
    /// what that block was correlated with.
    #[must_use]
    pub fn with_sigmas(mut self, sigma_theta_rad: Option<f64>, sigma_p_m: Option<f64>) -> Self {
        for (first, sigma) in [(0, sigma_theta_rad), (3, sigma_p_m)] {
            let Some(sigma) = sigma else { continue };
            self.covariance.fixed_rows_mut::<3>(first).fill(0.0);
            self.covariance.fixed_columns_mut::<3>(first).fill(0.0);
            self.covariance.fixed_view_mut::<3, 3>(first, first).fill_diagonal(sigma * sigma);
        }
        self
    }

    /// The largest standard deviations of the rotation about an axis (rad) and of the position along an axis (m).
    pub fn largest_sigmas(&self) -> (f64, f64) {
        let sigma = |first: usize| self.covariance.diagonal().fixed_rows::<3>(first).max().sqrt();
        (sigma(0), sigma(3))
    }
}

/// A position of a point of the robot in the map's frame, for example of an antenna or of a total station's prism.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferencePosition {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// The point in the map's frame, metres.
    pub position: Vector3<f64>,
    /// Covariance of its error in the map's frame (m^2).
    pub covariance: Matrix3<f64>,
}

/// Ground truth as a function of time.
#[derive(Clone, Copy, Debug)]
pub struct TruthTrack<'a> {
    rows: &'a [TruthRow],
}

impl<'a> TruthTrack<'a> {
    /// Rows in order of time.
    pub fn new(rows: &'a [TruthRow]) -> Self {
        Self { rows }
    }

    /// `truth_from_imu` at an instant: rotation on the shortest arc, position on the straight line.
    ///
    /// `None` outside of the rows, and between two rows that are further apart than `max_gap_ns`.
    pub fn pose(&self, stamp_ns: i64, max_gap_ns: i64) -> Option<Pose> {
        let (a, b, weight) = self.neighbours(stamp_ns, max_gap_ns)?;
        Some(a.pose.interpolate(&b.pose, weight))
    }

    /// Velocity in the truth's frame at an instant, m/s, where both neighbours know it.
    pub fn velocity(&self, stamp_ns: i64, max_gap_ns: i64) -> Option<Vector3<f64>> {
        let (a, b, weight) = self.neighbours(stamp_ns, max_gap_ns)?;
        if weight == 0.0 {
            return a.velocity;
        }
        Some(a.velocity?.lerp(&b.velocity?, weight))
    }

    /// The rows around an instant and how far it is from the first to the second, 0 to 1.
    fn neighbours(&self, stamp_ns: i64, max_gap_ns: i64) -> Option<(&'a TruthRow, &'a TruthRow, f64)> {
        let after = self.rows.partition_point(|row| row.stamp_ns < stamp_ns);
        let b = self.rows.get(after)?;
        if b.stamp_ns == stamp_ns {
            return Some((b, b, 0.0));
        }
        let a = self.rows.get(after.checked_sub(1)?)?;
        let gap = b.stamp_ns - a.stamp_ns;
        (gap <= max_gap_ns).then(|| (a, b, (stamp_ns - a.stamp_ns) as f64 / gap as f64))
    }
}
