//! What identifies a recording, up to the end of a chunk.

use crate::bytes::{Reader, Writer};
use crate::error::ChunkError;

/// The identity of all that was recorded up to the end of a chunk, as the ledger of a map has it (`map::sessions::Recorded`).
///
/// It is computed of the readings as they came, before they are rounded, and of all images: so it is that of the same drive in a
/// recording with images.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordedSoFar {
    /// Digest.
    pub id: [u8; 16],
    /// First image and ...
    pub begin_ns: i64,
    /// ... last image (ns).
    pub end_ns: i64,
    /// Images.
    pub images: u64,
    /// Readings.
    pub readings: u64,
    /// Samples of readings that came since the last chunk.
    pub new_samples: Vec<u64>,
}

pub(super) fn write(out: &mut Writer, recorded: &RecordedSoFar) {
    out.bytes(&recorded.id);
    out.signed(recorded.begin_ns);
    out.signed(recorded.end_ns);
    out.unsigned(recorded.images);
    out.unsigned(recorded.readings);
    out.unsigned(recorded.new_samples.len() as u64);
    for sample in &recorded.new_samples {
        out.bytes(&sample.to_le_bytes());
    }
}

pub(super) fn read(input: &mut Reader<'_>) -> Result<RecordedSoFar, ChunkError> {
    let id = input.array()?;
    let (begin_ns, end_ns) = (input.signed()?, input.signed()?);
    let (images, readings) = (input.unsigned()?, input.unsigned()?);
    if begin_ns > end_ns {
        return Err(ChunkError::Order);
    }
    let (mut new_samples, count) = input.list()?;
    for _ in 0..count {
        new_samples.push(u64::from_le_bytes(input.array()?));
    }
    Ok(RecordedSoFar { id, begin_ns, end_ns, images, readings, new_samples })
}
