//! Maps of rigs: each camera has keyframes of its own, and those of one instant err together.

use std::collections::BTreeMap;
use std::sync::Arc;

use estimator::TrackObservation;
use geometry::camera::{Camera, Distortion};
use geometry::numeric::numeric_jacobian;
use geometry::pose::Pose;
use geometry::rotation;
use geometry::uncertain_pose::PoseWithCovariance;
use map::contents::MapContents;
use map::model::{GAUGE_SIGMA_P, GAUGE_SIGMA_YAW, Keyframe};
use nalgebra::{DMatrix, DVector, Matrix6, Vector2, Vector3, Vector6};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use sensors::{CameraSensor, Frame, ImageData, ReferencePose, Sequence};
use vision::{ExtractError, FeatureExtractor, GrayImage, ImageFeatures, Keypoint, Metric};

use super::{dense, normal};
use crate::camera::Rig;
use crate::keyframe_view::KeyframeView;
use crate::odometry::add_tracks;
use crate::{BuildOptions, BuildReport, Extraction, Spread, StoredPoses, build_map};

const INSTANTS: usize = 16;
const SIGMA_THETA: f64 = 0.01;
const SIGMA_P: f64 = 0.05;

/// Two cameras that look ahead, one to the left, of another kind, and one back.
fn cameras() -> Vec<CameraSensor> {
    let camera = |focal: f64, width: u32| Camera {
        width,
        height: 240,
        focal: [focal, focal + 1.0],
        centre: [f64::from(width) / 2.0, 120.0],
        distortion: Distortion::RadialTangential([-0.1, 0.02, 1e-4, 2e-5]),
    };
    let at = |camera: Camera, yaw: f64, x: f64, z: f64| {
        let mounted = Pose::new(rotation::exp(&(Vector3::y() * yaw)), Vector3::new(x, 0.02, z));
        CameraSensor::new(camera, mounted, 10.0)
    };
    vec![
        at(camera(200.0, 320), 0.0, 0.0, 0.2),
        at(camera(200.0, 320), 0.0, 0.12, 0.2),
        at(camera(170.0, 300), -1.5, -0.15, 0.0),
        at(camera(200.0, 320), 3.1, 0.0, -0.2),
    ]
}

/// Landmarks all around a body that moves and turns to the right; y points down.
struct World {
    sequence: Sequence,
    references: Vec<ReferencePose>,
    /// True `global_from_imu`.
    truth: Vec<Pose>,
    landmarks: Vec<Vector3<f64>>,
    /// What an extractor finds in each image, and the landmark of each feature.
    features: BTreeMap<(usize, usize), (ImageFeatures, Vec<usize>)>,
}

impl World {
    fn new(seed: u64, pose_noise: f64, pixel_noise: f64) -> World {
        let mut rng = StdRng::seed_from_u64(seed);
        let landmarks: Vec<Vector3<f64>> = (0..400)
            .map(|_| {
                let (angle, distance): (f64, f64) =
                    (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(4.0..7.0));
                Vector3::new(angle.sin() * distance, rng.random_range(-2.0..2.0), angle.cos() * distance)
            })
            .collect();
        let descriptors: Vec<[u8; 32]> = landmarks.iter().map(|_| rng.random()).collect();
        let sensors = cameras();
        let mut world = World {
            sequence: Sequence {
                root: "rig".into(),
                imu: None,
                imu_samples: Vec::new(),
                wheels: None,
                wheel_readings: Vec::new(),
                gnss: None,
                gnss_readings: Vec::new(),
                cameras: sensors.clone(),
                frames: Vec::new(),
                groundtruth: None,
                reference_poses: None,
            },
            references: Vec::new(),
            truth: Vec::new(),
            landmarks,
            features: BTreeMap::new(),
        };
        for instant in 0..INSTANTS {
            let turned = 0.12 * instant as f64;
            let position = Vector3::new((1.3 * turned).sin(), 0.1 * (3.0 * turned).sin(), turned);
            let global_from_imu = Pose::new(rotation::exp(&(Vector3::y() * turned)), position);
            let mut images = BTreeMap::new();
            for (index, sensor) in sensors.iter().enumerate() {
                let global_from_camera = global_from_imu * sensor.imu_from_camera;
                let mut found = ImageFeatures {
                    keypoints: Vec::new(),
                    metric: Metric::Hamming,
                    width: 32,
                    descriptors: Vec::new(),
                };
                let mut labels = Vec::new();
                for (label, landmark) in world.landmarks.iter().enumerate() {
                    let in_camera = global_from_camera.inverse_transform(landmark);
                    let seen = sensor.camera.project(&in_camera).ok();
                    let noisy = seen
                        .map(|pixel| pixel + Vector2::new(normal(&mut rng), normal(&mut rng)) * pixel_noise);
                    if let Some(pixel) = noisy.filter(|pixel| sensor.camera.contains(pixel)) {
                        let pixel = [pixel.x as f32, pixel.y as f32];
                        found.keypoints.push(Keypoint { pixel, scale: 1.0, score: 1.0 });
                        found.descriptors.extend(descriptors[label]);
                        labels.push(label);
                    }
                }
                let (width, height) = (sensor.camera.width as usize, sensor.camera.height as usize);
                let name = [instant as u8, index as u8];
                let image =
                    GrayImage::from_fn(width, height, |x, y| if y == 0 && x < 2 { name[x] } else { 0 });
                images.insert(index, ImageData::Pixels(Arc::new(image)));
                world.features.insert((instant, index), (found, labels));
            }
            let stamp_ns = stamp_ns(instant);
            world.sequence.frames.push(Frame { stamp_ns, images, ..Frame::default() });
            let sigmas = [SIGMA_THETA, SIGMA_P];
            let error = Vector6::from_fn(|row, _| normal(&mut rng) * sigmas[row / 3] * pose_noise);
            let pose = global_from_imu.retract(&error);
            world.references.push(ReferencePose::isotropic(stamp_ns, pose, SIGMA_THETA, SIGMA_P));
            world.truth.push(global_from_imu);
        }
        world
    }

    fn build(&self, cameras: usize, options: &BuildOptions) -> (MapContents, BuildReport) {
        let mut extractor = Known(&self.features);
        let extraction = Extraction {
            extractor: &mut extractor,
            others: &mut [],
            max_features: 1000,
            masks: &[],
            cameras,
        };
        build_map(&self.sequence, &self.references, Some(extraction), options, &mut |_, _, _| ()).unwrap()
    }

    fn instant(&self, keyframe: &Keyframe) -> usize {
        self.sequence.frames.iter().position(|frame| frame.stamp_ns == keyframe.stamp_ns).unwrap()
    }

    /// The camera of a keyframe: the one whose pose it is.
    fn camera(&self, keyframe: &Keyframe) -> usize {
        let imu = &self.truth[self.instant(keyframe)];
        let away = |camera: &usize| {
            let pose = imu.compose(&self.sequence.cameras[*camera].imu_from_camera);
            pose.rotation.angle_to(&keyframe.global_from_keyframe.pose.rotation)
        };
        [0, 2, 3].into_iter().min_by(|a, b| away(a).total_cmp(&away(b))).unwrap()
    }

    fn true_pose(&self, keyframe: &Keyframe) -> Pose {
        let camera = self.camera(keyframe);
        self.truth[self.instant(keyframe)].compose(&self.sequence.cameras[camera].imu_from_camera)
    }
}

fn stamp_ns(instant: usize) -> i64 {
    1_000_000_000 + 100_000_000 * instant as i64
}

/// Finds in an image, which it knows by its first two pixels, what is known to be in it.
struct Known<'a>(&'a BTreeMap<(usize, usize), (ImageFeatures, Vec<usize>)>);

impl FeatureExtractor for Known<'_> {
    fn name(&self) -> &'static str {
        "known"
    }

    fn metric(&self) -> Metric {
        Metric::Hamming
    }

    fn width(&self) -> usize {
        32
    }

    fn extract(
        &mut self,
        image: &GrayImage,
        _: Option<&GrayImage>,
        _: usize,
    ) -> Result<ImageFeatures, ExtractError> {
        Ok(self.0[&(usize::from(image.get(0, 0)), usize::from(image.get(1, 0)))].0.clone())
    }
}

/// The joint covariance of all keyframes that a map states.
fn covariance(contents: &MapContents) -> DMatrix<f64> {
    let index = |id: u64| contents.keyframes.iter().position(|keyframe| keyframe.id == id).unwrap();
    let own: Vec<_> = contents.keyframes.iter().map(|k| k.global_from_keyframe.covariance).collect();
    let cross = contents.cross_covariances.iter().map(|cross| (index(cross.a), index(cross.b), cross.block));
    dense(&own, cross)
}

#[test]
fn every_camera_of_a_rig_has_keyframes_and_landmarks_of_its_own() {
    let world = World::new(1, 0.0, 0.0);
    let (contents, report) = world.build(usize::MAX, &BuildOptions::default());
    assert_eq!((contents.keyframes.len(), report.keyframes), (3 * INSTANTS, 3 * INSTANTS));
    assert!(report.stereo_features > 100, "{report:?}");
    for keyframe in &contents.keyframes {
        let camera = world.camera(keyframe);
        assert_eq!(keyframe.camera, world.sequence.cameras[camera].camera);
        let error = keyframe.global_from_keyframe.pose.local(&world.true_pose(keyframe));
        assert!(error.norm() < 1e-5, "camera {camera}: {error}");
    }
    let by_id: BTreeMap<u64, &Keyframe> = contents.keyframes.iter().map(|of| (of.id, of)).collect();
    let (mut errors, mut anchored, mut shared) = (Vec::new(), [0; 4], 0);
    for landmark in &contents.landmarks {
        let anchor = by_id[&landmark.anchor];
        let position = world.true_pose(anchor).transform(&landmark.position_in_anchor);
        let away = |truth: &Vector3<f64>| (truth - position).norm();
        errors.push(world.landmarks.iter().map(away).fold(f64::INFINITY, f64::min));
        anchored[world.camera(anchor)] += 1;
        let of = |camera: usize| {
            landmark.observations.iter().any(|seen| world.camera(by_id[&seen.keyframe]) == camera)
        };
        shared += usize::from(of(0) && of(2));
    }
    let errors = Spread::of(errors);
    assert!(errors.median < 1e-4 && errors.p95 < 0.01, "{errors:?}");
    assert!(anchored[0] > 50 && anchored[2] > 50 && anchored[3] > 50, "{anchored:?}");
    // The body turns to the right: what the front camera sees is seen by the left one later.
    assert!(shared > 20, "{shared}");
}

#[test]
fn the_front_alone_gives_the_map_of_the_front() {
    let world = World::new(2, 0.5, 0.5);
    let (alone, _) = world.build(1, &BuildOptions::default());
    assert_eq!(alone.keyframes.len(), INSTANTS);
    assert!(alone.keyframes.iter().all(|keyframe| world.camera(keyframe) == 0));
    let (pair, report) = world.build(2, &BuildOptions::default());
    assert!(pair.keyframes.len() == INSTANTS && report.stereo_features > 100);
}

#[test]
fn keyframes_of_one_instant_err_together() {
    let world = World::new(3, 1.0, 1.0);
    for stored_poses in [StoredPoses::Refined, StoredPoses::Given] {
        let options = BuildOptions { stored_poses, ..BuildOptions::default() };
        let (contents, _) = world.build(usize::MAX, &options);
        let joint = covariance(&contents);
        assert!(joint.clone().cholesky().is_some(), "{}", joint.symmetric_eigenvalues().min());
        for (i, first) in contents.keyframes.iter().enumerate() {
            for (j, second) in contents.keyframes.iter().enumerate().skip(i + 1) {
                if first.stamp_ns != second.stamp_ns {
                    continue;
                }
                let [a, b] = [first, second].map(|of| of.global_from_keyframe.pose);
                let truth = world.true_pose(first).inverse().compose(&world.true_pose(second));
                assert!(truth.local(&a.inverse().compose(&b)).norm() < 1e-9);
                // The error of the relative pose, in the frame of the first.
                let relative = |error: &DVector<f64>| {
                    let of = |begin: usize| Vector6::from_column_slice(&error.as_slice()[begin..begin + 6]);
                    let moved = a.retract(&of(0)).inverse().compose(&b.retract(&of(6)));
                    DVector::from_column_slice(truth.local(&moved).as_slice())
                };
                let jacobian = numeric_jacobian(12, relative);
                let both = DMatrix::from_fn(12, 12, |row, column| {
                    let at = |k: usize| 6 * [i, j][k / 6] + k % 6;
                    joint[(at(row), at(column))]
                });
                let of_relative = &jacobian * both * jacobian.transpose();
                let most = [2.01 * GAUGE_SIGMA_YAW.powi(2), 2.01 * GAUGE_SIGMA_P.powi(2)];
                for index in 0..6 {
                    assert!(of_relative[(index, index)] < most[index / 3], "{of_relative}");
                }
            }
        }
    }
}

#[test]
fn the_poses_of_all_cameras_err_as_their_joint_covariance_says() {
    let (mut nees, mut freedom) = (0.0, 0);
    let (mut front, mut all) = (0.0, 0.0);
    for seed in 0..6 {
        let world = World::new(20 + seed, 1.0, 1.0);
        let of_front = |contents: &MapContents| -> f64 {
            let keyframes = contents.keyframes.iter().filter(|keyframe| world.camera(keyframe) == 0);
            keyframes
                .map(|keyframe| {
                    let error = keyframe.global_from_keyframe.pose.local(&world.true_pose(keyframe));
                    error.fixed_rows::<3>(3).norm_squared()
                })
                .sum()
        };
        front += of_front(&world.build(1, &BuildOptions::default()).0);
        let (contents, _) = world.build(usize::MAX, &BuildOptions::default());
        all += of_front(&contents);
        // One camera of each instant: the others err with it.
        let joint = covariance(&contents);
        let chosen: Vec<usize> = (0..contents.keyframes.len())
            .filter(|&at| {
                let keyframe = &contents.keyframes[at];
                world.camera(keyframe) == [0, 2, 3][world.instant(keyframe) % 3]
            })
            .collect();
        let size = 6 * chosen.len();
        let at = |k: usize| 6 * chosen[k / 6] + k % 6;
        let of_chosen = DMatrix::from_fn(size, size, |row, column| joint[(at(row), at(column))]);
        let error = DVector::from_iterator(
            size,
            chosen.iter().flat_map(|&at| {
                let keyframe = &contents.keyframes[at];
                let error = keyframe.global_from_keyframe.pose.local(&world.true_pose(keyframe));
                error.iter().copied().collect::<Vec<_>>()
            }),
        );
        nees += error.dot(&of_chosen.cholesky().unwrap().solve(&error));
        freedom += size;
    }
    // 576 degrees of freedom: a standard deviation of 6 %; five of them.
    let ratio = nees / freedom as f64;
    assert!((0.7..1.3).contains(&ratio), "NEES {ratio}");
    assert!(all < 0.8 * front, "all cameras {all}, the front alone {front}");
}

#[test]
fn the_mounting_is_the_numeric_derivative() {
    let rig = Rig::new(&cameras(), usize::MAX);
    let body = Pose::new(rotation::exp(&Vector3::new(0.4, -1.1, 0.3)), Vector3::new(3.0, -2.0, 5.0));
    assert!(rig.mounting(0, &body).is_none());
    for group in 1..rig.groups.len() {
        let camera = rig.camera_pose(group, &body);
        let numeric = numeric_jacobian(6, |error| {
            let moved = body.retract(&Vector6::from_column_slice(error.as_slice()));
            DVector::from_column_slice(camera.local(&rig.camera_pose(group, &moved)).as_slice())
        });
        let stated: Matrix6<f64> = rig.mounting(group, &body).unwrap().jacobian;
        let stated = DMatrix::from_column_slice(6, 6, stated.as_slice());
        assert!((&numeric - &stated).amax() < 1e-6, "{numeric} {stated}");
    }
}

#[test]
fn tracks_of_cameras_that_are_triggered_apart_are_not_broken_by_images_of_others() {
    let rig = Rig::new(&cameras(), usize::MAX);
    let point = |camera: u8, feature_id: u64| TrackObservation {
        camera,
        feature_id,
        pixel: Vector2::new(100.0 + feature_id as f64, 90.0),
    };
    let frame = |k: i64, tracks: Vec<TrackObservation>| Frame { stamp_ns: k, tracks, ..Frame::default() };
    // The left camera and the one behind give the same name to their points. The front camera loses one and finds it again.
    let frames = [
        frame(0, vec![point(0, 1), point(1, 1), point(0, 2), point(3, 1)]),
        frame(1, vec![point(2, 1)]),
        frame(2, vec![point(0, 1), point(1, 1), point(3, 1)]),
        frame(3, vec![point(2, 1)]),
        frame(4, vec![point(0, 1), point(0, 2), point(3, 1)]),
    ];
    let view = |k: i64| KeyframeView {
        stamp_ns: k,
        images: Vec::new(),
        tracked: Vec::new(),
        stereo: Vec::new(),
        rays: Vec::new(),
        prior: PoseWithCovariance::exact(Pose::identity()),
    };
    let mut views: Vec<KeyframeView<'_>> = (0..5).map(view).collect();
    let tracks = add_tracks(&mut views, &frames, &rig);
    let groups = |track: &Vec<(usize, usize)>| -> Vec<(usize, usize)> {
        track.iter().map(|&(view, feature)| (view, views[view].group(feature))).collect()
    };
    let mut found: Vec<Vec<(usize, usize)>> = tracks.iter().map(groups).collect();
    found.sort();
    let expected = vec![vec![(0, 0), (2, 0), (4, 0)], vec![(0, 2), (2, 2), (4, 2)], vec![(1, 1), (3, 1)]];
    assert_eq!(found, expected);
    let of_front = (0..views[0].rays.len()).filter(|&feature| views[0].stereo_pixel(feature).is_some());
    assert_eq!(of_front.map(|feature| views[0].group(feature)).collect::<Vec<_>>(), [0]);
}
