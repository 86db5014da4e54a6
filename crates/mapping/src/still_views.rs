//! Views of cameras with a rolling shutter: their pixels as the cameras would have seen them had they not turned during the readout.
//!
//! A keyframe has one pose. What the camera turned while it read the image out, which moves the outer rows by some pixels, is known from
//! the gyroscope; what it moved, by half a pixel at a walk in a room, is left in the noise of the pixels.

use ::odometry::calibrated_cameras;
use estimator::calibration::row_reach_ns;
use estimator::imu::ImuBuffer;
use estimator::rolling_shutter::still_pixel::{still_pixel, turn_around};
use nalgebra::{Vector2, Vector3};
use sensors::CameraSensor;

use super::camera::Rig;
use super::keyframe_view::KeyframeView;

/// Moves the pixels of the views. Without rolling shutters it does nothing.
///
/// # Arguments
/// * `sensors`: the cameras of the recording.
/// * `mounted`: those of the views.
/// * `readings`: of the IMU, on whose clock the views' stamps are.
/// * `gyroscope_bias`: at a time (ns), rad/s, as far as it is known.
pub(super) fn make_still(
    views: &mut [KeyframeView<'_>],
    sensors: &[CameraSensor],
    mounted: &Rig,
    readings: &ImuBuffer,
    gyroscope_bias: impl Fn(i64) -> Option<Vector3<f64>>,
) {
    let rig = calibrated_cameras(&sensors[..mounted.cameras.len()]);
    let reach_ns = row_reach_ns(&rig);
    if reach_ns == 0 {
        return;
    }
    let first = |group: usize| &rig[mounted.groups[group].first];
    let second = |group: usize| mounted.groups[group].second.map(|camera| &rig[camera]);
    for view in views {
        let bias = gyroscope_bias(view.stamp_ns).unwrap_or_default();
        let motion = turn_around(readings, view.stamp_ns, reach_ns, &bias);
        for image in &mut view.images {
            let camera = first(image.group);
            for pixel in &mut image.features.to_mut().pixels {
                let still = still_pixel(camera, &motion, &Vector2::from(pixel.map(f64::from)));
                *pixel = [still.x as f32, still.y as f32];
            }
        }
        for point in &mut view.tracked {
            point.pixel = still_pixel(first(point.group), &motion, &point.pixel);
        }
        for index in 0..view.stereo.len() {
            let group = view.group(index);
            if let Some((pixel, second)) = view.stereo[index].as_mut().zip(second(group)) {
                *pixel = still_pixel(second, &motion, pixel);
            }
        }
        for index in 0..view.rays.len() {
            let (camera, pixel) = (&first(view.group(index)).camera, view.pixel(index));
            view.rays[index] = camera.contains(&pixel).then(|| camera.unproject(&pixel).ok()).flatten();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keyframe_selection::rays;
    use crate::keyframe_view::{KeyframeImage, TrackedPoint};
    use geometry::camera::{Camera, Distortion};
    use geometry::pose::Pose;
    use geometry::rotation;
    use geometry::uncertain_pose::PoseWithCovariance;
    use protocol::{DescriptorKind, Descriptors, FeatureSet};
    use sensors::ImuSample;
    use std::borrow::Cow;

    const READOUT_S: f64 = 0.03;

    fn sensor(x: f64) -> CameraSensor {
        let camera = Camera {
            width: 640,
            height: 480,
            focal: [400.0; 2],
            centre: [320.0, 240.0],
            distortion: Distortion::RadialTangential([-0.1, 0.02, 1e-3, -1e-3]),
        };
        let mounted = Pose::new(rotation::exp(&Vector3::new(0.3, -0.2, 0.9)), Vector3::new(x, 0.0, 0.0));
        CameraSensor { readout_s: READOUT_S, ..CameraSensor::new(camera, mounted, 20.0) }
    }

    #[test]
    fn a_turning_camera_has_the_pixels_of_a_global_shutter() {
        let sensors = [sensor(0.0), sensor(0.1)];
        let rate = Vector3::new(0.8, -1.2, 0.5);
        let bias = Vector3::new(0.02, -0.01, 0.03);
        let mut readings = ImuBuffer::default();
        for k in 0..40 {
            let stamp_ns = k * 5_000_000;
            let (gyroscope, accelerometer) = (rate + bias, Vector3::z());
            readings.push(ImuSample { stamp_ns, gyroscope, accelerometer }).unwrap();
        }
        // Landmarks so far away that the distance between the cameras does not show.
        let directions =
            [[-0.5, -0.5], [0.6, -0.3], [0.1, 0.5], [-0.3, 0.4]].map(|[x, y]| Vector3::new(x, y, 1.0));
        let global: Vec<Vector2<f64>> =
            directions.iter().map(|direction| sensors[0].camera.project(direction).unwrap()).collect();
        let rolling: Vec<Vector2<f64>> = directions
            .iter()
            .map(|direction| {
                let mounted = sensors[0].imu_from_camera.rotation;
                let mut pixel = sensors[0].camera.project(direction).unwrap();
                for _ in 0..6 {
                    let seconds = ((pixel.y + 0.5) / 480.0 - 0.5) * READOUT_S;
                    let row_from_image = mounted.inverse() * rotation::exp(&(rate * -seconds)) * mounted;
                    pixel = sensors[0].camera.project(&(row_from_image * direction)).unwrap();
                }
                pixel
            })
            .collect();
        let features = FeatureSet {
            pixels: rolling.iter().map(|pixel| [pixel.x as f32, pixel.y as f32]).collect(),
            descriptors: Descriptors { kind: DescriptorKind::Binary, width: 1, bytes: vec![0; 4] },
            extractor: String::new(),
        };
        let mut rays = rays(&sensors[0].camera, &features);
        rays.push(None);
        let mut views = [KeyframeView {
            stamp_ns: 100_000_000,
            images: vec![KeyframeImage { group: 0, features: Cow::Owned(features) }],
            tracked: vec![TrackedPoint { group: 0, pixel: rolling[2] }],
            stereo: vec![Some(rolling[0]), None, None, None, Some(rolling[2])],
            rays,
            prior: PoseWithCovariance::exact(Pose::identity()),
        }];
        let rig = Rig::new(&sensors, 2);
        make_still(&mut views, &sensors, &rig, &readings, |_| Some(bias));
        let [view] = &views;
        for (index, expected) in global.iter().enumerate() {
            assert!((rolling[index] - expected).norm() > 1.0);
            assert!((view.pixel(index) - expected).norm() < 1e-3, "{index}");
            let ray = sensors[0].camera.unproject(expected).unwrap();
            assert!((view.rays[index].unwrap() - ray).norm() < 1e-5);
        }
        assert!((view.tracked[0].pixel - global[2]).norm() < 1e-3);
        assert!((view.stereo[0].unwrap() - global[0]).norm() < 1e-3);
    }
}
