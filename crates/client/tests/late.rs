//! A client whose server is not there yet.
#![allow(clippy::unwrap_used)]

use client::{SessionMode, SessionOptions, close_session, open_session};
use std::time::Duration;

#[tokio::test(flavor = "multi_thread")]
async fn a_client_is_open_as_soon_as_somebody_listens() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = vec![format!("tcp/127.0.0.1:{port}")];
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
