//! Starts of the odometry in motion, without a pose from the truth.

use nalgebra::{Matrix3, Vector3};
use onboard::Outcome;
use sensors::Sequence;
use tests::data::recording;
use tests::robot::run;

/// Least squares scale of odometry against the truth over the first ten seconds after the start (Umeyama).
fn scale_of_odometry(outcome: &Outcome, sequence: &Sequence) -> f64 {
    let truth = sequence.groundtruth.as_deref().unwrap();
    let states = &outcome.states().unwrap();
    let until_ns = states[0].stamp_ns + 10_000_000_000;
    let pairs: Vec<_> = states
        .iter()
        .take_while(|state| state.stamp_ns <= until_ns)
        .filter_map(|state| {
            let row = truth.iter().find(|row| (row.stamp_ns - state.stamp_ns).abs() < 1_000_000)?;
            Some((state.local_from_imu.pose.translation, row.pose.translation))
        })
        .collect();
    assert!(pairs.len() > 80);
    let count = pairs.len() as f64;
    let (mean, true_mean) =
        pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |sum, pair| (sum.0 + pair.0, sum.1 + pair.1));
    let (mean, true_mean) = (mean / count, true_mean / count);
    let mut cross = Matrix3::zeros();
    let mut spread = 0.0;
    for (estimated, true_place) in &pairs {
        cross += (estimated - mean) * (true_place - true_mean).transpose();
        spread += (true_place - true_mean).norm_squared();
    }
    // Both are one rigid shape, so the rotation that aligns them turns the cross covariance into its singular values.
    cross.svd(false, false).singular_values.sum() / spread
}

/// # Arguments
/// * `starts_s`: times from which on the filter runs, seconds after the begin of the recordings.
pub(super) fn starts_in_motion(starts_s: &[u32]) {
    for name in ["odometry/udel_gore", "odometry/MH_03_medium"] {
        let folder = recording(name);
        let sequence = Sequence::open(&folder).unwrap();
        for cameras in ["mono", "stereo"] {
            for start in starts_s {
                let out = tempfile::tempdir().unwrap();
                // Ten seconds for the scale and the minute after in which nothing may diverge.
                let switches =
                    format!("--mode odometry --cameras {cameras} --start-at {start} --duration 62");
                let outcome = run(&sequence, out.path(), &switches, None);
                let case = format!("{name} {cameras} from {start} s");
                let summary = &outcome.summary;
                assert!(summary.starts[0].seconds < 2.0, "{case}: after {} s", summary.starts[0].seconds);
                assert!(summary.divergences.is_empty(), "{case}: {:?}", summary.divergences);
                let scale = scale_of_odometry(&outcome, &sequence);
                assert!((scale - 1.0).abs() < 0.05, "{case}: scale {scale}");
                let error = summary.score.as_ref().unwrap().odometry_yaw_aligned_m.rmse;
                assert!(error < 0.10, "{case}: {error} m");
            }
        }
    }
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn starts_in_motion_without_truth() {
    starts_in_motion(&[5, 50]);
}
