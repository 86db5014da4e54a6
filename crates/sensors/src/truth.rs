//! The ground truth at any instant, interpolated between its rows.

use super::rows::TruthRow;
use geometry::pose::Pose;
use nalgebra::Vector3;

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
