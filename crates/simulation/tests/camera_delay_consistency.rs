//! Odometry of a hand-held stereo pair whose second camera is exposed later than the first, by a delay that its calibration states.

use crate::{Tracks, none_diverged, rms_error_m};
use estimator::{EstimatorConfig, MapMode};
use simulation::monte_carlo::score::{ScoreOptions, score};
use simulation::monte_carlo::{MonteCarloOptions, Variant, VariantRuns, run};
use simulation::{Scenario, SimulationOptions};

/// Seeds of every run, and of the nightly one.
const RUNS: usize = 2;
const ALL_RUNS: usize = 3;
const FIRST_SEED: u64 = 41;

fn odometry(runs: usize, second_delay_s: f64) -> VariantRuns {
    let mut config = EstimatorConfig::default();
    config.mode = MapMode::Odometry;
    let options = MonteCarloOptions {
        runs,
        first_seed: FIRST_SEED,
        threads: std::thread::available_parallelism().map_or(2, usize::from),
        simulation: SimulationOptions {
            scenario: Scenario::Room,
            depth_m: Scenario::Room.depth_m(),
            frame_rate_hz: 20.0,
            second_delay_s,
            max_tracks: Tracks::Few.max(),
            duration_s: Some(30.0),
            live_feature_period_s: 1e9,
            ..SimulationOptions::default()
        },
        ..MonteCarloOptions::default()
    };
    run(&options, &[Variant { name: "odometry".to_owned(), config, cameras: 2 }], |_| {}).unwrap().remove(0)
}

#[test]
fn a_camera_with_a_delay_is_as_good_as_one_without() {
    is_as_good_as_one_without(RUNS);
}

#[test]
#[ignore = "all seeds"]
fn a_camera_with_a_delay_is_as_good_as_one_without_with_all_seeds() {
    is_as_good_as_one_without(ALL_RUNS);
}

fn is_as_good_as_one_without(count: usize) {
    let (together, late) = (odometry(count, 0.0), odometry(count, 0.005));
    none_diverged(&together);
    none_diverged(&late);
    for (one, other) in together.trials.iter().zip(&late.trials) {
        assert!(one.errors != other.errors, "seed {}: the delay changes nothing", one.seed);
    }
    let [together_m, late_m] =
        [&together, &late].map(|runs| runs.trials.iter().map(rms_error_m).sum::<f64>() / count as f64);
    let nees = score(&late, &ScoreOptions::default()).local.unwrap().pose.mean;
    println!("together {together_m:.4} m, late {late_m:.4} m, NEES {nees:.2}");
    assert!(late_m < 1.2 * together_m, "{late_m} of {together_m}");
    assert!((0.4..=1.4).contains(&nees), "{nees}");
}
