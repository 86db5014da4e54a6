//! A map with several kinds of features.

use super::*;
use testing::{add_second_kind, second_descriptor};

#[tokio::test(flavor = "multi_thread")]
async fn robots_with_either_kind_of_features_share_a_map() {
    let mut place = small_place();
    place.map.info.extractor = "sift-1".to_owned();
    add_second_kind(&mut place.map, "edgepoint2-1");
    let (serving, endpoint) = listening().await;
    let options = ServerOptions::default();
    let server = MapServer::start(serving.clone(), vec![served("hall", &place)], options).await.unwrap();
    let client = peer(&[], &[&endpoint]).await;
    let scene = Scene { place, server, client, serving, endpoint };
    scene.wait_for_info().await;
    let mut of_first = scene.request(5, 2);
    of_first.features.extractor = "sift-1".to_owned();
    let mut of_second = of_first.clone();
    of_second.features.descriptors.bytes.chunks_mut(32).for_each(second_descriptor);
    of_second.features.extractor = "edgepoint2-1".to_owned();
    let mut landmarks = Vec::new();
    for request in [&of_first, &of_second] {
        let replies: Vec<MatchReply> = ask_bincode(&scene.client, "map/hall/match", request).await;
        let [MatchReply::Keyframe(best), .., MatchReply::Done(status)] = replies.as_slice() else {
            panic!("{replies:?}")
        };
        assert_eq!(status.outcome, MatchOutcome::Matched);
        landmarks.push(best.matches.iter().map(|found| found.landmark).collect::<Vec<_>>());
    }
    let last = scene.place.map.landmarks.last().unwrap().id;
    assert!(landmarks[0].iter().all(|&id| id <= last) && landmarks[1].iter().all(|&id| id > last));

    let mut of_third = of_first.clone();
    of_third.features.extractor = "xfeat-1".to_owned();
    let payload = protocol::encode(Format::Bincode, &of_third).unwrap();
    let answers = ask(&scene.client, "map/hall/match", Some(payload), None).await;
    let error = only_error(&answers, Format::Bincode);
    assert_eq!(error.code, ErrorCode::DescriptorMismatch);
    assert!(["xfeat-1", "sift-1", "edgepoint2-1"].iter().all(|name| error.message.contains(name)), "{error}");

    let answers = ask(&scene.client, "map/hall/info", None, None).await;
    let info: MapInfoReply = decoded(answers[0].clone(), Format::Bincode);
    let names: Vec<&str> = info.feature_kinds.iter().map(|kind| kind.extractor.as_str()).collect();
    assert_eq!((info.extractor.as_str(), names), ("sift-1", vec!["sift-1", "edgepoint2-1"]));
    scene.end().await;
}
