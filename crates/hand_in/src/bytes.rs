//! Integers of variable length, written and read with bounds.

use crate::error::ChunkError;

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

/// Bytes that are read.
pub(crate) struct Reader<'a>(pub(crate) &'a [u8]);

impl<'a> Reader<'a> {
    /// What [`Writer::unsigned`] wrote.
    pub(crate) fn unsigned(&mut self) -> Result<u64, ChunkError> {
        let mut value = 0;
        for position in 0..MOST_BYTES {
            let (&byte, rest) = self.0.split_first().ok_or(ChunkError::TooShort)?;
            self.0 = rest;
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
        let (bytes, rest) = self.0.split_at_checked(count).ok_or(ChunkError::TooShort)?;
        self.0 = rest;
        Ok(bytes)
    }

    /// An array of bytes.
    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], ChunkError> {
        let (bytes, rest) = self.0.split_first_chunk::<N>().ok_or(ChunkError::TooShort)?;
        self.0 = rest;
        Ok(*bytes)
    }

    /// The number of elements of a list, each of at least one byte: what is announced and not there reserves no memory.
    pub(crate) fn count(&mut self) -> Result<usize, ChunkError> {
        let count = usize::try_from(self.unsigned()?).map_err(|_| ChunkError::TooShort)?;
        if count > self.0.len() { Err(ChunkError::TooShort) } else { Ok(count) }
    }
}
