//! Session files that robots hand in.

use std::path::Path;

/// Bytes before the blocks of a session file: its name and its version.
const BEGIN: usize = 10;
/// Bytes before the payload of a block: length, kind, checksum.
const BLOCK: usize = 9;

/// A session file: the bytes as they are, and with the checksums of its blocks made right, so that mutations get past them.
///
/// # Panics
/// Reading does, or what was read breaks what is promised of it.
pub fn session_files(data: &[u8]) {
    read(data);
    read(&with_checksums(data));
}

fn read(bytes: &[u8]) {
    let Ok(session) = hand_in::Session::of_bytes(Path::new("robot.session"), bytes) else { return };
    assert!(session.whole_bytes <= bytes.len() as u64);
    assert!(session.readings.is_sorted_by(|one, next| one.stamp_ns < next.stamp_ns));
    assert!(session.frames.is_sorted_by(|one, next| one.stamp_ns < next.stamp_ns));
    let cameras = session.header.cameras.len();
    let mut tracks = session.frames.iter().flat_map(|frame| &frame.tracks);
    assert!(
        tracks.all(|track| usize::from(track.camera) < cameras && track.pixel.iter().all(|u| u.is_finite()))
    );
    for frame in &session.frames {
        assert!(frame.candidates.is_sorted_by(|one, next| one.camera < next.camera));
        assert!(frame.candidates.iter().all(|candidate| candidate.camera < cameras));
    }
    assert!(
        session.answers.iter().all(|answer| answer.camera < cameras),
        "an answer about a camera that is not there"
    );
    let _ = (session.candidates(), session.seconds());
}

fn with_checksums(data: &[u8]) -> Vec<u8> {
    let mut bytes = data.to_vec();
    let mut at = BEGIN;
    while let Some(&[l0, l1, l2, l3, kind]) = bytes.get(at..).and_then(|rest| rest.first_chunk::<5>()) {
        let length = [l0, l1, l2, l3];
        let (begin, size) = (at + BLOCK, u32::from_le_bytes(length) as usize);
        let Some(payload) = bytes.get(begin..).and_then(|rest| rest.get(..size)) else { break };
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&length);
        hasher.update(&[kind]);
        hasher.update(payload);
        bytes[at + 5..begin].copy_from_slice(&hasher.finalize().to_le_bytes());
        at = begin + size;
    }
    bytes
}
