//! The robot's cameras as the filter knows them, and what of that it estimates online.
//!
//! Off by default: a calibration that is right is better left alone, and some motions (straight at a constant speed,
//! one axis of rotation) do not show all of it. Errors, in the order of the active state, only of what is estimated:
//! ```text
//! time offset (1)                       seconds; t_imu = t_camera + offset
//! of each camera: extrinsics (6)        [δθ, δp] of imu_from_camera, R = Exp(δθ) R̂, in the IMU's frame
//!                 intrinsics (4 to 8)   [fx, fy, cx, cy, distortion...]
//! ```
//! Source: Li & Mourikis, "Online temporal calibration for camera-IMU systems", IJRR 2014; Li, Yu, Zheng & Mourikis,
//! "High-fidelity sensor modeling and self-calibration in vision-aided inertial navigation", ICRA 2014.

use geometry::{Camera, MAX_INTRINSICS, Pose};
use nalgebra::{DMatrix, DVectorView, Matrix2x3, Matrix2x6, SMatrix, SVector, Vector2, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A camera of the robot's rig.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedCamera {
    /// Its intrinsics.
    pub camera: Camera,
    /// Where it sits on the body.
    pub imu_from_camera: Pose,
}

/// What is estimated online, and how uncertain it is at the start (one standard deviation).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OnlineCalibration {
    /// Estimate where each camera sits on the body.
    pub extrinsics: bool,
    /// Estimate focal length, centre and distortion of each camera.
    pub intrinsics: bool,
    /// Estimate by how much the cameras' clock is behind the IMU's.
    pub time_offset: bool,
    /// Orientation of a camera on the body, rad.
    pub sigma_rotation: f64,
    /// Position of a camera on the body, metres.
    pub sigma_position: f64,
    /// Focal length, as a part of itself.
    pub sigma_focal: f64,
    /// What cameras of a rig that were calibrated together share of these three errors; the rest, independent of each
    /// other, is so much smaller: 0.1 for a tenth.
    pub relative: f64,
    /// Principal point, px.
    pub sigma_centre: f64,
    /// Each coefficient of the distortion.
    pub sigma_distortion: f64,
    /// Time offset, seconds.
    pub sigma_time_offset: f64,
}

impl Default for OnlineCalibration {
    /// Nothing is estimated. The deviations are those of a calibration by hand: 2 degrees, 3 cm, 1 % of the focal
    /// length, 5 px, 10 ms.
    fn default() -> Self {
        Self {
            extrinsics: false,
            intrinsics: false,
            time_offset: false,
            sigma_rotation: 0.035,
            sigma_position: 0.03,
            sigma_focal: 0.01,
            relative: 0.1,
            sigma_centre: 5.0,
            sigma_distortion: 0.01,
            sigma_time_offset: 0.01,
        }
    }
}

/// Width of a camera's own error when all of it is estimated.
pub const CAMERA_DIM: usize = 6 + MAX_INTRINSICS;

/// The cameras and the time offset, with the layout of their errors.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Cameras by their number.
    pub rig: Vec<CalibratedCamera>,
    /// What is added to a camera's time to have the IMU's, seconds.
    pub time_offset: f64,
    online: OnlineCalibration,
}

impl Calibration {
    /// As the sequence or the user states it.
    pub fn new(rig: Vec<CalibratedCamera>, time_offset: f64, online: OnlineCalibration) -> Self {
        Self { rig, time_offset, online }
    }

    /// Numbers in the error: none if nothing is estimated.
    pub fn dim(&self) -> usize {
        self.time_offset_dim() + (0..self.rig.len()).map(|camera| self.camera_dim(camera)).sum::<usize>()
    }

    fn time_offset_dim(&self) -> usize {
        usize::from(self.online.time_offset)
    }

    fn extrinsics_dim(&self) -> usize {
        if self.online.extrinsics { 6 } else { 0 }
    }

    fn camera_dim(&self, camera: usize) -> usize {
        let intrinsics = if self.online.intrinsics { self.rig[camera].camera.intrinsics_len() } else { 0 };
        self.extrinsics_dim() + intrinsics
    }

    /// Whether the time offset is estimated; its error is the first then.
    pub fn estimates_time_offset(&self) -> bool {
        self.online.time_offset
    }

    /// Where a camera's errors stand among those of the calibration.
    pub fn camera_range(&self, camera: usize) -> Range<usize> {
        let begin = self.time_offset_dim() + (0..camera).map(|before| self.camera_dim(before)).sum::<usize>();
        begin..begin + self.camera_dim(camera)
    }

    /// Covariance of the errors at the start. What was calibrated together is wrong together.
    pub fn initial_covariance(&self) -> DMatrix<f64> {
        let online = &self.online;
        let mut covariance = DMatrix::zeros(self.dim(), self.dim());
        if online.time_offset {
            covariance[(0, 0)] = online.sigma_time_offset.powi(2);
        }
        let sigmas: Vec<Vec<(f64, bool)>> = self.rig.iter().map(|eye| self.initial_sigmas(eye)).collect();
        for (row, of_row) in sigmas.iter().enumerate() {
            for (column, of_column) in sigmas.iter().enumerate() {
                let begin = (self.camera_range(row).start, self.camera_range(column).start);
                for (k, (&(sigma, shared), &(other, _))) in of_row.iter().zip(of_column).enumerate() {
                    let own = if row == column { 1.0 } else { 0.0 };
                    let share = if shared { 1.0 + own * online.relative.powi(2) } else { own };
                    covariance[(begin.0 + k, begin.1 + k)] = share * sigma * other;
                }
            }
        }
        covariance
    }

    /// Deviations of one camera's errors, and whether the other cameras share them.
    fn initial_sigmas(&self, eye: &CalibratedCamera) -> Vec<(f64, bool)> {
        let online = &self.online;
        let mut sigmas = Vec::with_capacity(CAMERA_DIM);
        if online.extrinsics {
            sigmas.extend([(online.sigma_rotation, true); 3]);
            sigmas.extend([(online.sigma_position, true); 3]);
        }
        if online.intrinsics {
            sigmas.extend(eye.camera.focal.map(|focal| (focal * online.sigma_focal, true)));
            sigmas.extend([(online.sigma_centre, false); 2]);
            let rest = eye.camera.intrinsics_len() - 4;
            sigmas.resize(sigmas.len() + rest, (online.sigma_distortion, false));
        }
        sigmas
    }

    /// Adds an error.
    pub fn retract(&mut self, error: &DVectorView<'_, f64>) {
        if self.online.time_offset {
            self.time_offset += error[0];
        }
        for camera in 0..self.rig.len() {
            let range = self.camera_range(camera);
            let extrinsics = self.extrinsics_dim();
            let eye = &mut self.rig[camera];
            if extrinsics > 0 {
                let step: Vector6<f64> = error.fixed_rows::<6>(range.start).into();
                eye.imu_from_camera = eye.imu_from_camera.retract(&step);
            }
            if self.online.intrinsics {
                let mut step = SVector::<f64, MAX_INTRINSICS>::zeros();
                let count = range.len() - extrinsics;
                step.rows_mut(0, count).copy_from(&error.rows(range.start + extrinsics, count));
                eye.camera.add_to_intrinsics(&step);
            }
        }
    }

    /// Whether every number is finite and every camera still one.
    pub fn is_sound(&self) -> bool {
        self.time_offset.is_finite()
            && self.rig.iter().all(|eye| eye.imu_from_camera.is_finite() && eye.camera.validate().is_ok())
    }

    /// How an observation of `camera` depends on that camera's errors: the first columns, as many as
    /// [`Self::camera_range`] is long, in that order.
    pub fn camera_jacobian(&self, camera: usize, observation: &Observation) -> CameraJacobian {
        let mut jacobian = CameraJacobian::zeros();
        let extrinsics = self.extrinsics_dim();
        if extrinsics > 0 {
            jacobian.fixed_view_mut::<2, 6>(0, 0).copy_from(&observation.of_extrinsics);
        }
        if self.online.intrinsics
            && let Ok(of_intrinsics) = self.rig[camera].camera.intrinsics_jacobian(&observation.in_camera)
        {
            jacobian.fixed_view_mut::<2, MAX_INTRINSICS>(0, extrinsics).copy_from(&of_intrinsics);
        }
        jacobian
    }
}

/// Derivative of a pixel by the errors of its camera.
pub type CameraJacobian = SMatrix<f64, 2, CAMERA_DIM>;

/// A landmark as a camera on the body sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Where, px.
    pub pixel: Vector2<f64>,
    /// In the camera's frame, metres.
    pub in_camera: Vector3<f64>,
    /// By the error of the body's pose, `[δθ, δp]` in L.
    pub of_body: Matrix2x6<f64>,
    /// By the landmark in L.
    pub of_landmark: Matrix2x3<f64>,
    /// By the error of the camera's pose on the body.
    pub of_extrinsics: Matrix2x6<f64>,
}

impl CalibratedCamera {
    /// The pixel of a landmark in L.
    pub fn predict(&self, local_from_imu: &Pose, landmark: &Vector3<f64>) -> Option<Vector2<f64>> {
        let in_camera = self.imu_from_camera.inverse_transform(&local_from_imu.inverse_transform(landmark));
        self.camera.project(&in_camera).ok()
    }

    /// The pixel of a landmark in L, and its Jacobians.
    pub fn observe(&self, local_from_imu: &Pose, landmark: &Vector3<f64>) -> Option<Observation> {
        let in_imu = local_from_imu.inverse_transform(landmark);
        let (of_pose, of_point) = local_from_imu.inverse_transform_jacobians(landmark);
        let in_camera = self.imu_from_camera.inverse_transform(&in_imu);
        let (by_extrinsics, by_point) = self.imu_from_camera.inverse_transform_jacobians(&in_imu);
        let (pixel, of_ray) = self.camera.project_with_jacobian(&in_camera).ok()?;
        let of_imu = of_ray * by_point;
        Some(Observation {
            pixel,
            in_camera,
            of_body: of_imu * of_pose,
            of_landmark: of_imu * of_point,
            of_extrinsics: of_ray * by_extrinsics,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::numeric::numeric_jacobian;
    use geometry::{Distortion, rotation};
    use nalgebra::DVector;

    #[test]
    fn an_observation_depends_on_body_landmark_and_camera_as_its_jacobians_say() {
        let distortions = [
            Distortion::None,
            Distortion::RadialTangential([-0.28, 0.07, 2e-4, 2e-5]),
            Distortion::Equidistant([-0.01, 0.02, -0.01, 0.002]),
            Distortion::Fov(0.92),
        ];
        for distortion in distortions {
            let camera =
                Camera { width: 752, height: 480, focal: [458.0, 457.0], centre: [367.0, 248.0], distortion };
            let pose = |x: f64, y: f64, z: f64| {
                Pose::new(rotation::exp(&Vector3::new(x, y, z)), Vector3::new(y, z, x))
            };
            let rig = [
                CalibratedCamera { camera: camera.clone(), imu_from_camera: pose(0.1, -0.2, 0.3) },
                CalibratedCamera { camera, imu_from_camera: pose(-0.1, 0.2, 0.1) },
            ];
            let online = OnlineCalibration {
                extrinsics: true,
                intrinsics: true,
                time_offset: true,
                ..Default::default()
            };
            let calibration = Calibration::new(rig.to_vec(), 0.003, online);
            let (body, landmark) = (pose(0.2, 0.1, -0.1), Vector3::new(0.4, -0.3, 4.0));
            for number in 0..2 {
                let observation = calibration.rig[number].observe(&body, &landmark).unwrap();
                let pixel = |rig: &CalibratedCamera, body: &Pose, landmark: &Vector3<f64>| {
                    DVector::from_column_slice(rig.predict(body, landmark).unwrap().as_slice())
                };
                let own = &calibration.rig[number];
                let of_body = numeric_jacobian(6, |e| {
                    pixel(own, &body.retract(&e.fixed_rows::<6>(0).into()), &landmark)
                });
                assert!((of_body - observation.of_body).amax() < 1e-5);
                let of_landmark =
                    numeric_jacobian(3, |e| pixel(own, &body, &(landmark + e.fixed_rows::<3>(0))));
                assert!((of_landmark - observation.of_landmark).amax() < 1e-5);
                let all = numeric_jacobian(calibration.dim(), |e| {
                    let mut moved = calibration.clone();
                    moved.retract(&e.as_view());
                    pixel(&moved.rig[number], &body, &landmark)
                });
                let range = calibration.camera_range(number);
                let analytic = calibration.camera_jacobian(number, &observation);
                let difference = all.columns(range.start, range.len()) - analytic.columns(0, range.len());
                assert!(difference.amax() < 1e-5, "{distortion:?}: {difference}");
                let sum: f64 = all.iter().map(|value| value.abs()).sum();
                assert!((sum - analytic.iter().map(|value| value.abs()).sum::<f64>()).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn nothing_is_estimated_unless_asked_for() {
        let camera = Camera {
            width: 10,
            height: 10,
            focal: [5.0; 2],
            centre: [5.0; 2],
            distortion: Distortion::Fov(0.9),
        };
        let rig = vec![CalibratedCamera { camera, imu_from_camera: Pose::identity() }];
        assert_eq!(Calibration::new(rig.clone(), 0.0, OnlineCalibration::default()).dim(), 0);
        let online = OnlineCalibration { intrinsics: true, time_offset: true, ..Default::default() };
        let calibration = Calibration::new(rig, 0.0, online);
        assert_eq!((calibration.dim(), calibration.camera_range(0)), (6, 1..6));
        assert_eq!(calibration.initial_covariance().nrows(), 6);
    }
}
