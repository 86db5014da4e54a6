//! The page in a browser. Skipped, with a line that says so, where no Chromium is installed. Pictures are written to
//! `target/viewer`.

use crate::browser::{Browser, installed};
use crate::common::{Shown, answered, candidate};
use crate::fleet::check_layout;
use geometry::uncertain_pose::isotropic_covariance;
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{UnitQuaternion, Vector3};
use protocol::{KeyframeId, RobotState};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use viewer::{CandidateVerdict, RunTracks, ServerSample, TrackPoint};

pub fn picture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/viewer").join(name)
}

/// A browser; without one, says that the test is skipped, also where the output of tests is not shown.
pub fn browser_or_reason() -> Option<PathBuf> {
    let program = installed();
    if program.is_none() {
        let _ = writeln!(std::io::stderr(), "skipped: no Chromium is installed (apt-get install chromium)");
    }
    program
}

/// Nothing in the console, and nothing asked of another host.
pub fn check_well_behaved(browser: &Browser, address: std::net::SocketAddr) {
    assert!(browser.complaints.is_empty(), "{:?}", browser.complaints);
    let own =
        [format!("http://{address}/"), format!("ws://{address}/"), "data:".to_owned(), "about:".to_owned()];
    let foreign: Vec<_> =
        browser.requests.iter().filter(|request| !own.iter().any(|own| request.starts_with(own))).collect();
    assert!(foreign.is_empty() && browser.requests.len() > 10, "{foreign:?}");
}

/// Clicks what a selector finds.
async fn click(browser: &mut Browser, selector: &str) {
    browser.wait_for(&format!("Boolean(document.querySelector(`{selector}`))")).await;
    browser.evaluate(&format!("document.querySelector(`{selector}`).click()")).await;
}

/// The text of what a selector finds.
async fn text(browser: &mut Browser, selector: &str) -> String {
    let found = browser.evaluate(&format!("document.querySelector(`{selector}`).innerText")).await;
    found.as_str().unwrap_or_default().to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_shows_the_map_and_follows_robots() {
    let Some(program) = browser_or_reason() else { return };
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
        shown.publish_robot("r9", 8.0, RobotState::Lost).await;
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
    let keyframes: Vec<_> = shown.place.map.keyframes[10..16].iter().map(|keyframe| keyframe.id).collect();
    shown.viewer.note_query(&id, answered(&keyframes, vec![]));
    browser.wait_for("window.driftless.robots.r7.answers === 1").await;
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    browser.save_picture(&picture("dark.png")).await;

    browser.press("d").await;
    browser.press("t").await;
    tokio::time::sleep(std::time::Duration::from_millis(500)).await;
    browser.save_picture(&picture("light_top.png")).await;
    assert_eq!(browser.evaluate("document.documentElement.dataset.theme").await, "light");

    check_well_behaved(&browser, address);
    token.undeclare().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_inspector_says_why_a_query_was_refused() {
    let Some(program) = browser_or_reason() else { return };
    let shown = Shown::start().await;
    let address = shown.address();
    let id = shown.session.zid().to_string();
    let token = shown.session.liveliness().declare_token(format!("robot/r7/session/{id}")).await.unwrap();
    shown.publish_robot("r7", 12.0, RobotState::Localized).await;
    // A tablet.
    let mut browser = Browser::start(&program, 1024, 768).await;
    browser.prefer("dark").await;
    browser.open(&format!("http://{address}/#robot=r7")).await;
    browser.wait_for("window.driftless?.isConnected && Boolean(window.driftless.robots.r7)").await;

    let ids: Vec<KeyframeId> = shown.place.map.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let refused = |at: usize| {
        let verdict = [CandidateVerdict::NoPose, CandidateVerdict::TooFewMatches][at % 2];
        candidate(ids[at], at as u32, verdict)
    };
    shown.viewer.note_query("a stranger", answered(&[], vec![]));
    shown.viewer.note_query(&id, answered(&[], (3..9).map(refused).collect()));
    let used = |at: usize| candidate(ids[at], 40 + at as u32, CandidateVerdict::InAnswer);
    shown.viewer.note_query(&id, answered(&ids[10..13], (10..13).map(used).chain([refused(20)]).collect()));

    browser.press("q").await;
    browser.wait_for("document.querySelectorAll('.query').length === 2").await;
    assert_eq!(text(&mut browser, "#query-outcome").await, "● Recognized.");
    assert_eq!(browser.evaluate("window.driftless.query.drawn").await, 4);
    browser.save_picture(&picture("query.png")).await;

    // The older one, pinned while newer ones come in.
    click(&mut browser, "#query-list li:nth-child(2) .query").await;
    shown.viewer.note_query(&id, answered(&ids[10..11], vec![used(10)]));
    browser.wait_for("document.querySelectorAll('.query').length === 3").await;
    let outcome = text(&mut browser, "#query-outcome").await;
    assert!(outcome.contains("no pose explains the matches"), "{outcome}");
    let table = text(&mut browser, "#candidates tbody").await;
    for reason in ["refused: no pose fits", "refused: too few matches"] {
        assert_eq!(table.matches(reason).count(), 3, "{table}");
    }
    assert!(table.contains(&ids[8].to_string()) && table.contains("80"), "{table}");
    browser.save_picture(&picture("query_refused.png")).await;
    browser.press("d").await;
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    browser.save_picture(&picture("query_light.png")).await;

    let everybody = "(() => { const select = document.getElementById('query-robot'); select.value = ''; \
                     select.dispatchEvent(new Event('change')); return true; })()";
    browser.evaluate(everybody).await;
    browser.wait_for("document.querySelectorAll('.query').length === 4").await;
    check_well_behaved(&browser, address);
    token.undeclare().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_slider_goes_back_and_the_button_returns() {
    let Some(program) = browser_or_reason() else { return };
    let shown = Shown::start().await;
    let address = shown.address();
    let mut browser = Browser::start(&program, 1280, 800).await;
    browser.prefer("light").await;
    browser.open(&format!("http://{address}/")).await;
    browser.wait_for("window.driftless?.isConnected").await;
    let is_at = |position: Vector3<f64>| {
        let [x, y, z] = position.into();
        format!(
            "(() => {{ const p = window.driftless.robots.r7?.position; \
             return Boolean(p) && Math.hypot(p[0] - {x}, p[1] - {y}, p[2] - {z}) < 1e-6; }})()"
        )
    };
    // Each for longer than the history needs to see it.
    let mut first = Vector3::zeros();
    for step in 0..3 {
        let state = [RobotState::Lost, RobotState::OdometryOnly, RobotState::Localized][step];
        let x_m = 10.0 + 2.0 * step as f64;
        for _ in 0..12 {
            let position = shown.publish_robot("r7", x_m, state).await;
            if step == 0 {
                first = position;
            }
            tokio::time::sleep(std::time::Duration::from_millis(100)).await;
        }
    }
    let now = shown.publish_robot("r7", 20.0, RobotState::Localized).await;
    browser.wait_for(&is_at(now)).await;
    assert_eq!(browser.evaluate("window.driftless.time.isLive").await, true);

    let back = "(() => { const slider = document.getElementById('time'); slider.value = 0; \
                slider.dispatchEvent(new Event('input')); slider.dispatchEvent(new Event('change')); return true; })()";
    browser.evaluate(back).await;
    browser.wait_for("window.driftless.time.isLive === false").await;
    browser.wait_for(&is_at(first)).await;
    browser.wait_for("document.querySelector('.robot .state').textContent.includes('lost')").await;
    // What is published meanwhile is not shown.
    let later = shown.publish_robot("r7", 24.0, RobotState::Localized).await;
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    assert_eq!(browser.evaluate(&is_at(first)).await, true);
    browser.save_picture(&picture("past.png")).await;

    browser.press("l").await;
    browser.wait_for("window.driftless.time.isLive === true").await;
    browser.wait_for(&is_at(later)).await;
    assert_eq!(browser.evaluate("location.hash.includes('t=')").await, false);

    // A link to a time.
    let t_ms = shown.json("/api/history").await["since_ms"].as_u64().unwrap();
    browser.open("about:blank").await;
    browser.open(&format!("http://{address}/#robot=r7&t={}", t_ms as f64 * 1e-3)).await;
    browser.wait_for("window.driftless?.time.isLive === false").await;
    browser.wait_for(&is_at(first)).await;
    assert_eq!(text(&mut browser, ".is-followed .name").await, "r7");
    // Played to its end.
    browser.press(" ").await;
    browser.wait_for("window.driftless.robots.r7.state === 'localized'").await;
    click(&mut browser, "#live").await;
    browser.wait_for(&is_at(later)).await;
    check_well_behaved(&browser, address);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_draws_how_busy_the_server_is() {
    let Some(program) = browser_or_reason() else { return };
    let shown = Shown::start().await;
    for at in 0..30 {
        let load = (f64::from(at) / 5.0).sin().abs();
        let figures = ServerSample {
            answered_per_s: 40.0 * load,
            failed_per_s: 0.2,
            refused_per_s: (30.0 * (load - 0.8)).max(0.0),
            waiting: (8.0 * load) as u64,
            p50_ms: Some(12.0 + 10.0 * load),
            p99_ms: Some(20.0 + 100.0 * load),
        };
        shown.viewer.note_statistics(figures);
    }
    let mut browser = Browser::start(&program, 1024, 768).await;
    browser.prefer("light").await;
    browser.open(&format!("http://{}/#tab=server", shown.address())).await;
    browser.wait_for("document.getElementById('server-chart')?.hidden === false").await;
    let figures = text(&mut browser, "#server-figures").await;
    assert!(figures.contains("queries/s, median 1") && figures.contains("waiting"), "{figures}");
    let is_drawn = "(() => { const c = document.getElementById('server-chart'); \
                    return c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some((v) => v > 0); })()";
    assert_eq!(browser.evaluate(is_drawn).await, true);
    browser.save_picture(&picture("server.png")).await;
    check_well_behaved(&browser, shown.address());
}

/// A drive along the path whose bounds shrink whenever the map is used.
fn drive() -> RunTracks {
    let place = testing::Place::new(&testing::PlaceOptions::default());
    let forward = place.camera_at(1.0, 0.0, 0.0).translation - place.camera_at(0.0, 0.0, 0.0).translation;
    let at = |t: f64, error: Vector3<f64>, sigma_m: f64| {
        let pose = Pose::new(UnitQuaternion::identity(), place.path[0].translation + forward * t + error);
        (PoseWithCovariance::new(pose, isotropic_covariance(0.01, sigma_m)), error.into())
    };
    let times = || (0..500).map(|step| f64::from(step) * 0.1);
    let drift = |t: f64| Vector3::new(0.01 * t, 0.02 * (t / 3.0).sin(), 0.0) + place.gravity * 0.004 * t;
    let estimate = |t: f64| at(t, drift(t % 7.0) * 3.0, 0.05 + 0.01 * (t % 7.0));
    let point =
        |t: f64, (pose, error): (PoseWithCovariance, [f64; 3])| TrackPoint::new(t, &pose, Some(error));
    RunTracks {
        name: "drive".to_owned(),
        global: times().map(|t| point(t, estimate(t))).collect(),
        local: times().map(|t| TrackPoint::new(t, &at(t, drift(t) * 4.0, 0.1 + 0.01 * t).0, None)).collect(),
        global_from_local: vec![TrackPoint::new(0.0, &PoseWithCovariance::exact(Pose::identity()), None)],
        truth: times().map(|t| TrackPoint::new(t, &at(t, Vector3::zeros(), 0.0).0, None)).collect(),
        queries: (0..50).map(|query| (f64::from(query), query % 7 == 0)).collect(),
        up: (-place.gravity).into(),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_shows_a_run_at_any_time_of_it() {
    let Some(program) = browser_or_reason() else { return };
    let run = drive();
    let [x, y, z] = run.global[100].position;
    let shown = Shown::start_with(Some(run)).await;
    // A tablet.
    let mut browser = Browser::start(&program, 1024, 768).await;
    browser.prefer("light").await;
    browser.open(&format!("http://{}/", shown.address())).await;
    browser.wait_for("window.driftless?.isReady").await;
    let seek = "(() => { const slider = document.getElementById('time'); slider.value = 201; \
                slider.dispatchEvent(new Event('input')); return document.getElementById('clock').value; })()";
    assert_eq!(browser.evaluate(seek).await, "10.0 of 49.9 s");
    let shown_at = browser.evaluate("window.driftless.robots.drive.position").await;
    let shown_at: [f64; 3] = serde_json::from_value(shown_at).unwrap();
    assert!((Vector3::from(shown_at) - Vector3::new(x, y, z)).norm() < 1e-9);
    tokio::time::sleep(std::time::Duration::from_millis(500)).await;
    browser.save_picture(&picture("run.png")).await;
    browser.press(" ").await;
    browser.wait_for("Number(document.getElementById('time').value) > 201").await;
    for (width, height) in [(820, 1180), (390, 844)] {
        browser.resize(width, height).await;
        check_layout(&mut browser, &format!("{width}x{height}")).await;
        browser.save_picture(&picture(&format!("run_{width}.png"))).await;
    }
    assert!(browser.complaints.is_empty(), "{:?}", browser.complaints);
}
