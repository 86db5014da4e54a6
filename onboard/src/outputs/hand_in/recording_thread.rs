//! The thread that makes chunks and writes them.

use super::folder;
use super::session_builder::SessionBuilder;
use super::settings::HandInSettings;
use estimator::{ImuSample, TrackObservation};
use geometry::Pose;
use hand_in::{Answer, Chunk, HandInError, Header, SessionWriter};
use protocol::FeatureSet;
use std::fs::File;
use std::path::PathBuf;
use std::sync::mpsc::Receiver;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// What happened.
pub(super) enum Item {
    Reading(ImuSample),
    Image(i64),
    Tracks(i64, Vec<TrackObservation>),
    Pose(i64, Pose),
    /// Of an image: its time and camera, and its features.
    Features(i64, usize, FeatureSet),
    Answer(Answer),
    Restart,
    /// What is added to the times of all other items from now on (ns).
    ClockShift(i64),
}

/// Where the clock of the sensors is set by more than this (ns), it is not known when that was recorded what came before.
const WRONG_CLOCK_NS: u64 = 86_400_000_000_000;

/// Why recording ends.
#[derive(Debug, thiserror::Error)]
pub(super) enum RecordingError {
    #[error(transparent)]
    File(#[from] HandInError),
    #[error("{}: {source}", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
    #[error(
        "{} has {bytes} bytes of sessions that were not handed in, more than --hand-in-limit: hand them in with driftless hand-in, or delete them",
        path.display()
    )]
    Full { path: PathBuf, bytes: u64 },
}

/// A session that is being written.
struct Open {
    writer: SessionWriter,
    path: PathBuf,
    /// Held until the session has ended.
    _lock: File,
}

/// Records sessions until the robot ends.
pub(super) fn record(settings: &HandInSettings, items: &Receiver<Item>) -> Result<(), RecordingError> {
    let builder = SessionBuilder::new(settings.bytes_per_minute);
    let mut thread = RecordingThread { settings, builder, clock_shift_ns: 0, open: None };
    while let Ok(item) = items.recv() {
        thread.take(item)?;
        while let Some(chunk) = thread.builder.next_chunk() {
            thread.write(&chunk)?;
            if Duration::from_nanos(thread.builder.length_ns().unsigned_abs()) >= settings.session_length {
                thread.end_session()?;
            }
        }
    }
    thread.end_session()
}

struct RecordingThread<'a> {
    settings: &'a HandInSettings,
    builder: SessionBuilder,
    /// Added to the times of items (ns).
    clock_shift_ns: i64,
    open: Option<Open>,
}

impl RecordingThread<'_> {
    fn take(&mut self, item: Item) -> Result<(), RecordingError> {
        let builder = &mut self.builder;
        let of_sensors = |stamp_ns: i64| stamp_ns.saturating_add(self.clock_shift_ns);
        match item {
            Item::Reading(reading) => {
                builder.reading(ImuSample { stamp_ns: of_sensors(reading.stamp_ns), ..reading });
            }
            Item::Image(stamp_ns) => builder.image(of_sensors(stamp_ns)),
            Item::Tracks(stamp_ns, tracks) => builder.tracks(of_sensors(stamp_ns), tracks),
            Item::Pose(stamp_ns, local_from_imu) => builder.pose(of_sensors(stamp_ns), local_from_imu),
            Item::Features(stamp_ns, camera, features) => {
                builder.features(of_sensors(stamp_ns), camera, features);
            }
            Item::Answer(answer) => {
                builder.answer(Answer { stamp_ns: of_sensors(answer.stamp_ns), ..answer });
            }
            Item::Restart => builder.restart(),
            Item::ClockShift(shift_ns) => return self.shift_clock(shift_ns),
        }
        Ok(())
    }

    /// The clock of the sensors was set. What was recorded before becomes a session of its own, and the next one begins: the times of
    /// one session are of one clock.
    fn shift_clock(&mut self, shift_ns: i64) -> Result<(), RecordingError> {
        let by_ns = shift_ns.saturating_sub(std::mem::replace(&mut self.clock_shift_ns, shift_ns));
        if by_ns == 0 {
            return Ok(());
        }
        if by_ns.unsigned_abs() > WRONG_CLOCK_NS {
            self.discard_session()?;
        } else {
            self.end_session()?;
        }
        self.builder.shift_clock(by_ns);
        Ok(())
    }

    /// Removes the session that is being recorded: a map takes its times for those when landmarks were seen.
    fn discard_session(&mut self) -> Result<(), RecordingError> {
        self.builder.end_session();
        let Some(Open { path, .. }) = self.open.take() else { return Ok(()) };
        tracing::warn!(
            "{} was recorded with a clock that was off by more than a day, and is removed",
            path.display()
        );
        std::fs::remove_file(&path).map_err(|source| RecordingError::Folder { path, source })
    }

    fn write(&mut self, chunk: &Chunk) -> Result<(), RecordingError> {
        let open = match &mut self.open {
            Some(open) => open,
            none => none.insert(begin(self.settings, chunk.recorded.begin_ns)?),
        };
        let before = open.writer.bytes();
        open.writer.append(chunk)?;
        self.builder.wrote(open.writer.bytes() - before);
        Ok(())
    }

    fn end_session(&mut self) -> Result<(), RecordingError> {
        if let Some(chunk) = self.builder.end_session() {
            self.write(&chunk)?;
        }
        let Some(Open { writer, path, _lock }) = self.open.take() else { return Ok(()) };
        writer.finish()?;
        folder::finish(&path, self.settings.key.as_deref())
            .map_err(|source| RecordingError::Folder { path, source })?;
        Ok(())
    }
}

/// Begins a session.
///
/// # Arguments
/// * `begin_ns`: time of its first image: where a recording is played, it began by the clock of that recording.
fn begin(settings: &HandInSettings, begin_ns: i64) -> Result<Open, RecordingError> {
    let folder = &settings.folder;
    let of_folder = |source| RecordingError::Folder { path: folder.clone(), source };
    let bytes = folder::bytes_in(folder).map_err(of_folder)?;
    if bytes > settings.most_bytes {
        return Err(RecordingError::Full { path: folder.clone(), bytes });
    }
    let now_unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_secs());
    let path = folder::next_path(folder, &settings.header.robot, now_unix_s);
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let of_recording = u64::try_from(begin_ns / 1_000_000_000).unwrap_or(0);
    let started_unix_s = if settings.realtime { now_unix_s } else { of_recording };
    let header = Header { name, started_unix_s, ..settings.header.clone() };
    let writer = SessionWriter::create(&path, &header)?;
    let lock = folder::lock(&path).map_err(|source| RecordingError::Folder { path: path.clone(), source })?;
    Ok(Open { writer, path, _lock: lock })
}
