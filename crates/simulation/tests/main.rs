//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

/// Tracks in an image. What is tested holds for any number of them; the filter's work grows with it.
#[derive(Clone, Copy)]
enum Tracks {
    /// In every test run.
    Few,
    /// In the nightly one: as many as by default.
    All,
}

impl Tracks {
    fn max(self) -> usize {
        match self {
            Self::Few => 50,
            Self::All => simulation::SimulationOptions::default().max_tracks,
        }
    }
}

/// Rounds through a scenario of loops; the answers of the map are simulated, so that images need no features.
fn loops(speed: f64, duration_s: f64, tracks: Tracks) -> simulation::SimulationOptions {
    simulation::SimulationOptions {
        scenario: simulation::Scenario::Loops,
        speed,
        max_tracks: tracks.max(),
        duration_s: Some(duration_s),
        live_feature_period_s: 1e9,
        ..simulation::SimulationOptions::default()
    }
}

/// Asserts that every run came to its end: the errors of one that did not are those until then.
fn none_diverged(all: &simulation::monte_carlo::VariantRuns) {
    for trial in &all.trials {
        assert_eq!(trial.diverged, None, "{}, seed {}", all.variant.name, trial.seed);
    }
}

/// Root mean square error of the position in L, metres; infinite without one, and for a run that ended early.
fn rms_error_m(trial: &simulation::monte_carlo::Trial) -> f64 {
    let Some(errors) = trial.errors.as_ref().filter(|_| trial.diverged.is_none()) else {
        return f64::INFINITY;
    };
    let squares: f64 = errors.local.iter().map(|sample| sample.error.fixed_rows::<3>(3).norm_squared()).sum();
    (squares / errors.local.len() as f64).sqrt()
}

mod camera_delay_consistency;
mod gnss_consistency;
mod lying_map;
mod map_change_consistency;
mod map_consistency;
mod odometry_consistency;
mod rendered_flights;
mod rescue;
mod rolling_shutter_consistency;
mod wheel_consistency;
