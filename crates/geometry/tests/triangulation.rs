//! Laws of triangulation: exact on exact pixels, consistent on noisy ones, an error where the landmark is not there.

use crate::common::{Random, cameras, euroc};
use geometry::{
    Camera, Pose, ProjectionError, TriangulationError, TriangulationOptions, View, reprojection_error,
    rotation, triangulate,
};
use nalgebra::{Vector2, Vector3};

/// A landmark and views of it from a path of 2 m that looks at it, in a parent frame of any orientation.
fn scene(random: &mut Random, camera: &Camera, views: usize, noise_px: f64) -> (Vector3<f64>, Vec<View>) {
    let parent_from_first = random.pose(100.0);
    let landmark_in_first =
        Vector3::new(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(4.0, 10.0));
    let landmark = parent_from_first.transform(&landmark_in_first);
    let direction =
        Vector3::new(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(-0.3, 0.3));
    let step = direction.normalize() * (2.0 / views as f64);
    let views = (0..views)
        .map(|k| {
            let first_from_camera = Pose::new(rotation::exp(&(random.vector(0.1))), step * k as f64);
            let parent_from_camera = parent_from_first * first_from_camera;
            let pixel = camera.project(&parent_from_camera.inverse_transform(&landmark)).unwrap();
            let noise = random.normal_vector::<2>() * noise_px;
            View { parent_from_camera, pixel: pixel + noise, sigma_px: noise_px.max(1.0) }
        })
        .collect();
    (landmark, views)
}

#[test]
fn exact_pixels_give_the_exact_landmark() {
    for camera in cameras() {
        let mut random = Random::new(7);
        for k in 0..300 {
            let (landmark, views) = scene(&mut random, &camera, 2 + k % 20, 0.0);
            let cameras = vec![&camera; views.len()];
            let found = triangulate(&cameras, &views, &TriangulationOptions::default()).unwrap();
            assert!((found.position - landmark).norm() < 1e-7, "{found:?} {landmark}");
            assert!(found.mean_reprojection_error < 1e-8);
        }
    }
}

#[test]
fn the_covariance_is_consistent() {
    const TRIALS: usize = 3000;
    for (count, noise) in [(2, 0.5), (5, 1.0), (20, 1.5)] {
        let camera = euroc();
        let (mut nees, mut reprojection) = (0.0, 0.0);
        for seed in 0..TRIALS {
            let (landmark, mut views) = scene(&mut Random::new(seed as u64), &camera, count, noise);
            for view in &mut views {
                view.sigma_px = noise;
            }
            let cameras = vec![&camera; count];
            let found = triangulate(&cameras, &views, &TriangulationOptions::default()).unwrap();
            let error = found.position - landmark;
            nees += error.dot(&found.covariance.cholesky().unwrap().solve(&error)) / TRIALS as f64;
            reprojection += found.mean_reprojection_error / TRIALS as f64;
        }
        // Three degrees of freedom: the mean has a standard deviation of sqrt(6 / 3000) = 0.045.
        assert!((nees - 3.0).abs() < 0.25, "{count} views: {nees}");
        assert!(reprojection < noise * 1.4, "{reprojection}");
    }
}

#[test]
fn cameras_of_different_kinds_triangulate_together() {
    let cameras = cameras();
    let mut random = Random::new(9);
    for _ in 0..100 {
        let (landmark, mut views) = scene(&mut random, &cameras[0], cameras.len(), 0.0);
        for (view, camera) in views.iter_mut().zip(&cameras) {
            view.pixel = camera.project(&view.parent_from_camera.inverse_transform(&landmark)).unwrap();
        }
        let references: Vec<&Camera> = cameras.iter().collect();
        let found = triangulate(&references, &views, &TriangulationOptions::default()).unwrap();
        assert!((found.position - landmark).norm() < 1e-7);
    }
}

#[test]
fn a_robust_triangulation_stands_an_outlier() {
    let camera = euroc();
    let mut random = Random::new(11);
    let robust =
        TriangulationOptions { huber_sigmas: 1.5, max_iterations: 20, ..TriangulationOptions::default() };
    let (mut plain_error, mut robust_error) = (0.0, 0.0);
    for _ in 0..100 {
        let (landmark, mut views) = scene(&mut random, &camera, 15, 0.5);
        views[7].pixel += Vector2::new(25.0, -25.0);
        let cameras = vec![&camera; views.len()];
        let plain = triangulate(&cameras, &views, &TriangulationOptions::default()).unwrap();
        let found = triangulate(&cameras, &views, &robust).unwrap();
        plain_error += (plain.position - landmark).norm();
        robust_error += (found.position - landmark).norm();
        assert!(reprojection_error(&camera, &views[7], &found.position).unwrap() > 20.0);
    }
    assert!(robust_error < 0.5 * plain_error, "{robust_error} {plain_error}");
}

#[test]
fn what_cannot_be_triangulated_is_an_error() {
    let camera = euroc();
    let options = TriangulationOptions::default();
    let (landmark, views) = scene(&mut Random::new(13), &camera, 3, 0.0);
    let cameras = [&camera, &camera, &camera];
    assert_eq!(triangulate(&cameras[..1], &views[..1], &options), Err(TriangulationError::TooFewViews(1)));
    assert_eq!(triangulate(&[], &[], &options), Err(TriangulationError::TooFewViews(0)));
    let mismatch = TriangulationError::LengthMismatch { cameras: 2, views: 3 };
    assert_eq!(triangulate(&cameras[..2], &views, &options), Err(mismatch));
    // The same place twice has no parallax, whatever the orientation.
    let turned = Pose::new(rotation::exp(&Vector3::new(0.05, 0.0, 0.0)), Vector3::zeros());
    let mut still = views.clone();
    for view in &mut still[1..] {
        view.parent_from_camera = still_pose(&views[0]) * turned;
        view.pixel = camera.project(&view.parent_from_camera.inverse_transform(&landmark)).unwrap();
    }
    assert_eq!(triangulate(&cameras, &still, &options), Err(TriangulationError::Degenerate));
    for spoil in [
        |view: &mut View| view.pixel.x = f64::NAN,
        |view: &mut View| view.sigma_px = 0.0,
        |view: &mut View| view.parent_from_camera.translation.z = f64::INFINITY,
    ] {
        let mut spoilt = views.clone();
        spoil(&mut spoilt[1]);
        assert_eq!(triangulate(&cameras, &spoilt, &options), Err(TriangulationError::InvalidInput));
    }
    let mut outside = views.clone();
    let wide = crate::common::fov();
    outside[0].pixel = Vector2::new(1e4, 0.0);
    let no_ray = TriangulationError::NoRay(ProjectionError::OutsideModel);
    assert_eq!(triangulate(&[&wide, &wide, &wide], &outside, &options), Err(no_ray));
}

fn still_pose(view: &View) -> Pose {
    view.parent_from_camera
}

#[test]
fn rays_that_diverge_meet_behind_the_cameras() {
    let camera = crate::common::pinhole();
    let at = |x: f64, u: f64| View {
        parent_from_camera: Pose::new(rotation::exp(&Vector3::zeros()), Vector3::new(x, 0.0, 0.0)),
        pixel: Vector2::new(u, 240.0),
        sigma_px: 1.0,
    };
    let options = TriangulationOptions::default();
    let diverging = [at(0.0, 220.0), at(1.0, 420.0)];
    assert_eq!(triangulate(&[&camera, &camera], &diverging, &options), Err(TriangulationError::BehindCamera));
    let near = [at(0.0, 560.0), at(0.02, 80.0)];
    assert_eq!(triangulate(&[&camera, &camera], &near, &options), Err(TriangulationError::BehindCamera));
}
