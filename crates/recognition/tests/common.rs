//! What the tests of recognition have in common.

use geometry::{Pose, PoseWithCovariance};
use nalgebra::Matrix6;
use protocol::{
    LocalizeRequest, MatchOutcome, MatchReply, MatchRequest, MatchStatus, MatchedKeyframe, PosePrior,
    Validate,
};
use rand::RngExt;
use rand::rngs::StdRng;
use recognition::{LoadedMap, RecognitionOptions};
use testing::Place;

pub fn loaded(place: &Place) -> LoadedMap {
    LoadedMap::from_contents(place.map.clone()).unwrap()
}

pub fn ask(map: &LoadedMap, request: &MatchRequest) -> (Vec<MatchedKeyframe>, MatchStatus) {
    let mut replies = map.answer(request, &RecognitionOptions::default()).unwrap();
    for reply in &replies {
        reply.validate().unwrap();
    }
    let Some(MatchReply::Done(status)) = replies.pop() else { panic!("no final status") };
    let keyframes: Vec<_> = replies
        .into_iter()
        .map(|reply| match reply {
            MatchReply::Keyframe(keyframe) => keyframe,
            MatchReply::Done(_) => panic!("two final statuses"),
        })
        .collect();
    assert_eq!(usize::from(status.keyframes_sent), keyframes.len());
    assert_eq!(status.outcome == MatchOutcome::Matched, !keyframes.is_empty());
    (keyframes, status)
}

/// A camera pose near the path, and not on a keyframe.
pub fn random_pose(place: &Place, rng: &mut StdRng) -> Pose {
    let along = rng.random_range(1.0..2.0 * place.path.len() as f64 - 3.0);
    place.camera_at(along, rng.random_range(-1.0..1.0), rng.random_range(-0.3..0.3))
}

pub fn localize_request(request: MatchRequest) -> LocalizeRequest {
    LocalizeRequest {
        camera: request.camera,
        features: request.features,
        prior: request.prior,
        gravity_in_camera: request.gravity_in_camera,
    }
}

pub fn prior_at(pose: Pose, sigma: f64) -> PosePrior {
    PosePrior { global_from_camera: PoseWithCovariance::new(pose, Matrix6::identity() * sigma.powi(2)) }
}
