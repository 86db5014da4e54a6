//! The reference poses at the time of an image.

use sensors::ReferencePose;

/// Poses further apart than this are not interpolated between (ns): a robot can move arbitrarily in between.
const MAX_GAP_NS: i64 = 110_000_000;

/// Reference poses, ordered by time.
pub(super) struct ReferencePoses {
    poses: Vec<ReferencePose>,
}

impl ReferencePoses {
    /// Poses in any order.
    pub(super) fn new(poses: &[ReferencePose]) -> ReferencePoses {
        let mut poses = poses.to_vec();
        poses.sort_by_key(|pose| pose.stamp_ns);
        ReferencePoses { poses }
    }

    /// The pose at a time, interpolated where it lies between two given ones at most 0.11 s apart.
    ///
    /// The error of the interpolated pose is `(1 - f) e_a + f e_b`; whatever the correlation of the two, its covariance
    /// is at most `(1 - f) P_a + f P_b`, which is taken.
    pub(super) fn at(&self, stamp_ns: i64) -> Option<ReferencePose> {
        let next = self.poses.partition_point(|pose| pose.stamp_ns < stamp_ns);
        let after = self.poses.get(next)?;
        if after.stamp_ns == stamp_ns {
            return Some(*after);
        }
        let before = self.poses.get(next.checked_sub(1)?)?;
        let gap_ns = after.stamp_ns - before.stamp_ns;
        if gap_ns > MAX_GAP_NS {
            return None;
        }
        let fraction = (stamp_ns - before.stamp_ns) as f64 / gap_ns as f64;
        Some(ReferencePose {
            stamp_ns,
            pose: before.pose.interpolate(&after.pose, fraction),
            covariance: before.covariance * (1.0 - fraction) + after.covariance * fraction,
        })
    }
}
