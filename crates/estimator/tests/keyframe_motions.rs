//! A new version of the map that says how far each keyframe moved: the state moves with those that it depends on.

use crate::common::{World, accepted};
use estimator::{
    AdaptiveNoise, ChangeSize, Estimator, EstimatorConfig, KeyframeMotion, MapRevision, RevisionEffect,
};
use geometry::{Pose, rotation};
use nalgebra::{Matrix6, Vector3, Vector6};

const SIZE: ChangeSize = ChangeSize { sigma_rotation_rad: 0.02, sigma_position_m: 0.15 };
const HELD: [u64; 4] = [4, 5, 8, 9];

/// A filter that was localized by keyframes 4, 5 and 8, 9.
///
/// # Arguments
/// * `motion`: by how much the version of the map that it used has each keyframe elsewhere.
fn localized(config: EstimatorConfig, motion: impl Fn(u64) -> Vector6<f64>) -> Estimator {
    let world = World::new();
    let mut estimator = world.estimator(config);
    for frame in 1..=12 {
        let clone = world.frame(&mut estimator, frame);
        if frame % 4 == 0 && frame < 12 {
            let mut answer = world.answer(frame, frame, frame as u64);
            for keyframe in &mut answer.keyframes {
                let pose = &mut keyframe.global_from_keyframe.pose;
                *pose = pose.retract(&motion(keyframe.id));
            }
            assert!(accepted(&estimator.map_update(clone, &answer).unwrap()));
        }
    }
    estimator
}

fn revision(changed: &[u64], motion: impl Fn(u64) -> Option<Vector6<f64>>) -> MapRevision {
    revision_of(1, changed, motion)
}

fn revision_of(
    from_version: u64,
    changed: &[u64],
    motion: impl Fn(u64) -> Option<Vector6<f64>>,
) -> MapRevision {
    let moved = |&id: &u64| motion(id).map(|motion| KeyframeMotion { id, motion });
    MapRevision {
        from_version,
        version: from_version + 1,
        changed_keyframes: changed.to_vec(),
        size: Some(SIZE),
        keyframe_motions: changed.iter().filter_map(moved).collect(),
    }
}

fn pose_in_map(estimator: &Estimator) -> Pose {
    estimator.global_from_imu().unwrap().pose
}

fn covariance_in_map(estimator: &Estimator) -> Matrix6<f64> {
    estimator.global_from_imu().unwrap().covariance
}

#[test]
fn the_state_moves_as_if_it_had_used_the_new_version_from_the_beginning() {
    let still = |_: u64| Vector6::zeros();
    // Only the first, only the second, all of them, each otherwise.
    for weights in [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -0.7]] {
        let of = |id: u64| {
            let weight = weights[usize::from(id > 5)];
            Vector6::new(1e-5, -2e-5, 3e-5, 2e-4, 1e-4, -2e-4) * weight * (1.0 + 0.1 * (id % 2) as f64)
        };
        // What is learned from residuals depends on the motion, too.
        let mut config = EstimatorConfig::default();
        config.adaptive_noise = AdaptiveNoise::NONE;
        let mut moved = localized(config.clone(), still);
        let before = [pose_in_map(&moved), moved.local_from_imu().pose];
        assert_eq!(moved.map_changed(&revision(&HELD, |id| Some(of(id)))), RevisionEffect::CarriedOver);
        let after = [pose_in_map(&moved), moved.local_from_imu().pose];
        let anew = localized(config, of);
        let anew = [pose_in_map(&anew), anew.local_from_imu().pose];
        let correction = before[0].local(&after[0]);
        assert!(correction.amax() > 2e-5, "{correction}");
        for k in 0..2 {
            let difference = after[k].local(&anew[k]).amax();
            // Measurements with residuals of a pixel are linearized at other poses then.
            assert!(difference < 0.1 * correction.amax(), "{weights:?}: {difference} of {correction}");
        }
    }
}

/// A filter that was localized by two keyframes of each of some versions of the map, which restated them as they were, and by two of
/// the newest version.
///
/// # Arguments
/// * `motion`: by how much the newest version has these elsewhere.
///
/// # Returns
/// The filter, and the keyframes of the newest version.
fn localized_in_versions(revisions: u64, motion: Vector6<f64>) -> (Estimator, [u64; 2]) {
    let world = World::new();
    let mut config = EstimatorConfig::default();
    config.adaptive_noise = AdaptiveNoise::NONE;
    let mut estimator = world.estimator(config);
    let mut keyframes = [0; 2];
    for version in 1..=revisions + 1 {
        let frame = version as i64 + 1;
        if version == 1 {
            world.frame(&mut estimator, 1);
        }
        let clone = world.frame(&mut estimator, frame);
        keyframes = [10 * version, 10 * version + 1];
        let mut answer = world.answer(frame, frame, keyframes[0]);
        answer.map_version = version;
        if version > revisions {
            for keyframe in &mut answer.keyframes {
                let pose = &mut keyframe.global_from_keyframe.pose;
                *pose = pose.retract(&motion);
            }
        }
        assert!(accepted(&estimator.map_update(clone, &answer).unwrap()));
        if version <= revisions {
            let again = revision_of(version, &keyframes, |_| Some(Vector6::zeros()));
            assert_eq!(estimator.map_changed(&again), RevisionEffect::CarriedOver);
        }
    }
    (estimator, keyframes)
}

#[test]
fn after_many_revisions_the_state_moves_as_far_as_after_the_first() {
    let motion = Vector6::new(1e-5, -2e-5, 3e-5, 2e-4, 1e-4, -2e-4);
    for revisions in [0, 1, 3, 7] {
        let (mut moved, keyframes) = localized_in_versions(revisions, Vector6::zeros());
        let before = pose_in_map(&moved);
        let last = revision_of(revisions + 1, &keyframes, |_| Some(motion));
        assert_eq!(moved.map_changed(&last), RevisionEffect::CarriedOver);
        let (anew, _) = localized_in_versions(revisions, motion);
        let [correction, expected] = [&moved, &anew].map(|robot| before.local(&pose_in_map(robot)));
        let difference = (correction - expected).amax();
        println!("{revisions} revisions: {correction} for {expected}");
        assert!(expected.amax() > 2e-5, "{expected}");
        assert!(difference < 0.1 * expected.amax(), "{revisions} revisions: {correction} for {expected}");
    }
}

#[test]
fn what_moves_elsewhere_costs_no_certainty() {
    let mut robot = localized(EstimatorConfig::default(), |_| Vector6::zeros());
    let (pose, covariance) = (pose_in_map(&robot), covariance_in_map(&robot));
    let far = revision(&[100, 101], |_| Some(Vector6::new(0.0, 0.0, 0.05, 0.3, 0.0, 0.0)));
    assert_eq!(robot.map_changed(&far), RevisionEffect::CarriedOver);
    assert_eq!(robot.held_keyframes().len(), HELD.len());
    assert!(pose.local(&pose_in_map(&robot)).amax() < 1e-12);
    let grown = covariance_in_map(&robot) - covariance;
    let stated = |k| if k < 3 { SIZE.sigma_rotation_rad } else { SIZE.sigma_position_m };
    for k in 0..6 {
        let part = grown[(k, k)] / f64::powi(stated(k), 2);
        assert!((-1e-12..1e-3).contains(&part), "{part} of number {k}");
    }
}

#[test]
fn a_map_that_moves_as_a_whole_takes_the_robot_with_it() {
    let mut robot = localized(EstimatorConfig::default(), |_| Vector6::zeros());
    let mut without = robot.clone();
    let before = pose_in_map(&robot);
    let turn = rotation::exp(&Vector3::new(1e-3, -2e-3, 3e-3));
    let shift = Vector3::new(0.3, -0.2, 0.1);
    let centre = before.translation;
    let new_from_old = Pose::new(turn, centre + shift - turn * centre);
    let world = World::new();
    let poses: Vec<_> =
        [4, 8].iter().flat_map(|&frame| world.answer(frame, frame, frame as u64).keyframes).collect();
    let motion = |id: u64| {
        let old = poses.iter().find(|keyframe| keyframe.id == id)?.global_from_keyframe.pose;
        Some(old.local(&(new_from_old * old)))
    };
    assert_eq!(robot.map_changed(&revision(&HELD, motion)), RevisionEffect::CarriedOver);
    let expected = new_from_old * before;
    let difference = pose_in_map(&robot).local(&expected).amax();
    assert!(difference < 2e-3, "{difference} of {shift}");
    // Told the size alone, it is as uncertain as that instead.
    without.map_changed(&revision(&HELD, |_| None));
    let [told, untold] = [&robot, &without].map(|robot| covariance_in_map(robot).diagonal());
    assert!(told[3] < 0.2 * untold[3], "{told} {untold}");
}

#[test]
fn the_part_of_the_state_that_no_keyframe_of_the_new_version_explains_moves_by_the_stated_size() {
    let growth = |removed: &[u64]| {
        let mut robot = localized(EstimatorConfig::default(), |_| Vector6::zeros());
        let begin = covariance_in_map(&robot)[(3, 3)];
        let still = |id: u64| (!removed.contains(&id)).then(Vector6::zeros);
        // Keyframes that did not move, and had no other covariance, are not invalidated.
        let changed: Vec<u64> = removed.iter().copied().chain([100]).collect();
        assert_eq!(robot.map_changed(&revision(&changed, still)), RevisionEffect::CarriedOver);
        (covariance_in_map(&robot)[(3, 3)] - begin) / SIZE.sigma_position_m.powi(2)
    };
    let (none, one, half, all) = (growth(&[]), growth(&[4]), growth(&[4, 5]), growth(&HELD));
    assert!(none < 1e-3 && none < one && one < half && half < all, "{none} {one} {half} {all}");
    assert!((0.98..1.2).contains(&all), "{all}");
}

#[test]
fn motions_that_are_no_numbers_or_beyond_all_bounds_make_the_robot_begin_anew() {
    for bad in [f64::NAN, f64::INFINITY, 1e9] {
        for number in 0..6 {
            let mut robot = localized(EstimatorConfig::default(), |_| Vector6::zeros());
            let (pose, covariance) = (pose_in_map(&robot), covariance_in_map(&robot));
            let mut motion = Vector6::zeros();
            motion[number] = bad;
            let unfit = revision(&HELD, |_| Some(motion));
            assert_eq!(robot.map_changed(&unfit), RevisionEffect::Reinitialized);
            assert_eq!((pose_in_map(&robot), covariance_in_map(&robot)), (pose, covariance));
        }
    }
}
