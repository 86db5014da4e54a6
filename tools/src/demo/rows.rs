//! The rows of the tables.

use super::figures::{FigureSums, Figures};
use super::robot::{Run, Variant};
use serde::Serialize;

/// A variant's results over all seeds.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The variant.
    pub name: &'static str,
    /// What it does with the map.
    pub description: &'static str,
    /// Pose in G; for odometry the local pose, as if L had been placed where it truly is.
    pub pose: Option<Figures>,
    /// Pose in L.
    pub local: Option<Figures>,
    /// `G_T_L`.
    pub transform: Option<Figures>,
    /// Pose in G of each seed.
    pub pose_by_seed: Vec<SeedFigures>,
    /// Queries whose match updated the state.
    pub used: u64,
    /// Queries sent.
    pub sent: u64,
    /// Milliseconds a frame.
    pub milliseconds_per_frame: f64,
}

/// The pose in G of one variant in one seed.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SeedFigures {
    /// The seed.
    pub seed: u64,
    /// Errors, claimed uncertainty and consistency.
    pub pose: Option<Figures>,
}

/// The sums behind one row.
#[derive(Clone, Debug, Default)]
pub(super) struct RowSums {
    pose: FigureSums,
    local: FigureSums,
    transform: FigureSums,
    pose_by_seed: Vec<SeedFigures>,
    used: u64,
    sent: u64,
    milliseconds_per_frame: f64,
}

impl RowSums {
    /// Adds the run of a seed.
    pub(super) fn add(&mut self, seed: u64, run: &Run) {
        let mut of_seed = FigureSums::default();
        of_seed.add(run.pose_samples());
        self.pose_by_seed.push(SeedFigures { seed, pose: of_seed.figures() });
        self.pose.add(run.pose_samples());
        self.local.add(&run.errors.local);
        self.transform.add(run.scored(&run.errors.transform));
        self.used += run.used;
        self.sent += run.sent;
        self.milliseconds_per_frame += run.milliseconds_per_frame;
    }

    /// The row.
    pub(super) fn finish(self, variant: &Variant) -> Row {
        Row {
            name: variant.name,
            description: variant.description,
            pose: self.pose.figures(),
            local: self.local.figures(),
            transform: self.transform.figures(),
            milliseconds_per_frame: self.milliseconds_per_frame / self.pose_by_seed.len().max(1) as f64,
            pose_by_seed: self.pose_by_seed,
            used: self.used,
            sent: self.sent,
        }
    }
}
