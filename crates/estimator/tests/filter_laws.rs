//! What the filter as a whole promises to whoever runs it.

use crate::common::{FRAME_NS, World, accepted, imu_at, says};
use estimator::{
    AdaptiveNoise, Estimator, EstimatorConfig, EstimatorError, Localization, MapMode, Rejection,
};

/// A filter that ran for a while and knows where it is.
fn localized(config: EstimatorConfig) -> (World, Estimator, i64) {
    let world = World::new();
    let mut estimator = world.estimator(config);
    for frame in 1..=12 {
        let clone = world.frame(&mut estimator, frame);
        if frame % 4 == 0 {
            let answer = world.answer(frame, frame, frame as u64);
            let report = estimator.map_update(clone, &answer).unwrap();
            assert!(accepted(&report), "{report:?}");
        }
    }
    (world, estimator, 12)
}

fn run(world: &World, estimator: &mut Estimator, frames: std::ops::Range<i64>) {
    for frame in frames {
        world.frame(estimator, frame);
    }
}

#[test]
fn a_pose_that_is_not_known_well_enough_is_not_claimed_until_answers_make_it_so() {
    let coarsest = |estimator: &Estimator| {
        estimator
            .global_from_imu()
            .unwrap()
            .covariance
            .fixed_view::<3, 3>(3, 3)
            .symmetric_eigenvalues()
            .max()
            .sqrt()
    };
    let first = |needed_m: f64| {
        let mut config = EstimatorConfig::default();
        config.localized_sigma_m = needed_m;
        let world = World::new();
        let mut estimator = world.estimator(config);
        let clone = world.frame(&mut estimator, 1);
        assert!(accepted(&estimator.map_update(clone, &world.answer(1, 1, 1)).unwrap()));
        (world, estimator)
    };
    let sigma = coarsest(&first(1.0).1);
    for (needed_m, expected) in
        [(1.01 * sigma, Localization::Localized), (0.99 * sigma, Localization::OdometryOnly)]
    {
        assert_eq!(first(needed_m).1.status().localization, expected);
    }

    let needed_m = 0.8 * sigma;
    let (world, mut estimator) = first(needed_m);
    let mut known = false;
    for frame in 2..60 {
        let clone = world.frame(&mut estimator, frame);
        estimator.map_update(clone, &world.answer(frame, frame, frame as u64)).unwrap();
        // Once known it stays so, however far the robot drives without the map.
        known = known || coarsest(&estimator) <= needed_m;
        let status = estimator.status();
        assert_eq!(status.localization == Localization::Localized, known, "{status:?}");
        assert!(known || status.reason.contains("m are needed"), "{status:?}");
    }
    assert!(known);
}

#[test]
fn it_knows_where_it_is_in_every_mode() {
    for mode in [MapMode::Single, MapMode::Multi, MapMode::MapConst] {
        let mut config = EstimatorConfig::default();
        config.mode = mode;
        config.localized_sigma_m = 0.3;
        let (world, estimator, frame) = localized(config);
        assert_eq!(estimator.status().localization, Localization::Localized);
        let truth = world.global_from_local * World::truth(frame);
        let pose = estimator.global_from_imu().unwrap();
        let error = pose.pose.local(&truth);
        // One keyframe alone says little of the distance to the landmarks, and a second of one camera little of the speed.
        let bound = if mode == MapMode::Single { 0.1 } else { 0.05 };
        assert!(error.amax() < bound, "{mode:?}: {error}");
        let local = estimator.local_from_imu();
        if mode != MapMode::MapConst {
            for (name, nees) in [("in G", pose.nees(&truth)), ("local", local.nees(&World::truth(frame)))] {
                assert!(nees.unwrap() < 25.0, "{mode:?} {name}: {nees:?} over 6");
            }
        }
        let error = local.pose.local(&World::truth(frame));
        assert!(error.amax() < bound, "{mode:?}: {error}");
    }
}

#[test]
fn a_rejected_answer_changes_nothing_now_or_later() {
    // Before the first match, where the transform is inserted and taken away again, and after it.
    let fresh = || {
        let world = World::new();
        let mut estimator = world.estimator(EstimatorConfig::default());
        run(&world, &mut estimator, 1..7);
        (world, estimator, 6)
    };
    for is_localized in [false, true] {
        let (world, mut estimator, frame) =
            if is_localized { localized(EstimatorConfig::default()) } else { fresh() };
        let clone = world.frame(&mut estimator, frame + 1);
        let mut untouched = estimator.clone();
        let mut wrong = world.answer(frame + 1, frame + 1, 70);
        for keyframe in &mut wrong.keyframes {
            // Verified by geometry, but its two keyframes contradict each other and the state.
            let sign = if keyframe.id == 70 { 1.0 } else { -1.0 };
            keyframe.global_from_keyframe.pose.translation += nalgebra::Vector3::new(3.0, 2.0, 1.0) * sign;
        }
        let report = estimator.map_update(clone, &wrong).unwrap();
        assert!(!accepted(&report) && report.inliers > 20, "{report:?}");
        assert_eq!(says(&estimator), says(&untouched));
        for next in frame + 2..frame + 25 {
            World::feed_imu(&mut estimator, next);
            World::feed_imu(&mut untouched, next);
            let tracks = world.tracks(next);
            for filter in [&mut estimator, &mut untouched] {
                filter.time_update(next * FRAME_NS).unwrap();
                filter.track_update(&tracks).unwrap();
            }
            assert_eq!(says(&estimator), says(&untouched), "at frame {next}");
        }
    }
}

#[test]
fn a_pinned_clone_survives_the_window_and_an_unpinned_one_does_not() {
    let mut config = EstimatorConfig::default();
    config.window = 6;
    let (world, mut estimator, frame) = localized(config);
    let (kept, lost) = (world.frame(&mut estimator, frame + 1), world.frame(&mut estimator, frame + 2));
    let (kept_answer, lost_answer) =
        (world.answer(frame + 1, frame + 1, 60), world.answer(frame + 2, frame + 2, 70));
    // By two queries, the first of which is answered at once.
    estimator.pin(kept);
    estimator.pin(kept);
    estimator.unpin(kept);
    run(&world, &mut estimator, frame + 3..frame + 13);
    assert_eq!(estimator.map_update(lost, &lost_answer).unwrap().rejection, Some(Rejection::TooLate));
    let report = estimator.map_update(kept, &kept_answer).unwrap();
    assert!(accepted(&report), "{report:?}");
    estimator.unpin(kept);
    run(&world, &mut estimator, frame + 13..frame + 15);
    assert_eq!(estimator.map_update(kept, &kept_answer).unwrap().rejection, Some(Rejection::TooLate));
    let error = estimator.local_from_imu().pose.local(&World::truth(frame + 14));
    assert!(error.amax() < 0.1, "{error}");
}

#[test]
fn a_frame_without_readings_or_from_the_past_is_refused_and_leaves_no_trace() {
    let (world, mut estimator, frame) = localized(EstimatorConfig::default());
    let mut untouched = estimator.clone();
    let missing = estimator.time_update((frame + 5) * FRAME_NS);
    assert!(matches!(missing, Err(EstimatorError::NoImu { .. })), "{missing:?}");
    let old = estimator.time_update((frame - 1) * FRAME_NS);
    assert!(matches!(old, Err(EstimatorError::OldFrame { .. })), "{old:?}");
    assert_eq!(says(&estimator), says(&untouched));
    for filter in [&mut estimator, &mut untouched] {
        World::feed_imu(filter, frame + 1);
        filter.time_update((frame + 1) * FRAME_NS).unwrap();
    }
    let tracks = world.tracks(frame + 1);
    assert_eq!(estimator.track_update(&tracks).unwrap(), untouched.track_update(&tracks).unwrap());
    assert_eq!(says(&estimator), says(&untouched));
}

#[test]
fn the_map_is_never_changed_and_a_keyframe_used_again_is_the_same_keyframe() {
    let (world, mut estimator, frame) = localized(EstimatorConfig::default());
    let mut held = estimator.held_keyframes();
    held.sort_unstable();
    assert_eq!(held, [4, 5, 8, 9, 12, 13]);
    // Two keyframes again and again: their errors do not average out, and they stay two.
    for next in frame + 1..frame + 30 {
        let clone = world.frame(&mut estimator, next);
        let report = estimator.map_update(clone, &world.answer(next, frame, 20)).unwrap();
        assert!(report.inliers > 20, "{report:?}");
    }
    assert_eq!(estimator.held_keyframes().len(), 8);
    let pose = estimator.global_from_imu().unwrap();
    let sigma = pose.covariance[(5, 5)].sqrt();
    // Eight keyframes of 0.01 m: no better than their mean.
    assert!(sigma > 0.9 * 0.01 / 8.0_f64.sqrt(), "{sigma}");
    let nees = pose.nees(&(world.global_from_local * World::truth(frame + 29))).unwrap();
    assert!(nees < 25.0, "{nees} over 6");
}

/// Standard deviations of the body's yaw (rad) and position (m) in L after six seconds, and their error.
fn knowledge_of_local(mode: MapMode, first_estimates: bool) -> ([f64; 4], f64) {
    let mut config = EstimatorConfig::default();
    (config.mode, config.first_estimates) = (mode, first_estimates);
    // Filters of equal noise are compared: with a map it would be learned from more.
    config.adaptive_noise = AdaptiveNoise::NONE;
    // Of L itself nothing is known but where up is: the velocity would tell its yaw.
    let initial = &mut config.initial;
    (initial.sigma_yaw_rad, initial.sigma_position_m, initial.sigma_velocity_m_s) = (0.05, 0.3, 0.3);
    let world = World::new();
    let mut estimator = world.estimator(config);
    for frame in 1..60 {
        let clone = world.frame(&mut estimator, frame);
        if frame % 5 == 0 && mode != MapMode::Odometry {
            let report = estimator.map_update(clone, &world.answer(frame, frame, frame as u64)).unwrap();
            assert!(accepted(&report), "{report:?}");
        }
    }
    let pose = estimator.local_from_imu();
    let error = pose.pose.local(&World::truth(59))[2];
    ([2, 3, 4, 5].map(|k| pose.covariance[(k, k)].sqrt()), error)
}

#[test]
fn the_map_never_tells_where_local_is() {
    // Turning L about gravity and moving it changes no measurement. The prior of the transform, which is
    // six times wider than that of L, may add one or two percent.
    let (alone, yaw_alone) = knowledge_of_local(MapMode::Odometry, true);
    let (with_map, yaw_error) = knowledge_of_local(MapMode::Multi, true);
    for (name, (with_map, alone)) in ["yaw", "x", "y", "z"].iter().zip(with_map.iter().zip(&alone)) {
        assert!(*with_map > 0.95 * alone, "{name} is known to {with_map} with the map, {alone} without");
    }
    // Map rows and tracks differ in what is eliminated with them: a part of the turn that its deviation covers.
    let turned = (yaw_error - yaw_alone).abs();
    assert!(
        turned < 0.3 * with_map[0],
        "the map turned L by {turned} rad, known to {}: {yaw_error}, {yaw_alone} without",
        with_map[0]
    );
}

#[test]
fn odometry_never_tells_where_local_is() {
    // What was known of it at the start, by the direction of the velocity, too: see `knowledge_of_local`.
    let speed_squared: f64 = 0.4 * 0.4 + 0.9 * 0.9;
    let yaw = (0.05_f64.powi(-2) + speed_squared / (0.3 * 0.3)).sqrt().recip();
    let (known, _) = knowledge_of_local(MapMode::Odometry, true);
    for (name, (known, before)) in ["yaw", "x", "y", "z"].iter().zip(known.iter().zip([yaw, 0.3, 0.3, 0.3])) {
        assert!(*known > 0.999 * before, "{name} is known to {known}, {before} at the start");
    }
}

#[test]
fn a_prediction_is_the_time_update_that_the_filter_would_make() {
    let (_, mut estimator, frame) = localized(EstimatorConfig::default());
    // A state between two readings, as that of an image mostly is.
    let state_ns = frame * FRAME_NS + 12_500_000;
    let stamps: Vec<i64> = (1..=30).map(|k| frame * FRAME_NS + k * 5_000_000).collect();
    for stamp_ns in stamps.iter().take_while(|stamp_ns| **stamp_ns < state_ns + 5_000_000) {
        estimator.imu(imu_at(*stamp_ns)).unwrap();
    }
    estimator.time_update(state_ns).unwrap();
    let (mut predictor, untouched) = (estimator.predictor(), estimator.clone());
    assert_eq!(predictor.state_ns(), state_ns);
    for stamp_ns in &stamps {
        let motion = predictor.add(imu_at(*stamp_ns));
        assert_eq!(predictor.add(imu_at(*stamp_ns)), None, "a reading counts once");
        let mut updated = untouched.clone();
        for later in stamps.iter().filter(|later| **later > state_ns + 5_000_000 && *later <= stamp_ns) {
            updated.imu(imu_at(*later)).unwrap();
        }
        let Some(motion) = motion else {
            assert!(*stamp_ns <= state_ns);
            continue;
        };
        updated.time_update(*stamp_ns).unwrap();
        let expected = updated.motion();
        assert_eq!((motion.stamp_ns, motion.state), (*stamp_ns, expected.state));
        assert!((motion.angular_velocity - expected.angular_velocity).norm() < 1e-12);
        let difference = (motion.covariance - expected.covariance).amax();
        assert!(difference < 1e-12 * expected.covariance.amax(), "{stamp_ns}: {difference}");
    }
}
