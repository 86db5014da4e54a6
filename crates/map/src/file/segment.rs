//! Segments: many records in one piece of bytes, which never changes.
//!
//! ```text
//! "driftless segment 4\n", or with a list of existence "driftless segment 5\n"
//! for keyframes, landmarks, cross-covariances, common errors, aliases, existence:
//!     number of records u64 LE
//!     for each, ascending: key (8 bytes, of a pair 16, big-endian) | length u32 LE | record
//! ```
//! Equal contents have equal bytes, whatever program and machine wrote them. A segment of images begins with `"driftless images 1\n"`
//! and has one list, that of the images.

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::list::{List, Reader};
use super::record::{Element, RecordError, Table};
use crate::added::KeptImage;
use crate::model::{
    CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark, LandmarkExistence,
};

/// How a segment begins, and its lists in their order.
pub(crate) struct Layout {
    magic: &'static [u8],
    tables: &'static [Table],
}

/// Of a part of a map.
pub(crate) const OF_MAP: &Layout = &Layout {
    magic: b"driftless segment 4\n",
    tables: &[
        Table::Keyframes,
        Table::Landmarks,
        Table::CrossCovariances,
        Table::CommonErrors,
        Table::Aliases,
    ],
};

/// Of a part of a map with a list of existence that is not empty. What has none has the bytes that it always had.
pub(crate) const OF_MAP_WITH_EXISTENCE: &Layout = &Layout {
    magic: b"driftless segment 5\n",
    tables: &[
        Table::Keyframes,
        Table::Landmarks,
        Table::CrossCovariances,
        Table::CommonErrors,
        Table::Aliases,
        Table::Existence,
    ],
};

/// Of images of keyframes.
pub(crate) const OF_IMAGES: &Layout = &Layout { magic: b"driftless images 1\n", tables: &[Table::Images] };

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
    /// By landmark.
    pub existence: Vec<LandmarkExistence>,
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
pub struct SegmentWriter {
    layout: &'static Layout,
    /// By table, in the order of the layout.
    lists: Vec<List>,
}

impl Default for SegmentWriter {
    fn default() -> Self {
        SegmentWriter::new(OF_MAP_WITH_EXISTENCE)
    }
}

impl SegmentWriter {
    /// A segment of images of keyframes.
    pub fn of_images() -> SegmentWriter {
        SegmentWriter::new(OF_IMAGES)
    }

    /// An empty segment.
    pub(crate) fn new(layout: &'static Layout) -> SegmentWriter {
        SegmentWriter { layout, lists: layout.tables.iter().map(|_| List::default()).collect() }
    }

    /// Adds an element.
    ///
    /// # Returns
    /// The payload of its record.
    ///
    /// # Errors
    /// [`RecordError::Unencodable`], of a record beyond 4 GiB.
    pub fn add<E: Element>(&mut self, element: &E) -> Result<&[u8], RecordError> {
        let position = self.layout.tables.iter().position(|&table| table == E::TABLE);
        let Some(list) = position.and_then(|at| self.lists.get_mut(at)) else {
            let reason = format!("a segment of this kind has no {}", E::TABLE.name());
            return Err(RecordError::Unencodable { reason });
        };
        list.add(element)
    }

    /// Bytes of the records so far.
    pub fn bytes(&self) -> usize {
        self.lists.iter().map(|list| list.bytes.len()).sum()
    }

    /// The segment.
    pub fn finish(mut self) -> Vec<u8> {
        let is_without = self.lists.last().is_some_and(|existence| existence.count == 0);
        if is_without && self.layout.tables.last() == Some(&Table::Existence) {
            self.layout = OF_MAP;
            self.lists.pop();
        }
        let Layout { magic, tables } = self.layout;
        let mut bytes = Vec::with_capacity(magic.len() + 8 * tables.len() + self.bytes());
        bytes.extend(*magic);
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
        let has_existence = bytes.starts_with(OF_MAP_WITH_EXISTENCE.magic);
        let layout = if has_existence { OF_MAP_WITH_EXISTENCE } else { OF_MAP };
        let mut reader = Reader::new(bytes, layout.magic)?;
        let segment = Segment {
            keyframes: reader.elements()?,
            landmarks: reader.elements()?,
            cross_covariances: reader.elements()?,
            common_errors: reader.elements()?,
            aliases: reader.elements()?,
            existence: if has_existence { reader.elements()? } else { Vec::new() },
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

/// The images of a segment of [`SegmentWriter::of_images`], by keyframe.
///
/// # Errors
/// [`SegmentError`].
pub fn decode_images(bytes: &[u8]) -> Result<Vec<KeptImage>, SegmentError> {
    let mut reader = Reader::new(bytes, OF_IMAGES.magic)?;
    let images = reader.elements()?;
    reader.end()?;
    Ok(images)
}

/// Visits the payloads of one kind of records in a segment that holds nothing else, by id.
///
/// # Arguments
/// * `table`: the kind, whose key is one id.
/// * `after`: the last id of the segment before it; those of this one come after it.
///
/// # Returns
/// The last id.
///
/// # Errors
/// [`SegmentError`]; the first record that cannot be used ends it.
pub(crate) fn visit_records(
    bytes: &[u8],
    layout: &Layout,
    table: Table,
    after: Option<u64>,
    mut visit: impl FnMut(u64, &[u8]) -> Result<(), RecordError>,
) -> Result<Option<u64>, SegmentError> {
    let mut reader = Reader::new(bytes, layout.magic)?;
    let mut last = after.map(|id| [id]);
    for &listed in layout.tables {
        if listed == table {
            last = reader.records(table, last, |[id]: [u64; 1], payload| visit(id, payload))?;
        } else if reader.count()? > 0 {
            return Err(misplaced(listed));
        }
    }
    reader.end()?;
    Ok(last.map(|[id]| id))
}

fn misplaced(table: Table) -> SegmentError {
    SegmentError::Misplaced { table: table.name() }
}
