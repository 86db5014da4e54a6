//! Queries with the images of a recording.

use protocol::MatchRequest;
use sensors::Sequence;

/// The match request of one image of camera 0 of a recording, without a prior; the image must have features.
pub fn request(sequence: &Sequence, frame: usize) -> MatchRequest {
    let frame = &sequence.frames[frame];
    MatchRequest {
        robot: "asker".to_owned(),
        stamp_ns: frame.stamp_ns,
        camera: sequence.cameras[0].camera.clone(),
        features: frame.features[&0].clone(),
        prior: None,
        gravity_in_camera: None,
        held: Vec::new(),
        map_version_held: None,
        max_keyframes: 4,
    }
}

/// All images of a recording that have features.
pub fn images(sequence: &Sequence) -> Vec<usize> {
    (0..sequence.frames.len()).filter(|&frame| sequence.frames[frame].features.contains_key(&0)).collect()
}
