//! The active state `[IMU (15) | calibration | global_from_local (6) | landmarks (3 each) | clones (6 each)]` and
//! where each block stands. Calibration is empty unless something of it is estimated online.

use crate::calibration::Calibration;
use crate::propagation::{ACCELEROMETER_BIAS, GYROSCOPE_BIAS, IMU_DIM, ImuState, MotionEstimate, VELOCITY};
use geometry::Pose;
use nalgebra::{DVector, Matrix6, Vector3, Vector6};
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

/// A landmark that is kept in the state for as long as its track lives.
#[derive(Clone, Debug)]
pub struct SlamFeature {
    /// The front end's name of it.
    pub feature_id: u64,
    /// Newest estimate in L, metres.
    pub position: Vector3<f64>,
    /// What was believed when it entered, where its rows are linearized.
    pub first_estimate: Vector3<f64>,
    /// Images in a row in which its pixel was implausible.
    pub implausible: usize,
}

/// Numbers in a landmark's error.
pub const LANDMARK_DIM: usize = 3;

/// A block of the active state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Block {
    /// All 15 numbers of the IMU.
    Imu,
    /// The first 6 of them: the body's pose in L.
    ImuPose,
    /// What is estimated of the cameras' calibration.
    Calibration,
    /// `global_from_local`.
    Transform,
    /// The landmark at this place.
    Landmark(usize),
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
    /// The cameras.
    pub calibration: Calibration,
    /// `global_from_local`, once a first match gave it.
    pub transform: Option<Pose>,
    /// Landmarks in the state.
    pub landmarks: Vec<SlamFeature>,
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
            Block::Calibration => Some(IMU_DIM..self.transform_begin()),
            Block::Transform => self.transform.map(|_| self.transform_begin()..self.landmarks_begin()),
            Block::Landmark(place) => (place < self.landmarks.len()).then(|| {
                let begin = self.landmarks_begin() + LANDMARK_DIM * place;
                begin..begin + LANDMARK_DIM
            }),
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

    /// Where `global_from_local` stands, or would.
    pub fn transform_begin(&self) -> usize {
        IMU_DIM + self.calibration.dim()
    }

    /// Where the landmarks stand in the active error.
    pub fn landmarks_range(&self) -> Range<usize> {
        self.landmarks_begin()..self.clones_begin()
    }

    fn landmarks_begin(&self) -> usize {
        self.transform_begin() + if self.transform.is_some() { POSE_DIM } else { 0 }
    }

    /// Where the clones begin, and the landmarks end.
    pub fn clones_begin(&self) -> usize {
        self.landmarks_begin() + LANDMARK_DIM * self.landmarks.len()
    }

    /// Adds an error to every block.
    pub fn retract(&mut self, error: &DVector<f64>) {
        let pose_error = |begin: usize| -> Vector6<f64> { error.fixed_rows::<6>(begin).into() };
        self.imu.local_from_imu = self.imu.local_from_imu.retract(&pose_error(0));
        self.imu.velocity += error.fixed_rows::<3>(VELOCITY);
        self.imu.gyroscope_bias += error.fixed_rows::<3>(GYROSCOPE_BIAS);
        self.imu.accelerometer_bias += error.fixed_rows::<3>(ACCELEROMETER_BIAS);
        let (transform_begin, landmarks_begin) = (self.transform_begin(), self.landmarks_begin());
        self.calibration.retract(&error.rows(IMU_DIM, transform_begin - IMU_DIM));
        if let Some(transform) = &mut self.transform {
            *transform = retract_locally(transform, &pose_error(transform_begin));
        }
        for (place, landmark) in self.landmarks.iter_mut().enumerate() {
            landmark.position += error.fixed_rows::<3>(landmarks_begin + LANDMARK_DIM * place);
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
            && self.calibration.is_sound()
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
