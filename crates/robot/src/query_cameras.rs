//! Which cameras of a rig the map is asked about next.

use estimator::CloneId;
use geometry::Camera;
use sensors::{CameraSensor, Frame, camera_groups};

/// Weight of the newest answer in the average of a camera's success.
const GAIN: f64 = 0.3;
/// How often a camera is asked whose answers were never of use, as a part of how often one is whose answers always are: the map may
/// know what it sees from now on.
const LEAST_SUCCESS: f64 = 0.1;

/// The image that a query is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueryImage {
    /// The clone of its pose.
    pub clone: CloneId,
    /// Its camera.
    pub camera: usize,
}

/// The cameras of a rig, and how well the map knows what they see.
///
/// Those are asked that have waited longest, where their time counts by the share of their answers that were of use: cameras that the
/// map knows are asked in turn, the others now and then. Of a stereo pair only the first camera is asked: both see the same.
#[derive(Clone, Debug)]
pub(crate) struct QueryCameras {
    /// Of all cameras.
    cameras: Vec<Camera>,
    asked: Vec<AskedCamera>,
}

#[derive(Clone, Copy, Debug)]
struct AskedCamera {
    camera: usize,
    /// Time of the last image that was asked about, nanoseconds.
    last_ns: Option<i64>,
    /// Share of the answers that were of use, the newest ones first of all.
    success: f64,
}

impl QueryCameras {
    pub(crate) fn new(cameras: &[CameraSensor]) -> Self {
        let of = |camera| AskedCamera { camera, last_ns: None, success: 1.0 };
        let asked = camera_groups(cameras).iter().map(|group| of(group.first)).collect();
        Self { cameras: cameras.iter().map(|sensor| sensor.camera.clone()).collect(), asked }
    }

    /// The projection of a camera.
    pub(crate) fn camera(&self, camera: usize) -> Option<&Camera> {
        self.cameras.get(camera)
    }

    /// The cameras to ask about, `number` at most, of those that a frame has features of, or where it has none, an image: the most
    /// urgent first.
    pub(crate) fn next(&self, frame: &Frame, number: usize) -> Vec<usize> {
        let urgency = |asked: &AskedCamera| {
            let waited = asked.last_ns.map_or(f64::INFINITY, |last_ns| (frame.stamp_ns - last_ns) as f64);
            waited * asked.success.max(LEAST_SUCCESS)
        };
        let has_features = self.has_features(frame);
        let is_there = |camera: usize| {
            if has_features {
                frame.features.get(&camera).is_some_and(|features| !features.is_empty())
            } else {
                frame.images.contains_key(&camera)
            }
        };
        let there = self.asked.iter().filter(|asked| is_there(asked.camera));
        let mut there: Vec<(f64, usize)> = there.map(|asked| (urgency(asked), asked.camera)).collect();
        // Of equal ones the first.
        there.sort_by(|a, b| b.0.total_cmp(&a.0));
        there.into_iter().take(number).map(|(_, camera)| camera).collect()
    }

    /// Whether a frame has features of a camera that can be asked about.
    pub(crate) fn has_features(&self, frame: &Frame) -> bool {
        let of = |asked: &AskedCamera| frame.features.get(&asked.camera);
        self.asked.iter().filter_map(of).any(|features| !features.is_empty())
    }

    /// Notes that a camera is asked about.
    pub(crate) fn note_query(&mut self, camera: usize, stamp_ns: i64) {
        self.of(camera, |asked| asked.last_ns = Some(stamp_ns));
    }

    /// Notes an answer, and whether it was of use.
    pub(crate) fn note_answer(&mut self, camera: usize, is_used: bool) {
        self.of(camera, |asked| asked.success += GAIN * (f64::from(u8::from(is_used)) - asked.success));
    }

    fn of(&mut self, camera: usize, change: impl FnOnce(&mut AskedCamera)) {
        if let Some(asked) = self.asked.iter_mut().find(|asked| asked.camera == camera) {
            change(asked);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{Distortion, Pose};
    use nalgebra::{UnitQuaternion, Vector3};
    use protocol::{DescriptorKind, Descriptors, FeatureSet};
    use sensors::ImageData;

    /// Two cameras that look ahead, one to the side and one back.
    fn cameras() -> QueryCameras {
        let camera = Camera {
            width: 640,
            height: 480,
            focal: [320.0; 2],
            centre: [320.0, 240.0],
            distortion: Distortion::None,
        };
        let at = |turned_rad: f64| {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turned_rad);
            CameraSensor::new(camera.clone(), Pose::new(rotation, Vector3::zeros()), 20.0)
        };
        QueryCameras::new(&[at(0.0), at(0.0), at(1.6), at(3.1)])
    }

    fn frame(seconds: i64, cameras: &[usize]) -> Frame {
        let image = |&camera: &usize| (camera, ImageData::File("image.png".into()));
        let images = cameras.iter().map(image).collect();
        Frame { stamp_ns: seconds * 1_000_000_000, images, ..Frame::default() }
    }

    /// How often each camera is asked in 200 s, where only some of them get answers of use.
    fn counts(known: &[usize]) -> [usize; 4] {
        let (mut cameras, mut counts) = (cameras(), [0; 4]);
        for second in 0..200 {
            let frame = frame(second, &[0, 1, 2, 3]);
            let [camera] = cameras.next(&frame, 1)[..] else { panic!("no camera") };
            cameras.note_query(camera, frame.stamp_ns);
            cameras.note_answer(camera, known.contains(&camera));
            counts[camera] += 1;
        }
        counts
    }

    #[test]
    fn cameras_are_asked_in_turn_and_those_that_the_map_does_not_know_now_and_then() {
        assert_eq!(counts(&[0, 2, 3]), [67, 0, 67, 66]);
        assert_eq!(counts(&[]), [67, 0, 67, 66]);
        let [first, second, side, back] = counts(&[0]);
        assert_eq!(second, 0);
        assert!(first > 140 && (10..30).contains(&side) && (10..30).contains(&back), "{first} {side} {back}");
    }

    #[test]
    fn a_camera_without_an_image_is_not_asked() {
        let cameras = cameras();
        assert_eq!(cameras.next(&frame(0, &[1, 3]), 1), [3]);
        assert!(cameras.next(&frame(0, &[1]), 1).is_empty());
    }

    #[test]
    fn of_a_frame_with_features_the_cameras_are_asked_that_they_are_of() {
        let cameras = cameras();
        let mut frame = frame(0, &[0, 2]);
        let set = |count: usize| FeatureSet {
            pixels: vec![[1.0, 2.0]; count],
            descriptors: Descriptors { kind: DescriptorKind::Binary, width: 1, bytes: vec![0; count] },
            extractor: String::new(),
        };
        frame.features = [(0, set(0)), (3, set(4))].into();
        assert_eq!(cameras.next(&frame, 9), [3]);
    }

    #[test]
    fn several_cameras_of_a_frame_are_asked_at_once() {
        let mut cameras = cameras();
        let all = [0, 1, 2, 3];
        assert_eq!(cameras.next(&frame(0, &all), 2), [0, 2]);
        for camera in [0, 2] {
            cameras.note_query(camera, 0);
        }
        assert_eq!(cameras.next(&frame(1, &all), 2), [3, 0]);
        assert_eq!(cameras.next(&frame(1, &all), 9), [3, 0, 2]);
    }
}
