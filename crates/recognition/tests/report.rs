//! The report of a search agrees with its answer and with the inspection of the same query.

use protocol::{LocalizeRequest, MatchOutcome, MatchReply, MatchRequest, PosePrior};
use rand::SeedableRng;
use rand::rngs::StdRng;
use recognition::{KeyframeVerdict, LoadedMap, RecognitionOptions, SearchReport};
use std::collections::HashMap;
use testing::{Place, PlaceOptions};

fn scene() -> (Place, LoadedMap) {
    let place = Place::new(&PlaceOptions::default());
    let map = LoadedMap::from_contents(place.map.clone()).unwrap();
    (place, map)
}

fn request(place: &Place, x_m: f64, prior: Option<PosePrior>) -> MatchRequest {
    let request = place.request(&place.camera_at(x_m, 0.3, 0.05), 3, &mut StdRng::seed_from_u64(x_m as u64));
    MatchRequest { prior, ..request }
}

fn localize_request(request: MatchRequest) -> LocalizeRequest {
    LocalizeRequest {
        camera: request.camera,
        features: request.features,
        prior: request.prior,
        gravity_in_camera: request.gravity_in_camera,
    }
}

fn verdicts(report: &SearchReport) -> Vec<Option<KeyframeVerdict>> {
    report.candidates.iter().map(|candidate| candidate.verdict).collect()
}

#[test]
fn a_report_changes_no_answer_and_names_the_keyframes_of_it() {
    let (place, map) = scene();
    let options = RecognitionOptions::default();
    for x_m in [5.0, 12.0, 23.0, 31.0] {
        let request = request(&place, x_m, None);
        let (replies, report) = map.answer_with_report(&request, &options).unwrap();
        let plain = map.answer(&request, &options).unwrap();
        let sent = |replies: &[MatchReply]| -> Vec<_> {
            let of = |reply: &MatchReply| match reply {
                MatchReply::Keyframe(matched) => Some((matched.keyframe.id, matched.matches.len())),
                MatchReply::Done(_) => None,
            };
            replies.iter().filter_map(of).collect()
        };
        assert_eq!(sent(&replies), sent(&plain));
        let in_answer = |id| report.candidates.iter().any(|one| one.keyframe == id && one.in_answer);
        // Those without matches are covisible, and no candidates.
        let verified: Vec<_> = sent(&replies).into_iter().filter(|(_, matches)| *matches > 0).collect();
        assert!(!verified.is_empty() && verified.iter().all(|&(id, _)| in_answer(id)), "{report:?}");
        let camera = report.camera_in_global().unwrap();
        let truth = place.camera_at(x_m, 0.3, 0.05).translation;
        assert!((camera - truth).norm() < 0.3, "{camera} {truth}");
        let compared = |candidate: &&recognition::Candidate| candidate.verdict.is_some();
        for candidate in report.candidates.iter().filter(compared) {
            assert!(candidate.inliers <= candidate.matches, "{candidate:?}");
            assert!(candidate.votes as usize >= options.min_votes, "{candidate:?}");
            assert_eq!(candidate.mean_error_px.is_some(), candidate.inliers > 0, "{candidate:?}");
        }
        let descending = report.candidates.len() <= options.candidates;
        assert!(descending && !report.candidates.iter().any(|candidate| candidate.near_prior));
    }
}

/// An inspection compares each candidate by itself; a search may expect the pose of the candidates before.
#[test]
fn a_report_agrees_with_the_inspection() {
    let (place, map) = scene();
    let options = RecognitionOptions::default();
    let request = localize_request(request(&place, 12.0, None));
    let (reply, report) = map.localize_with_report(&request, &options).unwrap();
    let inspection = map.inspect(&request, &options).unwrap();
    assert_eq!(reply, inspection.reply);
    let inspected: HashMap<_, _> =
        inspection.keyframes.iter().map(|keyframe| (keyframe.id, keyframe)).collect();
    assert_eq!(report.candidates.len(), inspected.len());
    let mut compared = 0;
    for candidate in &report.candidates {
        let keyframe = inspected[&candidate.keyframe];
        assert_eq!(candidate.votes as usize, keyframe.votes);
        if let Some(verdict) = candidate.verdict {
            compared += 1;
            assert_eq!(candidate.matches as usize, keyframe.matches.len());
            let agrees = (verdict, candidate.in_answer) == (keyframe.verdict, keyframe.in_answer);
            assert!(agrees, "{candidate:?} {:?}", keyframe.verdict);
        }
    }
    assert!(compared >= 4, "{report:?}");
}

#[test]
fn a_refused_query_has_a_reason_for_each_candidate() {
    let (place, map) = scene();
    let options = RecognitionOptions::default();
    let mut shuffled = request(&place, 12.0, None);
    let pixels = shuffled.features.pixels.clone();
    let count = pixels.len();
    shuffled.features.pixels = (0..count).map(|at| pixels[(at * 37 + 11) % count]).collect();
    let (reply, report) = map.localize_with_report(&localize_request(shuffled), &options).unwrap();
    assert_eq!((reply.outcome, report.camera_in_global()), (MatchOutcome::NotVerified, None));
    let verdicts = verdicts(&report);
    assert!(verdicts.contains(&Some(KeyframeVerdict::NoPose)), "{verdicts:?}");
    assert!(
        verdicts.iter().all(|verdict| verdict.is_some_and(|verdict| verdict != KeyframeVerdict::Verified))
    );
}

/// A prior elsewhere: first the candidates near it, then those of the whole map.
#[test]
fn after_a_wrong_prior_both_lists_of_candidates_are_reported() {
    let (place, map) = scene();
    let options = RecognitionOptions::default();
    let far = geometry::PoseWithCovariance::new(
        place.camera_at(2.0 * place.path.len() as f64 - 4.0, 0.0, 0.0),
        geometry::uncertain_pose::isotropic_covariance(0.05, 0.2),
    );
    let request = request(&place, 3.0, Some(PosePrior { global_from_camera: far }));
    let (_, report) = map.answer_with_report(&request, &options).unwrap();
    assert!(report.candidates.len() <= 2 * options.candidates);
    assert!(report.candidates.iter().all(|candidate| !(candidate.near_prior && candidate.in_answer)));
    assert!(report.candidates.iter().any(|candidate| candidate.in_answer), "{report:?}");
}
