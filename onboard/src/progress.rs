//! Progress bar and report of a run on the terminal.

use super::outputs::{Summary, status_word};
use estimator::GnssCounts;
use evaluation::{RunScore, Score, ScoreOptions};
use indicatif::{ProgressBar, ProgressStyle};
use std::fmt::Write as _;

/// A NEES of the pose in the map that no filter has in the frame of its truth.
const OTHER_FRAME_NEES: f64 = 1000.0;
/// Widest number in the table of errors.
const WIDTH: usize = 8;

/// A number with so many decimals, or in powers of ten where it would not fit into its column.
fn short(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    if text.len() <= WIDTH { text } else { format!("{value:.1e}") }
}

/// A progress bar over frames; without a total where their number is not known beforehand.
pub fn frame_bar(frames: impl Into<Option<usize>>) -> ProgressBar {
    let Some(frames) = frames.into() else { return ProgressBar::new_spinner() };
    let bar = ProgressBar::new(frames as u64);
    // The template is a constant that is known to parse.
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} frames  {elapsed_precise}  {msg}") {
        bar.set_style(style);
    }
    bar
}

/// What became of the queries to the map.
fn query_report(summary: &Summary) -> String {
    let mut text = String::new();
    let queries = &summary.queries;
    let _ = writeln!(
        text,
        "{} queries: {} matched, {} accepted ({} re-linearized), {} failed; {} keyframes pulled ({} held), {} KB received",
        queries.sent,
        queries.matched,
        queries.accepted,
        queries.relinearized,
        queries.failed,
        summary.keyframes_pulled,
        summary.keyframes_held,
        summary.wire_bytes.received / 1024
    );
    if queries.kept_waiting > 0 {
        let _ = writeln!(
            text,
            "first pose in the map: {} answers were kept until the evidence was enough, {} hypotheses were dropped",
            queries.kept_waiting, queries.hypotheses_dropped
        );
    }
    text
}

/// What became of the positions of GNSS.
fn gnss_report(gnss: &GnssCounts) -> String {
    let unused = if gnss.used + gnss.initializations == 0 { ": NONE WAS USED" } else { "" };
    format!(
        "GNSS: {} positions used, {} rejected, {} while it was left out, {} before the pose in the map was initialized, {} late or without \
         images, {} invalid{unused}\n",
        gnss.used, gnss.gated, gnss.left_out, gnss.before_initialization, gnss.late, gnss.refused
    )
}

/// The errors of a run against ground truth.
fn score_report(score: &RunScore) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{:24} {:>8} {:>9} {:>8} {:>8} {:>8}",
        "errors against truth", "deg", "m", "max m", "NEES", "n"
    );
    let mut line = |name: &str, score: &Score| {
        let mut nees = score.nees_pose.map_or_else(|| "-".to_owned(), |nees| short(nees, 2));
        if score.nees_samples < score.samples {
            // The NEES leaves those without a covariance out.
            let _ = write!(nees, " of {}", score.nees_samples);
        }
        let _ = writeln!(
            text,
            "{name:24} {:>8} {:>9} {:>8} {nees:>8} {:>8}",
            short(score.rmse_deg, 3),
            short(score.rmse_m, 4),
            short(score.max_m, 3),
            score.samples
        );
    };
    line("local_from_imu", &score.local);
    if let Some(transform) = &score.transform {
        line("global_from_local", transform);
    }
    if let Some(pose) = &score.pose {
        line("global_from_imu", pose);
    }
    let aligned = if score.map_from_truth.is_some() { "aligned" } else { "not aligned" };
    let _ = writeln!(
        text,
        "  truth interpolated; local_from_imu and odometry: all frames; the others: from {} s after the map \
         initialization on, {aligned}",
        ScoreOptions::default().skip_after_initialization_s
    );
    if let Some(aligned) = &score.map_from_truth {
        let _ = writeln!(text, "  {aligned}");
    } else if score.pose.is_some_and(|pose| pose.nees_pose.is_some_and(|nees| nees > OTHER_FRAME_NEES)) {
        let _ = writeln!(
            text,
            "  far more than claimed: if the map's frame is not the truth's, compare with `driftless evaluate --align yaw`"
        );
    }
    let _ = writeln!(
        text,
        "odometry alone, aligned in yaw and position: {:.4} m over {:.0} m",
        score.odometry_yaw_aligned_m.rmse, score.distance_m
    );
    text
}

/// The summary of a run in a few lines.
pub fn report(summary: &Summary) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{} frames, {:.0} s of recording in {:.1} s ({:.1} times real time, {:.1} ms a frame)",
        summary.frames,
        summary.seconds,
        summary.wall_seconds,
        summary.realtime_factor,
        summary.milliseconds_per_frame.total
    );
    if let Some(pairs) = summary.stereo_pairs.filter(|_| summary.cameras > 1) {
        let _ = writeln!(
            text,
            "{} stereo pairs; without a partner: {} images of the first camera, used alone, and {} of the second, left out",
            pairs.pairs, pairs.lone_first, pairs.lone_second
        );
    }
    if summary.dropped_frames > 0 {
        let _ =
            writeln!(text, "dropped     {} frames: see the alarms in summary.json", summary.dropped_frames);
    }
    if summary.skipped_frames > 0 {
        let _ = writeln!(
            text,
            "{} frames were skipped: their image could not be used, or there were no IMU readings; see the log",
            summary.skipped_frames
        );
    }
    if summary.map.is_some() {
        text += &query_report(summary);
    }
    if let Some(gnss) = &summary.gnss {
        text += &gnss_report(gnss);
    }
    if let Some(score) = &summary.score {
        text += &score_report(score);
    }
    if let Some(reason) = &summary.no_score {
        let _ = writeln!(text, "not compared with ground truth: {reason}");
    }
    for divergence in &summary.divergences {
        let _ = writeln!(
            text,
            "diverged and initialized again at {:.1} s: {}",
            divergence.seconds, divergence.reason
        );
    }
    if let Some(noise) = &summary.learned_noise {
        let _ = writeln!(
            text,
            "noise: IMU {:.2} times the stated, tracks {:.2} px, matches {:.2} times the stated",
            noise.imu_noise_scale, noise.sigma_track_px, noise.match_noise_scale
        );
    }
    for alarm in &summary.alarms {
        let until = alarm.ended_s.map_or_else(String::new, |seconds| format!(" to {seconds:.1} s"));
        let _ = writeln!(text, "ALARM from {:.1} s{until}: {}", alarm.seconds, alarm.reason);
    }
    if let Some(status) = &summary.final_status {
        let _ = writeln!(text, "at the end: {}, {}", status_word(status), status.reason);
    }
    if let Some(reason) = &summary.ended_early {
        let _ = writeln!(text, "ENDED EARLY: {reason}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_do_not_run_together() {
        for (value, decimals, expected) in [
            (0.1234, 3, "0.123"),
            (640_982.0, 2, "6.4e5"),
            (99_999.99, 2, "99999.99"),
            (123_456.789, 3, "1.2e5"),
        ] {
            assert_eq!(short(value, decimals), expected);
        }
    }
}
