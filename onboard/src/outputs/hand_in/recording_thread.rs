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
    Features(i64, FeatureSet),
    Answer(Answer),
    Restart,
}

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
    let mut thread =
        RecordingThread { settings, builder: SessionBuilder::new(settings.bytes_per_minute), open: None };
    while let Ok(item) = items.recv() {
        thread.take(item);
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
    open: Option<Open>,
}

impl RecordingThread<'_> {
    fn take(&mut self, item: Item) {
        let builder = &mut self.builder;
        match item {
            Item::Reading(reading) => builder.reading(reading),
            Item::Image(stamp_ns) => builder.image(stamp_ns),
            Item::Tracks(stamp_ns, tracks) => builder.tracks(stamp_ns, tracks),
            Item::Pose(stamp_ns, local_from_imu) => builder.pose(stamp_ns, local_from_imu),
            Item::Features(stamp_ns, features) => builder.features(stamp_ns, features),
            Item::Answer(answer) => builder.answer(answer),
            Item::Restart => builder.restart(),
        }
    }

    fn write(&mut self, chunk: &Chunk) -> Result<(), RecordingError> {
        let open = match &mut self.open {
            Some(open) => open,
            none => none.insert(begin(self.settings)?),
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
fn begin(settings: &HandInSettings) -> Result<Open, RecordingError> {
    let folder = &settings.folder;
    let of_folder = |source| RecordingError::Folder { path: folder.clone(), source };
    let bytes = folder::bytes_in(folder).map_err(of_folder)?;
    if bytes > settings.most_bytes {
        return Err(RecordingError::Full { path: folder.clone(), bytes });
    }
    let started_unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_secs());
    let path = folder::next_path(folder, &settings.header.robot, started_unix_s);
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let header = Header { name, started_unix_s, ..settings.header.clone() };
    let writer = SessionWriter::create(&path, &header)?;
    let lock = folder::lock(&path).map_err(|source| RecordingError::Folder { path: path.clone(), source })?;
    Ok(Open { writer, path, _lock: lock })
}
