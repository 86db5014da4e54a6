//! The position of the antenna in G as a measurement of two clones and of `global_from_local`.
//!
//! ```text
//! z = G_T_L ( w1 (p1 + R1 l) + w2 (p2 + R2 l) ) + n
//! ```
//! with the antenna `l` in the frame of the IMU and the weights of linear interpolation between the clones before and after the
//! reading: the antenna is off a straight line by an eighth of its acceleration times the squared interval, 1 mm at 3 m/s^2
//! and 20 images a second. Everything is turned to L, where the unobservable directions are the same at every estimate of
//! `global_from_local`.
//!
//! The error of a clone is that of the pose at the true time of its image, and a reading is at a time of the IMU's clock: where the offset of the
//! cameras' clock is estimated, a larger one has the antenna pass between the clones by `v` times it earlier.

use crate::measurement::LinearizedMeasurement;
use crate::state::{ActiveState, Block};
use geometry::rotation::skew;
use nalgebra::{Matrix3, SMatrix, Vector3};
use smallvec::{SmallVec, smallvec};
use std::ops::Range;

/// Columns: two clones, the transform, then the offset of the cameras' clock, where that is estimated.
const COLUMNS: usize = 19;
const TRANSFORM: usize = 12;
const TIME_OFFSET: usize = 18;

/// Where a reading is between two clones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Between {
    /// Indices of the clones before and after.
    pub(crate) clones: [usize; 2],
    /// Weight of the later one, 0 to 1.
    pub(crate) later: f64,
}

/// The linearized measurement in the axes of L.
#[derive(Clone, Debug)]
pub(crate) struct GnssMeasurement {
    residual: Vector3<f64>,
    jacobian: SMatrix<f64, 3, COLUMNS>,
    local_from_global: Matrix3<f64>,
    blocks: SmallVec<[Range<usize>; 4]>,
}

/// The antenna in L; `None` where a clone does not exist.
pub(crate) fn antenna_in_local(
    state: &ActiveState,
    between: &Between,
    antenna: &Vector3<f64>,
) -> Option<Vector3<f64>> {
    let at = |index: usize| Some(state.clones.get(index)?.local_from_imu.transform(antenna));
    Some(at(between.clones[0])?.lerp(&at(between.clones[1])?, between.later))
}

/// Velocity of the antenna between two clones, in L (m/s); `None` where a clone does not exist, or both are at one time.
fn velocity_between(state: &ActiveState, between: &Between, antenna: &Vector3<f64>) -> Option<Vector3<f64>> {
    let [first, second] = [state.clones.get(between.clones[0])?, state.clones.get(between.clones[1])?];
    let seconds = (second.stamp_ns - first.stamp_ns) as f64 * 1e-9;
    let moved = second.local_from_imu.transform(antenna) - first.local_from_imu.transform(antenna);
    (seconds > 0.0).then(|| moved / seconds)
}

impl GnssMeasurement {
    /// # Arguments
    /// * `antenna`: in the frame of the IMU.
    /// * `position`: of the antenna in G, as it is measured.
    /// * `first_estimates`: keep the turn of L about gravity unobservable at the first estimates of the clones.
    ///
    /// # Returns
    /// `None` where a clone or the transform does not exist.
    pub(crate) fn new(
        state: &ActiveState,
        between: &Between,
        antenna: &Vector3<f64>,
        position: &Vector3<f64>,
        first_estimates: bool,
    ) -> Option<Self> {
        let transform = state.transform.as_ref()?;
        let expected = antenna_in_local(state, between, antenna)?;
        let mut jacobian = SMatrix::<f64, 3, COLUMNS>::zeros();
        let mut put = |column: usize, block: Matrix3<f64>| {
            jacobian.fixed_view_mut::<3, 3>(0, column).copy_from(&block);
        };
        for (k, weight) in [1.0 - between.later, between.later].into_iter().enumerate() {
            let clone = state.clones.get(between.clones[k])?;
            let pose = &clone.local_from_imu;
            let mut lever = pose.rotation * antenna;
            if first_estimates {
                // The turn of L moves a clone as its first estimate would, and the transform as the newest one.
                lever += pose.translation - clone.first_estimate.translation;
            }
            put(6 * k, -skew(&lever) * weight);
            put(6 * k + 3, Matrix3::identity() * weight);
        }
        put(TRANSFORM, -skew(&expected));
        put(TRANSFORM + 3, Matrix3::identity());
        let mut blocks = smallvec![
            state.range(Block::Clone(between.clones[0]))?,
            state.range(Block::Clone(between.clones[1]))?,
            state.range(Block::Transform)?,
        ];
        if state.calibration.estimates_time_offset() {
            let begin = state.range(Block::Calibration)?.start;
            blocks.push(begin..begin + 1);
            jacobian
                .fixed_view_mut::<3, 1>(0, TIME_OFFSET)
                .copy_from(&-velocity_between(state, between, antenna)?);
        }
        let local_from_global = transform.rotation.inverse().to_rotation_matrix().into_inner();
        Some(Self {
            residual: local_from_global * (position - transform.translation) - expected,
            jacobian,
            local_from_global,
            blocks,
        })
    }

    /// The measurement whitened into `rows`; `false` where the covariance is not positive definite.
    ///
    /// # Arguments
    /// * `covariance`: of the position in G, m^2.
    pub(crate) fn whiten(&self, covariance: &Matrix3<f64>, rows: &mut LinearizedMeasurement) -> bool {
        let in_local = self.local_from_global * covariance * self.local_from_global.transpose();
        rows.set_whitened(&self.blocks, &self.jacobian, &self.residual, in_local)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::covariance::JointCovariance;
    use crate::test_scene::{gauge_of_clones, scene};
    use geometry::numeric::numeric_jacobian;
    use geometry::{Pose, rotation};
    use nalgebra::{DMatrix, DVector};

    const BETWEEN: Between = Between { clones: [3, 5], later: 0.3 };

    fn state() -> ActiveState {
        let mut state = scene(false).state;
        let turned = rotation::exp(&Vector3::new(0.4, -0.3, 1.9));
        state.transform = Some(Pose::new(turned, Vector3::new(20.0, -7.0, 3.0)));
        state
    }

    fn measurement(state: &ActiveState, first_estimates: bool) -> GnssMeasurement {
        let (antenna, position) = (Vector3::new(0.2, -0.3, 0.9), Vector3::new(19.0, -8.0, 4.0));
        GnssMeasurement::new(state, &BETWEEN, &antenna, &position, first_estimates).unwrap()
    }

    fn whole(state: &ActiveState, measurement: &GnssMeasurement) -> DMatrix<f64> {
        let mut whole = DMatrix::zeros(3, state.dim());
        for (column, index) in measurement.blocks.iter().flat_map(Clone::clone).enumerate() {
            whole.set_column(index, &measurement.jacobian.column(column));
        }
        whole
    }

    #[test]
    fn the_jacobian_is_the_numeric_one() {
        let state = state();
        let found = whole(&state, &measurement(&state, false));
        // The residual is turned by the transform, which itself has an error.
        let fixed = measurement(&state, false).local_from_global;
        let numeric = numeric_jacobian(state.dim(), |error| {
            let mut moved = state.clone();
            moved.retract(error);
            let moved = measurement(&moved, false);
            let in_global = moved.local_from_global.transpose() * moved.residual;
            DVector::from_column_slice((-(fixed * in_global)).as_slice())
        });
        assert!((&numeric - &found).amax() < 1e-6, "{}", numeric - found);
        assert!(found.amax() > 0.5);
    }

    /// With a larger offset of the cameras' clock, a reading is nearer to the clone before it.
    #[test]
    fn the_offset_of_the_cameras_moves_a_reading_between_its_clones() {
        let mut state = scene(true).state;
        state.transform =
            Some(Pose::new(rotation::exp(&Vector3::new(0.4, -0.3, 1.9)), Vector3::new(20.0, -7.0, 3.0)));
        for (clone, stamp) in state.clones.iter_mut().zip(0..) {
            clone.stamp_ns = stamp * 100_000_000;
        }
        let column = state.range(Block::Calibration).unwrap().start;
        let found = whole(&state, &measurement(&state, true)).column(column).into_owned();
        let seconds = (state.clones[5].stamp_ns - state.clones[3].stamp_ns) as f64 * 1e-9;
        let antenna = Vector3::new(0.2, -0.3, 0.9);
        let at = |offset: f64| {
            let between = Between { later: BETWEEN.later - offset / seconds, ..BETWEEN };
            antenna_in_local(&state, &between, &antenna).unwrap()
        };
        let numeric = (at(1e-3) - at(-1e-3)) / 2e-3;
        assert!(seconds > 0.0 && numeric.norm() > 0.1 && (found - numeric).amax() < 1e-9, "{numeric}");
    }

    #[test]
    fn the_gauge_of_the_odometry_frame_gains_no_information() {
        let state = state();
        let found = whole(&state, &measurement(&state, true));
        let mut gauge = gauge_of_clones(&state);
        let begin = state.range(Block::Transform).unwrap().start;
        gauge.fixed_view_mut::<6, 6>(begin, 0).copy_from(&-nalgebra::Matrix6::identity());
        assert!((&found * &gauge).amax() < 1e-12, "{}", &found * &gauge);
        let newest = whole(&state, &measurement(&state, false));
        assert!((newest * gauge).amax() > 1e-3, "the first estimates differ from the newest ones");
    }

    #[test]
    fn an_update_is_that_of_the_dense_filter() {
        let state = state();
        let measurement = measurement(&state, true);
        let dim = state.dim();
        let root = DMatrix::from_fn(dim, dim, |row, column| {
            let own = if row == column { 0.3 } else { 0.0 };
            own + 0.02 * ((5 * row + 3 * column) as f64).sin()
        });
        let prior = &root * root.transpose();
        let noise = Matrix3::new(0.5, 0.1, 0.0, 0.1, 0.8, -0.2, 0.0, -0.2, 2.0);
        let mut rows = LinearizedMeasurement::default();
        assert!(measurement.whiten(&noise, &mut rows));
        let mut covariance = JointCovariance::new(prior.clone(), 4);
        let nis = covariance.nis(&rows).unwrap();
        let mut correction = DVector::zeros(0);
        covariance.measurement_update(&rows, &mut correction).unwrap();

        // In G, as it is written in textbooks.
        let global_from_local = measurement.local_from_global.transpose();
        let h = global_from_local * whole(&state, &measurement);
        let r = global_from_local * measurement.residual;
        let innovation = &h * &prior * h.transpose() + DMatrix::from_column_slice(3, 3, noise.as_slice());
        let inverse = innovation.try_inverse().unwrap();
        let gain = &prior * h.transpose() * inverse;
        let expected = &prior - &gain * &h * &prior;
        assert!((covariance.active().view() - &expected).amax() < 1e-10);
        assert!((correction - &gain * r).amax() < 1e-10);
        assert!((nis - (r.transpose() * inverse * r)[0]).abs() < 1e-9);
    }
}
