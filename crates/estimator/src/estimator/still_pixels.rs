//! Pixels of queries to the map, of cameras with a rolling shutter.
//!
//! A map answers for one pose of the image. The pixels of its features are moved to where the camera would have seen them from the pose of the
//! image's clone: by the turn before the query ([`Estimator::still_pixel`]), which moves the outer rows most and needs no landmarks, and
//! by the translation when the answer states how far the landmarks are. Both are known to small parts of a pixel from the clones and
//! the IMU; what is left of that is within the noise of a match.

use super::Estimator;
use crate::calibration::CalibratedCamera;
use crate::map_update::map_answer::{MapAnswer, MatchedLandmark};
use crate::rolling_shutter::row_pose::{Estimates, RowPose};
use crate::state::CloneId;
use geometry::Pose;
use nalgebra::Vector2;

impl Estimator {
    /// The pixel at which a camera would have seen the same direction, had it not turned while its rolling shutter read the image out:
    /// what a query to the map is made with. With a global shutter, and for a marginalized clone, the pixel itself.
    ///
    /// # Arguments
    /// * `clone`, `camera`: of the image.
    /// * `pixel`: as the camera sees it (distorted).
    pub fn still_pixel(&self, clone: CloneId, camera: usize, pixel: &Vector2<f64>) -> Vector2<f64> {
        let Some(image_from_row) = self.image_from_row(clone, camera, pixel) else { return *pixel };
        let Some(CalibratedCamera { camera, .. }) = self.camera(camera) else { return *pixel };
        let Ok(seen) = camera.bearing(pixel) else { return *pixel };
        camera.project(&(image_from_row.rotation * seen.into_inner())).unwrap_or(*pixel)
    }

    /// A camera when it took a pixel, in its own frame at the time of the image; `None` where that is the same.
    fn image_from_row(&self, clone: CloneId, camera: usize, pixel: &Vector2<f64>) -> Option<Pose> {
        let index = self.state.clone_index(clone)?;
        let imu_from_camera = self.camera(camera)?.imu_from_camera;
        let row = RowPose::of(&self.state, index, camera, pixel, Estimates::Newest);
        row.dependence?;
        let local_from_camera = self.state.clones[index].local_from_imu * imu_from_camera;
        Some(local_from_camera.inverse() * row.local_from_imu * imu_from_camera)
    }

    /// An answer whose pixels are those that its camera would have seen from its pose at the time of the image.
    pub(super) fn seen_from_the_image(&self, clone: CloneId, mut answer: MapAnswer) -> MapAnswer {
        if !self.has_pixel_times() {
            return answer;
        }
        let global_from_camera = self.state.clone_index(clone).and_then(|index| {
            let local_from_camera =
                self.state.clones[index].local_from_imu * self.camera_of(&answer).imu_from_camera;
            Some(self.state.transform? * local_from_camera)
        });
        let mut landmarks = std::mem::take(&mut answer.landmarks);
        for landmark in &mut landmarks {
            let seen = self.moved_to_the_image(clone, landmark, &answer, global_from_camera.as_ref());
            landmark.pixel = seen.unwrap_or(landmark.pixel);
        }
        MapAnswer { landmarks, ..answer }
    }

    /// The pixel of a landmark from the camera's pose at the time of the image.
    ///
    /// # Arguments
    /// * `global_from_camera`: where that is known. Else the landmark is taken to be as far away as from its keyframe.
    fn moved_to_the_image(
        &self,
        clone: CloneId,
        landmark: &MatchedLandmark,
        answer: &MapAnswer,
        global_from_camera: Option<&Pose>,
    ) -> Option<Vector2<f64>> {
        // The row of a pixel that was corrected for the turn differs from that in which it was taken by the correction, some rows.
        let camera_at_row = self.image_from_row(clone, answer.camera, &landmark.pixel)?.translation;
        let away = match (global_from_camera, self.pose_of(landmark.anchor, answer)) {
            (Some(pose), Some(anchor)) => {
                pose.inverse_transform(&anchor.transform(&landmark.position_in_anchor))
            }
            _ => landmark.position_in_anchor,
        };
        let camera = &self.camera_of(answer).camera;
        let direction = camera.bearing(&landmark.pixel).ok()?.into_inner();
        camera.project(&(direction * away.norm() + camera_at_row)).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{EstimatorConfig, InitialSigmas};
    use crate::initialization::static_init::InitialState;
    use crate::map_update::map_answer::MapKeyframe;
    use crate::test_scene::rolling_scene;
    use geometry::PoseWithCovariance;
    use nalgebra::{Matrix6, Matrix6xX, Vector3};

    #[test]
    fn pixels_of_an_answer_are_those_of_a_global_shutter_at_the_clone() {
        let scene = rolling_scene(0.03, true);
        let start = InitialState::from_truth(
            0,
            &Pose::identity(),
            &Vector3::zeros(),
            &-Vector3::z(),
            InitialSigmas::default(),
        );
        let cameras = scene.state.calibration.cameras.clone();
        let mut estimator = Estimator::new(EstimatorConfig::default(), cameras.clone(), &start).unwrap();
        estimator.state = scene.state;
        estimator.state.transform = Some(Pose::identity());
        let (index, calibrated) = (4, &cameras[0]);
        let (id, own) = (estimator.state.clones[index].id, estimator.state.clones[index].local_from_imu);
        let local_from_camera = own * calibrated.imu_from_camera;
        let mut landmarks = Vec::new();
        let mut expected = Vec::new();
        for [x, y, z] in [[-1.0, -1.6, 3.0], [0.5, -1.0, 2.0], [0.2, 1.7, 4.0], [1.5, 1.2, 2.5]] {
            let landmark = local_from_camera.transform(&Vector3::new(x, y, z));
            let global = calibrated.predict(&own, &landmark).unwrap();
            let mut pixel = global;
            for _ in 0..8 {
                let row = RowPose::of(&estimator.state, index, 0, &pixel, Estimates::Newest);
                pixel = calibrated.predict(&row.local_from_imu, &landmark).unwrap();
            }
            assert!((pixel - global).norm() > 1.5);
            landmarks.push(MatchedLandmark {
                pixel: estimator.still_pixel(id, 0, &pixel),
                anchor: 1,
                position_in_anchor: landmark,
                observations: Vec::new(),
            });
            expected.push(global);
        }
        let keyframe = MapKeyframe {
            id: 1,
            global_from_keyframe: PoseWithCovariance::new(Pose::identity(), Matrix6::identity()),
            camera: calibrated.camera.clone(),
            common_error: Matrix6xX::zeros(0),
            cross_covariances: Vec::new(),
        };
        let answer = MapAnswer {
            map_version: 1,
            map_identity: 1,
            camera: 0,
            keyframes: vec![keyframe],
            held_at_query: Vec::new(),
            landmarks,
            gravity_in_global: None,
            sigma_map_px: 1.0,
            log_odds: 0.0,
            log_prior_odds: 0.0,
        };
        let seen = estimator.seen_from_the_image(id, answer);
        for (landmark, global) in seen.landmarks.iter().zip(&expected) {
            assert!((landmark.pixel - global).norm() < 0.1, "{} {global}", landmark.pixel);
        }
    }
}
