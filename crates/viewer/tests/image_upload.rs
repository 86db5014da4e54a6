//! Images over HTTP: what is let through to a search, one at a time, and what is refused in words.

use crate::common::{Shown, answered, candidate, get, response};
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use viewer::{
    CandidateVerdict, GivenImage, ImageCamera, ImageError, LocalizeImage, MAX_IMAGE_BYTES, ViewedAnswer,
    ViewedResult,
};

/// Begins like an image; whether it is one is for the search to say.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n and more";

/// The same with so many bytes behind it.
fn padded(bytes: usize) -> Vec<u8> {
    [PNG, &vec![0; bytes]].concat()
}

/// A search that waits until it may answer, and keeps what it was given.
struct Search {
    may_answer: Mutex<Receiver<()>>,
    given: Sender<GivenImage>,
}

impl LocalizeImage for Search {
    fn localize(&self, image: &GivenImage) -> Result<ViewedAnswer, ImageError> {
        self.given.send(image.clone()).unwrap();
        self.may_answer.lock().unwrap().recv().unwrap();
        if image.file.ends_with(b"half") {
            return Err(ImageError::Unusable("the image is cut off".to_owned()));
        }
        assert!(!image.file.ends_with(b"panic"), "a search that fails");
        let candidates = vec![candidate(14, 31, CandidateVerdict::InAnswer)];
        match answered(&[14], candidates).result {
            ViewedResult::Answered(answer) => Ok(*answer),
            ViewedResult::Failed { .. } => unreachable!(),
        }
    }
}

/// What the test does to the search.
struct Searching {
    shown: Shown,
    allow: Sender<()>,
    given: Receiver<GivenImage>,
}

async fn start() -> Searching {
    let shown = Shown::start().await;
    let ((allow, may_answer), (told, given)) = (channel(), channel());
    let search = Search { may_answer: Mutex::new(may_answer), given: told };
    shown.viewer.take_images(Arc::new(search));
    Searching { shown, allow, given }
}

/// A request with a body.
fn request(address: SocketAddr, target: &str, headers: &str, body: &[u8]) -> Vec<u8> {
    let head = format!(
        "POST {target} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nContent-Length: {}\r\n{headers}\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat()
}

/// Status and JSON of a response.
fn parsed(response: &[u8]) -> (u16, Value) {
    let text = String::from_utf8_lossy(response);
    let status = text.split(' ').nth(1).unwrap().parse().unwrap();
    let (_, body) = text.split_once("\r\n\r\n").unwrap();
    (status, serde_json::from_str(body).unwrap_or_else(|_| json!({"error": body})))
}

async fn post(address: SocketAddr, target: &str, body: &[u8]) -> (u16, Value) {
    parsed(&response(address, request(address, target, "", body)).await)
}

#[tokio::test(flavor = "multi_thread")]
async fn an_image_is_searched_for_with_its_camera_and_listed_with_the_queries() {
    let Searching { shown, allow, given } = start().await;
    let address = shown.address();
    assert_eq!(shown.json("/api/maps").await["takes_images"], true);
    let cameras = shown.json("/api/maps/place/cameras").await;
    let camera = &shown.place.map.keyframes[0].camera;
    assert_eq!(cameras["cameras"].as_array().unwrap().len(), 1);
    assert_eq!(cameras["cameras"][0]["keyframes"], shown.place.map.keyframes.len());
    assert_eq!(cameras["cameras"][0]["focal"], json!(camera.focal));

    allow.send(()).unwrap();
    let (status, answer) = post(address, "/api/maps/place/localize?camera=0", PNG).await;
    assert_eq!(
        (status, &answer["kind"], &answer["outcome"]),
        (200, &json!("image"), &json!("matched")),
        "{answer}"
    );
    assert_eq!(answer["candidates"][0]["inliers"], 31);
    let image = given.try_recv().unwrap();
    assert_eq!((image.map.as_str(), &image.file[..]), ("place", PNG));
    assert!(matches!(image.camera, ImageCamera::OfMap(of_map) if of_map == *camera));
    assert_eq!(shown.json("/api/queries").await["queries"][0], answer);

    allow.send(()).unwrap();
    let target = "/api/maps/place/localize?calibration=resolution%3A%20%5B1%2C%202%5D%0A";
    assert_eq!(post(address, target, &[0xff, 0xd8, 0xff, 0xe0]).await.0, 200);
    let image = given.try_recv().unwrap();
    assert!(matches!(image.camera, ImageCamera::Calibration(text) if text == "resolution: [1, 2]\n"));
}

#[tokio::test(flavor = "multi_thread")]
async fn one_image_is_searched_at_a_time_and_the_others_are_refused() {
    let Searching { shown, allow, given } = start().await;
    let address = shown.address();
    let target = "/api/maps/place/localize";
    let first = tokio::spawn(async move { post(address, target, PNG).await });
    // It is being searched now.
    let given = tokio::task::spawn_blocking(move || {
        given.recv_timeout(Duration::from_secs(20)).unwrap();
        given
    });
    let given = given.await.unwrap();
    for _ in 0..3 {
        let (status, answer) = post(address, target, &padded(1 << 20)).await;
        assert_eq!(status, 429, "{answer}");
        assert!(answer["error"].as_str().unwrap().contains("another image"), "{answer}");
    }
    // The rest goes on meanwhile.
    shown.body("/api/maps").await;
    allow.send(()).unwrap();
    assert_eq!(first.await.unwrap().0, 200);
    // Those that were refused were never searched.
    assert!(given.try_recv().is_err());
    allow.send(()).unwrap();
    assert_eq!(post(address, target, PNG).await.0, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_image_or_not_from_here_is_refused_in_words() {
    let Searching { shown, allow, given } = start().await;
    let address = shown.address();
    let target = "/api/maps/place/localize";
    let large = padded(MAX_IMAGE_BYTES);
    let long = format!("{target}?calibration={}", "x".repeat(20_000));
    for (target, body, status, word) in [
        (target, &b"GIF89a"[..], 415, "PNG"),
        (target, b"", 415, "PNG"),
        (target, &large, 413, "4 MiB"),
        ("/api/maps/cellar/localize", PNG, 404, "/api/maps"),
        ("/api/maps/place/localize?camera=7", PNG, 400, "/api/maps/place/cameras"),
        ("/api/maps/place/localize?camera=front", PNG, 400, "number"),
        (&long, PNG, 400, "16 KiB"),
        ("/api/maps", PNG, 405, "only GET"),
        ("/localize", PNG, 405, "only GET"),
    ] {
        let (found, answer) = post(address, target, body).await;
        let said = answer["error"].as_str().unwrap();
        assert!(found == status && said.contains(word), "{target}: {found} {said}");
    }
    // A length that is not stated.
    let head = format!(
        "POST {target} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nTransfer-Encoding: chunked\r\n\r\n"
    );
    let chunk = [format!("{:x}\r\n", large.len()).as_bytes(), &large, b"\r\n0\r\n\r\n"].concat();
    assert_eq!(parsed(&response(address, [head.as_bytes(), &chunk].concat()).await).0, 413);
    let foreign = request(address, target, "Origin: http://evil.example\r\n", PNG);
    assert_eq!(parsed(&response(address, foreign).await).0, 403);
    let put = String::from_utf8_lossy(&request(address, target, "", b"x")).replace("POST", "PUT");
    assert!(response(address, put).await.starts_with(b"HTTP/1.1 405"));
    assert!(get(address, target).await.starts_with(b"HTTP/1.1 405"));
    assert!(given.try_recv().is_err(), "none of them was searched");

    // Those that the search refuses, and one on which it fails.
    allow.send(()).unwrap();
    let (status, answer) = post(address, target, b"\x89PNG\r\n\x1a\nhalf").await;
    assert_eq!((status, &answer["error"]), (422, &json!("the image is cut off")));
    allow.send(()).unwrap();
    assert_eq!(post(address, target, b"\x89PNG\r\n\x1a\npanic").await.0, 500);
    // The page itself names its origin.
    allow.send(()).unwrap();
    let own = request(address, target, &format!("Origin: http://{address}\r\n"), PNG);
    assert_eq!(parsed(&response(address, own).await).0, 200);
    shown.body("/api/maps").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_that_ends_early_leaves_the_turn_to_the_next() {
    let Searching { shown, allow, given: _given } = start().await;
    let address = shown.address();
    let whole = request(address, "/api/maps/place/localize", "", &padded(100_000));
    for _ in 0..3 {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(&whole[..whole.len() / 2]).await.unwrap();
        stream.shutdown().await.unwrap();
        let mut said = Vec::new();
        stream.read_to_end(&mut said).await.unwrap();
        assert!(said.is_empty() || said.starts_with(b"HTTP/1.1 400"), "{}", String::from_utf8_lossy(&said));
    }
    allow.send(()).unwrap();
    assert!(response(address, whole).await.starts_with(b"HTTP/1.1 200"));
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_search_images_are_not_offered_and_refused() {
    let shown = Shown::start().await;
    assert_eq!(shown.json("/api/maps").await["takes_images"], false);
    let (status, answer) = post(shown.address(), "/api/maps/place/localize", PNG).await;
    assert!(status == 404 && answer["error"].as_str().unwrap().contains("map_server"), "{answer}");
}
