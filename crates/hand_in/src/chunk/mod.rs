//! A chunk: all that a robot recorded in a few seconds. It is read by itself, whatever became of those before it.

mod answers;
mod candidates;
mod frames;
mod identity;
mod pixels;
mod readings;

use types::{ImuSample, TrackObservation};

pub use answers::{Answer, AnsweredMatch};
pub use candidates::Candidate;
pub use identity::RecordedSoFar;

use crate::bytes::{Reader, Writer};
use crate::error::ChunkError;
use crate::schema::Schema;

/// What the cameras of a robot saw at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionFrame {
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// Tracked points, by id and camera; pixels to a 16th.
    pub tracks: Vec<TrackObservation>,
    /// Its images that are keyframe candidates, ascending by camera.
    pub candidates: Vec<Candidate>,
}

/// Some seconds of a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chunk {
    /// What the whole recording up to here is identified by.
    pub recorded: RecordedSoFar,
    /// Readings of the IMU, ascending in time.
    pub readings: Vec<ImuSample>,
    /// Images, ascending in time.
    pub frames: Vec<SessionFrame>,
    /// Answers of the map about candidates, in this chunk or in one before it.
    pub answers: Vec<Answer>,
}

/// How the chunks of a file are written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChunkFormat {
    /// The version of the format.
    pub(crate) schema: Schema,
    /// What readings are rounded to: of the gyroscope (rad/s) and of the accelerometer (m/s^2).
    pub(crate) steps: [f64; 2],
    /// How many cameras there are.
    pub(crate) cameras: usize,
}

impl ChunkFormat {
    /// Whether candidates and answers of a camera can be written.
    fn has_camera(self, camera: usize) -> bool {
        match self.schema {
            Schema::FirstCamera => camera == 0,
            Schema::EachCamera => camera < self.cameras,
        }
    }

    /// Writes the camera of a candidate or an answer, where the format states it.
    fn write_camera(self, out: &mut Writer, camera: usize) {
        if self.schema == Schema::EachCamera {
            out.unsigned(camera as u64);
        }
    }

    /// Reads what [`ChunkFormat::write_camera`] wrote.
    fn read_camera(self, input: &mut Reader<'_>) -> Result<usize, ChunkError> {
        match self.schema {
            Schema::FirstCamera => Ok(0),
            Schema::EachCamera => usize::try_from(input.unsigned()?)
                .ok()
                .filter(|camera| *camera < self.cameras)
                .ok_or(ChunkError::Range("the camera of an image")),
        }
    }
}

/// The bytes of a chunk.
pub(crate) fn encode(chunk: &Chunk, format: ChunkFormat) -> Vec<u8> {
    let mut out = Writer::default();
    identity::write(&mut out, &chunk.recorded);
    readings::write(&mut out, &chunk.readings, format.steps);
    frames::write(&mut out, &chunk.frames, format);
    answers::write(&mut out, &chunk.answers, format);
    out.0
}

/// The chunk of some bytes, and how many bytes of memory it takes.
pub(crate) fn decode(bytes: &[u8], format: ChunkFormat) -> Result<(Chunk, u64), ChunkError> {
    let mut input = Reader::new(bytes);
    let chunk = Chunk {
        recorded: identity::read(&mut input)?,
        readings: readings::read(&mut input, format.steps)?,
        frames: frames::read(&mut input, format)?,
        answers: answers::read(&mut input, format)?,
    };
    Ok((chunk, input.end()?))
}

/// What the recording up to the end of a chunk is identified by; nothing else of the chunk is decoded.
pub(crate) fn decode_identity(bytes: &[u8]) -> Result<RecordedSoFar, ChunkError> {
    identity::read(&mut Reader::new(bytes))
}

/// Times that ascend, as differences.
struct Times(Option<i64>);

impl Times {
    fn write(&mut self, out: &mut Writer, stamp_ns: i64) {
        match self.0 {
            Some(last_ns) => out.unsigned(stamp_ns.wrapping_sub(last_ns) as u64),
            None => out.signed(stamp_ns),
        }
        self.0 = Some(stamp_ns);
    }

    /// A time after the last one.
    fn read(&mut self, input: &mut Reader<'_>) -> Result<i64, ChunkError> {
        let last_ns = self.0;
        let stamp_ns = self.read_same_or_later(input)?;
        if last_ns == Some(stamp_ns) { Err(ChunkError::Order) } else { Ok(stamp_ns) }
    }

    /// A time that is not before the last one.
    fn read_same_or_later(&mut self, input: &mut Reader<'_>) -> Result<i64, ChunkError> {
        let stamp_ns = match self.0 {
            None => input.signed()?,
            Some(last_ns) => {
                let step = i64::try_from(input.unsigned()?).map_err(|_| ChunkError::Order)?;
                last_ns.checked_add(step).ok_or(ChunkError::Order)?
            }
        };
        self.0 = Some(stamp_ns);
        Ok(stamp_ns)
    }
}
