//! The page *Limits and guarantees* states the limits that the code has.

use std::collections::BTreeMap;

const PAGE: &str = include_str!("../../docs/src/reference/limits.md");

/// A number with a comma before each three digits.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (at, digit) in digits.char_indices() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

fn count(number: usize, of: &str) -> String {
    format!("{} {of}", grouped(number as u64))
}

/// In the largest unit of which it is a multiple.
fn bytes(number: u64) -> String {
    [(30, "GiB"), (20, "MiB"), (10, "KiB")]
        .into_iter()
        .find(|(shift, _)| number.is_multiple_of(1 << shift))
        .map_or_else(
            || format!("{} bytes", grouped(number)),
            |(shift, unit)| format!("{} {unit}", number >> shift),
        )
}

/// What the page has to say about each constant.
fn limits() -> BTreeMap<&'static str, String> {
    use geometry::camera;
    BTreeMap::from([
        ("protocol::MAX_MESSAGE_BYTES", bytes(protocol::MAX_MESSAGE_BYTES as u64)),
        ("protocol::MAX_QUERY_FEATURES", count(protocol::MAX_QUERY_FEATURES, "features")),
        ("protocol::MAX_HELD_KEYFRAMES", count(protocol::MAX_HELD_KEYFRAMES, "held keyframes")),
        ("protocol::MAX_SESSION_PART_BYTES", bytes(protocol::MAX_SESSION_PART_BYTES as u64)),
        ("protocol::MAX_SESSION_BYTES", bytes(protocol::MAX_SESSION_BYTES)),
        ("hand_in::MAX_MEMORY_PER_BYTE", format!("{} bytes of memory", hand_in::MAX_MEMORY_PER_BYTE)),
        ("hand_in::MAX_SESSION_MEMORY_BYTES", bytes(hand_in::MAX_SESSION_MEMORY_BYTES)),
        ("protocol::MAX_ANSWER_KEYFRAMES", format!("{} keyframes", protocol::MAX_ANSWER_KEYFRAMES)),
        ("geometry::camera::MIN_FOCAL", format!("from {} to", camera::MIN_FOCAL)),
        ("geometry::camera::MAX_FOCAL", format!("to {} times", grouped(camera::MAX_FOCAL as u64))),
        ("geometry::camera::MAX_CENTRE_OFFSET", format!("{} longer sides", camera::MAX_CENTRE_OFFSET)),
        ("geometry::camera::MAX_DISTORTION", format!("{} times", camera::MAX_DISTORTION)),
        (
            "geometry::camera::MAX_RATIONAL_TERM",
            format!("{} times", grouped(camera::MAX_RATIONAL_TERM as u64)),
        ),
        ("geometry::camera::MAX_CAMERA_SIDE", count(camera::MAX_CAMERA_SIDE as usize, "columns")),
        ("geometry::camera::MAX_MOUNT_M", format!("{} m", grouped(camera::MAX_MOUNT_M as u64))),
        ("geometry::MAX_COORDINATE_M", format!("{} km", grouped(geometry::MAX_COORDINATE_M as u64 / 1000))),
        ("client::session::MAX_SESSIONS", count(client::session::MAX_SESSIONS, "sessions")),
        ("vision::MAX_PIXELS", format!("{} million pixels", vision::MAX_PIXELS / 1_000_000)),
        ("vision::MAX_IMAGE_SIDE", count(vision::MAX_IMAGE_SIDE as usize, "columns")),
        ("vision::MAX_SCANS", format!("{} scans", vision::MAX_SCANS)),
        ("vision::MAX_IMAGE_FILE_BYTES", format!("{} MB", vision::MAX_IMAGE_FILE_BYTES / 1_000_000)),
        ("viewer::MAX_IMAGE_BYTES", bytes(viewer::MAX_IMAGE_BYTES as u64)),
        ("map_server::images::MAX_IMAGE_SIDE", count(map_server::images::MAX_IMAGE_SIDE as usize, "columns")),
        ("files::MAX_TEXT_BYTES", bytes(files::MAX_TEXT_BYTES)),
        ("vision::features::weights::MAX_WEIGHTS_BYTES", bytes(vision::features::weights::MAX_WEIGHTS_BYTES)),
        ("bags::MAX_MESSAGE", bytes(bags::MAX_MESSAGE)),
        ("monitoring::MAX_CONNECTIONS", count(::monitoring::MAX_CONNECTIONS, "connections")),
        ("monitoring::HEADER_TIME", format!("{} s", ::monitoring::HEADER_TIME.as_secs())),
    ])
}

/// What stands between backticks in a text.
fn code(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

#[test]
fn the_page_states_the_limits_of_the_code() {
    let limits = limits();
    let mut found = Vec::new();
    for row in PAGE.lines().filter(|line| line.starts_with('|')) {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let (limit, constants) = (cells[1], cells[2]);
        for constant in code(constants)
            .filter(|name| name.contains("MAX_") || name.contains("MIN_") || name.contains("_TIME"))
        {
            let Some(value) = limits.get(constant) else {
                panic!("{constant} is not compared with the code")
            };
            // A number that only ends like it is another one.
            let is_stated = limit.match_indices(value.as_str()).any(|(at, _)| {
                !limit[..at]
                    .ends_with(|before: char| before.is_ascii_digit() || before == ',' || before == '.')
            });
            assert!(is_stated, "{constant} is {value}, and the page says: {limit}");
            found.push(constant);
        }
    }
    found.sort_unstable();
    assert_eq!(found, limits.keys().copied().collect::<Vec<_>>(), "each constant has one row");
}

#[test]
fn the_page_states_how_long_the_queue_is() {
    let options = map_server::ServerOptions::default();
    let queue = format!(
        "(`ServerOptions::queue_length`, {}; `queue_bytes`, {})",
        options.queue_length,
        bytes(options.queue_bytes as u64)
    );
    assert!(PAGE.contains(&queue), "{queue}");
}
