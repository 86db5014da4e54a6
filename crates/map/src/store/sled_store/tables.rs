//! The tables of a map's database and their keys.
//!
//! | table | key (big endian) | value |
//! |---|---|---|
//! | `info` | `schema` | `DRFTMAP` and the schema number (u16 LE) |
//! | `info` | `info` | what applies to the map as a whole |
//! | `keyframes` | id | a keyframe |
//! | `landmarks` | id | a landmark with its observations |
//! | `cross_covariances` | a, b (`a < b`) | a 6x6 block |
//! | `common_errors` | keyframe | its part of the common error |
//! | `aliases` | keyframe | the places that it could be taken for |
//!
//! All values but `schema` are records with a checksum, see [`crate::store::record`].

use protocol::KeyframeId;

pub(super) const SCHEMA_KEY: &[u8] = b"schema";
pub(super) const SCHEMA_MAGIC: &[u8] = b"DRFTMAP";
pub(super) const INFO_KEY: &[u8] = b"info";

/// A table of the database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Table {
    Info,
    Keyframes,
    Landmarks,
    CrossCovariances,
    CommonErrors,
    Aliases,
}

impl Table {
    /// The name in the database and in checksums.
    pub(super) fn name(self) -> &'static str {
        match self {
            Table::Info => "info",
            Table::Keyframes => "keyframes",
            Table::Landmarks => "landmarks",
            Table::CrossCovariances => "cross_covariances",
            Table::CommonErrors => "common_errors",
            Table::Aliases => "aliases",
        }
    }

    /// A record's name in messages.
    pub(super) fn describe(self, key: &[u8]) -> String {
        let id = |bytes: &[u8]| match bytes.try_into() {
            Ok(bytes) => u64::from_be_bytes(bytes).to_string(),
            Err(_) => format!("{bytes:02x?}"),
        };
        match self {
            Table::Info => "the map's info".to_owned(),
            Table::Keyframes => format!("keyframe {}", id(key)),
            Table::Landmarks => format!("landmark {}", id(key)),
            Table::CommonErrors => format!("the common error of keyframe {}", id(key)),
            Table::Aliases => format!("the aliases of keyframe {}", id(key)),
            Table::CrossCovariances => {
                let (a, b) = key.split_at(key.len() / 2);
                format!("the cross-covariance of keyframes {} and {}", id(a), id(b))
            }
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
