//! The cameras of a recording whose images become keyframes.

use adjustment::{LandmarkObservation, MountedCamera};
use geometry::CameraGroup;
use geometry::camera::Camera;
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use map::model::{GAUGE_SIGMA_P, GAUGE_SIGMA_YAW};
use nalgebra::Matrix6;
use protocol::KeyframeId;
use sensors::{CameraSensor, camera_groups};

use super::keyframe_view::{FeatureId, KeyframeView};

/// Cameras on a body, whose pose is that of camera 0. Each stereo pair or single camera makes keyframes of its own.
#[derive(Clone, Debug)]
pub(super) struct Rig {
    /// All cameras.
    pub(super) cameras: Vec<MountedCamera>,
    /// Stereo pairs and single cameras.
    pub(super) groups: Vec<CameraGroup>,
    /// Pose of the first camera of each group in the frame of camera 0; `None` for camera 0 itself.
    mounted: Vec<Option<Pose>>,
    /// The second camera of each group, mounted on the first.
    seconds: Vec<Option<MountedCamera>>,
}

impl Rig {
    /// The cameras of a recording.
    ///
    /// # Arguments
    /// * `used`: how many are used, the first ones.
    pub(super) fn new(sensors: &[CameraSensor], used: usize) -> Rig {
        let sensors = &sensors[..used.min(sensors.len())];
        let camera = |sensor: &CameraSensor, body: &CameraSensor| {
            let camera_from_body = sensor.imu_from_camera.inverse() * body.imu_from_camera;
            MountedCamera::new(sensor.camera.clone(), &camera_from_body)
        };
        let groups = camera_groups(sensors);
        let pose = |group: &CameraGroup| {
            let first_from_imu = sensors[0].imu_from_camera.inverse();
            (group.first != 0).then(|| first_from_imu * sensors[group.first].imu_from_camera)
        };
        let second = |group: &CameraGroup| Some(camera(&sensors[group.second?], &sensors[group.first]));
        Rig {
            cameras: sensors.iter().map(|sensor| camera(sensor, &sensors[0])).collect(),
            mounted: groups.iter().map(pose).collect(),
            seconds: groups.iter().map(second).collect(),
            groups,
        }
    }

    /// Cameras of views that have one image each and poses of their own: each is camera 0 of its body.
    pub(super) fn of_single(cameras: Vec<Camera>) -> Rig {
        let groups = (0..cameras.len()).map(|first| CameraGroup { first, second: None }).collect();
        let mounted = |camera: Camera| MountedCamera::new(camera, &Pose::identity());
        Rig {
            groups,
            mounted: vec![None; cameras.len()],
            seconds: vec![None; cameras.len()],
            cameras: cameras.into_iter().map(mounted).collect(),
        }
    }

    /// The camera whose images become the keyframes of a group.
    pub(super) fn camera(&self, group: usize) -> &Camera {
        &self.cameras[self.groups[group].first].camera
    }

    /// The group of a keyframe, by its id in the map of the recording alone: see [`keyframe_id`](super::assemble::keyframe_id).
    pub(super) fn group_of_keyframe(&self, id: KeyframeId) -> usize {
        (id.saturating_sub(1) % self.groups.len().max(1) as u64) as usize
    }

    /// The first camera of the stereo pair of a camera, or the camera itself.
    pub(super) fn first_camera(&self, camera: usize) -> usize {
        let group = self.groups.iter().find(|group| group.second == Some(camera));
        group.map_or(camera, |group| group.first)
    }

    /// The second camera of a group, mounted on the first.
    pub(super) fn second_camera(&self, group: usize) -> Option<&MountedCamera> {
        self.seconds[group].as_ref()
    }

    /// The observations of a landmark by a feature: in the image of a camera, and of the second camera where it was matched there.
    pub(super) fn observations(
        &self,
        feature: FeatureId,
        view: &KeyframeView<'_>,
    ) -> impl Iterator<Item = LandmarkObservation> {
        let group = self.groups[view.group(feature.1)];
        let pixel = view.pixel(feature.1);
        let first = LandmarkObservation { feature, camera: group.first, is_second: false, pixel };
        let in_second = |(camera, pixel)| LandmarkObservation { camera, is_second: true, pixel, ..first };
        std::iter::once(first).chain(group.second.zip(view.stereo_pixel(feature.1)).map(in_second))
    }

    /// Pose of the camera of a group in the frame of camera 0; `None` for camera 0 itself.
    pub(super) fn mounted(&self, group: usize) -> Option<Pose> {
        self.mounted[group]
    }

    /// The pose of the camera of a group, by that of camera 0.
    pub(super) fn camera_pose(&self, group: usize, body: &Pose) -> Pose {
        self.mounted[group].map_or(*body, |mounted| body.compose(&mounted))
    }

    /// The pose of the camera of a group with its covariance, by that of camera 0.
    pub(super) fn uncertain_pose(&self, group: usize, body: &PoseWithCovariance) -> PoseWithCovariance {
        self.mounted[group].map_or(*body, |mounted| body.change_of_child(&mounted))
    }

    /// The pose of camera 0 by that of the camera of a group.
    pub(super) fn body_pose(&self, group: usize, camera: &PoseWithCovariance) -> PoseWithCovariance {
        self.mounted[group].map_or(*camera, |mounted| camera.change_of_child(&mounted.inverse()))
    }

    /// How the error of the pose of a group's camera depends on that of camera 0; `None` for camera 0 itself.
    ///
    /// # Arguments
    /// * `body`: the pose of camera 0.
    pub(super) fn mounting(&self, group: usize, body: &Pose) -> Option<Mounting> {
        let lever = body.rotation * self.mounted[group]?.translation;
        let mut jacobian = Matrix6::identity();
        jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&-geometry::rotation::skew(&lever));
        Some(Mounting { jacobian })
    }
}

/// A camera that is mounted on a body: its pose has the error of the body's, `J e`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mounting {
    /// `J`.
    pub(super) jacobian: Matrix6<f64>,
}

impl Mounting {
    /// The covariance of the camera's pose by that of the body's: `J P J^T`, and as little as keeps the joint covariance of the
    /// cameras of one instant from being singular.
    pub(super) fn covariance(&self, of_body: &Matrix6<f64>) -> Matrix6<f64> {
        let mut covariance = self.jacobian * of_body * self.jacobian.transpose();
        for index in 0..3 {
            covariance[(index, index)] += GAUGE_SIGMA_YAW * GAUGE_SIGMA_YAW;
            covariance[(index + 3, index + 3)] += GAUGE_SIGMA_P * GAUGE_SIGMA_P;
        }
        covariance
    }
}

/// Whether cameras 0 and 1 are a stereo pair.
pub(super) fn is_stereo(sensors: &[CameraSensor]) -> bool {
    camera_groups(sensors).first().is_some_and(|group| (group.first, group.second) == (0, Some(1)))
}
