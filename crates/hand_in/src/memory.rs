//! How much memory the content of a session file may take: a few bytes of a file can announce many.

use crate::error::ChunkError;

/// Most bytes of memory that the content of a chunk takes for each of its bytes. Readings take 8 at most, tracked points 16, images
/// without a point 19.
pub const MAX_MEMORY_PER_BYTE: u64 = 20;
/// Most bytes of memory that the content of a session takes: four hours of a robot with an IMU of 1 kHz take 1.4 GB.
pub const MAX_SESSION_MEMORY_BYTES: u64 = 2 << 30;

/// The memory that a chunk may take, and what of it is taken.
pub(crate) struct ChunkMemory {
    most: u64,
    taken: u64,
}

impl ChunkMemory {
    /// None is taken yet.
    ///
    /// # Arguments
    /// * `bytes`: of the chunk in the file.
    pub(crate) fn of(bytes: usize) -> Self {
        Self { most: (bytes as u64).saturating_mul(MAX_MEMORY_PER_BYTE), taken: 0 }
    }

    /// Takes the memory of some values, before they are made.
    ///
    /// # Errors
    /// [`ChunkError::Memory`].
    pub(crate) fn take<T>(&mut self, count: usize) -> Result<(), ChunkError> {
        let bytes = (count as u64).saturating_mul(size_of::<T>() as u64);
        self.taken = self.taken.saturating_add(bytes);
        if self.taken > self.most { Err(ChunkError::Memory { most: self.most }) } else { Ok(()) }
    }

    /// Bytes that are taken.
    pub(crate) fn taken(&self) -> u64 {
        self.taken
    }
}
