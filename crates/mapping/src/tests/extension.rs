//! The law of extensions: a stored map and further observations are the same as all observations at once.

use geometry::pose::Pose;
use geometry::rotation;
use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};
use map::contents::MapContents;
use map::model::{Keyframe, KeyframeCrossCovariance, Landmark, MapMetadata};
use nalgebra::{DMatrix, Vector2, Vector3};
use protocol::DescriptorKind;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::{camera, normal};
use crate::bundle_adjustment::{Bundle, PosePrior, Problem};
use crate::camera::{CameraPose, MappingCamera};
use crate::joint_prior::JointPrior;
use crate::landmark::{InverseDepthLandmark, LandmarkObservation};
use crate::landmark_prior::{LandmarkPrior, StoredObserver};
use crate::pose_priors::PriorFactors;

/// Of pixels (px), and of reference poses (rad, m): so small that everything is linear.
const SIGMA_PX: f64 = 0.1;
const SIGMA_POSE: f64 = 3e-4;
/// Views of the map, and views that are added.
const STORED: usize = 4;
const ADDED: usize = 3;

/// Gauss-Newton without robust weights, as far as it goes.
fn solved(problem: &Problem<'_>, mut bundle: Bundle) -> (Bundle, DMatrix<f64>) {
    for _ in 0..8 {
        let step = problem.equations(&bundle, f64::INFINITY, 0.0).solve(0.0).unwrap();
        let landmarks = bundle.landmarks.iter().zip(&step.landmarks);
        let landmarks = landmarks.map(|(landmark, error)| landmark.corrected(error)).collect();
        bundle = Bundle { landmarks, ..bundle.moved(&step.states) };
    }
    let size = 6 * bundle.poses.len();
    let columns: Vec<usize> = (0..size).collect();
    let covariance = problem.information(&bundle).unwrap().inverse_columns(&columns);
    (bundle, covariance)
}

/// Noisy observations of landmarks by all views, the map's last; those of one landmark begin with its anchor.
fn observations(rng: &mut StdRng, poses: &[Pose]) -> Vec<InverseDepthLandmark> {
    let camera = camera();
    let stored_view = |at: usize| ADDED + at;
    (0..40)
        .map(|index| {
            let anchor = stored_view(index % STORED);
            let ray = Vector2::new(rng.random_range(-0.3..0.3), rng.random_range(-0.2..0.2));
            let inverse_depth = rng.random_range(0.1..0.3);
            let position = poses[anchor].transform(&(ray.push(1.0) / inverse_depth));
            let others = (0..ADDED + STORED).filter(|&view| view != anchor);
            let observations = std::iter::once(anchor)
                .chain(others)
                .map(|view| {
                    let exact = camera.project(&poses[view].inverse_transform(&position)).unwrap();
                    let pixel = exact + Vector2::new(normal(rng), normal(rng)) * SIGMA_PX;
                    LandmarkObservation { feature: (view, index), camera: 0, pixel }
                })
                .collect();
            InverseDepthLandmark { anchor: 0, ray, inverse_depth, observations, prior: None }
        })
        .collect()
}

#[test]
fn an_extended_map_is_the_map_of_all_observations() {
    let mut rng = StdRng::seed_from_u64(21);
    let small = |rng: &mut StdRng, size: f64| Vector3::from_fn(|_, _| size * rng.random_range(-1.0..1.0));
    let truth: Vec<Pose> = (0..ADDED + STORED)
        .map(|_| Pose::new(rotation::exp(&small(&mut rng, 0.05)), small(&mut rng, 0.5)))
        .collect();
    let landmarks = observations(&mut rng, &truth);
    let sensor = sensors::CameraSensor { camera: camera(), imu_from_camera: Pose::identity(), rate_hz: 1.0 };
    let cameras = MappingCamera::of_sensors(&[sensor]);
    let reference = |view: usize, rng: &mut StdRng| {
        let covariance = isotropic_covariance(SIGMA_POSE, SIGMA_POSE);
        let error = nalgebra::Vector6::from_fn(|_, _| normal(rng) * SIGMA_POSE);
        PosePrior::of_reference(view, &PoseWithCovariance::new(truth[view].retract(&error), covariance))
    };
    let priors: Vec<PosePrior> = (0..ADDED + STORED).map(|view| reference(view, &mut rng)).collect();
    let measured = PriorFactors::default();
    let problem = |priors| Problem {
        cameras: &cameras,
        priors,
        measured: &measured,
        inertial: None,
        relative_poses: &[],
        stored: None,
        sigma_px: SIGMA_PX,
    };
    let bundle = |poses: &[Pose], landmarks| Bundle { poses: poses.to_vec(), motions: Vec::new(), landmarks };
    let (batch, expected) = solved(&problem(&priors), bundle(&truth, landmarks.clone()));

    // The map by itself: its views count from 0.
    let of_map: Vec<PosePrior> =
        priors[ADDED..].iter().map(|prior| PosePrior { view: prior.view - ADDED, ..prior.clone() }).collect();
    let in_map = |landmark: &InverseDepthLandmark| {
        let mut landmark = landmark.clone();
        landmark.observations.retain(|observation| observation.view() >= ADDED);
        landmark.observations.iter_mut().for_each(|observation| observation.feature.0 -= ADDED);
        landmark
    };
    let (map, covariance) =
        solved(&problem(&of_map), bundle(&truth[ADDED..], landmarks.iter().map(in_map).collect()));
    let contents = stored(&map, &covariance);

    let joint = JointPrior::of_map(&contents, ADDED).unwrap();
    let seen_again = |(landmark, in_map): (&InverseDepthLandmark, &InverseDepthLandmark)| {
        let camera = camera();
        let observer = |observation: &LandmarkObservation| StoredObserver {
            view: ADDED + observation.view(),
            pose: map.poses[observation.view()],
            camera: &camera,
            pixel: observation.pixel,
        };
        let stored = Landmark {
            id: 1,
            anchor: 1,
            position_in_anchor: in_map.ray.push(1.0) / in_map.inverse_depth,
            observations: Vec::new(),
        };
        let observers: Vec<_> = in_map.observations.iter().map(observer).collect();
        let mut again = LandmarkPrior::landmark(&stored, &observers, SIGMA_PX).unwrap();
        let new = landmark.observations.iter().filter(|observation| observation.view() < ADDED);
        again.observations.extend(new.copied());
        again
    };
    let again = landmarks.iter().zip(&map.landmarks).map(seen_again).collect();
    let mut poses = truth[..ADDED].to_vec();
    poses.extend(&map.poses);
    let extension = Problem { stored: Some(&joint), ..problem(&priors[..ADDED]) };
    let (extended, stated) = solved(&extension, bundle(&poses, again));

    let sigma = expected.diagonal().min().sqrt();
    for (view, (pose, in_batch)) in extended.poses.iter().zip(&batch.poses).enumerate() {
        let error = in_batch.local(pose);
        assert!(error.norm() < 0.05 * sigma, "view {view}: {} of sigma {sigma}", error.norm());
    }
    let difference = (&stated - &expected).amax();
    assert!(difference < 0.01 * expected.amax(), "{difference} of {}", expected.amax());
    let before = covariance.trace();
    let after = stated.view((6 * ADDED, 6 * ADDED), (6 * STORED, 6 * STORED)).trace();
    assert!(after < before, "{after} {before}");
    // The positions of landmarks are those of the batch, too.
    let camera_poses: [Vec<CameraPose>; 2] = [extended.camera_poses(), batch.camera_poses()];
    for (a, b) in extended.landmarks.iter().zip(&batch.landmarks) {
        let [a, b] = [(a, &camera_poses[0]), (b, &camera_poses[1])]
            .map(|(l, poses)| l.position(&poses[l.anchor_view()]));
        assert!((a - b).norm() < sigma, "{a} {b}");
    }
}

/// The map of an adjusted bundle, without its landmarks.
fn stored(map: &Bundle, covariance: &DMatrix<f64>) -> MapContents {
    let mut contents = MapContents::empty(MapMetadata::new("hall", "test", DescriptorKind::Binary, 32));
    let block = |i: usize, j: usize| covariance.fixed_view::<6, 6>(6 * i, 6 * j).into_owned();
    for (i, pose) in map.poses.iter().enumerate() {
        contents.keyframes.push(Keyframe {
            id: i as u64 + 1,
            stamp_ns: i as i64,
            global_from_keyframe: PoseWithCovariance::new(*pose, block(i, i)),
            camera: camera(),
            features: None,
        });
        for j in 0..i {
            let (a, b) = (j as u64 + 1, i as u64 + 1);
            contents.cross_covariances.push(KeyframeCrossCovariance { a, b, block: block(j, i) });
        }
    }
    contents
}
