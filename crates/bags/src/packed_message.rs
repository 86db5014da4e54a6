//! Messages that are compressed each for itself with zstd, as `ros2 bag record --compression-mode message` writes them.
//!
//! `metadata.yaml` says so, and may be lost. A message tells it by itself: no message of ROS 2 begins with the four bytes
//! of a zstd frame.

use crate::BagError;
use crate::storage::MAX_MESSAGE;
use std::io::Read;

/// The first bytes of a zstd frame.
pub(crate) const ZSTD_MAGIC: [u8; 4] = 0xfd2f_b528_u32.to_le_bytes();

/// The first bytes of a message as it was before it was compressed, if it is.
///
/// # Arguments
/// * `start`: its first bytes as they are stored, as many as are wanted and at least those of a zstd frame.
/// * `most`: so many bytes are wanted.
/// * `read_all`: reads all of its bytes as they are stored.
/// * `damaged`: the error for a problem.
pub(crate) fn finish(
    mut start: Vec<u8>,
    most: usize,
    read_all: impl FnOnce() -> Result<Vec<u8>, BagError>,
    damaged: impl FnOnce(String) -> BagError,
) -> Result<Vec<u8>, BagError> {
    if !start.starts_with(&ZSTD_MAGIC) {
        start.truncate(most);
        return Ok(start);
    }
    let packed = read_all()?;
    unpack(&packed, (most as u64).min(MAX_MESSAGE)).map_err(|error| damaged(error.to_string()))
}

fn unpack(packed: &[u8], most: u64) -> std::io::Result<Vec<u8>> {
    let mut unpacked = Vec::new();
    zstd::stream::Decoder::with_buffer(packed)?.take(most).read_to_end(&mut unpacked)?;
    Ok(unpacked)
}
