//! Segments: many records in one piece of bytes, which never changes.
//!
//! ```text
//! "driftless segment 4\n"
//! for keyframes, landmarks, cross-covariances, common errors, aliases:
//!     number of records u64 LE
//!     for each, ascending: key (8 bytes, of a pair 16, big-endian) | length u32 LE | record
//! ```
//! Equal contents have equal bytes, whatever program and machine wrote them.

use protocol::LandmarkId;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::record::{self, Element, RecordError, Table, key_bytes};
use crate::model::{CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark};

const MAGIC: &[u8] = b"driftless segment 4\n";
/// In the order of their lists.
const TABLES: [Table; 5] =
    [Table::Keyframes, Table::Landmarks, Table::CrossCovariances, Table::CommonErrors, Table::Aliases];

/// What a segment holds, each by its key.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Segment {
    /// By id.
    pub keyframes: Vec<Keyframe>,
    /// By id.
    pub landmarks: Vec<Landmark>,
    /// By (a, b).
    pub cross_covariances: Vec<KeyframeCrossCovariance>,
    /// By keyframe.
    pub common_errors: Vec<CommonError>,
    /// By keyframe.
    pub aliases: Vec<KeyframeAliases>,
}

/// The name of a segment.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmentName {
    /// Its SHA-256, 64 hexadecimal digits.
    pub sha256: String,
    /// Its length.
    pub bytes: u64,
}

/// Why bytes are no segment.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SegmentError {
    /// The first bytes are others.
    #[error("it does not begin as a segment of this version does")]
    NotASegment,
    /// It ends too early.
    #[error("it ends after {bytes} bytes, in the middle of a record")]
    CutOff {
        /// Its length.
        bytes: usize,
    },
    /// It goes on after its last record.
    #[error("{bytes} bytes follow its last record")]
    TooLong {
        /// How many.
        bytes: usize,
    },
    /// A record does not come after the one before it.
    #[error("{record} is out of order")]
    Order {
        /// Which one.
        record: String,
    },
    /// It holds what this segment of a map must not hold.
    #[error("it has {table} where none belong")]
    Misplaced {
        /// What.
        table: &'static str,
    },
    /// A record is damaged.
    #[error("{record}: {problem}")]
    Record {
        /// Which one.
        record: String,
        /// What is wrong with it.
        problem: RecordError,
    },
}

impl SegmentName {
    /// That of some bytes.
    pub fn of(bytes: &[u8]) -> SegmentName {
        SegmentName { sha256: sha256(bytes), bytes: bytes.len() as u64 }
    }

    /// Whether it can be one. A hostile name could lead out of the folder of segments.
    pub fn is_valid(&self) -> bool {
        let is_digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
        self.sha256.len() == 64 && self.sha256.bytes().all(is_digit)
    }
}

/// SHA-256 in hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    types::hexadecimal::encode(&Sha256::digest(bytes))
}

/// Makes a segment, element by element, those of one kind in the order of their keys.
///
/// # Example
/// ```
/// use map::file::{Segment, SegmentWriter};
/// use map::{Alias, KeyframeAliases};
///
/// let aliases = KeyframeAliases { keyframe: 3, places: vec![Alias { keyframe: 7, log_odds: 2.5 }] };
/// let mut writer = SegmentWriter::default();
/// writer.add(&aliases)?;
/// assert_eq!(Segment::decode(&writer.finish())?.aliases, [aliases]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Default)]
pub struct SegmentWriter {
    /// By table, in the order of [`TABLES`].
    lists: [List; TABLES.len()],
}

#[derive(Default)]
struct List {
    count: u64,
    bytes: Vec<u8>,
}

impl SegmentWriter {
    /// Adds an element.
    ///
    /// # Returns
    /// The payload of its record.
    ///
    /// # Errors
    /// [`RecordError::Unencodable`], of a record beyond 4 GiB.
    pub fn add<E: Element>(&mut self, element: &E) -> Result<&[u8], RecordError> {
        let key = key_bytes(element.key().as_ref());
        let sealed = record::seal(E::TABLE.name(), &key, &element.to_record())?;
        let length = u32::try_from(sealed.len()).map_err(|_| RecordError::Unencodable {
            reason: format!("a record of {} bytes is too long", sealed.len()),
        })?;
        let list = &mut self.lists[E::TABLE as usize];
        list.count += 1;
        list.bytes.extend(key);
        list.bytes.extend(length.to_le_bytes());
        let start = list.bytes.len() + record::HEADER_BYTES;
        list.bytes.extend(sealed);
        Ok(&list.bytes[start..])
    }

    /// Bytes of the records so far.
    pub fn bytes(&self) -> usize {
        self.lists.iter().map(|list| list.bytes.len()).sum()
    }

    /// The segment.
    pub fn finish(self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(MAGIC.len() + 8 * TABLES.len() + self.bytes());
        bytes.extend(MAGIC);
        for list in self.lists {
            bytes.extend(list.count.to_le_bytes());
            bytes.extend(list.bytes);
        }
        bytes
    }
}

impl Segment {
    /// Reads a segment. Counts and lengths are believed only as far as there are bytes.
    ///
    /// # Errors
    /// [`SegmentError`].
    pub fn decode(bytes: &[u8]) -> Result<Segment, SegmentError> {
        let mut reader = Reader::new(bytes)?;
        let segment = Segment {
            keyframes: reader.elements()?,
            landmarks: reader.elements()?,
            cross_covariances: reader.elements()?,
            common_errors: reader.elements()?,
            aliases: reader.elements()?,
        };
        reader.end()?;
        Ok(segment)
    }

    /// The same without landmarks.
    pub(crate) fn decode_frame(bytes: &[u8]) -> Result<Segment, SegmentError> {
        let segment = Segment::decode(bytes)?;
        if segment.landmarks.is_empty() { Ok(segment) } else { Err(misplaced(Table::Landmarks)) }
    }
}

/// Visits the payloads of the landmarks of a segment that holds nothing else, by id.
///
/// # Arguments
/// * `after`: the last landmark of the segment before it; those of this one come after it.
///
/// # Returns
/// The last landmark.
///
/// # Errors
/// [`SegmentError`]; the first record that cannot be used ends it.
pub(crate) fn visit_landmarks(
    bytes: &[u8],
    after: Option<LandmarkId>,
    mut visit: impl FnMut(LandmarkId, &[u8]) -> Result<(), RecordError>,
) -> Result<Option<LandmarkId>, SegmentError> {
    let mut reader = Reader::new(bytes)?;
    let mut last = after.map(|id| [id]);
    for table in TABLES {
        if table == Table::Landmarks {
            last = reader.records(table, last, |[id]: [u64; 1], payload| visit(id, payload))?;
        } else if reader.array().map(u64::from_le_bytes)? > 0 {
            return Err(misplaced(table));
        }
    }
    reader.end()?;
    Ok(last.map(|[id]| id))
}

fn misplaced(table: Table) -> SegmentError {
    SegmentError::Misplaced { table: table.name() }
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn new(bytes: &'a [u8]) -> Result<Self, SegmentError> {
        if bytes.starts_with(MAGIC) {
            Ok(Self { bytes, at: MAGIC.len() })
        } else {
            Err(SegmentError::NotASegment)
        }
    }

    fn elements<E: Element>(&mut self) -> Result<Vec<E>, SegmentError> {
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
    fn records<K: Copy + Default + Ord + AsRef<[u64]> + AsMut<[u64]>>(
        &mut self,
        table: Table,
        mut previous: Option<K>,
        mut visit: impl FnMut(K, &[u8]) -> Result<(), RecordError>,
    ) -> Result<Option<K>, SegmentError> {
        for _ in 0..u64::from_le_bytes(self.array()?) {
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

    fn end(self) -> Result<(), SegmentError> {
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
