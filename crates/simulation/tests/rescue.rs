//! A state that is wrong without knowing it, and a map that goes on answering: the filter must give way.

use crate::{Tracks, loops};
use estimator::EstimatorConfig;
use simulation::monte_carlo::{AnswerOptions, Disturbance, DisturbedState, MonteCarloOptions, Variant, run};

/// Of each failure with one and with two cameras, in every run of the tests, and in the nightly one.
const SEEDS: usize = 1;
const ALL_SEEDS: usize = 10;

/// The failures, each of as many seeds with one and with two cameras.
const FAILURES: [DisturbedState; 8] = [
    DisturbedState::Position(1.0),
    DisturbedState::Position(10.0),
    DisturbedState::Position(100.0),
    DisturbedState::Velocity(5.0),
    DisturbedState::Yaw(0.174_533),
    DisturbedState::Yaw(std::f64::consts::FRAC_PI_2),
    DisturbedState::Tilt(0.087_266),
    DisturbedState::Biases(10.0),
];

#[test]
fn a_wrong_state_is_rescued_by_five_answers_and_never_trusted_for_long() {
    rescued(SEEDS);
}

/// Answers of a sparse map or a dark image: half of them verify with fewer than twenty matches, none with many more. They update the state
/// and are evidence against it.
#[test]
fn a_wrong_state_is_not_trusted_for_long_against_answers_of_few_matches() {
    let failures = [DisturbedState::Position(10.0), DisturbedState::Yaw(std::f64::consts::FRAC_PI_2)];
    let options = MonteCarloOptions {
        runs: 3,
        simulation: loops(3.0, 50.0, Tracks::Few),
        answers: AnswerOptions { every_s: 0.5, max_matches: 19, ..AnswerOptions::default() },
        disturbance: Some(Disturbance { at_s: 25.35, states: failures.to_vec() }),
        ..MonteCarloOptions::default()
    };
    let variant = Variant { name: "few matches".to_owned(), config: EstimatorConfig::default(), cameras: 2 };
    let all = run(&options, &[variant], |_| {}).unwrap();
    let rescues = all[0].trials.iter().flat_map(|trial| &trial.rescues);
    let (mut trusted, mut right) = (0, 0);
    for rescue in rescues {
        println!("{rescue:?}");
        trusted += usize::from(rescue.wrong_s > 0.0);
        right += usize::from(rescue.right.iter().any(|right| *right));
        assert!(rescue.wrong_s < 4.0, "{rescue:?}");
    }
    assert!(trusted > 0, "no run was localized before its failure");
    // What few answers show is often not certain enough for another pose.
    assert!(right > 0, "none of the poses was right again");
}

#[test]
#[ignore = "all seeds, minutes"]
fn a_wrong_state_is_rescued_by_five_answers_with_all_seeds() {
    rescued(ALL_SEEDS);
}

fn rescued(runs: usize) {
    let options = MonteCarloOptions {
        runs,
        simulation: loops(3.0, 26.0, Tracks::All),
        answers: AnswerOptions { every_s: 1.0, ..AnswerOptions::default() },
        disturbance: Some(Disturbance { at_s: 15.35, states: FAILURES.to_vec() }),
        ..MonteCarloOptions::default()
    };
    let variants = [1, 2].map(|cameras| Variant {
        name: format!("cameras {cameras}"),
        config: EstimatorConfig::default(),
        cameras,
    });
    let (mut all, mut late, mut never, mut trusted) = (0, Vec::new(), Vec::new(), Vec::new());
    for runs in run(&options, &variants, |_| {}).unwrap() {
        for trial in runs.trials {
            assert_eq!(trial.diverged, None, "{} seed {}", runs.variant.name, trial.seed);
            assert_eq!(trial.rescues.len(), FAILURES.len());
            for (state, rescue) in FAILURES.iter().zip(&trial.rescues) {
                all += 1;
                let what = format!("{state:?} {} seed {}", runs.variant.name, trial.seed);
                println!("{what}: {rescue:?}");
                // A failure of the biases shows later than one answer.
                let within = |answers: usize| rescue.right.iter().take(answers).skip(1).any(|right| *right);
                if !within(5) {
                    late.push(what.clone());
                }
                if !within(6) {
                    never.push(what.clone());
                }
                if rescue.wrong_s > 3.0 {
                    trusted.push(what);
                }
            }
        }
    }
    assert!(never.is_empty(), "{} of {all} not within six answers: {never:?}", never.len());
    // One in a hundred, and none of a few.
    let few = all / 100;
    assert!(late.len() <= few, "{} of {all} not within five answers: {late:?}", late.len());
    assert!(trusted.len() <= few, "wrong for 3 s while localized: {trusted:?}");
}
