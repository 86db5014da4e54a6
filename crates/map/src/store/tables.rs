//! The tables of a map's database, their keys, and the writes of one commit.
//!
//! | table | key (big endian) | value |
//! |---|---|---|
//! | `info` | `schema` | `DRFTMAP` and the schema number (u16 LE) |
//! | `info` | `info` | what holds for the map as a whole |
//! | `keyframes` | id | a keyframe |
//! | `landmarks` | id | a landmark with its observations |
//! | `cross_covariances` | a, b (`a < b`) | a 6x6 block |
//! | `references` | `l` keyframe landmark, `c` keyframe keyframe | empty: who observes, who is correlated |
//!
//! All values but `schema` and the references are records with a checksum, see [`super::record`].

use protocol::KeyframeId;

pub(super) const SCHEMA_KEY: &[u8] = b"schema";
pub(super) const SCHEMA_MAGIC: &[u8] = b"DRFTMAP";
pub(super) const INFO_KEY: &[u8] = b"info";
/// First byte of a reference from a keyframe to a landmark that it observes.
pub(super) const OBSERVES: u8 = b'l';
/// First byte of a reference from a keyframe to one with which it has a cross-covariance.
pub(super) const CORRELATED: u8 = b'c';

/// A table of the database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Table {
    Info,
    Keyframes,
    Landmarks,
    CrossCovariances,
    References,
}

impl Table {
    /// All of them, each at the position of its number.
    pub(super) const ALL: [Table; 5] =
        [Table::Info, Table::Keyframes, Table::Landmarks, Table::CrossCovariances, Table::References];

    /// Those that hold what a map is made of, everything but its info.
    pub(super) const CONTENTS: [Table; 4] =
        [Table::Keyframes, Table::Landmarks, Table::CrossCovariances, Table::References];

    /// The name in the database and in checksums.
    pub(super) fn name(self) -> &'static str {
        match self {
            Table::Info => "info",
            Table::Keyframes => "keyframes",
            Table::Landmarks => "landmarks",
            Table::CrossCovariances => "cross_covariances",
            Table::References => "references",
        }
    }

    /// A record's name for people.
    pub(super) fn describe(self, key: &[u8]) -> String {
        let id = |bytes: &[u8]| match bytes.try_into() {
            Ok(bytes) => u64::from_be_bytes(bytes).to_string(),
            Err(_) => format!("{bytes:02x?}"),
        };
        match self {
            Table::Info => "the map's info".to_owned(),
            Table::Keyframes => format!("keyframe {}", id(key)),
            Table::Landmarks => format!("landmark {}", id(key)),
            Table::CrossCovariances => {
                let (a, b) = key.split_at(key.len() / 2);
                format!("the cross-covariance of keyframes {} and {}", id(a), id(b))
            }
            Table::References => format!("reference {key:02x?}"),
        }
    }
}

/// Key of a cross-covariance.
pub(super) fn pair_key(a: KeyframeId, b: KeyframeId) -> [u8; 16] {
    let mut key = [0; 16];
    key[..8].copy_from_slice(&a.to_be_bytes());
    key[8..].copy_from_slice(&b.to_be_bytes());
    key
}

/// Key of a reference.
pub(super) fn reference_key(kind: u8, keyframe: KeyframeId, other: u64) -> [u8; 17] {
    let mut key = [kind; 17];
    key[1..].copy_from_slice(&pair_key(keyframe, other));
    key
}

/// What a commit writes, a batch a table; within a batch the later write of a key wins.
#[derive(Default)]
pub(super) struct Writes {
    /// In the order of [`Table::ALL`].
    pub(super) batches: [sled::Batch; 5],
}

impl Writes {
    pub(super) fn insert(&mut self, table: Table, key: impl AsRef<[u8]>, value: Vec<u8>) {
        self.batches[table as usize].insert(key.as_ref(), value);
    }

    pub(super) fn remove(&mut self, table: Table, key: impl AsRef<[u8]>) {
        self.batches[table as usize].remove(key.as_ref());
    }
}
