//! Frames, covariances and maps of models whose truth is known.

use super::covariance::{Point, View, covariance};
use super::frame::{ColmapFrame, Gravity, stamp_images, stamp_ns};
use crate::error::BuildError;
use estimator::EstimatorConfig;
use geometry::camera::{Camera, Distortion};
use geometry::{Pose, rotation};
use map_io::colmap::{ColmapImage, ColmapModel};
use nalgebra::{DMatrix, UnitQuaternion, Vector2, Vector3, Vector6};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use sensors::{Frame, Sequence};
use simulation::{SimulationOptions, simulate};

/// Metres in the unit of length of the models.
const SCALE: f64 = 0.4;
const SIGMA_PX: f64 = 0.7;

fn camera() -> Camera {
    let distortion = Distortion::RadialTangential([-0.28, 0.07, 2e-4, 2e-5]);
    Camera { width: 752, height: 480, focal: [458.0, 457.0], centre: [367.0, 248.0], distortion }
}

/// Five views of thirty points.
fn scene() -> (Vec<View>, Vec<Point>) {
    let mut rng = StdRng::seed_from_u64(7);
    let mut uniform = |half: f64| rng.random_range(-half..half);
    let view = |index: usize| {
        let turn = Vector3::from_fn(|_, _| uniform(0.1));
        let position = Vector3::new(0.4 * index as f64, uniform(0.1), uniform(0.1));
        View { camera: camera(), pose: Pose::new(rotation::exp(&turn), position) }
    };
    let views: Vec<View> = (0..5).map(view).collect();
    let point = |id: u64| {
        let position = Vector3::new(0.8 + uniform(1.5), uniform(1.0), 4.0 + uniform(1.0));
        let pixel = |(index, view): (usize, &View)| {
            (index, 0, view.camera.project(&view.pose.inverse_transform(&position)).unwrap())
        };
        Point { id, position, seen: views.iter().enumerate().map(pixel).collect() }
    };
    let points = (0..30).map(point).collect();
    (views, points)
}

fn frame() -> ColmapFrame {
    let in_global = Vector3::new(0.1, 0.9, -0.3).normalize();
    ColmapFrame {
        scale: 1.0,
        sigma_scale: 0.02,
        global_from_model: UnitQuaternion::identity(),
        gravity: Some(Gravity { in_global, sigma_rad: 0.01 }),
    }
}

/// Residuals in standard deviations, as a function of the error of all poses, then points.
fn whitened(views: &[View], points: &[Point], error: &[f64]) -> Vec<f64> {
    let moved: Vec<Pose> = views
        .iter()
        .zip(error.chunks(6))
        .map(|(view, error)| view.pose.retract(&Vector6::from_column_slice(error)))
        .collect();
    let mut residuals = Vec::new();
    for (point, error) in points.iter().zip(error[6 * views.len()..].chunks(3)) {
        let position = point.position + Vector3::from_column_slice(error);
        for (view, _, pixel) in &point.seen {
            let at = views[*view].camera.project(&moved[*view].inverse_transform(&position)).unwrap();
            residuals.extend(((at - pixel) / SIGMA_PX).iter());
        }
        // The weak prior of the inverse depth in the middle view.
        let middle = point.seen[point.seen.len() / 2].0;
        let depth = |pose: &Pose, position: &Vector3<f64>| pose.inverse_transform(position).z;
        let stated = depth(&views[middle].pose, &point.position);
        residuals.push(depth(&moved[middle], &position).recip() - stated.recip());
    }
    // The frame: position and yaw of the first view, its tilt, and the distance between the outermost views.
    let frame = frame();
    let gravity = frame.gravity.unwrap();
    let first = Vector6::from_column_slice(&error[..6]);
    let (turn, moved_by) = (Vector3::from(first.fixed_rows::<3>(0)), Vector3::from(first.fixed_rows::<3>(3)));
    let along = turn.dot(&gravity.in_global);
    let tilt = turn - gravity.in_global * along;
    residuals.push(along / 1e-4);
    residuals.extend((tilt / gravity.sigma_rad).iter());
    residuals.extend((moved_by / 1e-3).iter());
    let distance = |poses: [&Pose; 2]| (poses[1].translation - poses[0].translation).norm();
    let stated = distance([&views[0].pose, &views[4].pose]);
    residuals.push((distance([&moved[0], &moved[4]]) - stated) / (0.02 * stated));
    residuals
}

#[test]
fn the_covariance_is_that_of_the_dense_problem_with_numeric_derivatives() {
    let (views, points) = scene();
    let joint = covariance(&views, &points, &frame(), SIGMA_PX, |_, _| {}).unwrap();
    let dim = 6 * views.len() + 3 * points.len();
    let mut columns = Vec::new();
    for index in 0..dim {
        let moved = |step: f64| {
            let mut error = vec![0.0; dim];
            error[index] = step;
            nalgebra::DVector::from_vec(whitened(&views, &points, &error))
        };
        columns.push((moved(1e-6) - moved(-1e-6)) / 2e-6);
    }
    let jacobian = DMatrix::from_columns(&columns);
    let dense = jacobian.tr_mul(&jacobian).try_inverse().unwrap();
    let near = |stated: &nalgebra::Matrix6<f64>, a: usize, b: usize| {
        let expected = dense.view((6 * a, 6 * b), (6, 6));
        let error = (stated - expected).norm() / expected.norm();
        assert!(error < 1e-4, "views {a} and {b}: {error}");
    };
    for (view, own) in &joint.own {
        near(own, *view, *view);
    }
    assert_eq!(joint.cross.len(), 10);
    for (a, b, block) in &joint.cross {
        near(block, *a, *b);
    }
}

/// A camera that only turns sees no depth at all: what its images say of its rotation stays, and nothing of its position is invented.
#[test]
fn points_without_parallax_tell_the_rotation_and_no_position() {
    let (mut views, mut points) = scene();
    let at = views[0].pose.translation;
    // Three views at one place, and two that see the points from elsewhere.
    views[1].pose.translation = at;
    views[2].pose.translation = at;
    for point in &mut points {
        point.position += (point.position - at) * 200.0;
        for (view, _, pixel) in &mut point.seen {
            let View { camera, pose } = &views[*view];
            *pixel = camera.project(&pose.inverse_transform(&point.position)).unwrap();
        }
        point.seen.truncate(3);
    }
    let joint = covariance(&views[..3], &points, &frame(), SIGMA_PX, |_, _| {});
    let Some(joint) = joint else { panic!("the weak prior of the depth leaves the poses determined") };
    let of_last = joint.own[&2];
    let sigmas = of_last.diagonal().map(f64::sqrt);
    let tilt = frame().gravity.unwrap().sigma_rad;
    assert!(sigmas.fixed_rows::<3>(0).max() < 2.0 * tilt, "{sigmas}");
    assert!(sigmas.fixed_rows::<3>(3).min() > 0.1, "{sigmas}");
}

/// A model of a recording's images at its true poses, in a frame and unit of length of its own.
fn model_of(sequence: &Sequence, stereo: bool) -> ColmapModel {
    let turned = Pose::new(rotation::exp(&Vector3::new(0.8, -1.1, 0.4)), Vector3::new(3.0, -2.0, 5.0));
    let mut model = ColmapModel::default();
    let truth = sequence.groundtruth.as_ref().unwrap();
    for row in truth.iter().step_by(truth.len() / 20) {
        for (index, sensor) in sequence.cameras[..if stereo { 2 } else { 1 }].iter().enumerate() {
            let Pose { rotation, translation } = turned.compose(&row.pose).compose(&sensor.imu_from_camera);
            let image = ColmapImage {
                name: format!("cam{index}/{}.png", row.stamp_ns),
                stamp_ns: None,
                camera: index as u32,
                world_from_camera: Pose::new(rotation, translation / SCALE),
                pixels: Vec::new(),
            };
            model.cameras.insert(index as u32, sensor.camera.clone());
            model.images.insert(model.images.len() as u32 + 1, image);
        }
    }
    model
}

#[test]
fn a_recording_gives_scale_and_gravity() {
    let options = SimulationOptions { duration_s: Some(30.0), ..SimulationOptions::default() };
    let sequence = simulate(&options).unwrap().live;
    let config = EstimatorConfig::default();
    let model = model_of(&sequence, true);
    let frame = ColmapFrame::of_recording(&model, &sequence, None, &config).unwrap();
    assert!((frame.scale / SCALE - 1.0).abs() < 1e-6, "{}", frame.scale);
    let gravity = frame.gravity.as_ref().unwrap();
    assert!(gravity.sigma_rad < 0.02, "{}", gravity.sigma_rad);
    // In G, verticals are vertical and distances are metric.
    let truth = sequence.groundtruth.as_ref().unwrap();
    for (image, row) in model.images.values().step_by(2).zip(truth.iter().step_by(truth.len() / 20)) {
        let pose = frame.pose(&image.world_from_camera);
        let true_pose = row.pose.compose(&sequence.cameras[0].imu_from_camera);
        let up = |pose: &Pose| pose.rotation.inverse() * Vector3::z();
        assert!(up(&pose).angle(&up(&true_pose)) < 0.02);
    }
    let mono = model_of(&sequence, false);
    let by_imu = ColmapFrame::of_recording(&mono, &sequence, None, &config).unwrap();
    assert!((by_imu.scale / SCALE - 1.0).abs() < 3.0 * by_imu.sigma_scale, "{by_imu:?}");
    assert!(by_imu.sigma_scale >= crate::joint_covariance::SCALE_SIGMA);
    let told = ColmapFrame::of_recording(&mono, &sequence, Some((SCALE, 0.01)), &config).unwrap();
    assert_eq!((told.scale, told.sigma_scale), (SCALE, 0.01));
}

/// The camera's clock is 0.3 s behind, so that the recording adds as much to the stamps of its frames, and names have none of it.
#[test]
fn images_of_a_recording_with_an_offset_of_the_clocks_have_the_times_of_its_frames() {
    const OFFSET_NS: i64 = 300_000_000;
    let options = SimulationOptions { duration_s: Some(30.0), ..SimulationOptions::default() };
    let mut sequence = simulate(&options).unwrap().live;
    let config = EstimatorConfig::default();
    let mut model = model_of(&sequence, true);
    let expected = ColmapFrame::of_recording(&model, &sequence, None, &config).unwrap();
    let truth = sequence.groundtruth.as_ref().unwrap();
    let times: Vec<i64> = truth.iter().step_by(truth.len() / 20).flat_map(|row| [row.stamp_ns; 2]).collect();
    // All images are frames, and all frames are images.
    sequence.frames =
        times.iter().step_by(2).map(|&stamp_ns| Frame { stamp_ns, ..Frame::default() }).collect();
    let of_times = |model: &ColmapModel| {
        model.images.values().map(|image| image.stamp_ns).eq(times.iter().copied().map(Some))
    };
    // Names that are times of frames as they are stay, whatever the offset.
    stamp_images(&mut model, &sequence, OFFSET_NS);
    assert!(of_times(&model));
    for (image, stamp_ns) in model.images.values_mut().zip(&times) {
        image.name = format!("cam{}/{}.png", image.camera, stamp_ns - OFFSET_NS);
    }
    stamp_images(&mut model, &sequence, OFFSET_NS);
    assert!(of_times(&model));
    let found = ColmapFrame::of_recording(&model, &sequence, None, &config).unwrap();
    assert_eq!(found, expected);
    // Images that are none of the recording's keep what their names say.
    let first = model.images.values_mut().next().unwrap();
    first.name = String::from("cam0/77777777777.png");
    stamp_images(&mut model, &sequence, OFFSET_NS);
    let first = model.images.values().next().unwrap();
    assert_eq!((first.stamp_ns, stamp_ns(first)), (None, Some(77_777_777_777)));
}

#[test]
fn a_stated_direction_of_gravity_points_down_in_the_map() {
    let pose = Pose::new(UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3), Vector3::new(1.0, -2.0, 3.0));
    for gravity in [Vector3::y(), -Vector3::z(), Vector3::z(), Vector3::new(0.6, 0.0, -0.8)] {
        let frame = ColmapFrame::given(SCALE, 0.01, Some(gravity));
        assert_eq!(frame.gravity.as_ref().unwrap().in_global, -Vector3::z());
        // What a camera sees of it is the same.
        let in_camera = frame.pose(&pose).rotation.inverse() * -Vector3::z();
        assert!((in_camera - pose.rotation.inverse() * gravity).norm() < 1e-12, "{gravity}");
    }
    assert!(ColmapFrame::given(SCALE, 0.01, None).gravity.is_none());
}

#[test]
fn points_that_do_not_fit_are_left_out_and_images_of_another_size_are_named() {
    let (views, points) = scene();
    let mut model = ColmapModel::default();
    model.cameras.insert(1, camera());
    for (index, view) in views.iter().enumerate() {
        let pixel = |point: &Point| map_io::colmap::ColmapPixel {
            pixel: (point.seen[index].2 + Vector2::new(if point.id == 3 { 30.0 } else { 0.0 }, 0.0)).into(),
            point: point.id,
        };
        let image = ColmapImage {
            name: format!("{index}.png"),
            stamp_ns: None,
            camera: 1,
            world_from_camera: view.pose,
            pixels: points.iter().map(pixel).collect(),
        };
        model.images.insert(index as u32, image);
    }
    model.points = points.iter().map(|point| (point.id, point.position)).collect();
    let mut extractor = vision::features::open("sift-1", None).unwrap();
    let mut import = |size: [usize; 2], read: bool| {
        let image = |_: &str| {
            if !read {
                return vision::GrayImage::read(std::path::Path::new("none.png"));
            }
            Ok(vision::GrayImage::from_fn(size[0], size[1], |x, y| ((x * 7 + y * 13) % 251) as u8))
        };
        let mut extraction = few_features(extractor.as_mut());
        super::import_colmap(&model, &frame(), image, &mut extraction, ["hall", "test"], &mut |_, _, _| {})
    };
    let error = import([640, 400], true).unwrap_err();
    assert!(matches!(&error, BuildError::ColmapImageSize { image, .. } if image == "0.png"), "{error}");
    let error = import([752, 480], false).unwrap_err();
    assert!(matches!(error, BuildError::NoDescribedPoints { unreadable: 5 }), "{error}");
}

fn few_features(extractor: &mut dyn vision::FeatureExtractor) -> crate::Extraction<'_> {
    crate::Extraction { extractor, others: &mut [], max_features: 50, masks: &[], cameras: 1 }
}

#[test]
fn images_that_share_no_points_are_named() {
    let mut model = ColmapModel::default();
    model.cameras.insert(1, camera());
    for id in 1..3 {
        let name = format!("{id}.png");
        let (camera, world_from_camera) = (1, Pose::identity());
        let image = ColmapImage { name, stamp_ns: None, camera, world_from_camera, pixels: Vec::new() };
        model.images.insert(id, image);
    }
    let mut extractor = vision::features::open("sift-1", None).unwrap();
    let mut extraction = few_features(extractor.as_mut());
    let read = |_: &str| Ok(vision::GrayImage::from_fn(752, 480, |_, _| 0));
    let names = ["hall", "test"];
    let error = super::import_colmap(&model, &frame(), read, &mut extraction, names, &mut |_, _, _| {});
    assert!(matches!(&error, Err(BuildError::ColmapUndetermined { points: 0, .. })), "{error:?}");
}
