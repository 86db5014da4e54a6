//! Jacobians are the numeric derivatives, and equations are the gradient of their cost.

use std::sync::Arc;

use adjustment::{
    Bundle, Factor, InverseDepthLandmark, JointPrior, LandmarkPrior, LandmarkTie, Loss,
    MAPPED_INVERSE_DEPTHS, MeasuredPose, MeasuredPoses, NormalEquations, POSE, PosePrior, Problem,
    RelativePose, StoredObserver, ViewPose, gauge_information,
};
use geometry::numeric::{numeric_jacobian, numeric_jacobian_with_step};
use geometry::rotation::exp;
use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};
use nalgebra::{DMatrix, DVector, Matrix6, Vector2, Vector3, Vector6};
use rand::SeedableRng;
use rand::rngs::StdRng;

use crate::scene::{Scene, camera, pixel_model, pose, vector};

#[test]
fn jacobians_of_a_prediction_are_the_numeric_derivatives() {
    for seed in 0..10 {
        let scene = Scene::new(seed, 2, 4);
        for landmark in &scene.landmarks {
            for index in 0..landmark.observations.len() {
                check_prediction(&scene, landmark, index);
            }
        }
    }
}

fn check_prediction(scene: &Scene, landmark: &InverseDepthLandmark, index: usize) {
    let (anchor, view) = (landmark.anchor_view(), landmark.observations[index].view());
    let stated = landmark.predict(&scene.cameras, &view_poses(&scene.poses), index).unwrap();
    assert!((stated.pixel - landmark.observations[index].pixel).norm() < 1e-9);
    let numeric = numeric_jacobian(15, |error| {
        let mut poses = scene.poses.clone();
        poses[anchor] = poses[anchor].retract(&error.fixed_rows::<6>(0).into_owned());
        poses[view] = poses[view].retract(&error.fixed_rows::<6>(6).into_owned());
        let moved = landmark.corrected(&error.fixed_rows::<3>(12).into_owned(), MAPPED_INVERSE_DEPTHS);
        let pixel = moved.predict(&scene.cameras, &view_poses(&poses), index).unwrap().pixel;
        DVector::from_column_slice(pixel.as_slice())
    });
    assert!((numeric.columns(0, 6) - stated.by_anchor).amax() < 1e-5);
    assert!((numeric.columns(6, 6) - stated.by_view).amax() < 1e-5);
    assert!((numeric.columns(12, 3) - stated.by_landmark).amax() < 1e-5);
}

fn view_poses(poses: &[geometry::Pose]) -> Vec<ViewPose> {
    poses.iter().map(ViewPose::from).collect()
}

/// The bundle of three views without landmarks.
fn three_views(rng: &mut StdRng) -> Bundle {
    Bundle { poses: (0..3).map(|_| pose(rng, 0.4, 1.0)).collect(), ..Bundle::default() }
}

fn check_factor(factor: &dyn Factor, bundle: &Bundle) {
    for scale in [0.5, 30.0] {
        let mut equations = NormalEquations::new(bundle.layout());
        factor.add_to(&mut equations, bundle, scale);
        let numeric = numeric_jacobian_with_step(bundle.layout().dim(), 1e-5, |error| {
            DVector::from_element(1, factor.cost(&bundle.moved(error), scale))
        });
        let gradient = equations.gradient();
        let off = (numeric.transpose() + gradient).amax();
        assert!(gradient.amax() > 0.0 && off < 1e-6 * gradient.amax(), "{off} of {}", gradient.amax());
    }
}

#[test]
fn equations_of_priors_and_of_relative_poses_are_the_gradient_of_their_cost() {
    let mut rng = StdRng::seed_from_u64(14);
    let bundle = three_views(&mut rng);
    let reference = PoseWithCovariance::new(pose(&mut rng, 0.4, 1.0), isotropic_covariance(0.1, 0.2));
    check_factor(&PosePrior::of_reference(1, &reference), &bundle);
    let information = gauge_information(0.3, f64::INFINITY, 0.2);
    check_factor(&PosePrior { view: 2, pose: pose(&mut rng, 0.4, 1.0), information }, &bundle);
    let root = DMatrix::from_fn(2 * POSE, 2 * POSE, |row, column| ((row * 7 + column * 13) as f64).sin());
    let means = vec![pose(&mut rng, 0.4, 1.0), pose(&mut rng, 0.4, 1.0)];
    check_factor(&JointPrior::new(vec![0, 2], means, Arc::new(&root * root.transpose())), &bundle);
    let relative = |views, rng: &mut StdRng| RelativePose {
        views,
        first_from_second: pose(rng, 0.4, 1.0),
        information: Matrix6::from_diagonal(&Vector6::new(3.0, 2.0, 1.0, 4.0, 5.0, 6.0)),
    };
    check_factor(&vec![relative([0, 2], &mut rng), relative([2, 1], &mut rng)], &bundle);
}

#[test]
fn equations_of_measured_poses_are_the_gradient_of_their_cost() {
    let mut rng = StdRng::seed_from_u64(15);
    let bundle = three_views(&mut rng);
    for with_rotation in [false, true] {
        let mut information = Matrix6::zeros();
        information.fixed_view_mut::<3, 3>(3, 3).fill_diagonal(40.0);
        if with_rotation {
            information.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(90.0);
            information[(1, 5)] = 7.0;
            information[(5, 1)] = 7.0;
        }
        let measured = MeasuredPose {
            view: 2,
            point_in_body: vector(&mut rng, 1.0),
            position: vector(&mut rng, 1.0),
            rotation: with_rotation.then(|| exp(&vector(&mut rng, 0.6))),
            information,
        };
        check_factor(&MeasuredPoses::new(&[measured], &bundle.poses), &bundle);
    }
}

#[test]
fn equations_of_a_landmark_that_two_maps_share_are_the_gradient_of_their_cost() {
    let mut rng = StdRng::seed_from_u64(16);
    let poses: Vec<_> = (0..4).map(|_| pose(&mut rng, 0.05, 0.3)).collect();
    let camera = camera();
    let point = Vector3::new(0.3, -0.2, 5.0);
    let of_map = |views: [usize; 2]| {
        let observer = |view: usize| {
            let pixel = camera.project(&poses[view].inverse_transform(&point)).unwrap();
            StoredObserver {
                view,
                pose: poses[view],
                camera: &camera,
                pixel: pixel + Vector2::new(0.4, -0.3),
            }
        };
        let in_anchor = poses[views[0]].inverse_transform(&point);
        LandmarkPrior::landmark(1, &in_anchor, &views.map(observer), 1.0).unwrap()
    };
    let tie = LandmarkTie::new(of_map([0, 1]), of_map([2, 3]), &poses).unwrap();
    let moved = poses.iter().map(|pose| pose.retract(&Vector6::from_fn(|row, _| 0.003 * (row as f64).cos())));
    check_factor(&tie, &Bundle { poses: moved.collect(), ..Bundle::default() });
}

#[test]
fn equations_of_pixels_are_the_gradient_of_their_cost() {
    for (loss, scale) in [(Loss::Cauchy, 3.0), (Loss::Huber, 2.0), (Loss::Huber, f64::INFINITY)] {
        let scene = Scene::new(17, 3, 5).noisy(3, 4.0);
        let problem = Problem { cameras: &scene.cameras, factors: Vec::new(), pixels: pixel_model(loss) };
        let bundle = Bundle { poses: scene.poses, motions: Vec::new(), landmarks: scene.landmarks };
        let numeric = numeric_jacobian(bundle.layout().dim(), |error| {
            DVector::from_element(1, problem.cost(&bundle.moved(error), scale))
        });
        let equations = problem.equations(&bundle, scale, 0.0);
        let off = (numeric.transpose() + equations.gradient()).amax();
        assert!(
            off < 1e-6 * equations.gradient().amax(),
            "{loss:?}: {off} of {}",
            equations.gradient().amax()
        );
    }
}
