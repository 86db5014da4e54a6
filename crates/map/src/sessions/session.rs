//! One session of a map.

use std::fmt;
use std::ops::RangeInclusive;

use protocol::KeyframeId;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use types::hexadecimal;

use super::recorded::{ReadingSamples, Recorded};

/// Most bytes of a session's name, of its robot and of the program that added it.
pub const MAX_TEXT_BYTES: usize = 256;

/// Identifies what was recorded, wherever it lies and however it is called: see [`RecordedDigest`](super::RecordedDigest). In
/// JSON and in texts it is 32 hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionId([u8; 16]);

impl SessionId {
    /// The id of these bytes.
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    /// Its bytes.
    pub const fn to_bytes(self) -> [u8; 16] {
        self.0
    }
}

impl fmt::Display for SessionId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&hexadecimal::encode(&self.0))
    }
}

impl Serialize for SessionId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for SessionId {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let bytes = hexadecimal::decode(&text).and_then(|bytes| bytes.try_into().ok());
        bytes.map(Self).ok_or_else(|| de::Error::custom("the id of a session is 32 hexadecimal digits"))
    }
}

/// A recording that a map was made of, and what the map has of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Session {
    /// Digest of what was recorded; of an imported map without a ledger, of its keyframes.
    pub id: SessionId,
    /// Name of the recording, for display.
    pub name: String,
    /// The robot that recorded it, where known.
    pub robot: Option<String>,
    /// First and ...
    pub begin_ns: i64,
    /// ... last image that was used (ns); both 0 where times are not known.
    pub end_ns: i64,
    /// How many frames of its cameras there are between them.
    pub images: u64,
    /// How many readings of its IMU there are between them.
    pub readings: u64,
    /// A sample of these readings: they tell a piece of a recording from another recording.
    pub samples: ReadingSamples,
    /// Standard deviation of its pixels (px), as given or as its own trajectory fits them; `None` where it is not known, then that of the map
    /// covers it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_px: Option<f64>,
    /// First and last of the ids that its keyframes were given.
    pub keyframe_ids: [KeyframeId; 2],
    /// Keyframes of it that the map has. A store counts them.
    pub keyframes: u64,
    /// Their observations of landmarks. A store counts them.
    pub observations: u64,
    /// Those of landmarks that are anchored in a keyframe of another session. A store counts them.
    pub seen_again: u64,
    /// The program that added it, with its version.
    pub added_by: String,
    /// When it was first stored, seconds since 1970. A store sets it where it is `None`.
    pub added_unix_s: Option<u64>,
}

impl Session {
    /// A session without keyframes yet, added by this version of the program.
    ///
    /// # Arguments
    /// * `name`: control characters are replaced, and what exceeds [`MAX_TEXT_BYTES`] is cut off.
    pub fn new(recorded: Recorded, name: &str) -> Session {
        Session {
            id: recorded.id,
            name: printable(name),
            robot: None,
            begin_ns: recorded.begin_ns,
            end_ns: recorded.end_ns,
            images: recorded.images,
            readings: recorded.readings,
            samples: recorded.samples,
            sigma_px: None,
            keyframe_ids: [0; 2],
            keyframes: 0,
            observations: 0,
            seen_again: 0,
            added_by: concat!("driftless ", env!("CARGO_PKG_VERSION")).to_owned(),
            added_unix_s: None,
        }
    }

    /// The same, recorded by a robot; its name as that of [`Session::new`].
    #[must_use]
    pub fn by_robot(self, robot: Option<&str>) -> Session {
        Session { robot: robot.map(printable), ..self }
    }

    /// The ids that its keyframes can have.
    pub fn ids(&self) -> RangeInclusive<KeyframeId> {
        let [first, last] = self.keyframe_ids;
        first..=last
    }
}

/// A text without control characters, of at most [`MAX_TEXT_BYTES`].
fn printable(text: &str) -> String {
    let mut short = String::new();
    for character in text.chars() {
        let character = if character.is_control() { ' ' } else { character };
        if short.len() + character.len_utf8() > MAX_TEXT_BYTES {
            break;
        }
        short.push(character);
    }
    short
}
