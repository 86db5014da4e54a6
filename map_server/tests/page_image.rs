//! Images that are given to the live map of a server: over HTTP, and dropped on the page in a browser. Without Chromium the
//! latter is skipped, with a line that says so; pictures are written to `target/viewer`.

use crate::browser::{Browser, installed};
use axum::Router;
use base64::Engine as _;
use client::{SessionOptions, close_session, open_session};
use geometry::uncertain_pose::isotropic_covariance;
use geometry::{Camera, Distortion, Pose, PoseWithCovariance};
use map::{Keyframe, Landmark, MapContents, MapMetadata, Observation};
use map_server::{MapServer, ServedMap, ServerOptions, Show};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use recognition::LoadedMap;
use serde_json::{Value, json};
use std::io::Write as _;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use vision::GrayImage;
use vision::features::{DEFAULT_EXTRACTOR, open};
use vision::kind_of;
use zenoh::Session;

const CALIBRATION: &str = "resolution: [640, 480]\ncamera_model: pinhole\nintrinsics: [500, 500, 320, 240]\n";

fn camera() -> Camera {
    Camera {
        width: 640,
        height: 480,
        focal: [500.0; 2],
        centre: [320.0, 240.0],
        distortion: Distortion::None,
    }
}

/// Blots of all sizes.
fn picture(seed: u64, width: usize, height: usize) -> GrayImage {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut grey = vec![128_f64; width * height];
    for _ in 0..700 {
        let (x0, y0) = (rng.random_range(0.0..width as f64), rng.random_range(0.0..height as f64));
        let (sigma, height_of) = (rng.random_range(2.0..9.0_f64), rng.random_range(-70.0..70.0));
        let reach = (3.0 * sigma) as i64;
        for y in (y0 as i64 - reach).max(0)..(y0 as i64 + reach).min(height as i64) {
            for x in (x0 as i64 - reach).max(0)..(x0 as i64 + reach).min(width as i64) {
                let squared = (x as f64 - x0).powi(2) + (y as f64 - y0).powi(2);
                grey[y as usize * width + x as usize] += height_of * (-squared / (2.0 * sigma * sigma)).exp();
            }
        }
    }
    GrayImage::new(width, height, grey.iter().map(|value| value.clamp(0.0, 255.0) as u8).collect()).unwrap()
}

/// Poses of the keyframes in G.
fn poses() -> [Pose; 3] {
    let place = |x: f64, yaw: f64| {
        Pose::new(UnitQuaternion::from_euler_angles(0.1, yaw, -0.2), Vector3::new(x, 2.0, 1.5))
    };
    [place(0.0, 0.0), place(40.0, 0.7), place(80.0, -0.4)]
}

/// A map of three places; each keyframe shows a wavy surface with a picture on it.
fn rooms() -> MapContents {
    let mut extractor = open(DEFAULT_EXTRACTOR, None).unwrap();
    let width = extractor.width() as u16;
    let mut info = MapMetadata::new("rooms", "test", kind_of(extractor.metric()), width);
    extractor.name().clone_into(&mut info.extractor);
    let mut map = MapContents::empty(info);
    for (place, pose) in poses().into_iter().enumerate() {
        let id = 10 + place as u64;
        let image = picture(place as u64, 640, 480);
        let features = extractor.extract(&image, None, 500).unwrap();
        map.keyframes.push(Keyframe {
            id,
            stamp_ns: place as i64,
            global_from_keyframe: PoseWithCovariance::new(pose, isotropic_covariance(0.001, 0.01)),
            camera: camera(),
            features: None,
        });
        for (at, keypoint) in features.keypoints.iter().enumerate() {
            let pixel = keypoint.pixel;
            let normalized = camera().unproject(&Vector2::from(pixel.map(f64::from))).unwrap();
            let depth = 5.0 + (3.0 * normalized.x).sin() + (4.0 * normalized.y).cos();
            let bytes = usize::from(width);
            map.landmarks.push(Landmark {
                id: 1000 * id + at as u64,
                anchor: id,
                position_in_anchor: normalized.push(1.0) * depth,
                observations: vec![Observation {
                    keyframe: id,
                    pixel,
                    descriptor: features.descriptors[at * bytes..][..bytes].to_vec(),
                }],
            });
        }
    }
    map
}

/// A server of the map with its page.
struct Served {
    session: Session,
    server: MapServer,
    show: Show,
}

impl Served {
    async fn start(map: MapContents) -> Self {
        let session = open_session(&SessionOptions::default()).await.unwrap();
        let map = Arc::new(LoadedMap::from_contents(map).unwrap());
        let maps = vec![ServedMap { name: "rooms".to_owned(), map }];
        let server = MapServer::start(session.clone(), maps, ServerOptions::default()).await.unwrap();
        let names = ["rooms"].into_iter();
        let show =
            Show::start(([127, 0, 0, 1], 0).into(), &session, &server, names, Router::new()).await.unwrap();
        Self { session, server, show }
    }

    fn address(&self) -> SocketAddr {
        self.show.address()
    }

    /// Status and answer.
    async fn post(&self, parameters: &str, file: &[u8]) -> (u16, Value) {
        let address = self.address();
        let head = format!(
            "POST /api/maps/rooms/localize?{parameters} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\
             Content-Length: {}\r\n\r\n",
            file.len()
        );
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(&[head.as_bytes(), file].concat()).await.unwrap();
        let mut response = String::new();
        stream.read_to_string(&mut response).await.unwrap();
        let (head, body) = response.split_once("\r\n\r\n").unwrap();
        (head.split(' ').nth(1).unwrap().parse().unwrap(), serde_json::from_str(body).unwrap())
    }

    async fn stop(self) {
        self.show.stop().await;
        self.server.stop().await.unwrap();
        close_session(&self.session).await;
    }
}

fn encoded(image: &GrayImage, name: &str) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    image.write(&path).unwrap();
    std::fs::read(path).unwrap()
}

/// Percent-encoded, as in a parameter.
fn parameter(text: &str) -> String {
    text.bytes().fold(String::new(), |encoded, byte| encoded + &format!("%{byte:02x}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn an_image_is_localized_where_it_was_taken() {
    let served = Served::start(rooms()).await;
    for (place, pose) in poses().into_iter().enumerate() {
        let file = encoded(&picture(place as u64, 640, 480), ["a.png", "b.jpg", "c.png"][place]);
        let by_calibration = format!("calibration={}", parameter(CALIBRATION));
        let parameters = if place == 2 { by_calibration.as_str() } else { "camera=0" };
        let (status, answer) = served.post(parameters, &file).await;
        assert_eq!((status, &answer["outcome"]), (200, &json!("matched")), "{answer}");
        let position: [f64; 3] = serde_json::from_value(answer["fix"]["position"].clone()).unwrap();
        assert!((Vector3::from(position) - pose.translation).norm() < 0.05, "{answer}");
        let [w, x, y, z]: [f64; 4] = serde_json::from_value(answer["fix"]["rotation_wxyz"].clone()).unwrap();
        let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        assert!(rotation.angle_to(&pose.rotation) < 0.01, "{answer}");
        assert!(answer["fix"]["inliers"].as_u64().unwrap() > 100, "{answer}");
        assert_eq!(
            (&answer["keyframes"], &answer["candidates"][0]["verdict"]),
            (&json!([10 + place]), &json!("in_answer"))
        );
    }
    // A place that the map does not have.
    let (status, answer) = served.post("camera=0", &encoded(&picture(99, 640, 480), "a.png")).await;
    assert_eq!((status, &answer["fix"]), (200, &Value::Null));
    assert_ne!(answer["outcome"], "matched");
    served.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn images_that_cannot_be_searched_for_are_refused_in_words() {
    let served = Served::start(rooms()).await;
    let file = encoded(&picture(0, 640, 480), "a.png");
    let small = encoded(&picture(0, 320, 240), "a.jpg");
    // The header of an image of 20,000 x 20,000 pixels, and nothing else.
    let mut huge = file.clone();
    huge[16..24].copy_from_slice(&[0, 0, 0x4e, 0x20, 0, 0, 0x4e, 0x20]);
    let tall = encoded(&GrayImage::from_fn(5000, 4, |x, _| x as u8), "a.png");
    let garbage = [b"\x89PNG\r\n\x1a\n".as_slice(), &[7; 5000]].concat();
    let unknown_lens =
        format!("calibration={}", parameter(&format!("{CALIBRATION}distortion_model: fisheye\n")));
    let bomb = "a: &a [x,x,x,x,x,x,x,x,x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b,*b,*b]\n\
                d: &d [*c,*c,*c,*c,*c,*c,*c,*c,*c]\ne: &e [*d,*d,*d,*d,*d,*d,*d,*d,*d]\nresolution: [*e,*e]\n";
    let bomb = format!("calibration={}", parameter(bomb));
    for (parameters, file, words) in [
        ("camera=0", &file[..file.len() / 2], "cut off"),
        ("camera=0", &small, "320 x 240 pixels, its camera 640 x 480"),
        ("camera=0", &tall, "5000 x 4 pixels, more than 4096"),
        ("camera=0", &huge, ""),
        ("camera=0", &garbage, ""),
        ("calibration=nonsense", &file, "the calibration"),
        (&unknown_lens, &file, "fisheye"),
        (&bomb, &file, "the calibration"),
    ] {
        let (status, answer) = served.post(parameters, file).await;
        let said = answer["error"].as_str().unwrap();
        assert!(status == 422 && said.contains(words), "{parameters}: {status} {said}");
        assert!(said.len() > 10 && said.len() < 600, "{said}");
    }
    served.stop().await;

    let mut unnamed = rooms();
    unnamed.info.extractor = String::new();
    let served = Served::start(unnamed).await;
    let (status, answer) = served.post("camera=0", &file).await;
    assert!(status == 422 && answer["error"].as_str().unwrap().contains("extractor"), "{answer}");
    served.stop().await;
}

/// Drops a file on the page, as a hand would.
async fn drop_file(browser: &mut Browser, name: &str, file: &[u8]) {
    let data = base64::engine::general_purpose::STANDARD.encode(file);
    let script = format!(
        "(() => {{ const bytes = Uint8Array.from(atob('{data}'), (c) => c.charCodeAt(0)); \
         const dataTransfer = new DataTransfer(); dataTransfer.items.add(new File([bytes], '{name}')); \
         const scene = document.getElementById('scene'); \
         for (const type of ['dragover', 'drop']) scene.dispatchEvent(new DragEvent(type, \
         {{ dataTransfer, bubbles: true, cancelable: true }})); return true; }})()"
    );
    assert_eq!(browser.evaluate(&script).await, true);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_image_that_is_dropped_on_the_page_is_shown_where_it_was_taken() {
    let Some(program) = installed() else {
        let _ = writeln!(std::io::stderr(), "skipped: no Chromium is installed (apt-get install chromium)");
        return;
    };
    let served = Served::start(rooms()).await;
    let mut browser = Browser::start(&program, 1280, 800).await;
    browser.prefer("dark").await;
    browser.open(&format!("http://{}/", served.address())).await;
    browser.wait_for("window.driftless?.isConnected").await;
    browser.press("q").await;
    browser.wait_for("document.querySelectorAll('#image-camera option').length === 2").await;

    let file = encoded(&picture(1, 640, 480), "hall.jpg");
    drop_file(&mut browser, "hall.jpg", &file).await;
    browser.wait_for("Boolean(window.driftless.query?.camera)").await;
    let at = browser.evaluate("window.driftless.query").await;
    assert_eq!((&at["kind"], &at["outcome"]), (&json!("image"), &json!("matched")));
    let camera: [f64; 3] = serde_json::from_value(at["camera"].clone()).unwrap();
    assert!((Vector3::from(camera) - poses()[1].translation).norm() < 0.05, "{at}");
    let text = |id: &str| format!("document.getElementById('{id}').textContent");
    let fix = browser.evaluate(&text("query-fix")).await;
    assert!(fix.as_str().unwrap().contains("matched features agree"), "{fix}");
    let table = browser.evaluate("document.querySelector('#candidates tbody').innerText").await;
    assert!(table.as_str().unwrap().contains("part of the answer"), "{table}");
    tokio::time::sleep(std::time::Duration::from_millis(500)).await;
    let picture_of = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/viewer").join(name);
    browser.save_picture(&picture_of("image.png")).await;

    // One that is nowhere: listed, with why.
    drop_file(&mut browser, "moon.png", &encoded(&picture(99, 640, 480), "moon.png")).await;
    browser
        .wait_for("window.driftless.query?.outcome !== 'matched' && !window.driftless.query?.camera")
        .await;
    // What is no image, and one of another size: words, and the page goes on.
    drop_file(&mut browser, "notes.txt", b"no image").await;
    browser
        .wait_for("document.getElementById('image-status').textContent.includes('neither a PNG nor a JPEG')")
        .await;
    drop_file(&mut browser, "small.png", &encoded(&picture(1, 320, 240), "small.png")).await;
    browser.wait_for("document.getElementById('image-status').textContent.includes('320 x 240')").await;
    browser.press("d").await;
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    browser.save_picture(&picture_of("image_refused.png")).await;

    // With the calibration pasted, by the keyboard: the same image at half the size is recognized, too.
    let half = vision::Pyramid::new(picture(1, 640, 480), 2).level(1).clone();
    let calibration = "resolution: [320, 240]\\ncamera_model: pinhole\\nintrinsics: [250, 250, 160, 120]\\n";
    let paste = format!(
        "(() => {{ const select = document.getElementById('image-camera'); select.value = 'other'; \
         select.dispatchEvent(new Event('change')); \
         document.getElementById('image-calibration').value = '{calibration}'; \
         return document.getElementById('image-calibration').hidden; }})()"
    );
    assert_eq!(browser.evaluate(&paste).await, false);
    drop_file(&mut browser, "half.png", &encoded(&half, "half.png")).await;
    browser
        .wait_for("window.driftless.query?.kind === 'image' && Boolean(window.driftless.query.camera)")
        .await;
    browser.press("i").await;
    assert_eq!(browser.evaluate("document.activeElement.id").await, "image-file");

    // The refusals are the server's; the browser notes each of them.
    let refusals = browser.complaints.iter().filter(|one| one.contains("localize")).count();
    assert_eq!((refusals, browser.complaints.len()), (2, 2), "{:?}", browser.complaints);
    served.stop().await;
}
