//! GNSS over Monte-Carlo runs: between two stretches with a map, and without any.

use crate::{Tracks, none_diverged};
use estimator::{EstimatorConfig, GnssConfig, MapMode};
use simulation::SimulationOptions;
use simulation::monte_carlo::score::{ScoreOptions, score};
use simulation::monte_carlo::{
    AnswerOptions, GnssJump, GnssOptions, MonteCarloOptions, Trial, Variant, VariantRuns, run,
};

/// Seeds of every run, and of the nightly one.
const RUNS: usize = 4;
const ALL_RUNS: usize = 20;
/// Of these, those in which GNSS must not be worse.
const MOST_RUNS: usize = 19;
/// An error that is smaller by less is the same, metres.
const SAME_M: f64 = 0.005;

fn antenna() -> GnssConfig {
    let mut antenna = GnssConfig::at([-0.3, 0.2, 0.6]);
    antenna.correlation_time_s = 10.0;
    antenna
}

/// A receiver with corrections: a decimetre.
fn corrected() -> GnssOptions {
    GnssOptions { sigma_m: [0.1, 0.1, 0.2], ..GnssOptions::new(antenna()) }
}

fn variant(mode: MapMode, gnss: Option<GnssConfig>) -> Variant {
    let mut config = EstimatorConfig::default();
    (config.mode, config.gnss) = (mode, gnss);
    Variant { name: if gnss.is_some() { "with GNSS" } else { "without" }.to_owned(), config, cameras: 1 }
}

/// Round a block with one camera and an IMU with four times its stated noise; a map for the first 12 s only.
fn runs(
    count: usize,
    seconds: f64,
    tracks: Tracks,
    gnss: &GnssOptions,
    variants: &[Variant],
) -> Vec<VariantRuns> {
    let options = MonteCarloOptions {
        runs: count,
        simulation: SimulationOptions {
            imu_noise_scale: 4.0,
            max_tracks: tracks.max(),
            duration_s: Some(seconds),
            live_feature_period_s: 1e9,
            ..SimulationOptions::default()
        },
        answers: AnswerOptions { gaps_s: vec![12.0..1e9], ..AnswerOptions::default() },
        gnss: Some(gnss.clone()),
        ..MonteCarloOptions::default()
    };
    run(&options, variants, |_| {}).unwrap()
}

/// Root mean square error of the position in G from a time on, metres; infinite without one, and for a run that ended early.
fn rms_in_global_m(trial: &Trial, from_s: f64) -> f64 {
    let Some(errors) = trial.errors.as_ref().filter(|_| trial.diverged.is_none()) else {
        return f64::INFINITY;
    };
    let from_ns = trial.begin_ns + (from_s * 1e9) as i64;
    let late = errors.pose.iter().filter(|sample| sample.stamp_ns >= from_ns);
    let squares: Vec<f64> = late.map(|sample| sample.error.fixed_rows::<3>(3).norm_squared()).collect();
    if squares.is_empty() {
        f64::INFINITY
    } else {
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }
}

fn between_maps(count: usize, tracks: Tracks) {
    let gnss = corrected();
    let variants = [variant(MapMode::Multi, None), variant(MapMode::Multi, Some(gnss.antenna))];
    let all = runs(count, 60.0, tracks, &gnss, &variants);
    let mut better = 0;
    for (without, with) in all[0].trials.iter().zip(&all[1].trials) {
        let [alone, helped] = [without, with].map(|trial| rms_in_global_m(trial, 12.0));
        println!("seed {}: {alone:.3} m without, {helped:.3} m with, {:?}", with.seed, with.gnss.unwrap());
        better += usize::from(helped <= alone + SAME_M);
    }
    let [without, with] = [&all[0], &all[1]].map(|all| score(all, &ScoreOptions::default()));
    assert_eq!((without.diverged, with.diverged), (0, 0));
    for (name, score) in [("without", &without), ("with", &with)] {
        for (output, of) in [("in G", &score.pose), ("local", &score.local), ("transform", &score.transform)]
        {
            let of = of.as_ref().unwrap();
            println!(
                "{name}, {output}: {:.3} m, NEES {:.2} {:.2} {:.2}",
                of.rmse_m, of.rotation.mean, of.position.mean, of.pose.mean
            );
        }
    }
    assert!(better * ALL_RUNS >= MOST_RUNS * count, "better in {better} of {count}");
    let with = with.pose.unwrap();
    assert_eq!(with.pose.runs, count, "all runs are in the NEES");
    assert!((0.7..=1.4).contains(&with.pose.mean), "{:?}", with.pose);
    assert!(with.rmse_m < without.pose.unwrap().rmse_m);
}

#[test]
fn a_robot_that_leaves_its_map_is_consistent_and_better_with_gnss() {
    between_maps(RUNS, Tracks::Few);
}

#[test]
#[ignore = "all seeds, minutes"]
fn a_robot_that_leaves_its_map_is_consistent_and_better_with_gnss_with_all_seeds() {
    between_maps(ALL_RUNS, Tracks::All);
}

fn without_a_map(count: usize, tracks: Tracks) {
    let gnss = corrected();
    let all = runs(count, 60.0, tracks, &gnss, &[variant(MapMode::Odometry, Some(gnss.antenna))]);
    for trial in &all[0].trials {
        let begin_s = trial.map_initialization_s.unwrap_or(f64::NAN);
        println!(
            "seed {}: from {begin_s:.0} s on {:.3} m, {:?}",
            trial.seed,
            rms_in_global_m(trial, begin_s),
            trial.gnss.unwrap()
        );
        assert!((3.0..60.0).contains(&begin_s), "{begin_s}");
    }
    let score = score(&all[0], &ScoreOptions { skip_after_initialization_s: 0.0, ..ScoreOptions::default() });
    assert_eq!(score.diverged, 0);
    let pose = score.pose.unwrap();
    assert_eq!(pose.pose.runs, count, "all runs are in the NEES");
    println!(
        "in G: {:.3} m, {:.2} deg, NEES {:.2} {:.2} {:.2}",
        pose.rmse_m, pose.rmse_deg, pose.rotation.mean, pose.position.mean, pose.pose.mean
    );
    // Conservative: odometry's covariance until then is added as if it were independent.
    assert!((0.3..=1.4).contains(&pose.pose.mean), "{:?}", pose.pose);
}

#[test]
fn positions_alone_localize_after_some_way() {
    without_a_map(RUNS, Tracks::Few);
}

#[test]
#[ignore = "all seeds, minutes"]
fn positions_alone_localize_after_some_way_with_all_seeds() {
    without_a_map(ALL_RUNS, Tracks::All);
}

/// Reflections of 6 m for 8 s, and of 20 m for one reading: they are rejected, and cost nothing.
#[test]
fn jumps_are_gated() {
    jumps_of_runs_are_gated(2);
}

#[test]
#[ignore = "all seeds"]
fn jumps_are_gated_with_all_seeds() {
    jumps_of_runs_are_gated(3);
}

fn jumps_of_runs_are_gated(count: usize) {
    let mut gnss = corrected();
    let with = [variant(MapMode::Multi, Some(gnss.antenna))];
    let clean = runs(count, 50.0, Tracks::Few, &gnss, &with);
    let jump = |from_s: f64, to_s: f64, offset_m| GnssJump { span_s: from_s..to_s, offset_m };
    gnss.jumps = vec![jump(24.5, 32.5, [4.0, -4.0, 2.0]), jump(40.5, 41.5, [0.0, 20.0, 0.0])];
    let jumping = runs(count, 50.0, Tracks::Few, &gnss, &with);
    clean.iter().chain(&jumping).for_each(none_diverged);
    for (clean, jumping) in clean[0].trials.iter().zip(&jumping[0].trials) {
        let counts = jumping.gnss.unwrap();
        let [one, other] = [clean, jumping].map(|trial| rms_in_global_m(trial, 12.0));
        println!("{one:.3} m, with jumps {other:.3} m: {counts:?}");
        assert!(counts.gated + counts.left_out >= 9, "{counts:?}");
        assert_eq!(counts.initializations, 0);
        assert!(other < one + 0.3);
    }
}

/// A constant offset of 30 m from 15 s on: GNSS is left out and named, and the state stays.
#[test]
fn positions_of_another_place_are_left_out_and_named() {
    another_place_is_left_out(2);
}

#[test]
#[ignore = "all seeds"]
fn positions_of_another_place_are_left_out_and_named_with_all_seeds() {
    another_place_is_left_out(3);
}

fn another_place_is_left_out(count: usize) {
    let mut gnss = corrected();
    gnss.jumps = vec![GnssJump { span_s: 15.0..1e9, offset_m: [30.0, 0.0, 0.0] }];
    let variants = [variant(MapMode::Multi, None), variant(MapMode::Multi, Some(gnss.antenna))];
    let all = runs(count, 50.0, Tracks::Few, &gnss, &variants);
    all.iter().for_each(none_diverged);
    for (without, with) in all[0].trials.iter().zip(&all[1].trials) {
        let [alone, misled] = [without, with].map(|trial| rms_in_global_m(trial, 12.0));
        let left_out_s = with.gnss_left_out_s.unwrap();
        println!(
            "left out after {left_out_s:.1} s, {alone:.3} m without, {misled:.3} m with, {:?}",
            with.gnss
        );
        assert!(left_out_s < 30.0);
        assert!(misled < alone + 0.3);
    }
}
