//! Cells at several servers answer as one map.

use std::sync::Arc;
use std::time::{Duration, Instant};

use client::MapClient;
use map_server::{CellChoice, MapServer, ServedMap, ServerOptions};
use protocol::{Format, LocalizeRequest, MapChangeNotice, MatchOutcome};
use rand::SeedableRng as _;
use rand::rngs::StdRng;
use recognition::LoadedMap;
use releases::publish;

use super::servers::{CellServer, hub, session, wait_for_cells};
use super::town::{Town, requests, small_cells, soon};

#[tokio::test(flavor = "multi_thread")]
async fn cells_at_several_servers_answer_as_one_map_through_the_loss_of_a_server_and_a_release() {
    let Town { place, folder, store, release, .. } = Town::new().await;
    let cells = release.cells.len();
    assert_eq!(cells, 8);

    let (_hub, endpoint) = hub().await;
    let mut servers = Vec::new();
    for name in ["north", "south", "west"] {
        servers.push(CellServer::start(&endpoint, name, &store, folder.path(), CellChoice::Auto).await);
    }
    let robot = session(&endpoint).await;
    wait_for_cells(&robot, 2 * cells).await;
    let whole = session(&endpoint).await;
    let map = ServedMap {
        name: "whole".to_owned(),
        map: Arc::new(LoadedMap::from_contents(place.map.clone()).unwrap()),
    };
    let one = MapServer::start(whole.clone(), vec![map], ServerOptions::default()).await.unwrap();
    let [city, reference] = ["city", "whole"].map(|name| MapClient::new(robot.clone(), name).unwrap());

    let info = city.info(soon()).await.unwrap();
    // Until the robot's session knows of the new server, the others answer that they have no such map.
    let known = async {
        loop {
            match reference.info(soon()).await {
                Ok(info) => break info,
                Err(_) => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        }
    };
    let expected = tokio::time::timeout(Duration::from_secs(10), known).await.unwrap();
    assert_eq!((info.keyframes, info.landmarks), (expected.keyframes, expected.landmarks));
    assert_eq!(
        (info.observations, info.cross_covariances),
        (expected.observations, expected.cross_covariances)
    );
    assert_eq!((info.extent, info.identity), (expected.extent, release.identity()));

    // The same images are recognized, at the same places, with the same correlations.
    let (mut matched, mut landmarks) = (0, [0, 0]);
    for request in requests(&place) {
        let answer = city.match_image(&request, soon()).await.unwrap();
        let expected = reference.match_image(&request, soon()).await.unwrap();
        assert_eq!(answer.status.outcome, expected.status.outcome);
        if answer.status.outcome != MatchOutcome::Matched {
            continue;
        }
        matched += 1;
        assert!(
            answer.status.log_odds > 0.5 * expected.status.log_odds,
            "{} for {}",
            answer.status.log_odds,
            expected.status.log_odds
        );
        let count = |answer: &client::MatchAnswer| -> usize {
            answer.keyframes.iter().map(|keyframe| keyframe.matches.len()).sum()
        };
        landmarks = [landmarks[0] + count(&answer), landmarks[1] + count(&expected)];
        for keyframe in &answer.keyframes {
            let same = expected.keyframes.iter().find(|other| other.keyframe.id == keyframe.keyframe.id);
            let Some(same) = same else { continue };
            assert_eq!(keyframe.keyframe, same.keyframe);
            for cross in &same.cross_covariances {
                let both = answer.keyframes.iter().any(|other| other.keyframe.id == cross.other);
                if both && keyframe.rank == same.rank || request.held.contains(&cross.other) {
                    let block = keyframe.cross_covariances.iter().find(|other| other.other == cross.other);
                    let block = block.or_else(|| {
                        let other = answer.keyframes.iter().find(|other| other.keyframe.id == cross.other)?;
                        other.cross_covariances.iter().find(|back| back.other == keyframe.keyframe.id)
                    });
                    assert!(block.is_some(), "a correlation is missing");
                }
            }
        }
        let localize = LocalizeRequest {
            camera: request.camera.clone(),
            features: request.features.clone(),
            prior: request.prior.clone(),
            gravity_in_camera: None,
        };
        let [fix, expected] = [&city, &reference].map(|map| map.localize(&localize, soon()));
        let (fix, expected) = (fix.await.unwrap(), expected.await.unwrap());
        assert_eq!(fix.outcome, expected.outcome);
        if let Some((fix, expected)) = fix.fix.zip(expected.fix) {
            let apart = fix.global_from_camera.pose.local(&expected.global_from_camera.pose);
            assert!(apart.norm() < 0.05, "{apart}");
        }
    }
    assert!(matched >= 18, "{matched} of 20");
    assert!(landmarks[0] * 10 > landmarks[1] * 9, "{landmarks:?}");
    let keyframe = city.keyframe(place.map.keyframes[33].id, soon()).await.unwrap();
    let same = reference.keyframe(place.map.keyframes[33].id, soon()).await.unwrap();
    assert_eq!((keyframe.keyframe, keyframe.landmarks), (same.keyframe, same.landmarks));
    let replies =
        robot.get("map/city/keyframes/*").consolidation(zenoh::query::ConsolidationMode::None).await.unwrap();
    let mut all = 0;
    while let Ok(reply) = replies.recv_async().await {
        all += usize::from(reply.result().is_ok());
    }
    assert_eq!(all, 60);

    // A server goes: its cells are at the two others, and no query fails meanwhile.
    servers.pop().unwrap().stop().await;
    for request in requests(&place).iter().take(8) {
        let answer = city.match_image(request, soon()).await.unwrap();
        assert_eq!(answer.status.outcome, MatchOutcome::Matched);
    }
    wait_for_cells(&robot, 2 * cells).await;

    // A release: all servers change over, and robots are told once what changed.
    let notices = robot.declare_subscriber("map/city/changes").await.unwrap();
    let mut next = place.map.clone();
    next.keyframes[30].global_from_keyframe.pose.translation.x += 0.2;
    publish(&store, next, &small_cells(), |_| {}).await.unwrap();
    let notice = notices.recv_async().await.unwrap().payload().to_bytes().into_owned();
    let notice: MapChangeNotice = protocol::decode(Format::Bincode, &notice).unwrap();
    assert_eq!((notice.from_version, notice.version), (release.map.version, release.map.version + 1));
    assert_eq!(notice.moved, [place.map.keyframes[30].id]);
    for request in requests(&place).iter().take(8) {
        let answer = city.match_image(request, soon()).await.unwrap();
        assert_eq!(answer.status.outcome, MatchOutcome::Matched);
        assert_eq!(answer.status.map_version, notice.version);
    }
    for server in servers {
        server.stop().await;
    }
    one.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cell_without_a_server_is_no_missing_match() {
    let Town { place, folder, store, release, .. } = Town::new().await;
    let half: Vec<u32> = release.cells.iter().map(|cell| cell.cell).filter(|cell| cell % 2 == 0).collect();
    let text = half.iter().map(u32::to_string).collect::<Vec<_>>().join(",");

    let (_hub, endpoint) = hub().await;
    let only = CellServer::start(&endpoint, "only", &store, folder.path(), text.parse().unwrap()).await;
    let robot = session(&endpoint).await;
    wait_for_cells(&robot, half.len()).await;
    let city = MapClient::new(robot.clone(), "city").unwrap();
    let (mut matched, mut refused) = (0, 0);
    let mut rng = StdRng::seed_from_u64(3);
    for pose in place.path.iter().step_by(7) {
        let request = place.request(pose, 8, &mut rng);
        match city.match_image(&request, Instant::now() + Duration::from_millis(300)).await {
            Ok(answer) => {
                assert_eq!(answer.status.outcome, MatchOutcome::Matched);
                matched += 1;
            }
            Err(error) => {
                assert!(error.is_transient(), "{error}");
                refused += 1;
            }
        }
    }
    assert!(matched > 0 && refused > 0, "{matched} matched, {refused} refused");
    only.stop().await;
}

#[test]
fn choices_of_cells_are_read() {
    assert_eq!("auto".parse(), Ok(CellChoice::Auto));
    assert_eq!("3".parse(), Ok(CellChoice::These([3].into())));
    assert_eq!("0-2, 7".parse(), Ok(CellChoice::These([0, 1, 2, 7].into())));
    for wrong in ["", "all", "3-", "5-3", "-1", "0-4000000000"] {
        assert!(wrong.parse::<CellChoice>().is_err(), "{wrong}");
    }
}
