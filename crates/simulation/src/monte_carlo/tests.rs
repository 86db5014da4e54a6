//! Laws of the Monte-Carlo runs.

use super::*;
use crate::Scenario;
use estimator::{AdaptiveNoise, MapMode};
use evaluation::nees_bounds;
use evaluation::trajectory::StateKind;

/// Short runs in motion.
fn options(runs: usize, seconds: f64) -> MonteCarloOptions {
    let scenario = Scenario::Loops;
    MonteCarloOptions {
        runs,
        first_seed: 40,
        threads: 2,
        simulation: SimulationOptions {
            scenario,
            speed: scenario.usual_speed(),
            depth_m: scenario.depth_m(),
            max_tracks: 50,
            duration_s: Some(seconds),
            live_feature_period_s: 1e9,
            ..SimulationOptions::default()
        },
        map: MapOptions::default(),
        answers: AnswerOptions::default(),
        map_change: None,
        calibration: CalibrationErrors::default(),
        ..MonteCarloOptions::default()
    }
}

fn variant(mode: MapMode) -> Variant {
    let mut config = EstimatorConfig::default();
    config.mode = mode;
    Variant { name: format!("{mode:?}"), config, cameras: 2 }
}

fn errors(all: &VariantRuns) -> Vec<String> {
    all.trials.iter().map(|trial| format!("{:?} {:?}", trial.errors, trial.map)).collect()
}

#[test]
fn the_result_depends_on_the_seeds_and_on_nothing_else() {
    let options = options(3, 4.0);
    let alone = run(&MonteCarloOptions { threads: 1, ..options.clone() }, &[variant(MapMode::Multi)], |_| {});
    let both = [variant(MapMode::Odometry), variant(MapMode::Multi)];
    let (alone, beside) = (alone.unwrap(), run(&options, &both, |_| {}).unwrap());
    assert_eq!(errors(&alone[0]), errors(&beside[1]));
    let others =
        run(&MonteCarloOptions { first_seed: 50, ..options }, &[variant(MapMode::Multi)], |_| {}).unwrap();
    assert_ne!(errors(&alone[0]), errors(&others[0]));
}

#[test]
fn first_estimates_are_off_by_what_their_covariance_says() {
    // Only the first image counts: what the filter does to it afterwards is not judged here.
    let runs = 60;
    let all = run(&options(runs, 1.0), &[variant(MapMode::Odometry)], |_| {}).unwrap();
    let first: Vec<f64> = all[0]
        .trials
        .iter()
        .map(|trial| trial.errors.as_ref().unwrap().local[0].nees.unwrap().pose)
        .collect();
    let mean = first.iter().sum::<f64>() / runs as f64;
    let (low, high) = nees_bounds(6, runs, 0.999).unwrap();
    assert!((low..high).contains(&mean), "{mean}");
}

#[test]
fn a_good_map_helps_and_a_gap_gives_no_answers() {
    let modes = [variant(MapMode::Odometry), variant(MapMode::Multi)];
    let mut options = options(4, 20.0);
    let all = run(&options, &modes, |_| {}).unwrap();
    let scoring = score::ScoreOptions::default();
    let (odometry, multi) = (score(&all[0], &scoring), score(&all[1], &scoring));
    assert!(odometry.pose.is_none() && odometry.map == MapCounts::default());
    assert!(multi.map.answers >= 4 * 15 && 10 * multi.map.used >= 9 * multi.map.answers, "{multi:?}");
    assert_eq!((multi.not_localized, multi.diverged, multi.map.jumps), (0, 0, 0));
    assert!(multi.get(StateKind::GlobalFromImu).unwrap().rmse_m < 0.5);

    options.answers.gaps_s = vec![5.0..15.0];
    let with_gap = score(&run(&options, &modes[1..], |_| {}).unwrap()[0], &scoring);
    assert_eq!(with_gap.map.answers + 4 * 10, multi.map.answers);
}

#[test]
fn wrong_places_are_answered_as_often_as_asked_for_and_never_first() {
    let mut options = options(6, 15.0);
    options.answers.wrong_place = 0.25;
    let all = run(&options, &[variant(MapMode::Multi)], |_| {}).unwrap();
    let counts = score(&all[0], &score::ScoreOptions::default()).map;
    let share = counts.wrong_places as f64 / (counts.wrong_places + counts.answers) as f64;
    assert!((0.1..0.4).contains(&share), "{counts:?}");
    for trial in &all[0].trials {
        let first = trial.errors.as_ref().unwrap().transform[0].error.fixed_rows::<3>(3).norm();
        assert!(first < 5.0, "the first answer of seed {} is {first} m off", trial.seed);
    }
}

#[test]
fn the_stated_calibration_has_errors_of_the_given_magnitudes() {
    let mut options = options(8, 1.0);
    options.calibration = CalibrationErrors {
        rotation_rad: 2_f64.to_radians(),
        translation_m: 0.03,
        time_offset_s: 0.01,
        focal_fraction: 0.01,
    };
    let all = run(&options, &[variant(MapMode::Odometry)], |_| {}).unwrap();
    let mut signs = Vec::new();
    for trial in &all[0].trials {
        assert_eq!(trial.stated_calibration.len(), 2);
        for error in &trial.stated_calibration {
            assert!((error.deg - 2.0).abs() < 1e-9 && (error.m - 0.03).abs() < 1e-12, "{error:?}");
            assert!((error.seconds.abs() - 0.01).abs() < 1e-12);
            assert!((error.focal_fraction - 0.01).abs() < 1e-12);
        }
        signs.push(trial.stated_calibration[0].seconds.signum());
    }
    signs.dedup();
    assert!(signs.len() > 1, "both signs come up");
}

#[test]
fn a_covariance_that_is_too_small_is_called_so() {
    let mut bold = variant(MapMode::Odometry);
    bold.config.sigma_track_px = 0.3;
    bold.config.adaptive_noise = AdaptiveNoise::NONE;
    let mut options = options(12, 12.0);
    options.simulation.max_tracks = SimulationOptions::default().max_tracks;
    let all = run(&options, &[variant(MapMode::Odometry), bold], |_| {}).unwrap();
    let verdicts: Vec<_> = all
        .iter()
        .map(|runs| score(runs, &score::ScoreOptions::default()).local.unwrap().pose.verdict)
        .collect();
    assert!(verdicts[0].passes() && !verdicts[1].passes(), "{verdicts:?}");
    let text = report::table(
        "title",
        &all,
        &all.iter().map(|runs| score(runs, &score::ScoreOptions::default())).collect::<Vec<_>>(),
    );
    assert!(text.contains("ok") && text.contains("HIGH") && text.contains("12 runs"), "{text}");
}
