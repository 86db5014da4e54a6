//! Keeps a map true by the sessions that its robots hand in.
//!
//! [`take_session`] works one session into a map:
//!
//! 1. It is refused where the ledger has it, where it shows no place of the map, and where it contradicts the map ([`Refusal`]).
//! 2. It is located in the map, whose poses stay as they are ([`mapping::MapPoses::Considered`]).
//! 3. Which landmarks its keyframes saw, and which they should have seen, changes the probability that each is there
//!    ([`ExistenceModel`], [`DetectionRates`]), once a drive. What is gone is taken out.
//! 4. Of each place, so many keyframes of each appearance, and so many landmarks, stay as [`Settings`] say: the map is as large as what it covers.
//!
//! Derivation: `docs/src/derivations/existence.md`.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod appearance;
mod coverage;
mod drive;
mod existence;
mod gone;
mod map_index;
mod places;
mod position_grid;
mod rates;
mod refusal;
mod report;
mod session;
mod settings;
mod sightings;
#[cfg(test)]
mod tests;

pub use existence::{ExistenceModel, log_odds, probability};
pub use rates::DetectionRates;
pub use refusal::Refusal;
pub use report::{RemovedKeyframes, SessionReport};
pub use session::take_session;
pub use settings::Settings;
