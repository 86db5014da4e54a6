//! Reads session files.

use std::path::{Path, PathBuf};

use crate::block::{self, kind};
use crate::chunk::{self, Answer, Chunk, RecordedSoFar, SessionFrame};
use crate::error::{ChunkError, HandInError};
use crate::header::{self, Header};
use crate::{MAGIC, SCHEMA};
use protocol::MAX_SESSION_BYTES;
use types::ImuSample;

/// What a robot recorded and handed in, as far as it is whole.
///
/// ```no_run
/// let session = hand_in::Session::open("robot7_2026-11-28.session".as_ref())?;
/// println!("{}: {} images, {} candidates", session.header.robot, session.frames.len(), session.candidates());
/// # Ok::<(), hand_in::HandInError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Session {
    /// The file.
    pub path: PathBuf,
    /// Who recorded it, with which sensors.
    pub header: Header,
    /// What identifies it; `None` where no chunk is whole.
    pub recorded: Option<RecordedSoFar>,
    /// Readings of the IMU, ascending in time.
    pub readings: Vec<ImuSample>,
    /// Images, ascending in time.
    pub frames: Vec<SessionFrame>,
    /// Answers of the map, by chunk.
    pub answers: Vec<Answer>,
    /// Whether the robot ended the session itself. Otherwise it was stopped, and what it had written counts.
    pub is_ended: bool,
    /// How many bytes of the file count. Those behind them were being written when the robot was stopped.
    pub whole_bytes: u64,
    /// How many bytes a signature covers, and its text in the format of minisign.
    pub signature: Option<(u64, String)>,
}

impl Session {
    /// Reads a session file up to the first block that is not whole.
    ///
    /// # Errors
    /// [`HandInError`]: the file cannot be read, is none, or holds what cannot be.
    pub fn open(path: &Path) -> Result<Self, HandInError> {
        let bytes = files::read(path, MAX_SESSION_BYTES)
            .map_err(|source| HandInError::Io { path: path.to_owned(), source })?;
        Self::of_bytes(path, &bytes)
    }

    /// The session of the bytes of a file.
    ///
    /// # Arguments
    /// * `path`: what it is called in errors.
    ///
    /// # Errors
    /// As [`Session::open`].
    pub fn of_bytes(path: &Path, bytes: &[u8]) -> Result<Self, HandInError> {
        let own = || path.to_owned();
        let Some(after_magic) = bytes.strip_prefix(MAGIC) else {
            return Err(HandInError::OtherFormat { path: own() });
        };
        let Some((schema, mut rest)) = after_magic.split_first_chunk::<2>() else {
            return Err(HandInError::NoHeader { path: own() });
        };
        let found = u16::from_le_bytes(*schema);
        if found != SCHEMA {
            return Err(HandInError::Schema { path: own(), found, expected: SCHEMA });
        }
        let first = block::first(rest).filter(|block| block.kind == kind::HEADER);
        let Some(first) = first else { return Err(HandInError::NoHeader { path: own() }) };
        let (header, steps) = header::decode(path, first.payload)?;
        rest = &rest[first.size..];
        let mut session = Self {
            path: own(),
            header,
            recorded: None,
            readings: Vec::new(),
            frames: Vec::new(),
            answers: Vec::new(),
            is_ended: false,
            whole_bytes: (bytes.len() - rest.len()) as u64,
            signature: None,
        };
        while let Some(block) = block::first(rest) {
            let offset = session.whole_bytes;
            session.take(&block, steps).map_err(|source| HandInError::Chunk {
                path: own(),
                offset,
                source,
            })?;
            rest = &rest[block.size..];
            session.whole_bytes += block.size as u64;
            if session.signature.is_some() {
                break;
            }
        }
        Ok(session)
    }

    fn take(&mut self, block: &block::Block<'_>, steps: [f64; 2]) -> Result<(), ChunkError> {
        match block.kind {
            kind::CHUNK => {
                let chunk = chunk::decode(block.payload, steps, self.header.cameras.len())?;
                self.append(chunk)
            }
            kind::END => {
                self.is_ended = true;
                Ok(())
            }
            kind::SIGNATURE => {
                let text =
                    std::str::from_utf8(block.payload).map_err(|_| ChunkError::Range("a signature"))?;
                self.signature = Some((self.whole_bytes, text.to_owned()));
                Ok(())
            }
            other => Err(ChunkError::Kind(other)),
        }
    }

    fn append(&mut self, chunk: Chunk) -> Result<(), ChunkError> {
        let Chunk { mut recorded, readings, frames, answers } = chunk;
        let follows =
            |last: Option<i64>, next: Option<i64>| last.zip(next).is_none_or(|(last, next)| last < next);
        let last_reading = self.readings.last().map(|reading| reading.stamp_ns);
        let last_frame = self.frames.last().map(|frame| frame.stamp_ns);
        if !follows(last_reading, readings.first().map(|reading| reading.stamp_ns))
            || !follows(last_frame, frames.first().map(|frame| frame.stamp_ns))
        {
            return Err(ChunkError::Order);
        }
        self.readings.extend(readings);
        self.frames.extend(frames);
        self.answers.extend(answers);
        if let Some(before) = self.recorded.take() {
            let new = std::mem::replace(&mut recorded.new_samples, before.new_samples);
            recorded.new_samples.extend(new);
        }
        self.recorded = Some(recorded);
        Ok(())
    }

    /// Images with features.
    pub fn candidates(&self) -> usize {
        self.frames.iter().filter(|frame| frame.features.is_some()).count()
    }

    /// From the first image to the last, seconds; 0 without any.
    pub fn seconds(&self) -> f64 {
        let ends = self.frames.first().zip(self.frames.last());
        ends.map_or(0.0, |(first, last)| (last.stamp_ns - first.stamp_ns) as f64 * 1e-9)
    }

    /// Whether a file is a session file, by how it begins.
    pub fn is_session(path: &Path) -> bool {
        use std::io::Read as _;
        let mut begin = [0; MAGIC.len()];
        path.is_file()
            && files::open(path).and_then(|mut file| file.read_exact(&mut begin)).is_ok()
            && begin == *MAGIC
    }
}
