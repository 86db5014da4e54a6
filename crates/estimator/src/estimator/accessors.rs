//! What the filter tells of its state.

use super::Estimator;
use crate::KeyframeId;
use crate::calibration::{CalibratedCamera, Calibration, row_reach_ns};
use crate::config::EstimatorConfig;
use crate::map_update::map_answer::MapAnswer;
use crate::motion::{Motion, MotionPredictor};
use crate::noise_adaptation::{LearnedNoise, NoiseAdaptation};
use crate::propagation::{ACCELEROMETER_BIAS, GYROSCOPE_BIAS, IMU_DIM, ImuMatrix};
use crate::state::{Block, CloneId, rotation_adjoint};
use crate::wheels::report::Estimated;
use geometry::PoseWithCovariance;
use nalgebra::{DMatrix, Matrix6, Vector3};
use types::ImuNoise;

impl Estimator {
    /// The settings.
    pub fn config(&self) -> &EstimatorConfig {
        &self.config
    }

    /// Time of the state by the IMU's clock, nanoseconds.
    pub fn stamp_ns(&self) -> i64 {
        self.state.stamp_ns
    }

    /// Time of an image by the IMU's clock according to the estimated time offset, nanoseconds. A
    /// [`time_update`](Self::time_update) needs IMU samples up to there.
    pub fn imu_stamp_ns(&self, image_stamp_ns: i64) -> i64 {
        image_stamp_ns + (self.state.calibration.time_offset * 1e9).round() as i64
    }

    /// Time of the last row of an image by the IMU's clock, nanoseconds: where a [`time_update`](Self::time_update) has IMU samples up to
    /// there, it extrapolates no motion. With global shutters the same as [`Self::imu_stamp_ns`].
    pub fn last_row_ns(&self, image_stamp_ns: i64) -> i64 {
        self.imu_stamp_ns(image_stamp_ns) + row_reach_ns(&self.state.calibration.cameras)
    }

    /// Estimated cameras and time offset.
    pub fn calibration(&self) -> &Calibration {
        &self.state.calibration
    }

    /// Covariance of the errors of the [`calibration`](Self::calibration), in its order; empty if nothing of it is estimated.
    pub fn calibration_covariance(&self) -> DMatrix<f64> {
        let range = self.state.range(Block::Calibration).unwrap_or_default();
        self.covariance
            .active()
            .view()
            .view((range.start, range.start), (range.len(), range.len()))
            .into_owned()
    }

    /// Readout time of each camera, seconds, with its standard deviation: 0 where it is not estimated. `None` where all shutters are
    /// global ones.
    pub fn readout_times(&self) -> Option<Vec<Estimated>> {
        let calibration = &self.state.calibration;
        let begin = self.state.range(Block::Calibration).unwrap_or_default().start;
        let variance = |index: usize| self.covariance.active()[(begin + index, begin + index)];
        let of_camera = |(camera, calibrated): (usize, &CalibratedCamera)| {
            let sigma =
                calibration.readout_index(camera).map_or(0.0, |index| variance(index).max(0.0).sqrt());
            Estimated { value: calibrated.readout_s, sigma }
        };
        calibration
            .has_rolling_shutter()
            .then(|| calibration.cameras.iter().enumerate().map(of_camera).collect())
    }

    /// IMU pose in L, with the covariance of its error `[δθ, δp]` in L (rad, metres).
    pub fn local_from_imu(&self) -> PoseWithCovariance {
        PoseWithCovariance {
            pose: self.state.imu.local_from_imu,
            covariance: self.block(&Block::ImuPose, &Block::ImuPose),
        }
    }

    /// Velocity of the IMU in L, m/s.
    pub fn velocity(&self) -> Vector3<f64> {
        self.state.imu.velocity
    }

    /// Pose, velocity, biases and angular velocity of now, with the covariance of their errors.
    pub fn motion(&self) -> Motion {
        let covariance = self.imu_covariance();
        Motion::new(
            self.state.stamp_ns,
            self.state.imu,
            &covariance,
            &self.angular_rate,
            &self.propagation_noise(),
        )
    }

    /// Predicts the motion after now from readings that the filter has not integrated yet.
    pub fn predictor(&self) -> MotionPredictor {
        MotionPredictor::new(
            self.state.stamp_ns,
            &self.imu_covariance(),
            self.propagation(),
            self.propagation_noise(),
            self.imu.check_from_oldest(),
        )
    }

    fn imu_covariance(&self) -> ImuMatrix {
        self.covariance.active().view().fixed_view::<IMU_DIM, IMU_DIM>(0, 0).into_owned()
    }

    /// Noise densities of the IMU as learned up to now.
    fn propagation_noise(&self) -> ImuNoise {
        self.noise.imu_noise(&self.config.imu_noise)
    }

    /// Biases of gyroscope (rad/s) and accelerometer (m/s^2).
    pub fn biases(&self) -> (Vector3<f64>, Vector3<f64>) {
        (self.state.imu.gyroscope_bias, self.state.imu.accelerometer_bias)
    }

    /// Standard deviations of the biases of gyroscope (rad/s) and accelerometer (m/s^2).
    pub fn sigma_biases(&self) -> (Vector3<f64>, Vector3<f64>) {
        let sigma = |begin: usize| {
            Vector3::from_fn(|k, _| self.covariance.active()[(begin + k, begin + k)].max(0.0).sqrt())
        };
        (sigma(GYROSCOPE_BIAS), sigma(ACCELEROMETER_BIAS))
    }

    /// `global_from_local` with the covariance of its error in G, enlarged while the map is in doubt
    /// ([`Alarm::Drift`](crate::Alarm)); `None` before the map initialization.
    pub fn global_from_local(&self) -> Option<PoseWithCovariance> {
        self.filtered_global_from_local().map(|filtered| self.map_watch.claimed(&filtered))
    }

    /// `global_from_local` with the filter's own covariance.
    fn filtered_global_from_local(&self) -> Option<PoseWithCovariance> {
        let pose = self.state.transform?;
        let adjoint = rotation_adjoint(&pose);
        let covariance = adjoint * self.block(&Block::Transform, &Block::Transform) * adjoint.transpose();
        Some(PoseWithCovariance { pose, covariance })
    }

    /// IMU pose in G with the covariance of its error in G, correlations between both parts included, enlarged while the
    /// map is in doubt ([`Alarm::Drift`](crate::Alarm)); `None` before the map initialization.
    pub fn global_from_imu(&self) -> Option<PoseWithCovariance> {
        self.filtered_global_from_imu().map(|filtered| self.map_watch.claimed(&filtered))
    }

    /// IMU pose in G with the filter's own covariance.
    pub(super) fn filtered_global_from_imu(&self) -> Option<PoseWithCovariance> {
        let transform = self.filtered_global_from_local()?;
        Some(transform.compose_correlated(
            &self.local_from_imu(),
            &(rotation_adjoint(&transform.pose) * self.block(&Block::Transform, &Block::ImuPose)),
        ))
    }

    /// Pose of a camera in G at a clone, the prior of a map query; `None` for a marginalized clone, before the map
    /// initialization, and for a camera that there is not.
    pub fn global_from_camera(&self, clone: CloneId, camera: usize) -> Option<PoseWithCovariance> {
        let transform = self.filtered_global_from_local()?;
        let index = self.state.clone_index(clone)?;
        let (pose, block) = (self.state.clones[index].local_from_imu, Block::Clone(index));
        let global_from_imu = transform.compose_correlated(
            &PoseWithCovariance { pose, covariance: self.block(&block, &block) },
            &(rotation_adjoint(&transform.pose) * self.block(&Block::Transform, &block)),
        );
        let exact =
            PoseWithCovariance { pose: self.camera(camera)?.imu_from_camera, covariance: Matrix6::zeros() };
        Some(global_from_imu.compose(&exact))
    }

    /// Pose of a camera in L at a clone; `None` for a marginalized clone, and for a camera that there is not.
    pub fn local_from_camera(&self, clone: CloneId, camera: usize) -> Option<PoseWithCovariance> {
        let index = self.state.clone_index(clone)?;
        let (pose, block) = (self.state.clones[index].local_from_imu, Block::Clone(index));
        let local_from_imu = PoseWithCovariance { pose, covariance: self.block(&block, &block) };
        Some(local_from_imu.change_of_child(&self.camera(camera)?.imu_from_camera))
    }

    /// Unit vector along gravity in the frame of a camera at a clone; `None` for a marginalized clone, and for a camera that
    /// there is not.
    pub fn gravity_in_camera(&self, clone: CloneId, camera: usize) -> Option<Vector3<f64>> {
        let local_from_imu = self.state.clones[self.state.clone_index(clone)?].local_from_imu;
        let local_from_camera = local_from_imu.rotation * self.camera(camera)?.imu_from_camera.rotation;
        Some(local_from_camera.inverse() * -Vector3::z())
    }

    /// Noise levels as learned up to now; see [`noise_adaptation`](crate::noise_adaptation).
    pub fn learned_noise(&self) -> LearnedNoise {
        self.noise.learned()
    }

    /// Continues from noise levels that another filter of the same sensors has learned.
    pub fn resume_noise(&mut self, learned: &LearnedNoise) {
        self.noise = NoiseAdaptation::new(&self.config, Some(learned));
    }

    /// Whether most tracks of the newest second contradict the state: not yet a divergence, but the pose should not be
    /// relied on.
    pub fn is_suspicious(&self) -> bool {
        self.health.is_suspicious()
    }

    /// The keyframes of the map that are held, to be named in a map query.
    pub fn held_keyframes(&self) -> Vec<KeyframeId> {
        self.covariance.held.ids().collect()
    }

    /// Heap memory of the held keyframes, bytes.
    pub fn held_bytes(&self) -> usize {
        self.covariance.held.heap_bytes()
    }

    /// Version of the map that the held keyframes belong to; `None` before the map initialization.
    pub fn map_version(&self) -> Option<u64> {
        self.map_version.in_use()
    }

    /// Identity of the map that the held keyframes belong to; `None` before the map initialization.
    pub fn map_identity(&self) -> Option<u128> {
        self.map_version.identity()
    }

    pub(super) fn camera(&self, camera: usize) -> Option<&CalibratedCamera> {
        self.state.calibration.cameras.get(camera)
    }

    /// The camera whose image an answer was matched with, which was checked to be there.
    pub(super) fn camera_of(&self, answer: &MapAnswer) -> &CalibratedCamera {
        &self.state.calibration.cameras[answer.camera]
    }

    fn block(&self, row: &Block, column: &Block) -> Matrix6<f64> {
        match (self.state.range(*row), self.state.range(*column)) {
            (Some(rows), Some(columns)) => {
                self.covariance.active().view().fixed_view::<6, 6>(rows.start, columns.start).into_owned()
            }
            _ => Matrix6::zeros(),
        }
    }
}
