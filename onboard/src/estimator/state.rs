//! The active state `[IMU (15) | global_from_local (6) | clones (6 each)]` and where each block stands.

use super::propagation::{ACCELEROMETER_BIAS, GYROSCOPE_BIAS, IMU_DIM, ImuState, MotionEstimate, VELOCITY};
use geometry::Pose;
use nalgebra::{DVector, Matrix6, Vector6};
use std::ops::Range;

/// Numbers in a pose error.
pub const POSE_DIM: usize = 6;

/// Names one clone for as long as it lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CloneId(pub(crate) u64);

/// A copy of the IMU pose at the time of one image.
#[derive(Clone, Debug)]
pub struct ClonedPose {
    /// Its name.
    pub id: CloneId,
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// Newest estimate of the body in L.
    pub local_from_imu: Pose,
    /// What was believed when the clone was made, before any image was used.
    pub first_estimate: Pose,
    /// A map query waits for its answer: the clone stays.
    pub pinned: bool,
}

/// A block of the active state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Block {
    /// All 15 numbers of the IMU.
    Imu,
    /// The first 6 of them: the body's pose in L.
    ImuPose,
    /// `global_from_local`.
    Transform,
    /// The clone at this place of the window, oldest first.
    Clone(usize),
}

/// Means of the active state. The only place that knows the order of the blocks.
#[derive(Clone, Debug)]
pub struct ActiveState {
    /// Time of the IMU state, nanoseconds.
    pub stamp_ns: i64,
    /// Newest IMU state.
    pub imu: ImuState,
    /// Position and velocity as first believed at `stamp_ns`, where the next transition is linearized.
    pub first_motion: MotionEstimate,
    /// `global_from_local`, once a first match gave it.
    pub transform: Option<Pose>,
    /// The sliding window, oldest first.
    pub clones: Vec<ClonedPose>,
}

impl ActiveState {
    /// Numbers in the active error.
    pub fn dim(&self) -> usize {
        self.clones_begin() + POSE_DIM * self.clones.len()
    }

    /// Where a block stands in the active error; `None` for one that does not exist.
    pub fn range(&self, block: Block) -> Option<Range<usize>> {
        match block {
            Block::Imu => Some(0..IMU_DIM),
            Block::ImuPose => Some(0..POSE_DIM),
            Block::Transform => self.transform.map(|_| IMU_DIM..IMU_DIM + POSE_DIM),
            Block::Clone(place) => (place < self.clones.len()).then(|| {
                let begin = self.clones_begin() + POSE_DIM * place;
                begin..begin + POSE_DIM
            }),
        }
    }

    /// The place of a clone in the window.
    pub fn place_of(&self, id: CloneId) -> Option<usize> {
        self.clones.iter().position(|clone| clone.id == id)
    }

    fn clones_begin(&self) -> usize {
        IMU_DIM + if self.transform.is_some() { POSE_DIM } else { 0 }
    }

    /// Adds an error to every block.
    pub fn retract(&mut self, error: &DVector<f64>) {
        let pose_error = |begin: usize| -> Vector6<f64> { error.fixed_rows::<6>(begin).into() };
        self.imu.local_from_imu = self.imu.local_from_imu.retract(&pose_error(0));
        self.imu.velocity += error.fixed_rows::<3>(VELOCITY);
        self.imu.gyroscope_bias += error.fixed_rows::<3>(GYROSCOPE_BIAS);
        self.imu.accelerometer_bias += error.fixed_rows::<3>(ACCELEROMETER_BIAS);
        if let Some(transform) = &mut self.transform {
            *transform = retract_locally(transform, &pose_error(IMU_DIM));
        }
        let begin = self.clones_begin();
        for (place, clone) in self.clones.iter_mut().enumerate() {
            clone.local_from_imu = clone.local_from_imu.retract(&pose_error(begin + POSE_DIM * place));
        }
    }

    /// Whether every mean is a number.
    pub fn is_finite(&self) -> bool {
        let imu = &self.imu;
        imu.local_from_imu.is_finite()
            && [imu.velocity, imu.gyroscope_bias, imu.accelerometer_bias]
                .iter()
                .all(|vector| vector.iter().all(|value| value.is_finite()))
            && self.transform.is_none_or(|pose| pose.is_finite())
    }
}

/// `R = R̂ Exp(e)`, `p = p̂ + R̂ e_p`: the error of `global_from_local` inside of the filter.
///
/// In L, the directions that nothing observes (turning L about gravity and moving it) are the same for
/// every estimate of the transform; in G they turn with it, and each update would learn a little of them.
pub fn retract_locally(pose: &Pose, error: &Vector6<f64>) -> Pose {
    let turn = geometry::rotation::exp(&error.fixed_rows::<3>(0).into_owned());
    let shift = pose.rotation * error.fixed_rows::<3>(3).into_owned();
    Pose::new(pose.rotation * turn, pose.translation + shift)
}

/// The error that leads from `from` to `to`: undoes [`retract_locally`].
pub fn local_error(from: &Pose, to: &Pose) -> Vector6<f64> {
    let back = from.rotation.inverse();
    let turn = geometry::rotation::log(&(back * to.rotation));
    let shift = back * (to.translation - from.translation);
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// `diag(R, R)`: an error in the child frame told in the parent frame.
pub fn turned(pose: &Pose) -> Matrix6<f64> {
    let rotation = pose.rotation.to_rotation_matrix().into_inner();
    let mut blocks = Matrix6::zeros();
    blocks.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    blocks.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    blocks
}
