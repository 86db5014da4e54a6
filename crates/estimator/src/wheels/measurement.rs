//! The preintegrated motion of the base as a measurement of two clones and of the calibration of the wheels.
//!
//! With `X = imu_from_base` and the clones `R_i, p_i` and `R_j, p_j`, the motion of the base is
//! ```text
//! R = R_Xᵀ R_iᵀ R_j R_X        p = R_Xᵀ (R_iᵀ (p_j - p_i) + (R_iᵀ R_j - 1) p_X)
//! ```
//! The wheels measure the heading `Log(R)_z` and `p_x`, and that `p_y` is what the arc makes it. `p_z` is zero on a flat
//! floor.

use super::calibration::{EXTRINSICS, WHEELS_DIM, WheelCalibration};
use super::config::WheelNoise;
use super::preintegration::PlanarMotion;
use crate::measurement::LinearizedMeasurement;
use crate::state::{ActiveState, Block};
use geometry::Pose;
use geometry::rotation::{left_jacobian_inverse, log, skew};
use nalgebra::{Matrix2, Matrix3, SMatrix, Vector4};
use std::ops::Range;

/// Speed to which the noise across the track falls at rest, m/s: a vibrating body is not exactly still.
const LEAST_SPEED: f64 = 0.05;

/// Columns: calibration of the wheels, both clones, time offset of the cameras.
const COLUMNS: usize = WHEELS_DIM + 13;
const FIRST: usize = WHEELS_DIM;
const CAMERA_CLOCK: usize = WHEELS_DIM + 12;

/// Rows of a whitened part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// What the wheels turn: heading and way. Slip contradicts it.
    Rolling,
    /// What they forbid: motion along their axis and off the floor.
    OffTrack,
}

/// The linearized motion of the base between two clones: heading, x, y, z (rad, metres).
#[derive(Clone, Debug)]
pub struct WheelMeasurement {
    residual: Vector4<f64>,
    jacobian: SMatrix<f64, 4, COLUMNS>,
    rolling: Matrix2<f64>,
    off_track: Matrix2<f64>,
    blocks: Vec<Range<usize>>,
}

/// Motion of the base from one pose of the body to another: heading, x, y, z (rad, metres).
pub(super) fn relative_motion(begin: &Pose, end: &Pose, imu_from_base: &Pose) -> Vector4<f64> {
    let relative = (*begin * *imu_from_base).inverse() * (*end * *imu_from_base);
    let p = relative.translation;
    Vector4::new(log(&relative.rotation).z, p.x, p.y, p.z)
}

/// Way of the left and the right wheel in a motion of the base, metres.
pub(super) fn ways_of_wheels(motion: &Vector4<f64>, track_m: f64) -> [f64; 2] {
    let across = motion.x * track_m / 2.0;
    [motion.y - across, motion.y + across]
}

/// Jacobian of [`relative_motion`] with respect to the errors of both poses and of `imu_from_base`.
fn relative_motion_jacobian(begin: &Pose, end: &Pose, imu_from_base: &Pose) -> SMatrix<f64, 4, 18> {
    let matrix = |pose: &Pose| pose.rotation.to_rotation_matrix().into_inner();
    let (first, second, base) = (matrix(begin).transpose(), matrix(end), matrix(imu_from_base).transpose());
    let lever = imu_from_base.translation;
    let turned = first * second;
    let moved = end.translation - begin.translation + second * lever;
    let in_first = first * moved - lever;
    let to_base = base * first;
    let relative = begin.rotation.inverse() * end.rotation;
    let phi = log(&(imu_from_base.rotation.inverse() * relative * imu_from_base.rotation));
    let left = left_jacobian_inverse(&phi);
    let identity = Matrix3::identity();

    let mut all = SMatrix::<f64, 6, 18>::zeros();
    let mut put = |row: usize, column: usize, block: Matrix3<f64>| {
        all.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
    };
    put(0, 0, -left * to_base);
    put(0, 6, left * to_base);
    put(0, 12, left * base * (turned - identity));
    put(3, 0, to_base * skew(&moved));
    put(3, 3, -to_base);
    put(3, 6, -to_base * skew(&(second * lever)));
    put(3, 9, to_base);
    put(3, 12, base * skew(&in_first));
    put(3, 15, base * (turned - identity));
    all.fixed_rows::<4>(2).into_owned()
}

impl WheelMeasurement {
    /// Linearizes the motion between two clones.
    ///
    /// # Arguments
    /// * `clones`: indices of the earlier and the later one.
    /// * `first_estimates`: evaluate Jacobians at those of the clones.
    ///
    /// # Returns
    /// `None` where a clone does not exist, or there are no wheels.
    pub fn new(
        state: &ActiveState,
        clones: [usize; 2],
        motion: &PlanarMotion,
        noise: &WheelNoise,
        first_estimates: bool,
    ) -> Option<Self> {
        let calibration: &WheelCalibration = state.wheels.as_ref()?;
        let base = &calibration.imu_from_base;
        let [begin, end] = [state.clones.get(clones[0])?, state.clones.get(clones[1])?];
        let expected = relative_motion(&begin.local_from_imu, &end.local_from_imu, base);
        let measured = Vector4::new(motion.motion.x, motion.motion.y, motion.motion.z, 0.0);
        let mut residual = measured - expected;
        residual.x =
            (residual.x + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;

        let by_poses = if first_estimates {
            relative_motion_jacobian(&begin.first_estimate, &end.first_estimate, base)
        } else {
            relative_motion_jacobian(&begin.local_from_imu, &end.local_from_imu, base)
        };
        let mut jacobian = SMatrix::<f64, 4, COLUMNS>::zeros();
        jacobian.fixed_view_mut::<4, 12>(0, FIRST).copy_from(&by_poses.fixed_columns::<12>(0));
        jacobian.fixed_view_mut::<4, 6>(0, EXTRINSICS).copy_from(&by_poses.fixed_columns::<6>(12));
        jacobian.fixed_view_mut::<3, 4>(0, 0).copy_from(&-motion.wrt_calibration);
        // A larger offset of the cameras makes the clones later by the clock of the wheels, as a smaller one of theirs does.
        jacobian.fixed_view_mut::<3, 1>(0, CAMERA_CLOCK).copy_from(&motion.wrt_calibration.column(3));

        let mut blocks = vec![
            state.range(Block::Wheels)?,
            state.range(Block::Clone(clones[0]))?,
            state.range(Block::Clone(clones[1]))?,
        ];
        if state.calibration.estimates_time_offset() {
            let begin = state.range(Block::Calibration)?.start;
            blocks.push(begin..begin + 1);
        }
        let off_track =
            noise.sigma_off_track_m_sqrt_m.powi(2) * (motion.distance_m + LEAST_SPEED * motion.seconds);
        Some(Self {
            residual,
            jacobian,
            rolling: motion.covariance.fixed_view::<2, 2>(0, 0).into_owned(),
            off_track: Matrix2::new(motion.covariance[(2, 2)] + off_track, 0.0, 0.0, off_track),
            blocks,
        })
    }

    /// Measured minus expected way of each wheel, left and right, metres.
    pub fn residual_of_wheels(&self, track_m: f64) -> [f64; 2] {
        ways_of_wheels(&self.residual, track_m)
    }

    /// One part of the measurement, whitened, into `rows`; `false` where its covariance is not positive definite.
    pub fn whiten(&self, part: Part, rows: &mut LinearizedMeasurement) -> bool {
        let (begin, covariance) = match part {
            Part::Rolling => (0, &self.rolling),
            Part::OffTrack => (2, &self.off_track),
        };
        let jacobian = self.jacobian.fixed_rows::<2>(begin).into_owned();
        let residual = self.residual.fixed_rows::<2>(begin).into_owned();
        rows.set_whitened(&self.blocks, &jacobian, &residual, *covariance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{gauge_of_clones, scene};
    use crate::wheels::buffer::WheelInterval;
    use crate::wheels::config::WheelConfig;
    use crate::wheels::preintegration::preintegrate;
    use geometry::numeric::numeric_jacobian;
    use nalgebra::{DMatrix, DVector, Vector3};
    use types::WheelReading;

    const CLONES: [usize; 2] = [3, 5];

    fn state(calibrating: bool) -> ActiveState {
        let mut config = WheelConfig::new(0.10, 0.50);
        config.base_position_m = [-0.3, 0.1, -0.2];
        config.base_rotation_rad = [0.1, -0.2, 0.3];
        let mut state = scene(calibrating).state;
        state.wheels = Some(WheelCalibration::new(&config));
        state
    }

    /// The measurement, with readings that are shifted as the time offset is.
    fn measurement(state: &ActiveState, first_estimates: bool) -> WheelMeasurement {
        let calibration = state.wheels.unwrap();
        let at = |k: i32| {
            let seconds = f64::from(k) * 0.02;
            let t = seconds - calibration.time_offset_s;
            let stamp_ns = (seconds * 1e9).round() as i64;
            WheelReading { stamp_ns, left: 10.0 + t, right: 12.0 - 3.0 * t }
        };
        let readings = (0..=20).map(at).collect();
        let interval = WheelInterval { readings, period_s: 0.02 };
        let noise = WheelNoise::default();
        let motion = preintegrate(&interval, &calibration, &noise).unwrap();
        WheelMeasurement::new(state, CLONES, &motion, &noise, first_estimates).unwrap()
    }

    /// The Jacobian over the whole active error.
    fn whole(state: &ActiveState, measurement: &WheelMeasurement) -> DMatrix<f64> {
        let mut whole = DMatrix::zeros(4, state.dim());
        let columns = measurement.blocks.iter().flat_map(Clone::clone);
        for (column, index) in columns.enumerate() {
            let sum = whole.column(index) + measurement.jacobian.column(column);
            whole.set_column(index, &sum);
        }
        whole
    }

    #[test]
    fn the_jacobian_is_the_numeric_one() {
        let state = state(false);
        let found = whole(&state, &measurement(&state, false));
        let numeric = numeric_jacobian(state.dim(), |error| {
            let mut moved = state.clone();
            moved.retract(error);
            DVector::from_column_slice((-measurement(&moved, false).residual).as_slice())
        });
        let difference = &numeric - &found;
        let clock = state.range(Block::Wheels).unwrap().start + 3;
        assert!(difference.column(clock).amax() < 1e-3, "a chord is not an arc: {difference}");
        assert!(difference.remove_column(clock).amax() < 1e-6);
        assert!(found.amax() > 0.1);
    }

    #[test]
    fn a_late_camera_is_an_early_wheel() {
        let state = state(true);
        let found = whole(&state, &measurement(&state, true));
        let camera = found.column(state.range(Block::Calibration).unwrap().start);
        let wheels = found.column(state.range(Block::Wheels).unwrap().start + 3);
        assert_eq!(camera, -wheels);
        assert!(camera.amax() > 1e-3);
    }

    #[test]
    fn the_gauge_of_the_odometry_frame_gains_no_information() {
        let state = state(false);
        let found = whole(&state, &measurement(&state, true));
        let gauge = gauge_of_clones(&state);
        assert!((found * gauge).amax() < 1e-12);
    }

    #[test]
    fn whitened_rows_have_unit_noise_and_the_residual_is_that_of_the_wheels() {
        let state = state(false);
        let measurement = measurement(&state, false);
        let mut rows = LinearizedMeasurement::default();
        for (part, begin, covariance) in
            [(Part::Rolling, 0, measurement.rolling), (Part::OffTrack, 2, measurement.off_track)]
        {
            assert!(measurement.whiten(part, &mut rows));
            assert_eq!((rows.residual.len(), rows.jacobian.ncols()), (2, rows.blocks.len()));
            let expected = measurement.residual.fixed_rows::<2>(begin);
            let nis = expected.dot(&(covariance.try_inverse().unwrap() * expected));
            let found: f64 = rows.residual.iter().map(|value| value * value).sum();
            assert!((found / nis - 1.0).abs() < 1e-9);
        }
        let [left, right] = measurement.residual_of_wheels(0.5);
        let back = Vector3::new((right - left) / 0.5, f64::midpoint(right, left), 0.0);
        assert!((back.xy() - measurement.residual.xy()).amax() < 1e-12);
    }
}
