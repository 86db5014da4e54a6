//! Many sessions in one world, whose landmarks are moved between them.

use nalgebra::Vector3;
use rand::RngExt as _;
use sensors::{CameraSensor, Sequence};

use super::random::{Purpose, normal3, stream};
use super::run::{Kind, Run, record};
use super::world::Landmark;
use super::{SimulationError, SimulationOptions, path, simulate_world};

/// Standard deviation of a moved landmark about another one, metres an axis.
const SIGMA_MOVED_M: f64 = 0.5;

/// A world that changes, and in which robots record sessions.
///
/// # Example
/// ```
/// use simulation::{ChangingPlace, Scenario, SimulationOptions};
///
/// let mut options = SimulationOptions::default();
/// options.scenario = Scenario::Room;
/// options.duration_s = Some(5.0);
/// let mut place = ChangingPlace::new(&options)?;
/// let monday = place.record(1, 1_700_000_000_000_000_000)?;
/// place.move_landmarks(0.1, 1);
/// let tuesday = place.record(2, 1_700_086_400_000_000_000)?;
/// assert!(monday.frames.last().map(|frame| frame.stamp_ns) < tuesday.frames.first().map(|frame| frame.stamp_ns));
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug)]
pub struct ChangingPlace {
    options: SimulationOptions,
    cameras: Vec<CameraSensor>,
    landmarks: Vec<Landmark>,
}

impl ChangingPlace {
    /// The world of a simulation, as in [`simulate`](crate::simulate).
    ///
    /// # Errors
    /// [`SimulationError`].
    pub fn new(options: &SimulationOptions) -> Result<ChangingPlace, SimulationError> {
        let world = simulate_world(options)?;
        Ok(ChangingPlace { options: options.clone(), cameras: world.cameras, landmarks: world.landmarks })
    }

    /// Moves landmarks to where others are, each with this probability.
    ///
    /// # Arguments
    /// * `change`: number of the change: the same moves the same ones.
    ///
    /// # Returns
    /// How many were moved.
    pub fn move_landmarks(&mut self, probability: f64, change: u64) -> usize {
        let mut rng = stream(self.options.seed, change, Purpose::MovedLandmarks);
        let mut moved = 0;
        for at in 0..self.landmarks.len() {
            if rng.random_bool(probability) {
                let other = self.landmarks[rng.random_range(0..self.landmarks.len())].position;
                self.landmarks[at].position = other + normal3(&mut rng) * SIGMA_MOVED_M;
                moved += 1;
            }
        }
        moved
    }

    /// Records a session along the built-in scenario, with drop-outs as the options state them.
    ///
    /// # Arguments
    /// * `session`: its number, from 1 on: noise and trajectory differ from session to session.
    /// * `begin_ns`: time of its first reading (ns).
    ///
    /// # Errors
    /// [`SimulationError`].
    pub fn record(&self, session: u64, begin_ns: i64) -> Result<Sequence, SimulationError> {
        let options = &self.options;
        let style = path::Style::of_run(options.seed, session);
        let mut trajectory = path::built_in(options.scenario, begin_ns, options.speed, &style)?;
        if let Some(seconds) = options.duration_s {
            trajectory = trajectory.until(begin_ns + (seconds * 1e9) as i64);
        }
        let run = Run { kind: Kind::Live, number: session };
        Ok(record(options, run, &trajectory, &self.cameras, &self.landmarks))
    }

    /// Where its landmarks are now, in the world (m).
    pub fn landmark_positions(&self) -> impl Iterator<Item = Vector3<f64>> {
        self.landmarks.iter().map(|landmark| landmark.position)
    }
}
