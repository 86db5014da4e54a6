//! A robot that stands, and one that creeps among features so far away that half a second does not show it.

use crate::{none_diverged, rms_error_m};
use estimator::{EstimatorConfig, MapMode};
use evaluation::trajectory::StampedPose;
use geometry::{Pose, Rotation};
use nalgebra::Vector3;
use simulation::SimulationOptions;
use simulation::monte_carlo::score::{ScoreOptions, score};
use simulation::monte_carlo::{FilterStart, MonteCarloOptions, Variant, VariantRuns, run};

const RUNS: usize = 4;
/// Rest before the robot creeps, and time to its speed, seconds.
const REST_S: f64 = 4.0;
const SPEED_UP_S: f64 = 2.0;
/// Distance of the features in a yard, metres.
const YARD_M: [f64; 2] = [15.0, 25.0];

/// Straight ahead at a speed (m/s) after a rest.
fn creep(seconds: f64, speed: f64) -> Vec<StampedPose> {
    let pose = |tenth: i64| {
        let driven = (tenth as f64 * 0.1 - REST_S).max(0.0);
        let way = speed
            * if driven < SPEED_UP_S {
                driven * driven / (2.0 * SPEED_UP_S)
            } else {
                driven - SPEED_UP_S / 2.0
            };
        let pose = Pose::new(Rotation::identity(), Vector3::new(way, 0.0, 0.0));
        StampedPose { stamp_ns: tenth * 100_000_000, pose }
    };
    (0..=(seconds * 10.0) as i64).map(pose).collect()
}

fn runs(seconds: f64, speed: f64) -> VariantRuns {
    let trajectory = creep(seconds + 6.0, speed);
    let options = MonteCarloOptions {
        runs: RUNS,
        simulation: SimulationOptions {
            depth_m: YARD_M,
            map_trajectory: Some(trajectory.clone()),
            live_trajectory: Some(trajectory),
            duration_s: Some(seconds),
            live_feature_period_s: 1e9,
            ..SimulationOptions::default()
        },
        start: FilterStart::Initialization,
        ..MonteCarloOptions::default()
    };
    let mut config = EstimatorConfig::default();
    config.mode = MapMode::Odometry;
    let variant = Variant { name: format!("{speed} m/s"), config, cameras: 1 };
    let all = run(&options, &[variant], |_| {}).unwrap().remove(0);
    none_diverged(&all);
    all
}

#[test]
fn a_robot_that_creeps_through_a_yard_does_not_claim_to_stand() {
    for speed in [0.02, 0.04] {
        let all = runs(60.0, speed);
        let local = score(&all, &ScoreOptions::default()).local.unwrap();
        println!(
            "{speed} m/s: {:.2} m, NEES {:.2} {:.2}",
            local.rmse_m, local.position.mean, local.pose.mean
        );
        assert!(local.position.mean < 2.5, "{speed} m/s: {:?}", local.position);
    }
}

#[test]
fn a_robot_that_stands_for_minutes_holds_its_position() {
    let all = runs(180.0, 0.0);
    let local = score(&all, &ScoreOptions::default()).local.unwrap();
    println!("{:.3} m, NEES {:.2} {:.2}", local.rmse_m, local.position.mean, local.pose.mean);
    for trial in &all.trials {
        assert!(rms_error_m(trial) < 0.1, "seed {}: {} m", trial.seed, rms_error_m(trial));
    }
}
