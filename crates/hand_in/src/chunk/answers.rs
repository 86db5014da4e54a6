//! What the map answered.

use protocol::MapIdentity;
use types::{KeyframeId, LandmarkId};

use super::{ChunkFormat, Times};
use crate::bytes::{Reader, Writer};
use crate::error::ChunkError;

/// The answer of a map about a keyframe candidate: which of its landmarks were matched, and with which features.
///
/// There is no pose in it. Where the candidate was follows from these matches and the landmarks of that version of the map, and
/// from that which landmarks were in view and not matched.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// Its camera.
    pub camera: usize,
    /// The map.
    pub map_identity: MapIdentity,
    /// Its version.
    pub map_version: u64,
    /// Landmarks that agreed with one pose.
    pub inliers: u64,
    /// Landmarks that the update of the robot's state used.
    pub used: u64,
    /// Whether the robot's state took the answer.
    pub accepted: bool,
    /// The matches; none where the map did not recognize the image.
    pub matches: Vec<AnsweredMatch>,
}

/// A landmark that was matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AnsweredMatch {
    /// Number of the feature among those of the candidate.
    pub feature: u32,
    /// The landmark.
    pub landmark: LandmarkId,
    /// The keyframe of the answer that it came with.
    pub keyframe: KeyframeId,
}

pub(super) fn write(out: &mut Writer, answers: &[Answer], format: ChunkFormat) {
    let written = || answers.iter().filter(|answer| format.has_camera(answer.camera));
    out.unsigned(written().count() as u64);
    let mut times = Times(None);
    for answer in written() {
        times.write(out, answer.stamp_ns);
        format.write_camera(out, answer.camera);
        out.bytes(&answer.map_identity.to_bytes());
        out.unsigned(answer.map_version);
        out.unsigned(answer.inliers);
        out.unsigned(answer.used);
        out.unsigned(u64::from(answer.accepted));
        out.unsigned(answer.matches.len() as u64);
        let (mut landmark, mut keyframe) = (0_u64, 0_u64);
        for found in &answer.matches {
            out.unsigned(u64::from(found.feature));
            out.signed(found.landmark.wrapping_sub(landmark) as i64);
            out.signed(found.keyframe.wrapping_sub(keyframe) as i64);
            (landmark, keyframe) = (found.landmark, found.keyframe);
        }
    }
}

pub(super) fn read(input: &mut Reader<'_>, format: ChunkFormat) -> Result<Vec<Answer>, ChunkError> {
    let (mut answers, count) = input.list()?;
    let (mut times, mut last) = (Times(None), None);
    for _ in 0..count {
        let stamp_ns = times.read_same_or_later(input)?;
        let camera = format.read_camera(input)?;
        if last.replace((stamp_ns, camera)) >= Some((stamp_ns, camera)) {
            return Err(ChunkError::Order);
        }
        let map_identity = MapIdentity::from_bytes(input.array()?);
        let (map_version, inliers, used) = (input.unsigned()?, input.unsigned()?, input.unsigned()?);
        let accepted = match input.unsigned()? {
            0 => false,
            1 => true,
            _ => return Err(ChunkError::Range("whether an answer was accepted")),
        };
        let (mut landmark, mut keyframe) = (0_u64, 0_u64);
        let (mut matches, count) = input.list()?;
        for _ in 0..count {
            let feature =
                u32::try_from(input.unsigned()?).map_err(|_| ChunkError::Range("the number of a feature"))?;
            landmark = landmark.wrapping_add(input.signed()? as u64);
            keyframe = keyframe.wrapping_add(input.signed()? as u64);
            matches.push(AnsweredMatch { feature, landmark, keyframe });
        }
        answers.push(Answer {
            stamp_ns,
            camera,
            map_identity,
            map_version,
            inliers,
            used,
            accepted,
            matches,
        });
    }
    Ok(answers)
}
