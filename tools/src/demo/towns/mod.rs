//! From tracks: several simulated towns, a surveyed map of each, a map server, and a robot that runs once for each variant of
//! the paper's table.
//!
//! | module | what |
//! |---|---|
//! | [`conditions`] | what is simulated, in numbers and in sentences |
//! | `town` | one seed: the map, its server, the runs |
//! | `picture` | the comparison of the first seed |

pub mod conditions;
mod picture;
mod town;

use super::robot::{Run, Variant};
use super::rows::{Row, RowSums};
use anyhow::{Context as _, Result};
use conditions::Conditions;
use onboard::arguments::Mode;
use serde::Serialize;
use std::path::{Path, PathBuf};
use town::Town;

/// The rows of the table, in its order. All but odometry re-linearize (the paper's R).
pub const VARIANTS: [Variant; 4] = [
    Variant::ODOMETRY,
    Variant {
        name: "mapconst",
        description: "takes the map for exact",
        folder: "mapconst",
        mode: Mode::Mapconst,
    },
    Variant { name: "SM+R", description: "one keyframe a query", folder: "sm_r", mode: Mode::Single },
    Variant { name: "MM+R", description: "several keyframes a query", folder: "mm_r", mode: Mode::Multi },
];

/// What the demo computed.
#[derive(Clone, Debug, Serialize)]
pub struct TownsDemo {
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

/// Runs the demo from tracks.
///
/// # Arguments
/// * `out`: folder for `demo.json`, `comparison.svg`, and a folder `seed_N` for the map and the runs of each seed.
/// * `conditions`: what is simulated.
/// * `progress`: called with each step as it begins.
///
/// # Errors
/// A folder that cannot be written, no free port for the server, no seed.
pub fn run_towns(out: &Path, conditions: &Conditions, progress: &mut dyn FnMut(&str)) -> Result<TownsDemo> {
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
            sums.add(town.seed, run);
        }
    }

    fn finish(self, conditions: &Conditions) -> TownsDemo {
        let towns = self.towns as f64;
        let rows = VARIANTS.iter().zip(self.rows).map(|(variant, sums)| sums.finish(variant));
        TownsDemo {
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
