//! The odometry knows how wrong it is: NEES over Monte-Carlo runs, each of which starts from a drawn state.
#![allow(clippy::unwrap_used)]

use onboard::estimator::{EstimatorConfig, MapMode};
use onboard::evaluation::Verdict;
use tools::monte_carlo::score::{ScoreOptions, score};
use tools::monte_carlo::{
    AnswerOptions, CalibrationErrors, MapOptions, MonteCarloOptions, Variant, VariantRuns, run,
};
use tools::simulation::{Course, SimulationOptions};

/// As many runs as a chi-square interval is worth looking at for.
const RUNS: usize = 20;

/// A hand in a room, from rest: every direction is turned about and accelerated along.
fn runs(variants: &[Variant]) -> Vec<VariantRuns> {
    let course = Course::Room;
    let options = MonteCarloOptions {
        runs: RUNS,
        first_seed: 1,
        threads: std::thread::available_parallelism().map_or(2, usize::from),
        simulation: SimulationOptions {
            course,
            speed: course.usual_speed(),
            depth_m: course.depth_m(),
            duration_s: Some(60.0),
            live_feature_period_s: 1e9,
            ..SimulationOptions::default()
        },
        map: MapOptions::default(),
        answers: AnswerOptions::default(),
        calibration: CalibrationErrors::default(),
    };
    run(&options, variants, |_| {}).unwrap()
}

fn odometry(name: &str, cameras: usize) -> Variant {
    let config = EstimatorConfig { mode: MapMode::Odometry, ..EstimatorConfig::default() };
    Variant { name: name.to_owned(), config, cameras }
}

#[test]
fn nees_of_the_odometry_is_within_its_95_percent_interval() {
    for all in runs(&[odometry("mono", 1), odometry("stereo", 2)]) {
        let score = score(&all, &ScoreOptions::default());
        assert_eq!((score.runs, score.diverged), (RUNS, 0), "{}", score.name);
        let local = score.local.unwrap();
        for (part, nees) in
            [("rotation", &local.rotation), ("position", &local.position), ("pose", &local.pose)]
        {
            println!("{} {part}: {:.2}, {:.2?}", score.name, nees.mean, nees.interval);
            assert_eq!(nees.verdict, Verdict::Inside, "{} {part}: {nees:?}", score.name);
        }
    }
}
