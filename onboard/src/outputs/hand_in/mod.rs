//! Records sessions that a map can be extended by: what is handed in.
//!
//! | module | what |
//! |---|---|
//! | `recording_thread`, `folder` | the thread that writes; the folder of sessions |
//! | `session_builder` | chunks of what a robot sees |
//! | `candidates`, `tracked_points`, `budget` | what of it is recorded |
//! | `identity` | what identifies a session in the ledger of a map |
//! | `settings` | where to, and how much |

mod budget;
mod candidates;
mod folder;
mod identity;
mod recording_thread;
mod session_builder;
mod settings;
#[cfg(test)]
mod tests;
mod tracked_points;

use client::MatchAnswer;
use estimator::{ImuSample, MapReport, TrackObservation};
use hand_in::{Answer, AnsweredMatch};
use protocol::FeatureSet;
use recording_thread::Item;
use robot::{Estimate, Output};
use sensors::Frame;
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

pub(crate) use settings::HandInSettings;

/// What may wait for the disk in real time: the readings of half a minute at 1 kHz, which come at once with the first image.
const REALTIME_QUEUE: usize = 1 << 15;
/// The same where the run waits for the disk.
const QUEUE: usize = 256;
/// Said where recording ends before the run does.
const ENDED: &str = "no more is recorded to be handed in";

/// Records sessions. What goes wrong ends the recording, not the run.
#[derive(Debug)]
pub(crate) struct HandInOutput {
    sender: Option<SyncSender<Item>>,
    thread: Option<JoinHandle<()>>,
    realtime: bool,
    /// Why no more is recorded.
    fault: Arc<OnceLock<String>>,
}

impl HandInOutput {
    /// Makes the folder, makes sessions of what a killed robot left there, and starts the thread.
    ///
    /// # Errors
    /// The folder cannot be written, or the operating system refuses a thread.
    pub(crate) fn start(settings: HandInSettings) -> std::io::Result<Self> {
        std::fs::create_dir_all(&settings.folder)?;
        folder::recover(&settings.folder, settings.key.as_deref())?;
        let realtime = settings.realtime;
        let (sender, items) = sync_channel(if realtime { REALTIME_QUEUE } else { QUEUE });
        let fault = Arc::new(OnceLock::new());
        let of_thread = Arc::clone(&fault);
        let work = move || {
            if let Err(error) = recording_thread::record(&settings, &items) {
                let reason = error.to_string();
                tracing::error!(reason, "{ENDED}; the run continues, and what was written so far counts");
                let _ = of_thread.set(format!("{ENDED}: {reason}"));
            }
        };
        let thread = std::thread::Builder::new().name("hand-in".into()).spawn(work)?;
        Ok(Self { sender: Some(sender), thread: Some(thread), realtime, fault })
    }

    /// Sends to the thread, which is gone where writing failed: that was said.
    fn send(&mut self, item: Item) {
        let Some(sender) = &self.sender else { return };
        let is_full = if self.realtime {
            matches!(sender.try_send(item), Err(TrySendError::Full(_)))
        } else {
            let _ = sender.send(item);
            false
        };
        if is_full {
            tracing::error!("{ENDED}: the disk is too slow; the run continues");
            let _ = self.fault.set(format!("{ENDED}: the disk is too slow"));
            self.sender = None;
        }
    }
}

impl Output for HandInOutput {
    fn reading(&mut self, reading: &ImuSample) {
        self.send(Item::Reading(*reading));
    }

    fn frame(&mut self, frame: &Frame) {
        self.send(Item::Image(frame.stamp_ns));
    }

    fn tracks(&mut self, stamp_ns: i64, tracks: &[TrackObservation]) {
        self.send(Item::Tracks(stamp_ns, tracks.to_vec()));
    }

    fn features(&mut self, stamp_ns: i64, camera: usize, features: &FeatureSet) {
        self.send(Item::Features(stamp_ns, camera, features.clone()));
    }

    fn answer(&mut self, stamp_ns: i64, camera: usize, answer: &MatchAnswer, report: Option<&MapReport>) {
        let MatchAnswer { status, keyframes } = answer;
        let of_keyframe = |keyframe: &protocol::MatchedKeyframe| {
            let id = keyframe.keyframe.id;
            let found = |found: &protocol::LandmarkMatch| AnsweredMatch {
                feature: found.feature,
                landmark: found.landmark,
                keyframe: id,
            };
            keyframe.matches.iter().map(found).collect::<Vec<_>>()
        };
        self.send(Item::Answer(Answer {
            stamp_ns,
            camera,
            map_identity: status.map_identity,
            map_version: status.map_version,
            inliers: report.map_or(0, |report| report.inliers as u64),
            used: report.map_or(0, |report| report.used as u64),
            accepted: report.is_some_and(|report| report.rejection.is_none()),
            matches: keyframes.iter().flat_map(of_keyframe).collect(),
        }));
    }

    fn estimate(&mut self, estimate: &Estimate) {
        let motion = &estimate.motion;
        self.send(Item::Pose(motion.stamp_ns, motion.local_from_imu().pose));
    }

    fn restart(&mut self) {
        self.send(Item::Restart);
    }

    fn set_clock_shift(&mut self, shift_ns: i64) {
        self.send(Item::ClockShift(shift_ns));
    }

    fn fault(&self) -> Option<&str> {
        self.fault.get().map(String::as_str)
    }
}

impl Drop for HandInOutput {
    /// Writes what waits.
    fn drop(&mut self) {
        self.sender = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that records for the map panicked");
        }
    }
}
