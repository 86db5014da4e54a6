//! What the viewer keeps: queries, the last hour, statistics. It is bounded, whatever robots publish.

use crate::common::{Shown, answered, candidate, get};
use protocol::{ErrorCode, RobotState, RobotStatus, keys};
use serde_json::{Value, json};
use std::time::Duration;
use viewer::{CandidateVerdict, MAX_QUERIES, ServerSample, ViewedQuery, ViewedResult};

fn failed(error: ErrorCode, message: &str) -> ViewedQuery {
    let result = ViewedResult::Failed { error, message: message.to_owned() };
    ViewedQuery { kind: "localize", map: "place".to_owned(), duration_ms: 0.5, result }
}

#[tokio::test(flavor = "multi_thread")]
async fn queries_are_kept_with_what_was_found_and_why_they_were_refused() {
    let shown = Shown::start().await;
    let id = shown.session.zid().to_string();
    let token = shown.session.liveliness().declare_token(format!("robot/r7/session/{id}")).await.unwrap();
    let candidates = vec![
        candidate(14, 31, CandidateVerdict::InAnswer),
        candidate(15, 5, CandidateVerdict::TooFewMatches),
    ];
    // The token may not have arrived yet.
    let robot = loop {
        shown.viewer.note_query(&id, answered(&[14], candidates.clone()));
        let of_robot = shown.json("/api/queries?robot=r7").await;
        if let Some(query) = of_robot["queries"].get(0) {
            break query.clone();
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    assert_eq!(
        (&robot["robot"], &robot["outcome"], &robot["kind"]),
        (&json!("r7"), &json!("matched"), &json!("match"))
    );
    assert_eq!(robot["candidates"][0]["inliers"], 31);
    assert_eq!(robot["candidates"][1]["verdict"], "too_few_matches");
    assert_eq!(robot["prior_in_global"], json!([8.0, 0.0, 1.0]));

    let number = robot["number"].as_u64().unwrap();
    shown.viewer.note_query("stranger & co", failed(ErrorCode::Busy, "ask again later"));
    let newer = shown.json(&format!("/api/queries?after={number}")).await;
    assert_eq!(newer["queries"].as_array().unwrap().len(), 1);
    let busy = shown.json("/api/queries?robot=stranger%20%26%20co&limit=1").await["queries"][0].clone();
    assert_eq!((&busy["robot"], &busy["error"]), (&Value::Null, &json!("busy")));
    assert!(busy["time_ms"].as_u64() >= robot["time_ms"].as_u64());
    let newest = shown.json("/api/queries?limit=2").await;
    assert_eq!(newest["queries"][0], busy, "newest first");
    assert!(get(shown.address(), "/api/queries?limit=many").await.starts_with(b"HTTP/1.1 400"));
    token.undeclare().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_queries_displaces_neither_memory_nor_the_queries_of_others() {
    let shown = Shown::start().await;
    shown.viewer.note_query("quiet", answered(&[7], vec![]));
    for _ in 0..5 * MAX_QUERIES {
        let candidates = (0..1000).map(|id| candidate(id, 20, CandidateVerdict::Verified)).collect();
        shown.viewer.note_query("loud", answered(&(0..1000).collect::<Vec<_>>(), candidates));
        shown.viewer.note_query("loud", failed(ErrorCode::Internal, &"long ".repeat(10_000)));
    }
    let all = shown.body("/api/queries?limit=99999999").await;
    assert!(all.len() < MAX_QUERIES * 8 * 1024, "{}", all.len());
    let all: Value = serde_json::from_slice(&all).unwrap();
    let queries = all["queries"].as_array().unwrap();
    assert_eq!(queries.len(), MAX_QUERIES);
    assert!(queries.iter().any(|query| query["client"] == "quiet"));
    for _ in 0..5 * MAX_QUERIES {
        shown.viewer.note_query(&"x".repeat(10_000), answered(&[], vec![]));
    }
    let names = shown.json("/api/queries?limit=512").await;
    let longest =
        names["queries"].as_array().unwrap().iter().map(|query| query["client"].as_str().unwrap().len());
    assert!(longest.max().unwrap() <= 256);
}

/// The samples of a robot in the history, once it has so many.
async fn samples(shown: &Shown, path: &str, at_least: usize) -> Vec<Value> {
    let found = async {
        loop {
            let history = shown.json(path).await;
            let samples = history["robots"][0]["samples"].as_array().cloned().unwrap_or_default();
            if samples.len() >= at_least {
                return samples;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(20), found).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_history_has_a_pose_a_second_and_each_change_of_state() {
    let shown = Shown::start().await;
    let id = shown.session.zid().to_string();
    let token = shown.session.liveliness().declare_token(format!("robot/r7/session/{id}")).await.unwrap();
    assert_eq!(shown.json("/api/history").await["since_ms"], Value::Null);
    let started = std::time::Instant::now();
    let mut published = Vec::new();
    // A hundred poses a second.
    while started.elapsed() < Duration::from_millis(3300) {
        let state = if started.elapsed() < Duration::from_millis(1600) {
            RobotState::Lost
        } else {
            RobotState::Localized
        };
        published.push(shown.publish_robot("r7", 10.0 + started.elapsed().as_secs_f64(), state).await);
        if published.len() % 50 == 0 {
            shown.viewer.note_query(&id, answered(&[], vec![]));
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let all = samples(&shown, "/api/history?map=place", 3).await;
    assert!((3..=5).contains(&all.len()), "{} of {}", all.len(), published.len());
    for sample in &all {
        let position: [f64; 3] = serde_json::from_value(sample["pose"]["position"].clone()).unwrap();
        let is_it = |one: &nalgebra::Vector3<f64>| (one - nalgebra::Vector3::from(position)).norm() < 1e-9;
        assert!(published.iter().any(is_it), "{sample}");
        let variance_m2 = sample["pose"]["position_covariance"][5].as_f64().unwrap();
        assert!((variance_m2 - 0.0225).abs() < 1e-6, "{sample}");
    }
    assert!(all.iter().map(|sample| sample["unmatched"].as_u64().unwrap()).sum::<u64>() > 0);
    let history = shown.json("/api/history").await;
    let changes = history["robots"][0]["changes"].as_array().unwrap();
    let states: Vec<_> = changes.iter().map(|change| change["state"].as_str().unwrap()).collect();
    assert_eq!(states, ["lost", "localized"]);
    assert_eq!(changes[0]["reason"], "velocity sigma 1.2 m/s exceeds 1.0: was tracking lost?");

    let second = all[1]["t_ms"].as_u64().unwrap();
    let part = samples(&shown, &format!("/api/history?from={second}&to={second}"), 1).await;
    assert_eq!(part, all[1..2]);
    let elsewhere = samples(&shown, "/api/history?map=cellar", 1).await;
    assert!(elsewhere.iter().all(|sample| sample["pose"].is_null()));
    assert!(get(shown.address(), "/api/history?from=-1").await.starts_with(b"HTTP/1.1 400"));
    token.undeclare().await.unwrap();
}

/// Statuses that differ each time, of robots with the longest names and reasons, in maps that nobody serves.
#[tokio::test(flavor = "multi_thread")]
async fn the_history_is_bounded_whatever_robots_publish() {
    let shown = Shown::start().await;
    let started = std::time::Instant::now();
    let mut sent = 0_u64;
    while started.elapsed() < Duration::from_millis(2500) {
        let robot = format!("{:0>64}", sent % 2000);
        let status = RobotStatus {
            stamp_ns: sent as i64,
            state: if sent.is_multiple_of(2) { RobotState::Lost } else { RobotState::Localized },
            reason: "r".repeat(4096),
            map: Some(format!("map{sent}")),
            last_map_update_ns: Some(i64::MIN),
            keyframes_held: u32::MAX,
            queries_sent: u64::MAX,
            queries_answered: u64::MAX,
        };
        shown.publish(keys::robot_status(&robot).unwrap(), &status).await;
        sent += 1;
    }
    shown.publish_robot("r7", 12.0, RobotState::Localized).await;
    tokio::time::sleep(Duration::from_millis(1500)).await;
    let history = shown.body("/api/history").await;
    assert!(sent > 100 && history.len() < 4 << 20, "{sent} messages, {} bytes", history.len());
    let maps = shown.json("/api/maps").await;
    assert_eq!(maps["maps"].as_array().unwrap().len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn statistics_of_an_hour_are_kept() {
    let shown = Shown::start().await;
    assert_eq!(shown.json("/api/statistics").await["samples"], json!([]));
    for at in 0..2000 {
        shown
            .viewer
            .note_statistics(ServerSample { answered_per_s: f64::from(at), ..ServerSample::default() });
    }
    let kept = shown.json("/api/statistics").await;
    let samples = kept["samples"].as_array().unwrap();
    assert_eq!((samples.len(), &kept["period_s"]), (720, &json!(5.0)));
    assert_eq!((&samples[719]["answered_per_s"], &samples[719]["p99_ms"]), (&json!(1999.0), &Value::Null));
}
