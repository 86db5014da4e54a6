//! The bytes of a map: one format for the file of a map and for the objects of a release.
//!
//! A map is a manifest and segments. A segment is a sequence of records, each with a checksum, and has its SHA-256 for a name; the
//! manifest says what applies to the map as a whole, and names its segments. A stored map is cut where a segment is large enough, a
//! release by place. Nothing here reads or writes a file.
//!
//! | module | what |
//! |---|---|
//! | [`record`] | one element of a map: version, checksum, layout |
//! | [`segment`] | many of them |
//! | `list` | records of one kind, as segments have them |
//! | `manifest` | what a folder states of its map |

mod list;
pub(crate) mod manifest;
pub mod record;
pub mod segment;

pub use manifest::{EXTENDED_STORE_SCHEMA, STORE_SCHEMA};
pub use segment::{Segment, SegmentError, SegmentName, SegmentWriter, decode_images};
