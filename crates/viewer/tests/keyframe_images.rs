//! The images of keyframes: in the API, and in the page by a click.

use crate::browser::Browser;
use crate::common::{Shown, answered, candidate, get};
use crate::page::{browser_or_reason, check_well_behaved, picture};
use map::KeptImage;
use map::store::{StoredImages, save_map};
use protocol::KeyframeId;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use viewer::{CandidateVerdict, KeyframeImages};

/// A picture of stripes.
fn jpeg(period: u32) -> Vec<u8> {
    let stripes = image::GrayImage::from_fn(320, 240, |x, y| {
        image::Luma([if (x + y) % period < period / 2 { 60 } else { 190 }])
    });
    let mut file = std::io::Cursor::new(Vec::new());
    stripes.write_to(&mut file, image::ImageFormat::Jpeg).unwrap();
    file.into_inner()
}

/// A disk that fails.
struct Failing;

impl KeyframeImages for Failing {
    fn count(&self) -> usize {
        1
    }

    fn jpeg(&self, _: KeyframeId) -> Result<Option<Vec<u8>>, String> {
        Err("hall.db cannot be read: the disk failed".to_owned())
    }
}

async fn refused(shown: &Shown, path: &str, status: u16, words: &str) {
    let answer = String::from_utf8_lossy(&get(shown.address(), path).await).into_owned();
    assert!(answer.starts_with(&format!("HTTP/1.1 {status}")) && answer.contains(words), "{path}: {answer}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_images_that_a_database_keeps_are_served_one_at_a_time() {
    let shown = Shown::start().await;
    let mut map = shown.place.map.clone();
    let [first, second, third] = [0, 1, 2].map(|at| map.keyframes[at].id);
    let image_of = |keyframe: KeyframeId| format!("/api/maps/place/keyframes/{keyframe}/image");
    assert_eq!(shown.json("/api/maps").await["maps"][0]["keyframe_images"], 0);
    refused(&shown, &image_of(first), 404, "--keep-images").await;

    map.images =
        [first, second].map(|keyframe| KeptImage { keyframe, jpeg: jpeg(8 + keyframe as u32) }).into();
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("place.db");
    save_map(&database, &map, false).unwrap();
    shown.viewer.set_keyframe_images("place", Arc::new(Mutex::new(StoredImages::open(&database).unwrap())));
    assert_eq!(shown.json("/api/maps").await["maps"][0]["keyframe_images"], 2);
    for image in &map.images {
        let path = image_of(image.keyframe);
        assert_eq!(shown.body(&path).await, image.jpeg);
        let head = String::from_utf8_lossy(&get(shown.address(), &path).await).to_lowercase();
        assert!(head.contains("content-type: image/jpeg"), "{path}");
    }
    refused(&shown, &image_of(third), 404, "no image of this keyframe").await;
    refused(&shown, "/api/maps/place/keyframes/none/image", 400, "a number").await;
    refused(&shown, &image_of(first).replace("place", "elsewhere"), 404, "no map of this name").await;

    shown.viewer.set_keyframe_images("place", Arc::new(Failing));
    refused(&shown, &image_of(first), 500, "the disk failed").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_click_shows_what_a_keyframe_saw() {
    let Some(program) = browser_or_reason() else { return };
    let shown = Shown::start().await;
    let address = shown.address();
    let ids: Vec<KeyframeId> = shown.place.map.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let images: BTreeMap<KeyframeId, Vec<u8>> =
        ids[1..].iter().map(|id| (*id, jpeg(10 + *id as u32))).collect();
    shown.viewer.set_keyframe_images("place", Arc::new(images));
    let used = [0, 5].map(|at| candidate(ids[at], 40, CandidateVerdict::InAnswer));
    shown.viewer.note_query("a stranger", answered(&[ids[0], ids[5]], used.into()));

    let mut browser = Browser::start(&program, 1024, 768).await;
    browser.prefer("dark").await;
    browser.open(&format!("http://{address}/")).await;
    browser.wait_for("window.driftless?.isConnected").await;
    browser.press("q").await;
    let button = |row: usize| format!("document.querySelectorAll('#candidates button')[{row}]");
    browser.wait_for(&format!("Boolean({})", button(1))).await;
    browser.evaluate(&format!("{}.click()", button(1))).await;
    browser.wait_for("document.getElementById('keyframe-image').naturalWidth === 320").await;
    let visible =
        "document.getElementById('keyframe').open && !document.getElementById('keyframe-image').hidden";
    browser.wait_for(visible).await;
    let title = browser.evaluate("document.getElementById('keyframe-title').innerText").await;
    assert_eq!(title, format!("Keyframe {}", ids[5]));
    browser.save_picture(&picture("keyframe.png")).await;

    // One without an image.
    browser.evaluate("document.getElementById('keyframe').close()").await;
    browser.evaluate(&format!("{}.click()", button(0))).await;
    browser.wait_for("document.getElementById('keyframe-no-image').innerText.includes('No image')").await;
    browser.evaluate("document.getElementById('keyframe').close()").await;

    // In the map itself, where the keyframe is drawn.
    let at = browser.evaluate(&format!("window.driftless.pixelOf({})", ids[7])).await;
    let [x, y]: [f64; 2] = serde_json::from_value(at).unwrap();
    let press = |kind: &str| {
        format!(
            "document.getElementById('scene').dispatchEvent(new MouseEvent('{kind}', {{ clientX: {x}, clientY: {y}, bubbles: true }}))"
        )
    };
    let events = format!(
        "document.getElementById('scene').dispatchEvent(new PointerEvent('pointerdown', {{ clientX: {x}, clientY: {y}, pointerId: 1 }}));\
         document.getElementById('scene').dispatchEvent(new PointerEvent('pointerup', {{ clientX: {x}, clientY: {y}, pointerId: 1 }}));\
         {}",
        press("click")
    );
    browser.evaluate(&events).await;
    browser.wait_for(visible).await;
    let title = browser.evaluate("document.getElementById('keyframe-title').innerText").await;
    let shown_id: KeyframeId = title.as_str().unwrap().trim_start_matches("Keyframe ").parse().unwrap();
    assert!(ids[6..9].contains(&shown_id), "{title} for {}", ids[7]);
    // Of all that is asked for, only the image that is not kept is refused.
    browser.complaints.retain(|complaint| {
        !complaint.contains(&format!("/keyframes/{}/image", ids[0])) && !complaint.contains("404")
    });
    check_well_behaved(&browser, address);
}
