//! A served map changes while a robot uses it: what its news and its answers do to the filter.

use crate::common::{FRAME_NS, World, accepted, assert_finite, says};
use estimator::map_update::map_revision::ANNOUNCEMENT_NS;
use estimator::state::local_error;
use estimator::{
    ChangeSize, CloneId, Estimator, EstimatorConfig, Localization, MapAnswer, MapRevision, Rejection,
    RevisionEffect,
};
use geometry::{Pose, PoseWithCovariance, rotation};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use rand::{RngExt as _, SeedableRng, rngs::StdRng};

const SIZE: ChangeSize = ChangeSize { sigma_rotation_rad: 0.02, sigma_position_m: 0.15 };

/// A filter that is localized by keyframes 4, 5 and 8, 9 of version 1; and the newest frame.
fn localized() -> (World, Estimator, i64) {
    let world = World::new();
    let mut estimator = world.estimator(EstimatorConfig::default());
    for frame in 1..=12 {
        let clone = world.frame(&mut estimator, frame);
        if frame % 4 == 0 && frame < 12 {
            let report = estimator.map_update(clone, &world.answer(frame, frame, frame as u64)).unwrap();
            assert!(accepted(&report), "{report:?}");
        }
    }
    (world, estimator, 12)
}

fn news(from_version: u64, version: u64, size: Option<ChangeSize>) -> MapRevision {
    let (changed_keyframes, keyframe_motions) = (vec![4, 5, 8, 9], Vec::new());
    MapRevision { from_version, version, changed_keyframes, size, keyframe_motions }
}

/// The answer of a version whose frame is moved by `new_from_old`.
fn moved(mut answer: MapAnswer, version: u64, new_from_old: &Pose) -> MapAnswer {
    answer.map_version = version;
    for keyframe in &mut answer.keyframes {
        let stated = &mut keyframe.global_from_keyframe;
        *stated = PoseWithCovariance::new(*new_from_old * stated.pose, stated.covariance);
    }
    answer
}

/// A move of G by so many deviations of a size about the robot's place.
fn move_about(place: &Vector3<f64>, size: ChangeSize, deviations: &Vector6<f64>) -> Pose {
    let turn = rotation::exp(&(deviations.fixed_rows::<3>(0) * size.sigma_rotation_rad));
    let shift = deviations.fixed_rows::<3>(3) * size.sigma_position_m;
    Pose::new(turn, place + shift - turn * place)
}

fn next(world: &World, estimator: &mut Estimator, frame: &mut i64) -> CloneId {
    *frame += 1;
    world.frame(estimator, *frame)
}

#[test]
fn the_pose_in_the_map_becomes_as_uncertain_as_stated_wherever_the_origin_is() {
    let (_, mut estimator, _) = localized();
    let (transform, pose) = (estimator.global_from_local().unwrap(), estimator.global_from_imu().unwrap());
    let local = says_local(&estimator);
    let revision = MapRevision { changed_keyframes: Vec::new(), ..news(1, 2, Some(SIZE)) };
    assert_eq!(estimator.map_changed(&revision), RevisionEffect::CarriedOver);
    assert_eq!((estimator.map_version(), estimator.held_keyframes().len()), (Some(2), 4));
    let after = estimator.global_from_imu().unwrap();
    assert_eq!((after.pose, says_local(&estimator)), (pose.pose, local));
    let grown = after.covariance - pose.covariance;
    let stated = |k| if k < 3 { SIZE.sigma_rotation_rad } else { SIZE.sigma_position_m };
    let expected = Matrix6::from_diagonal(&Vector6::from_fn(|k, _| f64::powi(stated(k), 2)));
    assert!((grown - expected).amax() < 1e-9 * expected.amax(), "{grown}");

    // `G_T_L` itself: against sampled moves of G about the robot's place.
    let mut rng = StdRng::seed_from_u64(5);
    let draws = 40_000;
    let mut sampled = Matrix6::zeros();
    for _ in 0..draws {
        let deviations = Vector6::from_fn(|_, _| (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0);
        let new_from_old = move_about(&pose.pose.translation, SIZE, &deviations);
        let error = local_error(&transform.pose, &(new_from_old * transform.pose));
        sampled += error * error.transpose() / f64::from(draws);
    }
    let told = |pose: &PoseWithCovariance| {
        let mut back = Matrix6::zeros();
        let turn: Matrix3<f64> = pose.pose.rotation.inverse().to_rotation_matrix().into_inner();
        back.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        back.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        back * pose.covariance * back.transpose()
    };
    let noise = told(&estimator.global_from_local().unwrap()) - told(&transform);
    for row in 0..6 {
        for column in 0..6 {
            let apart = (noise - sampled)[(row, column)].abs();
            assert!(apart < 0.03 * (noise[(row, row)] * noise[(column, column)]).sqrt(), "{noise} {sampled}");
        }
    }
}

fn says_local(estimator: &Estimator) -> String {
    format!("{:?} {:?} {:?}", estimator.local_from_imu(), estimator.velocity(), estimator.biases())
}

#[test]
fn a_stated_change_keeps_the_robot_localized_without_a_jump() {
    for sign in [1.0, -1.0] {
        let (world, mut estimator, mut frame) = localized();
        let place = estimator.global_from_imu().unwrap().pose.translation;
        let deviations = Vector6::new(1.0, -1.0, 0.5, 1.0, 1.0, -1.0) * sign;
        let new_from_old = move_about(&place, SIZE, &deviations);
        assert_eq!(estimator.map_changed(&news(1, 2, Some(SIZE))), RevisionEffect::CarriedOver);
        assert!(estimator.held_keyframes().is_empty());
        for step in 0..12 {
            let clone = next(&world, &mut estimator, &mut frame);
            assert_eq!(estimator.status().localization, Localization::Localized);
            let before = estimator.global_from_imu().unwrap();
            let answer = moved(world.answer(frame, frame, 20 + 2 * step), 2, &new_from_old);
            let report = estimator.map_update(clone, &answer).unwrap();
            assert!(accepted(&report) && !report.initialized, "{report:?}");
            let jump = before.nees(&estimator.global_from_imu().unwrap().pose).unwrap();
            assert!(jump < 20.06, "{jump} of 6 numbers at step {step}: beyond 3 sigma");
        }
        let truth = new_from_old * world.global_from_local * World::truth(frame);
        let pose = estimator.global_from_imu().unwrap();
        assert!(pose.pose.local(&truth).amax() < 0.05, "{}", pose.pose.local(&truth));
        assert!(pose.nees(&truth).unwrap() < 25.0);
        assert_eq!(estimator.map_version(), Some(2));
        assert_finite(&estimator);
    }
}

#[test]
fn keyframes_that_stayed_the_same_stay_held_and_the_rest_is_given_up() {
    let (world, mut estimator, mut frame) = localized();
    let revision = MapRevision { changed_keyframes: vec![4, 9, 77], ..news(1, 2, Some(SIZE)) };
    assert_eq!(estimator.map_changed(&revision), RevisionEffect::CarriedOver);
    let mut held = estimator.held_keyframes();
    held.sort_unstable();
    assert_eq!(held, [5, 8]);
    let clone = next(&world, &mut estimator, &mut frame);
    let again = moved(world.answer(frame, 8, 8), 2, &Pose::identity());
    assert!(accepted(&estimator.map_update(clone, &again).unwrap()));
    assert_eq!(estimator.held_keyframes().len(), 3);
}

#[test]
fn late_answers_of_the_old_version_are_refused() {
    let (world, mut estimator, mut frame) = localized();
    let asked = next(&world, &mut estimator, &mut frame);
    estimator.pin(asked);
    let late = world.answer(frame, frame, 30);
    next(&world, &mut estimator, &mut frame);
    let now = frame;
    let newest = next(&world, &mut estimator, &mut frame);
    estimator.map_changed(&news(1, 2, Some(SIZE)));
    let before = says(&estimator);
    let report = estimator.map_update(asked, &late).unwrap();
    assert_eq!(report.rejection, Some(Rejection::OldMapVersion { answered: 1, held: 2 }));
    // Even one to the newest image, which was asked before the news came; and a map may be built anew from version 1.
    let mut rebuilt = estimator.clone();
    let report = estimator.map_update(newest, &world.answer(frame, now, 30)).unwrap();
    assert_eq!(report.rejection, Some(Rejection::OldMapVersion { answered: 1, held: 2 }));
    assert_eq!(says(&estimator), before);
    rebuilt.map_changed(&news(2, 1, Some(SIZE)));
    let mut late = late;
    late.map_version = 2;
    let report = rebuilt.map_update(asked, &late).unwrap();
    assert_eq!(report.rejection, Some(Rejection::OldMapVersion { answered: 2, held: 1 }));
}

#[test]
fn changes_in_a_row_add_up_and_are_counted_once() {
    let variance = |estimator: &Estimator| estimator.global_from_imu().unwrap().covariance[(3, 3)];
    let (_, mut estimator, _) = localized();
    let begin = variance(&estimator);
    let empty = |from, to| MapRevision { changed_keyframes: Vec::new(), ..news(from, to, Some(SIZE)) };
    assert_eq!(estimator.map_changed(&empty(1, 2)), RevisionEffect::CarriedOver);
    assert_eq!(estimator.map_changed(&empty(1, 2)), RevisionEffect::None);
    assert_eq!(estimator.map_changed(&empty(2, 5)), RevisionEffect::CarriedOver);
    let expected = 2.0 * SIZE.sigma_position_m.powi(2);
    assert!((variance(&estimator) - begin - expected).abs() < 1e-9, "{}", variance(&estimator) - begin);
    assert_eq!(estimator.map_version(), Some(5));
}

#[test]
fn without_news_the_place_is_found_anew_after_a_while_and_with_unfit_news_at_once() {
    let elsewhere = Pose::new(rotation::exp(&Vector3::new(0.4, 0.2, -1.0)), Vector3::new(5.0, 80.0, -3.0));
    let answer = |world: &World, frame, version| {
        moved(world.answer(frame, frame, 10 * version + frame as u64), version, &elsewhere)
    };
    let found = |world: &World, estimator: &Estimator, frame| {
        assert_eq!(estimator.map_version(), Some(3));
        let truth = elsewhere * world.global_from_local * World::truth(frame);
        assert!(estimator.global_from_imu().unwrap().pose.local(&truth).amax() < 0.3);
    };

    let (world, mut estimator, mut frame) = localized();
    let begin = frame;
    loop {
        let clone = next(&world, &mut estimator, &mut frame);
        let report = estimator.map_update(clone, &answer(&world, frame, 3)).unwrap();
        assert_eq!(estimator.status().localization, Localization::Localized);
        if accepted(&report) {
            assert!(report.initialized && (frame - begin) * FRAME_NS > 2_000_000_000, "{report:?}");
            break;
        }
        assert_eq!(report.rejection, Some(Rejection::UnannouncedMapVersion { answered: 3, held: 1 }));
    }
    found(&world, &estimator, frame);

    // News from another version: some were lost. News without a size. A size that nothing survives.
    let boundless = ChangeSize { sigma_rotation_rad: 3.0, ..SIZE };
    for unfit in [news(2, 3, Some(SIZE)), news(1, 3, None), news(1, 3, Some(boundless))] {
        let (world, mut estimator, mut frame) = localized();
        assert_eq!(estimator.map_changed(&unfit), RevisionEffect::Reinitialized);
        assert_eq!(estimator.status().localization, Localization::Localized);
        let clone = next(&world, &mut estimator, &mut frame);
        let report = estimator.map_update(clone, &answer(&world, frame, 3)).unwrap();
        assert!(accepted(&report) && report.initialized, "{report:?}");
        found(&world, &estimator, frame);
    }
}

/// Several servers of a map change over to a release one after the other.
#[test]
fn a_server_that_is_behind_takes_no_robot_back() {
    let (world, mut estimator, mut frame) = localized();
    let stays = MapRevision { changed_keyframes: Vec::new(), ..news(1, 2, Some(SIZE)) };
    assert_eq!(estimator.map_changed(&stays), RevisionEffect::CarriedOver);
    let now_served = |world: &World, frame: i64| {
        moved(world.answer(frame, frame, 100 + 2 * frame as u64), 2, &Pose::identity())
    };
    for step in 0..100 {
        let clone = next(&world, &mut estimator, &mut frame);
        match step % 20 {
            // The announcement of the server that is behind, once more.
            0 => assert_eq!(estimator.map_changed(&news(0, 1, Some(SIZE))), RevisionEffect::None),
            5 => {
                let report = estimator.map_update(clone, &world.answer(frame, frame, 30)).unwrap();
                let behind = Rejection::UnannouncedMapVersion { answered: 1, held: 2 };
                assert_eq!(report.rejection, Some(behind));
            }
            10 if step > 50 => {
                let report = estimator.map_update(clone, &now_served(&world, frame)).unwrap();
                assert!(accepted(&report) && !report.initialized, "{report:?}");
            }
            _ => {}
        }
        assert_eq!(estimator.status().localization, Localization::Localized);
        assert_eq!(estimator.map_version(), Some(2));
    }
}

#[test]
fn news_behind_the_first_answer_of_their_version_still_count() {
    let (world, mut estimator, mut frame) = localized();
    let clone = next(&world, &mut estimator, &mut frame);
    let early = estimator.map_update(clone, &moved(world.answer(frame, frame, 20), 2, &Pose::identity()));
    assert_eq!(early.unwrap().rejection, Some(Rejection::UnannouncedMapVersion { answered: 2, held: 1 }));
    assert_eq!(estimator.map_changed(&news(1, 2, Some(SIZE))), RevisionEffect::CarriedOver);
    let clone = next(&world, &mut estimator, &mut frame);
    let report = estimator.map_update(clone, &moved(world.answer(frame, frame, 20), 2, &Pose::identity()));
    let report = report.unwrap();
    assert!(accepted(&report) && !report.initialized, "{report:?}");
}

#[test]
fn an_answer_of_another_map_that_is_refused_does_not_cost_the_transform() {
    let (world, mut estimator, mut frame) = localized();
    estimator.map_changed(&news(1, 2, None));
    let before = (estimator.global_from_local(), estimator.held_keyframes());
    let clone = next(&world, &mut estimator, &mut frame);
    let before = (before, says(&estimator));
    let mut spoilt = world.answer(frame, frame, 50);
    spoilt.map_version = 2;
    for keyframe in &mut spoilt.keyframes {
        let sign = if keyframe.id == 50 { 1.0 } else { -1.0 };
        keyframe.global_from_keyframe.pose.translation += Vector3::new(3.0, 2.0, 1.0) * sign;
    }
    let report = estimator.map_update(clone, &spoilt).unwrap();
    assert!(!accepted(&report));
    assert_eq!(says(&estimator), before.1);
    assert_eq!((estimator.held_keyframes(), estimator.map_version()), (before.0.1, Some(1)));
}

#[test]
fn answers_of_another_map_are_refused_whatever_their_version() {
    let (world, mut estimator, mut frame) = localized();
    assert_eq!(estimator.map_identity(), Some(1));
    for version in [1, 2] {
        // Beyond the time in which an announcement of a version is waited for.
        for _ in 0..3 * ANNOUNCEMENT_NS / FRAME_NS / 2 {
            let clone = next(&world, &mut estimator, &mut frame);
            let (held, pose) = (estimator.held_keyframes(), says(&estimator));
            let shift = Pose { translation: Vector3::new(5.0, 0.0, 0.0), ..Pose::identity() };
            let mut other = moved(world.answer(frame, frame, 4), version, &shift);
            other.map_identity = 2;
            let report = estimator.map_update(clone, &other).unwrap();
            assert_eq!(report.rejection, Some(Rejection::OtherMap { answered: 2, held: 1 }));
            assert_eq!((estimator.held_keyframes(), says(&estimator)), (held, pose));
        }
    }
    let clone = next(&world, &mut estimator, &mut frame);
    let report = estimator.map_update(clone, &world.answer(frame, frame, 20)).unwrap();
    assert!(accepted(&report), "{report:?}");
}

#[test]
fn hostile_changes_leave_a_finite_filter_that_the_map_localizes_again() {
    let (world, mut estimator, mut frame) = localized();
    let extremes = [0.0, 1e-300, 1.0, 1e3, 1e9, 1e160, f64::MAX, f64::INFINITY, f64::NAN, -1.0];
    let mut version = 1;
    for sigma_rotation_rad in extremes {
        for sigma_position_m in extremes {
            let held = estimator.map_version().unwrap();
            version += 1;
            estimator.map_changed(&news(
                held,
                version,
                Some(ChangeSize { sigma_rotation_rad, sigma_position_m }),
            ));
            if version % 10 == 0 {
                next(&world, &mut estimator, &mut frame);
            }
            assert_finite(&estimator);
        }
    }
    // The map itself has another version.
    let end = frame + 40;
    while frame < end {
        let clone = next(&world, &mut estimator, &mut frame);
        let answer = moved(world.answer(frame, frame, frame as u64), version + 1, &Pose::identity());
        estimator.map_update(clone, &answer).unwrap();
        assert_finite(&estimator);
    }
    let truth = world.global_from_local * World::truth(frame);
    assert!(estimator.global_from_imu().unwrap().pose.local(&truth).amax() < 0.3);
    assert_eq!(estimator.status().localization, Localization::Localized);
}
