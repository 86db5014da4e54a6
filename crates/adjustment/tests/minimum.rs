//! Steps with and without damping end at the minimum, and the covariance is that of the dense equations.

use adjustment::{Bundle, Loss, POSE, PixelModel, PosePrior, Problem};
use nalgebra::{DMatrix, DVector, Matrix6};

use crate::scene::{SIGMA_PX, Scene, pixel_model};

/// Priors that hold the first pose, and the scale by the position of the last one.
fn priors(scene: &Scene) -> Vec<PosePrior> {
    let weak = Matrix6::identity() * 1e-2;
    let prior = |(view, pose)| {
        let is_held = view == 0 || view + 1 == scene.poses.len();
        PosePrior { view, pose, information: if is_held { Matrix6::identity() * 1e8 } else { weak } }
    };
    scene.poses.iter().copied().enumerate().map(prior).collect()
}

/// Poses and landmarks away from the truth.
fn displaced(scene: &Scene) -> Bundle {
    let layout = Bundle { poses: scene.poses.clone(), ..Bundle::default() };
    let error = |index: usize| if index < POSE { 0.0 } else { 0.02 * (index as f64 * 1.7).sin() };
    let mut bundle = layout.moved(&DVector::from_fn(layout.layout().dim(), |index, _| error(index)));
    bundle.landmarks.clone_from(&scene.landmarks);
    for (index, landmark) in bundle.landmarks.iter_mut().enumerate() {
        landmark.inverse_depth *= 1.0 + 0.2 * (index as f64).sin();
    }
    bundle
}

#[test]
fn exact_pixels_give_the_exact_poses_with_each_loss_and_with_steps_of_landmarks() {
    for (loss, scales, landmark_steps) in
        [(Loss::Cauchy, [16.0, 3.0], 0), (Loss::Huber, [2.0; 2], 3), (Loss::Huber, [f64::INFINITY; 2], 0)]
    {
        let scene = Scene::new(1, 4, 40);
        let priors = priors(&scene);
        let pixels = PixelModel { landmark_steps, ..pixel_model(loss) };
        let problem = Problem { cameras: &scene.cameras, factors: vec![&priors], pixels };
        let found = problem.minimize(displaced(&scene), scales, |_, _| ());
        let undamped = problem.minimize_undamped(displaced(&scene), scales[1]);
        let poses = found.poses.iter().zip(&scene.poses).chain(undamped.poses.iter().zip(&scene.poses));
        for (found, truth) in poses {
            assert!(truth.local(found).norm() < 1e-3, "{loss:?}: {}", truth.local(found).norm());
        }
    }
}

#[test]
fn outliers_do_not_move_a_bundle_with_a_robust_loss() {
    let mut scene = Scene::new(2, 4, 40);
    for landmark in scene.landmarks.iter_mut().step_by(5) {
        let index = (landmark.anchor + 3) % landmark.observations.len();
        landmark.observations[index].pixel.x += 60.0 * SIGMA_PX;
    }
    let priors = priors(&scene);
    let problem =
        Problem { cameras: &scene.cameras, factors: vec![&priors], pixels: pixel_model(Loss::Cauchy) };
    let error = |scales| {
        let found = problem.minimize(displaced(&scene), scales, |_, _| ());
        found
            .poses
            .iter()
            .zip(&scene.poses)
            .map(|(found, truth)| truth.local(found).norm())
            .fold(0.0, f64::max)
    };
    let (robust, square) = (error([16.0, 3.0]), error([1e3, 1e3]));
    assert!(robust < 0.1 * square, "{robust} {square}");
}

#[test]
fn the_covariance_is_the_inverse_of_the_dense_information_of_states_and_landmarks() {
    let scene = Scene::new(3, 3, 12);
    let priors = priors(&scene);
    let pixels = pixel_model(Loss::Huber);
    let problem = Problem { cameras: &scene.cameras, factors: vec![&priors], pixels };
    let (views, count) = (scene.poses.len(), scene.landmarks.len());
    let bundle =
        Bundle { poses: scene.poses.clone(), motions: Vec::new(), landmarks: scene.landmarks.clone() };
    let mut full = DMatrix::<f64>::zeros(POSE * views + 3 * count, POSE * views + 3 * count);
    for PosePrior { view, information, .. } in &priors {
        full.fixed_view_mut::<6, 6>(POSE * view, POSE * view).copy_from(information);
    }
    let poses = bundle.view_poses();
    for (at, landmark) in scene.landmarks.iter().enumerate() {
        let begin = POSE * views + 3 * at;
        full[(begin + 2, begin + 2)] += pixels.depth_information;
        for (index, observation) in landmark.observations.iter().enumerate() {
            let predicted = landmark.predict(&scene.cameras, &poses, index).unwrap();
            let mut row = DMatrix::<f64>::zeros(2, full.ncols());
            for (view, block) in
                [(landmark.anchor_view(), predicted.by_anchor), (observation.view(), predicted.by_view)]
            {
                let mut columns = row.fixed_columns_mut::<6>(POSE * view);
                columns += block;
            }
            row.fixed_columns_mut::<3>(begin).copy_from(&predicted.by_landmark);
            full += row.tr_mul(&row) / SIGMA_PX.powi(2);
        }
    }
    let inverse = full.cholesky().unwrap().inverse();
    let covariance = problem.covariance(&bundle).unwrap();
    let of_poses = covariance.columns(0..POSE * views);
    let expected = inverse.view((0, 0), (POSE * views, POSE * views));
    assert!((&of_poses - expected).amax() < 1e-6 * expected.amax());
    let block = covariance.blocks([1], 2)[0];
    assert!((block - of_poses.fixed_view::<6, 6>(POSE, 2 * POSE)).amax() < 1e-12 * expected.amax());
    let factors = DVector::from_fn(POSE * views, |row, _| (row as f64).cos());
    assert!((covariance.times(&factors) - &of_poses * &factors).amax() < 1e-9 * of_poses.amax());
}
