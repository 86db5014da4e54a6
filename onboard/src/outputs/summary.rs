//! The summary of a run: `summary.json`.

use super::status_word::status_word;
use crate::alarms::Alarm;
use estimator::{EstimatorConfig, LearnedNoise, Status};
use evaluation::RunScore;
use sensors::PairCounts;
use serde::Serialize;
use std::time::Duration;

/// Computing time of the processing steps, summed over frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timings {
    /// Reading images and tracking points in them.
    pub front_end: Duration,
    /// IMU propagation and cloning.
    pub propagation: Duration,
    /// The update from tracks.
    pub tracks: Duration,
    /// Updates from the map, waiting excluded.
    pub map: Duration,
    /// Frames that were added.
    pub frames: usize,
}

impl Timings {
    /// Adds a frame.
    pub fn add(&mut self, frame: &Self) {
        self.front_end += frame.front_end;
        self.propagation += frame.propagation;
        self.tracks += frame.tracks;
        self.map += frame.map;
        self.frames += 1;
    }

    /// Computing time of all steps.
    pub fn total(&self) -> Duration {
        self.front_end + self.propagation + self.tracks + self.map
    }

    /// Milliseconds a frame.
    pub fn mean(&self) -> MillisecondsPerFrame {
        let mean = |total: Duration| total.as_secs_f64() * 1e3 / self.frames.max(1) as f64;
        MillisecondsPerFrame {
            front_end: mean(self.front_end),
            propagation: mean(self.propagation),
            tracks: mean(self.tracks),
            map: mean(self.map),
            total: mean(self.front_end + self.propagation + self.tracks + self.map),
        }
    }
}

/// Mean time a frame by step, wall clock of the estimator's thread.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct MillisecondsPerFrame {
    /// Reading images and tracking points in them; 0 where the source has tracks.
    pub front_end: f64,
    /// IMU propagation and cloning.
    pub propagation: f64,
    /// The update from tracks.
    pub tracks: f64,
    /// Updates from the map, waiting excluded.
    pub map: f64,
    /// All of them.
    pub total: f64,
}

/// Payload bytes over the wire.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Traffic {
    /// From the robot to the map server.
    pub sent: usize,
    /// From the map server to the robot.
    pub received: usize,
}

impl Traffic {
    /// Adds the bytes of a query.
    pub fn add(&mut self, other: &Self) {
        self.sent += other.sent;
        self.received += other.received;
    }
}

/// Counts of queries and their results.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct QuerySummary {
    /// Sent.
    pub sent: u64,
    /// Images without a query because too many were pending.
    pub skipped: u64,
    /// Answered by the map, with or without a match.
    pub answered: u64,
    /// Answered with a match.
    pub matched: u64,
    /// Corrected the state.
    pub accepted: u64,
    /// Of these, after re-linearization at the PnP solution.
    pub relinearized: u64,
    /// Kept as evidence for a first pose in the map, which was not enough yet.
    pub kept_waiting: u64,
    /// Hypotheses about the first pose in the map that were dropped: another one had more evidence.
    pub hypotheses_dropped: u64,
    /// Without an answer: no server, deadline passed, refused.
    pub failed: u64,
}

/// Counts of changes of the map that were received.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct MapChangeSummary {
    /// The pose in the map was carried over to the new version.
    pub carried_over: u64,
    /// The pose in the map was dropped and had to be initialized again.
    pub found_anew: u64,
}

/// Stereo pairs and images without a partner: of a recording all, of live sensors those until the end.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PairSummary {
    /// Frames with an image of both cameras.
    pub pairs: usize,
    /// Images of camera 0 without a partner: used as those of one camera.
    pub lone_first: usize,
    /// Images of camera 1 without a partner: left out.
    pub lone_second: usize,
    /// Largest difference between the stamps of a pair, milliseconds.
    pub largest_difference_ms: f64,
}

impl From<PairCounts> for PairSummary {
    fn from(counts: PairCounts) -> Self {
        let PairCounts { pairs, lone_first, lone_second, .. } = counts;
        let largest_difference_ms = counts.largest_difference_ns as f64 * 1e-6;
        Self { pairs, lone_first, lone_second, largest_difference_ms }
    }
}

/// Counts of tracks.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct TrackSummary {
    /// Corrected the state.
    pub used: usize,
    /// Could not be triangulated.
    pub not_triangulated: usize,
    /// Rejected by the chi-square gate.
    pub gated: usize,
    /// Single outlying observations that were dropped.
    pub dropped_observations: usize,
}

/// Gaps between IMU readings, over which the motion is interpolated.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ImuGapSummary {
    /// How many.
    pub count: usize,
    /// The longest, seconds.
    pub longest_s: f64,
}

/// An initialization of the filter.
#[derive(Clone, Debug, Serialize)]
pub struct StartSummary {
    /// Time since the first frame, seconds.
    pub seconds: f64,
    /// `known` (the initial state was given), `rest` or `motion`.
    pub method: &'static str,
    /// In motion: standard deviation of the scale, relative.
    pub sigma_scale: Option<f64>,
}

/// A divergence of the filter.
#[derive(Clone, Debug, Serialize)]
pub struct DivergenceSummary {
    /// Time since the first frame, seconds.
    pub seconds: f64,
    /// Why it was detected.
    pub reason: String,
}

/// A run that ended without a pose that can be trusted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the run ended {state}: {reason}")]
pub struct EndedLost {
    /// The last state in a word.
    pub state: &'static str,
    /// Reason of the last status.
    pub reason: String,
}

impl EndedLost {
    /// Exit code of the programs: neither that of an error (1) nor that of wrong switches (2).
    pub const EXIT_CODE: u8 = 3;
}

impl Summary {
    /// Whether the run came to its end, and the robot knew its pose there.
    ///
    /// # Errors
    /// [`EndedLost`] where it did not know it.
    pub fn check_end(&self) -> Result<(), EndedLost> {
        check_status(self.final_status.as_ref())
    }
}

fn check_status(last: Option<&Status>) -> Result<(), EndedLost> {
    let lost = last.filter(|status| !status.localization.is_usable());
    lost.map_or(Ok(()), |status| Err(EndedLost { state: status_word(status), reason: status.reason.clone() }))
}

/// The summary of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The recording or other source.
    pub sequence: String,
    /// Name of the map; none with odometry only.
    pub map: Option<String>,
    /// Identity of the map that the robot was localized in; none where it never was.
    pub map_identity: Option<String>,
    /// Cameras used.
    pub cameras: usize,
    /// Frames that were processed.
    pub frames: usize,
    /// Frames that were skipped: no IMU readings, an unusable image.
    pub skipped_frames: usize,
    /// Stereo pairs of the source, and images without a partner; none for one camera.
    pub stereo_pairs: Option<PairSummary>,
    /// Frames that a live source dropped: the processor did not keep up, or there were no readings for them.
    pub dropped_frames: u64,
    /// IMU readings that were left out: not finite, not in the order of time, or no motion.
    pub dropped_imu: usize,
    /// Gaps between IMU readings.
    pub imu_gaps: ImuGapSummary,
    /// Time from the first to the last state, seconds.
    pub seconds: f64,
    /// Duration of the run, seconds of wall time.
    pub wall_seconds: f64,
    /// `seconds` divided by `wall_seconds`.
    pub realtime_factor: f64,
    /// Computing time per frame.
    pub milliseconds_per_frame: MillisecondsPerFrame,
    /// Errors and consistency, where truth is known.
    pub score: Option<RunScore>,
    /// Why there is no score.
    pub no_score: Option<String>,
    /// Queries.
    pub queries: QuerySummary,
    /// Changes of the map.
    pub map_changes: MapChangeSummary,
    /// Keyframes received in answers, repeated ones included.
    pub keyframes_pulled: usize,
    /// Keyframes held in the estimator at the end.
    pub keyframes_held: usize,
    /// Payload bytes of queries and answers.
    pub wire_bytes: Traffic,
    /// Tracks.
    pub tracks: TrackSummary,
    /// Initializations after the first.
    pub reinitializations: usize,
    /// All initializations.
    pub starts: Vec<StartSummary>,
    /// Divergences, after each of which the filter was initialized again.
    pub divergences: Vec<DivergenceSummary>,
    /// Noise levels that the filter learned, or that the settings fixed; none where it was never initialized.
    pub learned_noise: Option<LearnedNoise>,
    /// What contradicted the sensors or the map, and what to do about it.
    pub alarms: Vec<Alarm>,
    /// Status at the end.
    pub final_status: Option<Status>,
    /// Whether the run was stopped from outside (Ctrl-C).
    pub interrupted: bool,
    /// Why the run ended early, if it did.
    pub ended_early: Option<String>,
    /// Settings of the estimator.
    pub settings: EstimatorConfig,
}

#[cfg(test)]
mod tests {
    use super::*;
    use estimator::Localization;

    fn ended(localization: Localization) -> Result<(), EndedLost> {
        let status =
            Status { localization, reason: "why".to_owned(), last_map_update_ns: None, held_keyframes: 0 };
        check_status(Some(&status))
    }

    #[test]
    fn only_a_run_that_ended_lost_is_an_error() {
        assert_eq!(ended(Localization::Localized), Ok(()));
        assert_eq!(ended(Localization::OdometryOnly), Ok(()));
        assert_eq!(check_status(None), Ok(()));
        for (localization, said) in [
            (Localization::Lost, "the run ended lost: why"),
            (Localization::Starting, "the run ended starting: why"),
        ] {
            assert_eq!(ended(localization).unwrap_err().to_string(), said);
        }
    }
}
