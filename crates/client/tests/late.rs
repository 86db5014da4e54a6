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
