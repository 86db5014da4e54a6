//! Robots over Zenoh to a WebSocket.

use crate::common::{Shown, answered};
use futures_util::{SinkExt as _, StreamExt as _};
use protocol::RobotState;
use serde_json::Value;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};
use viewer::{MAX_VIEWERS, ViewedMap};

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;
const PATIENCE: Duration = Duration::from_secs(20);

async fn connect(shown: &Shown) -> Socket {
    connect_async(format!("ws://{}/api/live", shown.address())).await.unwrap().0
}

/// The status with which a WebSocket is refused.
async fn refused(shown: &Shown, origin: Option<&str>) -> Option<u16> {
    let mut request = format!("ws://{}/api/live", shown.address()).into_client_request().unwrap();
    if let Some(origin) = origin {
        request.headers_mut().insert("origin", origin.parse().unwrap());
    }
    match connect_async(request).await {
        Ok(_) => None,
        Err(Error::Http(response)) => Some(response.status().as_u16()),
        Err(error) => panic!("{error}"),
    }
}

/// The first message that satisfies a condition.
async fn first(socket: &mut Socket, mut is_it: impl FnMut(&Value) -> bool) -> Value {
    let found = async {
        loop {
            if let Message::Text(text) = socket.next().await.unwrap().unwrap() {
                let update: Value = serde_json::from_str(&text).unwrap();
                if is_it(&update) {
                    return update;
                }
            }
        }
    };
    timeout(PATIENCE, found).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_sees_what_robots_publish_and_what_they_were_answered() {
    let shown = Shown::start().await;
    let mut early = connect(&shown).await;
    let snapshot = first(&mut early, |_| true).await;
    assert_eq!((&snapshot["is_snapshot"], snapshot["robots"].as_array().unwrap().len()), (&true.into(), 0));
    assert!(snapshot["instance"].is_string(), "{snapshot}");

    let position = shown.publish_robot("r7", 12.0, RobotState::Localized).await;
    let update = first(&mut early, |update| update["robots"][0]["status"]["state"] == "localized").await;
    let robot = &update["robots"][0];
    assert_eq!(robot["robot"], "r7");
    let sent: [f64; 3] =
        serde_json::from_value(robot["pose"]["global_from_imu"]["position"].clone()).unwrap();
    assert!((position - nalgebra::Vector3::from(sent)).norm() < 1e-9);
    assert!(
        (robot["pose"]["global_from_imu"]["position_covariance"][2][2].as_f64().unwrap() - 0.0225).abs()
            < 1e-9
    );
    assert_eq!(robot["odometry"]["speed_mps"], 5.0);
    assert_eq!(robot["status"]["reason"], "the map was last used 0.4 s ago");

    let id = shown.session.zid().to_string();
    let token = shown.session.liveliness().declare_token(format!("robot/r7/session/{id}")).await.unwrap();
    let keyframes = vec![14, 15];
    let told = first(&mut early, |update| {
        shown.viewer.note_query("another", answered(&[], vec![]));
        shown.viewer.note_query(&id, answered(&keyframes, vec![]));
        update["robots"][0]["answer"].is_object()
    });
    let repeating = async {
        let mut x_m = 12.0;
        loop {
            x_m += 0.1;
            shown.publish_robot("r7", x_m, RobotState::Localized).await;
            tokio::time::sleep(Duration::from_millis(60)).await;
        }
    };
    let told: Value = tokio::select! { told = told => told, () = repeating => unreachable!() };
    assert!(told["time_ms"].as_u64().unwrap() >= snapshot["time_ms"].as_u64().unwrap());
    assert_eq!(told["robots"][0]["answer"]["keyframes"], serde_json::json!([14, 15]));

    let mut late = connect(&shown).await;
    let snapshot = first(&mut late, |_| true).await;
    assert_eq!(snapshot["robots"][0]["robot"], "r7", "a new viewer need not wait for the next message");
    token.undeclare().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_version_of_a_map_is_told() {
    let mut shown = Shown::start().await;
    let mut socket = connect(&shown).await;
    assert_eq!(first(&mut socket, |_| true).await["maps"]["place"], 3);
    shown.place.map.info.version = 5;
    shown.viewer.set_map(ViewedMap::of_contents("place", &shown.place.map));
    first(&mut socket, |update| update["maps"]["place"] == 5).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_other_origins_and_too_many_viewers_are_refused() {
    let shown = Shown::start().await;
    let own = format!("http://{}", shown.address());
    assert_eq!(refused(&shown, Some("http://evil.example")).await, Some(403));
    assert_eq!(refused(&shown, Some("null")).await, Some(403));
    assert_eq!(refused(&shown, Some(&own)).await, None);
    let mut sockets = Vec::new();
    let mut refusals = 0;
    for _ in 0..2 * MAX_VIEWERS {
        match connect_async(format!("ws://{}/api/live", shown.address())).await {
            Ok((socket, _)) => sockets.push(socket),
            Err(_) => refusals += 1,
        }
    }
    // The one above may not be gone yet.
    assert!(
        (MAX_VIEWERS - 1..=MAX_VIEWERS).contains(&sockets.len()) && refusals >= MAX_VIEWERS,
        "{refusals}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_that_says_much_is_disconnected_and_one_that_does_not_read_stops_nobody() {
    let shown = Shown::start().await;
    let mut loud = connect(&shown).await;
    // It may be cut off before all of it is sent.
    let _ = loud.send(Message::Binary(vec![0; 8 << 20].into())).await;
    let ended = async {
        while let Some(Ok(message)) = loud.next().await {
            drop(message);
        }
    };
    timeout(PATIENCE, ended).await.expect("disconnected");

    let _deaf = connect(&shown).await;
    let mut socket = connect(&shown).await;
    let mut seen = Vec::new();
    for at in 0..40 {
        for robot in 0..50 {
            shown.publish_robot(&format!("r{robot}"), f64::from(at), RobotState::Localized).await;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let last = shown.publish_robot("r49", 55.0, RobotState::Lost).await;
    first(&mut socket, |update| {
        let robots = update["robots"].as_array().unwrap();
        let found = robots.iter().find(|robot| robot["robot"] == "r49" && robot["status"]["state"] == "lost");
        seen.extend(found.map(|robot| robot["pose"]["global_from_imu"]["position"][0].as_f64().unwrap()));
        found.is_some()
    })
    .await;
    assert!((seen[0] - last.x).abs() < 1e-9);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_is_gone_with_its_token_when_it_is_silent_and_when_it_says_so() {
    let shown = Shown::start().await;
    let mut socket = connect(&shown).await;
    let is_online = |update: &Value| update["robots"][0]["is_online"].clone();
    let token = shown.session.liveliness().declare_token("robot/r7").await.unwrap();
    shown.publish_robot("r7", 12.0, RobotState::Localized).await;
    first(&mut socket, |update| update["robots"][0]["status"].is_object() && is_online(update) == true).await;
    token.undeclare().await.unwrap();
    first(&mut socket, |update| is_online(update) == false).await;
    // A message that was on its way.
    shown.publish_robot("r7", 13.0, RobotState::Lost).await;
    let late = first(&mut socket, |update| update["robots"][0]["status"]["state"] == "lost").await;
    assert_eq!(is_online(&late), false, "{late}");

    shown.publish_robot("r8", 12.0, RobotState::Localized).await;
    let of_r8 = |update: &Value| {
        let robots = update["robots"].as_array().unwrap();
        robots.iter().find(|robot| robot["robot"] == "r8").map(|robot| robot["is_online"] == true)
    };
    first(&mut socket, |update| of_r8(update) == Some(true)).await;
    let silent = first(&mut socket, |update| of_r8(update) == Some(false)).await;
    let robot = |update: &Value, name: &str| {
        let robots = update["robots"].as_array().unwrap();
        robots.iter().find(|robot| robot["robot"] == name).cloned().unwrap_or_default()
    };
    assert_eq!(robot(&silent, "r8")["is_off"], false, "{silent}");

    // Off at once, with and without a token, and for as long as it is not started again.
    shown.publish_status("r8", 14, RobotState::Off).await;
    first(&mut socket, |update| robot(update, "r8")["is_off"] == true).await;
    let snapshot = first(&mut connect(&shown).await, |update| update["is_snapshot"] == true).await;
    let [killed, off] = ["r7", "r8"].map(|name| robot(&snapshot, name));
    assert_eq!((&killed["is_off"], &killed["has_ended"]), (&false.into(), &true.into()), "{snapshot}");
    assert_eq!((&off["is_off"], &off["has_ended"]), (&true.into(), &true.into()), "{snapshot}");
    let _token = shown.session.liveliness().declare_token("robot/r8").await.unwrap();
    first(&mut socket, |update| robot(update, "r8")["is_off"] == false).await;
}
