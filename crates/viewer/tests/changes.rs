//! What changed since the release before, and in a candidate, on the page.

use crate::browser::Browser;
use crate::common::Shown;
use crate::fleet::check_layout;
use crate::page::{browser_or_reason, check_well_behaved, picture};
use map::MapContents;
use map::difference::{Compared, KeyframeDifference};
use viewer::{ViewedChange, ViewedChanges};

/// In which keyframes are drawn in the dark that moved, are new, are gone.
const MOVED: [u8; 3] = [0xff, 0x6e, 0xc7];
const ADDED: [u8; 3] = [0x4f, 0xd6, 0xff];
const REMOVED: [u8; 3] = [0xff, 0xd8, 0x4a];

fn change(release: &str, before: &MapContents, now: &MapContents) -> ViewedChange {
    let difference = KeyframeDifference::between(&Compared::of(before), &Compared::of(now));
    ViewedChange { release: release.to_owned(), difference }
}

/// The map that is shown, before: some keyframes elsewhere, some more and some not there.
fn changes(shown: &Shown, has_candidate: bool) -> ViewedChanges {
    let now = &shown.place.map;
    let mut before = now.clone();
    let added = before.keyframes.remove(8);
    for keyframe in &mut before.keyframes[12..15] {
        keyframe.global_from_keyframe.pose.translation.z += 2.0;
    }
    let mut gone = added;
    gone.id = 900_000;
    gone.global_from_keyframe.pose.translation.z += 4.0;
    before.keyframes.push(gone);
    let mut next = now.clone();
    for keyframe in &mut next.keyframes[2..6] {
        keyframe.global_from_keyframe.pose.translation.z += 1.5;
    }
    ViewedChanges {
        version: now.info.version,
        since: Some(change("release 1", &before, now)),
        candidate: has_candidate.then(|| change("candidate 2", now, &next)),
    }
}

/// Pixels of a colour in what is drawn of the map, the panels left out.
async fn pixels(browser: &mut Browser, name: &str, color: [u8; 3]) -> usize {
    browser
        .evaluate("document.querySelectorAll('.card').forEach((card) => card.style.visibility = 'hidden')")
        .await;
    tokio::time::sleep(std::time::Duration::from_millis(600)).await;
    let picture = browser.save_picture(&picture(name)).await;
    browser
        .evaluate("document.querySelectorAll('.card').forEach((card) => card.style.visibility = '')")
        .await;
    let image = image::load_from_memory(&picture).unwrap().to_rgb8();
    image.pixels().filter(|pixel| pixel.0.iter().zip(color).all(|(a, b)| a.abs_diff(b) < 24)).count()
}

async fn toggle(browser: &mut Browser, layer: &str) {
    browser.evaluate(&format!("document.querySelector('[data-layer={layer}]').click()")).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_changed_and_what_a_candidate_would_change_are_layers() {
    let Some(program) = browser_or_reason() else { return };
    let shown = Shown::start().await;
    let mut browser = Browser::start(&program, 1280, 800).await;
    browser.prefer("dark").await;
    browser.open(&format!("http://{}/", shown.address())).await;
    browser.wait_for("window.driftless?.isReady && window.driftless.isConnected").await;
    // No releases, no layers.
    let named = |told: &[(String, String)], name: &str| {
        told.iter().any(|(role, named)| role == "checkbox" && named.starts_with(name))
    };
    let told = browser.accessible().await;
    assert!(named(&told, "keyframes") && !named(&told, "since") && !named(&told, "candidate"), "{told:?}");

    // A page that is open is told.
    shown.viewer.set_changes("place", &changes(&shown, true));
    browser.wait_for("window.driftless.layers.since?.join() === 'moved,added,removed'").await;
    let told = browser.accessible().await;
    let since = "since release 1: → 3 moved, by 2.00 m at most; + 1 new; − 1 gone";
    assert!(named(&told, since), "{told:?}");
    assert!(named(&told, "candidate 2: → 4 moved, by 1.50 m at most"), "{told:?}");
    for color in [MOVED, ADDED, REMOVED] {
        assert_eq!(pixels(&mut browser, "changes_off.png", color).await, 0, "a layer is switched on by hand");
    }
    toggle(&mut browser, "since").await;
    for color in [MOVED, ADDED, REMOVED] {
        let drawn = pixels(&mut browser, "changes.png", color).await;
        assert!(drawn > 5, "{color:?}: {drawn}");
    }
    toggle(&mut browser, "since").await;
    toggle(&mut browser, "candidate").await;
    let drawn = pixels(&mut browser, "candidate.png", MOVED).await;
    assert!(drawn > 5, "{drawn}");
    for color in [ADDED, REMOVED] {
        assert_eq!(pixels(&mut browser, "candidate.png", color).await, 0);
    }
    browser.press("d").await;
    browser.save_picture(&picture("changes_light.png")).await;
    for (width, height) in [(1280, 800), (820, 1180), (390, 844)] {
        browser.resize(width, height).await;
        check_layout(&mut browser, &format!("{width}x{height}")).await;
    }

    // It was promoted or rejected.
    browser.resize(1280, 800).await;
    shown.viewer.set_changes("place", &changes(&shown, false));
    browser.wait_for("document.getElementById('candidate-layer').hidden").await;
    let told = browser.accessible().await;
    assert!(named(&told, since) && !named(&told, "candidate"), "{told:?}");
    // What is of another version is not shown.
    let other = ViewedChanges { version: 77, ..changes(&shown, true) };
    shown.viewer.set_changes("place", &other);
    browser.wait_for("document.getElementById('since-layer').hidden").await;
    check_well_behaved(&browser, shown.address());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_changed_is_answered_by_map() {
    let shown = Shown::start().await;
    let none = shown.json("/api/maps/place/changes").await;
    assert!(none["version"] == 3 && none["since"].is_null() && none["candidate"].is_null(), "{none}");
    shown.viewer.set_changes("place", &changes(&shown, false));
    let answer = shown.json("/api/maps/place/changes").await;
    let since = &answer["since"];
    assert_eq!((&since["release"], &since["moved"]["count"]), (&"release 1".into(), &3.into()), "{answer}");
    let moved = &since["moved"]["drawn"][0];
    let keyframe = &shown.place.map.keyframes[13];
    let now = keyframe.global_from_keyframe.pose.translation;
    assert_eq!((&moved["id"], &moved["now"]["position"][2]), (&keyframe.id.into(), &now.z.into()));
    assert!((moved["before"]["position"][2].as_f64().unwrap() - now.z - 2.0).abs() < 1e-9);
    assert_eq!(since["removed"]["drawn"][0]["id"], 900_000);
    let unknown = crate::common::get(shown.address(), "/api/maps/nowhere/changes").await;
    assert!(unknown.starts_with(b"HTTP/1.1 404"));
}
