//! In a secured fleet each certificate has one share of a server, however many sessions use it.

use client::MapClient;
use client::session::{close_session, open_session};
use map_server::{MapServer, ServedMap, ServerOptions};
use protocol::MatchRequest;
use rand::SeedableRng as _;
use rand::rngs::StdRng;
use recognition::LoadedMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use testing::{Place, PlaceOptions};
use tests::attack::VICTIM;
use tests::fleet::{MAP, PATIENCE, member, secured};

/// Sessions of the robot that wants more than its share.
const SESSIONS: usize = 5;
/// Queries that a session has at the server at any time.
const AT_ONCE: usize = 6;
/// Answers after which shares are compared.
const ANSWERS: usize = 300;

/// Asks again and again.
async fn ask(map: MapClient, request: MatchRequest, answered: Arc<AtomicUsize>, is_over: Arc<AtomicBool>) {
    while !is_over.load(Ordering::Relaxed) {
        if map.match_image(&request, Instant::now() + PATIENCE).await.is_ok() {
            answered.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_with_many_sessions_has_the_share_of_one() {
    let folder = tempfile::tempdir().unwrap();
    let fleet_folder = folder.path().join("fleet");
    secured(&fleet_folder, false);
    let place = Place::new(&PlaceOptions { keyframes: 24, landmarks: 1200, ..PlaceOptions::default() });
    let request = place.request(&place.path[0], 4, &mut StdRng::seed_from_u64(1));
    let session = open_session(&member(&fleet_folder, "south")).await.unwrap();
    let map = Arc::new(LoadedMap::from_contents(place.map).unwrap());
    let mut options = ServerOptions::default();
    (options.name, options.workers) = (Some("south".to_owned()), 1);
    let maps = vec![ServedMap { name: MAP.to_owned(), map }];
    let server = MapServer::start(session.clone(), maps, options).await.unwrap();

    let is_over = Arc::new(AtomicBool::new(false));
    let counts: [Arc<AtomicUsize>; 2] = Default::default();
    let (mut sessions, mut asking) = (Vec::new(), Vec::new());
    for (robot, count, answered) in [("bo", SESSIONS, &counts[0]), (VICTIM, 1, &counts[1])] {
        for _ in 0..count {
            let session = open_session(&member(&fleet_folder, robot)).await.unwrap();
            let map = MapClient::new(session.clone(), MAP).unwrap().awaiting_map();
            map.match_image(&request, Instant::now() + PATIENCE).await.unwrap();
            sessions.push((session, map, Arc::clone(answered)));
        }
    }
    // Until the server has seen who is connected, they share one place with all that are not known.
    tokio::time::sleep(Duration::from_secs(2)).await;
    for (_, map, answered) in &sessions {
        for _ in 0..AT_ONCE {
            let (answered, is_over) = (Arc::clone(answered), Arc::clone(&is_over));
            asking.push(tokio::spawn(ask(map.clone(), request.clone(), answered, is_over)));
        }
    }
    let begin = Instant::now();
    let answered = || counts.each_ref().map(|count| count.load(Ordering::Relaxed));
    while answered().iter().sum::<usize>() < ANSWERS {
        assert!(begin.elapsed() < 4 * PATIENCE, "{:?} answers", answered());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let [many, one] = answered();
    is_over.store(true, Ordering::Relaxed);
    for task in asking {
        task.await.unwrap();
    }
    println!("{many} answers to {SESSIONS} sessions of one robot, {one} to the other robot");
    // Of equal shares it would have a half, of shares by session a sixth.
    assert!(3 * one > many, "{one} of {}", one + many);
    for (session, ..) in sessions {
        close_session(&session).await;
    }
    server.stop().await.unwrap();
    close_session(&session).await;
}
