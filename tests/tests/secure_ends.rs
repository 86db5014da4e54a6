//! Certificates that expire while they are used, members that are locked out, and traffic that is sent again.

use client::session::{CONFIG_FILE, Role, SessionOptions, close_session};
use protocol::{Format, keys};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tests::attack::{FORGED_STAMP, VICTIM, all_answers, status};
use tests::fleet::{FleetOperator, FleetRobot, FleetServer, PATIENCE, member, secured};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tools::fleet::{Fleet, Validity};

/// How long the certificate of a robot is valid that expires in the test.
const LIFETIME: Duration = Duration::from_secs(8);

/// What an operator hears until a status of this robot is heard, which has the same way as all before.
async fn heard_until(operator: &FleetOperator, robot: &FleetRobot, stamp_ns: i64) -> Vec<(String, i64)> {
    let (begin, mut heard) = (Instant::now(), Vec::new());
    while !heard.iter().any(|(_, heard_ns)| *heard_ns == stamp_ns) {
        assert!(begin.elapsed() < PATIENCE, "the robot is not heard: {heard:?}");
        robot.publish(stamp_ns).await;
        tokio::time::sleep(Duration::from_millis(50)).await;
        heard.extend(operator.heard());
    }
    heard
}

/// A session that is opened in one attempt, or not.
async fn attempt(options: &SessionOptions) -> zenoh::Result<zenoh::Session> {
    let mut config = options.to_config().unwrap();
    config.insert_json5("connect/timeout_ms", "0").unwrap();
    zenoh::open(config).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_whose_certificate_expires_is_disconnected_and_not_let_in_again() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("fleet");
    let fleet = secured(&place, false);
    let server = FleetServer::start(&member(&place, "south")).await;
    let begin = Instant::now();
    fleet.renew(Some("bo"), Validity { seconds: LIFETIME.as_secs() as i64 }).unwrap();
    let expiring = FleetRobot::start("bo", &member(&place, "bo")).await;
    expiring.first_answer().await;
    let other = FleetRobot::start(VICTIM, &member(&place, VICTIM)).await;
    while !all_answers(&expiring.session, "map/hall/info").await.is_empty() {
        assert!(begin.elapsed() < PATIENCE, "it is still served");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert!(begin.elapsed() >= LIFETIME.saturating_sub(Duration::from_secs(1)), "{:?}", begin.elapsed());
    assert!(attempt(&member(&place, "bo")).await.is_err(), "it was let in");
    other.first_answer().await;
    // With a new one it is a member as before.
    fleet.renew(Some("bo"), Validity::default()).unwrap();
    FleetRobot::start("bo", &member(&place, "bo")).await.first_answer().await;
    server.stop().await;
}

/// Removes the subject of a member from the access control of a hub, as the book says.
fn lock_out(fleet: &Fleet, hub: &str, subject: &str) {
    let path = fleet.folder_of(hub).join(CONFIG_FILE);
    let text = std::fs::read_to_string(&path).unwrap();
    let without_comments: String = text.lines().filter(|line| !line.starts_with("//")).collect();
    let mut config: serde_json::Value = serde_json::from_str(&without_comments).unwrap();
    let access = &mut config["access_control"];
    let subjects = access["subjects"].as_array_mut().unwrap();
    let before = subjects.len();
    subjects.retain(|entry| entry["id"] != subject);
    assert_eq!(subjects.len(), before - 1);
    access["policies"].as_array_mut().unwrap().retain(|policy| policy["subjects"][0] != subject);
    std::fs::write(path, config.to_string()).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_was_locked_out_gets_nothing_and_tells_nobody_anything() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("fleet");
    let fleet = secured(&place, false);
    lock_out(&fleet, "south", "robot/bo");
    let server = FleetServer::start(&member(&place, "south")).await;
    let operator = FleetOperator::start(&member(&place, "ann")).await;
    let honest = FleetRobot::start(VICTIM, &member(&place, VICTIM)).await;
    honest.first_answer().await;
    // It has a certificate, so that it is connected; what it checks itself is no obstacle.
    let mut config = member(&place, "bo").to_config().unwrap();
    config.insert_json5("access_control", "{ enabled: false }").unwrap();
    let lost = zenoh::open(config).await.unwrap();
    let heard = lost.declare_subscriber("**").await.unwrap();
    let own = status(FORGED_STAMP);
    for _ in 0..5 {
        let put = lost.put(keys::robot_status("bo").unwrap(), own.clone());
        put.encoding(Format::Bincode.encoding()).await.unwrap();
        assert!(all_answers(&lost, "map/hall/info").await.is_empty(), "served");
    }
    let all = heard_until(&operator, &honest, 7).await;
    assert!(all.iter().all(|(_, stamp)| *stamp == 7), "an operator heard the lost robot: {all:?}");
    assert!(heard.drain().all(|sample| sample.payload().to_bytes().as_ref() == own), "overheard");
    close_session(&lost).await;
    server.stop().await;
}

/// Forwards one connection to the server, and keeps what its client sent.
async fn tap(target: String) -> (String, Arc<Mutex<Vec<u8>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("tls/{}", listener.local_addr().unwrap());
    let captured = Arc::new(Mutex::new(Vec::new()));
    let keep = Arc::clone(&captured);
    tokio::spawn(async move {
        let (near, _) = listener.accept().await.unwrap();
        let far = TcpStream::connect(target).await.unwrap();
        let ((mut from_near, mut to_near), (mut from_far, mut to_far)) =
            (near.into_split(), far.into_split());
        tokio::spawn(async move { tokio::io::copy(&mut from_far, &mut to_near).await });
        let mut chunk = [0; 4096];
        while let Ok(read @ 1..) = from_near.read(&mut chunk).await {
            keep.lock().unwrap().extend_from_slice(&chunk[..read]);
            to_far.write_all(&chunk[..read]).await.unwrap();
        }
    });
    (endpoint, captured)
}

fn address_of(fleet: &Path) -> String {
    let config = std::fs::read_to_string(fleet.join("south").join(CONFIG_FILE)).unwrap();
    let port = config.split("tls/127.0.0.1:").nth(1).unwrap();
    format!("127.0.0.1:{}", port.split('"').next().unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn captured_traffic_that_is_sent_again_is_neither_heard_nor_answered() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("fleet");
    let fleet = secured(&place, false);
    assert_eq!(fleet.hub().role, Role::MapServer);
    let server = FleetServer::start(&member(&place, "south")).await;
    let operator = FleetOperator::start(&member(&place, "ann")).await;
    let (endpoint, captured) = tap(address_of(&place)).await;
    let mut tapped = member(&place, "bo");
    tapped.connect = vec![endpoint];
    let robot = FleetRobot::start("bo", &tapped).await;
    robot.first_answer().await;
    heard_until(&operator, &robot, 11).await;
    close_session(&robot.session).await;
    operator.heard();

    let bytes = captured.lock().unwrap().clone();
    assert!(bytes.len() > 1000, "{} bytes were captured", bytes.len());
    let honest = FleetRobot::start(VICTIM, &member(&place, VICTIM)).await;
    for part in [bytes.len(), bytes.len() / 2, 400] {
        let mut stream = TcpStream::connect(address_of(&place)).await.unwrap();
        // The server may end the connection before all was sent.
        let _ = stream.write_all(&bytes[..part]).await;
        let mut answer = Vec::new();
        let ended = tokio::time::timeout(PATIENCE, stream.read_to_end(&mut answer)).await;
        assert!(ended.is_ok(), "the server keeps the connection");
        // The begin of a new handshake, whose keys the sender does not have.
        assert!(answer.len() < 10_000, "{} bytes", answer.len());
    }
    honest.first_answer().await;
    let all = heard_until(&operator, &honest, 12).await;
    assert!(!all.iter().any(|(_, stamp)| *stamp == 11), "the captured status was heard again");
    server.stop().await;
}
