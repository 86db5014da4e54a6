//! Consistency of the pose in G behind a change of the served map, over Monte-Carlo runs.

use estimator::EstimatorConfig;
use evaluation::Verdict;
use simulation::monte_carlo::score::{OutputScore, ScoreOptions, score};
use simulation::monte_carlo::{
    AnswerOptions, ChangeStatement, MapChangeOptions, MonteCarloOptions, MovedPart, Variant, run,
};

use crate::{Tracks, loops};

/// Runs of 20 s of which the last 8 are scored: the map changed just before, by 0.3 m and 1.7 degrees an axis.
fn pose_after_a_change(
    runs: usize,
    tracks: Tracks,
    part: MovedPart,
    new_errors: bool,
    statement: ChangeStatement,
) -> (OutputScore, usize) {
    let change =
        MapChangeOptions { at_s: 12.0, sigma_theta_rad: 0.03, sigma_p_m: 0.3, part, new_errors, statement };
    let options = MonteCarloOptions {
        runs,
        simulation: loops(3.0, 20.0, tracks),
        answers: AnswerOptions { every_s: 2.0, ..AnswerOptions::default() },
        map_change: Some(change),
        ..MonteCarloOptions::default()
    };
    let variant = Variant { name: "default".to_owned(), config: EstimatorConfig::default(), cameras: 2 };
    let all = run(&options, &[variant], |_| {}).unwrap().remove(0);
    let score = score(&all, &ScoreOptions { skip_after_initialization_s: 0.0, ..ScoreOptions::default() });
    assert_eq!((score.runs, score.diverged, score.not_localized), (runs, 0, 0));
    let pose = score.pose.unwrap();
    assert_eq!(pose.pose.runs, runs, "all runs are in the NEES");
    for (name, nees) in [("rotation", &pose.rotation), ("position", &pose.position), ("pose", &pose.pose)] {
        println!(
            "{part:?} moves, new errors {new_errors}, stated {statement:?}, {name}: {:.2}, {:.2?}",
            nees.mean, nees.interval
        );
    }
    println!("{:.3} m, {:.3} deg, {:?}", pose.rmse_m, pose.rmse_deg, score.map);
    (pose, score.map.jumps)
}

fn is_consistent(pose: &OutputScore) {
    for nees in [&pose.rotation, &pose.position, &pose.pose] {
        assert!(matches!(nees.verdict, Verdict::Inside | Verdict::Near), "{nees:?}");
    }
}

#[test]
fn nees_in_g_is_as_stated_behind_a_change_that_is_stated_and_above_it_without() {
    is_as_stated_behind_a_change(4, Tracks::Few);
}

#[test]
#[ignore = "all seeds, minutes"]
fn nees_in_g_is_as_stated_behind_a_change_with_all_seeds() {
    is_as_stated_behind_a_change(30, Tracks::All);
}

fn is_as_stated_behind_a_change(runs: usize, tracks: Tracks) {
    for new_errors in [true, false] {
        let after = |statement| pose_after_a_change(runs, tracks, MovedPart::All, new_errors, statement);
        let (pose, jumps) = after(ChangeStatement::Drawn);
        is_consistent(&pose);
        assert_eq!(jumps, 0);
        // Without the process noise the same runs are overconfident.
        let (pose, _) = after(ChangeStatement::Nothing);
        assert_eq!(pose.pose.verdict, Verdict::Overconfident, "{:?}", pose.pose);
    }
}

#[test]
fn robots_in_a_corner_that_moved_and_outside_of_it_are_as_uncertain_as_they_err() {
    behind_a_moved_corner(
        3,
        Tracks::Few,
        &[(MovedPart::Within(25.0), false), (MovedPart::Beyond(25.0), false)],
    );
}

#[test]
#[ignore = "all seeds, minutes"]
fn robots_in_a_corner_that_moved_and_outside_of_it_with_all_seeds() {
    let parts = [MovedPart::All, MovedPart::Within(25.0), MovedPart::Beyond(25.0)];
    let cases: Vec<_> = parts.into_iter().flat_map(|part| [(part, true), (part, false)]).collect();
    behind_a_moved_corner(30, Tracks::All, &cases);
}

fn behind_a_moved_corner(runs: usize, tracks: Tracks, cases: &[(MovedPart, bool)]) {
    for &(part, new_errors) in cases {
        let after = |statement| pose_after_a_change(runs, tracks, part, new_errors, statement).0;
        let pose = after(ChangeStatement::Keyframes);
        for nees in [&pose.rotation, &pose.position, &pose.pose] {
            // Where a stated change moved nothing near the robot, it is more uncertain than it errs.
            assert!(nees.mean < nees.interval.1, "{part:?} {new_errors}: {nees:?}");
        }
        // Told one size for the whole map, the same robots err more.
        let by_size = after(ChangeStatement::Size);
        assert!(pose.rmse_m < by_size.rmse_m && pose.rmse_deg < by_size.rmse_deg, "{part:?} {new_errors}");
    }
}
