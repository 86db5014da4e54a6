//! One seed of the demo: a simulated town, its surveyed map, a server of that map, and a robot's runs.

use super::Variant;
use super::conditions::{Conditions, GRAVITY_IN_GLOBAL, build_options};
use crate::in_process::{LocalServer, load_map};
use anyhow::{Context as _, Result, bail};
use evaluation::trajectory::{StampedPose, StateRow};
use evaluation::{ErrorSample, RunErrors, ScoreOptions, run_errors};
use map::store::save_map;
use mapping::{BuildReport, build_map};
use nalgebra::Vector3;
use onboard::arguments::{Init, Mode};
use onboard::{RobotArguments, run_robot};
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

/// One run of one variant.
pub(super) struct Run {
    /// The variant.
    pub(super) variant: Variant,
    /// Its output folder.
    pub(super) folder: PathBuf,
    /// All errors.
    pub(super) errors: RunErrors,
    /// The IMU in G. For odometry: with L placed where it truly is.
    pub(super) poses: Vec<StampedPose>,
    /// Distance travelled, metres.
    pub(super) distance_m: f64,
    /// Queries whose match updated the state.
    pub(super) used: u64,
    /// Queries sent.
    pub(super) sent: u64,
    /// Milliseconds a frame.
    pub(super) milliseconds_per_frame: f64,
}

impl Town {
    /// Simulates a town and builds its map in `folder`.
    pub(super) fn build(
        conditions: &Conditions,
        seed: u64,
        folder: &Path,
        progress: &mut dyn FnMut(&str),
    ) -> Result<Self> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot create the folder {}", folder.display()))?;
        progress(&format!("seed {seed}: simulating a town and two runs through it"));
        let scenario = simulate(&conditions.simulation(seed))?;
        progress(&format!("seed {seed}: building the map"));
        let references = scenario.map.reference_poses.clone().unwrap_or_default();
        let (contents, map) =
            build_map(&scenario.map, &references, None, &build_options(), &mut |_, _, _| {})?;
        let keyframes =
            contents.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose.translation);
        let keyframes = keyframes.collect();
        save_map(&folder.join("map.db"), &contents, true)?;
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
        let folder = self.folder.join(variant.folder);
        let mut arguments = RobotArguments::with_defaults(&folder)?;
        arguments.mode = Some(variant.mode);
        arguments.init = Init::Truth;
        let link = server.link("demo")?;
        let outcome = run_robot(&self.live, &arguments, Some(link.clone()), |_| {})?;
        server.unlink(&link);
        let summary = &outcome.summary;
        if let Some(reason) = &summary.ended_early {
            bail!("seed {}: the run of {} ended early: {reason}", self.seed, variant.name);
        }
        let states = outcome.states()?;
        let errors = run_errors(&states, self.truth(), GRAVITY_IN_GLOBAL)?;
        let poses = states.iter().filter_map(|state| {
            let pose = pose_in_global(variant.mode, &errors, state)?;
            Some(StampedPose { stamp_ns: state.stamp_ns, pose })
        });
        Ok(Run {
            variant,
            folder,
            poses: poses.collect(),
            errors,
            distance_m: summary.score.as_ref().map_or(0.0, |score| score.distance_m),
            used: summary.queries.accepted,
            sent: summary.queries.sent,
            milliseconds_per_frame: summary.milliseconds_per_frame.total,
        })
    }
}

fn pose_in_global(mode: Mode, errors: &RunErrors, state: &StateRow) -> Option<geometry::Pose> {
    if mode == Mode::Odometry {
        Some(errors.true_global_from_local * state.local_from_imu.pose)
    } else {
        state.global_from_imu.as_ref().map(|estimate| estimate.pose)
    }
}

impl Run {
    /// The errors behind the figures of the pose in G; for odometry those of the local pose.
    pub(super) fn pose_samples(&self) -> impl Iterator<Item = &ErrorSample> {
        let samples = match self.variant.mode {
            Mode::Odometry => &self.errors.local,
            _ => &self.errors.pose,
        };
        self.scored(samples)
    }

    /// The samples from the time on from which runs are scored: some seconds after the map initialization.
    pub(super) fn scored<'a>(
        &self,
        samples: &'a [ErrorSample],
    ) -> impl Iterator<Item = &'a ErrorSample> + use<'a> {
        let skip_ns = (ScoreOptions::default().skip_after_initialization_s * 1e9) as i64;
        let from_ns = self.errors.pose.first().map_or(i64::MIN, |sample| sample.stamp_ns + skip_ns);
        samples.iter().filter(move |sample| sample.stamp_ns >= from_ns)
    }
}
