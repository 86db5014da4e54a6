//! What can be wrong with an object of a store.

use crate::partition::{CellId, PartitionError};
use crate::release::{EXTENDED_RELEASE_SCHEMA, OLDEST_RELEASE_SCHEMA};
use crate::stage::Stage;
use protocol::MapIdentity;

/// Why an object of a store is not what was published.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Damage {
    /// The file of a release is no JSON of one.
    #[error("{0}")]
    Json(#[from] serde_json::Error),
    /// A release of another layout.
    #[error(
        "it has schema {found}, this program reads {OLDEST_RELEASE_SCHEMA} to {EXTENDED_RELEASE_SCHEMA}: publish the map to another place"
    )]
    Schema {
        /// Its schema, 0 for none.
        found: u64,
    },
    /// Fields of one layout under the number of another.
    #[error("it has not the fields of schema {schema}")]
    Fields {
        /// The schema that it states.
        schema: u16,
    },
    /// A cell has not one segment for each added kind of features.
    #[error("cell {cell} has {found} segments of added features, the release has {stated} kinds of them")]
    AddedKinds {
        /// The cell.
        cell: CellId,
        /// Segments that it names.
        found: usize,
        /// Kinds of the release.
        stated: usize,
    },
    /// The file of a release has the name of another one.
    #[error("it says that it is release {0}")]
    Number(u64),
    /// The file of a candidate has the name of another one.
    #[error("it says that it is candidate {0}")]
    CandidateNumber(u64),
    /// A candidate among the live releases, or the other way round: somebody moved it.
    #[error("it says that it is {0}, and lies among the others: somebody moved it")]
    Stage(Stage),
    /// A text that is too long or would control a terminal.
    #[error("its {what} is longer than {at_most} bytes, or has control characters")]
    Note {
        /// `author` or `comment`.
        what: &'static str,
        /// The limit.
        at_most: usize,
    },
    /// A decision about another candidate.
    #[error("it is about candidate {candidate} with the digest {digest}")]
    OtherCandidate {
        /// Its number.
        candidate: u64,
        /// Digest of its map.
        digest: MapIdentity,
    },
    /// Its partition cannot be one.
    #[error(transparent)]
    Partition(#[from] PartitionError),
    /// Cells do not ascend.
    #[error("cell {0} is not in order")]
    Order(CellId),
    /// A cell that the partition does not have.
    #[error("its partition has no cell {0}")]
    NoCell(CellId),
    /// A name that no segment has; it could lead out of their folder.
    #[error("cell {cell} has the segment {name:?}")]
    SegmentName {
        /// The cell.
        cell: CellId,
        /// What stands in the place of a SHA-256.
        name: String,
    },
    /// The contents of the cells are not those of the release.
    #[error("its cells give the digest {found}, it states {stated}")]
    Digest {
        /// That of the cells.
        found: MapIdentity,
        /// That of the release.
        stated: MapIdentity,
    },
    /// A segment has other bytes than its name says.
    #[error("its {bytes} bytes have the SHA-256 {sha256}")]
    Checksum {
        /// How many.
        bytes: u64,
        /// Hexadecimal.
        sha256: String,
    },
    /// An object is longer than it can be.
    #[error("it has {found} bytes, not {at_most} or less")]
    Length {
        /// Its bytes.
        found: u64,
        /// The limit.
        at_most: u64,
    },
}
