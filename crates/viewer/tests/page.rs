//! The page in a browser. Skipped, with a line that says so, where no Chromium is installed. Pictures are written to
//! `target/viewer`.
#![allow(clippy::unwrap_used)]

#[path = "common/browser.rs"]
mod browser;
mod common;

use browser::{Browser, installed};
use common::Shown;
use protocol::RobotState;
use std::path::{Path, PathBuf};
use viewer::Answer;

fn picture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/viewer").join(name)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_shows_the_map_and_follows_robots() {
    let Some(program) = installed() else {
        eprintln!("skipped: no Chromium is installed (apt-get install chromium)");
        return;
    };
    let shown = Shown::start().await;
    let address = shown.address();
    let mut browser = Browser::start(&program, 1280, 800).await;
    browser.prefer("dark").await;
    browser.open(&format!("http://{address}/#robot=r7")).await;
    browser.wait_for("window.driftless?.isReady && window.driftless.isConnected").await;
    let counts = browser.evaluate("window.driftless.counts").await;
    assert_eq!(counts["keyframes"], shown.place.map.keyframes.len());
    assert_eq!(counts["landmarks"], shown.place.map.landmarks.len());

    let id = shown.session.zid().to_string();
    let token = shown.session.liveliness().declare_token(format!("robot/r7/session/{id}")).await.unwrap();
    shown.publish_robot("r2", 40.0, RobotState::OdometryOnly).await;
    shown.publish_robot("r9", 8.0, RobotState::Lost).await;
    for step in 0..60 {
        let position = shown.publish_robot("r7", 10.0 + 0.25 * f64::from(step), RobotState::Localized).await;
        shown.publish_robot("r2", 40.0 - 0.1 * f64::from(step), RobotState::OdometryOnly).await;
        if step % 20 == 19 {
            let [x, y, z] = position.into();
            let distance = format!(
                "(() => {{ const p = window.driftless.robots.r7?.position; \
                 return Boolean(p) && Math.hypot(p[0] - {x}, p[1] - {y}, p[2] - {z}) < 1e-6; }})()"
            );
            browser.wait_for(&distance).await;
        }
        tokio::time::sleep(std::time::Duration::from_millis(50)).await;
    }
    let state = browser.evaluate("window.driftless.robots.r7.state").await;
    assert_eq!(state, "localized");
    assert!(
        browser.evaluate("window.driftless.robots.r7.trail").await.as_u64().unwrap() > 10,
        "it left a trail"
    );
    assert_eq!(browser.evaluate("document.querySelector('.is-followed .name').textContent").await, "r7");

    browser.press("r").await;
    browser.press("1").await;
    browser.press("f").await;
    let keyframes = shown.place.map.keyframes[10..16].iter().map(|keyframe| keyframe.id).collect();
    shown.viewer.note_answer(&id, Answer { map: "place".into(), keyframes });
    browser.wait_for("window.driftless.robots.r7.answers === 1").await;
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    browser.save_picture(&picture("dark.png")).await;

    browser.press("d").await;
    browser.press("t").await;
    tokio::time::sleep(std::time::Duration::from_millis(500)).await;
    browser.save_picture(&picture("light_top.png")).await;
    assert_eq!(browser.evaluate("document.documentElement.dataset.theme").await, "light");

    assert!(browser.complaints.is_empty(), "{:?}", browser.complaints);
    let own =
        [format!("http://{address}/"), format!("ws://{address}/"), "data:".to_owned(), "about:".to_owned()];
    let foreign: Vec<_> =
        browser.requests.iter().filter(|request| !own.iter().any(|own| request.starts_with(own))).collect();
    assert!(foreign.is_empty() && browser.requests.len() > 10, "{foreign:?}");
    token.undeclare().await.unwrap();
}
