//! Cameras, their extrinsics and time offset, and the online calibration of any of these.
//!
//! Online calibration is off by default: it does not improve a correct calibration, and some motions (straight at
//! constant speed, rotation about one axis) leave parts of it unobservable. Errors in the order of the active state, only
//! of what is estimated:
//! ```text
//! time offset (1)                       seconds; t_imu = t_camera + offset
//! of each camera: extrinsics (6)        [δθ, δp] of imu_from_camera, R = Exp(δθ) R̂, in the IMU's frame
//!                 intrinsics (4 to 8)   [fx, fy, cx, cy, distortion...]
//!                 readout time (1)      seconds
//! ```
//! Source: Li & Mourikis, "Online temporal calibration for camera-IMU systems", IJRR 2014; Li, Yu, Zheng & Mourikis,
//! "High-fidelity sensor modeling and self-calibration in vision-aided inertial navigation", ICRA 2014.

use geometry::{Camera, CameraGroup, MAX_INTRINSICS, Pose, camera_groups};
use nalgebra::{DMatrix, DVectorView, Matrix2x3, Matrix2x6, SMatrix, SVector, Vector2, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A camera with its extrinsics.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedCamera {
    /// Its intrinsics.
    pub camera: Camera,
    /// Camera pose in the IMU frame (extrinsics).
    pub imu_from_camera: Pose,
    /// Time from the readout of the first row to that after the last one, seconds: 0 for a global shutter. An image's stamp is the
    /// time of its middle row, see [`rolling_shutter`](crate::rolling_shutter).
    pub readout_s: f64,
    /// Time of its images after the stamp of their frame, seconds: of cameras that are exposed together, but with delays that are calibrated.
    /// Its pixels are predicted from the pose at their own time, as rows of a rolling shutter are.
    pub delay_s: f64,
}

/// Which calibration parameters are estimated online, and their initial standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of its own")]
pub struct OnlineCalibration {
    /// Estimate the extrinsics of each camera.
    pub extrinsics: bool,
    /// Estimate focal length, principal point and distortion of each camera.
    pub intrinsics: bool,
    /// Estimate the time offset between the cameras and the IMU.
    pub time_offset: bool,
    /// Estimate the readout time of each camera's rolling shutter.
    pub readout_time: bool,
    /// Orientation of a camera in the IMU frame, rad.
    pub sigma_rotation_rad: f64,
    /// Position of a camera in the IMU frame, metres.
    pub sigma_position_m: f64,
    /// Focal length, as a fraction of itself.
    pub sigma_focal_fraction: f64,
    /// Cameras that were calibrated together share these three errors; their independent parts have standard deviations
    /// this fraction of the above.
    pub sigma_relative_fraction: f64,
    /// Principal point, px.
    pub sigma_principal_point_px: f64,
    /// Each distortion coefficient (no unit).
    pub sigma_distortion: f64,
    /// Time offset, seconds.
    pub sigma_time_offset_s: f64,
    /// Readout time of each camera, seconds.
    pub sigma_readout_time_s: f64,
}

impl Default for OnlineCalibration {
    /// Nothing is estimated. The standard deviations are those of a manual calibration: 2 degrees, 3 cm, 1 % of the focal
    /// length, 5 px, 10 ms. That of the readout time is for a camera of which nothing is known.
    fn default() -> Self {
        Self {
            extrinsics: false,
            intrinsics: false,
            time_offset: false,
            readout_time: false,
            sigma_rotation_rad: 0.035,
            sigma_position_m: 0.03,
            sigma_focal_fraction: 0.01,
            sigma_relative_fraction: 0.1,
            sigma_principal_point_px: 5.0,
            sigma_distortion: 0.01,
            sigma_time_offset_s: 0.01,
            sigma_readout_time_s: 0.015,
        }
    }
}

/// Dimension of the error of one camera when all of it is estimated.
pub const CAMERA_DIM: usize = 6 + MAX_INTRINSICS + 1;

/// How far the times of pixels reach from that of the frame, nanoseconds.
pub fn row_reach_ns(cameras: &[CalibratedCamera]) -> i64 {
    let reach = |calibrated: &CalibratedCamera| calibrated.delay_s.abs() + 0.5 * calibrated.readout_s.abs();
    let longest = cameras.iter().map(reach).fold(0.0, f64::max);
    (longest.min(MAX_ROW_REACH_S) * 1e9) as i64
}

/// Motion about an image is known this far, seconds: half of the longest readout time of any camera, and its delay.
const MAX_ROW_REACH_S: f64 = 0.1;

/// Cameras and time offset, with the layout of their errors.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Cameras by index.
    pub cameras: Vec<CalibratedCamera>,
    /// Added to a camera's time stamp to obtain the IMU's, seconds.
    pub time_offset: f64,
    online: OnlineCalibration,
}

impl Calibration {
    /// The initial calibration.
    ///
    /// # Arguments
    /// * `time_offset`: added to a camera's time stamp to obtain the IMU's, seconds.
    pub fn new(cameras: Vec<CalibratedCamera>, time_offset: f64, online: OnlineCalibration) -> Self {
        Self { cameras, time_offset, online }
    }

    /// Which cameras are stereo pairs.
    pub fn camera_groups(&self) -> Vec<CameraGroup> {
        camera_groups(self.cameras.iter().map(|calibrated| (&calibrated.camera, &calibrated.imu_from_camera)))
    }

    /// Dimension of the error: 0 if nothing is estimated.
    pub fn dim(&self) -> usize {
        self.time_offset_dim() + (0..self.cameras.len()).map(|camera| self.camera_dim(camera)).sum::<usize>()
    }

    fn time_offset_dim(&self) -> usize {
        usize::from(self.online.time_offset)
    }

    fn extrinsics_dim(&self) -> usize {
        if self.online.extrinsics { 6 } else { 0 }
    }

    fn camera_dim(&self, camera: usize) -> usize {
        let intrinsics =
            if self.online.intrinsics { self.cameras[camera].camera.intrinsics_len() } else { 0 };
        self.extrinsics_dim() + intrinsics + usize::from(self.online.readout_time)
    }

    /// Whether the time offset is estimated; if so, its error is the first.
    pub fn estimates_time_offset(&self) -> bool {
        self.online.time_offset
    }

    /// Whether rows of images have times of their own.
    pub fn has_rolling_shutter(&self) -> bool {
        self.online.readout_time || self.cameras.iter().any(|calibrated| calibrated.readout_s != 0.0)
    }

    /// Whether pixels have times of their own: of rows that are read out one after the other, or of cameras that are exposed later than
    /// others.
    pub fn has_pixel_times(&self) -> bool {
        self.has_rolling_shutter() || self.cameras.iter().any(|calibrated| calibrated.delay_s != 0.0)
    }

    /// How far the times of rows reach from that of the frame, nanoseconds.
    pub(crate) fn row_reach_ns(&self) -> i64 {
        let uncertain = if self.online.readout_time { self.online.sigma_readout_time_s } else { 0.0 };
        row_reach_ns(&self.cameras) + (uncertain * 1e9) as i64
    }

    /// Whether what is estimated shows in the images of a camera at rest: the readout time does not.
    pub fn shows_at_rest(&self) -> bool {
        self.online.time_offset || self.online.extrinsics || self.online.intrinsics
    }

    /// Index of the error of a camera's readout time within those of the calibration; `None` where it is not estimated.
    pub fn readout_index(&self, camera: usize) -> Option<usize> {
        self.online.readout_time.then(|| self.camera_range(camera).end - 1)
    }

    /// Range of a camera's errors within those of the calibration.
    pub fn camera_range(&self, camera: usize) -> Range<usize> {
        let begin = self.time_offset_dim() + (0..camera).map(|before| self.camera_dim(before)).sum::<usize>();
        begin..begin + self.camera_dim(camera)
    }

    /// Initial covariance of the errors, correlated between cameras (see
    /// [`OnlineCalibration::sigma_relative_fraction`]).
    pub fn initial_covariance(&self) -> DMatrix<f64> {
        let online = &self.online;
        let mut covariance = DMatrix::zeros(self.dim(), self.dim());
        if online.time_offset {
            covariance[(0, 0)] = online.sigma_time_offset_s.powi(2);
        }
        let sigmas: Vec<Vec<(f64, bool)>> =
            self.cameras.iter().map(|calibrated| self.initial_sigmas(calibrated)).collect();
        for (row, of_row) in sigmas.iter().enumerate() {
            for (column, of_column) in sigmas.iter().enumerate() {
                let begin = (self.camera_range(row).start, self.camera_range(column).start);
                for (k, (&(sigma, shared), &(other, _))) in of_row.iter().zip(of_column).enumerate() {
                    let own = if row == column { 1.0 } else { 0.0 };
                    let share = if shared { 1.0 + own * online.sigma_relative_fraction.powi(2) } else { own };
                    covariance[(begin.0 + k, begin.1 + k)] = share * sigma * other;
                }
            }
        }
        covariance
    }

    /// Standard deviations of one camera's errors, each with whether the other cameras share it.
    fn initial_sigmas(&self, calibrated: &CalibratedCamera) -> Vec<(f64, bool)> {
        let online = &self.online;
        let mut sigmas = Vec::with_capacity(CAMERA_DIM);
        if online.extrinsics {
            sigmas.extend([(online.sigma_rotation_rad, true); 3]);
            sigmas.extend([(online.sigma_position_m, true); 3]);
        }
        if online.intrinsics {
            sigmas.extend(calibrated.camera.focal.map(|focal| (focal * online.sigma_focal_fraction, true)));
            sigmas.extend([(online.sigma_principal_point_px, false); 2]);
            let rest = calibrated.camera.intrinsics_len() - 4;
            sigmas.resize(sigmas.len() + rest, (online.sigma_distortion, false));
        }
        if online.readout_time {
            sigmas.push((online.sigma_readout_time_s, false));
        }
        sigmas
    }

    /// Adds an error of dimension [`Self::dim`].
    pub fn retract(&mut self, error: &DVectorView<'_, f64>) {
        if self.online.time_offset {
            self.time_offset += error[0];
        }
        for camera in 0..self.cameras.len() {
            let range = self.camera_range(camera);
            let extrinsics = self.extrinsics_dim();
            let readout = usize::from(self.online.readout_time);
            let calibrated = &mut self.cameras[camera];
            if extrinsics > 0 {
                let step: Vector6<f64> = error.fixed_rows::<6>(range.start).into();
                calibrated.imu_from_camera = calibrated.imu_from_camera.retract(&step);
            }
            if self.online.intrinsics {
                let mut step = SVector::<f64, MAX_INTRINSICS>::zeros();
                let count = range.len() - extrinsics - readout;
                step.rows_mut(0, count).copy_from(&error.rows(range.start + extrinsics, count));
                calibrated.camera.add_to_intrinsics(&step);
            }
            if readout > 0 {
                calibrated.readout_s += error[range.end - 1];
            }
        }
    }

    /// Becomes a copy of `other` in its own memory.
    pub fn copy_from(&mut self, other: &Self) {
        (self.time_offset, self.online) = (other.time_offset, other.online);
        self.cameras.clone_from(&other.cameras);
    }

    /// Whether all values are finite and all intrinsics valid.
    pub fn is_valid(&self) -> bool {
        self.time_offset.is_finite()
            && self.cameras.iter().all(|calibrated| {
                calibrated.imu_from_camera.is_finite()
                    && calibrated.camera.validate().is_ok()
                    && calibrated.readout_s.is_finite()
                    && calibrated.delay_s.is_finite()
            })
    }

    /// Jacobian of a pixel of `camera` with respect to the errors of that camera: the first columns, as many as
    /// [`Self::camera_range`] is long, in that order; zero for the readout time.
    pub fn camera_jacobian(&self, camera: usize, projection: &Projection) -> CameraJacobian {
        let mut jacobian = CameraJacobian::zeros();
        let extrinsics = self.extrinsics_dim();
        if extrinsics > 0 {
            jacobian.fixed_view_mut::<2, 6>(0, 0).copy_from(&projection.wrt_extrinsics);
        }
        if self.online.intrinsics
            && let Ok(wrt_intrinsics) = self.cameras[camera].camera.intrinsics_jacobian(&projection.in_camera)
        {
            jacobian.fixed_view_mut::<2, MAX_INTRINSICS>(0, extrinsics).copy_from(&wrt_intrinsics);
        }
        jacobian
    }
}

/// Jacobian of a pixel with respect to the errors of its camera.
pub type CameraJacobian = SMatrix<f64, 2, CAMERA_DIM>;

/// A projected landmark and the Jacobians of its pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// Predicted pixel, distorted.
    pub pixel: Vector2<f64>,
    /// The landmark in the camera frame, metres.
    pub in_camera: Vector3<f64>,
    /// With respect to the error of the IMU pose, `[δθ, δp]` in L.
    pub wrt_body: Matrix2x6<f64>,
    /// With respect to the landmark in L.
    pub wrt_landmark: Matrix2x3<f64>,
    /// With respect to the error of the extrinsics.
    pub wrt_extrinsics: Matrix2x6<f64>,
}

impl CalibratedCamera {
    /// A camera with a global shutter and no delay.
    pub fn new(camera: Camera, imu_from_camera: Pose) -> Self {
        Self { camera, imu_from_camera, readout_s: 0.0, delay_s: 0.0 }
    }

    /// Time at which a pixel was taken after the stamp of its frame, seconds.
    pub fn pixel_time_s(&self, pixel: &Vector2<f64>) -> f64 {
        self.delay_s + self.row_fraction(pixel) * self.readout_s
    }

    /// Time at which the row of a pixel was read out, as a fraction of the readout time after the middle of it.
    pub fn row_fraction(&self, pixel: &Vector2<f64>) -> f64 {
        (pixel.y + 0.5) / f64::from(self.camera.height) - 0.5
    }

    /// The predicted pixel of a landmark in L; `None` where it does not project.
    pub fn predict(&self, local_from_imu: &Pose, landmark: &Vector3<f64>) -> Option<Vector2<f64>> {
        let in_camera = self.imu_from_camera.inverse_transform(&local_from_imu.inverse_transform(landmark));
        self.camera.project(&in_camera).ok()
    }

    /// The predicted pixel of a landmark in L and its Jacobians; `None` where it does not project.
    pub fn predict_with_jacobians(
        &self,
        local_from_imu: &Pose,
        landmark: &Vector3<f64>,
    ) -> Option<Projection> {
        let in_imu = local_from_imu.inverse_transform(landmark);
        let (in_imu_wrt_pose, in_imu_wrt_landmark) = local_from_imu.inverse_transform_jacobians(landmark);
        let in_camera = self.imu_from_camera.inverse_transform(&in_imu);
        let (in_camera_wrt_extrinsics, in_camera_wrt_in_imu) =
            self.imu_from_camera.inverse_transform_jacobians(&in_imu);
        let (pixel, wrt_in_camera) = self.camera.project_with_jacobian(&in_camera).ok()?;
        let wrt_in_imu = wrt_in_camera * in_camera_wrt_in_imu;
        Some(Projection {
            pixel,
            in_camera,
            wrt_body: wrt_in_imu * in_imu_wrt_pose,
            wrt_landmark: wrt_in_imu * in_imu_wrt_landmark,
            wrt_extrinsics: wrt_in_camera * in_camera_wrt_extrinsics,
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
    fn the_jacobians_of_a_projection_are_its_numeric_derivatives() {
        let distortions = [
            Distortion::None,
            Distortion::RadialTangential([-0.28, 0.07, 2e-4, 2e-5]),
            Distortion::Equidistant([-0.01, 0.02, -0.01, 0.002]),
            Distortion::Fov(0.92),
            Distortion::Rational([-0.21, 0.05, 1e-3, -7e-4, -0.004, 0.02, 0.01, 0.003, 1e-3, 0.0, 0.0, 0.0]),
            Distortion::ThinPrismFisheye([-0.04, 0.01, 2e-4, -4e-4, -0.004, 8e-4, 6e-4, -9e-4]),
            Distortion::DoubleSphere { xi: -0.2, alpha: 0.57 },
            Distortion::Eucm { alpha: 0.63, beta: 1.04 },
            Distortion::Omni { xi: 1.2, distortion: [-0.07, 0.04, -1e-3, 8e-4] },
        ];
        for distortion in distortions {
            let camera =
                Camera { width: 752, height: 480, focal: [458.0, 457.0], centre: [367.0, 248.0], distortion };
            let pose = |x: f64, y: f64, z: f64| {
                Pose::new(rotation::exp(&Vector3::new(x, y, z)), Vector3::new(y, z, x))
            };
            let cameras = [
                CalibratedCamera::new(camera.clone(), pose(0.1, -0.2, 0.3)),
                CalibratedCamera::new(camera, pose(-0.1, 0.2, 0.1)),
            ];
            let online = OnlineCalibration {
                extrinsics: true,
                intrinsics: true,
                time_offset: true,
                ..Default::default()
            };
            let calibration = Calibration::new(cameras.to_vec(), 0.003, online);
            let (body, landmark) = (pose(0.2, 0.1, -0.1), Vector3::new(0.4, -0.3, 4.0));
            for number in 0..2 {
                let projection =
                    calibration.cameras[number].predict_with_jacobians(&body, &landmark).unwrap();
                let pixel = |camera: &CalibratedCamera, body: &Pose, landmark: &Vector3<f64>| {
                    DVector::from_column_slice(camera.predict(body, landmark).unwrap().as_slice())
                };
                let own = &calibration.cameras[number];
                let wrt_body = numeric_jacobian(6, |e| {
                    pixel(own, &body.retract(&e.fixed_rows::<6>(0).into()), &landmark)
                });
                assert!((wrt_body - projection.wrt_body).amax() < 1e-5);
                let wrt_landmark =
                    numeric_jacobian(3, |e| pixel(own, &body, &(landmark + e.fixed_rows::<3>(0))));
                assert!((wrt_landmark - projection.wrt_landmark).amax() < 1e-5);
                let all = numeric_jacobian(calibration.dim(), |e| {
                    let mut moved = calibration.clone();
                    moved.retract(&e.as_view());
                    pixel(&moved.cameras[number], &body, &landmark)
                });
                let range = calibration.camera_range(number);
                let analytic = calibration.camera_jacobian(number, &projection);
                let difference = all.columns(range.start, range.len()) - analytic.columns(0, range.len());
                assert!(difference.amax() < 1e-5, "{distortion:?}: {difference}");
                let sum: f64 = all.iter().map(|value| value.abs()).sum();
                assert!((sum - analytic.iter().map(|value| value.abs()).sum::<f64>()).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn nothing_is_estimated_by_default() {
        let camera = Camera {
            width: 10,
            height: 10,
            focal: [5.0; 2],
            centre: [5.0; 2],
            distortion: Distortion::Fov(0.9),
        };
        let cameras = vec![CalibratedCamera::new(camera, Pose::identity())];
        assert_eq!(Calibration::new(cameras.clone(), 0.0, OnlineCalibration::default()).dim(), 0);
        let online = OnlineCalibration { intrinsics: true, time_offset: true, ..Default::default() };
        let calibration = Calibration::new(cameras, 0.0, online);
        assert_eq!((calibration.dim(), calibration.camera_range(0)), (6, 1..6));
        assert_eq!(calibration.initial_covariance().nrows(), 6);
    }
}
