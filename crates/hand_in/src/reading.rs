//! Reads session files.

use std::path::{Path, PathBuf};

use crate::MAGIC;
use crate::block::{Block, kind};
use crate::blocks::Blocks;
use crate::chunk::{self, Answer, Chunk, ChunkFormat, RecordedSoFar, SessionFrame};
use crate::error::{ChunkError, HandInError};
use crate::header::{self, Header};
use crate::memory::MAX_SESSION_MEMORY_BYTES;
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
        Self::of_bytes(path, &read_file(path)?)
    }

    /// The session of the bytes of a file.
    ///
    /// # Arguments
    /// * `path`: what it is called in errors.
    ///
    /// # Errors
    /// As [`Session::open`].
    pub fn of_bytes(path: &Path, bytes: &[u8]) -> Result<Self, HandInError> {
        Decoder::decode(path, bytes, true)
    }

    /// What identifies a file: that of its last chunk, of which nothing else is decoded, nor of those before it. `None` where no chunk
    /// is whole.
    ///
    /// # Errors
    /// [`HandInError`]: the file cannot be read, is none, or its last chunk does not begin as one does.
    pub fn identify(path: &Path) -> Result<Option<RecordedSoFar>, HandInError> {
        let bytes = read_file(path)?;
        let (_, blocks) = Blocks::of_file(path, &bytes)?;
        let last = blocks.filter(|(_, block)| block.kind == kind::CHUNK).last();
        let identity = last.map(|(begin, block)| {
            chunk::decode_identity(block.payload).map_err(|source| HandInError::Chunk {
                path: path.to_owned(),
                offset: begin as u64,
                source,
            })
        });
        identity.transpose()
    }

    /// Checks the bytes of a file as [`Session::of_bytes`] does, with the memory of one chunk at a time.
    ///
    /// # Returns
    /// The session without readings, images, answers and samples.
    ///
    /// # Errors
    /// As [`Session::open`].
    pub(crate) fn check(path: &Path, bytes: &[u8]) -> Result<Self, HandInError> {
        Decoder::decode(path, bytes, false)
    }

    /// Keyframe candidates, of all cameras.
    pub fn candidates(&self) -> usize {
        self.frames.iter().map(|frame| frame.candidates.len()).sum()
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

fn read_file(path: &Path) -> Result<Vec<u8>, HandInError> {
    files::read(path, MAX_SESSION_BYTES).map_err(|source| HandInError::Io { path: path.to_owned(), source })
}

/// Decodes a file, chunk by chunk.
struct Decoder {
    session: Session,
    /// Whether the content of chunks stays in memory.
    keeps: bool,
    /// Bytes of memory that all chunks take, kept or not.
    memory: u64,
    last_reading_ns: Option<i64>,
    last_frame_ns: Option<i64>,
}

impl Decoder {
    fn decode(path: &Path, bytes: &[u8], keeps: bool) -> Result<Session, HandInError> {
        let (header, mut blocks) = Blocks::of_file(path, bytes)?;
        let (header, steps) = header::decode(path, header.payload)?;
        let session = Session {
            path: path.to_owned(),
            header,
            recorded: None,
            readings: Vec::new(),
            frames: Vec::new(),
            answers: Vec::new(),
            is_ended: false,
            whole_bytes: 0,
            signature: None,
        };
        let cameras = session.header.cameras.len();
        let format = ChunkFormat { schema: blocks.schema(), steps, cameras };
        let mut decoder = Self { session, keeps, memory: 0, last_reading_ns: None, last_frame_ns: None };
        for (begin, block) in &mut blocks {
            let offset = begin as u64;
            decoder.take(&block, offset, format).map_err(|source| HandInError::Chunk {
                path: path.to_owned(),
                offset,
                source,
            })?;
        }
        decoder.session.whole_bytes = blocks.whole_bytes() as u64;
        Ok(decoder.session)
    }

    fn take(&mut self, block: &Block<'_>, offset: u64, format: ChunkFormat) -> Result<(), ChunkError> {
        match block.kind {
            kind::CHUNK => {
                let (chunk, memory) = chunk::decode(block.payload, format)?;
                self.memory = self.memory.saturating_add(memory);
                if self.memory > MAX_SESSION_MEMORY_BYTES {
                    return Err(ChunkError::SessionMemory);
                }
                self.append(chunk)
            }
            kind::END => {
                self.session.is_ended = true;
                Ok(())
            }
            kind::SIGNATURE => {
                let text =
                    std::str::from_utf8(block.payload).map_err(|_| ChunkError::Range("a signature"))?;
                self.session.signature = Some((offset, text.to_owned()));
                Ok(())
            }
            other => Err(ChunkError::Kind(other)),
        }
    }

    fn append(&mut self, chunk: Chunk) -> Result<(), ChunkError> {
        let Chunk { mut recorded, readings, frames, answers } = chunk;
        let follows =
            |last: Option<i64>, next: Option<i64>| last.zip(next).is_none_or(|(last, next)| last < next);
        if !follows(self.last_reading_ns, readings.first().map(|reading| reading.stamp_ns))
            || !follows(self.last_frame_ns, frames.first().map(|frame| frame.stamp_ns))
        {
            return Err(ChunkError::Order);
        }
        self.last_reading_ns = readings.last().map(|reading| reading.stamp_ns).or(self.last_reading_ns);
        self.last_frame_ns = frames.last().map(|frame| frame.stamp_ns).or(self.last_frame_ns);
        let session = &mut self.session;
        if self.keeps {
            session.readings.extend(readings);
            session.frames.extend(frames);
            session.answers.extend(answers);
        } else {
            recorded.new_samples = Vec::new();
        }
        if let Some(before) = session.recorded.take() {
            let new = std::mem::replace(&mut recorded.new_samples, before.new_samples);
            recorded.new_samples.extend(new);
        }
        session.recorded = Some(recorded);
        Ok(())
    }
}
