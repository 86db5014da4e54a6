//! Blocks: the parts of a session file that are there as a whole or do not count.
//!
//! ```text
//! length of the payload u32 LE | kind u8 | CRC-32 (IEEE) of length, kind and payload u32 LE | payload
//! ```

/// Bytes before the payload.
const HEADER_BYTES: usize = 9;
/// Most bytes of a payload; a chunk of some seconds has some tens of kilobytes.
pub(crate) const MAX_BLOCK_BYTES: usize = 16 << 20;

/// What a block holds.
pub(crate) mod kind {
    /// The header, the first block and nowhere else.
    pub(crate) const HEADER: u8 = 1;
    /// Some seconds of the session.
    pub(crate) const CHUNK: u8 = 2;
    /// The robot ended the session itself; it has no payload.
    pub(crate) const END: u8 = 3;
    /// A signature of all bytes before it, in the format of minisign; the last block.
    pub(crate) const SIGNATURE: u8 = 4;
}

/// A block that is whole.
pub(crate) struct Block<'a> {
    pub(crate) kind: u8,
    pub(crate) payload: &'a [u8],
    /// Bytes of the block in the file.
    pub(crate) size: usize,
}

/// The bytes of a block; `None` where the payload is too large.
pub(crate) fn encode(kind: u8, payload: &[u8]) -> Option<Vec<u8>> {
    let length = u32::try_from(payload.len()).ok().filter(|_| payload.len() <= MAX_BLOCK_BYTES)?;
    let mut bytes = Vec::with_capacity(HEADER_BYTES + payload.len());
    bytes.extend(length.to_le_bytes());
    bytes.push(kind);
    bytes.extend(checksum(length, kind, payload).to_le_bytes());
    bytes.extend(payload);
    Some(bytes)
}

/// The block at the beginning of some bytes; `None` where it is not whole.
pub(crate) fn first(bytes: &[u8]) -> Option<Block<'_>> {
    let (&[l0, l1, l2, l3, kind, c0, c1, c2, c3], rest) = bytes.split_first_chunk::<HEADER_BYTES>()?;
    let length = u32::from_le_bytes([l0, l1, l2, l3]);
    let payload = rest.get(..usize::try_from(length).ok()?)?;
    let is_whole = payload.len() <= MAX_BLOCK_BYTES
        && checksum(length, kind, payload) == u32::from_le_bytes([c0, c1, c2, c3]);
    is_whole.then(|| Block { kind, payload, size: HEADER_BYTES + payload.len() })
}

fn checksum(length: u32, kind: u8, payload: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&length.to_le_bytes());
    hasher.update(&[kind]);
    hasher.update(payload);
    hasher.finalize()
}
