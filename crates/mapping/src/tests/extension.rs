//! The laws of extensions and of merging: stored maps and further observations are the same as all observations at once.

use std::ops::Range;

use adjustment::{
    Bundle, Factor, InverseDepthLandmark, LandmarkObservation, LandmarkPrior, LandmarkTie,
    MAPPED_INVERSE_DEPTHS, MountedCamera, PosePrior, Problem, StoredObserver, ViewPose,
};
use geometry::pose::Pose;
use geometry::rotation;
use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};
use map::contents::MapContents;
use map::model::{Keyframe, KeyframeCrossCovariance, MapMetadata};
use nalgebra::{DMatrix, Vector2, Vector3};
use protocol::DescriptorKind;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::{camera, normal};
use crate::camera::Rig;
use crate::refinement::pixel_model;
use crate::stored_poses::StoredPoses;

/// Of pixels (px), and of reference poses (rad, m): so small that everything is linear.
const SIGMA_PX: f64 = 0.1;
const SIGMA_POSE: f64 = 3e-4;
/// Views of the map, and views that are added.
const STORED: usize = 4;
const ADDED: usize = 3;

/// Landmarks are known to a thousandth of their distance; what is not linear in it is the square of that, and some more.
const LANDMARK_TOLERANCE: f64 = 1e-4;

/// Gauss-Newton without robust weights, as far as it goes.
fn solved(problem: &Problem<'_>, mut bundle: Bundle) -> (Bundle, DMatrix<f64>) {
    for _ in 0..8 {
        let step = problem.equations(&bundle, f64::INFINITY, 0.0).solve(0.0).unwrap();
        let landmarks = bundle.landmarks.iter().zip(&step.landmarks);
        let landmarks =
            landmarks.map(|(landmark, error)| landmark.corrected(error, MAPPED_INVERSE_DEPTHS)).collect();
        bundle = Bundle { landmarks, ..bundle.moved(&step.states) };
    }
    let size = 6 * bundle.poses.len();
    let covariance = problem.covariance(&bundle).unwrap().columns(0..size);
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
                    LandmarkObservation { feature: (view, index), camera: 0, is_second: false, pixel }
                })
                .collect();
            InverseDepthLandmark { anchor: 0, ray, inverse_depth, observations, prior: None }
        })
        .collect()
}

/// A small place, and everything that is measured of it.
struct Place {
    truth: Vec<Pose>,
    landmarks: Vec<InverseDepthLandmark>,
    cameras: Vec<MountedCamera>,
    priors: Vec<PosePrior>,
}

impl Place {
    fn new() -> Place {
        let mut rng = StdRng::seed_from_u64(21);
        let small = |rng: &mut StdRng, size: f64| Vector3::from_fn(|_, _| size * rng.random_range(-1.0..1.0));
        let truth: Vec<Pose> = (0..ADDED + STORED)
            .map(|_| Pose::new(rotation::exp(&small(&mut rng, 0.05)), small(&mut rng, 0.5)))
            .collect();
        let landmarks = observations(&mut rng, &truth);
        let sensor = sensors::CameraSensor::new(camera(), Pose::identity(), 1.0);
        let reference = |view: usize, rng: &mut StdRng| {
            let covariance = isotropic_covariance(SIGMA_POSE, SIGMA_POSE);
            let error = nalgebra::Vector6::from_fn(|_, _| normal(rng) * SIGMA_POSE);
            PosePrior::of_reference(view, &PoseWithCovariance::new(truth[view].retract(&error), covariance))
        };
        let priors = (0..ADDED + STORED).map(|view| reference(view, &mut rng)).collect();
        let cameras = Rig::new(&[sensor], 1).cameras;
        Place { truth, landmarks, cameras, priors }
    }

    fn problem<'a>(&'a self, factors: Vec<&'a dyn Factor>) -> Problem<'a> {
        Problem { cameras: &self.cameras, factors, pixels: pixel_model(SIGMA_PX) }
    }

    /// Everything at once.
    fn batch(&self) -> (Bundle, DMatrix<f64>) {
        solved(&self.problem(vec![&self.priors]), bundle(&self.truth, self.landmarks.clone()))
    }

    /// The map of some views, which count from 0 in it.
    fn map(&self, views: Range<usize>) -> (Bundle, DMatrix<f64>) {
        let renumbered = |prior: &PosePrior| PosePrior { view: prior.view - views.start, ..prior.clone() };
        let priors: Vec<PosePrior> = self.priors[views.clone()].iter().map(renumbered).collect();
        let in_map = |landmark: &InverseDepthLandmark| {
            let position = self.truth[landmark.anchor_view()]
                .transform(&(landmark.ray.push(1.0) / landmark.inverse_depth));
            let mut landmark = landmark.clone();
            landmark.observations.retain(|observation| views.contains(&observation.view()));
            let in_anchor = self.truth[landmark.anchor_view()].inverse_transform(&position);
            (landmark.ray, landmark.inverse_depth) = (in_anchor.xy() / in_anchor.z, in_anchor.z.recip());
            landmark.observations.iter_mut().for_each(|observation| observation.feature.0 -= views.start);
            landmark
        };
        let landmarks = self.landmarks.iter().map(in_map).collect();
        solved(&self.problem(vec![&priors]), bundle(&self.truth[views.clone()], landmarks))
    }
}

fn bundle(poses: &[Pose], landmarks: Vec<InverseDepthLandmark>) -> Bundle {
    Bundle { poses: poses.to_vec(), motions: Vec::new(), landmarks }
}

/// A landmark of a map with what the map knows of it.
///
/// # Arguments
/// * `first`: view of the first keyframe of the map.
fn with_prior(map: &Bundle, first: usize, in_map: &InverseDepthLandmark) -> InverseDepthLandmark {
    let camera = camera();
    let observer = |observation: &LandmarkObservation| StoredObserver {
        view: first + observation.view(),
        pose: map.poses[observation.view()],
        camera: &camera,
        pixel: observation.pixel,
    };
    let position_in_anchor = in_map.ray.push(1.0) / in_map.inverse_depth;
    let observers: Vec<_> = in_map.observations.iter().map(observer).collect();
    LandmarkPrior::landmark(1, &position_in_anchor, &observers, SIGMA_PX).unwrap()
}

/// Poses and covariance of a batch and of what was made of maps are the same.
fn assert_equal(found: &[Pose], stated: &DMatrix<f64>, batch: &[Pose], expected: &DMatrix<f64>) {
    let sigma = expected.diagonal().min().sqrt();
    for (view, (pose, in_batch)) in found.iter().zip(batch).enumerate() {
        let error = in_batch.local(pose);
        assert!(error.norm() < 0.05 * sigma, "view {view}: {} of sigma {sigma}", error.norm());
    }
    let difference = (stated - expected).amax();
    assert!(difference < 0.01 * expected.amax(), "{difference} of {}", expected.amax());
}

#[test]
fn an_extended_map_is_the_map_of_all_observations() {
    let place = Place::new();
    let (batch, expected) = place.batch();
    let (map, covariance) = place.map(ADDED..ADDED + STORED);
    let joint = prior(&stored(&map, &covariance), ADDED).prior();
    let seen_again = |(landmark, in_map): (&InverseDepthLandmark, &InverseDepthLandmark)| {
        let mut again = with_prior(&map, ADDED, in_map);
        let new = landmark.observations.iter().filter(|observation| observation.view() < ADDED);
        again.observations.extend(new.copied());
        again
    };
    let again = place.landmarks.iter().zip(&map.landmarks).map(seen_again).collect();
    let mut poses = place.truth[..ADDED].to_vec();
    poses.extend(&map.poses);
    let priors = place.priors[..ADDED].to_vec();
    let extension = place.problem(vec![&priors, &joint]);
    let (extended, stated) = solved(&extension, bundle(&poses, again));
    assert_equal(&extended.poses, &stated, &batch.poses, &expected);

    let before = covariance.trace();
    let after = stated.view((6 * ADDED, 6 * ADDED), (6 * STORED, 6 * STORED)).trace();
    assert!(after < before, "{after} {before}");
    // The positions of landmarks are those of the batch, too.
    let view_poses: [Vec<ViewPose>; 2] = [extended.view_poses(), batch.view_poses()];
    for (a, b) in extended.landmarks.iter().zip(&batch.landmarks) {
        let [a, b] =
            [(a, &view_poses[0]), (b, &view_poses[1])].map(|(l, poses)| l.position(&place.cameras, poses));
        assert!((a - b).norm() < LANDMARK_TOLERANCE * a.z, "{a} {b}");
    }
}

#[test]
fn two_merged_maps_are_the_map_of_all_observations() {
    let place = Place::new();
    let (batch, expected) = place.batch();
    let (first, covariance) = place.map(ADDED..ADDED + STORED);
    let (second, of_second) = place.map(0..ADDED);
    let joint = vec![
        prior(&stored(&second, &of_second), 0).prior(),
        prior(&stored(&first, &covariance), ADDED).prior(),
    ];
    let poses = [&second.poses[..], &first.poses[..]].concat();
    let tie = |(one, other): (&InverseDepthLandmark, &InverseDepthLandmark)| {
        LandmarkTie::new(with_prior(&first, ADDED, one), with_prior(&second, 0, other), &poses).unwrap()
    };
    let ties: Vec<LandmarkTie> = first.landmarks.iter().zip(&second.landmarks).map(tie).collect();
    let merging = place.problem(vec![&joint, &ties]);
    let (merged, stated) = solved(&merging, bundle(&poses, Vec::new()));
    assert_equal(&merged.poses, &stated, &batch.poses, &expected);

    for (tie, landmark) in ties.iter().zip(&batch.landmarks) {
        let anchor = landmark.anchor_view();
        let position = merged.poses[anchor].transform(&tie.position_in_anchor(&merged.poses).unwrap());
        let in_batch = batch.poses[anchor].transform(&(landmark.ray.push(1.0) / landmark.inverse_depth));
        assert!((position - in_batch).norm() < LANDMARK_TOLERANCE * position.z, "{position} {in_batch}");
        assert!(tie.is_consistent(&merged.poses));
    }
}

/// The poses of a map, all of which are tied.
fn prior(contents: &MapContents, first: usize) -> StoredPoses {
    StoredPoses::of_map(contents, first, (0..contents.keyframes.len()).collect()).unwrap()
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
