//! Poses that the map gave while it contradicted the state, and whether they agree with each other.
//!
//! A wrong place contradicts the state as well. The poses of successive answers of the right place agree with the motion
//! between them, as odometry or the IMU alone measured it; but so do those of one picture that repeats elsewhere. What tells
//! them apart is at how many different places they were taken, see [`place_evidence`](super::place_evidence).

use crate::KeyframeId;
use crate::map_update::place_evidence::{PlaceEvidence, SeenPlace};
use crate::propagation::ImuState;
use geometry::{Pose, Rotation};
use nalgebra::{Matrix6, Vector3};
use std::collections::VecDeque;

/// Time over which the motion is kept, nanoseconds: fixes further apart are not compared.
const HISTORY_NS: i64 = 20_000_000_000;
/// Maximum number of images of which the motion is kept: 20 s at 50 Hz.
const MAX_MOTIONS: usize = 1000;
/// Fixes that are kept, the newest.
const MAX_FIXES: usize = 100;
/// Tolerance of the rotation between two fixes, rad: errors of their keyframes.
const ROTATION_TOLERANCE_RAD: f64 = 0.06;
/// The same for each second between them, rad/s: an unknown gyroscope bias.
const ROTATION_TOLERANCE_RAD_S: f64 = 0.1;
/// Tolerance of an acceleration, m/s^2: an unknown accelerometer bias, and the tilt of the fix.
const ACCELERATION_TOLERANCE: f64 = 0.6;
/// Maximum plausible speed, m/s.
const MAX_SPEED: f64 = 60.0;
/// Squared Mahalanobis distance between map and state beyond which a rejected or doubted fix is evidence against the state,
/// if those before it are of other keyframes: the mean of six degrees of freedom.
const EVIDENCE: f64 = 6.0;
/// Beyond which it contradicts the state: 99.99 %.
const FAR: f64 = 27.9;
/// Beyond which no error of a keyframe explains it: ten sigmas in one direction.
const CERTAIN: f64 = 100.0;
/// Odometry between two fixes may be wrong by this fraction of the distance to the state.
const ODOMETRY_FRACTION: f64 = 0.25;

/// A pose of the IMU in G by the map alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapFix {
    /// Time stamp of the image, nanoseconds.
    pub stamp_ns: i64,
    /// Pose by the map.
    pub global_from_imu: Pose,
    /// Pose in G according to the state.
    pub predicted: Pose,
    /// Pose in L according to the state.
    pub local_from_imu: Pose,
    /// Keyframe that it is relative to. Fixes relative to one keyframe share its error.
    pub keyframe: KeyframeId,
    /// Squared Mahalanobis distance between the pose by the map and that of the state.
    pub squared: f64,
    /// Standard deviation of the rotation, rad.
    pub sigma_rotation: f64,
    /// Standard deviation of the position, metres.
    pub sigma_position: f64,
    /// What its answer shows.
    pub seen: SeenPlace,
}

impl MapFix {
    /// Whether map and state are further apart than their covariances allow.
    pub fn is_far(&self) -> bool {
        self.squared > FAR
    }

    /// Whether two fixes are apart as odometry says, much better than either agrees with the state.
    pub fn agrees_by_odometry(&self, before: &Self) -> bool {
        let moved = before.local_from_imu.inverse() * self.local_from_imu;
        let (turned, shifted) = odometry_error(&before.global_from_imu, &moved, &self.global_from_imu);
        let from_state = self.predicted.local(&self.global_from_imu);
        let tolerance = 3.0 * self.sigma_position.hypot(before.sigma_position);
        turned <= ROTATION_TOLERANCE_RAD + 3.0 * self.sigma_rotation.hypot(before.sigma_rotation)
            && shifted <= tolerance.max(ODOMETRY_FRACTION * from_state.fixed_rows::<3>(3).norm()).min(2.0)
    }
}

/// How far a fix is from where odometry takes the one before, rad and metres.
///
/// # Arguments
/// * `before`, `after`: poses of the IMU in G.
/// * `moved`: the motion between them by odometry.
pub fn odometry_error(before: &Pose, moved: &Pose, after: &Pose) -> (f64, f64) {
    let apart = (*before * *moved).local(after);
    (apart.fixed_rows::<3>(0).norm(), apart.fixed_rows::<3>(3).norm())
}

/// Standard deviations of a pose's rotation (rad) and position (m), each along its worst axis, whatever its direction.
pub fn worst_sigmas(covariance: &Matrix6<f64>) -> (f64, f64) {
    let sigma = |begin: usize| {
        let block = covariance.fixed_view::<3, 3>(begin, begin).into_owned();
        let is_finite = block.iter().all(|value| value.is_finite());
        if is_finite { block.symmetric_eigenvalues().max().max(0.0).sqrt() } else { f64::INFINITY }
    };
    (sigma(0), sigma(3))
}

/// Motion by the IMU alone, without gravity: what an ideal accelerometer and gyroscope add up to.
#[derive(Clone, Copy, Debug)]
pub struct ImuMotion {
    from_ns: i64,
    to_ns: i64,
    rotation: Rotation,
    velocity: Vector3<f64>,
    position: Vector3<f64>,
}

impl ImuMotion {
    /// The motion that took one state to another.
    ///
    /// # Arguments
    /// * `gravity`: in L, m/s^2.
    pub fn between(before: &ImuState, after: &ImuState, stamps_ns: [i64; 2], gravity: &Vector3<f64>) -> Self {
        let [from_ns, to_ns] = stamps_ns;
        let seconds = (to_ns - from_ns) as f64 * 1e-9;
        let (start, end) = (&before.local_from_imu, &after.local_from_imu);
        let back = start.rotation.inverse();
        let fallen = gravity * (0.5 * seconds * seconds);
        Self {
            from_ns,
            to_ns,
            rotation: back * end.rotation,
            velocity: back * (after.velocity - before.velocity - gravity * seconds),
            position: back * (end.translation - start.translation - before.velocity * seconds - fallen),
        }
    }

    fn seconds(&self) -> f64 {
        (self.to_ns - self.from_ns) as f64 * 1e-9
    }

    fn then(&self, next: &Self) -> Self {
        Self {
            from_ns: self.from_ns,
            to_ns: next.to_ns,
            rotation: self.rotation * next.rotation,
            velocity: self.velocity + self.rotation * next.velocity,
            position: self.position + self.velocity * next.seconds() + self.rotation * next.position,
        }
    }
}

/// The newest fixes that contradict the state and agree with each other, and the motion since the first of them.
#[derive(Clone, Debug)]
pub struct MapFixes {
    fixes: Vec<MapFix>,
    motion: VecDeque<ImuMotion>,
}

impl Default for MapFixes {
    /// Without fixes. All memory that the motion ever needs is taken here: an image allocates nothing.
    fn default() -> Self {
        Self { fixes: Vec::new(), motion: VecDeque::with_capacity(MAX_MOTIONS) }
    }
}

/// Pose and velocity in G by fixes and IMU alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedMotion {
    /// Pose of the IMU in G.
    pub global_from_imu: Pose,
    /// Velocity in G, m/s.
    pub velocity: Vector3<f64>,
    /// Standard deviation of the rotation, rad.
    pub sigma_rotation: f64,
    /// Standard deviation of the position, metres.
    pub sigma_position: f64,
    /// Standard deviation of the velocity, m/s.
    pub sigma_velocity: f64,
}

impl MapFixes {
    /// Adds the motion up to an image.
    pub fn add_motion(&mut self, motion: ImuMotion) {
        let is_old = |oldest: &ImuMotion| motion.to_ns - oldest.from_ns > HISTORY_NS;
        while self.motion.len() == MAX_MOTIONS || self.motion.front().is_some_and(is_old) {
            self.motion.pop_front();
        }
        self.motion.push_back(motion);
    }

    /// Whether a fix shows more than the error of a keyframe that the map states: of hundreds of keyframes, one is wrong by
    /// four sigmas, and all answers with it contradict a right state in the same way.
    pub fn is_evidence(&self, fix: &MapFix) -> bool {
        let is_new = self.fixes.iter().all(|before| before.keyframe != fix.keyframe);
        fix.squared > if is_new { EVIDENCE } else { CERTAIN }
    }

    /// Adds a fix that contradicts the state. One that does not agree with those before replaces them.
    ///
    /// # Returns
    /// How many agree, this one included.
    pub fn add(&mut self, fix: MapFix) -> usize {
        let agrees = self
            .fixes
            .last()
            .is_some_and(|before| fix.agrees_by_odometry(before) || self.agrees_by_imu(before, &fix));
        if !agrees {
            self.fixes.clear();
        }
        if self.fixes.len() == MAX_FIXES {
            self.fixes.remove(0);
        }
        self.fixes.push(fix);
        self.fixes.len()
    }

    /// Forgets the fixes: the map agreed with the state.
    pub fn clear(&mut self) {
        self.fixes.clear();
    }

    /// Number of fixes that agree with each other.
    pub fn len(&self) -> usize {
        self.fixes.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.fixes.is_empty()
    }

    /// Logarithm of the odds of the fixes: of the different places that they show.
    pub fn log_odds(&self) -> f64 {
        self.evidence().log_odds()
    }

    /// The different places that the fixes show.
    pub fn evidence(&self) -> PlaceEvidence {
        self.fixes.iter().map(|fix| fix.seen).collect()
    }

    /// Whether the newest fixes agree with odometry: only `global_from_local` is wrong.
    pub fn agree_by_odometry(&self, count: usize) -> bool {
        let newest = &self.fixes[self.fixes.len().saturating_sub(count)..];
        newest.len() >= count && newest.windows(2).all(|pair| pair[1].agrees_by_odometry(&pair[0]))
    }

    /// Mean angle between gravity by the newest fixes and by the state, rad.
    ///
    /// # Arguments
    /// * `gravity`: in G.
    pub fn tilt(&self, gravity: &Vector3<f64>, count: usize) -> f64 {
        let newest = &self.fixes[self.fixes.len().saturating_sub(count)..];
        let in_local = |fix: &MapFix| {
            fix.local_from_imu.rotation * (fix.global_from_imu.rotation.inverse() * gravity.normalize())
        };
        newest.iter().map(in_local).sum::<Vector3<f64>>().angle(&-Vector3::z())
    }

    /// Whether the rotation between two fixes is that of the gyroscope.
    fn agrees_by_imu(&self, before: &MapFix, after: &MapFix) -> bool {
        let Some(motion) = self.motion_between(before.stamp_ns, after.stamp_ns) else { return false };
        let turned = before.global_from_imu.rotation.inverse() * after.global_from_imu.rotation;
        let tolerance = ROTATION_TOLERANCE_RAD
            + 3.0 * before.sigma_rotation.hypot(after.sigma_rotation)
            + ROTATION_TOLERANCE_RAD_S * motion.seconds();
        turned.angle_to(&motion.rotation) <= tolerance
    }

    fn motion_between(&self, from_ns: i64, to_ns: i64) -> Option<ImuMotion> {
        let parts = self.motion.iter().filter(|part| part.from_ns >= from_ns && part.to_ns <= to_ns);
        let motion = parts.copied().reduce(|sum, part| sum.then(&part))?;
        (motion.from_ns == from_ns && motion.to_ns == to_ns).then_some(motion)
    }

    /// Velocity at the second of two fixes, and its standard deviation.
    fn velocity(&self, pair: [&MapFix; 2], gravity: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
        let [before, after] = pair;
        let motion = self.motion_between(before.stamp_ns, after.stamp_ns)?;
        let seconds = motion.seconds();
        let rotation = before.global_from_imu.rotation;
        let moved = after.global_from_imu.translation - before.global_from_imu.translation;
        let free = moved - gravity * (0.5 * seconds * seconds) - rotation * motion.position;
        let velocity = free / seconds + gravity * seconds + rotation * motion.velocity;
        let tilt = before.sigma_rotation * gravity.norm();
        let sigma = (after.sigma_position.hypot(before.sigma_position) / seconds)
            .hypot(0.5 * seconds * (tilt + 0.3 * ACCELERATION_TOLERANCE));
        Some((velocity, sigma))
    }

    /// Pose and velocity now by the newest three fixes and the IMU; `None` unless the fixes agree with one motion.
    ///
    /// # Arguments
    /// * `gravity`: in G, m/s^2.
    /// * `now_ns`: time stamp of the newest image; the motion is known up to there.
    pub fn fixed_motion(&self, gravity: &Vector3<f64>, now_ns: i64) -> Option<FixedMotion> {
        let [.., first, second, third] = self.fixes.as_slice() else { return None };
        let (velocity, sigma) = self.velocity([second, third], gravity)?;
        let (earlier, sigma_earlier) = self.velocity([first, second], gravity)?;
        let motion = self.motion_between(second.stamp_ns, third.stamp_ns)?;
        let rotation = second.global_from_imu.rotation;
        let expected = earlier + gravity * motion.seconds() + rotation * motion.velocity;
        let tolerance = 3.0 * sigma.hypot(sigma_earlier) + ACCELERATION_TOLERANCE * motion.seconds();
        if (velocity - expected).norm() > tolerance || velocity.norm() > MAX_SPEED {
            return None;
        }
        let fixed = FixedMotion {
            global_from_imu: third.global_from_imu,
            velocity,
            sigma_rotation: third.sigma_rotation,
            sigma_position: third.sigma_position,
            sigma_velocity: sigma,
        };
        if third.stamp_ns == now_ns {
            return Some(fixed);
        }
        let since = self.motion_between(third.stamp_ns, now_ns)?;
        let (seconds, rotation) = (since.seconds(), third.global_from_imu.rotation);
        let position = third.global_from_imu.translation
            + velocity * seconds
            + gravity * (0.5 * seconds * seconds)
            + rotation * since.position;
        Some(FixedMotion {
            global_from_imu: Pose::new(rotation * since.rotation, position),
            velocity: velocity + gravity * seconds + rotation * since.velocity,
            sigma_position: third.sigma_position.hypot(sigma * seconds),
            ..fixed
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// The worst axis is not one of G's.
    #[test]
    fn the_worst_axis_does_not_depend_on_the_axes_of_the_map() {
        let (short, long) = (Vector3::new(1e-4, 1e-4, 4e-4), Vector3::new(1e-4, 1e-4, 0.04));
        for (yaw, pitch) in [(0.0, 0.0), (0.8, 0.0), (0.8, 0.6), (2.0, -1.2)] {
            let turn = Rotation::from_euler_angles(0.0, pitch, yaw).to_rotation_matrix().into_inner();
            let turned =
                |variances: &Vector3<f64>| turn * Matrix3::from_diagonal(variances) * turn.transpose();
            let mut covariance = Matrix6::zeros();
            covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&turned(&short));
            covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&turned(&long));
            let (rotation, position) = worst_sigmas(&covariance);
            assert!((rotation - 0.02).abs() < 1e-9 && (position - 0.2).abs() < 1e-9, "{rotation} {position}");
        }
        let unknown = Matrix6::identity() * f64::NAN;
        assert!(worst_sigmas(&unknown).1.is_infinite());
    }

    fn fix(keyframe: KeyframeId, squared: f64) -> MapFix {
        MapFix {
            stamp_ns: 0,
            global_from_imu: Pose::identity(),
            predicted: Pose::identity(),
            local_from_imu: Pose::identity(),
            keyframe,
            squared,
            sigma_rotation: 0.01,
            sigma_position: 0.1,
            seen: SeenPlace::of(&[Vector3::zeros()], 1.0, 0.0),
        }
    }

    #[test]
    fn one_keyframe_is_no_evidence_twice_unless_no_error_of_it_explains_the_distance() {
        let mut fixes = MapFixes::default();
        assert!(!fixes.is_evidence(&fix(1, 5.0)), "as expected");
        assert!(fixes.is_evidence(&fix(1, 20.0)));
        fixes.add(fix(1, 20.0));
        assert!(!fixes.is_evidence(&fix(1, 40.0)), "the same keyframe");
        assert!(fixes.is_evidence(&fix(1, 200.0)));
        assert!(fixes.is_evidence(&fix(2, 20.0)));
        assert!(!fixes.is_evidence(&fix(3, f64::NAN)));
    }
}
