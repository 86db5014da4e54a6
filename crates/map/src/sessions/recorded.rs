//! What of a recording identifies it.

use std::collections::BTreeSet;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use sha2::{Digest as _, Sha256};
use types::hexadecimal;

use super::session::SessionId;

/// One reading of so many is sampled, chosen by its digest: about six a second at 200 Hz.
const READINGS_A_SAMPLE: u64 = 32;
/// Most samples of a recording; of a long one those with the smallest digests, so that the samples of its pieces are among them.
pub const MAX_SAMPLES: usize = 1024;

/// Digests of some readings of an IMU, ascending.
///
/// Which readings are sampled depends on nothing but the readings, so that two recordings that share some seconds share samples,
/// whatever was cut off before and behind. Of two recordings with different numbers of samples, readings that both have are samples of both
/// where their digests are below the largest of either: fewer samples only make short overlaps less likely to be found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReadingSamples(Vec<u64>);

impl ReadingSamples {
    /// The samples of these digests, in any order: of too many those with the smallest.
    pub fn of_digests(mut digests: Vec<u64>) -> Self {
        digests.sort_unstable();
        digests.dedup();
        digests.truncate(MAX_SAMPLES);
        Self(digests)
    }

    /// Keeps those with the smallest digests.
    ///
    /// # Arguments
    /// * `most`: how many, at most.
    pub(super) fn thin_out(&mut self, most: usize) {
        self.0.truncate(most);
    }

    /// The digests.
    pub fn digests(&self) -> &[u64] {
        &self.0
    }

    /// How many samples both have.
    pub fn shared_with(&self, other: &ReadingSamples) -> usize {
        self.0.iter().filter(|digest| other.0.binary_search(digest).is_ok()).count()
    }

    /// Whether they can be samples of a recording: ascending, and not too many.
    pub(super) fn is_valid(&self) -> bool {
        self.0.len() <= MAX_SAMPLES && self.0.is_sorted_by(|one, next| one < next)
    }
}

impl Serialize for ReadingSamples {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let bytes: Vec<u8> = self.0.iter().flat_map(|digest| digest.to_be_bytes()).collect();
        serializer.serialize_str(&hexadecimal::encode(&bytes))
    }
}

impl<'de> Deserialize<'de> for ReadingSamples {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let bytes = hexadecimal::decode(&String::deserialize(deserializer)?).unwrap_or_else(|| vec![0]);
        let (digests, rest) = bytes.as_chunks();
        if !rest.is_empty() {
            return Err(de::Error::custom("samples of readings are 16 hexadecimal digits each"));
        }
        Ok(Self(digests.iter().copied().map(u64::from_be_bytes).collect()))
    }
}

/// What was recorded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recorded {
    /// Digest of all of it.
    pub id: SessionId,
    /// First image (ns).
    pub begin_ns: i64,
    /// Last image (ns).
    pub end_ns: i64,
    /// Images.
    pub images: u64,
    /// Readings of the IMU.
    pub readings: u64,
    /// Some of these.
    pub samples: ReadingSamples,
}

/// Computes the identity of a recording from the readings of its IMU and the times of its images.
///
/// Files, names and the order of topics do not matter. Readings are rounded to single precision, so that a decimal text with
/// fewer digits gives the same.
///
/// # Example
/// ```
/// use map::sessions::RecordedDigest;
///
/// let recorded = |shift: f64| {
///     let mut digest = RecordedDigest::default();
///     (0..1000).for_each(|at| digest.add_reading(at * 5_000_000, [shift, 0.0, 0.0, 0.0, 0.0, 9.81]));
///     (0..50).for_each(|at| digest.add_image(at * 100_000_000));
///     digest.finish()
/// };
/// assert_eq!(recorded(0.1), recorded(0.1));
/// assert_ne!(recorded(0.1).id, recorded(0.2).id);
/// assert_eq!(recorded(0.1).samples.shared_with(&recorded(0.2).samples), 0);
/// ```
#[derive(Clone, Debug, Default)]
pub struct RecordedDigest {
    readings: Sha256,
    images: Sha256,
    counts: [u64; 2],
    times: Option<[i64; 2]>,
    samples: BTreeSet<u64>,
}

impl RecordedDigest {
    /// Adds the next reading of the IMU.
    ///
    /// # Arguments
    /// * `values`: of the gyroscope (rad/s) and the accelerometer (m/s^2).
    pub fn add_reading(&mut self, stamp_ns: i64, values: [f64; 6]) {
        let mut bytes = stamp_ns.to_le_bytes().to_vec();
        // The sum makes one zero of two.
        bytes.extend(values.iter().flat_map(|value| (*value as f32 + 0.0).to_le_bytes()));
        self.readings.update(&bytes);
        self.counts[0] += 1;
        let digest = first_bytes(&Sha256::digest(&bytes));
        if digest <= u64::MAX / READINGS_A_SAMPLE {
            self.samples.insert(digest);
            if self.samples.len() > MAX_SAMPLES {
                self.samples.pop_last();
            }
        }
    }

    /// Adds the next image, or what was extracted of it.
    pub fn add_image(&mut self, stamp_ns: i64) {
        self.images.update(stamp_ns.to_le_bytes());
        self.counts[1] += 1;
        let [begin_ns, end_ns] = self.times.unwrap_or([stamp_ns; 2]);
        self.times = Some([begin_ns.min(stamp_ns), end_ns.max(stamp_ns)]);
    }

    /// The identity of what was added.
    pub fn finish(self) -> Recorded {
        let mut all = Sha256::new();
        for (part, count) in [self.readings, self.images].into_iter().zip(self.counts) {
            all.update(count.to_le_bytes());
            all.update(part.finalize());
        }
        let all = all.finalize();
        let [begin_ns, end_ns] = self.times.unwrap_or_default();
        Recorded {
            id: SessionId::from_bytes(std::array::from_fn(|at| all[at])),
            begin_ns,
            end_ns,
            images: self.counts[1],
            readings: self.counts[0],
            samples: ReadingSamples(self.samples.into_iter().collect()),
        }
    }
}

fn first_bytes(digest: &[u8]) -> u64 {
    u64::from_be_bytes(std::array::from_fn(|at| digest[at]))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Readings at 200 Hz, and an image in ten.
    fn recorded(seed: u64, readings: std::ops::Range<i64>) -> Recorded {
        let mut digest = RecordedDigest::default();
        for at in readings {
            let stamp_ns = at * 5_000_000;
            let value = |axis: u64| ((seed + axis) as f64 + at as f64 * 0.37).sin();
            digest.add_reading(stamp_ns, [0, 1, 2, 3, 4, 5].map(value));
            if at % 10 == 0 {
                digest.add_image(stamp_ns);
            }
        }
        digest.finish()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn a_piece_of_a_recording_shares_samples_with_it_and_another_recording_none(
            seed in 0..1000_u64, begin in 0..3000_i64, length in 600..1500_i64
        ) {
            let whole = recorded(seed, 0..4500);
            let piece = recorded(seed, begin..begin + length);
            prop_assert_ne!(whole.id, piece.id);
            // Of 19 that are expected or more.
            prop_assert!(piece.samples.shared_with(&whole.samples) >= 3);
            prop_assert_eq!(recorded(seed + 7, 0..4500).samples.shared_with(&piece.samples), 0);
            let text = serde_json::to_string(&whole.samples).unwrap();
            prop_assert_eq!(&serde_json::from_str::<ReadingSamples>(&text).unwrap(), &whole.samples);
            prop_assert!(whole.samples.is_valid());
        }
    }

    #[test]
    fn a_long_recording_keeps_so_many_samples_that_a_minute_of_it_is_found() {
        let hour = recorded(1, 0..720_000 / 6);
        assert_eq!(hour.samples.digests().len(), MAX_SAMPLES);
        assert!(recorded(1, 60_000..72_000).samples.shared_with(&hour.samples) > 50);
    }

    #[test]
    fn fewer_digits_give_the_same_identity() {
        let of = |value: f64| {
            let mut digest = RecordedDigest::default();
            digest.add_reading(5, [value; 6]);
            digest.finish().id
        };
        assert_eq!(of(0.123_456_789_012_345_6), of(0.123_456_789_012));
        assert_eq!(of(0.0), of(-0.0));
        assert_ne!(of(0.123_456), of(0.123_457));
    }
}
