//! The camera models against OpenCV and COLMAP, and the laws of their regions: what is outside is an error, never a wrong ray.

use crate::common::{Random, cameras, time_of_flight, webcam};
use geometry::{Camera, Distortion, ProjectionError};
use nalgebra::{Vector2, Vector3};
use std::collections::BTreeMap;

/// Made by `data/make_camera_models.py`.
const REFERENCES: &str = include_str!("data/camera_models.txt");
/// Largest difference of normalized coordinates.
const TOLERANCE: f64 = 1e-9;

fn of_reference(model: &str, k: &[f64]) -> Distortion {
    match model {
        "radial-tangential" | "OPENCV" | "FULL_OPENCV" => Distortion::from_opencv(k).unwrap(),
        "equidistant" | "OPENCV_FISHEYE" => Distortion::Equidistant(k.try_into().unwrap()),
        "FOV" => Distortion::Fov(k[0]),
        "THIN_PRISM_FISHEYE" => Distortion::ThinPrismFisheye(k.try_into().unwrap()),
        "omni" => Distortion::Omni { xi: k[0], distortion: k[1..].try_into().unwrap() },
        _ => panic!("{model}"),
    }
}

#[test]
fn points_are_where_opencv_and_colmap_have_them() {
    let mut largest: BTreeMap<String, [f64; 2]> = BTreeMap::new();
    let (mut distortion, mut name) = (Distortion::None, String::new());
    for line in REFERENCES.lines().filter(|line| !line.starts_with('#')) {
        let words: Vec<&str> = line.split(' ').collect();
        let numbers = |words: &[&str]| words.iter().map(|word| word.parse().unwrap()).collect::<Vec<f64>>();
        if words[0] == "camera" {
            let k = numbers(&words[3..]);
            distortion = of_reference(words[2], &k);
            name = format!("{} {} of {}", words[1], words[2], k.len());
            continue;
        }
        let [x, y, u, v] = numbers(&words)[..] else { panic!("{line}") };
        let (undistorted, distorted) = (Vector2::new(x, y), Vector2::new(u, v));
        let off = (distortion.distort(&undistorted) - distorted).amax();
        let back = distortion.undistort(&distorted).unwrap_or_else(|error| panic!("{name} {line}: {error}"));
        let found = largest.entry(name.clone()).or_default();
        *found = [found[0].max(off), found[1].max((back - undistorted).amax())];
    }
    assert!(largest.len() >= 10, "{largest:?}");
    for (name, [off, back]) in largest {
        println!("{name}: distorted {off:.1e}, undistorted {back:.1e}");
        assert!(off < TOLERANCE && back < TOLERANCE, "{name}: {off:e}, {back:e}");
    }
}

/// Coefficients as lenses have them, of every model.
fn lens(random: &mut Random, model: usize) -> Distortion {
    let scales = [0.2, 0.1, 2e-3, 2e-3, 0.05, 0.1, 0.05, 0.02, 2e-3, 1e-3, 2e-3, 1e-3];
    let k = scales.map(|scale| scale * random.normal());
    let four = [k[0], k[1], k[2], k[3]];
    match model {
        0 => Distortion::RadialTangential(four),
        1 => Distortion::Equidistant([0.05, 0.02, 0.01, 0.002].map(|scale| scale * random.normal())),
        2 => Distortion::Fov(random.uniform(0.1, 1.5)),
        3 => Distortion::Rational(k),
        4 => Distortion::ThinPrismFisheye([
            0.1 * k[0],
            0.1 * k[1],
            k[2],
            k[3],
            0.1 * k[4],
            0.1 * k[7],
            k[8],
            k[9],
        ]),
        5 => Distortion::DoubleSphere { xi: random.uniform(-0.9, 0.9), alpha: random.uniform(0.0, 1.0) },
        6 => Distortion::Eucm { alpha: random.uniform(0.0, 1.0), beta: random.uniform(0.3, 3.0) },
        _ => Distortion::Omni { xi: random.uniform(-0.5, 3.0), distortion: four.map(|value| 0.5 * value) },
    }
}

fn with_unit_focal_length(distortion: Distortion) -> Camera {
    Camera { width: 2, height: 2, focal: [1.0; 2], centre: [0.0; 2], distortion }
}

#[test]
fn undistorting_undoes_distorting_in_the_region() {
    let mut random = Random::new(11);
    let mut wrong = Vec::new();
    for model in 0..8 {
        let (mut largest, mut inside, mut missed, mut flat) = (0.0_f64, 0, 0, 0);
        for _ in 0..300 {
            let distortion = lens(&mut random, model);
            let camera = with_unit_focal_length(distortion);
            for _ in 0..20 {
                let (radius, angle) = (random.uniform(0.0, 1.4_f64).tan(), random.uniform(-3.2, 3.2));
                let ray = Vector2::new(radius * angle.cos(), radius * angle.sin());
                let Ok((distorted, jacobian)) = camera.project_with_jacobian(&ray.push(1.0)) else {
                    continue;
                };
                let jacobian = jacobian.fixed_columns::<2>(0).into_owned();
                // Where the model is nearly flat, at the end of its region, a pixel says little about the ray.
                let sensitivity = jacobian.try_inverse().map_or(f64::INFINITY, |inverse| inverse.amax());
                // Tangential terms fold the radial-tangential model a little earlier than its radial part.
                if sensitivity > 1e3 * (1.0 + radius * radius) || jacobian.determinant() <= 0.0 {
                    flat += 1;
                    continue;
                }
                inside += 1;
                match distortion.undistort(&distorted) {
                    Ok(back) => {
                        let off = (back - ray).amax() / sensitivity.max(1.0);
                        if off > 1e-11 {
                            println!("{distortion:?} at {ray:?}: {back:?}");
                        }
                        largest = largest.max(off);
                    }
                    Err(error) => {
                        missed += 1;
                        println!("{distortion:?} at {ray:?}: {error}, sensitivity {sensitivity:e}");
                    }
                }
            }
        }
        println!("model {model}: {inside} rays, {flat} flat, {missed} missed, off by {largest:.1e}");
        if inside < 1000 || missed > 0 || largest > 1e-11 {
            wrong.push(model);
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn what_is_undistorted_is_a_ray_of_that_pixel() {
    let mut random = Random::new(12);
    for model in 0..8 {
        let (mut rays, mut refused) = (0, 0);
        for _ in 0..400 {
            let camera = with_unit_focal_length(lens(&mut random, model));
            for _ in 0..20 {
                let size = 10_f64.powf(random.uniform(-2.0, 2.0));
                let pixel = random.normal_vector::<2>() * size;
                match camera.unproject(&pixel) {
                    Ok(ray) => {
                        rays += 1;
                        let back = camera.distortion.distort(&ray);
                        let off = (back - pixel).amax() / (1.0 + pixel.norm());
                        assert!(off < 1e-11, "{camera:?} {pixel}: {back}");
                        // At the limit itself both sides round.
                        if model > 2 {
                            assert!(camera.project(&ray.push(1.0)).is_ok(), "{camera:?} {pixel}: {ray}");
                        }
                    }
                    Err(error) => {
                        refused += 1;
                        assert_eq!(error, ProjectionError::OutsideModel);
                    }
                }
            }
        }
        assert!(rays > 500 && refused > 500, "{model}: {rays} {refused}");
    }
}

#[test]
fn absurd_coefficients_end_in_an_error_or_a_ray() {
    let mut random = Random::new(13);
    for round in 0..20_000 {
        let mut value = || {
            let size = 10_f64.powf(random.uniform(-3.0, 12.0));
            match random.index(12) {
                0 => 0.0,
                1 => f64::MAX,
                2 => f64::NAN,
                3 => f64::INFINITY,
                _ => size * random.normal(),
            }
        };
        let k: [f64; 12] = std::array::from_fn(|_| value());
        let four = [k[0], k[1], k[2], k[3]];
        let distortion = match round % 5 {
            0 => Distortion::Rational(k),
            1 => Distortion::ThinPrismFisheye(std::array::from_fn(|i| k[i])),
            2 => Distortion::DoubleSphere { xi: k[0], alpha: k[1] },
            3 => Distortion::Eucm { alpha: k[0], beta: k[1] },
            _ => Distortion::Omni { xi: k[4], distortion: four },
        };
        let camera = with_unit_focal_length(distortion);
        for _ in 0..4 {
            let pixel = random.normal_vector::<2>();
            if let Ok(ray) = camera.unproject(&pixel) {
                let off = (distortion.distort(&ray) - pixel).amax();
                assert!(off < 1e-9 * (1.0 + pixel.norm()), "{distortion:?} {pixel}: {off:e}");
            }
            let _ = camera.project_with_jacobian(&pixel.push(1.0));
            let _ = camera.intrinsics_jacobian(&pixel.push(1.0));
        }
        let _ = camera.validate();
    }
}

#[test]
fn beyond_the_first_fold_a_rational_model_has_no_ray_even_where_it_increases_again() {
    // The derivative of r (1 - r^2 + 0.3 r^4 + 0.1 r^6) vanishes at 0.67 and at 0.93.
    let distortion = Distortion::from_opencv(&[-1.0, 0.3, 0.0, 0.0, 0.1]).unwrap();
    let camera = with_unit_focal_length(distortion);
    let project = |radius: f64| camera.project(&Vector3::new(radius, 0.0, 1.0));
    let radius_of = |radius: f64| distortion.distort(&Vector2::new(radius, 0.0)).x;
    let step = 1e-3;
    let fold = (1..2000).map(|k| f64::from(k) * step).find(|&r| radius_of(r + step) <= radius_of(r)).unwrap();
    assert!(radius_of(2.0) > radius_of(1.9), "it increases again");
    assert!(project(fold - 2.0 * step).is_ok());
    for radius in [fold + 2.0 * step, 1.0, 2.0, 50.0] {
        assert_eq!(project(radius), Err(ProjectionError::OutsideModel));
    }
    let beyond = Vector2::new(radius_of(2.0), 0.0);
    assert_eq!(camera.unproject(&beyond), Err(ProjectionError::OutsideModel));
    // A pole of the gain ends the region too.
    let pole =
        with_unit_focal_length(Distortion::from_opencv(&[0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0]).unwrap());
    assert!(pole.project(&Vector3::new(0.99, 0.0, 1.0)).is_ok());
    assert_eq!(pole.project(&Vector3::new(1.01, 0.0, 1.0)), Err(ProjectionError::OutsideModel));
}

#[test]
fn beyond_the_first_fold_a_fisheye_has_no_ray_even_where_it_increases_again() {
    // The derivative of t - 1.3 t^7 + 0.9 t^9 vanishes at 0.79 and at 1 rad.
    let distortion = Distortion::Equidistant([0.0, 0.0, -1.3, 0.9]);
    let camera = with_unit_focal_length(distortion);
    let ray = |angle: f64| Vector2::new(angle.tan(), 0.0);
    let project = |angle: f64| camera.project(&ray(angle).push(1.0));
    let radius_of = |angle: f64| distortion.distort(&ray(angle)).x;
    let step = 1e-3;
    let fold = (1..1500).map(|k| f64::from(k) * step).find(|&t| radius_of(t + step) <= radius_of(t)).unwrap();
    assert!((fold - 0.79).abs() < 0.01 && radius_of(1.1) > radius_of(fold), "{fold}: it increases again");
    for at in 1..100 {
        let before = f64::from(at) / 100.0 * fold;
        let back = camera.unproject(&project(before).unwrap()).unwrap();
        assert!((back - ray(before)).norm() < 1e-9, "{before}: {back}");
    }
    for beyond in [fold + 2.0 * step, 0.9, 1.05, 1.1, 1.3, 1.5] {
        assert_eq!(project(beyond), Err(ProjectionError::OutsideModel), "{beyond}");
    }
    for beyond in [1.1, 1.3, 1.5] {
        let pixel = Vector2::new(radius_of(beyond), 0.0);
        assert_eq!(camera.unproject(&pixel), Err(ProjectionError::OutsideModel), "{beyond}");
    }
}

#[test]
fn a_double_sphere_ends_where_its_radius_is_largest() {
    for (xi, alpha) in [(-0.9, 0.9), (-0.9, 0.1), (-0.9, 0.7), (-0.95, 0.75), (-0.5, 0.97)] {
        let distortion = Distortion::DoubleSphere { xi, alpha };
        let camera = with_unit_focal_length(distortion);
        let step = 1e-3;
        let is_refused = |radius: &f64| camera.project(&Vector3::new(*radius, 0.0, 1.0)).is_err();
        let radii = (1..20_000).map(|k| f64::from(k) * step);
        let limit = radii.clone().find(is_refused).unwrap_or(f64::INFINITY);
        let value = |radius: f64| distortion.distort(&Vector2::new(radius, 0.0)).x;
        let falls = |radius: &f64| value(*radius) < 0.0 || value(*radius) < value(*radius - step);
        let turn = radii.clone().find(falls).unwrap_or(f64::INFINITY);
        assert!((limit - turn).abs() < 1.5 * step, "{xi} {alpha}: {limit}, falls at {turn}");
        assert!(limit < 10.0, "{xi} {alpha}: {limit}");
        assert!(radii.skip_while(|radius| *radius < limit).all(|radius| is_refused(&radius)));
    }
}

#[test]
fn models_contain_each_other() {
    let mut random = Random::new(14);
    for _ in 0..200 {
        let ray = random.normal_vector::<2>() * 0.5;
        let four = [0.1, -0.05, 1e-3, -2e-3];
        let mut twelve = [0.0; 12];
        twelve[..4].copy_from_slice(&four);
        let xi = random.uniform(0.0, 2.0);
        // The unified model with its parameter alpha is the omnidirectional one with xi = alpha / (1 - alpha), scaled.
        let alpha = xi / (1.0 + xi);
        let unified = Distortion::Eucm { alpha, beta: 1.0 }.distort(&ray);
        let mei = Distortion::Omni { xi, distortion: [0.0; 4] }.distort(&ray);
        assert!((unified - mei * (1.0 + xi)).amax() < 1e-12);
        let sphere = Distortion::DoubleSphere { xi: 0.0, alpha }.distort(&ray);
        assert!((sphere - unified).amax() < 1e-12);
        for (a, b) in [
            (Distortion::RadialTangential(four), Distortion::Rational(twelve)),
            (Distortion::RadialTangential(four), Distortion::Omni { xi: 0.0, distortion: four }),
            (Distortion::None, Distortion::Eucm { alpha: 0.0, beta: 1.3 }),
            (
                Distortion::Equidistant([0.01, -0.02, 0.003, 1e-3]),
                Distortion::ThinPrismFisheye([0.01, -0.02, 0.0, 0.0, 0.003, 1e-3, 0.0, 0.0]),
            ),
        ] {
            let (a, b) = (a.distort_with_jacobian(&ray), b.distort_with_jacobian(&ray));
            assert!((a.0 - b.0).amax() < 1e-12 && (a.1 - b.1).amax() < 1e-12, "{a:?} {b:?}");
        }
    }
}

#[test]
fn the_simplest_model_that_says_the_same_is_taken() {
    let four = [-0.3, 0.1, 1e-3, 2e-3];
    for count in [4, 5, 8, 12] {
        let mut k = vec![0.0; count];
        k[..4].copy_from_slice(&four);
        assert_eq!(Distortion::from_opencv(&k), Some(Distortion::RadialTangential(four)));
        if count > 4 {
            k[count - 1] = 0.01;
            let full = Distortion::from_opencv(&k).unwrap();
            assert_eq!((full.coefficients(), full.name()), (k.clone(), "radial-tangential"));
        }
    }
    assert!([0, 3, 6, 14].iter().all(|&count| Distortion::from_opencv(&vec![0.1; count]).is_none()));
    assert_eq!(webcam().distortion.coefficients().len(), 5);
    assert_eq!(time_of_flight().distortion.coefficients().len(), 8);
}

#[test]
fn the_whole_image_of_each_camera_is_undone() {
    for camera in cameras() {
        let (mut seen, mut refused) = (0, 0);
        for u in (0..=camera.width).step_by(16) {
            for v in (0..=camera.height).step_by(16) {
                let pixel = Vector2::new(f64::from(u) - 0.5, f64::from(v) - 0.5);
                let Ok(ray) = camera.bearing(&pixel) else {
                    refused += 1;
                    continue;
                };
                seen += 1;
                let back = camera.project(&(ray.into_inner() * 7.0)).unwrap();
                assert!((back - pixel).norm() < 1e-8, "{camera:?} {pixel}: {back}");
            }
        }
        println!("{}: {seen} seen, {refused} refused", camera.distortion.name());
        assert!(seen > 5 * refused, "{camera:?}: {seen} seen, {refused} refused");
    }
}
