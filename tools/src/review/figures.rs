//! How well a drive was localized in a map.

use super::drive::DriveRun;
use evaluation::MAX_TRUTH_GAP_NS;
use geometry::{Pose, PoseWithCovariance};
use protocol::MatchOutcome;
use sensors::{TruthRow, TruthTrack};
use serde::Serialize;
use std::collections::BTreeMap;

/// A pose that is off by more than this (m) and three of its standard deviations is one of another place.
const WRONG_PLACE_M: f64 = 0.5;
/// Errors are summed up in windows of so long (s) as well: a corner that is off is a small part of a drive.
pub(super) const WINDOW_S: f64 = 5.0;
/// Poses that such a window has, at least.
const WINDOW_POSES: f64 = 10.0;
/// Degrees of freedom of a pose.
const DEGREES: f64 = 6.0;

/// What poses are compared with: the truth of the drive, or its poses in the live release.
#[derive(Clone, Debug)]
pub struct Reference {
    rows: Vec<TruthRow>,
    is_truth: bool,
}

impl Reference {
    /// The reference of a drive.
    ///
    /// # Arguments
    /// * `live`: the drive in the live release.
    pub fn of(live: &DriveRun) -> Self {
        if let Some(rows) = &live.truth {
            return Self { rows: rows.clone(), is_truth: true };
        }
        let localized =
            live.states.iter().filter_map(|state| Some((state.stamp_ns, state.global_from_imu.as_ref()?)));
        let row = |(stamp_ns, pose): (i64, &PoseWithCovariance)| TruthRow {
            stamp_ns,
            pose: pose.pose,
            velocity: None,
            gyroscope_bias: None,
            accelerometer_bias: None,
        };
        Self { rows: localized.map(row).collect(), is_truth: false }
    }

    fn pose(&self, stamp_ns: i64) -> Option<Pose> {
        TruthTrack::new(&self.rows).pose(stamp_ns, MAX_TRUTH_GAP_NS)
    }
}

/// How well a drive was localized in a map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DriveFigures {
    /// Queries of the robot that were answered or failed.
    pub queries: usize,
    /// Those that a keyframe matched.
    pub matched: usize,
    /// Those whose answer updated the state.
    pub accepted: usize,
    /// Part of the drive in which the robot knew its pose in the map.
    pub localized: f64,
    /// Poses in the map.
    pub poses: usize,
    /// Normalized innovation squared of the answers per degree of freedom: 1 is consistent. `None` without an answer.
    pub innovation: Option<f64>,
    /// Errors of the robot's poses; of the live release `None` where the drive has no truth.
    pub errors: Option<ErrorFigures>,
    /// Images that were localized by themselves.
    pub cold: ColdFigures,
}

/// Errors of poses in the map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorFigures {
    /// Whether they are errors to the truth; else differences to the poses in the live release.
    pub is_to_truth: bool,
    /// Root mean square of the distance (m).
    pub rmse_m: f64,
    /// Largest distance (m).
    pub largest_m: f64,
    /// Root mean square of the angle (deg).
    pub rmse_deg: f64,
    /// NEES per degree of freedom to the truth: 1 is consistent.
    pub nees: Option<f64>,
    /// Number of poses.
    pub poses: usize,
    /// Root mean square of the distance within each 5 s of the drive with ten poses or more (m).
    pub windows: BTreeMap<u32, f64>,
}

/// Images that were localized by themselves, as by a robot that starts there.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ColdFigures {
    /// How many.
    pub images: usize,
    /// Those that were localized, in the right place as far as is known.
    pub localized: usize,
    /// Those of them of which it is not known: where the truth has a gap, or without truth the live release gives no pose.
    pub unjudged: usize,
    /// Those that were localized in a wrong place: off by more than 0.5 m and three stated standard deviations.
    pub wrong: usize,
    /// Those that could be of several places.
    pub ambiguous: usize,
    /// Time from an image to the first one that is localized (s): the median over all images. Where none follows, that to the end.
    pub map_initialization_median_s: f64,
    /// The same, below which 95 % are.
    pub map_initialization_p95_s: f64,
    /// Images after which none was localized.
    pub without_fix: usize,
}

impl DriveFigures {
    /// The figures of a drive in a map.
    pub fn of(run: &DriveRun, reference: &Reference) -> Self {
        let events = run.events.iter();
        let innovations = events.clone().filter_map(|event| Some((event.nis?, event.nis_degrees?)));
        let (sum, degrees) = innovations.fold((0.0, 0), |all, (nis, degrees)| (all.0 + nis, all.1 + degrees));
        let localized = run.states.iter().filter(|state| state.global_from_imu.is_some()).count();
        Self {
            queries: run.events.len(),
            matched: events.clone().filter(|event| event.outcome == "matched").count(),
            accepted: events.filter(|event| event.accepted).count(),
            localized: localized as f64 / run.states.len().max(1) as f64,
            poses: localized,
            innovation: (degrees > 0).then(|| sum / degrees as f64),
            errors: ErrorFigures::of(run, reference),
            cold: ColdFigures::of(run, reference),
        }
    }
}

impl ErrorFigures {
    /// `None` where no pose can be compared, or all are those of the reference.
    fn of(run: &DriveRun, reference: &Reference) -> Option<Self> {
        let (mut squared_m, mut squared_rad, mut largest_m, mut poses) = (0.0, 0.0, 0.0_f64, 0);
        let (mut nees, mut with_nees) = (0.0, 0);
        let mut windows: BTreeMap<u32, (f64, f64)> = BTreeMap::new();
        let begin_ns = run.states.first().map_or(0, |state| state.stamp_ns);
        for state in &run.states {
            let Some(estimate) = &state.global_from_imu else { continue };
            let Some(pose) = reference.pose(state.stamp_ns) else { continue };
            let distance = distance(estimate, &pose);
            squared_m += distance.powi(2);
            let window = ((state.stamp_ns - begin_ns) as f64 * 1e-9 / WINDOW_S) as u32;
            let (sum, count) = windows.entry(window).or_default();
            (*sum, *count) = (*sum + distance.powi(2), *count + 1.0);
            squared_rad += estimate.pose.rotation.angle_to(&pose.rotation).powi(2);
            largest_m = largest_m.max(distance);
            poses += 1;
            if let Some(of_pose) = estimate.nees(&pose).filter(|_| reference.is_truth) {
                (nees, with_nees) = (nees + of_pose / DEGREES, with_nees + 1);
            }
        }
        let root_mean = |squared: f64| (squared / f64::from(poses)).sqrt();
        (poses > 0).then(|| Self {
            is_to_truth: reference.is_truth,
            rmse_m: root_mean(squared_m),
            largest_m,
            rmse_deg: root_mean(squared_rad).to_degrees(),
            nees: (with_nees > 0).then(|| nees / f64::from(with_nees)),
            poses: poses as usize,
            windows: windows
                .into_iter()
                .filter(|(_, (_, count))| *count >= WINDOW_POSES)
                .map(|(window, (sum, count))| (window, (sum / count).sqrt()))
                .collect(),
        })
    }
}

impl ColdFigures {
    fn of(run: &DriveRun, reference: &Reference) -> Self {
        let mut figures = Self { images: run.images.len(), ..Self::default() };
        let mut right_ns = Vec::new();
        for image in &run.images {
            figures.ambiguous += usize::from(image.outcome == MatchOutcome::Ambiguous);
            let Some(fix) = &image.global_from_imu else { continue };
            let is_wrong =
                |pose: Pose| distance(fix, &pose) > WRONG_PLACE_M + 3.0 * fix.sigma_p_m() * 3_f64.sqrt();
            let place = reference.pose(image.stamp_ns);
            figures.unjudged += usize::from(place.is_none());
            if place.is_some_and(is_wrong) {
                figures.wrong += 1;
            } else {
                right_ns.push(image.stamp_ns);
            }
        }
        figures.localized = right_ns.len();
        let end_ns = run.images.last().map_or(0, |image| image.stamp_ns);
        let mut waits_s: Vec<f64> = Vec::new();
        for image in &run.images {
            let next = right_ns.get(right_ns.partition_point(|stamp_ns| *stamp_ns < image.stamp_ns));
            figures.without_fix += usize::from(next.is_none());
            waits_s.push((next.unwrap_or(&end_ns) - image.stamp_ns) as f64 * 1e-9);
        }
        waits_s.sort_by(f64::total_cmp);
        let quantile =
            |part: f64| waits_s.get(((waits_s.len() as f64 * part) as usize).min(waits_s.len() - 1));
        if !waits_s.is_empty() {
            figures.map_initialization_median_s = quantile(0.5).copied().unwrap_or_default();
            figures.map_initialization_p95_s = quantile(0.95).copied().unwrap_or_default();
        }
        figures
    }
}

fn distance(estimate: &PoseWithCovariance, pose: &Pose) -> f64 {
    (estimate.pose.translation - pose.translation).norm()
}
