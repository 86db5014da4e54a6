//! One run of one variant.

use super::GRAVITY_IN_GLOBAL;
use anyhow::{Result, bail};
use evaluation::trajectory::{StampedPose, StateRow};
use evaluation::{ErrorSample, RunErrors, ScoreOptions, run_errors};
use onboard::arguments::{Init, Mode};
use onboard::{MapLink, RobotArguments, run_robot};
use sensors::Sequence;
use std::path::{Path, PathBuf};

/// One row of a table.
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

impl Variant {
    /// Without a map: what the others are compared with.
    pub(super) const ODOMETRY: Self =
        Self { name: "odometry", description: "no map", folder: "odometry", mode: Mode::Odometry };
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

impl Run {
    /// Runs a robot through a recording.
    ///
    /// # Arguments
    /// * `live`: with ground truth in G.
    /// * `out`: the run is written to the variant's folder in it.
    /// * `progress`: called with the index of every frame before it is processed.
    ///
    /// # Errors
    /// A folder that cannot be written, a run that ends early.
    pub(super) fn of(
        live: &Sequence,
        variant: Variant,
        (out, init): (&Path, Init),
        link: MapLink,
        progress: impl FnMut(usize),
    ) -> Result<Self> {
        let folder = out.join(variant.folder);
        let mut arguments = RobotArguments::with_defaults(&folder)?;
        arguments.mode = Some(variant.mode);
        arguments.init = init;
        let outcome = run_robot(live, &arguments, Some(link), progress)?;
        let summary = &outcome.summary;
        if let Some(reason) = &summary.ended_early {
            bail!("the run of {} ended early: {reason}", variant.name);
        }
        let states = outcome.states()?;
        let truth = live.groundtruth.as_deref().unwrap_or_default();
        let errors = run_errors(&states, truth, GRAVITY_IN_GLOBAL)?;
        let poses = states.iter().filter_map(|state| {
            let pose = pose_in_global(variant.mode, &errors, state)?;
            Some(StampedPose { stamp_ns: state.stamp_ns, pose })
        });
        Ok(Self {
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

fn pose_in_global(mode: Mode, errors: &RunErrors, state: &StateRow) -> Option<geometry::Pose> {
    if mode == Mode::Odometry {
        Some(errors.true_global_from_local * state.local_from_imu.pose)
    } else {
        state.global_from_imu.as_ref().map(|estimate| estimate.pose)
    }
}
