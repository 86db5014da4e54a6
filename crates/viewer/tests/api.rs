//! The page and its API over a real connection.

use crate::common::{Shown, get, response};
use nalgebra::Vector3;
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use viewer::MAX_CONNECTIONS;
use viewer::assets::{ASSETS, asset};

#[tokio::test(flavor = "multi_thread")]
async fn the_map_of_the_api_is_the_map() {
    let shown = Shown::start().await;
    let map = &shown.place.map;
    let maps: Value = serde_json::from_slice(&shown.body("/api/maps").await).unwrap();
    let summary = &maps["maps"][0];
    assert_eq!(summary["name"], "place");
    assert_eq!(summary["identity"], map.info.identity.unwrap().to_string());
    assert_eq!(summary["keyframes"], map.keyframes.len());
    assert_eq!(summary["landmarks"], map.landmarks.len());

    let answer: Value = serde_json::from_slice(&shown.body("/api/maps/place/keyframes").await).unwrap();
    let keyframes = answer["keyframes"].as_array().unwrap();
    assert_eq!(keyframes.len(), map.keyframes.len());
    for (sent, keyframe) in keyframes.iter().zip(&map.keyframes) {
        assert_eq!(sent["id"], keyframe.id);
        let pose = &keyframe.global_from_keyframe;
        let position: [f64; 3] = serde_json::from_value(sent["position"].clone()).unwrap();
        assert!((Vector3::from(position) - pose.pose.translation).norm() < 1e-12);
        let [w, x, y, z]: [f64; 4] = serde_json::from_value(sent["rotation_wxyz"].clone()).unwrap();
        let rotation = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        assert!(rotation.angle_to(&pose.pose.rotation) < 1e-7);
        let covariance: [[f64; 3]; 3] = serde_json::from_value(sent["position_covariance"].clone()).unwrap();
        assert!((covariance[1][1] - pose.covariance[(4, 4)]).abs() < 1e-15);
    }

    let low = Vector3::from(serde_json::from_value::<[f64; 3]>(summary["extent"]["min"].clone()).unwrap());
    let positions = || map.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose.translation);
    assert!(positions().all(|position| (position - low).min() >= -1e-12));
    assert!((0..3).all(|axis| positions().any(|position| (position[axis] - low[axis]).abs() < 1e-12)));
}

#[tokio::test(flavor = "multi_thread")]
async fn fewer_landmarks_are_the_first_of_all_of_them() {
    let shown = Shown::start().await;
    let all = shown.body("/api/maps/place/landmarks").await;
    assert_eq!(all.len(), 12 * shown.place.map.landmarks.len());
    assert_eq!(shown.body("/api/maps/place/landmarks?limit=100").await, all[..1200]);
    assert_eq!(shown.body("/api/maps/place/landmarks?limit=99999999999").await, all);

    let landmark = &shown.place.map.landmarks[0];
    let anchor = shown.place.map.keyframes.iter().find(|keyframe| keyframe.id == landmark.anchor).unwrap();
    let expected = anchor.global_from_keyframe.pose.transform(&landmark.position_in_anchor).cast::<f32>();
    let bytes: Vec<u8> = expected.iter().flat_map(|value| value.to_le_bytes()).collect();
    assert!(all.chunks_exact(12).any(|sent| sent == bytes), "the first landmark is among them");

    assert!(get(shown.address(), "/api/maps/place/landmarks?limit=-1").await.starts_with(b"HTTP/1.1 400"));
    assert!(get(shown.address(), "/api/maps/cellar/landmarks").await.starts_with(b"HTTP/1.1 404"));
    assert!(get(shown.address(), "/api/run").await.starts_with(b"HTTP/1.1 404"));
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_files_of_the_page_are_served_with_strict_headers() {
    let shown = Shown::start().await;
    for file in ASSETS {
        assert_eq!(shown.body(&format!("/{}", file.path)).await, file.bytes, "{}", file.path);
    }
    let page = String::from_utf8(get(shown.address(), "/").await).unwrap().to_ascii_lowercase();
    for header in ["content-security-policy: default-src 'self';", "x-content-type-options: nosniff"] {
        assert!(page.contains(header), "{header}");
    }
    for path in [
        "/../Cargo.toml",
        "/..%2fCargo.toml",
        "/vendor/../../Cargo.toml",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
    ] {
        assert!(get(shown.address(), path).await.starts_with(b"HTTP/1.1 404"), "{path}");
    }
}

#[test]
fn the_policy_allows_the_import_map_of_the_page() {
    use base64::Engine as _;
    let page = std::str::from_utf8(asset("").unwrap().bytes).unwrap();
    let (_, rest) = page.split_once(r#"<script type="importmap">"#).unwrap();
    let (import_map, _) = rest.split_once("</script>").unwrap();
    let digest = base64::engine::general_purpose::STANDARD.encode(Sha256::digest(import_map.as_bytes()));
    assert_eq!(include_str!("../page/import_map.sha256"), format!("sha256-{digest}"));
}

#[tokio::test(flavor = "multi_thread")]
async fn other_methods_and_other_hosts_are_refused() {
    let shown = Shown::start().await;
    let address = shown.address();
    for method in ["POST", "PUT", "DELETE", "OPTIONS"] {
        let request = format!("{method} /api/maps HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
        assert!(response(address, &request).await.starts_with(b"HTTP/1.1 405"), "{method}");
    }
    let rebound = "GET /api/maps HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n";
    assert!(response(address, rebound).await.starts_with(b"HTTP/1.1 421"));
    let two = format!(
        "GET /api/maps HTTP/1.1\r\nHost: {address}\r\nHost: evil.example\r\nConnection: close\r\n\r\n"
    );
    assert!(response(address, &two).await.starts_with(b"HTTP/1.1 400"));
    let foreign = format!(
        "GET /api/maps HTTP/1.1\r\nHost: {address}\r\nOrigin: http://evil.example\r\nConnection: close\r\n\r\n"
    );
    assert!(response(address, &foreign).await.starts_with(b"HTTP/1.1 403"));
}

#[tokio::test(flavor = "multi_thread")]
async fn of_a_thousand_connections_a_limited_number_stays_and_the_server_goes_on() {
    let shown = Shown::start().await;
    let address = shown.address();
    let mut open = Vec::new();
    for _ in 0..1000 {
        open.push(TcpStream::connect(address).await.unwrap());
    }
    // Until all are accepted: the newest stay.
    tokio::time::sleep(std::time::Duration::from_millis(500)).await;
    let request = format!("GET /api/maps HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    let mut answered = 0;
    for stream in &mut open {
        let mut text = Vec::new();
        // Those beyond the limit are closed or reset.
        let is_sent = stream.write_all(request.as_bytes()).await.is_ok();
        let is_read = is_sent && stream.read_to_end(&mut text).await.is_ok();
        answered += usize::from(is_read && text.starts_with(b"HTTP/1.1 200"));
    }
    assert_eq!(answered, MAX_CONNECTIONS);
    drop(open);
    shown.body("/api/maps").await;
}
