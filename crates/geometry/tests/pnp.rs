//! Laws of absolute pose: solvers are exact on exact data, the search stands outliers, covariances are consistent.

use crate::common::{Random, cameras, euroc, fov};
use geometry::numeric::numeric_jacobian;
use geometry::pnp::{gravity_two_point, p3p, refine, solve_ransac};
use geometry::{Camera, Correspondence, Gravity, PnpError, Pose, RansacOptions, rotation};
use nalgebra::{DVector, Unit, UnitVector3, Vector3};

/// Exact sights of random points from a random pose.
fn scene(random: &mut Random, camera: &Camera, count: usize) -> (Pose, Vec<Correspondence>) {
    let world_from_camera = random.pose(20.0);
    let sights = (0..count)
        .map(|_| {
            let in_camera = random.visible_point(camera, 2.0, 15.0);
            let point = world_from_camera.transform(&in_camera);
            Correspondence { point, pixel: camera.project(&in_camera).unwrap() }
        })
        .collect();
    (world_from_camera, sights)
}

/// Noise on all pixels, and a wrong pixel for the first `outliers`.
fn spoil(random: &mut Random, camera: &Camera, sights: &mut [Correspondence], sigma: f64, outliers: usize) {
    for sight in sights.iter_mut() {
        sight.pixel += random.normal_vector::<2>() * sigma;
    }
    for sight in &mut sights[..outliers] {
        sight.pixel = random.pixel(camera);
    }
}

fn bearings(camera: &Camera, sights: &[Correspondence]) -> Vec<UnitVector3<f64>> {
    sights.iter().map(|sight| camera.bearing(&sight.pixel).unwrap()).collect()
}

fn nearest(truth: &Pose, poses: &[Pose]) -> f64 {
    poses.iter().map(|pose| truth.local(pose).norm()).fold(f64::INFINITY, f64::min)
}

#[test]
fn p3p_finds_the_exact_pose_and_every_solution_explains_the_points() {
    let camera = euroc();
    let mut random = Random::new(21);
    let mut errors = Vec::new();
    for _ in 0..1000 {
        let (truth, sights) = scene(&mut random, &camera, 3);
        let rays = bearings(&camera, &sights);
        let points = [sights[0].point, sights[1].point, sights[2].point];
        let poses = p3p(&[rays[0], rays[1], rays[2]], &points).unwrap();
        assert!((1..=4).contains(&poses.len()));
        for pose in &poses {
            for (ray, point) in rays.iter().zip(&points) {
                let direction = pose.inverse_transform(point).normalize();
                assert!((direction - ray.into_inner()).norm() < 1e-6, "{pose:?}");
            }
        }
        errors.push(nearest(&truth, &poses));
    }
    errors.sort_by(f64::total_cmp);
    // Near the danger cylinder the problem itself is ill-conditioned.
    assert!(errors[500] < 1e-11 && errors[990] < 1e-7 && errors[999] < 1e-3, "{:?}", &errors[985..]);
}

#[test]
fn two_points_and_gravity_find_the_exact_pose() {
    let camera = euroc();
    let mut random = Random::new(23);
    let mut errors = Vec::new();
    for _ in 0..1000 {
        let (truth, sights) = scene(&mut random, &camera, 2);
        let rays = bearings(&camera, &sights);
        let in_world = Unit::new_normalize(random.vector(1.0));
        let in_camera = Unit::new_normalize(truth.rotation.inverse() * in_world.into_inner());
        let points = [sights[0].point, sights[1].point];
        let poses = gravity_two_point(&points, &[rays[0], rays[1]], &in_world, &in_camera).unwrap();
        assert!(poses.len() <= 2);
        for pose in &poses {
            assert!((pose.rotation * in_camera.into_inner() - in_world.into_inner()).norm() < 1e-12);
        }
        errors.push(nearest(&truth, &poses));
    }
    errors.sort_by(f64::total_cmp);
    // A double root is known to the square root of the rounding error only.
    assert!(errors[500] < 1e-11 && errors[990] < 1e-8 && errors[999] < 1e-4, "{:?}", &errors[985..]);
}

#[test]
fn the_search_finds_the_pose_among_outliers() {
    for camera in cameras() {
        for (percent, with_gravity) in [(30, false), (30, true), (60, false), (60, true)] {
            for seed in 0..10 {
                let mut random = Random::new(100 + seed);
                let (truth, mut sights) = scene(&mut random, &camera, 100);
                spoil(&mut random, &camera, &mut sights, 0.5, percent);
                let in_world = Vector3::new(0.1, -9.8, 0.3);
                // One degree of error about any axis.
                let tilt = rotation::exp(&(Unit::new_normalize(random.vector(1.0)).into_inner() * 0.0175));
                let in_camera = tilt * (truth.rotation.inverse() * in_world);
                let gravity = with_gravity.then_some(Gravity { in_world, in_camera });
                let options = RansacOptions { threshold_px: 2.5, seed, gravity, ..RansacOptions::default() };
                let found = solve_ransac(&camera, &sights, &options, 0.5).unwrap();
                let error = truth.local(&found.world_from_camera.pose);
                let what = format!("{camera:?} {percent} % gravity {with_gravity} seed {seed}: {error}");
                assert!(found.world_from_camera.nees(&truth).unwrap() < 60.0, "{what}");
                assert!(found.inliers.len() as i32 >= 95 - percent as i32, "{what}");
                assert!(found.inliers.iter().filter(|&&i| i < percent).count() <= 3, "{what}");
                assert!(found.mean_error_px < 1.0);
                assert_eq!(
                    found,
                    solve_ransac(&camera, &sights, &options, 0.5).unwrap(),
                    "not deterministic"
                );
            }
        }
    }
}

#[test]
fn points_behind_the_camera_are_outliers() {
    let camera = euroc();
    let mut random = Random::new(31);
    let (truth, mut sights) = scene(&mut random, &camera, 60);
    for sight in &mut sights[..20] {
        sight.point = truth.transform(&-truth.inverse_transform(&sight.point)); // mirrored: the same line of sight
    }
    let found = solve_ransac(&camera, &sights, &RansacOptions::default(), 1.0).unwrap();
    assert_eq!(found.inliers, (20..60).collect::<Vec<_>>());
    assert!(truth.local(&found.world_from_camera.pose).norm() < 1e-8);
}

#[test]
fn the_refined_covariance_is_consistent() {
    const TRIALS: usize = 1000;
    for camera in [euroc(), fov()] {
        let mut mean_nees = 0.0;
        for seed in 0..TRIALS {
            let mut random = Random::new(seed as u64);
            let (truth, mut sights) = scene(&mut random, &camera, 30);
            spoil(&mut random, &camera, &mut sights, 1.0, 0);
            let start = truth.retract(&(random.normal_vector::<6>() * 0.02));
            let found = refine(&camera, &sights, &start, 1.0, 10, None).unwrap();
            mean_nees += found.nees(&truth).unwrap() / TRIALS as f64;
        }
        // Six degrees of freedom: the mean has a standard deviation of sqrt(12 / 1000) = 0.11.
        assert!((mean_nees - 6.0).abs() < 0.45, "{mean_nees}");
    }
}

#[test]
fn the_refined_covariance_is_the_inverse_of_the_numeric_information() {
    let camera = euroc();
    let (truth, sights) = scene(&mut Random::new(41), &camera, 20);
    let found = refine(&camera, &sights, &truth, 2.0, 5, None).unwrap();
    let jacobian = numeric_jacobian(6, |e| {
        let moved = truth.retract(&nalgebra::Vector6::from_column_slice(e.as_slice()));
        let pixels =
            sights.iter().map(|sight| camera.project(&moved.inverse_transform(&sight.point)).unwrap());
        DVector::from_iterator(40, pixels.flat_map(|pixel| [pixel.x, pixel.y]))
    });
    let information = jacobian.tr_mul(&jacobian) / 4.0;
    let product = information * found.covariance;
    assert!((product - nalgebra::DMatrix::identity(6, 6)).amax() < 1e-5);
}

#[test]
fn refining_comes_home_from_far_with_outliers() {
    let camera = euroc();
    let mut random = Random::new(51);
    for _ in 0..50 {
        let (truth, mut sights) = scene(&mut random, &camera, 60);
        spoil(&mut random, &camera, &mut sights, 0.3, 3);
        let start = truth.retract(&(random.normal_vector::<6>() * 0.1));
        let found = refine(&camera, &sights, &start, 0.3, 50, Some(1.5)).unwrap();
        assert!(truth.local(&found.pose).norm() < 0.05, "{}", truth.local(&found.pose));
    }
}

#[test]
fn degenerate_input_is_an_error() {
    let camera = euroc();
    let (_, sights) = scene(&mut Random::new(61), &camera, 20);
    let rays = bearings(&camera, &sights);
    let points: Vec<_> = sights.iter().map(|sight| sight.point).collect();

    let line = [Vector3::x(), Vector3::x() * 2.0, Vector3::x() * 5.0];
    assert_eq!(p3p(&[rays[0], rays[1], rays[2]], &line), Err(PnpError::Degenerate));
    assert_eq!(
        p3p(&[rays[0], rays[1], rays[1]], &[points[0], points[1], points[2]]),
        Err(PnpError::Degenerate)
    );
    let nan = Vector3::new(f64::NAN, 0.0, 0.0);
    assert_eq!(p3p(&[rays[0], rays[1], rays[2]], &[nan, points[1], points[2]]), Err(PnpError::InvalidInput));

    let z = Vector3::z_axis();
    let above = [points[0], points[0] + Vector3::z()];
    assert_eq!(gravity_two_point(&above, &[rays[0], rays[1]], &z, &z), Err(PnpError::Degenerate));
    assert_eq!(gravity_two_point(&[points[0]; 2], &[rays[0], rays[1]], &z, &z), Err(PnpError::Degenerate));
    assert_eq!(gravity_two_point(&[points[0], points[1]], &[rays[0]; 2], &z, &z), Err(PnpError::Degenerate));
    assert_eq!(
        gravity_two_point(&[nan, points[1]], &[rays[0], rays[1]], &z, &z),
        Err(PnpError::InvalidInput)
    );
}

#[test]
fn a_search_or_refinement_without_support_is_an_error() {
    let camera = euroc();
    let mut random = Random::new(71);
    let (truth, mut sights) = scene(&mut random, &camera, 40);
    let options = RansacOptions::default();
    let few = solve_ransac(&camera, &sights[..5], &options, 1.0);
    assert_eq!(few, Err(PnpError::TooFew { given: 5, needed: 10 }));
    let nan = RansacOptions { threshold_px: f64::NAN, ..options };
    assert_eq!(solve_ransac(&camera, &sights, &nan, 1.0), Err(PnpError::InvalidInput));
    let sure = RansacOptions { confidence: 1.0, ..options };
    assert_eq!(solve_ransac(&camera, &sights, &sure, 1.0), Err(PnpError::InvalidInput));
    let weightless = Gravity { in_world: Vector3::zeros(), in_camera: Vector3::z() };
    let weightless = RansacOptions { gravity: Some(weightless), ..options };
    assert_eq!(solve_ransac(&camera, &sights, &weightless, 1.0), Err(PnpError::InvalidInput));
    assert_eq!(refine(&camera, &sights, &truth, 0.0, 5, None), Err(PnpError::InvalidInput));
    assert!(matches!(refine(&camera, &sights[..2], &truth, 1.0, 5, None), Err(PnpError::TooFew { .. })));
    let one_line: Vec<_> = (0..10)
        .map(|k| {
            let in_camera = Vector3::new(0.1 * f64::from(k), 0.2, 4.0);
            Correspondence { point: truth.transform(&in_camera), pixel: camera.project(&in_camera).unwrap() }
        })
        .collect();
    assert_eq!(refine(&camera, &one_line, &truth, 1.0, 5, None), Err(PnpError::Degenerate));

    spoil(&mut random, &camera, &mut sights, 0.0, 40);
    assert!(matches!(solve_ransac(&camera, &sights, &options, 1.0), Err(PnpError::TooFewInliers { .. })));
    let gravity = Some(Gravity { in_world: Vector3::z(), in_camera: Vector3::y() });
    let guided = RansacOptions { gravity, ..options };
    assert!(matches!(solve_ransac(&camera, &sights, &guided, 1.0), Err(PnpError::TooFewInliers { .. })));
    sights[0].point.x = f64::NAN;
    assert_eq!(solve_ransac(&camera, &sights, &options, 1.0), Err(PnpError::InvalidInput));
}
