//! The pose of the IMU when a row of an image was taken, as a function of two clones.

use crate::state::{ActiveState, ClonedPose};
use geometry::{Pose, rotation};
use nalgebra::{Matrix2x6, Vector2, Vector3, Vector6};

/// At which estimates of the clones something is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Estimates {
    /// The first ones, for Jacobians.
    First,
    /// The newest ones.
    Newest,
}

impl Estimates {
    fn of(self, clone: &ClonedPose) -> &Pose {
        match self {
            Self::First => &clone.first_estimate,
            Self::Newest => &clone.local_from_imu,
        }
    }
}

/// The pose of the IMU when a row of an image was taken.
#[derive(Clone, Copy, Debug)]
pub struct RowPose {
    /// The pose.
    pub local_from_imu: Pose,
    /// How it depends on the state; `None` where it is the clone's own, as with a global shutter.
    pub dependence: Option<RowDependence>,
}

/// How the pose of a row depends on the state.
#[derive(Clone, Copy, Debug)]
pub struct RowDependence {
    /// On the image's own clone.
    pub own: ClonePart,
    /// On a clone beside it, with its index.
    pub neighbour: Option<(usize, ClonePart)>,
    /// Derivative of the pose by the readout time: `[δθ, δp]` in L a second.
    pub by_readout: Vector6<f64>,
}

/// The part of a clone's error in that of a row: `δθ = w δθ_j`, `δp = w (δp_j + δθ_j x lever)`.
#[derive(Clone, Copy, Debug)]
pub struct ClonePart {
    weight: f64,
    /// From the clone to the row, metres in L.
    lever: Vector3<f64>,
}

impl ClonePart {
    /// The Jacobian with respect to the clone of what has the Jacobian `wrt_row` with respect to the row's pose.
    pub fn chain(&self, wrt_row: &Matrix2x6<f64>) -> Matrix2x6<f64> {
        let mut wrt_clone = *wrt_row;
        let by_lever = wrt_row.fixed_columns::<3>(3) * rotation::skew(&self.lever);
        let mut of_rotation = wrt_clone.fixed_columns_mut::<3>(0);
        of_rotation -= by_lever;
        wrt_clone * self.weight
    }
}

impl RowPose {
    /// The pose when a pixel was taken.
    ///
    /// # Arguments
    /// * `clone`: index of the image's clone.
    /// * `camera`: index of the camera.
    /// * `pixel`: as measured.
    pub fn of(
        state: &ActiveState,
        clone: usize,
        camera: usize,
        pixel: &Vector2<f64>,
        estimates: Estimates,
    ) -> Self {
        let own = estimates.of(&state.clones[clone]);
        let Some(motion) = &state.clones[clone].motion else {
            return Self { local_from_imu: *own, dependence: None };
        };
        let calibrated = &state.calibration.cameras[camera];
        let fraction = calibrated.row_fraction(pixel);
        let seconds = calibrated.pixel_time_s(pixel);
        let relative = motion.at(seconds);
        let unshifted = *own * relative.clone_from_imu;
        let mut rate = Vector6::zeros();
        rate.fixed_rows_mut::<3>(0).copy_from(&(own.rotation * relative.angular_velocity));
        rate.fixed_rows_mut::<3>(3).copy_from(&(own.rotation * relative.velocity));

        let Some(neighbour) = OtherClone::of(state, clone, seconds) else {
            let own = ClonePart { weight: 1.0, lever: unshifted.translation - own.translation };
            let dependence = RowDependence { own, neighbour: None, by_readout: rate * fraction };
            return Self { local_from_imu: unshifted, dependence: Some(dependence) };
        };
        let other = estimates.of(&state.clones[neighbour.index]);
        let expected = *own * neighbour.own_from_other;
        let turn = rotation::log(&(other.rotation * expected.rotation.inverse()));
        let shift = other.translation - expected.translation;
        let arm = unshifted.translation - expected.translation;
        let weight = seconds / neighbour.seconds;
        let turned = rotation::exp(&(turn * weight));
        let pose =
            Pose::new(turned * unshifted.rotation, expected.translation + shift * weight + turned * arm);
        // What the difference of the clones adds.
        let mut of_rotation = rate.fixed_rows_mut::<3>(0);
        of_rotation += turn / neighbour.seconds;
        let mut of_position = rate.fixed_rows_mut::<3>(3);
        of_position += (shift + turn.cross(&arm)) / neighbour.seconds;
        let part = |weight: f64, of: &Pose| ClonePart { weight, lever: pose.translation - of.translation };
        Self {
            local_from_imu: pose,
            dependence: Some(RowDependence {
                own: part(1.0 - weight, own),
                neighbour: Some((neighbour.index, part(weight, other))),
                by_readout: rate * fraction,
            }),
        }
    }
}

/// The clone between which and an image's own one a row is interpolated.
struct OtherClone {
    index: usize,
    /// Its time after the image, seconds.
    seconds: f64,
    /// Its pose in the frame of the image's clone, by the readings of the IMU.
    own_from_other: Pose,
}

impl OtherClone {
    /// The next clone for rows after the image, the one before for those before it, or else the other one of these; `None`
    /// where neither is left.
    fn of(state: &ActiveState, clone: usize, seconds: f64) -> Option<Self> {
        let before = || {
            let (since, before_from_own) = since_before(state, clone)?;
            let own_from_other = before_from_own.inverse();
            Some(Self { index: clone - 1, seconds: -since, own_from_other })
        };
        let after = || {
            let (until, own_from_other) = since_before(state, clone + 1)?;
            Some(Self { index: clone + 1, seconds: until, own_from_other })
        };
        if seconds < 0.0 { before().or_else(after) } else { after().or_else(before) }
    }
}

/// Time and motion since the clone before, if that is still in the window.
fn since_before(state: &ActiveState, clone: usize) -> Option<(f64, Pose)> {
    let before = state.clones.get(clone.checked_sub(1)?)?;
    let own = state.clones.get(clone)?;
    let is_next = own.id.0 == before.id.0 + 1;
    own.motion.as_ref().filter(|_| is_next)?.since_before
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rolling_shutter::motion_around::MotionAround;
    use crate::state::{CloneId, POSE_DIM};
    use crate::test_scene::rolling_scene;
    use geometry::numeric::numeric_jacobian;
    use nalgebra::{DMatrix, DVector, Matrix6};

    fn pixels() -> [Vector2<f64>; 3] {
        [Vector2::new(10.0, 3.0), Vector2::new(320.0, 239.5), Vector2::new(500.0, 470.0)]
    }

    /// The dependence on a clone as a matrix.
    fn matrix(part: &ClonePart) -> Matrix6<f64> {
        let mut matrix = Matrix6::zeros();
        for k in 0..3 {
            let mut rows = Matrix2x6::zeros();
            (rows[(0, 2 * k)], rows[(1, 2 * k + 1)]) = (1.0, 1.0);
            matrix.fixed_view_mut::<2, 6>(2 * k, 0).copy_from(&part.chain(&rows));
        }
        matrix
    }

    #[test]
    fn the_dependence_of_a_row_is_its_numeric_derivative() {
        // Of clones that differ from the readings by 26 mm, a third of that at most is neglected.
        let mut late = rolling_scene(0.0, true);
        late.state.calibration.cameras[0].delay_s = 0.004;
        let scenes = [(rolling_scene(0.03, true), 1e-6), (rolling_scene(0.03, false), 8e-3), (late, 1e-6)];
        for (scene, tolerance) in scenes {
            for (clone, pixel) in [0, 3, 7].into_iter().flat_map(|clone| pixels().map(|pixel| (clone, pixel)))
            {
                let row = |state: &ActiveState| RowPose::of(state, clone, 0, &pixel, Estimates::Newest);
                let at = row(&scene.state);
                let dependence = at.dependence.unwrap();
                let error_of = |pose: &RowPose| {
                    DVector::from_column_slice(at.local_from_imu.local(&pose.local_from_imu).as_slice())
                };
                let mut analytic = DMatrix::zeros(6, POSE_DIM * scene.state.clones.len());
                let mut put = |index: usize, part: &ClonePart| {
                    analytic.fixed_view_mut::<6, 6>(0, POSE_DIM * index).copy_from(&matrix(part));
                };
                put(clone, &dependence.own);
                let (neighbour, part) = dependence.neighbour.unwrap();
                put(neighbour, &part);
                let numeric = numeric_jacobian(analytic.ncols(), |error| {
                    let mut moved = scene.state.clone();
                    for (index, clone) in moved.clones.iter_mut().enumerate() {
                        let step = error.fixed_rows::<6>(POSE_DIM * index).into();
                        clone.local_from_imu = clone.local_from_imu.retract(&step);
                    }
                    error_of(&row(&moved))
                });
                let difference = (&numeric - &analytic).amax();
                assert!(difference < tolerance, "clone {clone}, {pixel}: {difference}");

                let by_readout = numeric_jacobian(1, |change| {
                    let mut moved = scene.state.clone();
                    moved.calibration.cameras[0].readout_s += change[0];
                    error_of(&row(&moved))
                });
                assert!((by_readout - dependence.by_readout).amax() < tolerance, "clone {clone}, {pixel}");
            }
        }
    }

    #[test]
    fn a_row_moves_with_the_frame_at_any_estimates() {
        let mut scene = rolling_scene(0.03, false);
        scene.state.calibration.cameras[0].delay_s = -0.003;
        let turn = Pose::new(rotation::exp(&Vector3::new(0.3, -0.2, 1.4)), Vector3::new(5.0, -7.0, 2.0));
        let mut moved = scene.state.clone();
        for clone in &mut moved.clones {
            clone.local_from_imu = turn * clone.local_from_imu;
            clone.first_estimate = turn * clone.first_estimate;
        }
        for estimates in [Estimates::First, Estimates::Newest] {
            for (clone, pixel) in [0, 4, 7].into_iter().zip(pixels()) {
                let row = RowPose::of(&scene.state, clone, 0, &pixel, estimates);
                let expected = turn * row.local_from_imu;
                let found = RowPose::of(&moved, clone, 0, &pixel, estimates);
                assert!(found.local_from_imu.local(&expected).amax() < 1e-12);
                // So do the Jacobians: a turn and a shift of all clones is that turn and shift of the row.
                let dependence = row.dependence.unwrap();
                let gauge = |point: &Vector3<f64>| {
                    let mut gauge = Matrix6::identity();
                    gauge.fixed_view_mut::<3, 3>(3, 0).copy_from(&-rotation::skew(point));
                    gauge
                };
                let mut sum =
                    matrix(&dependence.own) * gauge(&estimates.of(&scene.state.clones[clone]).translation);
                let (neighbour, part) = dependence.neighbour.unwrap();
                sum += matrix(&part) * gauge(&estimates.of(&scene.state.clones[neighbour]).translation);
                assert!((sum - gauge(&row.local_from_imu.translation)).amax() < 1e-12);
            }
        }
    }

    #[test]
    fn where_the_clones_agree_with_the_readings_the_row_is_where_these_say() {
        let mut scene = rolling_scene(0.03, true);
        for delay_s in [0.0, 0.004] {
            scene.state.calibration.cameras[0].delay_s = delay_s;
            for (clone, pixel) in [0, 4, 7].into_iter().zip(pixels()) {
                let row = RowPose::of(&scene.state, clone, 0, &pixel, Estimates::Newest);
                let own = &scene.state.clones[clone];
                let seconds = delay_s + scene.state.calibration.cameras[0].row_fraction(&pixel) * 0.03;
                let expected = own.local_from_imu * own.motion.as_ref().unwrap().at(seconds).clone_from_imu;
                assert!(row.local_from_imu.local(&expected).amax() < 1e-12);
            }
        }
    }

    #[test]
    fn a_clone_without_neighbours_has_the_motion_of_its_readings() {
        let mut scene = rolling_scene(0.03, false);
        // As one that a query to the map has kept.
        scene.state.clones.remove(1);
        assert_eq!(scene.state.clones[1].id, CloneId(2));
        let row = RowPose::of(&scene.state, 0, 0, &pixels()[0], Estimates::Newest);
        assert!(row.dependence.unwrap().neighbour.is_none());
        let motion: &MotionAround = scene.state.clones[0].motion.as_ref().unwrap();
        let seconds = scene.state.calibration.cameras[0].row_fraction(&pixels()[0]) * 0.03;
        let expected = scene.state.clones[0].local_from_imu * motion.at(seconds).clone_from_imu;
        assert_eq!(row.local_from_imu, expected);
        let next = RowPose::of(&scene.state, 1, 0, &pixels()[0], Estimates::Newest);
        assert_eq!(next.dependence.unwrap().neighbour.unwrap().0, 2);
    }
}
