//! Where the unknowns of each view are in the error of all states.

use std::ops::Range;

/// Errors of a pose, `[δθ, δp]` in G.
pub const POSE: usize = 6;
/// Errors of a motion: velocity, bias of the gyroscope, bias of the accelerometer.
pub const MOTION: usize = 9;

/// The layout `[pose, motion]` of each view; views without readings of an IMU come last and have no motion.
#[derive(Clone, Copy, Debug)]
pub struct StateLayout {
    /// Number of views.
    pub views: usize,
    /// Number of views with a motion: the first ones.
    pub motions: usize,
}

impl StateLayout {
    /// Number of unknowns.
    pub fn dim(self) -> usize {
        POSE * self.views + MOTION * self.motions
    }

    /// The pose of a view.
    pub fn pose(self, view: usize) -> Range<usize> {
        let begin = POSE * view + MOTION * view.min(self.motions);
        begin..begin + POSE
    }

    /// The motion of a view.
    pub fn motion(self, view: usize) -> Range<usize> {
        let begin = self.pose(view).end;
        begin..begin + MOTION
    }

    /// Pose and motion of a view, 15 in the order of an IMU state.
    pub fn state(self, view: usize) -> Range<usize> {
        self.pose(view).start..self.motion(view).end
    }
}
