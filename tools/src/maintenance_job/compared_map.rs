//! The map that a session was compared with, and how much of it is still there.

use map::{Keyframe, MapContents};
use protocol::MapIdentity;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use types::hexadecimal;

/// Keyframes that are remembered of a map, at most: the part of others is known to 0.03 with them.
const SAMPLED_KEYFRAMES: usize = 128;

/// The map that a session was compared with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ComparedMap {
    digest: MapIdentity,
    /// In its ledger.
    sessions: usize,
    keyframes: KeyframeSample,
}

impl ComparedMap {
    /// Reads all of the map.
    pub fn of(contents: &MapContents) -> ComparedMap {
        ComparedMap {
            digest: contents.digest(),
            sessions: contents.info.sessions.len(),
            keyframes: KeyframeSample::of(&contents.keyframes),
        }
    }

    /// The part of the keyframes of both maps that only one of them has, or that are elsewhere in the other.
    pub fn part_of_others(&self, other: &ComparedMap) -> f64 {
        self.keyframes.part_of_others(&other.keyframes)
    }
}

/// Hashes of some keyframes, each with its position, ascending: of all those with the smallest hashes, so that two maps remember the same ones
/// as far as they have them.
///
/// Source: Broder, "On the resemblance and containment of documents", SEQUENCES 1997.
#[derive(Clone, Debug, PartialEq, Eq)]
struct KeyframeSample(Vec<u64>);

impl KeyframeSample {
    fn of(keyframes: &[Keyframe]) -> KeyframeSample {
        let mut hashes: Vec<u64> = keyframes.iter().map(hash).collect();
        hashes.sort_unstable();
        hashes.dedup();
        hashes.truncate(SAMPLED_KEYFRAMES);
        KeyframeSample(hashes)
    }

    /// Up to this hash the sample has all keyframes.
    fn complete_to(&self) -> u64 {
        if self.0.len() < SAMPLED_KEYFRAMES { u64::MAX } else { self.0.last().copied().unwrap_or(u64::MAX) }
    }

    fn part_of_others(&self, other: &KeyframeSample) -> f64 {
        let last = self.complete_to().min(other.complete_to());
        let [own, others] = [self, other].map(|sample| sample.0.partition_point(|hash| *hash <= last));
        let both = self.0[..own].iter().filter(|hash| other.0.binary_search(hash).is_ok()).count();
        let all = own + others - both;
        (all - both) as f64 / all.max(1) as f64
    }
}

/// A hash of the id of a keyframe and its position, to single precision.
fn hash(keyframe: &Keyframe) -> u64 {
    let position = keyframe.global_from_keyframe.pose.translation;
    let of_position = position.iter().map(|coordinate| u64::from((*coordinate as f32).to_bits()));
    std::iter::once(keyframe.id).chain(of_position).fold(0, |hash, value| mixed(hash ^ value))
}

/// The finalizer of SplitMix64: each bit of the result depends on all bits of the value.
fn mixed(value: u64) -> u64 {
    let value = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

impl Serialize for KeyframeSample {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let bytes: Vec<u8> = self.0.iter().flat_map(|hash| hash.to_be_bytes()).collect();
        serializer.serialize_str(&hexadecimal::encode(&bytes))
    }
}

impl<'de> Deserialize<'de> for KeyframeSample {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let bytes = hexadecimal::decode(&String::deserialize(deserializer)?);
        let hashes = bytes.as_deref().map(<[u8]>::as_chunks).filter(|(_, rest)| rest.is_empty());
        let (hashes, _) = hashes.ok_or_else(|| de::Error::custom("hashes are 16 hexadecimal digits each"))?;
        Ok(Self(hashes.iter().copied().map(u64::from_be_bytes).collect()))
    }
}

#[cfg(test)]
mod tests {
    use testing::{Place, PlaceOptions};

    use super::*;

    fn part(before: &MapContents, after: &MapContents) -> f64 {
        ComparedMap::of(before).part_of_others(&ComparedMap::of(after))
    }

    #[test]
    fn the_part_of_keyframes_that_are_others_is_known_by_a_sample() {
        for count in [40, 600] {
            let options = PlaceOptions { keyframes: count, landmarks: 20, ..PlaceOptions::default() };
            let before = Place::new(&options).map;
            assert!(part(&before, &before).abs() < 1e-12);
            let mut after = before.clone();
            after.keyframes.truncate(count - count / 20);
            assert!((part(&before, &after) - 0.05).abs() < 0.06, "{}", part(&before, &after));
            after.keyframes.truncate(count / 2);
            assert!((part(&before, &after) - 0.5).abs() < 0.13, "{}", part(&before, &after));
            // The same ids elsewhere: the map was built anew.
            let mut moved = before.clone();
            for keyframe in &mut moved.keyframes {
                keyframe.global_from_keyframe.pose.translation.x += 0.01;
            }
            assert!((part(&before, &moved) - 1.0).abs() < 1e-12);
        }
        let empty = KeyframeSample::of(&[]);
        assert!(empty.part_of_others(&empty).abs() < 1e-12);
    }

    #[test]
    fn a_sample_is_read_as_it_was_written() {
        let options = PlaceOptions { keyframes: 300, landmarks: 20, ..PlaceOptions::default() };
        let compared = ComparedMap::of(&Place::new(&options).map);
        let text = serde_json::to_string(&compared).unwrap();
        assert_eq!(serde_json::from_str::<ComparedMap>(&text).unwrap(), compared);
        assert!(
            serde_json::from_str::<ComparedMap>(&text.replace("\"keyframes\":\"", "\"keyframes\":\"0"))
                .is_err()
        );
    }
}
