//! What each session has in a map.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{SystemTime, UNIX_EPOCH};

use protocol::KeyframeId;
use sha2::{Digest as _, Sha256};

use super::budget::thin_out_samples;
use super::recorded::{ReadingSamples, Recorded};
use super::session::{Session, SessionId};
use crate::contents::MapContents;
use crate::model::MapMetadata;

impl MapMetadata {
    /// The session of a keyframe: its index in the ledger.
    pub fn session_of(&self, keyframe: KeyframeId) -> Option<usize> {
        let at = self.sessions.partition_point(|session| *session.ids().end() < keyframe);
        self.sessions.get(at).filter(|session| session.ids().contains(&keyframe)).map(|_| at)
    }

    /// The largest id that the keyframes of a session were given: new ones come after it, whether it still exists or not.
    pub fn last_session_keyframe(&self) -> Option<KeyframeId> {
        self.sessions.last().map(|session| *session.ids().end())
    }
}

impl MapContents {
    /// Counts what the map has of each session of its ledger: [`Session::keyframes`], [`Session::observations`] and
    /// [`Session::seen_again`].
    pub fn count_sessions(&mut self) {
        self.info.sessions = self.counted_sessions();
    }

    /// The ledger with the counts of this map.
    pub(super) fn counted_sessions(&self) -> Vec<Session> {
        let mut sessions = self.info.sessions.clone();
        if sessions.is_empty() {
            return sessions;
        }
        for session in &mut sessions {
            (session.keyframes, session.observations, session.seen_again) = (0, 0, 0);
        }
        for keyframe in &self.keyframes {
            if let Some(at) = self.info.session_of(keyframe.id) {
                sessions[at].keyframes += 1;
            }
        }
        for landmark in &self.landmarks {
            let of_anchor = self.info.session_of(landmark.anchor);
            for observation in &landmark.observations {
                if let Some(at) = self.info.session_of(observation.keyframe) {
                    sessions[at].observations += 1;
                    sessions[at].seen_again += u64::from(of_anchor != Some(at));
                }
            }
        }
        sessions
    }

    /// The part of a ledger that says from which sessions the keyframes of this map are, with the counts of this map: for a part of
    /// a map, such as a cell.
    pub fn take_sessions_of(&mut self, ledger: &MapMetadata) {
        let present: BTreeSet<usize> =
            self.keyframes.iter().filter_map(|keyframe| ledger.session_of(keyframe.id)).collect();
        self.info.sessions = present.into_iter().map(|at| ledger.sessions[at].clone()).collect();
        self.count_sessions();
    }

    /// The ledger as it is stored now: counted, new sessions with the time, and older ones with fewer samples of their readings.
    pub fn sessions_to_store(&self) -> Vec<Session> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_secs());
        let mut sessions = self.counted_sessions();
        thin_out_samples(&mut sessions);
        for session in &mut sessions {
            session.added_unix_s = session.added_unix_s.or(Some(now));
        }
        sessions
    }

    /// Gives a map without a ledger one: a single session with all keyframes, whose id is a digest of what these saw and when.
    ///
    /// For maps of other programs. A map that has a ledger stays as it is.
    ///
    /// # Arguments
    /// * `name`: of the session.
    pub fn ensure_sessions(&mut self, name: &str) {
        self.info.sessions = self.sessions_or_one(name);
        self.count_sessions();
    }

    /// The ledger, or that which [`MapContents::ensure_sessions`] would give.
    pub fn sessions_or_one(&self, name: &str) -> Vec<Session> {
        let ids = || self.keyframes.iter().map(|keyframe| keyframe.id);
        let (true, Some((first, last))) = (self.info.sessions.is_empty(), ids().min().zip(ids().max()))
        else {
            return self.info.sessions.clone();
        };
        vec![Session { keyframe_ids: [first, last], ..Session::new(self.recorded(), name) }]
    }

    /// What is known of the recording of a map without a ledger: its keyframes, in the order of time, whatever their ids.
    fn recorded(&self) -> Recorded {
        let positions: BTreeMap<KeyframeId, usize> =
            self.keyframes.iter().map(|keyframe| keyframe.id).zip(0..).collect();
        let mut seen: Vec<(i64, Vec<[u32; 2]>)> =
            self.keyframes.iter().map(|keyframe| (keyframe.stamp_ns, Vec::new())).collect();
        for observation in self.landmarks.iter().flat_map(|landmark| &landmark.observations) {
            if let Some(at) = positions.get(&observation.keyframe) {
                seen[*at].1.push(observation.pixel.map(f32::to_bits));
            }
        }
        for (_, pixels) in &mut seen {
            pixels.sort_unstable();
        }
        seen.sort_unstable();
        let mut digest = Sha256::new();
        for (stamp_ns, pixels) in &seen {
            digest.update(stamp_ns.to_le_bytes());
            digest.update((pixels.len() as u64).to_le_bytes());
            pixels.iter().flatten().for_each(|bits| digest.update(bits.to_le_bytes()));
        }
        let all = digest.finalize();
        let known = || seen.iter().map(|(stamp_ns, _)| *stamp_ns).filter(|stamp_ns| *stamp_ns != 0);
        Recorded {
            id: SessionId::from_bytes(std::array::from_fn(|at| all[at])),
            begin_ns: known().min().unwrap_or(0),
            end_ns: known().max().unwrap_or(0),
            images: seen.len() as u64,
            readings: 0,
            samples: ReadingSamples::default(),
        }
    }
}
