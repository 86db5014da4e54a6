//! A fleet of 200 on the page: what it says of robots that are lost, silent or dead, and when; and how it looks on small screens.

use crate::browser::Browser;
use crate::common::Shown;
use crate::page::{browser_or_reason, check_well_behaved, picture};
use protocol::RobotState;
use std::io::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};
use testing::{Place, PlaceOptions};
use viewer::{ViewedMap, Viewer, ViewerServer};
use zenoh::liveliness::LivelinessToken;

const ROBOTS: usize = 200;
/// How soon the page must be right, on a machine that does nothing else.
const BOUND: Duration = Duration::from_secs(3);
/// In which a localized robot is written in the dark.
const GREEN: [u8; 3] = [0x2f, 0xbf, 0x94];
/// A desk, a tablet, a phone.
const SIZES: [(u32, u32); 3] = [(1280, 800), (820, 1180), (390, 844)];

fn name(robot: usize) -> String {
    format!("r{robot}")
}

/// Robots 1 to 170 are localized, the others have odometry only.
fn usual(robot: usize) -> RobotState {
    if robot <= 170 { RobotState::Localized } else { RobotState::OdometryOnly }
}

/// Publishes everything of all robots, each with its token.
async fn start_fleet(shown: &Shown) -> Vec<Option<LivelinessToken>> {
    let mut tokens = Vec::new();
    for robot in 1..=ROBOTS {
        let key = format!("robot/{}", name(robot));
        tokens.push(Some(shown.session.liveliness().declare_token(key).await.unwrap()));
        shown.publish_robot(&name(robot), 0.25 * robot as f64, usual(robot)).await;
    }
    tokens
}

/// The statuses of all robots but some, once.
async fn go_on(shown: &Shown, state: impl Fn(usize) -> Option<RobotState>) {
    for robot in 1..=ROBOTS {
        if let Some(state) = state(robot) {
            shown.publish_status(&name(robot), 1, state).await;
        }
    }
}

/// Waits until the counts of states are these.
async fn wait_for_counts(browser: &mut Browser, counts: &str) {
    let shown = "[...document.querySelectorAll('#counts li')].map((item) => item.textContent).join(', ')";
    browser.wait_for(&format!("{shown} === '{counts}'")).await;
}

/// Does something while robots go on publishing their statuses once a second.
async fn meanwhile<T>(
    shown: &Shown,
    state: impl Fn(usize) -> Option<RobotState>,
    doing: impl Future<Output = T>,
) -> T {
    let publishing = async {
        loop {
            go_on(shown, &state).await;
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    };
    tokio::select! {
        done = doing => done,
        () = publishing => unreachable!(),
    }
}

/// The colour in which a robot's state is written.
async fn color_of(browser: &mut Browser, robot: &str) -> String {
    let script = format!(
        "getComputedStyle([...document.querySelectorAll('.robot')].find((entry) => \
         entry.querySelector('.name').textContent === '{robot}').querySelector('.state')).color"
    );
    browser.evaluate(&script).await.as_str().unwrap().to_owned()
}

/// Pictures at all sizes, dark and light.
async fn check_screens(browser: &mut Browser) {
    for (scheme, color) in [("dark", GREEN), ("light", [0x00, 0x7a, 0x58])] {
        for (width, height) in SIZES {
            browser.resize(width, height).await;
            check_layout(browser, &format!("{width}x{height}")).await;
            let name = format!("fleet_{scheme}_{width}.png");
            // On a machine that is busy, statuses are late at times, and robots silent.
            let mut green = 0;
            for _ in 0..20 {
                green = pixels_of(&browser.save_picture(&picture(&name)).await, color);
                if green > 30 {
                    break;
                }
                tokio::time::sleep(Duration::from_millis(500)).await;
            }
            assert!(green > 30, "{name}: {green}");
        }
        browser.press("d").await;
    }
}

/// Pixels of the colour in which a state is written.
fn pixels_of(picture: &[u8], color: [u8; 3]) -> usize {
    let image = image::load_from_memory(picture).unwrap().to_rgb8();
    image.pixels().filter(|pixel| pixel.0.iter().zip(color).all(|(a, b)| a.abs_diff(b) < 12)).count()
}

/// Panels lie within the page and on no other, and *Fit* takes what they leave, which is enough.
pub async fn check_layout(browser: &mut Browser, screen: &str) {
    let script = "(() => { document.querySelector('[data-action=fit]').click(); \
        const ids = ['about', 'tools', 'side', 'legend', 'replay']; \
        const boxes = ids.map((id) => [id, document.getElementById(id).getBoundingClientRect()]).filter(([, b]) => b.width > 0); \
        const faults = []; \
        for (const [id, b] of boxes) { \
          if (b.left < 0 || b.top < 0 || b.right > innerWidth || b.bottom > innerHeight) faults.push(`${id} leaves the page`); \
          for (const [other, o] of boxes) { \
            if (id < other && b.left < o.right && o.left < b.right && b.top < o.bottom && o.top < b.bottom) faults.push(`${id} on ${other}`); \
          } \
        } \
        const { left, right, top, bottom } = window.driftless.free(); \
        if ((right - left) < 0.4 * innerWidth || (bottom - top) < 0.14 * innerHeight) faults.push(`only ${right - left} x ${bottom - top} are free`); \
        for (const [id, b] of boxes) { \
          if (left < b.right - 1 && b.left < right - 1 && top < b.bottom - 1 && b.top < bottom - 1) faults.push(`${id} is fitted into`); \
        } \
        return faults.join(', '); })()";
    let faults = browser.evaluate(script).await;
    assert_eq!(faults, "", "{screen}");
}

/// Words are told from what is behind them: 4.5 to 1, as WCAG 2 asks for.
async fn check_contrast(browser: &mut Browser) {
    let script = "(() => { \
        const context = document.createElement('canvas').getContext('2d', { willReadFrequently: true }); \
        const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name); \
        const luminance = (...names) => { \
          for (const name of names) { context.fillStyle = style(name); context.fillRect(0, 0, 1, 1); } \
          const [r, g, b] = [...context.getImageData(0, 0, 1, 1).data].map((v) => (v <= 10 ? v / 3294.6 : ((v / 255 + 0.055) / 1.055) ** 2.4)); \
          return 0.2126 * r + 0.7152 * g + 0.0722 * b; }; \
        const card = luminance('--background', '--card'); \
        return ['--text', '--faint', '--localized', '--odometry-only', '--lost', '--accent', '--moved', '--added', '--removed'].filter((name) => { \
          const word = luminance(name); \
          return (Math.max(word, card) + 0.05) / (Math.min(word, card) + 0.05) < 4.5; }).join(); })()";
    assert_eq!(browser.evaluate(script).await, "");
}

/// The states themselves; `a_stored_map_has_no_present_and_names_decide_colours_and_keys` has the ages at which they change.
#[tokio::test(flavor = "multi_thread")]
async fn lost_silent_and_dead_robots_of_200_are_told() {
    let Some(program) = browser_or_reason() else { return };
    let delays = tell_fleet(&program).await;
    let _ = writeln!(std::io::stderr(), "the page is right after {delays:.1?}");
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "measures times: needs a machine that does nothing else"]
async fn lost_silent_and_dead_robots_of_200_are_told_within_three_seconds() {
    let Some(program) = browser_or_reason() else { return };
    let delays = tell_fleet(&program).await;
    assert!(delays.iter().all(|delay| *delay <= BOUND), "{delays:?}");
}

/// Robots that are lost, silent, killed and off on the page, then a server that is gone; returns how long the page took to tell
/// of either.
async fn tell_fleet(program: &Path) -> [Duration; 2] {
    let shown = Shown::start().await;
    let address = shown.address();
    let mut browser = Browser::start(program, 390, 844).await;
    browser.prefer("dark").await;
    browser.open(&format!("http://{address}/")).await;
    browser.wait_for("window.driftless?.isConnected").await;
    let mut tokens = start_fleet(&shown).await;
    let well = wait_for_counts(&mut browser, "● 170 localized, ◐ 30 odometry only");
    meanwhile(&shown, |robot| Some(usual(robot)), well).await;

    // Ten are lost, ten fall silent with their tokens there, five are killed, five shut down in order.
    let later = |robot: usize| match robot {
        1..=10 => Some(RobotState::Lost),
        11..=30 => None,
        _ => Some(usual(robot)),
    };
    go_on(&shown, |robot| Some(usual(robot))).await;
    let since = Instant::now();
    for robot in 21..=30 {
        if robot > 25 {
            shown.publish_status(&name(robot), 2, RobotState::Off).await;
        }
        tokens[robot - 1].take().unwrap().undeclare().await.unwrap();
    }
    let counts = "● 140 localized, ◐ 30 odometry only, ✕ 10 lost, △ 15 silent, ○ 5 off";
    meanwhile(&shown, later, wait_for_counts(&mut browser, counts)).await;
    let of_robots = since.elapsed();

    let told = browser.accessible().await;
    assert!(told.len() > 100, "{told:?}");
    let has = |role: &str, name: &str| told.iter().any(|(r, n)| r == role && n.starts_with(name));
    assert!(has("list", "Robots by state") && has("list", "Alarms"), "{told:?}");
    assert!(has("button", "✕ r1 lost: velocity sigma"), "{told:?}");
    assert!(has("tab", "Robots") && has("slider", "Time") && has("image", "The map"), "{told:?}");
    let unnamed: Vec<_> = told.iter().filter(|(role, name)| role == "button" && name.is_empty()).collect();
    assert!(unnamed.is_empty(), "{unnamed:?}");
    // A killed robot is an alarm, and amber; one that was shut down is neither.
    assert!(has("button", "△ r21 silent, disconnected for"), "{told:?}");
    let is_off = |name: &str| name.starts_with("r26") && name.contains("○ off, heard");
    let buttons: Vec<_> = told.iter().filter(|(role, _)| role == "button").map(|(_, name)| name).collect();
    assert!(buttons.iter().any(|name| is_off(name)), "{buttons:?}");
    assert!(!buttons.iter().any(|name| name.starts_with("○")), "{buttons:?}");
    assert_ne!(color_of(&mut browser, "r21").await, color_of(&mut browser, "r26").await);
    assert_eq!(color_of(&mut browser, "r21").await, color_of(&mut browser, "r11").await);
    // Those that are off are at the end, in the order of their names.
    let last =
        "[...document.querySelectorAll('.robot .name')].slice(-5).map((name) => name.textContent).join()";
    assert_eq!(browser.evaluate(last).await, "r26,r27,r28,r29,r30");

    meanwhile(&shown, later, check_screens(&mut browser)).await;

    // Nothing is well where the server says nothing.
    let since = Instant::now();
    shown.server.stop().await;
    wait_for_counts(&mut browser, "? 200 not known").await;
    let of_server = since.elapsed();
    let told = browser.accessible().await;
    assert!(told.iter().any(|(role, _)| role == "alert"), "{told:?}");
    let after = pixels_of(&browser.save_picture(&picture("fleet_offline.png")).await, GREEN);
    assert_eq!(after, 0);
    browser.complaints.retain(|complaint| !complaint.contains("ERR_CONNECTION_REFUSED"));
    check_well_behaved(&browser, address);
    [of_robots, of_server]
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes more than a minute"]
async fn the_page_does_not_grow_in_a_minute_of_200_robots() {
    let Some(program) = browser_or_reason() else { return };
    let shown = Shown::start().await;
    let mut browser = Browser::start(&program, 1280, 800).await;
    browser.open(&format!("http://{}/", shown.address())).await;
    browser.wait_for("window.driftless?.isConnected").await;
    let _tokens = start_fleet(&shown).await;
    let mut heaps = Vec::new();
    let started = Instant::now();
    for step in 0.. {
        for robot in 1..=ROBOTS {
            // To and fro.
            let x_m = 0.25 * robot as f64 + f64::from(step % 20);
            shown.publish_robot(&name(robot), x_m, usual(robot)).await;
        }
        if started.elapsed() > Duration::from_secs(10 + 15 * heaps.len() as u64) {
            heaps.push(browser.heap().await);
        }
        if heaps.len() == 5 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
    let _ = writeln!(
        std::io::stderr(),
        "after 10, 25, 40, 55, 70 s, MB of objects and arrays: {:.1?}",
        heaps.iter().map(|(a, b)| (a * 1e-6, b * 1e-6)).collect::<Vec<_>>()
    );
    let grown = heaps[4].0 - heaps[0].0;
    assert!(grown < 1e6, "{grown} bytes");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stored_map_has_no_present_and_names_decide_colours_and_keys() {
    let Some(program) = browser_or_reason() else { return };
    let viewer = Viewer::of_stored_maps();
    viewer.set_map(ViewedMap::of_contents("place", &Place::new(&PlaceOptions::default()).map));
    let server = ViewerServer::start(([127, 0, 0, 1], 0).into(), viewer).await.unwrap();
    let mut browser = Browser::start(&program, 820, 1180).await;
    browser.open(&format!("http://{}/", server.address())).await;
    browser.wait_for("window.driftless?.isReady").await;
    let told = browser.accessible().await;
    let has = |role: &str, name: &str| told.iter().any(|(r, n)| r == role && n.starts_with(name));
    assert!(has("button", "Fit") && !has("button", "Live") && !has("tab", "Robots"), "{told:?}");
    check_layout(&mut browser, "a stored map").await;
    browser.save_picture(&picture("stored.png")).await;

    for _ in ["light", "dark"] {
        check_contrast(&mut browser).await;
        browser.press("d").await;
    }

    // In whatever order they come.
    let keys = "import('./names.js').then(({ keysOf }) => [['r7', 'amr-12', 'x', 'b-7'], ['b-7', 'x', 'r7', 'amr-12']].map( \
                (names) => JSON.stringify([...keysOf(names)].sort())).join(' '))";
    let same = r#"[["amr-12",1],["b-7",7],["r7",2],["x",3]]"#;
    assert_eq!(browser.evaluate(keys).await, format!("{same} {same}"));
    let colors = "import('./names.js').then(({ colorNumber }) => [colorNumber('r7'), colorNumber('amr-07'), colorNumber('x')].join())";
    assert_eq!(browser.evaluate(colors).await, "7,7,120");
    let states = "import('./presence.js').then(({ stateOf, stateText }) => [0, 2.4, 2.6, 12, 2520, 9000].map((s) => { \
                  const robot = { heard_age_s: 0, status: { state: 'localized', age_s: 0 } }; \
                  return stateText(stateOf(robot, s, true), robot, s); }).join(', '))";
    assert_eq!(
        browser.evaluate(states).await,
        "● localized, ● localized, △ silent for 2 s, △ silent for 12 s, ▽ unreachable for 42 min, ▽ unreachable for 2 h 30 min"
    );
    // Killed, and shut down in order.
    let ended = "import('./presence.js').then(({ stateOf, stateText, alarmOf }) => [false, true].flatMap((is_off) => [1, 59, 61].map((s) => { \
                 const robot = { heard_age_s: 0, has_ended: true, is_off, status: { state: is_off ? 'off' : 'localized', age_s: 0 } }; \
                 const state = stateOf(robot, s, true); \
                 return `${stateText(state, robot, s)}${alarmOf(state, robot, s) ? '!' : ''}`; })).join('; '))";
    assert_eq!(
        browser.evaluate(ended).await,
        "△ silent, disconnected for 1 s!; △ silent, disconnected for 59 s!; ▽ unreachable, disconnected for 1 min!; \
         ○ off, heard 1 s ago; ○ off, heard 59 s ago; ○ off, heard 1 min ago"
    );
    // A status that is old, beside odometry that is not.
    let stuck = "import('./presence.js').then(({ stateOf, stateText }) => { \
                 const robot = { heard_age_s: 0.1, status: { state: 'localized', age_s: 9 } }; \
                 return stateText(stateOf(robot, 0, true), robot, 0); })";
    assert_eq!(browser.evaluate(stuck).await, "△ silent, no status for 9 s");
    // In the past: the last sample, unless the state changed since.
    let past = "import('./history.js').then(({ stateAt }) => { \
                const point = { t: 5, state: 'localized' }; \
                const changes = [null, { t: 5, state: 'lost' }, { t: 6, state: 'silent' }]; \
                return [...changes.map((change) => stateAt(point, change)), ...changes.map((change) => stateAt(null, change))].join(); })";
    assert_eq!(browser.evaluate(past).await, "localized,localized,silent,nothing,lost,silent");
    check_well_behaved(&browser, server.address());
    server.stop().await;
}
