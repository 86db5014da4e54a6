//! The active state `[IMU (15) | calibration | wheels (10 to 12) | global_from_local (6) | SLAM features (3 each) | clones (6 each)]` and the
//! layout of its error. The calibration block is empty unless some of it is estimated online, that of the wheels without wheels.

use crate::calibration::Calibration;
use crate::propagation::{IMU_DIM, ImuState, MotionEstimate};
use crate::rolling_shutter::motion_around::MotionAround;
use crate::wheels::calibration::WheelCalibration;
use geometry::Pose;
use nalgebra::{DVector, Matrix6, Vector3, Vector6};
use std::ops::Range;
use std::sync::Arc;

/// Dimension of a pose error.
pub const POSE_DIM: usize = 6;

/// Identity of a clone, never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CloneId(pub(crate) u64);

/// A copy of the IMU pose at the time of one image.
#[derive(Clone, Debug)]
pub struct ClonedPose {
    /// Its identity.
    pub id: CloneId,
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// Newest estimate of the body in L.
    pub local_from_imu: Pose,
    /// Where Jacobians are evaluated: the estimate before the updates with the newest image (`first_estimates`).
    pub first_estimate: Pose,
    /// Number of map queries of its image that are pending: as long as there are some it is excluded from marginalization.
    pub pins: usize,
    /// Motion about the time of the image, for cameras with a rolling shutter.
    pub motion: Option<Arc<MotionAround>>,
}

/// A landmark in the state, kept as long as it is tracked.
#[derive(Clone, Debug)]
pub struct SlamFeature {
    /// The front end's identity of the feature.
    pub feature_id: u64,
    /// Newest estimate in L, metres.
    pub position: Vector3<f64>,
    /// Where Jacobians are evaluated, in L: see [`ClonedPose::first_estimate`].
    pub first_estimate: Vector3<f64>,
    /// Number of consecutive images in which the gate rejected it.
    pub gated_in_a_row: usize,
    /// The camera that it was first seen by.
    pub camera: u8,
    /// The last clone that observed it.
    pub last_seen: CloneId,
}

/// Dimension of the error of a SLAM feature.
pub const FEATURE_DIM: usize = 3;

/// A block of the active state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Block {
    /// The IMU state, dimension 15.
    Imu,
    /// The first 6 of it: the IMU pose in L.
    ImuPose,
    /// The calibration estimated online.
    Calibration,
    /// The calibration of the wheels.
    Wheels,
    /// `global_from_local`.
    Transform,
    /// The SLAM feature with this index.
    SlamFeature(usize),
    /// The clone with this index in the window, oldest first.
    Clone(usize),
}

/// Estimate of the active state. All index arithmetic on its blocks is here.
#[derive(Clone, Debug)]
pub struct ActiveState {
    /// Time of the IMU state, nanoseconds.
    pub stamp_ns: i64,
    /// Newest IMU state.
    pub imu: ImuState,
    /// First estimates of position and velocity at `stamp_ns`, at which the next transition is linearized.
    pub first_motion: MotionEstimate,
    /// The cameras.
    pub calibration: Calibration,
    /// The wheels, where there are any.
    pub wheels: Option<WheelCalibration>,
    /// `global_from_local`, after the map initialization.
    pub transform: Option<Pose>,
    /// SLAM features.
    pub slam_features: Vec<SlamFeature>,
    /// The sliding window, oldest first.
    pub clones: Vec<ClonedPose>,
}

impl ActiveState {
    /// Dimension of the active error.
    pub fn dim(&self) -> usize {
        self.clones_begin() + POSE_DIM * self.clones.len()
    }

    /// Range of a block in the active error; `None` for one that does not exist.
    pub fn range(&self, block: Block) -> Option<Range<usize>> {
        match block {
            Block::Imu => Some(0..IMU_DIM),
            Block::ImuPose => Some(0..POSE_DIM),
            Block::Calibration => Some(IMU_DIM..self.wheels_begin()),
            Block::Wheels => self.wheels.map(|_| self.wheels_begin()..self.transform_begin()),
            Block::Transform => self.transform.map(|_| self.transform_begin()..self.slam_features_begin()),
            Block::SlamFeature(index) => (index < self.slam_features.len()).then(|| {
                let begin = self.slam_features_begin() + FEATURE_DIM * index;
                begin..begin + FEATURE_DIM
            }),
            Block::Clone(index) => (index < self.clones.len()).then(|| {
                let begin = self.clones_begin() + POSE_DIM * index;
                begin..begin + POSE_DIM
            }),
        }
    }

    /// Index of a clone in the window.
    pub fn clone_index(&self, id: CloneId) -> Option<usize> {
        self.clones.iter().position(|clone| clone.id == id)
    }

    /// First index of `global_from_local` in the active error, also where it is not yet in the state.
    pub fn transform_begin(&self) -> usize {
        self.wheels_begin() + self.wheels.as_ref().map_or(0, WheelCalibration::dim)
    }

    fn wheels_begin(&self) -> usize {
        IMU_DIM + self.calibration.dim()
    }

    /// Range of all SLAM features in the active error.
    pub fn slam_features_range(&self) -> Range<usize> {
        self.slam_features_begin()..self.clones_begin()
    }

    fn slam_features_begin(&self) -> usize {
        self.transform_begin() + if self.transform.is_some() { POSE_DIM } else { 0 }
    }

    /// First index of the clones, one past the SLAM features.
    pub fn clones_begin(&self) -> usize {
        self.slam_features_begin() + FEATURE_DIM * self.slam_features.len()
    }

    /// Adds an error of dimension [`Self::dim`] to the estimate.
    pub fn retract(&mut self, error: &DVector<f64>) {
        let pose_error = |begin: usize| -> Vector6<f64> { error.fixed_rows::<6>(begin).into() };
        self.imu = self.imu.retract(&error.fixed_rows::<IMU_DIM>(0).into());
        let (transform_begin, slam_features_begin) = (self.transform_begin(), self.slam_features_begin());
        self.calibration.retract(&error.rows(IMU_DIM, self.calibration.dim()));
        if let Some(wheels) = &mut self.wheels {
            let dim = wheels.dim();
            wheels.retract(&error.rows(transform_begin - dim, dim));
        }
        if let Some(transform) = &mut self.transform {
            *transform = retract_locally(transform, &pose_error(transform_begin));
        }
        for (index, feature) in self.slam_features.iter_mut().enumerate() {
            feature.position += error.fixed_rows::<3>(slam_features_begin + FEATURE_DIM * index);
        }
        let begin = self.clones_begin();
        for (index, clone) in self.clones.iter_mut().enumerate() {
            clone.local_from_imu = clone.local_from_imu.retract(&pose_error(begin + POSE_DIM * index));
        }
    }

    /// Becomes a copy of `other` in its own memory.
    pub fn copy_from(&mut self, other: &Self) {
        (self.stamp_ns, self.imu, self.transform) = (other.stamp_ns, other.imu, other.transform);
        self.wheels = other.wheels;
        self.first_motion = other.first_motion;
        self.calibration.copy_from(&other.calibration);
        self.slam_features.clone_from(&other.slam_features);
        self.clones.clone_from(&other.clones);
    }

    /// Whether all values are finite.
    pub fn is_finite(&self) -> bool {
        self.imu.is_finite()
            && self.calibration.is_valid()
            && self.wheels.is_none_or(|wheels| wheels.is_valid())
            && self.transform.is_none_or(|pose| pose.is_finite())
    }
}

/// `R = R̂ Exp(e)`, `p = p̂ + R̂ e_p`: the error of `global_from_local` inside of the filter, in the axes of L.
///
/// In L the unobservable directions (rotation of L about gravity and translation of L) are the same at every estimate of
/// the transform. In G they rotate with it, and each update would gain spurious information along them.
pub fn retract_locally(pose: &Pose, error: &Vector6<f64>) -> Pose {
    let turn = geometry::rotation::exp(&error.fixed_rows::<3>(0).into_owned());
    let shift = pose.rotation * error.fixed_rows::<3>(3).into_owned();
    Pose::new(pose.rotation * turn, pose.translation + shift)
}

/// Error from `from` to `to`, the inverse of [`retract_locally`].
pub fn local_error(from: &Pose, to: &Pose) -> Vector6<f64> {
    let back = from.rotation.inverse();
    let turn = geometry::rotation::log(&(back * to.rotation));
    let shift = back * (to.translation - from.translation);
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// `diag(R, R)`: maps a pose error in the axes of the child frame to those of the parent frame.
pub fn rotation_adjoint(pose: &Pose) -> Matrix6<f64> {
    let rotation = pose.rotation.to_rotation_matrix().into_inner();
    let mut blocks = Matrix6::zeros();
    blocks.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    blocks.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    blocks
}
