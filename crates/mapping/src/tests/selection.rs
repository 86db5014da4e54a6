//! Keyframes selected while odometry runs are those that are selected after it, by any number of extractors.

use std::sync::Arc;

use estimator::propagation::ImuState;
use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use sensors::{CameraSensor, Frame, ImageData, ReferencePose, Sequence};
use vision::{FeatureExtractor, GrayImage, features};

use crate::camera::Rig;
use crate::feature_source::FeatureSource;
use crate::keyframe_selection::select_keyframes;
use crate::keyframe_view::KeyframeView;
use crate::odometry::local_reference;
use crate::{BuildOptions, Extraction, select_during};

const FRAMES: usize = 24;
/// A frame whose image cannot be read.
const MISSING: usize = 9;

/// A wall in blocks of random brightness that a stereo pair moves along, and faster towards the end; a camera behind sees another one.
fn sequence() -> Sequence {
    let camera = Camera {
        width: 160,
        height: 120,
        focal: [100.0, 100.0],
        centre: [80.0, 60.0],
        distortion: Distortion::RadialTangential([0.0; 4]),
    };
    let sensor = |x, turned_rad| {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turned_rad);
        CameraSensor::new(camera.clone(), Pose::new(rotation, Vector3::new(x, 0.0, 0.0)), 20.0)
    };
    let image = |offset: usize| {
        let brightness = |x: usize, y: usize| {
            let (column, row) = ((x + offset) / 9, y / 11);
            (column.wrapping_mul(73_856_093) ^ row.wrapping_mul(19_349_663)).wrapping_mul(2_654_435_761) >> 16
        };
        let image = GrayImage::from_fn(160, 120, |x, y| (brightness(x, y) & 0xff) as u8);
        ImageData::Pixels(Arc::new(image))
    };
    let frame = |index: usize| {
        let first =
            if index == MISSING { ImageData::File("missing.png".into()) } else { image(offset(index)) };
        Frame {
            stamp_ns: stamp_ns(index),
            images: [(0, first), (1, image(offset(index) + 5)), (2, image(offset(index) + 70))].into(),
            ..Frame::default()
        }
    };
    Sequence {
        root: "wall".into(),
        imu: None,
        imu_samples: Vec::new(),
        wheels: None,
        wheel_readings: Vec::new(),
        gnss: None,
        gnss_readings: Vec::new(),
        cameras: vec![sensor(0.0, 0.0), sensor(0.1, 0.0), sensor(0.0, 3.1)],
        frames: (0..FRAMES).map(frame).collect(),
        groundtruth: None,
        reference_poses: None,
    }
}

/// How far the image has moved (px).
fn offset(index: usize) -> usize {
    index + index * index / 8
}

fn stamp_ns(index: usize) -> i64 {
    1_000_000_000 + 50_000_000 * index as i64
}

/// The wall is 2 m away: 20 mm a pixel.
fn state(index: usize) -> ImuState {
    let position = Vector3::new(0.02 * offset(index) as f64, 0.0, 0.0);
    let local_from_imu = Pose::new(UnitQuaternion::identity(), position);
    let zero = Vector3::zeros();
    ImuState { local_from_imu, velocity: zero, gyroscope_bias: zero, accelerometer_bias: zero }
}

fn extractors(count: usize) -> Vec<Box<dyn FeatureExtractor>> {
    (0..count).map(|_| features::open("sift-1", None).unwrap()).collect()
}

fn extraction(extractors: &mut [Box<dyn FeatureExtractor>]) -> Extraction<'_> {
    let (first, others) = extractors.split_first_mut().unwrap();
    Extraction { extractor: first.as_mut(), others, max_features: 100, masks: &[], cameras: usize::MAX }
}

fn assert_equal(found: &[KeyframeView<'_>], expected: &[KeyframeView<'_>]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!(found.stamp_ns, expected.stamp_ns);
        let features = |view: &KeyframeView<'_>| -> Vec<_> {
            view.images.iter().map(|image| (image.group, image.features.clone().into_owned())).collect()
        };
        assert_eq!(features(found), features(expected));
        assert_eq!(found.stereo, expected.stereo);
        assert_eq!(found.prior.pose, expected.prior.pose);
    }
}

#[test]
fn keyframes_depend_neither_on_the_number_of_extractors_nor_on_when_they_are_selected() {
    let sequence = sequence();
    let options = BuildOptions::default();
    let rig = Rig::new(&sequence.cameras, usize::MAX);
    let references: Vec<ReferencePose> =
        (0..FRAMES).map(|index| local_reference(stamp_ns(index), &state(index))).collect();
    let mut one = extractors(1);
    let mut source = FeatureSource::new(Some(extraction(&mut one)), &rig);
    let expected =
        select_keyframes(&sequence, &references, &mut source, &options, &mut |_, _, _| ()).unwrap();
    assert!((4..FRAMES - 4).contains(&expected.len()), "{} keyframes", expected.len());
    assert!(expected.iter().any(|view| view.stereo.iter().any(Option::is_some)));
    assert!(expected.iter().all(|view| view.image_of(1).is_some()));
    assert_eq!(source.unreadable.len(), 1);
    for count in [2, 3] {
        let mut several = extractors(count);
        let mut ahead = FeatureSource::new(Some(extraction(&mut several)), &rig);
        let views =
            select_keyframes(&sequence, &references, &mut ahead, &options, &mut |_, _, _| ()).unwrap();
        assert_equal(&views, &expected);
        assert_eq!(ahead.unreadable, source.unreadable);
        let (frames, selected) = select_during(
            &sequence.cameras,
            stamp_ns(0),
            extraction(&mut several),
            &options,
            &mut |_, _, _| (),
            |located, _| {
                let of_frame = |(index, frame)| located(frame, &state(index));
                sequence.frames.iter().enumerate().map(of_frame).count()
            },
        );
        let selected = selected.unwrap();
        assert_eq!(frames, FRAMES);
        assert_equal(&selected.views, &expected);
        assert_eq!(selected.unreadable, source.unreadable);
    }
}

#[test]
fn cameras_that_are_triggered_apart_have_keyframes_of_their_own() {
    let mut sequence = sequence();
    for (index, frame) in sequence.frames.iter_mut().enumerate() {
        frame.images.retain(|&camera, _| (camera == 2) == (index % 2 == 1));
    }
    let references: Vec<ReferencePose> =
        (0..FRAMES).map(|index| local_reference(stamp_ns(index), &state(index))).collect();
    let rig = Rig::new(&sequence.cameras, usize::MAX);
    let mut extractors = extractors(2);
    let mut source = FeatureSource::new(Some(extraction(&mut extractors)), &rig);
    let options = BuildOptions::default();
    let views = select_keyframes(&sequence, &references, &mut source, &options, &mut |_, _, _| ()).unwrap();
    for group in 0..2 {
        let of_group = || views.iter().filter(|view| view.image_of(group).is_some());
        assert!(of_group().count() >= 4, "{} of group {group}", of_group().count());
        // None is taken before the camera has moved by half of what a keyframe needs.
        let positions: Vec<f64> = of_group().map(|view| view.prior.pose.translation.x).collect();
        let least = positions.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
        assert!(least >= 0.5 * options.min_distance - 1e-9, "{positions:?}");
    }
    assert!(views.iter().all(|view| view.images.len() == 1));
}

#[test]
fn an_image_of_another_size_ends_the_selection_and_not_the_odometry() {
    let mut sequence = sequence();
    let small = ImageData::Pixels(Arc::new(GrayImage::from_fn(64, 64, |x, y| (x * y) as u8)));
    sequence.frames[0].images.insert(1, small);
    let mut two = extractors(2);
    let (frames, selected) = select_during(
        &sequence.cameras,
        stamp_ns(0),
        extraction(&mut two),
        &BuildOptions::default(),
        &mut |_, _, _| (),
        |located, _| {
            let of_frame = |(index, frame)| located(frame, &state(index));
            sequence.frames.iter().enumerate().map(of_frame).count()
        },
    );
    assert_eq!(frames, FRAMES);
    assert!(matches!(selected, Err(crate::BuildError::ImageSize { .. })));
}
