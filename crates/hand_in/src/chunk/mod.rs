//! A chunk: all that a robot recorded in a few seconds. It is read by itself, whatever became of those before it.

mod answers;
mod frames;
mod identity;
mod readings;

use types::{FeatureSet, ImuSample, TrackObservation};

pub use answers::{Answer, AnsweredMatch};
pub use identity::RecordedSoFar;

use crate::bytes::{Reader, Writer};
use crate::error::ChunkError;

/// What the cameras of a robot saw at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionFrame {
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// Tracked points, by id and camera; pixels to a 16th.
    pub tracks: Vec<TrackObservation>,
    /// Features of the image of camera 0, of a keyframe candidate; pixels to an eighth.
    pub features: Option<FeatureSet>,
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

/// The bytes of a chunk.
///
/// # Arguments
/// * `steps`: what readings are rounded to, of the gyroscope (rad/s) and of the accelerometer (m/s^2).
pub(crate) fn encode(chunk: &Chunk, steps: [f64; 2]) -> Vec<u8> {
    let mut out = Writer::default();
    identity::write(&mut out, &chunk.recorded);
    readings::write(&mut out, &chunk.readings, steps);
    frames::write(&mut out, &chunk.frames);
    answers::write(&mut out, &chunk.answers);
    out.0
}

/// The chunk of some bytes, and how many bytes of memory it takes.
///
/// # Arguments
/// * `steps`: those that it was written with.
/// * `cameras`: how many there are.
pub(crate) fn decode(bytes: &[u8], steps: [f64; 2], cameras: usize) -> Result<(Chunk, u64), ChunkError> {
    let mut input = Reader::new(bytes);
    let chunk = Chunk {
        recorded: identity::read(&mut input)?,
        readings: readings::read(&mut input, steps)?,
        frames: frames::read(&mut input, cameras)?,
        answers: answers::read(&mut input)?,
    };
    Ok((chunk, input.end()?))
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

    fn read(&mut self, input: &mut Reader<'_>) -> Result<i64, ChunkError> {
        let stamp_ns = match self.0 {
            None => input.signed()?,
            Some(last_ns) => {
                let step = i64::try_from(input.unsigned()?).map_err(|_| ChunkError::Order)?;
                let next_ns = last_ns.checked_add(step).ok_or(ChunkError::Order)?;
                if next_ns <= last_ns {
                    return Err(ChunkError::Order);
                }
                next_ns
            }
        };
        self.0 = Some(stamp_ns);
        Ok(stamp_ns)
    }
}
