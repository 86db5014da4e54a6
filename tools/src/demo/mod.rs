//! The whole system on simulated input: several simulated towns, a surveyed map of each, a map server, and a robot that
//! runs once for each variant of the paper's table.
//!
//! | module | what |
//! |---|---|
//! | [`conditions`] | what is simulated, in numbers and in sentences |
//! | [`figures`] | errors, claimed uncertainty and consistency of a variant |
//! | `town` | one seed: the map, its server, the runs |
//! | `picture` | the comparison of the first seed |

pub mod conditions;
pub mod figures;
mod picture;
mod town;

use anyhow::{Context as _, Result};
use conditions::Conditions;
use figures::{FigureSums, Figures};
use onboard::arguments::Mode;
use serde::Serialize;
use std::path::{Path, PathBuf};
use town::{Run, Town};

/// One row of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    /// As the paper calls it.
    pub name: &'static str,
    /// What it does with the map.
    pub description: &'static str,
    /// Folder of its runs.
    pub folder: &'static str,
    /// The robot's mode.
    pub mode: Mode,
}

/// The rows of the table, in its order. All but odometry re-linearize (the paper's R).
pub const VARIANTS: [Variant; 4] = [
    Variant { name: "odometry", description: "no map", folder: "odometry", mode: Mode::Odometry },
    Variant {
        name: "mapconst",
        description: "takes the map for exact",
        folder: "mapconst",
        mode: Mode::Mapconst,
    },
    Variant { name: "SM+R", description: "one keyframe a query", folder: "sm_r", mode: Mode::Single },
    Variant { name: "MM+R", description: "several keyframes a query", folder: "mm_r", mode: Mode::Multi },
];

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

/// What the demo computed.
#[derive(Clone, Debug, Serialize)]
pub struct Demo {
    /// What was simulated.
    pub conditions: Conditions,
    /// The same in sentences.
    pub conditions_text: Vec<String>,
    /// Distance travelled in all live runs together, metres.
    pub distance_m: f64,
    /// Keyframes of the maps, mean over the seeds.
    pub keyframes: f64,
    /// Landmarks of the maps, mean over the seeds.
    pub landmarks: f64,
    /// The table.
    pub rows: Vec<Row>,
    /// Plots that were written.
    pub pictures: Vec<PathBuf>,
}

/// Runs the demo.
///
/// # Arguments
/// * `out`: folder for `demo.json`, `comparison.svg`, and a folder `seed_N` for the map and the runs of each seed.
/// * `conditions`: what is simulated.
/// * `progress`: called with each step as it begins.
///
/// # Errors
/// A folder that cannot be written, no free port for the server, no seed.
pub fn run_demo(out: &Path, conditions: &Conditions, progress: &mut dyn FnMut(&str)) -> Result<Demo> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot create the folder {}", out.display()))?;
    let mut first: Option<(Town, Vec<Run>)> = None;
    let mut summary = DemoSums::default();
    for seed in conditions.seed_range() {
        let town = Town::build(conditions, seed, &out.join(format!("seed_{seed}")), progress)?;
        let runs = town.run_all(&VARIANTS, progress)?;
        summary.add(&town, &runs);
        first.get_or_insert((town, runs));
    }
    let (town, runs) = first.context("the demo needs at least one seed")?;
    progress("drawing");
    let mut demo = summary.finish(conditions);
    demo.pictures = picture::draw_all(&town, &runs, &demo, out)?;
    std::fs::write(out.join("demo.json"), serde_json::to_string_pretty(&demo)?)?;
    Ok(demo)
}

/// The sums behind one row.
#[derive(Clone, Debug, Default)]
struct RowSums {
    pose: FigureSums,
    local: FigureSums,
    transform: FigureSums,
    pose_by_seed: Vec<SeedFigures>,
    used: u64,
    sent: u64,
    milliseconds_per_frame: f64,
}

/// The sums behind the demo's figures.
#[derive(Clone, Debug, Default)]
struct DemoSums {
    rows: [RowSums; VARIANTS.len()],
    towns: usize,
    distance_m: f64,
    keyframes: usize,
    landmarks: usize,
}

impl DemoSums {
    fn add(&mut self, town: &Town, runs: &[Run]) {
        self.towns += 1;
        self.keyframes += town.map.keyframes;
        self.landmarks += town.map.landmarks;
        self.distance_m += runs.first().map_or(0.0, |run| run.distance_m);
        for (sums, run) in self.rows.iter_mut().zip(runs) {
            let mut of_seed = FigureSums::default();
            of_seed.add(run.pose_samples());
            sums.pose_by_seed.push(SeedFigures { seed: town.seed, pose: of_seed.figures() });
            sums.pose.add(run.pose_samples());
            sums.local.add(&run.errors.local);
            sums.transform.add(run.scored(&run.errors.transform));
            sums.used += run.used;
            sums.sent += run.sent;
            sums.milliseconds_per_frame += run.milliseconds_per_frame;
        }
    }

    fn finish(self, conditions: &Conditions) -> Demo {
        let towns = self.towns as f64;
        let rows = VARIANTS.iter().zip(self.rows).map(|(variant, sums)| Row {
            name: variant.name,
            description: variant.description,
            pose: sums.pose.figures(),
            local: sums.local.figures(),
            transform: sums.transform.figures(),
            pose_by_seed: sums.pose_by_seed,
            used: sums.used,
            sent: sums.sent,
            milliseconds_per_frame: sums.milliseconds_per_frame / towns,
        });
        Demo {
            conditions: *conditions,
            conditions_text: conditions.describe(),
            distance_m: self.distance_m,
            keyframes: self.keyframes as f64 / towns,
            landmarks: self.landmarks as f64 / towns,
            rows: rows.collect(),
            pictures: Vec::new(),
        }
    }
}
