//! What tells a version of a map from others, and the number under which it is served.

use protocol::MapIdentity;
use recognition::LoadedMap;

/// A version of a map.
///
/// The number alone does not tell it from others: of a map that is copied and changed in two places there are two versions of one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapVersion {
    /// Of the map, the same for all its versions.
    pub identity: MapIdentity,
    /// Number of the version.
    pub version: u64,
    /// Digest of what is in it, where that is known.
    pub digest: Option<MapIdentity>,
}

impl MapVersion {
    /// That of a map in memory.
    pub fn of(map: &LoadedMap) -> MapVersion {
        MapVersion { identity: map.identity(), version: map.info().version, digest: map.digest() }
    }

    /// The number under which this version is served to robots that were served another one: its own, but the next one where the other
    /// has the same number and other contents, and that of the other where the contents are the same. Robots would else take what they
    /// hold of one for the other.
    ///
    /// ```
    /// use map_server::state::MapVersion;
    /// use protocol::MapIdentity;
    ///
    /// let [identity, one, two] = [1, 2, 3].map(|byte| MapIdentity::from_bytes([byte; 16]));
    /// let served = MapVersion { identity, version: 6, digest: Some(one) };
    /// let changed_elsewhere = MapVersion { digest: Some(two), ..served };
    /// assert_eq!(changed_elsewhere.number_after(&served), 7);
    /// // After a restart it is served under that number again.
    /// assert_eq!(changed_elsewhere.number_after(&MapVersion { version: 7, ..changed_elsewhere }), 7);
    /// ```
    pub fn number_after(&self, served: &MapVersion) -> u64 {
        if self.identity != served.identity {
            return self.version;
        }
        match self.digest.zip(served.digest) {
            Some((own, of_served)) if own == of_served => self.version.max(served.version),
            Some(_) if self.version == served.version => self.version.saturating_add(1),
            _ => self.version,
        }
    }
}
