//! Where the messages of a file of chunks are: by the index behind each chunk, or by the chunk itself where that is missing.

use crate::chunks::{Chunk, ChunkedFile, Packing};
use crate::storage::NO_CHUNK;
use std::collections::BTreeMap;

/// Messages of a channel: log time, chunk, offset.
pub(crate) type Messages = Vec<(i64, u32, u64)>;

/// The messages of a file so far, by channel.
pub(crate) struct ChunkIndex<C> {
    pub(crate) file: ChunkedFile,
    pub(crate) messages: BTreeMap<C, Messages>,
    /// The newest chunk and what its index says so far.
    newest: Option<(u32, Vec<(C, Messages)>)>,
}

impl<C: Ord> ChunkIndex<C> {
    pub(crate) fn new(file: ChunkedFile) -> Self {
        Self { file, messages: BTreeMap::new(), newest: None }
    }

    /// Takes note of a chunk, whose index may follow.
    pub(crate) fn add_chunk(&mut self, chunk: Chunk) {
        self.file.chunks.push(chunk);
        self.newest = Some((self.file.chunks.len() as u32 - 1, Vec::new()));
    }

    /// Takes the messages of a channel in the newest chunk from its index: log times, and offsets in the chunk.
    pub(crate) fn add_index(&mut self, channel: C, entries: impl Iterator<Item = (i64, u64)>) {
        let Some(number) = self.newest.as_ref().map(|(number, _)| *number) else { return };
        let (number, base) = self.address(number);
        let messages =
            entries.map(|(stamp_ns, offset)| (stamp_ns, number, base.saturating_add(offset))).collect();
        if let Some((_, channels)) = &mut self.newest {
            channels.push((channel, messages));
        }
    }

    /// Takes the index of the newest chunk.
    ///
    /// # Returns
    /// The chunk, where its index is missing or cut off: it is to be searched itself.
    pub(crate) fn end_chunk(&mut self, is_complete: bool) -> Option<u32> {
        let (number, channels) = self.newest.take()?;
        if channels.is_empty() || !is_complete {
            return Some(number);
        }
        for (channel, messages) in channels {
            self.messages.entry(channel).or_default().extend(messages);
        }
        None
    }

    /// Takes note of a message at an offset of a chunk, or of the file for [`NO_CHUNK`].
    pub(crate) fn add_message(&mut self, channel: C, stamp_ns: i64, chunk: u32, offset: u64) {
        let (number, base) = if chunk == NO_CHUNK { (NO_CHUNK, 0) } else { self.address(chunk) };
        self.messages.entry(channel).or_default().push((stamp_ns, number, base + offset));
    }

    /// How the messages of a chunk are addressed: those that are not compressed are read from the file.
    fn address(&self, chunk: u32) -> (u32, u64) {
        match self.file.chunks[chunk as usize] {
            Chunk { packing: Packing::None, start, .. } => (NO_CHUNK, start),
            _ => (chunk, 0),
        }
    }
}
