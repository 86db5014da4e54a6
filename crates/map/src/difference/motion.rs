//! How far a map moved as a whole.

use geometry::Pose;
use protocol::StatedChange;

/// The motion of a map, summed over the keyframes that both versions have.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motion {
    keyframes: usize,
    squared_angle: f64,
    squared_distance: f64,
}

impl Motion {
    /// Adds a keyframe that both versions have.
    pub(super) fn add(&mut self, before: &Pose, now: &Pose) {
        self.keyframes += 1;
        self.squared_angle += before.rotation.angle_to(&now.rotation).powi(2);
        self.squared_distance += (now.translation - before.translation).norm_squared();
    }

    /// Adds keyframes that did not move.
    pub(super) fn add_unmoved(&mut self, keyframes: usize) {
        self.keyframes += keyframes;
    }

    /// The size of the motion; `None` if no keyframe is in both versions.
    pub(super) fn size(&self) -> Option<StatedChange> {
        let per_axis = |squared: f64| (squared / (3 * self.keyframes) as f64).sqrt();
        (self.keyframes > 0).then(|| StatedChange {
            sigma_theta_rad: per_axis(self.squared_angle),
            sigma_p_m: per_axis(self.squared_distance),
        })
    }
}
