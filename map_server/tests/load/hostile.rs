//! What hostile clients cost a good robot and the server: time, memory and log lines.
//!
//! Each attack runs in a process of its own against an open network: nothing keeps an attacker out but the bounds.

use std::fs::File;
use std::path::Path;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use crate::load::images::{costly_jpeg, costly_png, post};
use crate::load::town::{MAP, Server, quantile_ms, requests, setting, town};
use client::{MapChangeSubscriber, MapClient, SessionOptions, close_session, open_session};
use protocol::{Format, MatchRequest};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use testing::{Place, resident_mb};
use vision::features::DEFAULT_EXTRACTOR;
use zenoh::Session;

/// Time that the good robot waits for an answer.
const DEADLINE: Duration = Duration::from_secs(5);
/// Time between two of its queries.
const PERIOD: Duration = Duration::from_millis(50);
/// Time that an attack runs before the good robot is measured.
const RAMP: Duration = Duration::from_secs(3);

/// Clients of an attack.
const CLIENTS: usize = 8;

const ATTACKS: [&str; 10] = [
    "payloads",
    "features",
    "many features",
    "costliest",
    "held",
    "names",
    "images",
    "sessions",
    "declarations",
    "garbage",
];

fn options(endpoint: &str) -> SessionOptions {
    SessionOptions { connect: vec![endpoint.to_owned()], ..SessionOptions::default() }
}

/// What the good robot sees in a while.
struct Seen {
    latencies: Vec<Duration>,
    failed: usize,
}

async fn ask_for_a_while(client: &MapClient, requests: &[MatchRequest], seconds: usize) -> Seen {
    let mut seen = Seen { latencies: Vec::new(), failed: 0 };
    let end = Instant::now() + Duration::from_secs(seconds as u64);
    for request in requests.iter().cycle() {
        let asked = Instant::now();
        if asked >= end {
            break;
        }
        match client.match_image(request, asked + DEADLINE).await {
            Ok(_) => seen.latencies.push(asked.elapsed()),
            Err(_) => seen.failed += 1,
        }
        tokio::time::sleep(PERIOD.saturating_sub(asked.elapsed())).await;
    }
    seen.latencies.sort();
    seen
}

/// Starts an attack of so many clients, where its kind has clients.
pub fn attack(name: &str, endpoint: &str, page: &str, clients: usize) -> Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "load::hostile::attacker", "--ignored", "--nocapture"]);
    command
        .env("ATTACK", name)
        .env("ENDPOINT", endpoint)
        .env("PAGE", page)
        .env("CLIENTS", clients.to_string())
        .spawn()
        .unwrap()
}

#[test]
#[ignore = "a measurement of minutes"]
fn hostile_load() {
    let (seconds, keyframes) = (setting("SECONDS", 15), setting("KEYFRAMES", 1000));
    let mut place = town(keyframes);
    // So that the page takes images.
    DEFAULT_EXTRACTOR.clone_into(&mut place.map.info.extractor);
    let folder = tempfile::tempdir().unwrap();
    let port = setting("PORT", 17_449);
    let (endpoint, page) = (format!("tcp/127.0.0.1:{port}"), format!("127.0.0.1:{}", port + 1));
    let log = folder.path().join("log");
    let to_log = Some(File::create(&log).unwrap());
    let server = Server::start_with(&place, folder.path(), &endpoint, to_log, &["--http", &page]);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let session = open_session(&options(&endpoint)).await.unwrap();
        let client = MapClient::new(session.clone(), MAP).unwrap().awaiting_map();
        let mut changes = MapChangeSubscriber::subscribe(&session, MAP).await.unwrap();
        let requests = requests(&place, true, 1);
        client.match_image(&requests[0], Instant::now() + Duration::from_mins(1)).await.unwrap();
        let lines = |path: &Path| std::fs::read_to_string(path).unwrap().lines().count();
        let mut before = lines(&log);
        let only = std::env::var("ATTACKS").ok();
        let is_chosen = |name: &&str| only.as_ref().is_none_or(|only| only.split(',').any(|one| one == *name));
        for name in std::iter::once("quiet").chain(ATTACKS.into_iter().filter(is_chosen)) {
            let mut attacker = (name != "quiet").then(|| attack(name, &endpoint, &page, CLIENTS));
            ask_for_a_while(&client, &requests, RAMP.as_secs() as usize).await;
            let seen = ask_for_a_while(&client, &requests, seconds).await;
            let begun = Instant::now();
            let newcomer = tokio::time::timeout(DEADLINE, open_session(&options(&endpoint))).await;
            match newcomer {
                Ok(session) => {
                    println!("{name:14} a new client was connected in {:.2} s", begun.elapsed().as_secs_f64());
                    close_session(&session.unwrap()).await;
                }
                Err(_) => println!("{name:14} a new client was not connected within {DEADLINE:?}"),
            }
            let mut told = 0;
            while changes.poll().is_some() {
                told += 1;
            }
            let (server_mb, robot_mb) = (resident_mb(server.id()).unwrap(), resident_mb(std::process::id()).unwrap());
            if let Some(attacker) = &mut attacker {
                assert!(attacker.try_wait().unwrap().is_none(), "{name}: the attacker ended, and proved nothing");
                attacker.kill().unwrap();
                attacker.wait().unwrap();
            }
            let now = lines(&log);
            println!(
                "{name:14} {:4} answers, {} failed; p50 {:.1} ms, p99 {:.1} ms; server {server_mb:.0} MB, robot {robot_mb:.0} MB; {} log lines; {told} changes taken",
                seen.latencies.len(),
                seen.failed,
                quantile_ms(&seen.latencies, 0.5),
                quantile_ms(&seen.latencies, 0.99),
                now - before,
            );
            before = now;
            assert!(!seen.latencies.is_empty(), "{name}: no answer at all");
            // Whoever comes after the attack is let in.
            let ended = Instant::now();
            let newcomer = tokio::time::timeout(Duration::from_mins(1), open_session(&options(&endpoint))).await;
            close_session(&newcomer.expect("a client connects after the attack").unwrap()).await;
            println!("{name:14} a new client was connected {:.2} s after it", ended.elapsed().as_secs_f64());
            // What the attack left is gone before the next.
            tokio::time::sleep(Duration::from_secs(5)).await;
        }
        close_session(&session).await;
    });
}

#[test]
#[ignore = "the other side of hostile_load"]
fn attacker() {
    let (Ok(attack), Ok(endpoint)) = (std::env::var("ATTACK"), std::env::var("ENDPOINT")) else { return };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        match attack.as_str() {
            "payloads" => send_payloads(&open(&endpoint).await).await,
            "features" => ask_with_features(&endpoint, 20_000).await,
            "many features" => ask_with_features(&endpoint, protocol::MAX_QUERY_FEATURES - 100).await,
            "costliest" => ask_for_most(&endpoint, protocol::MAX_HELD_KEYFRAMES as u64).await,
            "held" => ask_for_most(&endpoint, 4_000_000).await,
            "names" => ask_under_names(&endpoint).await,
            "images" => give_images(&std::env::var("PAGE").unwrap()),
            "sessions" => open_sessions(&endpoint).await,
            "declarations" => declare(&open(&endpoint).await).await,
            "garbage" => send_garbage(&open(&endpoint).await).await,
            other => panic!("no attack {other:?}"),
        }
    });
}

/// A session that sends whatever it is told to.
async fn open(endpoint: &str) -> Session {
    let mut config = options(endpoint).to_config().unwrap();
    config.insert_json5("transport/link/rx/max_message_size", "4000000000").unwrap();
    config.insert_json5("connect/timeout_ms", "30000").unwrap();
    zenoh::open(config).await.unwrap()
}

/// 900 MB, again and again.
async fn send_payloads(session: &Session) {
    let payload = zenoh::bytes::ZBytes::from(vec![7_u8; 900 << 20]);
    loop {
        let replies = session.get(protocol::keys::map_match(MAP).unwrap()).payload(payload.clone()).await;
        if let Ok(replies) = replies {
            while replies.recv_async().await.is_ok() {}
        }
    }
}

/// Clients, each with four queries at a time, without priors.
async fn ask_with_features(endpoint: &str, count: usize) {
    let place: Place = town(5);
    for client in 0..setting("CLIENTS", CLIENTS) as u64 {
        let mut rng = StdRng::seed_from_u64(client);
        let mut request = place.request(&place.path[0], 4, &mut rng);
        request.features = place.features(&place.path[0], count, &mut rng);
        let payload = unchecked(&request);
        let session = open(endpoint).await;
        for _ in 0..4 {
            tokio::spawn(ask_for_ever(session.clone(), client, payload.clone()));
        }
    }
    std::future::pending::<()>().await;
}

/// A request as JSON: the codec refuses to encode what it would refuse to decode.
fn unchecked(request: &MatchRequest) -> Vec<u8> {
    let mut message = serde_json::to_value(request).unwrap();
    message["schema"] = protocol::SCHEMA_VERSION.into();
    serde_json::to_vec(&message).unwrap()
}

async fn ask_for_ever(session: Session, client: u64, payload: Vec<u8>) {
    let selector = format!("{}?client={client}", protocol::keys::map_match(MAP).unwrap());
    loop {
        let query = session.get(&selector).payload(payload.clone());
        let replies = query.encoding(Format::Json.encoding()).await.unwrap();
        while replies.recv_async().await.is_ok() {}
    }
}

/// Clients with one query at a time: as many features, held keyframes and keyframes of the answer as may be.
async fn ask_for_most(endpoint: &str, held: u64) {
    let place: Place = town(5);
    for client in 0..setting("CLIENTS", CLIENTS) as u64 {
        let mut rng = StdRng::seed_from_u64(client);
        let mut request = place.request(&place.path[0], protocol::MAX_ANSWER_KEYFRAMES, &mut rng);
        request.features = place.features(&place.path[0], protocol::MAX_QUERY_FEATURES - 400, &mut rng);
        request.held = (0..held).collect();
        let session = open(endpoint).await;
        tokio::spawn(ask_for_ever(session, client, unchecked(&request)));
    }
    std::future::pending::<()>().await;
}

/// One session that sends 1,000 small queries a second, each under another of 500 names.
async fn ask_under_names(endpoint: &str) {
    let place: Place = town(5);
    let mut rng = StdRng::seed_from_u64(1);
    let request = place.request(&place.path[0], 1, &mut rng);
    let payload = protocol::encode(Format::Bincode, &request).unwrap();
    let session = open(endpoint).await;
    let key = protocol::keys::map_match(MAP).unwrap();
    let mut due = tokio::time::interval(Duration::from_millis(1));
    for k in (0..500).cycle() {
        due.tick().await;
        let query = session.get(format!("{key}?client=name{k}")).payload(payload.clone());
        query.encoding(Format::Bincode.encoding()).callback(|_| ()).await.unwrap();
    }
}

/// People who give the page one image after the other.
fn give_images(page: &str) {
    let images = [costly_png(), costly_jpeg()];
    std::thread::scope(|scope| {
        for person in 0..CLIENTS {
            let image = &images[person % images.len()];
            scope.spawn(move || {
                loop {
                    let status = post(page, MAP, image);
                    assert!(matches!(status, Ok(200 | 422 | 429)), "{status:?}");
                }
            });
        }
    });
}

async fn open_sessions(endpoint: &str) {
    let mut sessions = Vec::new();
    for _ in 0..1000 {
        // A server that lets no more in ends the attempts, not the attack.
        let Ok(Ok(session)) = tokio::time::timeout(Duration::from_secs(1), open_small(endpoint)).await else {
            break;
        };
        sessions.push(session);
    }
    eprintln!("{} sessions", sessions.len());
    std::future::pending::<()>().await;
}

async fn open_small(endpoint: &str) -> zenoh::Result<Session> {
    let mut config = options(endpoint).to_config().unwrap();
    config.insert_json5("connect/timeout_ms", "1000").unwrap();
    zenoh::open(config).await
}

async fn declare(session: &Session) {
    let (mut subscribers, mut queryables, mut tokens) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..10_000 {
        match k % 3 {
            0 => subscribers.push(session.declare_subscriber(format!("map/{MAP}/{k}")).await.unwrap()),
            1 => queryables.push(session.declare_queryable(format!("map/{MAP}/{k}")).await.unwrap()),
            _ => tokens.push(session.liveliness().declare_token(format!("robot/{k}")).await.unwrap()),
        }
    }
    eprintln!("10,000 declarations");
    std::future::pending::<()>().await;
}

/// 1,000 messages a second: queries, changes of the map, statuses.
async fn send_garbage(session: &Session) {
    let mut rng = StdRng::seed_from_u64(1);
    let keys = [
        protocol::keys::map_changes(MAP).unwrap(),
        protocol::keys::robot_status("r1").unwrap(),
        protocol::keys::robot_pose("r1").unwrap(),
    ];
    let queried = [
        protocol::keys::map_match(MAP).unwrap(),
        protocol::keys::map_localize(MAP).unwrap(),
        protocol::keys::map_keyframes(MAP).unwrap(),
    ];
    let mut due = tokio::time::interval(Duration::from_millis(10));
    loop {
        due.tick().await;
        for k in 0..10 {
            let bytes: Vec<u8> = (0..rng.random_range(0..4000)).map(|_| rng.random()).collect();
            if k % 2 == 0 {
                session.put(&keys[k / 2 % 3], bytes).await.unwrap();
            } else {
                session.get(&queried[k / 2 % 3]).payload(bytes).callback(|_| ()).await.unwrap();
            }
        }
    }
}
