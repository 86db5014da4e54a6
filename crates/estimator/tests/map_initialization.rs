//! What initializes the pose in the map.

use crate::common::{World, accepted};
use estimator::{EstimatorConfig, Rejection};

/// The odds of an answer are those of the pose that most of its matches agree on.
#[test]
fn the_odds_of_an_answer_do_not_speak_for_a_pose_of_few_of_its_matches() {
    let world = World::new();
    let mut estimator = world.estimator(EstimatorConfig::default());
    let clone = (1..=4).map(|frame| world.frame(&mut estimator, frame)).last().unwrap();
    let good = world.answer(4, 4, 4);
    let mut spoilt = good.clone();
    let count = spoilt.landmarks.len();
    for k in (0..count).filter(|k| k % 3 != 0) {
        spoilt.landmarks[k].pixel = good.landmarks[(7 * k + 11) % count].pixel;
    }
    let report = estimator.map_update(clone, &spoilt).unwrap();
    assert!(2 * report.inliers < count, "{report:?}");
    assert!(matches!(report.rejection, Some(Rejection::NotDistinctive(_))), "{report:?}");
    assert!(estimator.global_from_imu().is_none());
    assert!(accepted(&estimator.map_update(clone, &good).unwrap()));
}
