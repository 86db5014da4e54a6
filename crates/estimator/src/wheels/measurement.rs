//! The preintegrated motion of the base as a measurement of two clones and of the calibration of the wheels.
//!
//! With `X = imu_from_base` and the clones `R_i, p_i` and `R_j, p_j`, the motion of the base is
//! ```text
//! R = R_Xᵀ R_iᵀ R_j R_X        p = R_Xᵀ (R_iᵀ (p_j - p_i) + (R_iᵀ R_j - 1) p_X)
//! ```
//! The wheels measure the heading `Log(R)_z` and `p_x`. They measure `p_y` where they can move the base sideways; else it is what
//! the arc makes it. `p_z` is zero on a flat floor.

use super::calibration::{MAX_WHEELS_DIM, WheelCalibration};
use super::config::WheelNoise;
use super::kinematics::ways_of_wheels;
use super::preintegration::{LEAST_SPEED, PlanarMotion};
use crate::measurement::LinearizedMeasurement;
use crate::state::{ActiveState, Block};
use geometry::Pose;
use geometry::rotation::{left_jacobian_inverse, log, skew};
use nalgebra::{Matrix3, Matrix4, SMatrix, Vector4};
use std::ops::Range;
use types::{MAX_WHEELS, WheelBase};

/// Most columns: calibration of the wheels, both clones, time offset of the cameras.
const COLUMNS: usize = MAX_WHEELS_DIM + 13;

/// Rows of a whitened part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// What the wheels turn: heading and way, also sideways where they move the base so. Slip contradicts it.
    Rolling,
    /// What they forbid: motion along their axis, and off the floor.
    OffTrack,
}

/// The linearized motion of the base between two clones: heading, x, y, z (rad, metres).
#[derive(Clone, Debug)]
pub struct WheelMeasurement {
    residual: Vector4<f64>,
    jacobian: SMatrix<f64, 4, COLUMNS>,
    covariance: Matrix4<f64>,
    /// Whether the wheels move the base sideways.
    moves_sideways: bool,
    blocks: Vec<Range<usize>>,
}

/// Motion of the base from one pose of the body to another: heading, x, y, z (rad, metres).
pub(super) fn relative_motion(begin: &Pose, end: &Pose, imu_from_base: &Pose) -> Vector4<f64> {
    let relative = (*begin * *imu_from_base).inverse() * (*end * *imu_from_base);
    let p = relative.translation;
    Vector4::new(log(&relative.rotation).z, p.x, p.y, p.z)
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
        let (clones_begin, clock) = (calibration.dim(), calibration.clock());
        jacobian.fixed_view_mut::<4, 12>(0, clones_begin).copy_from(&by_poses.fixed_columns::<12>(0));
        let extrinsics = calibration.extrinsics();
        jacobian.fixed_view_mut::<4, 6>(0, extrinsics).copy_from(&by_poses.fixed_columns::<6>(12));
        let by_calibration = -motion.wrt_calibration.columns(0, clock + 1);
        jacobian.view_mut((0, 0), (3, clock + 1)).copy_from(&by_calibration);
        // A larger offset of the cameras makes the clones later by the clock of the wheels, as a smaller one of theirs does.
        let by_clock = motion.wrt_calibration.column(clock);
        jacobian.fixed_view_mut::<3, 1>(0, clones_begin + 12).copy_from(&by_clock);

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
        let mut covariance = Matrix4::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&motion.covariance);
        let moves_sideways = calibration.base.kind().moves_sideways();
        if !moves_sideways {
            covariance[(2, 2)] += off_track;
        }
        covariance[(3, 3)] = off_track;
        Some(Self { residual, jacobian, covariance, moves_sideways, blocks })
    }

    /// Measured minus expected way of each wheel, metres; of a steering, that of the steered wheels to their side.
    pub fn residual_of_wheels(&self, base: &WheelBase) -> [f64; MAX_WHEELS] {
        ways_of_wheels(base, &self.residual.xyz())
    }

    /// The same measurement of wheels that report half of the expected motion.
    pub fn of_half_the_motion(&self, motion: &PlanarMotion) -> Self {
        let mut of_half = self.clone();
        let expected = motion.motion - self.residual.xyz();
        of_half.residual.fixed_rows_mut::<3>(0).copy_from(&(-0.5 * expected));
        of_half
    }

    /// One part of the measurement, whitened, into `rows`; `false` where its covariance is not positive definite.
    pub fn whiten(&self, part: Part, rows: &mut LinearizedMeasurement) -> bool {
        match (part, self.moves_sideways) {
            (Part::Rolling, false) => self.whiten_rows::<2>(0, rows),
            (Part::OffTrack, false) => self.whiten_rows::<2>(2, rows),
            (Part::Rolling, true) => self.whiten_rows::<3>(0, rows),
            (Part::OffTrack, true) => self.whiten_rows::<1>(3, rows),
        }
    }

    /// So many rows from `begin` on.
    fn whiten_rows<const ROWS: usize>(&self, begin: usize, rows: &mut LinearizedMeasurement) -> bool {
        let jacobian = self.jacobian.fixed_rows::<ROWS>(begin).into_owned();
        let residual = self.residual.fixed_rows::<ROWS>(begin).into_owned();
        let covariance = self.covariance.fixed_view::<ROWS, ROWS>(begin, begin).into_owned();
        rows.set_whitened(&self.blocks, &jacobian, &residual, covariance)
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
    use types::{BaseKind, WheelReading};

    const CLONES: [usize; 2] = [3, 5];

    fn state(calibrating: bool) -> ActiveState {
        state_of(BaseKind::Differential, calibrating)
    }

    fn state_of(kind: BaseKind, calibrating: bool) -> ActiveState {
        let mut config = WheelConfig::new(WheelBase::new(kind, 0.10, 0.50));
        config.base_position_m = [-0.3, 0.1, -0.2];
        config.base_rotation_rad = [0.1, -0.2, 0.3];
        let mut state = scene(calibrating).state;
        state.wheels = Some(WheelCalibration::new(&config));
        state
    }

    /// The measurement, with readings that are shifted as the time offset is.
    fn measurement(state: &ActiveState, first_estimates: bool) -> WheelMeasurement {
        let calibration = state.wheels.unwrap();
        let stated = WheelBase::new(calibration.base.kind(), 0.10, 0.50);
        let at = |k: i32| {
            let seconds = f64::from(k) * 0.02;
            let t = seconds - calibration.time_offset_s;
            let stamp_ns = (seconds * 1e9).round() as i64;
            if stated.kind() == BaseKind::Ackermann {
                return WheelReading::new(stamp_ns, [10.0 + t, 0.2 - 0.3 * t]);
            }
            let left = if stated.kind().moves_sideways() { 0.4 * t } else { 0.0 };
            let ways = ways_of_wheels(&stated, &Vector3::new(0.4 - 0.8 * t, 1.1 - 0.1 * t, left));
            WheelReading { stamp_ns, values: ways.map(|way| way / 0.10) }
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

    fn clock(state: &ActiveState) -> usize {
        state.range(Block::Wheels).unwrap().start + state.wheels.unwrap().clock()
    }

    #[test]
    fn the_jacobian_is_the_numeric_one() {
        for kind in BaseKind::ALL {
            let state = state_of(kind, false);
            let found = whole(&state, &measurement(&state, false));
            let numeric = numeric_jacobian(state.dim(), |error| {
                let mut moved = state.clone();
                moved.retract(error);
                DVector::from_column_slice((-measurement(&moved, false).residual).as_slice())
            });
            let difference = &numeric - &found;
            let clock = clock(&state);
            assert!(difference.column(clock).amax() < 1e-3, "a chord is not an arc: {kind}: {difference}");
            assert!(difference.remove_column(clock).amax() < 1e-6, "{kind}");
            assert!(found.amax() > 0.1);
        }
    }

    #[test]
    fn a_late_camera_is_an_early_wheel() {
        let state = state(true);
        let found = whole(&state, &measurement(&state, true));
        let camera = found.column(state.range(Block::Calibration).unwrap().start);
        let wheels = found.column(clock(&state));
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
        for (kind, rolling) in [(BaseKind::Differential, 2), (BaseKind::Ackermann, 2), (BaseKind::Mecanum, 3)]
        {
            let state = state_of(kind, false);
            let measurement = measurement(&state, false);
            let mut rows = LinearizedMeasurement::default();
            for (part, begin, count) in [(Part::Rolling, 0, rolling), (Part::OffTrack, rolling, 4 - rolling)]
            {
                assert!(measurement.whiten(part, &mut rows));
                assert_eq!((rows.residual.len(), rows.jacobian.ncols()), (count, rows.blocks.len()));
                let expected = measurement.residual.rows(begin, count).into_owned();
                let covariance = measurement.covariance.view((begin, begin), (count, count)).into_owned();
                let nis = expected.dot(&(covariance.try_inverse().unwrap() * &expected));
                let found: f64 = rows.residual.iter().map(|value| value * value).sum();
                assert!((found / nis - 1.0).abs() < 1e-9);
            }
        }
        let state = state(false);
        let measurement = measurement(&state, false);
        let [left, right, ..] = measurement.residual_of_wheels(&state.wheels.unwrap().base);
        let back = Vector3::new((right - left) / 0.5, f64::midpoint(right, left), 0.0);
        assert!((back.xy() - measurement.residual.xy()).amax() < 1e-12);
    }
}
