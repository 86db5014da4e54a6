//! One image: where the body was when its rows were taken.

use super::spline::Spline;
use geometry::pose::Pose;
use nalgebra::{Vector2, Vector3};
use sensors::CameraSensor;

/// Steps of the search for the row in which a landmark is seen. Each is better by a factor of the image's rows by which the landmark
/// moves during the readout.
const ROW_STEPS: usize = 4;

/// The motion of the body about the time of an image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exposure<'a> {
    /// At the time of the image.
    world_from_imu: Pose,
    /// Trajectory and time of the image, nanoseconds; `None` where all rows have the pose above.
    moving: Option<(&'a Spline, i64)>,
}

impl<'a> Exposure<'a> {
    /// All rows at once, whatever the shutters of the cameras are.
    pub(crate) fn at_once(world_from_imu: Pose) -> Self {
        Self { world_from_imu, moving: None }
    }

    /// An image on a trajectory; rows have times of their own where the camera's shutter is a rolling one.
    pub(crate) fn of(trajectory: &'a Spline, stamp_ns: i64) -> Self {
        Self { world_from_imu: trajectory.at(stamp_ns).pose, moving: Some((trajectory, stamp_ns)) }
    }

    /// Where the camera is at the time of the image.
    pub(crate) fn camera_from_world(&self, sensor: &CameraSensor) -> Pose {
        self.world_from_imu.compose(&sensor.imu_from_camera).inverse()
    }

    /// A landmark in the camera's frame at the time of the image, metres.
    fn in_camera(&self, sensor: &CameraSensor, landmark: &Vector3<f64>) -> Vector3<f64> {
        self.camera_from_world(sensor).transform(landmark)
    }

    /// The pixel of a landmark, if it is in the image.
    pub(crate) fn project(&self, sensor: &CameraSensor, landmark: &Vector3<f64>) -> Option<Vector2<f64>> {
        let camera = &sensor.camera;
        let has_pixel_times = sensor.readout_s != 0.0 || sensor.delay_s() != 0.0;
        let mut pixel = camera.project(&self.in_camera(sensor, landmark)).ok();
        if let Some((trajectory, stamp_ns)) = self.moving.filter(|_| has_pixel_times) {
            for _ in 0..ROW_STEPS {
                // Beyond the first and the last row there is none.
                let part = ((pixel?.y + 0.5) / f64::from(camera.height)).clamp(0.0, 1.0);
                let after_s = sensor.delay_s() + (part - 0.5) * sensor.readout_s;
                let world_from_imu = trajectory.at(stamp_ns + (after_s * 1e9).round() as i64).pose;
                let row = Self { world_from_imu, moving: None };
                pixel = camera.project(&row.in_camera(sensor, landmark)).ok();
            }
        }
        pixel.filter(|pixel| camera.contains(pixel))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig;
    use nalgebra::UnitQuaternion;

    /// A radian and a metre a second.
    fn turning() -> Spline {
        let turned = |k: i32| {
            let angle = 0.1 * f64::from(k);
            Pose::new(UnitQuaternion::from_scaled_axis(Vector3::z() * angle), Vector3::x() * angle)
        };
        Spline::new(0, 100_000_000, (0..20).map(turned).collect()).unwrap()
    }

    #[test]
    fn a_camera_with_a_delay_sees_from_where_the_body_is_later() {
        let (spline, stamp_ns) = (turning(), 800_000_000);
        let sensor = &rig::stereo(10.0, 0.0, 0.005)[1];
        let ahead = spline.at(stamp_ns).pose;
        let landmark = ahead.transform(&Vector3::new(8.0, 0.5, 0.0));
        let pixel = Exposure::of(&spline, stamp_ns).project(sensor, &landmark).unwrap();
        let at = |pose| Exposure::at_once(pose).project(sensor, &landmark).unwrap();
        assert!((pixel - at(spline.at(stamp_ns + 5_000_000).pose)).norm() < 1e-6);
        assert!((pixel - at(ahead)).norm() > 1.0, "a radian a second is 2.3 px in 5 ms");
    }

    #[test]
    fn a_row_is_seen_from_where_the_body_was_at_its_time() {
        let spline = turning();
        let sensor = &rig::stereo(10.0, 0.03, 0.0)[0];
        let stamp_ns = 800_000_000;
        let exposure = Exposure::of(&spline, stamp_ns);
        let ahead = spline.at(stamp_ns).pose;
        for height in [-2.0, 0.0, 2.0] {
            let landmark = ahead.transform(&Vector3::new(8.0, 0.5, height));
            let pixel = exposure.project(sensor, &landmark).unwrap();
            let after_s = ((pixel.y + 0.5) / 480.0 - 0.5) * 0.03;
            let pose = spline.at(stamp_ns + (after_s * 1e9) as i64).pose;
            let camera_from_world = pose.compose(&sensor.imu_from_camera).inverse();
            let expected = sensor.camera.project(&camera_from_world.transform(&landmark)).unwrap();
            assert!((pixel - expected).norm() < 1e-4, "{pixel} {expected}");
            let at_once = Exposure::at_once(ahead).project(sensor, &landmark).unwrap();
            assert_eq!(
                (pixel - at_once).norm() > 1.0,
                height != 0.0,
                "a radian a second moves the upper and lower rows"
            );
        }
    }
}
