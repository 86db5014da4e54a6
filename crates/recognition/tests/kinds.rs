//! A map with several kinds of features answers a query with the kind that it has, as a map of that kind alone does.

use map::MapContents;
use protocol::{DescriptorFormat, DescriptorKind, MatchOutcome, MatchReply, MatchRequest};
use rand::SeedableRng;
use rand::rngs::StdRng;
use recognition::{LoadedMap, QueryError, RecognitionOptions};
use testing::{Place, PlaceOptions, add_second_kind, second_descriptor};

const FIRST: &str = "sift-1";
const SECOND: &str = "edgepoint2-1";

/// A place with a second kind in it, and a map of that kind alone.
fn place() -> (Place, MapContents) {
    let mut place = Place::new(&PlaceOptions { keyframes: 30, landmarks: 3000, ..PlaceOptions::default() });
    FIRST.clone_into(&mut place.map.info.extractor);
    add_second_kind(&mut place.map, SECOND);
    place.map.validate().unwrap();
    let mut alone = place.map.clone();
    let added = alone.added_features.remove(0);
    alone.landmarks = added.landmarks;
    alone.info = alone.info.with_kind(&added.kind);
    alone.info.identity = place.map.info.identity;
    alone.aliases.clear();
    (place, alone)
}

fn of_second(request: &MatchRequest) -> MatchRequest {
    let mut request = request.clone();
    let width = usize::from(request.features.descriptors.width);
    request.features.descriptors.bytes.chunks_mut(width).for_each(second_descriptor);
    SECOND.clone_into(&mut request.features.extractor);
    request
}

fn answered(map: &LoadedMap, request: &MatchRequest) -> Vec<MatchReply> {
    let mut replies = map.answer(request, &RecognitionOptions::default()).unwrap();
    for reply in &mut replies {
        if let MatchReply::Done(status) = reply {
            status.elapsed_us = 0;
        }
    }
    replies
}

#[test]
fn each_query_is_answered_with_the_kind_that_it_has() {
    let (place, alone) = place();
    let map = LoadedMap::from_contents(place.map.clone()).unwrap();
    let alone = LoadedMap::from_contents(alone).unwrap();
    let mut first_alone = place.map.clone();
    first_alone.added_features.clear();
    let identity = map.identity();
    first_alone.info.identity = Some(identity);
    let first_alone = LoadedMap::from_contents(first_alone).unwrap();
    let mut rng = StdRng::seed_from_u64(5);
    let mut matched = 0;
    for pose in place.path.iter().step_by(5) {
        let mut request = place.request(pose, 4, &mut rng);
        request.features.extractor = FIRST.to_owned();
        let replies = answered(&map, &request);
        assert_eq!(replies, answered(&first_alone, &request));
        let second = of_second(&request);
        let of_added = answered(&map, &second);
        let expected = answered(&alone, &second);
        assert_eq!(of_added.len(), expected.len());
        for (reply, expected) in of_added.iter().zip(&expected) {
            match (reply, expected) {
                (MatchReply::Keyframe(one), MatchReply::Keyframe(other)) => {
                    assert_eq!((&one.keyframe, &one.matches), (&other.keyframe, &other.matches));
                    assert_eq!(one.cross_covariances, other.cross_covariances);
                }
                (MatchReply::Done(one), MatchReply::Done(other)) => {
                    assert_eq!((one.outcome, one.sigma_map_px), (other.outcome, 1.5));
                    assert_eq!((one.log_odds, one.map_version), (other.log_odds, other.map_version));
                    matched += usize::from(one.outcome == MatchOutcome::Matched);
                }
                _ => panic!("replies in another order"),
            }
        }
        // Without a name the form of the descriptors decides, the first kind before the others.
        let mut unnamed = request.clone();
        unnamed.features.extractor.clear();
        assert_eq!(answered(&map, &unnamed), replies);
    }
    assert!(matched >= 4, "{matched}");
    let kinds: Vec<String> = map.feature_kinds().into_iter().map(|kind| kind.extractor).collect();
    assert_eq!(kinds, [FIRST, SECOND]);
    let told = map.info_reply("hall").feature_kinds;
    assert_eq!(told.len(), 2);
    assert_eq!(told[1].landmarks as usize, place.map.added_features[0].landmarks.len());
}

#[test]
fn a_kind_that_the_map_has_not_is_refused_with_those_that_it_has() {
    let (place, _) = place();
    let map = LoadedMap::from_contents(place.map.clone()).unwrap();
    let mut rng = StdRng::seed_from_u64(6);
    let mut request = place.request(&place.path[9], 4, &mut rng);
    request.features.extractor = "xfeat-1".to_owned();
    let error = map.answer(&request, &RecognitionOptions::default()).unwrap_err();
    assert!(matches!(error, QueryError::ExtractorMismatch { .. }));
    let said = error.to_string();
    assert!([FIRST, SECOND, "xfeat-1"].iter().all(|name| said.contains(name)), "{said}");
    request.features.descriptors.kind = DescriptorKind::Int8;
    let error = map.answer(&request, &RecognitionOptions::default()).unwrap_err();
    let query = DescriptorFormat { kind: DescriptorKind::Int8, width: 32 };
    assert!(matches!(&error, QueryError::DescriptorMismatch { query: of, .. } if *of == query));
    let said = error.to_string();
    assert!([FIRST, SECOND].iter().all(|name| said.contains(name)), "{said}");
}

#[test]
fn a_stored_map_answers_as_the_one_in_memory_and_after_freezing() {
    let (place, _) = place();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hall.db");
    map::store::save_map(&path, &place.map, false).unwrap();
    let read = LoadedMap::read(&path).unwrap();
    let mut frozen = Vec::new();
    read.freeze(&mut frozen).unwrap();
    let thawed = LoadedMap::thaw(frozen.as_slice()).unwrap();
    let stored = LoadedMap::from_contents(map::store::load_map(&path).unwrap().contents).unwrap();
    assert_eq!(read.info_reply("hall"), stored.info_reply("hall"));
    let mut rng = StdRng::seed_from_u64(7);
    let request = of_second(&place.request(&place.path[12], 4, &mut rng));
    let expected = answered(&stored, &request);
    assert!(expected.len() > 1);
    assert_eq!(answered(&read, &request), expected);
    assert_eq!(answered(&thawed, &request), expected);
}

/// The keyframes, their covariances and the common errors are in memory once.
#[test]
fn a_second_kind_takes_the_memory_of_its_landmarks_only() {
    let (place, alone) = place();
    let bytes =
        |contents: &MapContents| LoadedMap::from_contents(contents.clone()).unwrap().bytes_in_memory();
    let mut first = place.map.clone();
    first.added_features.clear();
    let mut poses = first.clone();
    poses.landmarks.clear();
    let sum = bytes(&first) + bytes(&alone) - bytes(&poses);
    let ratio = bytes(&place.map) as f64 / sum as f64;
    assert!((0.98..1.02).contains(&ratio), "{ratio}");
}
