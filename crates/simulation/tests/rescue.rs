//! A state that is wrong without knowing it, and a map that goes on answering: the filter must give way.

use estimator::EstimatorConfig;
use simulation::monte_carlo::{
    AnswerOptions, Disturbance, DisturbedState, MonteCarloOptions, Rescue, Variant, run,
};
use simulation::{Scenario, SimulationOptions};

const SEEDS: usize = 10;

/// The failures, each with as many seeds and one or two cameras.
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

fn rescues(state: DisturbedState, cameras: usize) -> Vec<Rescue> {
    let options = MonteCarloOptions {
        runs: SEEDS,
        simulation: SimulationOptions {
            scenario: Scenario::Loops,
            speed: 3.0,
            duration_s: Some(26.0),
            live_feature_period_s: 1e9,
            ..SimulationOptions::default()
        },
        answers: AnswerOptions { every_s: 1.0, ..AnswerOptions::default() },
        disturbance: Some(Disturbance { at_s: 15.35, state }),
        ..MonteCarloOptions::default()
    };
    let variant = Variant { name: "default".to_owned(), config: EstimatorConfig::default(), cameras };
    let trials = run(&options, &[variant], |_| {}).unwrap().remove(0).trials;
    let rescue = |trial: simulation::monte_carlo::Trial| {
        assert_eq!(trial.diverged, None, "seed {}", trial.seed);
        trial.rescue.unwrap()
    };
    trials.into_iter().map(rescue).collect()
}

#[test]
fn a_wrong_state_is_rescued_by_five_answers_and_never_trusted_for_long() {
    let (mut all, mut late, mut never, mut trusted) = (0, Vec::new(), Vec::new(), Vec::new());
    for state in FAILURES {
        for cameras in [1, 2] {
            for (seed, rescue) in rescues(state, cameras).into_iter().enumerate() {
                all += 1;
                println!("{state:?} cameras {cameras} seed {}: {rescue:?}", seed + 1);
                // A failure of the biases shows later than one answer.
                let within = |answers: usize| rescue.right.iter().take(answers).skip(1).any(|right| *right);
                let what = format!("{state:?} cameras {cameras} seed {}", seed + 1);
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
    assert!(late.len() * 100 <= all, "{} of {all} not within five answers: {late:?}", late.len());
    assert!(trusted.len() * 100 <= all, "wrong for 3 s while localized: {trusted:?}");
}
