//! The identity of a map.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use types::hexadecimal;

/// Bytes of an identity.
const BYTES: usize = 16;

/// The identity of a map: the same for all its versions, different for different maps. In JSON and in texts it is 32
/// hexadecimal digits.
///
/// ```
/// use protocol::MapIdentity;
/// let identity: MapIdentity = "00112233445566778899aabbccddeeff".parse()?;
/// assert_eq!(identity.to_bytes()[1], 0x11);
/// assert_eq!(identity.to_string(), "00112233445566778899aabbccddeeff");
/// assert!("00112233".parse::<MapIdentity>().is_err());
/// # Ok::<(), protocol::identity::IdentityError>(())
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MapIdentity([u8; BYTES]);

/// A text is no identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the identity of a map is {} hexadecimal digits", 2 * BYTES)]
pub struct IdentityError;

impl MapIdentity {
    /// The identity of these bytes.
    pub const fn from_bytes(bytes: [u8; BYTES]) -> Self {
        Self(bytes)
    }

    /// Its bytes.
    pub const fn to_bytes(self) -> [u8; BYTES] {
        self.0
    }
}

impl fmt::Display for MapIdentity {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&hexadecimal::encode(&self.0))
    }
}

impl fmt::Debug for MapIdentity {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, formatter)
    }
}

impl FromStr for MapIdentity {
    type Err = IdentityError;

    fn from_str(text: &str) -> Result<Self, IdentityError> {
        let bytes = hexadecimal::decode(text).and_then(|bytes| bytes.try_into().ok());
        bytes.map(Self).ok_or(IdentityError)
    }
}

impl Serialize for MapIdentity {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            serializer.collect_str(self)
        } else {
            self.0.serialize(serializer)
        }
    }
}

impl<'de> Deserialize<'de> for MapIdentity {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            String::deserialize(deserializer)?.parse().map_err(de::Error::custom)
        } else {
            <[u8; BYTES]>::deserialize(deserializer).map(Self)
        }
    }
}
