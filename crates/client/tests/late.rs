//! A client whose server is not there yet.

use client::{SessionMode, SessionOptions, close_session, open_session};
use std::time::Duration;

fn free_endpoint() -> String {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    format!("tcp/127.0.0.1:{port}")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_is_open_as_soon_as_somebody_listens() {
    let endpoint = vec![free_endpoint()];
    let late = async {
        tokio::time::sleep(Duration::from_millis(700)).await;
        let listen = endpoint.clone();
        let options = SessionOptions { listen, mode: Some(SessionMode::Router), ..SessionOptions::default() };
        open_session(&options).await.unwrap()
    };
    let early = SessionOptions { connect: endpoint.clone(), ..SessionOptions::default() };
    let (router, client) = tokio::join!(late, open_session(&early));
    close_session(&client.unwrap()).await;
    close_session(&router).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_nobody_answers_can_give_up() {
    let options = SessionOptions { connect: vec![free_endpoint()], ..SessionOptions::default() };
    let opening = tokio::time::timeout(Duration::from_millis(500), open_session(&options)).await;
    assert!(opening.is_err(), "it was opened without anybody to connect to");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_is_connected_to_the_endpoint_that_answers() {
    let (nobody, listening) = (free_endpoint(), free_endpoint());
    let listen = SessionOptions { listen: vec![listening.clone()], ..SessionOptions::default() };
    let server = open_session(&listen).await.unwrap();
    let connect = vec![nobody, listening];
    let client = SessionOptions { connect, mode: Some(SessionMode::Client), ..SessionOptions::default() };
    let client = open_session(&client).await.unwrap();
    let peers: Vec<_> = client.info().peers_zid().await.chain(client.info().routers_zid().await).collect();
    assert_eq!(peers, [server.zid()]);
    close_session(&client).await;
    close_session(&server).await;
}

/// With room for two in place of a thousand.
#[tokio::test(flavor = "multi_thread")]
async fn where_all_places_are_taken_a_client_waits_for_one() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("zenoh.json5");
    std::fs::write(&file, "{ transport: { unicast: { max_sessions: 2 } } }").unwrap();
    let endpoint = vec![free_endpoint()];
    let listening =
        SessionOptions { config_file: Some(file), listen: endpoint.clone(), ..SessionOptions::default() };
    let server = open_session(&listening).await.unwrap();
    let connecting = SessionOptions { connect: endpoint, ..SessionOptions::default() };
    let first = open_session(&connecting).await.unwrap();
    let second = open_session(&connecting).await.unwrap();
    let third = open_session(&connecting);
    tokio::pin!(third);
    let too_early = tokio::time::timeout(Duration::from_secs(1), &mut third).await;
    assert!(too_early.is_err(), "there was a third place");
    close_session(&first).await;
    let third = tokio::time::timeout(Duration::from_secs(30), third).await.expect("it is let in").unwrap();
    for session in [second, third, server] {
        close_session(&session).await;
    }
}

#[test]
fn a_thousand_sessions_find_room_by_default() {
    let config = SessionOptions::default().to_config().unwrap();
    let places = config.get_json("transport/unicast/max_sessions").unwrap();
    assert_eq!(places, client::session::MAX_SESSIONS.to_string());
}
