//! One seed of the demo: a simulated town, its surveyed map, a server of that map, and a robot's runs.

use super::conditions::{Conditions, build_options};
use crate::demo::CREATED_BY;
use crate::demo::robot::{Run, Variant};
use crate::in_process::{LocalServer, load_map};
use crate::own_map::is_replaceable;
use anyhow::{Context as _, Result};
use map::store::save_map;
use mapping::{BuildReport, build_map};
use nalgebra::Vector3;
use onboard::arguments::Init;
use sensors::{Sequence, TruthRow};
use simulation::simulate;
use std::path::{Path, PathBuf};

/// A simulated town with a map.
pub(super) struct Town {
    /// Its seed.
    pub(super) seed: u64,
    /// The recording to localize.
    pub(super) live: Sequence,
    /// How the map turned out.
    pub(super) map: BuildReport,
    /// Positions of the map's keyframes as the map states them, metres in G.
    pub(super) keyframes: Vec<Vector3<f64>>,
    /// Where the map and the runs are written.
    pub(super) folder: PathBuf,
}

impl Town {
    /// Simulates a town and builds its map in `folder`, where no other map may be than one of the demo.
    pub(super) fn build(
        conditions: &Conditions,
        seed: u64,
        folder: &Path,
        progress: &mut dyn FnMut(&str),
    ) -> Result<Self> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot create the folder {}", folder.display()))?;
        let database = folder.join("map.db");
        is_replaceable(&database, CREATED_BY)?;
        progress(&format!("seed {seed}: simulating a town and two runs through it"));
        let scenario = simulate(&conditions.simulation(seed))?;
        progress(&format!("seed {seed}: building the map"));
        let references = scenario.map.reference_poses.clone().unwrap_or_default();
        let (contents, map) =
            build_map(&scenario.map, &references, None, &build_options(), &mut |_, _, _| {})?;
        let keyframes =
            contents.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose.translation);
        let keyframes = keyframes.collect();
        save_map(&database, &contents, true)?;
        Ok(Self { seed, live: scenario.live, map, keyframes, folder: folder.to_path_buf() })
    }

    /// The truth of the live run.
    pub(super) fn truth(&self) -> &[TruthRow] {
        self.live.groundtruth.as_deref().unwrap_or_default()
    }

    /// Runs the robot once for each variant, over a map server of its own.
    pub(super) fn run_all(&self, variants: &[Variant], progress: &mut dyn FnMut(&str)) -> Result<Vec<Run>> {
        let server = LocalServer::start(vec![("demo".to_owned(), load_map(&self.folder.join("map.db"))?)])?;
        let mut runs = Vec::new();
        for variant in variants {
            progress(&format!("seed {}: the robot runs: {}", self.seed, variant.name));
            runs.push(self.run(*variant, &server)?);
        }
        server.stop()?;
        Ok(runs)
    }

    fn run(&self, variant: Variant, server: &LocalServer) -> Result<Run> {
        let link = server.link("demo")?;
        let run = Run::of(&self.live, variant, (&self.folder, Init::Truth), link.clone(), |_| {});
        server.unlink(&link);
        run.with_context(|| format!("seed {}", self.seed))
    }
}
