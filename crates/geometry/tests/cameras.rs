//! Laws of cameras: projecting and unprojecting undo one another, Jacobians are derivatives, bad input is an error.

use crate::common::{Random, cameras, euroc, fisheye, fov};
use geometry::numeric::{numeric_jacobian, numeric_jacobian_with_step};
use geometry::{Camera, CameraError, Distortion, MAX_INTRINSICS, ProjectionError};
use nalgebra::{DVector, SVector, Vector2, Vector3};

#[test]
fn project_undoes_unproject_over_the_whole_image() {
    for camera in [crate::common::pinhole(), euroc(), fov()] {
        for u in (0..=camera.width).step_by(8) {
            for v in (0..=camera.height).step_by(8) {
                let pixel = Vector2::new(f64::from(u) - 0.5, f64::from(v) - 0.5);
                let ray = camera.bearing(&pixel).unwrap();
                let back = camera.project(&(ray.into_inner() * 7.0)).unwrap();
                assert!((back - pixel).norm() < 1e-9, "{camera:?} {pixel}: {back}");
            }
        }
    }
}

#[test]
fn a_fisheye_is_undone_up_to_a_right_angle_and_refused_beyond() {
    let camera = fisheye();
    let (mut seen, mut refused) = (0, 0);
    for u in (0..=camera.width).step_by(4) {
        for v in (0..=camera.height).step_by(4) {
            let pixel = Vector2::new(f64::from(u) - 0.5, f64::from(v) - 0.5);
            if let Ok(ray) = camera.bearing(&pixel) {
                seen += 1;
                let back = camera.project(&(ray.into_inner() * 7.0)).unwrap();
                assert!((back - pixel).norm() < 1e-9, "{pixel}: {back}");
            } else {
                refused += 1;
                let radius = (pixel - Vector2::from(camera.centre)).norm();
                assert!(radius > 250.0, "{pixel} is refused");
            }
        }
    }
    assert!(seen > 10 * refused, "{seen} seen, {refused} refused");
}

#[test]
fn the_jacobian_by_the_intrinsics_is_the_derivative() {
    for camera in cameras() {
        for k in 0..50 {
            let point = Random::new(k).visible_point(&camera, 0.5, 20.0);
            let jacobian = camera.intrinsics_jacobian(&point).unwrap();
            let numeric = numeric_jacobian_with_step(MAX_INTRINSICS, 1e-5, |change| {
                let mut moved = camera.clone();
                moved.add_to_intrinsics(&SVector::from_column_slice(change.as_slice()));
                DVector::from_column_slice(moved.project(&point).unwrap().as_slice())
            });
            let difference = (&numeric - jacobian).amax() / numeric.amax();
            assert!(difference < 1e-7, "{camera:?} at {point}: {difference}");
            assert!(jacobian.columns_range(camera.intrinsics_len()..).iter().all(|value| *value == 0.0));
        }
    }
}

#[test]
fn jacobians_are_derivatives() {
    let mut random = Random::new(1);
    for camera in cameras() {
        for k in 0..200 {
            let mut point = Random::new(k).visible_point(&camera, 0.5, 20.0);
            if k == 0 {
                point = Vector3::new(1e-9, -1e-9, random.uniform(1.0, 2.0)); // on the axis
            }
            let Ok((pixel, jacobian)) = camera.project_with_jacobian(&point) else { continue };
            assert!((pixel - camera.project(&point).unwrap()).norm() < 1e-12);
            let numeric = numeric_jacobian_with_step(3, 1e-4 * point.z, |e| {
                let moved = point + Vector3::new(e[0], e[1], e[2]);
                DVector::from_column_slice(camera.project(&moved).unwrap().as_slice())
            });
            let scale = jacobian.amax();
            assert!((numeric - jacobian).amax() < 1e-6 * scale, "{camera:?} {point}");

            let normalized = Vector2::new(point.x / point.z, point.y / point.z);
            let (_, jacobian) = camera.distort_normalized_with_jacobian(&normalized);
            let numeric = numeric_jacobian(2, |e| {
                let (pixel, _) =
                    camera.distort_normalized_with_jacobian(&(normalized + Vector2::new(e[0], e[1])));
                DVector::from_column_slice(pixel.as_slice())
            });
            assert!((numeric - jacobian).amax() < 1e-6 * jacobian.amax(), "{camera:?} {normalized}");
        }
    }
}

#[test]
fn points_behind_and_numbers_that_are_not_finite_are_errors() {
    for camera in cameras() {
        assert_eq!(camera.project(&Vector3::new(0.1, 0.1, -1.0)), Err(ProjectionError::BehindCamera));
        assert_eq!(camera.project(&Vector3::zeros()), Err(ProjectionError::BehindCamera));
        assert_eq!(camera.project(&Vector3::new(f64::NAN, 0.0, 1.0)), Err(ProjectionError::NotFinite));
        assert!(camera.project_with_jacobian(&Vector3::new(0.0, f64::INFINITY, 1.0)).is_err());
        assert_eq!(camera.unproject(&Vector2::new(f64::NAN, 1.0)), Err(ProjectionError::NotFinite));
    }
}

#[test]
fn beyond_the_fold_of_the_model_there_is_no_pixel_and_no_ray() {
    // r (1 - 0.3 r^2) turns back at r = 1.054, where it is 0.703.
    let camera = Camera { distortion: Distortion::RadialTangential([-0.3, 0.0, 0.0, 0.0]), ..euroc() };
    assert!(camera.project(&Vector3::new(1.05, 0.0, 1.0)).is_ok());
    assert_eq!(camera.project(&Vector3::new(1.06, 0.0, 1.0)), Err(ProjectionError::OutsideModel));
    let at = |radius: f64| Vector2::new(camera.centre[0] + camera.focal[0] * radius, camera.centre[1]);
    assert!(camera.unproject(&at(0.70)).is_ok());
    assert_eq!(camera.unproject(&at(0.71)), Err(ProjectionError::OutsideModel));
    // atan(..) / omega never exceeds (pi / 2) / omega.
    let wide = fov();
    let far = Vector2::new(wide.centre[0] + wide.focal[0] * 1.7, wide.centre[1]);
    assert_eq!(wide.unproject(&far), Err(ProjectionError::OutsideModel));
}

#[test]
fn a_strongly_distorted_image_is_undone_too() {
    let camera = Camera { distortion: Distortion::RadialTangential([0.9, 1.5, 0.01, -0.02]), ..euroc() };
    let mut random = Random::new(5);
    for _ in 0..1000 {
        let pixel = random.pixel(&camera);
        let ray = camera.bearing(&pixel).unwrap();
        assert!((camera.project(&ray).unwrap() - pixel).norm() < 1e-9);
    }
}

#[test]
fn cameras_that_cannot_be_are_refused() {
    assert!(cameras().iter().all(|camera| camera.validate().is_ok()));
    assert!(matches!(Camera { width: 0, ..euroc() }.validate(), Err(CameraError::EmptyImage { .. })));
    assert!(matches!(Camera { focal: [0.0, 1.0], ..euroc() }.validate(), Err(CameraError::FocalLength(..))));
    assert!(matches!(Camera { centre: [f64::NAN, 1.0], ..euroc() }.validate(), Err(CameraError::Centre(..))));
    for distortion in [
        Distortion::Fov(0.0),
        Distortion::Fov(f64::NAN),
        Distortion::Equidistant([f64::INFINITY, 0.0, 0.0, 0.0]),
    ] {
        let error = Camera { distortion, ..euroc() }.validate().unwrap_err();
        assert!(matches!(error, CameraError::DistortionCoefficients(_) | CameraError::FovParameter { .. }));
    }
}

#[test]
fn the_image_includes_the_outer_half_of_its_border_pixels() {
    let camera = euroc();
    assert!(camera.contains(&Vector2::new(-0.5, 479.5)) && camera.contains(&Vector2::new(751.5, 0.0)));
    assert!(!camera.contains(&Vector2::new(-0.6, 0.0)) && !camera.contains(&Vector2::new(0.0, 479.6)));
    assert!(!camera.contains(&Vector2::new(f64::NAN, 0.0)));
}
