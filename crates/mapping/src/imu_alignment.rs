//! The trajectory of a camera and the readings of an IMU, by linear least squares: gravity, velocities, biases, and the scale
//! of the trajectory where it is not known.
//!
//! With `c` the positions of the camera in the unit of length of the trajectory, `l` the IMU in the camera's frame, and
//! `dp, dv` the readings of an interval of length `T`, integrated without gravity from rest, with their derivatives by the
//! bias `b` of the accelerometer:
//! ```text
//! p = s c + R l
//! p_j - p_i = v_i T + g T^2 / 2 + R_i (dp + P_b b)
//! v_j - v_i = g T + R_i (dv + V_b b)
//! ```
//! The magnitude of gravity is known; it enters linearized about the direction that the step before gave.

use adjustment::{SparseFactor, SparseSystem};
use estimator::EstimatorConfig;
use estimator::imu::ImuBuffer;
use estimator::propagation::{
    ACCELEROMETER_BIAS, GYROSCOPE_BIAS, ImuState, MotionEstimate, Propagated, VELOCITY, propagate,
};
use geometry::pose::Pose;
use geometry::rotation::log;
use nalgebra::{DVector, Matrix3, UnitQuaternion, Vector3};
use sensors::Sequence;

use super::error::BuildError;
use super::readings::{IMU_SLACK_NS, buffered};

/// Longest interval from which gravity and velocities are found (s): integration errors grow with its square.
const MAX_INTERVAL_S: f64 = 4.0;
/// Longest time between two readings of an interval (ns): over longer ones they are interpolated, and measure nothing.
const MAX_GAP_NS: i64 = 50_000_000;
/// Standard deviations of a position from the images (m), and of a change of velocity by the IMU (m/s for each second).
const SIGMAS: [f64; 2] = [0.02, 0.05];
/// Standard deviation of each axis of the accelerometer's bias (m/s^2).
const SIGMA_BIAS: f64 = 0.1;
/// Standard deviation of the magnitude of gravity (m/s^2): it varies so much over the Earth.
const SIGMA_GRAVITY: f64 = 0.02;
/// Plausible magnitudes of gravity as the images and the IMU give it (m/s^2).
const PLAUSIBLE_GRAVITY: [f64; 2] = [9.3, 10.3];
/// Steps with the magnitude of gravity: its direction changes by less than a degree in the first.
const STEPS: usize = 3;

/// How a trajectory and an IMU belong together.
pub(super) struct ImuAlignment {
    /// Metres in the unit of length of the trajectory.
    pub(super) scale: f64,
    /// Relative standard deviation of the scale; zero where it was given.
    pub(super) sigma_scale: f64,
    /// In the frame of the trajectory (m/s^2).
    pub(super) gravity: Vector3<f64>,
    /// Standard deviation of the direction of gravity (rad).
    pub(super) sigma_tilt: f64,
    /// Time stamps (ns) and states, in the frame of the trajectory, metric.
    states: Vec<(i64, ImuState)>,
}

/// Readings between two poses, integrated from rest without gravity in the frame of the first IMU pose.
struct Interval {
    begin: usize,
    seconds: f64,
    change: Propagated,
}

/// The pose of the IMU at an image.
struct ImagePose {
    stamp_ns: i64,
    /// From the frame of the IMU to that of the trajectory.
    rotation: UnitQuaternion<f64>,
    /// Position of the camera, in the unit of length of the trajectory.
    camera: Vector3<f64>,
    /// From the camera to the IMU, in the frame of the trajectory (m).
    lever: Vector3<f64>,
}

impl ImuAlignment {
    /// Aligns a trajectory with the readings of a recording. Intervals in which readings are missing are not used.
    ///
    /// # Arguments
    /// * `poses`: time stamps (ns) and poses of camera 0, in any frame.
    /// * `scale`: metres in the unit of length of the poses; `None` to find it.
    ///
    /// # Errors
    /// [`BuildError::TooFewRegistered`], [`BuildError::ContradictsImu`], [`BuildError::Indefinite`].
    pub(super) fn new(
        sequence: &Sequence,
        poses: &[(i64, Pose)],
        scale: Option<f64>,
        config: &EstimatorConfig,
    ) -> Result<ImuAlignment, BuildError> {
        let images = image_poses(&sequence.cameras[0].imu_from_camera, poses);
        let readings = buffered(&sequence.imu_samples);
        let without_bias = intervals(&readings, &images, Vector3::zeros(), config);
        if images.len() < 3 || without_bias.len() < 2 {
            return Err(BuildError::TooFewRegistered {
                images: sequence.frames.len(),
                located: images.len(),
            });
        }
        let gyroscope_bias = gyroscope_bias(&images, &without_bias);
        let intervals = intervals(&readings, &images, gyroscope_bias, config);
        let equations = Equations { images: &images, intervals: &intervals, scale };
        let mut solution = equations.solve(None).ok_or(BuildError::Indefinite)?;
        let magnitude = solution.gravity().norm();
        if !(PLAUSIBLE_GRAVITY[0]..=PLAUSIBLE_GRAVITY[1]).contains(&magnitude) {
            return Err(BuildError::ContradictsImu { gravity: magnitude });
        }
        for _ in 0..STEPS {
            let direction = solution.gravity().normalize();
            let known = Some((direction, config.gravity));
            solution = equations.solve(known).ok_or(BuildError::Indefinite)?;
        }
        Ok(solution.alignment(&images, gyroscope_bias, scale))
    }

    /// The states in a frame with z up, whose origin is the first pose of the IMU.
    pub(super) fn upright_states(&self) -> Vec<(i64, ImuState)> {
        let up = upright_from(&self.gravity);
        let origin =
            self.states.first().map_or_else(Vector3::zeros, |(_, state)| state.local_from_imu.translation);
        let local_from_trajectory = Pose::new(up, -(up * origin));
        let state = |(stamp_ns, state): &(i64, ImuState)| {
            let local_from_imu = local_from_trajectory.compose(&state.local_from_imu);
            (*stamp_ns, ImuState { local_from_imu, velocity: up * state.velocity, ..*state })
        };
        self.states.iter().map(state).collect()
    }
}

/// The rotation to a frame with z up.
///
/// # Arguments
/// * `gravity`: in the frame from which it rotates.
pub(super) fn upright_from(gravity: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(gravity, &-Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

/// The poses of the IMU at the images.
///
/// # Arguments
/// * `poses`: time stamps (ns) and poses of camera 0.
fn image_poses(imu_from_camera: &Pose, poses: &[(i64, Pose)]) -> Vec<ImagePose> {
    let camera_from_imu = imu_from_camera.inverse();
    let image = |&(stamp_ns, pose): &(i64, Pose)| ImagePose {
        stamp_ns,
        rotation: pose.rotation * camera_from_imu.rotation,
        camera: pose.translation,
        lever: pose.rotation * camera_from_imu.translation,
    };
    poses.iter().map(image).collect()
}

/// The intervals that readings without a hole cover.
fn intervals(
    readings: &ImuBuffer,
    images: &[ImagePose],
    gyroscope_bias: Vector3<f64>,
    config: &EstimatorConfig,
) -> Vec<Interval> {
    let rest = ImuState::at_rest(gyroscope_bias, Vector3::zeros());
    let interval = |(begin, ends): (usize, &[ImagePose])| {
        let [from, to] = [ends[0].stamp_ns, ends[1].stamp_ns];
        let seconds = (to - from) as f64 * 1e-9;
        if seconds > MAX_INTERVAL_S || readings.longest_gap_ns(from, to) > MAX_GAP_NS {
            return None;
        }
        let between = readings.interval(from, to, IMU_SLACK_NS).ok()?;
        let change = propagate(&rest, &MotionEstimate::of(&rest), &between, &config.imu_noise, 0.0);
        Some(Interval { begin, seconds, change })
    };
    images.windows(2).enumerate().filter_map(interval).collect()
}

/// The bias by which the integrated rotations differ from those of the images, by linear least squares.
fn gyroscope_bias(images: &[ImagePose], intervals: &[Interval]) -> Vector3<f64> {
    let (mut information, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
    for Interval { begin, change, .. } in intervals {
        let (begin, end) = (&images[*begin].rotation, &images[begin + 1].rotation);
        let integrated = change.state.local_from_imu.rotation;
        let residual = log(&(begin.inverse() * end * integrated.inverse()));
        let by_bias: Matrix3<f64> = change.transition.fixed_view::<3, 3>(0, GYROSCOPE_BIAS).into();
        information += by_bias.transpose() * by_bias;
        gradient += by_bias.transpose() * residual;
    }
    information.try_inverse().map_or_else(Vector3::zeros, |inverse| inverse * gradient)
}

/// The linear equations. Unknowns: a velocity an image, gravity, the bias of the accelerometer, the scale.
struct Equations<'a> {
    images: &'a [ImagePose],
    intervals: &'a [Interval],
    scale: Option<f64>,
}

/// Their solution.
struct Solution {
    unknowns: DVector<f64>,
    factor: SparseFactor,
    images: usize,
}

impl Equations<'_> {
    /// Solves them.
    ///
    /// # Arguments
    /// * `gravity`: its approximate direction and its magnitude (m/s^2); `None` where they are not known yet, and the bias
    ///   is taken for zero, which poses with errors would not tell from gravity.
    ///
    /// # Returns
    /// `None` where they are singular.
    fn solve(&self, gravity: Option<(Vector3<f64>, f64)>) -> Option<Solution> {
        let images = self.images.len();
        let dim = 3 * images + 7;
        let mut system = SparseSystem::new(dim);
        let mut right = DVector::zeros(dim);
        let mut add = |unknowns: &[usize], factors: &[f64], value: f64, sigma: f64| {
            let row = DVector::from_row_slice(factors) / sigma;
            system.add(unknowns, unknowns, &(&row * row.transpose()));
            for (unknown, factor) in unknowns.iter().zip(row.iter()) {
                right[*unknown] += factor * value / sigma;
            }
        };
        // So weak that it changes nothing but velocities that no interval determines.
        (0..3 * images).for_each(|index| add(&[index], &[1.0], 0.0, 1e3));
        let (at_gravity, at_bias, at_scale) = (3 * images, 3 * images + 3, 3 * images + 6);
        let sigma_bias = if gravity.is_some() { SIGMA_BIAS } else { 1e-3 * SIGMA_BIAS };
        (0..3).for_each(|axis| add(&[at_bias + axis], &[1.0], 0.0, sigma_bias));
        match self.scale {
            Some(scale) => add(&[at_scale], &[1.0], scale, 1e-9 * scale),
            None => add(&[at_scale], &[1.0], 0.0, 1e6),
        }
        if let Some((direction, magnitude)) = gravity {
            let unknowns = [at_gravity, at_gravity + 1, at_gravity + 2];
            add(&unknowns, direction.as_slice(), magnitude, SIGMA_GRAVITY);
        }
        for Interval { begin, seconds: t, change } in self.intervals {
            let (first, second) = (&self.images[*begin], &self.images[begin + 1]);
            let by_bias = |row: usize| {
                let block: Matrix3<f64> =
                    change.transition.fixed_view::<3, 3>(row, ACCELEROMETER_BIAS).into();
                first.rotation.to_rotation_matrix() * block
            };
            let (position_by_bias, velocity_by_bias) = (by_bias(3), by_bias(VELOCITY));
            let apart = second.camera - first.camera;
            let moved = second.lever - first.lever - first.rotation * change.state.local_from_imu.translation;
            let gained = first.rotation * change.state.velocity;
            for axis in 0..3 {
                let [v_i, v_j] = [3 * begin + axis, 3 * begin + 3 + axis];
                let shared = [at_gravity + axis, at_bias, at_bias + 1, at_bias + 2];
                let unknowns = [&[v_i, at_scale][..], &shared].concat();
                let bias = position_by_bias.row(axis);
                let factors = [*t, -apart[axis], 0.5 * t * t, bias[0], bias[1], bias[2]];
                add(&unknowns, &factors, moved[axis], SIGMAS[0]);
                let unknowns = [&[v_i, v_j][..], &shared].concat();
                let bias = velocity_by_bias.row(axis);
                let factors = [-1.0, 1.0, -t, -bias[0], -bias[1], -bias[2]];
                add(&unknowns, &factors, gained[axis], SIGMAS[1] * t);
            }
        }
        let factor = system.factor()?;
        Some(Solution { unknowns: factor.solve(&right), factor, images })
    }
}

impl Solution {
    fn triple(&self, index: usize) -> Vector3<f64> {
        self.unknowns.fixed_rows::<3>(3 * index).into()
    }

    fn gravity(&self) -> Vector3<f64> {
        self.triple(self.images)
    }

    fn alignment(
        &self,
        images: &[ImagePose],
        gyroscope_bias: Vector3<f64>,
        given: Option<f64>,
    ) -> ImuAlignment {
        let (at_gravity, at_scale) = (3 * self.images, 3 * self.images + 6);
        let inverse = self.factor.inverse_columns(&[at_gravity, at_gravity + 1, at_gravity + 2, at_scale]);
        let of_gravity: Matrix3<f64> = inverse.fixed_view::<3, 3>(at_gravity, 0).into();
        let gravity = self.gravity();
        let scale = given.unwrap_or(self.unknowns[at_scale]);
        let sigma_scale = if given.is_some() { 0.0 } else { inverse[(at_scale, 3)].sqrt() / scale };
        let accelerometer_bias = self.triple(self.images + 1);
        let state = |(index, image): (usize, &ImagePose)| {
            let state = ImuState {
                local_from_imu: Pose::new(image.rotation, image.camera * scale + image.lever),
                velocity: self.triple(index),
                gyroscope_bias,
                accelerometer_bias,
            };
            (image.stamp_ns, state)
        };
        ImuAlignment {
            scale,
            sigma_scale,
            gravity,
            sigma_tilt: of_gravity.symmetric_eigenvalues().max().sqrt() / gravity.norm(),
            states: images.iter().enumerate().map(state).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use simulation::{SimulationOptions, simulate};

    /// A recording and twenty poses of its camera, in a frame in which gravity points anywhere, in units of 0.4 m.
    fn trajectory() -> (Sequence, Vec<(i64, Pose)>) {
        let options = SimulationOptions { duration_s: Some(30.0), ..SimulationOptions::default() };
        let sequence = simulate(&options).unwrap().live;
        let truth = sequence.groundtruth.as_ref().unwrap();
        let turned =
            Pose::new(geometry::rotation::exp(&Vector3::new(0.8, -1.1, 0.4)), Vector3::new(3.0, -2.0, 5.0));
        let pose = |row: &sensors::TruthRow| {
            let pose = turned.compose(&row.pose).compose(&sequence.cameras[0].imu_from_camera);
            (row.stamp_ns, Pose::new(pose.rotation, pose.translation / 0.4))
        };
        let poses = truth.iter().step_by(truth.len() / 20).map(pose).collect();
        (sequence, poses)
    }

    #[test]
    fn poses_and_readings_give_gravity_velocities_and_biases() {
        let (sequence, poses) = trajectory();
        let truth = sequence.groundtruth.as_ref().unwrap();
        let config = EstimatorConfig::default();
        let alignment = ImuAlignment::new(&sequence, &poses, Some(0.4), &config).unwrap();
        assert_eq!((alignment.scale, alignment.sigma_scale), (0.4, 0.0));
        let states = alignment.upright_states();
        for (row, (stamp_ns, state)) in
            truth.iter().step_by(truth.len() / 20).zip(&states).take(states.len() - 1)
        {
            assert_eq!(row.stamp_ns, *stamp_ns);
            let tilt = (state.local_from_imu.rotation.inverse() * Vector3::z())
                .angle(&(row.pose.rotation.inverse() * Vector3::z()));
            assert!(tilt < 0.01, "{tilt} rad");
            let in_imu = |pose: &Pose, velocity: Vector3<f64>| pose.rotation.inverse() * velocity;
            let speed =
                in_imu(&state.local_from_imu, state.velocity) - in_imu(&row.pose, row.velocity.unwrap());
            assert!(speed.norm() < 0.1, "{speed}");
        }
    }

    #[test]
    fn poses_and_readings_give_the_scale() {
        let (sequence, poses) = trajectory();
        let config = EstimatorConfig::default();
        let alignment = ImuAlignment::new(&sequence, &poses, None, &config).unwrap();
        let error = alignment.scale / 0.4 - 1.0;
        assert!(error.abs() < 3.0 * alignment.sigma_scale, "{error}, sigma {}", alignment.sigma_scale);
        assert!(alignment.sigma_scale < 0.04, "{}", alignment.sigma_scale);
    }

    #[test]
    fn intervals_with_a_hole_in_the_readings_are_left_out_and_the_others_align_as_before() {
        let (mut sequence, poses) = trajectory();
        let config = EstimatorConfig::default();
        let images = image_poses(&sequence.cameras[0].imu_from_camera, &poses);
        let count = |sequence: &Sequence| {
            intervals(&buffered(&sequence.imu_samples), &images, Vector3::zeros(), &config).len()
        };
        let all = count(&sequence);
        let whole = ImuAlignment::new(&sequence, &poses, None, &config).unwrap();
        // Half a second is missing in each of three intervals.
        for at in [4, 9, 14] {
            let begin_ns = poses[at].0 + 400_000_000;
            sequence
                .imu_samples
                .retain(|reading| !(begin_ns..begin_ns + 500_000_000).contains(&reading.stamp_ns));
        }
        assert_eq!(count(&sequence), all - 3);
        let with_holes = ImuAlignment::new(&sequence, &poses, None, &config).unwrap();
        let error = with_holes.scale / 0.4 - 1.0;
        assert!(error.abs() < 3.0 * with_holes.sigma_scale, "{error}, sigma {}", with_holes.sigma_scale);
        assert!(with_holes.sigma_scale > whole.sigma_scale);
        assert!(with_holes.gravity.angle(&whole.gravity) < 0.02);
    }

    #[test]
    fn readings_in_units_of_gravity_contradict_the_images() {
        let (mut sequence, poses) = trajectory();
        for reading in &mut sequence.imu_samples {
            reading.accelerometer /= 9.81;
        }
        let result = ImuAlignment::new(&sequence, &poses, Some(0.4), &EstimatorConfig::default());
        assert!(matches!(result, Err(BuildError::ContradictsImu { .. })));
    }
}
