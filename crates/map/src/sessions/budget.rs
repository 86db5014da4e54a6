//! How many samples of readings a ledger keeps: fewer of older sessions, so that a ledger of many sessions stays short.
//!
//! ```text
//! samples(r) = max(LEAST, MAX_SAMPLES * RECENT / (RECENT + r)),   r sessions were added since
//! ```
//! Their sum grows like the logarithm of the number of sessions until all old ones have the least. A recording that shares the part `x` of a
//! session shares `x * samples(r)` of its samples on average, and is not found with a probability of `exp(-x * samples(r))`. All of a
//! session is found by its id, however few samples it has.

use super::recorded::MAX_SAMPLES;
use super::session::Session;

/// Samples of the oldest sessions: a recording that has all of one, and more, is not found with a probability of 0.0003.
const LEAST: usize = 8;
/// Sessions since then after which one has half of its samples.
const RECENT: usize = 128;

/// Takes samples out of a ledger: those with the largest digests of each session that has too many for its age.
///
/// # Arguments
/// * `sessions`: in the order in which they were added.
pub(super) fn thin_out_samples(sessions: &mut [Session]) {
    for (since, session) in sessions.iter_mut().rev().enumerate() {
        session.samples.thin_out(most_samples(since));
    }
}

/// # Arguments
/// * `since`: how many sessions were added since.
fn most_samples(since: usize) -> usize {
    (MAX_SAMPLES * RECENT / (RECENT + since)).max(LEAST)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sessions::{ReadingSamples, Recorded, SessionId};

    /// A session whose samples are the smallest of readings that `digests` are of.
    fn session(number: u64, digests: impl Iterator<Item = u64>) -> Session {
        let recorded = Recorded {
            id: SessionId::from_bytes(u128::from(number).to_le_bytes()),
            begin_ns: 0,
            end_ns: 1,
            images: 1,
            readings: 1,
            samples: ReadingSamples::of_digests(digests.collect()),
        };
        Session::new(recorded, "drive")
    }

    /// Digests of 120,000 readings, of which one in 32 is sampled.
    fn digests(number: u64) -> impl Iterator<Item = u64> {
        (0..3750_u64).map(move |at| (number * 4000 + at).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 5)
    }

    #[test]
    fn old_sessions_have_fewer_samples_and_recordings_that_have_half_of_them_are_found() {
        let mut sessions: Vec<Session> = (0..9000).map(|number| session(number, digests(number))).collect();
        thin_out_samples(&mut sessions);
        let counts: Vec<usize> = sessions.iter().map(|session| session.samples.digests().len()).collect();
        assert_eq!((counts[8999], counts[8999 - 128], counts[0]), (1024, 512, 14));
        assert!(counts.is_sorted());
        let total: usize = counts.iter().sum();
        assert!(total < 600_000, "{total}");
        let again = sessions.clone();
        thin_out_samples(&mut sessions);
        assert_eq!(sessions, again);
        let found = |number: u64, part: usize| {
            let half = session(1 << 40, digests(number).skip(900).take(part));
            half.overlap(&sessions[number as usize]).is_some()
        };
        assert!((8000..9000).all(|number| found(number, 1875)));
        let missed = (0..1000).filter(|&number| !found(number, 1875)).count();
        // Of 1000, exp(-7.5) of which is 0.6.
        assert!(missed <= 4, "{missed}");
    }

    #[test]
    fn eighty_thousand_sessions_fit_into_a_manifest() {
        const SESSIONS: usize = 80_000;
        let mut one = session(1, digests(1)).by_robot(Some("forklift-07"));
        one.name = "forklift-07-2026-11-30T22-15-00".to_owned();
        (one.begin_ns, one.end_ns) = (1_780_000_000_000_000_000, 1_780_000_600_000_000_000);
        (one.images, one.readings, one.sigma_px) = (12_000, 120_000, Some(1.123_456_789_012_345));
        (one.keyframe_ids, one.added_unix_s) = ([1_234_567, 1_234_678], Some(1_780_000_000));
        one.samples.thin_out(0);
        let text = serde_json::to_string_pretty(&one).unwrap();
        // In the manifest, its lines are indented and it has a comma.
        let bytes = text.len() + 1 + 7 * text.lines().count();
        let samples: usize = (0..SESSIONS).map(most_samples).sum();
        let all = bytes * SESSIONS + 16 * samples;
        assert!(all < 64 << 20, "{bytes} bytes a session, {samples} samples");
    }
}
