//! A map is served anew while robots use it: what they believe of their pose in it, over Monte-Carlo runs and over a network.
#![allow(clippy::unwrap_used)]

use onboard::estimator::EstimatorConfig;
use onboard::evaluation::Verdict;
use tools::monte_carlo::score::{OutputScore, ScoreOptions, score};
use tools::monte_carlo::{
    AnswerOptions, CalibrationErrors, MapChangeOptions, MapOptions, MonteCarloOptions, Variant, run,
};
use tools::simulation::{Course, SimulationOptions};

/// Runs of 20 s of which the last 8 are judged: the map changed just before, by 0.3 m and 1.7 degrees an axis.
fn pose_after_a_change(new_errors: bool, is_stated: bool) -> (OutputScore, usize) {
    let change = MapChangeOptions { at_s: 12.0, sigma_theta: 0.03, sigma_p: 0.3, new_errors, is_stated };
    let options = MonteCarloOptions {
        runs: 30,
        first_seed: 1,
        threads: std::thread::available_parallelism().map_or(2, usize::from),
        simulation: SimulationOptions {
            course: Course::Loops,
            speed: 3.0,
            duration_s: Some(20.0),
            live_feature_period_s: 1e9,
            ..SimulationOptions::default()
        },
        map: MapOptions::default(),
        answers: AnswerOptions { every_s: 2.0, ..AnswerOptions::default() },
        map_change: Some(change),
        calibration: CalibrationErrors::default(),
    };
    let variant = Variant { name: "default".to_owned(), config: EstimatorConfig::default(), cameras: 2 };
    let all = run(&options, &[variant], |_| {}).unwrap().remove(0);
    let score = score(&all, &ScoreOptions { skip_after_first_fix_s: 0.0, ..ScoreOptions::default() });
    assert_eq!((score.runs, score.diverged, score.not_localized), (30, 0, 0));
    let pose = score.pose.unwrap();
    for (part, nees) in [("rotation", &pose.rotation), ("position", &pose.position), ("pose", &pose.pose)] {
        println!(
            "new errors {new_errors}, stated {is_stated}, {part}: {:.2}, {:.2?}",
            nees.mean, nees.interval
        );
    }
    println!("{:.3} m, {:.3} deg, {:?}", pose.rmse_m, pose.rmse_deg, score.map);
    (pose, score.map.jumps)
}

#[test]
fn nees_in_g_is_as_stated_behind_a_change_that_is_stated_and_above_it_without() {
    for new_errors in [true, false] {
        let (pose, jumps) = pose_after_a_change(new_errors, true);
        for nees in [&pose.rotation, &pose.position, &pose.pose] {
            assert!(matches!(nees.verdict, Verdict::Inside | Verdict::Near), "{nees:?}");
        }
        assert_eq!(jumps, 0);
        // The law has power: without the noise the same runs are overconfident.
        let (pose, _) = pose_after_a_change(new_errors, false);
        assert_eq!(pose.pose.verdict, Verdict::Overconfident, "{:?}", pose.pose);
    }
}
