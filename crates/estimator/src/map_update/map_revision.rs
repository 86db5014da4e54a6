//! Map versions: announced changes of the map, and answers of other versions.
//!
//! # An announced change
//! `global_from_local` is kept, and its error is increased by the motion of the map at the robot. That motion is a pose error
//! of G at the position of the robot: G rotates about it by `τ` (rad, in L) and translates by `σ` (metres, in L). With `q`
//! the position of the robot in L and the error of `global_from_local` in L ([`retract_locally`](crate::state::retract_locally)),
//! ```text
//! R' = R Exp(τ),   p' = p + R (q + σ - Exp(τ) q)      so      e_θ = τ,   e_p = [q]ₓ τ + σ
//! Q = J diag(σ_θ² I, σ_p² I) Jᵀ,   J = [ I 0; [q]ₓ I ]
//! ```
//! The covariance of the robot's pose in G is increased by exactly the stated sizes, whatever its distance to the origin of
//! G. The noises of consecutive changes add up.
//!
//! # Where the motion of each keyframe is known
//! A change moves one corner of a map and leaves the rest where it is. By how much that moves the state is known: with the consider
//! sensitivities `M` of [`schmidt`](crate::schmidt) its error is `a = sum of M_j e_j + u`. Keyframe `j` was stated at `T_j` and is now
//! stated at `T_j` moved by `d_j`, so that `e_j = d_j + e'_j` with the error `e'_j` of the new version, and
//! ```text
//! a = sum of M_j d_j + sum of M_j e'_j + u
//! ```
//! The first sum is known, and the state is corrected by it. (`M` is that of the map's stated covariance, divided by its inflation.)
//! A robot that was localized by keyframes that stayed where they were is not corrected and does not become less certain; one that
//! was localized by those of the corner moves with them.
//!
//! What held keyframes do not explain (those that were removed, evicted, or changed before, and what else is known of
//! `global_from_local`) is the remainder of a law: where the whole map moves by `m`, `global_from_local` does, too. With the errors
//! `B_j m` of the keyframes and `J m` of the state, `J - sum of M_j B_j` is zero if all that the state knows of the map comes from
//! held keyframes. Times the stated size of the motion of the map as a whole it is process noise.
//!
//! # Held keyframes of the old version
//! * Keyframes that are unchanged in the new version have the same errors. They stay held, with their correlations; adding
//!   keyframes to a map has no cost.
//! * Keyframes that are changed or removed are invalidated. The errors of the new version may depend on theirs in any way,
//!   so the covariances of the state and of the new version are inflated until both can be used as independent
//!   ([`schmidt`](crate::schmidt)). This holds for equal and for new ids: both may be of the same images.
//! * The cross-covariances of new keyframes with unchanged ones are part of the new version's answers.
//!
//! # Answers of other versions
//! A change is applied when its announcement arrives. Later answers of another version to images from before that are
//! outdated and rejected. An answer of a new version may arrive before the announcement: such answers are rejected for
//! [`ANNOUNCEMENT_NS`]. Several servers of a map change over one after the other, so answers of an older version are rejected for
//! [`BEHIND_NS`], and the announcement of an older version is ignored unless it is of a change from the version in use. After that, or
//! where the announcement of a newer version is not of a change from the version in use (one was lost), the map is treated as a different
//! one: all keyframes are invalidated and `global_from_local` is initialized again.
//!
//! Answers of another map, as its identity tells, are rejected whatever their version.

use crate::KeyframeId;
use crate::state::POSE_DIM;
use geometry::Pose;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// Time after the first answer of a new version in which its announcement is waited for, nanoseconds of image time. Both
/// leave the server within milliseconds; in a recording played as fast as possible that can be a second.
pub const ANNOUNCEMENT_NS: i64 = 2_000_000_000;

/// Time in which a server that answers with an older version than the one in use is taken for one that is behind, nanoseconds of
/// image time: by default servers look for releases every 30 s.
pub const BEHIND_NS: i64 = 45_000_000_000;

/// Largest motion in a change that keeps `global_from_local`, metres per axis: beyond, its estimate says nothing, and a
/// covariance with such a variance beside those of centimetres is badly conditioned.
pub const MAX_LINEAR_CHANGE_M: f64 = 1000.0;

/// Motion of a map in a change: standard deviations of a pose error of G at any position in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChangeSize {
    /// Rotation, rad per axis.
    pub sigma_rotation_rad: f64,
    /// Position, metres per axis.
    pub sigma_position_m: f64,
}

/// Announcement of a new map version.
#[derive(Clone, Debug, PartialEq)]
pub struct MapRevision {
    /// The version before.
    pub from_version: u64,
    /// The new version.
    pub version: u64,
    /// Keyframes that were removed or whose pose, covariance or cross-covariances changed.
    pub changed_keyframes: Vec<KeyframeId>,
    /// Motion of the map, where it is known.
    pub size: Option<ChangeSize>,
    /// Motions of those of the changed keyframes that are in both versions. Without any, the map moves as a whole by `size`; a
    /// changed keyframe that is not here is one of which it is not known.
    pub keyframe_motions: Vec<KeyframeMotion>,
}

/// Motion of a keyframe from one version of the map to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyframeMotion {
    /// The keyframe.
    pub id: KeyframeId,
    /// `[δθ, δp]` in G, rad and metres: the pose of the new version is `R = Exp(δθ) R_old`, `p = p_old + δp`.
    pub motion: Vector6<f64>,
}

/// Effect of [`Estimator::map_changed`](crate::Estimator::map_changed).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RevisionEffect {
    /// `global_from_local` was kept, with process noise added.
    CarriedOver,
    /// The next answer of the new version initializes `global_from_local` again.
    Reinitialized,
    /// None: no map version is in use yet, or already this one or a newer one.
    None,
}

/// The map version in use.
#[derive(Clone, Debug)]
pub(crate) struct MapVersion {
    /// Version of the held keyframes.
    held: Option<u64>,
    /// Identity of the map that they belong to.
    identity: Option<u128>,
    /// Time of the newest image when that version came into use, nanoseconds.
    since_ns: i64,
    /// Another version that answered before its announcement, and the time of the state then, nanoseconds; none since an answer of
    /// the version in use.
    unannounced: Option<(u64, i64)>,
    /// Announced version that requires a new map initialization.
    reinitialize: Option<u64>,
}

impl Default for MapVersion {
    fn default() -> Self {
        Self { held: None, identity: None, since_ns: i64::MIN, unannounced: None, reinitialize: None }
    }
}

impl MapVersion {
    /// Version of the held keyframes.
    pub(crate) fn in_use(&self) -> Option<u64> {
        self.held
    }

    /// Time of the newest image when that version came into use, nanoseconds.
    pub(crate) fn since_ns(&self) -> i64 {
        self.since_ns
    }

    /// Requires a new map initialization by the next answer of `version`.
    pub(crate) fn reinitialize_with(&mut self, version: u64) {
        self.reinitialize = Some(version);
    }

    /// Notes an answer of the version in use: it is still served.
    pub(crate) fn note_answer(&mut self) {
        self.unannounced = None;
    }

    /// Whether an announced version is older than the one in use, and the announcement one of a change that came before.
    pub(crate) fn is_past(&self, from_version: u64, version: u64) -> bool {
        self.held.is_some_and(|held| version < held && from_version != held)
    }

    /// Whether the announcement of `version` is to be waited for, or that its server changes over.
    pub(crate) fn awaits_announcement(&mut self, version: u64, now_ns: i64) -> bool {
        if self.reinitialize == Some(version) {
            return false;
        }
        match self.unannounced {
            Some((other, since_ns)) if other == version => {
                let is_behind = self.held.is_some_and(|held| version < held);
                now_ns - since_ns < if is_behind { BEHIND_NS } else { ANNOUNCEMENT_NS }
            }
            _ => {
                self.unannounced = Some((version, now_ns));
                true
            }
        }
    }

    /// Sets the version in use.
    pub(crate) fn begin(&mut self, version: u64, since_ns: i64) {
        *self = Self { held: Some(version), identity: self.identity, since_ns, ..Self::default() };
    }

    /// Identity of the map in use.
    pub(crate) fn identity(&self) -> Option<u128> {
        self.identity
    }

    /// Sets the identity of the map in use.
    pub(crate) fn belong_to(&mut self, identity: u128) {
        self.identity = Some(identity);
    }
}

/// Process noise of `global_from_local` for a change of the map; see the module's documentation.
///
/// # Arguments
/// * `position`: of the robot in L, metres.
pub(crate) fn transform_noise(position: &Vector3<f64>, size: ChangeSize) -> Matrix6<f64> {
    let mut wrt_motion = Matrix6::identity();
    wrt_motion.fixed_view_mut::<3, 3>(POSE_DIM / 2, 0).copy_from(&position.cross_matrix());
    let motion = Matrix6::from_diagonal(&sigmas(size).map(|sigma| sigma.powi(2)));
    wrt_motion * motion * wrt_motion.transpose()
}

/// Standard deviations of a pose error of G.
pub(crate) fn sigmas(size: ChangeSize) -> Vector6<f64> {
    let of = |k: usize| if k < POSE_DIM / 2 { size.sigma_rotation_rad } else { size.sigma_position_m };
    Vector6::from_fn(|k, _| of(k))
}

/// Jacobian of the error of `global_from_local`, in L, with respect to a motion of G about a point.
///
/// # Arguments
/// * `position`: the point in L, metres.
///
/// # Returns
/// With respect to `[τ, σ]` in the axes of G: G rotates by `τ` about the point and translates by `σ`.
pub(crate) fn transform_wrt_motion(global_from_local: &Pose, position: &Vector3<f64>) -> Matrix6<f64> {
    let local_from_global: Matrix3<f64> =
        global_from_local.rotation.inverse().to_rotation_matrix().into_inner();
    let mut jacobian = Matrix6::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&local_from_global);
    jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&local_from_global);
    jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&(position.cross_matrix() * local_from_global));
    jacobian
}

/// Jacobian of the error of a keyframe with respect to the same motion of G.
///
/// # Arguments
/// * `keyframe`: its position in G, metres.
/// * `centre`: the point in G, metres.
pub(crate) fn keyframe_wrt_motion(keyframe: &Vector3<f64>, centre: &Vector3<f64>) -> Matrix6<f64> {
    let mut jacobian = Matrix6::identity();
    jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&-(keyframe - centre).cross_matrix());
    jacobian
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_older_version_is_waited_for_longer_than_a_newer_one_and_not_while_the_one_in_use_answers() {
        let mut used = MapVersion::default();
        used.begin(5, 0);
        for (version, waits_ns) in [(6, ANNOUNCEMENT_NS), (4, BEHIND_NS)] {
            assert!(used.awaits_announcement(version, 0));
            assert!(used.awaits_announcement(version, waits_ns - 1));
            assert!(!used.awaits_announcement(version, waits_ns));
            used.note_answer();
            assert!(used.awaits_announcement(version, waits_ns));
        }
        // Announcements of changes that are behind it, and one that goes back from it.
        assert!(used.is_past(3, 4) && used.is_past(1, 2));
        assert!(!used.is_past(5, 4) && !used.is_past(5, 6) && !used.is_past(7, 8));
    }
}
