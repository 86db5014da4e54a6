//! The session of a recording, as the ledger of a map has it.

use map::model::Keyframe;
use map::sessions::{Recorded, RecordedDigest, Session, SessionOverlap};
use map::{MapContents, MapMetadata};
use protocol::KeyframeId;
use sensors::Sequence;

use super::keyframe_selection::is_in_time;
use super::options::BuildOptions;

/// What of a recording is used, by the times of the options: its images, and the readings of the IMU from the first of them to before
/// the last one, so that two pieces that follow each other have no reading in common.
pub(super) fn session_of(sequence: &Sequence, options: &BuildOptions) -> Session {
    let name = sequence.root.file_name().map_or_else(|| "recording".into(), |name| name.to_string_lossy());
    let recorded = options.recorded.clone().unwrap_or_else(|| recorded_of(sequence, options));
    Session::new(recorded, &name).by_robot(options.robot.as_deref())
}

fn recorded_of(sequence: &Sequence, options: &BuildOptions) -> Recorded {
    let first_ns = sequence.frames.first().map_or(0, |frame| frame.stamp_ns);
    let stamps = || sequence.frames.iter().map(|frame| frame.stamp_ns);
    let used = || stamps().filter(|stamp_ns| is_in_time(*stamp_ns, first_ns, options));
    let [begin_ns, end_ns] = [used().next().unwrap_or(0), used().next_back().unwrap_or(0)];
    let mut digest = RecordedDigest::default();
    for reading in &sequence.imu_samples {
        if (begin_ns..end_ns).contains(&reading.stamp_ns) {
            let [gyroscope, accelerometer] = [reading.gyroscope, reading.accelerometer].map(<[f64; 3]>::from);
            let [[a, b, c], [d, e, f]] = [gyroscope, accelerometer];
            digest.add_reading(reading.stamp_ns, [a, b, c, d, e, f]);
        }
    }
    used().for_each(|stamp_ns| digest.add_image(stamp_ns));
    digest.finish()
}

/// Enters a session with its keyframes into a ledger, behind those that are there.
///
/// # Arguments
/// * `sigma_px`: standard deviation of its pixels (px).
pub(super) fn enter(info: &mut MapMetadata, session: Session, sigma_px: f64, keyframes: &[Keyframe]) {
    let ids = || keyframes.iter().map(|keyframe| keyframe.id);
    if let Some((first, last)) = ids().min().zip(ids().max()) {
        info.sessions.push(Session { keyframe_ids: [first, last], sigma_px: Some(sigma_px), ..session });
    }
}

/// The id beyond which new keyframes come: those that were removed from the map do not come again.
pub(super) fn last_keyframe(map: &MapContents) -> KeyframeId {
    let present = map.keyframes.iter().map(|keyframe| keyframe.id).max();
    present.max(map.info.last_session_keyframe()).unwrap_or_default()
}

/// Checks that what is used of a recording is not in a map already, by the map's ledger: as a whole or a piece of it, under
/// this name or another one. Takes a moment; [`extend_map`](crate::extend_map) does the same.
///
/// # Errors
/// [`SessionOverlap`], which names the session of the map.
pub fn check_new_recording(
    stored: &MapMetadata,
    sequence: &Sequence,
    options: &BuildOptions,
) -> Result<(), SessionOverlap> {
    stored.check_new_session(&session_of(sequence, options))
}
