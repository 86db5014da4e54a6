//! Integers of variable length, written and read with bounds.

use crate::error::ChunkError;
use crate::memory::ChunkMemory;

/// Most bytes of an integer of 64 bits.
const MOST_BYTES: u32 = 10;

/// Bytes that are written.
#[derive(Default)]
pub(crate) struct Writer(pub(crate) Vec<u8>);

impl Writer {
    /// An unsigned integer: seven bits a byte, the lowest first.
    pub(crate) fn unsigned(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    /// A signed integer, of which small ones of either sign are short.
    pub(crate) fn signed(&mut self, value: i64) {
        self.unsigned(((value << 1) ^ (value >> 63)) as u64);
    }

    /// Bytes as they are.
    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }
}

/// Bytes that are read, and the memory that what is read may take.
pub(crate) struct Reader<'a> {
    rest: &'a [u8],
    memory: ChunkMemory,
}

impl<'a> Reader<'a> {
    /// All bytes of a chunk.
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, memory: ChunkMemory::of(bytes.len()) }
    }

    /// Ends reading.
    ///
    /// # Returns
    /// Bytes of memory that was taken.
    ///
    /// # Errors
    /// [`ChunkError::TooLong`] where bytes are left.
    pub(crate) fn end(self) -> Result<u64, ChunkError> {
        if self.rest.is_empty() { Ok(self.memory.taken()) } else { Err(ChunkError::TooLong(self.rest.len())) }
    }

    /// What [`Writer::unsigned`] wrote.
    pub(crate) fn unsigned(&mut self) -> Result<u64, ChunkError> {
        let mut value = 0;
        for position in 0..MOST_BYTES {
            let (&byte, rest) = self.rest.split_first().ok_or(ChunkError::TooShort)?;
            self.rest = rest;
            let bits = u64::from(byte & 0x7f);
            let shifted = bits << (7 * position);
            if shifted >> (7 * position) != bits {
                break;
            }
            value |= shifted;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(ChunkError::Integer)
    }

    /// What [`Writer::signed`] wrote.
    pub(crate) fn signed(&mut self) -> Result<i64, ChunkError> {
        let value = self.unsigned()?;
        Ok((value >> 1) as i64 ^ -((value & 1) as i64))
    }

    /// So many bytes.
    pub(crate) fn bytes(&mut self, count: usize) -> Result<&'a [u8], ChunkError> {
        let (bytes, rest) = self.rest.split_at_checked(count).ok_or(ChunkError::TooShort)?;
        self.rest = rest;
        Ok(bytes)
    }

    /// An array of bytes.
    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], ChunkError> {
        let (bytes, rest) = self.rest.split_first_chunk::<N>().ok_or(ChunkError::TooShort)?;
        self.rest = rest;
        Ok(*bytes)
    }

    /// The number of elements of a list, each of at least one byte: what is announced and not there reserves no memory.
    pub(crate) fn count(&mut self) -> Result<usize, ChunkError> {
        let count = usize::try_from(self.unsigned()?).map_err(|_| ChunkError::TooShort)?;
        if count > self.rest.len() { Err(ChunkError::TooShort) } else { Ok(count) }
    }

    /// An empty list that has the memory for as many elements as it says, and their number.
    pub(crate) fn list<T>(&mut self) -> Result<(Vec<T>, usize), ChunkError> {
        let count = self.count()?;
        self.take::<T>(count)?;
        Ok((Vec::with_capacity(count), count))
    }

    /// Takes the memory of some values, before they are made.
    pub(crate) fn take<T>(&mut self, count: usize) -> Result<(), ChunkError> {
        self.memory.take::<T>(count)
    }
}
