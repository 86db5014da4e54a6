//! Laws of map building, on a small simulated place.

use std::path::PathBuf;

use geometry::camera::{Camera, Distortion};
use geometry::numeric::numeric_jacobian;
use geometry::pose::Pose;
use geometry::rotation;
use map::contents::MapContents;
use nalgebra::{DMatrix, DVector, Matrix6, Vector2, Vector3, Vector6};
use protocol::{DescriptorFormat, DescriptorKind, FeatureSet};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use sensors::{CameraSensor, Frame, ReferencePose, Sequence};

use crate::matching::FeatureMatch;
use crate::reference_poses::ReferencePoses;
use crate::{BuildOptions, BuildReport, Spread, StoredPoses, build_map, tracks};

mod equations;
mod extension;
mod rig;
mod scale;
mod selection;

pub(crate) fn normal(rng: &mut StdRng) -> f64 {
    StandardNormal.sample(rng)
}

pub(crate) fn camera() -> Camera {
    let distortion = Distortion::RadialTangential([-0.28, 0.07, 2e-4, 2e-5]);
    Camera { width: 752, height: 480, focal: [458.0, 457.0], centre: [367.0, 248.0], distortion }
}

/// A corridor of landmarks, a camera walking through it, and all that is true of it.
struct World {
    sequence: Sequence,
    references: Vec<ReferencePose>,
    /// True `global_from_camera` of each frame.
    truth: Vec<Pose>,
    /// True landmarks in G.
    landmarks: Vec<Vector3<f64>>,
    /// Landmark of each feature of each frame; `None` for clutter.
    labels: Vec<Vec<Option<usize>>>,
}

const SIGMA_THETA: f64 = 0.015;
const SIGMA_P: f64 = 0.08;

/// # Arguments
/// * `pose_noise`: factor on [`SIGMA_THETA`] and [`SIGMA_P`].
/// * `pixel_noise`: px.
fn world(seed: u64, pose_noise: f64, pixel_noise: f64) -> World {
    let mut rng = StdRng::seed_from_u64(seed);
    let camera = camera();
    let imu_from_camera =
        Pose::new(rotation::exp(&Vector3::new(0.1, -0.2, 1.5)), Vector3::new(0.1, 0.3, -0.2));
    let landmarks: Vec<Vector3<f64>> = (0..250)
        .map(|_| {
            let side = if rng.random::<bool>() { 1.0 } else { -1.0 };
            Vector3::new(
                side * rng.random_range(2.0..5.0),
                rng.random_range(-2.0..2.0),
                rng.random_range(0.0..40.0),
            )
        })
        .collect();
    let descriptors: Vec<[u8; 32]> = landmarks.iter().map(|_| rng.random()).collect();
    let mut world = World {
        sequence: Sequence {
            root: PathBuf::from("simulated"),
            imu: None,
            imu_samples: Vec::new(),
            wheels: None,
            wheel_readings: Vec::new(),
            gnss: None,
            gnss_readings: Vec::new(),
            cameras: vec![CameraSensor::new(camera.clone(), imu_from_camera, 1.0)],
            frames: Vec::new(),
            groundtruth: None,
            reference_poses: None,
        },
        references: Vec::new(),
        truth: Vec::new(),
        landmarks,
        labels: Vec::new(),
    };
    for index in 0..25_i64 {
        let sway = (index as f64 * 0.7).sin();
        let turn = rotation::exp(&Vector3::new(0.05 * sway, 0.2 * sway, 0.1 * sway));
        let global_from_camera = Pose::new(turn, Vector3::new(0.4 * sway, 0.1 * sway, index as f64));
        let mut features = FeatureSet::empty(DescriptorFormat { kind: DescriptorKind::Binary, width: 32 });
        let mut labels = Vec::new();
        for (label, landmark) in world.landmarks.iter().enumerate() {
            let p = global_from_camera.inverse_transform(landmark);
            let Some(pixel) = camera.project(&p).ok().filter(|pixel| p.z < 15.0 && camera.contains(pixel))
            else {
                continue;
            };
            let noisy = pixel + Vector2::new(normal(&mut rng), normal(&mut rng)) * pixel_noise;
            if camera.contains(&noisy) {
                features.pixels.push([noisy.x as f32, noisy.y as f32]);
                let mut descriptor = descriptors[label];
                descriptor[rng.random_range(0..32)] ^= 1 << rng.random_range(0..8);
                features.descriptors.bytes.extend(descriptor);
                labels.push(Some(label));
            }
        }
        for _ in 0..10 {
            features.pixels.push([rng.random_range(0.0..750.0), rng.random_range(0.0..478.0)]);
            features.descriptors.bytes.extend(rng.random::<[u8; 32]>());
            labels.push(None);
        }
        let stamp_ns = 1_000_000_000 * (index + 5);
        world.sequence.frames.push(Frame { stamp_ns, features: [(0, features)].into(), ..Frame::default() });
        let sigmas = [SIGMA_THETA, SIGMA_P];
        let error = Vector6::from_fn(|row, _| normal(&mut rng) * sigmas[row / 3] * pose_noise);
        let pose = (global_from_camera * imu_from_camera.inverse()).retract(&error);
        world.references.push(ReferencePose::isotropic(stamp_ns, pose, SIGMA_THETA, SIGMA_P));
        world.truth.push(global_from_camera);
        world.labels.push(labels);
    }
    world
}

fn build(world: &World, options: &BuildOptions) -> (MapContents, BuildReport) {
    build_map(&world.sequence, &world.references, None, options, &mut |_, _, _| ()).unwrap()
}

/// The landmark that most observations of a map's landmark are of, and how many are not of it.
fn label(world: &World, landmark: &map::model::Landmark) -> (usize, usize) {
    let labels: Vec<Option<usize>> = landmark
        .observations
        .iter()
        .map(|observation| {
            let view = observation.keyframe as usize - 1;
            let wanted = observation.pixel.map(f32::to_bits);
            let features = &world.sequence.frames[view].features[&0];
            let feature = features.pixels.iter().position(|pixel| pixel.map(f32::to_bits) == wanted).unwrap();
            world.labels[view][feature]
        })
        .collect();
    let most = labels.iter().max_by_key(|a| labels.iter().filter(|b| b == a).count()).unwrap().unwrap();
    (most, labels.iter().filter(|label| **label != Some(most)).count())
}

/// Relative error of each landmark's position in its anchor's camera frame.
fn errors_in_anchor(world: &World, contents: &MapContents) -> Vec<f64> {
    contents
        .landmarks
        .iter()
        .map(|landmark| {
            let (label, _) = label(world, landmark);
            let anchor = &world.truth[landmark.anchor as usize - 1];
            let truth = anchor.inverse_transform(&world.landmarks[label]);
            (landmark.position_in_anchor - truth).norm() / truth.norm()
        })
        .collect()
}

#[test]
fn exact_input_gives_the_exact_map() {
    let world = world(1, 0.0, 0.0);
    let (contents, report) = build(&world, &BuildOptions::default());
    let errors = Spread::of(errors_in_anchor(&world, &contents));
    // Pixels are written in single precision, and landmarks straight ahead have next to no parallax.
    assert!(errors.median < 1e-5 && errors.p95 < 1e-3, "{errors:?}");
    assert!(report.reprojection_px.p95 < 1e-3, "{report:?}");
    assert!(contents.landmarks.len() > 150, "{}", contents.landmarks.len());
}

#[test]
fn refining_poses_finds_landmarks_that_noisy_poses_hide() {
    let world = world(2, 1.0, 1.0);
    let error = |refine_poses: bool| {
        let options = BuildOptions { refine_poses, ..BuildOptions::default() };
        Spread::of(errors_in_anchor(&world, &build(&world, &options).0)).median
    };
    let (held, refined) = (error(false), error(true));
    assert!(refined < 0.02 && refined * 3.0 < held, "refined {refined}, poses held {held}");
}

#[test]
fn given_poses_are_stated_with_their_covariance_where_that_is_asked_for() {
    let world = world(3, 1.0, 1.0);
    let options = BuildOptions { stored_poses: StoredPoses::Given, ..BuildOptions::default() };
    let (contents, report) = build(&world, &options);
    // The sigmas of the report are per axis, as those that were given; a rotation's is the same in the camera.
    assert!((report.sigma_pose_deg.median.to_radians() - SIGMA_THETA).abs() < 1e-9, "{report:?}");
    assert!(report.sigma_pose_m.median < 1.5 * SIGMA_P, "{report:?}");
    let imu_from_camera = world.sequence.cameras[0].imu_from_camera;
    assert_eq!(contents.keyframes.len(), world.references.len());
    for (keyframe, reference) in contents.keyframes.iter().zip(&world.references) {
        let expected = reference.pose * imu_from_camera;
        assert!(expected.local(&keyframe.global_from_keyframe.pose).norm() < 1e-12);
        // The camera's error for an error of the IMU, numerically.
        let jacobian = numeric_jacobian(6, |error| {
            let moved =
                reference.pose.retract(&Vector6::from_column_slice(error.as_slice())) * imu_from_camera;
            DVector::from_column_slice(expected.local(&moved).as_slice())
        });
        let sigmas = DVector::from_fn(6, |row, _| if row < 3 { SIGMA_THETA } else { SIGMA_P });
        let covariance =
            &jacobian * DMatrix::from_diagonal(&sigmas.component_mul(&sigmas)) * jacobian.transpose();
        let stated = &keyframe.global_from_keyframe.covariance;
        assert!((covariance - DMatrix::from_column_slice(6, 6, stated.as_slice())).amax() < 1e-9);
    }
    assert!(contents.cross_covariances.is_empty());
}

#[test]
fn a_landmark_holds_one_place_and_no_clutter() {
    let world = world(4, 1.0, 1.0);
    let (contents, _) = build(&world, &BuildOptions::default());
    contents.validate().unwrap();
    let wrong: usize = contents.landmarks.iter().map(|landmark| label(&world, landmark).1).sum();
    assert!(wrong * 500 < contents.observation_count(), "{wrong} of {}", contents.observation_count());
    let seen: usize = world.labels.iter().flatten().filter(|label| label.is_some()).count();
    assert!(contents.observation_count() * 10 > seen * 8, "{} of {seen}", contents.observation_count());
}

#[test]
fn the_same_input_gives_the_same_map() {
    let world = world(5, 1.0, 1.0);
    let options = BuildOptions::default();
    assert_eq!(build(&world, &options).0, build(&world, &options).0);
}

#[test]
fn time_limits_and_distances_select_keyframes() {
    let world = world(6, 0.0, 0.0);
    let count = |options: BuildOptions| build(&world, &options).0.keyframes.len();
    assert_eq!(count(BuildOptions { from_s: 5.0, until_s: 9.0, ..BuildOptions::default() }), 5);
    let far = BuildOptions { min_distance: 2.5, min_rotation: 3.0, ..BuildOptions::default() };
    assert!((8..=13).contains(&count(far)));
}

#[test]
fn input_that_makes_no_map_is_named() {
    let mut world = world(7, 0.0, 0.0);
    let fail = |world: &World, options: &BuildOptions| {
        build_map(&world.sequence, &world.references, None, options, &mut |_, _, _| ())
            .unwrap_err()
            .to_string()
    };
    let late = BuildOptions { from_s: 1e6, ..BuildOptions::default() };
    assert!(fail(&world, &late).contains("0 images between --from and --until"));
    let negative = BuildOptions { sigma_p_m: Some(-1.0), ..BuildOptions::default() };
    assert!(fail(&world, &negative).contains("sigmas"));
    for reference in &mut world.references {
        reference.stamp_ns += 1;
    }
    assert!(fail(&world, &BuildOptions::default()).contains("reference pose at its time"));
    for frame in &mut world.sequence.frames {
        frame.features.clear();
    }
    assert!(fail(&world, &BuildOptions::default()).contains("features.csv"));
}

#[test]
fn exact_poses_are_possible() {
    let world = world(8, 0.0, 0.5);
    let options =
        BuildOptions { sigma_theta_rad: Some(0.0), sigma_p_m: Some(0.0), ..BuildOptions::default() };
    let (contents, report) = build(&world, &options);
    assert!(report.pose_correction_m.p95 < 1e-3 && !contents.landmarks.is_empty());
}

#[test]
fn a_pose_between_two_is_at_most_as_certain_as_both_and_a_sigma_replaces_its_block() {
    let wide = Matrix6::from_diagonal(&Vector6::new(1e-4, 2e-4, 3e-4, 0.04, 0.05, 0.06));
    let mut narrow = wide * 0.5;
    (narrow[(0, 4)], narrow[(4, 0)]) = (1e-4, 1e-4);
    let at = |stamp_ns, covariance| ReferencePose { stamp_ns, pose: Pose::identity(), covariance };
    let poses = ReferencePoses::new(&[at(0, wide), at(100, narrow)]);
    assert_eq!(poses.at(100).unwrap().covariance, narrow);
    assert!((poses.at(25).unwrap().covariance - (wide * 0.75 + narrow * 0.25)).amax() < 1e-15);
    let stated = at(0, narrow).with_sigmas(None, Some(0.2)).covariance;
    assert_eq!(stated.fixed_view::<3, 3>(0, 0), narrow.fixed_view::<3, 3>(0, 0));
    assert_eq!((stated[(4, 4)], stated[(0, 4)], stated[(4, 0)]), (0.2 * 0.2, 0.0, 0.0));
}

fn dense(
    own: &[Matrix6<f64>],
    cross: impl IntoIterator<Item = (usize, usize, Matrix6<f64>)>,
) -> DMatrix<f64> {
    let mut full = DMatrix::zeros(6 * own.len(), 6 * own.len());
    for (index, block) in own.iter().enumerate() {
        full.fixed_view_mut::<6, 6>(6 * index, 6 * index).copy_from(block);
    }
    for (i, j, block) in cross {
        full.fixed_view_mut::<6, 6>(6 * i, 6 * j).copy_from(&block);
        full.fixed_view_mut::<6, 6>(6 * j, 6 * i).copy_from(&block.transpose());
    }
    full
}

#[test]
fn refined_poses_err_as_their_joint_covariance_says() {
    let (mut nees, mut refined, mut given) = (0.0, 0.0, 0.0);
    let runs = 8;
    let mut freedom = 0;
    for seed in 0..runs {
        let world = world(100 + seed, 1.0, 1.0);
        let (contents, _) = build(&world, &BuildOptions::default());
        let index = |id: u64| id as usize - 1;
        let own: Vec<_> = contents.keyframes.iter().map(|k| k.global_from_keyframe.covariance).collect();
        let cross =
            contents.cross_covariances.iter().map(|cross| (index(cross.a), index(cross.b), cross.block));
        let covariance = dense(&own, cross);
        let error = DVector::from_iterator(
            covariance.nrows(),
            contents.keyframes.iter().zip(&world.truth).flat_map(|(keyframe, truth)| {
                let error = keyframe.global_from_keyframe.pose.local(truth);
                refined += error.fixed_rows::<3>(3).norm_squared();
                error.iter().copied().collect::<Vec<_>>()
            }),
        );
        let imu_from_camera = world.sequence.cameras[0].imu_from_camera;
        given += world.references.iter().zip(&world.truth).fold(0.0, |sum, (reference, truth)| {
            sum + (reference.pose * imu_from_camera).local(truth).fixed_rows::<3>(3).norm_squared()
        });
        nees += error.dot(&covariance.cholesky().unwrap().solve(&error));
        freedom += error.len();
    }
    // 150 degrees of freedom a run: the mean of 1200 has a standard deviation of 4 %; six of them.
    let ratio = nees / freedom as f64;
    assert!((0.76..1.24).contains(&ratio), "NEES {ratio}");
    assert!(refined * 4.0 < given, "refined {refined}, given {given}");
}

#[test]
fn a_track_has_one_feature_a_view_and_trusts_the_surest_match() {
    let found = |first, second, distance| FeatureMatch { first, second, distance };
    let matches = vec![
        found((0, 0), (1, 0), 0.1),
        found((1, 0), (2, 0), 0.1),
        // Contradicts the two above, and is less sure.
        found((0, 0), (2, 1), 0.2),
        found((2, 1), (3, 0), 0.1),
    ];
    let tracks = tracks::chain(&[vec![1], vec![1], vec![2], vec![1]], matches);
    assert_eq!(tracks, vec![vec![(0, 0), (1, 0), (2, 0)], vec![(2, 1), (3, 0)]]);
}
