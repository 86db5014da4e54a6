//! Lists of records, of which segments consist.
//!
//! ```text
//! number of records u64 LE
//! for each, ascending: key (8 bytes, of a pair 16, big-endian) | length u32 LE | record
//! ```

use super::record::{self, Element, RecordError, Table, key_bytes};
use super::segment::SegmentError;

/// A list while it is made.
#[derive(Default)]
pub(super) struct List {
    pub(super) count: u64,
    pub(super) bytes: Vec<u8>,
}

impl List {
    /// Adds an element, which comes after those before it.
    ///
    /// # Returns
    /// The payload of its record.
    ///
    /// # Errors
    /// [`RecordError::Unencodable`], of a record beyond 4 GiB.
    pub(super) fn add<E: Element>(&mut self, element: &E) -> Result<&[u8], RecordError> {
        let key = key_bytes(element.key().as_ref());
        let sealed = record::seal(E::TABLE.name(), &key, &element.to_record())?;
        let length = u32::try_from(sealed.len()).map_err(|_| RecordError::Unencodable {
            reason: format!("a record of {} bytes is too long", sealed.len()),
        })?;
        self.count += 1;
        self.bytes.extend(key);
        self.bytes.extend(length.to_le_bytes());
        let start = self.bytes.len() + record::HEADER_BYTES;
        self.bytes.extend(sealed);
        Ok(&self.bytes[start..])
    }
}

/// Reads lists one after the other. Counts and lengths are believed only as far as there are bytes.
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// # Arguments
    /// * `magic`: the bytes with which the segment begins.
    pub(super) fn new(bytes: &'a [u8], magic: &[u8]) -> Result<Self, SegmentError> {
        if bytes.starts_with(magic) {
            Ok(Self { bytes, at: magic.len() })
        } else {
            Err(SegmentError::NotASegment)
        }
    }

    /// The elements of the next list.
    pub(super) fn elements<E: Element>(&mut self) -> Result<Vec<E>, SegmentError> {
        let mut elements = Vec::new();
        self.records(E::TABLE, None, |key, payload| {
            elements.push(E::from_record(key, record::decode(payload)?)?);
            Ok(())
        })?;
        elements.shrink_to_fit();
        Ok(elements)
    }

    /// Visits keys and payloads of the next list.
    ///
    /// # Arguments
    /// * `previous`: the key after which they come.
    ///
    /// # Returns
    /// The last key.
    pub(super) fn records<K: Copy + Default + Ord + AsRef<[u64]> + AsMut<[u64]>>(
        &mut self,
        table: Table,
        mut previous: Option<K>,
        mut visit: impl FnMut(K, &[u8]) -> Result<(), RecordError>,
    ) -> Result<Option<K>, SegmentError> {
        for _ in 0..self.count()? {
            let mut key = K::default();
            let key_bytes = self.take(8 * key.as_ref().len())?;
            for (id, bytes) in key.as_mut().iter_mut().zip(key_bytes.as_chunks().0) {
                *id = u64::from_be_bytes(*bytes);
            }
            let record = || table.describe(key.as_ref());
            if previous.is_some_and(|previous| previous >= key) {
                return Err(SegmentError::Order { record: record() });
            }
            let length = u32::from_le_bytes(self.array()?) as usize;
            record::open(table.name(), key_bytes, self.take(length)?)
                .and_then(|payload| visit(key, payload))
                .map_err(|problem| SegmentError::Record { record: record(), problem })?;
            previous = Some(key);
        }
        Ok(previous)
    }

    /// How many records the next list states.
    pub(super) fn count(&mut self) -> Result<u64, SegmentError> {
        self.array().map(u64::from_le_bytes)
    }

    /// Ends the segment.
    pub(super) fn end(self) -> Result<(), SegmentError> {
        match self.bytes.len() - self.at {
            0 => Ok(()),
            bytes => Err(SegmentError::TooLong { bytes }),
        }
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], SegmentError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], SegmentError> {
        let end = self.at.checked_add(count);
        let taken = end.and_then(|end| self.bytes.get(self.at..end));
        let taken = taken.ok_or(SegmentError::CutOff { bytes: self.bytes.len() })?;
        self.at += count;
        Ok(taken)
    }
}
