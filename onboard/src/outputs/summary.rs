//! The summary of a run: `summary.json`.

use super::status_word::status_word;
use estimator::{Estimated, EstimatorConfig, GnssCounts, LearnedNoise, Status, WheelReport};
use evaluation::RunScore;
use robot::Alarm;
use robot::counts::{
    ClockShiftSummary, DivergenceSummary, ImuGapSummary, MapChangeSummary, MillisecondsPerFrame, PairSummary,
    QuerySummary, StartSummary, TrackSummary, Traffic,
};
use serde::Serialize;

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
        if self.frames == 0 && self.skipped_frames > 0 {
            let skipped = self.skipped_frames;
            let reason = format!(
                "none of {skipped} images could be used; do cameras and IMU have the same clock, and readings at the same time?"
            );
            return Err(EndedLost { state: "without a pose", reason });
        }
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
    /// Jumps of the clock of the sensors, whose times the files have.
    pub clock_shifts: Vec<ClockShiftSummary>,
    /// Noise levels that the filter learned, or that the settings fixed; none where it was never initialized.
    pub learned_noise: Option<LearnedNoise>,
    /// Readout time of each camera's rolling shutter at the end, seconds, with its standard deviation, 0 where it was not estimated;
    /// none where all shutters are global ones.
    pub readout_times_s: Option<Vec<Estimated>>,
    /// What the wheels did, and their calibration at the end with its standard deviations; none without them.
    pub wheels: Option<WheelReport>,
    /// What GNSS did; none without it.
    pub gnss: Option<GnssCounts>,
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
