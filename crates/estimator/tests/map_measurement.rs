//! Rows of the map's observation: their Jacobians, their gauge, and what moving the linearization point does.

use estimator::calibration::{Calibration, OnlineCalibration};
use estimator::covariance::JointCovariance;
use estimator::map_update::map_measurement::{
    Linearization, LinearizationPoint, MapMeasurementSettings, linearize_landmark,
};
use estimator::measurement::{Information, StateBlocks};
use estimator::state::retract_locally;
use estimator::{CalibratedCamera, MapAnswer, MapKeyframe, MatchedLandmark};
use geometry::numeric::numeric_jacobian;
use geometry::{Camera, Distortion, Pose, PoseWithCovariance, rotation};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Matrix6xX, Rotation3, Vector2, Vector3, Vector6};
use rand::{RngExt as _, SeedableRng, rngs::StdRng};

const KEYFRAMES: [u64; 3] = [40, 7, 12];
const SETTINGS: MapMeasurementSettings =
    MapMeasurementSettings { sigma_match_px: 1.5, sigma_map_px: 0.8, map_is_exact: false };

fn camera() -> Camera {
    Camera {
        width: 752,
        height: 480,
        focal: [458.0, 457.0],
        centre: [367.0, 248.0],
        distortion: Distortion::RadialTangential([-0.28, 0.07, 2e-4, 2e-5]),
    }
}

/// A camera that looks along the body's x axis, with a small turn and a lever.
fn calibrated() -> CalibratedCamera {
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let turn = rotation::exp(&Vector3::new(0.02, -0.03, 0.01));
    let rotation = turn * geometry::Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    CalibratedCamera::new(camera(), Pose::new(rotation, Vector3::new(0.1, 0.05, -0.02)))
}

/// One image, three keyframes that look the same way, and landmarks before all of them.
struct Scene {
    truth: LinearizationPoint,
    answer: MapAnswer,
}

fn scene(count: usize, pixel_noise: f64) -> Scene {
    let mut rng = StdRng::seed_from_u64(3);
    let global_from_local =
        Pose::new(rotation::exp(&Vector3::new(0.3, -0.2, 2.0)), Vector3::new(20.0, -8.0, 3.0));
    let local_from_imu =
        Pose::new(rotation::exp(&Vector3::new(0.1, -0.05, 0.4)), Vector3::new(5.0, 2.0, 1.0));
    let truth = LinearizationPoint { local_from_imu, global_from_local };
    let global_from_camera = global_from_local * local_from_imu * calibrated().imu_from_camera;
    let offsets = [[0.9, -0.2, -1.0], [-0.8, 0.4, -0.5], [0.2, 0.5, -2.0]].map(Vector3::from);
    let poses = offsets.map(|offset| global_from_camera * Pose::new(rotation::exp(&(0.05 * offset)), offset));
    let keyframes = std::iter::zip(KEYFRAMES, poses).map(|(id, pose)| MapKeyframe {
        id,
        global_from_keyframe: PoseWithCovariance::new(pose, Matrix6::identity() * 1e-6),
        camera: camera(),
        common_error: Matrix6xX::zeros(0),
        cross_covariances: Vec::new(),
    });
    let keyframes: Vec<MapKeyframe> = keyframes.collect();
    let landmarks = (0..count).map(|k| {
        let mut draw = |low: f64, high: f64| rng.random_range(low..high);
        let in_camera = Vector3::new(draw(-2.0, 2.0), draw(-1.2, 1.2), draw(4.0, 9.0));
        let in_global = global_from_camera.transform(&in_camera);
        let mut noisy =
            |pixel: Vector2<f64>| pixel + Vector2::new(draw(-1.0, 1.0), draw(-1.0, 1.0)) * pixel_noise;
        let see = |pose: &Pose| camera().project(&pose.inverse_transform(&in_global)).unwrap();
        let anchor = k % 3;
        MatchedLandmark {
            pixel: noisy(see(&global_from_camera)),
            anchor: KEYFRAMES[anchor],
            position_in_anchor: poses[anchor].inverse_transform(&in_global),
            observations: (0..3).map(|j| (KEYFRAMES[j], noisy(see(&poses[j])))).collect(),
        }
    });
    let landmarks = landmarks.collect();
    Scene {
        truth,
        answer: MapAnswer {
            held_at_query: Vec::new(),
            map_version: 1,
            map_identity: 1,
            camera: 0,
            keyframes,
            landmarks,
            gravity_in_global: None,
            sigma_map_px: 1.0,
            log_odds: 10.0,
            log_prior_odds: 0.0,
        },
    }
}

fn rows(
    scene: &Scene,
    landmark: usize,
    point: &Linearization,
    settings: &MapMeasurementSettings,
) -> (DMatrix<f64>, DVector<f64>) {
    let poses = |id| scene.answer.keyframe(id).map(|keyframe| keyframe.global_from_keyframe.pose);
    linearize_landmark(
        &scene.answer.landmarks[landmark],
        &scene.answer,
        &KEYFRAMES,
        &poses,
        &Calibration::new(vec![calibrated()], 0.0, OnlineCalibration::default()),
        point,
        settings,
    )
    .unwrap()
}

fn part(error: &DVector<f64>, begin: usize) -> Vector6<f64> {
    error.fixed_rows::<6>(begin).into()
}

fn moved(point: &LinearizationPoint, error: &DVector<f64>) -> LinearizationPoint {
    LinearizationPoint {
        local_from_imu: point.local_from_imu.retract(&part(error, 0)),
        global_from_local: retract_locally(&point.global_from_local, &part(error, 6)),
    }
}

/// The paper's equations, written down a second time: whitened pixels as a function of
/// `[clone, transform, keyframes, landmark]`.
fn pixels(scene: &Scene, landmark: usize, from: &LinearizationPoint, error: &DVector<f64>) -> DVector<f64> {
    let landmark = &scene.answer.landmarks[landmark];
    let point = moved(from, error);
    let pose = |id: u64| {
        let place = KEYFRAMES.iter().position(|held| *held == id).unwrap();
        let pose = scene.answer.keyframe(id).unwrap().global_from_keyframe.pose;
        pose.retract(&part(error, 12 + 6 * place))
    };
    let position = landmark.position_in_anchor + error.fixed_rows::<3>(30);
    let in_global = pose(landmark.anchor).transform(&position);
    let in_camera = (point.global_from_local * point.local_from_imu * calibrated().imu_from_camera)
        .inverse_transform(&in_global);
    let mut stacked: Vec<f64> = Vec::new();
    stacked.extend((camera().project(&in_camera).unwrap() / SETTINGS.sigma_match_px).iter());
    for (id, _) in &landmark.observations {
        let pixel = camera().project(&pose(*id).inverse_transform(&in_global)).unwrap();
        stacked.extend((pixel / SETTINGS.sigma_map_px).iter());
    }
    DVector::from_vec(stacked)
}

fn measured(landmark: &MatchedLandmark) -> DVector<f64> {
    let mut stacked: Vec<f64> = (landmark.pixel / SETTINGS.sigma_match_px).iter().copied().collect();
    for (_, pixel) in &landmark.observations {
        stacked.extend((pixel / SETTINGS.sigma_map_px).iter());
    }
    DVector::from_vec(stacked)
}

fn step(scale: f64) -> DVector<f64> {
    let direction = [0.5, -0.3, 1.0, 0.4, -0.8, 0.6, -0.4, 0.7, 0.9, -0.5, 0.3, 0.8];
    DVector::from_row_slice(&direction) * scale
}

#[test]
fn the_rows_are_the_derivative_of_the_paper_s_equations_with_the_landmark_eliminated() {
    let scene = scene(6, 1.0);
    // At the estimate, and at a linearization point that is a quarter of a radian away from it.
    for scale in [0.0, 0.25] {
        let at = scene.truth;
        let mut away = DVector::zeros(33);
        away.rows_mut(0, 12).copy_from(&step(scale));
        // The estimate from which `away` leads to the linearization point.
        let back = |pose: &Pose, error: Vector6<f64>| Pose {
            rotation: rotation::exp(&error.fixed_rows::<3>(0).into_owned()).inverse() * pose.rotation,
            translation: pose.translation - error.fixed_rows::<3>(3),
        };
        let back_locally = |pose: &Pose, error: Vector6<f64>| {
            let rotation = pose.rotation * rotation::exp(&error.fixed_rows::<3>(0).into_owned()).inverse();
            let translation = pose.translation - rotation * error.fixed_rows::<3>(3).into_owned();
            Pose::new(rotation, translation)
        };
        let estimate = LinearizationPoint {
            local_from_imu: back(&at.local_from_imu, part(&away, 0)),
            global_from_local: back_locally(&at.global_from_local, part(&away, 6)),
        };
        for k in 0..6 {
            let (jacobian, residual) =
                rows(&scene, k, &Linearization { estimate, at, first_position: None }, &SETTINGS);
            let numeric = numeric_jacobian(33, |error| pixels(&scene, k, &estimate, &(&away + error)));
            let (wrt_state, wrt_landmark) = (numeric.columns(0, 30), numeric.columns(30, 3));
            let followed = measured(&scene.answer.landmarks[k]) - pixels(&scene, k, &estimate, &away)
                + numeric.columns(0, 12) * step(scale);
            let inverse = (wrt_landmark.transpose() * wrt_landmark).try_inverse().unwrap();
            let hat = DMatrix::identity(8, 8) - wrt_landmark * inverse * wrt_landmark.transpose();
            let matrix = wrt_state.transpose() * &hat * wrt_state;
            let vector = wrt_state.transpose() * hat * followed;
            assert_eq!(jacobian.shape(), (5, 30));
            let scale = matrix.amax();
            assert!((jacobian.tr_mul(&jacobian) - matrix).amax() < 1e-8 * scale, "landmark {k}");
            assert!((jacobian.tr_mul(&residual) - vector).amax() < 1e-8 * scale, "residual of landmark {k}");
        }
    }
}

/// L turned about its z and moved, with `G_T_L` the other way: columns over `[clone, transform]`.
fn gauge(position: &Vector3<f64>) -> DMatrix<f64> {
    let mut directions = DMatrix::zeros(12, 4);
    let up = Vector3::z();
    directions.fixed_view_mut::<3, 1>(0, 0).copy_from(&up);
    directions.fixed_view_mut::<3, 1>(3, 0).copy_from(&up.cross(position));
    directions.fixed_view_mut::<3, 1>(6, 0).copy_from(&-up);
    directions.fixed_view_mut::<3, 3>(3, 1).fill_with_identity();
    directions.fixed_view_mut::<3, 3>(9, 1).copy_from(&-Matrix3::identity());
    directions
}

#[test]
fn turning_and_moving_local_about_gravity_is_invisible_to_the_map() {
    let scene = scene(6, 1.0);
    // Also where the clone was first believed to be elsewhere.
    let first = scene.truth.local_from_imu.translation + Vector3::new(0.05, -0.1, 0.02);
    let point = Linearization { estimate: scene.truth, at: scene.truth, first_position: Some(first) };
    for k in 0..6 {
        for settings in [SETTINGS, MapMeasurementSettings { map_is_exact: true, ..SETTINGS }] {
            let (jacobian, _) = rows(&scene, k, &point, &settings);
            let seen = jacobian.columns(0, 12) * gauge(&first);
            assert!(seen.amax() < 1e-11 * jacobian.amax(), "landmark {k}: {}", seen.amax());
        }
    }
}

#[test]
fn the_depth_of_a_landmark_carries_no_information() {
    let mut scene = scene(6, 0.0);
    let point = Linearization { estimate: scene.truth, at: scene.truth, first_position: None };
    let original = scene.answer.clone();
    let change = |scene: &mut Scene, k: usize, scale: f64| {
        scene.answer = original.clone();
        scene.answer.landmarks[k].position_in_anchor *= 1.0 + scale;
        rows(scene, k, &point, &SETTINGS).1.norm()
    };
    for k in 0..6 {
        // Of second order: half the change leaves a quarter of the residual, and little to begin with.
        let (large, small) = (change(&mut scene, k, 0.02), change(&mut scene, k, 0.01));
        assert!((3.5..4.5).contains(&(large / small)), "landmark {k}: {large} {small}");
        let moved = scene.answer.landmarks[k].position_in_anchor.norm();
        assert!(moved > 0.0 && large < 0.2, "landmark {k}: {large}");
    }
}

#[test]
fn a_map_taken_for_exact_has_two_rows_a_landmark_and_no_keyframe_columns() {
    let scene = scene(2, 1.0);
    let point = Linearization { estimate: scene.truth, at: scene.truth, first_position: None };
    let (jacobian, residual) =
        rows(&scene, 0, &point, &MapMeasurementSettings { map_is_exact: true, ..SETTINGS });
    assert_eq!((jacobian.shape(), residual.len()), ((2, 12), 2));
    let numeric = numeric_jacobian(33, |error| pixels(&scene, 0, &scene.truth, error));
    assert!((jacobian - numeric.view((0, 0), (2, 12))).amax() < 1e-6);
}

#[test]
fn one_keyframe_leaves_one_row_and_each_further_one_adds_two() {
    let mut scene = scene(1, 1.0);
    let point = Linearization { estimate: scene.truth, at: scene.truth, first_position: None };
    for (seen, left) in [(3, 5), (2, 3), (1, 1)] {
        scene.answer.landmarks[0].observations.truncate(seen);
        assert_eq!(rows(&scene, 0, &point, &SETTINGS).1.len(), left);
    }
}

/// Rotation error of `G_T_L` (rad) after one update linearized at `at`.
fn error_after(scene: &Scene, estimate: LinearizationPoint, at: LinearizationPoint) -> f64 {
    let mut covariance = DMatrix::identity(12, 12) * 1e-6;
    covariance.view_mut((6, 6), (6, 6)).fill_diagonal(4.0);
    let mut joint = JointCovariance::new(covariance, 8);
    let slots = scene.answer.keyframes.iter().map(|keyframe| {
        let none = Matrix6xX::zeros(0);
        joint.held.activate_or_insert(keyframe.id, &keyframe.global_from_keyframe, &none, &[])
    });
    let slots: Vec<usize> = slots.collect();
    let mut information =
        Information::new(StateBlocks { keyframes: slots, ..StateBlocks::of_active(std::iter::once(0..12)) });
    for k in 0..scene.answer.landmarks.len() {
        let (jacobian, residual) =
            rows(scene, k, &Linearization { estimate, at, first_position: None }, &SETTINGS);
        information.add(&jacobian, &residual);
    }
    let mut correction = DVector::zeros(0);
    joint.information_update(&information, &mut correction).unwrap();
    let updated = moved(&estimate, &correction);
    scene.truth.global_from_local.local(&updated.global_from_local).fixed_rows::<3>(0).norm()
}

#[test]
fn an_update_at_a_better_point_whose_residual_follows_lands_nearer_to_the_truth() {
    let scene = scene(40, 0.5);
    // The transform is off by 0.25 rad; the better point, as PnP finds it, by 0.01 rad.
    let off = |scale: f64| {
        let mut error = DVector::zeros(12);
        error.rows_mut(6, 6).copy_from(&(Vector6::new(0.3, -0.5, 0.8, 0.5, -0.4, 0.3) * scale));
        moved(&scene.truth, &error)
    };
    let (estimate, better) = (off(0.25), off(0.01));
    let (plain, followed) = (error_after(&scene, estimate, estimate), error_after(&scene, estimate, better));
    assert!(followed < 5e-3 && followed < 0.2 * plain, "plain {plain}, followed {followed}");
}
