//! Odometry with rolling shutters over Monte-Carlo runs of a hand-held body: against filters that do not know of it, and against the same
//! runs with global shutters.

use crate::{Tracks, none_diverged, rms_error_m};
use estimator::{EstimatorConfig, MapMode};
use simulation::monte_carlo::score::{ScoreOptions, score};
use simulation::monte_carlo::{MonteCarloOptions, OutputScore, Variant, VariantRuns, run};
use simulation::{Scenario, SimulationOptions};

/// Seeds of every run, and of the nightly one.
const RUNS: usize = 2;
const ALL_RUNS: usize = 20;
/// Of these, those in which a filter that knows the readout time must not be worse than one that does not.
const MOST_RUNS: usize = 19;
const FIRST_SEED: u64 = 21;
/// From the first row to that after the last one, seconds.
const READOUT_S: f64 = 0.02;

/// A filter that is told a readout time instead of the true one, and whether it estimates it.
fn odometry(name: &str, cameras: usize, readout_s: Option<f64>, estimates: bool) -> Variant {
    let mut config = EstimatorConfig::default();
    config.mode = MapMode::Odometry;
    config.readout_times_s = readout_s.into_iter().collect();
    config.calibration.readout_time = estimates;
    Variant { name: name.to_owned(), config, cameras }
}

fn runs(count: usize, tracks: Tracks, readout_s: f64, variants: &[Variant]) -> Vec<VariantRuns> {
    let options = MonteCarloOptions {
        runs: count,
        first_seed: FIRST_SEED,
        threads: std::thread::available_parallelism().map_or(2, usize::from),
        simulation: SimulationOptions {
            scenario: Scenario::Room,
            depth_m: Scenario::Room.depth_m(),
            frame_rate_hz: 20.0,
            readout_s,
            max_tracks: tracks.max(),
            duration_s: Some(30.0),
            live_feature_period_s: 1e9,
            ..SimulationOptions::default()
        },
        ..MonteCarloOptions::default()
    };
    run(&options, variants, |_| {}).unwrap()
}

fn scored(all: &VariantRuns) -> OutputScore {
    let scored = score(all, &ScoreOptions::default());
    for trial in &all.trials {
        if let Some(reason) = &trial.diverged {
            println!("seed {}: {reason}", trial.seed);
        }
    }
    let local = scored.local.unwrap();
    let [rotation, position, pose] = [&local.rotation, &local.position, &local.pose].map(|nees| nees.mean);
    println!(
        "{}: {} of {} diverged, {:.3} deg {:.3} m, NEES {rotation:.2} {position:.2} {pose:.2}",
        scored.name, scored.diverged, scored.runs, local.rmse_deg, local.rmse_m
    );
    local
}

/// Of one or two cameras.
fn is_as_good_as_a_global_shutter(count: usize, tracks: Tracks, cameras: usize) {
    let variants = [
        odometry("not known of", cameras, Some(0.0), false),
        odometry("known", cameras, None, false),
        odometry("estimated", cameras, Some(0.0), true),
    ];
    let all = runs(count, tracks, READOUT_S, &variants);
    let [without, known, estimated] = &all[..] else { panic!("three variants") };
    let global = runs(count, tracks, 0.0, &[odometry("global shutter", cameras, None, false)]);
    let global_score = scored(&global[0]);
    none_diverged(&global[0]);
    scored(without);
    for with in [known, estimated] {
        let local = scored(with);
        none_diverged(with);
        // These runs are conservative with global shutters already; rolling ones must not be more so.
        let least = 0.7_f64.min(0.9 * global_score.pose.mean);
        assert!((least..=1.4).contains(&local.pose.mean), "{:?}", local.pose);
        assert!(local.rmse_m < 1.2 * global_score.rmse_m, "{} of {}", local.rmse_m, global_score.rmse_m);
        let pairs = without.trials.iter().zip(&with.trials);
        let better = pairs.filter(|(without, with)| rms_error_m(with) <= rms_error_m(without)).count();
        println!("better in {better} of {count}");
        assert!(better * ALL_RUNS >= MOST_RUNS * count, "better in {better} of {count}");
    }
    for trial in &estimated.trials {
        for found in trial.readout_times.as_ref().unwrap() {
            let error = found.value - READOUT_S;
            println!("seed {}: {:+.3} ms, sigma {:.3} ms", trial.seed, error * 1e3, found.sigma * 1e3);
            assert!(error.abs() < 2e-3 && error.abs() < 4.0 * found.sigma);
        }
    }
}

#[test]
fn one_rolling_shutter_is_as_good_as_a_global_one() {
    is_as_good_as_a_global_shutter(RUNS, Tracks::Few, 1);
}

#[test]
#[ignore = "all seeds, minutes"]
fn one_rolling_shutter_is_as_good_as_a_global_one_with_all_seeds() {
    is_as_good_as_a_global_shutter(ALL_RUNS, Tracks::All, 1);
}

#[test]
#[ignore = "all seeds, minutes"]
fn two_rolling_shutters_are_as_good_as_global_ones_with_all_seeds() {
    is_as_good_as_a_global_shutter(ALL_RUNS, Tracks::All, 2);
}
