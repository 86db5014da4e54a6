//! Two servers of one name.

use std::time::{Duration, Instant};

use map_server::{MapServer, ServeError, ServerOptions};

use super::servers::{hub, session, wait_for};

fn named(name: &str) -> ServerOptions {
    let mut options = ServerOptions::default();
    options.name = Some(name.to_owned());
    options
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_whose_name_is_taken_waits_for_it_and_says_so() {
    let (_hub, endpoint) = hub().await;
    let [first, second] = [session(&endpoint).await, session(&endpoint).await];
    let north = MapServer::start(first, Vec::new(), named("north")).await.unwrap();
    // The router knows of it.
    wait_for(&second, &protocol::keys::map_server("north").unwrap(), 1).await;
    MapServer::start(second.clone(), Vec::new(), named("south")).await.unwrap().stop().await.unwrap();

    let refused = MapServer::start(second.clone(), Vec::new(), named("north")).await;
    let error = refused.err().unwrap();
    assert!(matches!(&error, ServeError::NameTaken { name } if name == "north"), "{error}");
    assert!(error.to_string().contains("--name"), "{error}");

    // One that comes while the other one ends takes its place.
    let begin = Instant::now();
    let taking = tokio::spawn(async move { MapServer::start(second, Vec::new(), named("north")).await });
    tokio::time::sleep(Duration::from_secs(1)).await;
    north.stop().await.unwrap();
    let taken = taking.await.unwrap().unwrap();
    assert!(begin.elapsed() < Duration::from_secs(5));
    taken.stop().await.unwrap();
}
