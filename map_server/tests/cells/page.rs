//! The live map of a server that has some cells of a map.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use map_server::{CellChoice, Show};
use protocol::KeyframeId;
use releases::{CellId, fetch_cell, publish};
use serde_json::Value;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use zenoh::Session;

use super::servers::{CellServer, hub, session};
use super::town::{Town, small_cells};

/// The body of an answer.
async fn ask(address: SocketAddr, method: &str, path: &str, body: &[u8]) -> Vec<u8> {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let head = format!(
        "{method} {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    stream.write_all(&[head.as_bytes(), body].concat()).await.unwrap();
    let mut response = Vec::new();
    stream.read_to_end(&mut response).await.unwrap();
    let end = response.windows(4).position(|bytes| bytes == b"\r\n\r\n").unwrap();
    response.split_off(end + 4)
}

pub async fn get(address: SocketAddr, path: &str) -> Vec<u8> {
    ask(address, "GET", path, b"").await
}

/// What the page says of the map once it satisfies a condition.
async fn summary(address: SocketAddr, is_so: impl Fn(&Value) -> bool) -> Value {
    let begin = Instant::now();
    loop {
        let list: Value = serde_json::from_slice(&get(address, "/api/maps").await).unwrap();
        let city = &list["maps"][0];
        assert_eq!(city["name"], "city");
        if is_so(city) {
            return city.clone();
        }
        assert!(begin.elapsed() < Duration::from_mins(1), "{city}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

async fn cells_at(client: &Session, server: &str) -> Vec<CellId> {
    let tokens = client.liveliness().get(format!("map/city/cell/*/server/{server}")).await.unwrap();
    let mut cells = Vec::new();
    while let Ok(reply) = tokens.recv_async().await {
        let key = reply.into_result().unwrap().key_expr().as_str().to_owned();
        cells.push(key.split('/').nth(3).unwrap().parse().unwrap());
    }
    cells
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_shows_the_cells_that_a_server_has_as_they_come_and_go() {
    let town = Town::new().await;
    let all = town.release.cells.len();
    let mut own: BTreeMap<CellId, Vec<KeyframeId>> = BTreeMap::new();
    for cell in &town.release.cells {
        let fetched = fetch_cell(&town.store, &town.release, cell.cell, None).await.unwrap();
        own.insert(cell.cell, fetched.own);
    }
    let (_hub, endpoint) = hub().await;
    let robot = session(&endpoint).await;
    let start = async |name: &str| {
        CellServer::start(&endpoint, name, &town.store, town.folder.path(), CellChoice::Auto).await
    };
    let north = start("north").await;
    let nothing_beside = axum::Router::new();
    let page = Show::start(
        ([127, 0, 0, 1], 0).into(),
        &north.session,
        &north.server,
        std::iter::empty(),
        nothing_beside,
    );
    let page = page.await.unwrap();
    let address = page.address();
    // What is drawn is what the server has, and nothing of it twice.
    let is_drawn = async |cells: &[CellId]| {
        let keyframes: Value =
            serde_json::from_slice(&get(address, "/api/maps/city/keyframes").await).unwrap();
        let mut drawn: Vec<KeyframeId> = keyframes["keyframes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|one| one["id"].as_u64().unwrap())
            .collect();
        drawn.sort_unstable();
        let mut expected: Vec<KeyframeId> = cells.iter().flat_map(|cell| own[cell].clone()).collect();
        expected.sort_unstable();
        let landmarks: usize = cells.iter().map(|cell| town.release.cell(*cell).unwrap().landmarks).sum();
        let drawn_landmarks = get(address, "/api/maps/city/landmarks").await.len() / 12;
        (drawn, drawn_landmarks) == (expected, landmarks)
    };

    let here = |count: usize| move |city: &Value| city["cells"]["here"] == count;
    let whole = summary(address, here(all)).await;
    assert!(is_drawn(&own.keys().copied().collect::<Vec<_>>()).await);
    let counts = [town.place.map.keyframes.len(), town.place.map.landmarks.len()];
    assert_eq!([&whole["keyframes"], &whole["landmarks"]], counts.map(Value::from).each_ref());

    // No cell is all of the map: an image is not searched in them.
    let refused = ask(address, "POST", "/api/maps/city/localize?camera=0", b"\x89PNG\r\n\x1a\n").await;
    assert!(String::from_utf8(refused).unwrap().contains("city is served by cells"));

    // Two more servers take some of the cells.
    let (south, west) = (start("south").await, start("west").await);
    let begin = Instant::now();
    loop {
        let left = cells_at(&robot, "north").await;
        if (1..all).contains(&left.len()) && is_drawn(&left).await {
            break;
        }
        assert!(begin.elapsed() < Duration::from_mins(1), "{left:?}");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    let fewer = summary(address, |_| true).await;
    assert_eq!((&fewer["cells"]["all"], &fewer["version"]), (&all.into(), &whole["version"]));
    assert!(fewer["cells"]["here"].as_u64() < whole["cells"]["here"].as_u64());
    assert!(fewer["revision"].as_u64() > whole["revision"].as_u64());

    // One of them goes, and all cells come back.
    south.stop().await;
    let again = summary(address, here(all)).await;
    assert_eq!(again["keyframes"], whole["keyframes"]);

    // A release moves a keyframe.
    let mut next = town.place.map.clone();
    next.keyframes[30].global_from_keyframe.pose.translation.x += 0.25;
    let moved = (next.keyframes[30].id, next.keyframes[30].global_from_keyframe.pose.translation.x);
    publish(&town.store, next, &small_cells(), |_| {}).await.unwrap();
    let version = town.release.map.version + 1;
    summary(address, |city| city["version"] == version && city["cells"]["here"] == all).await;
    let answer: Value = serde_json::from_slice(&get(address, "/api/maps/city/keyframes").await).unwrap();
    let shown = answer["keyframes"].as_array().unwrap().iter().find(|one| one["id"] == moved.0).unwrap();
    assert!((shown["position"][0].as_f64().unwrap() - moved.1).abs() < 1e-9);

    page.stop().await;
    north.stop().await;
    west.stop().await;
}
