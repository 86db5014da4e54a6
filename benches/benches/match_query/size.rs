//! Bytes of a map: its payload, on disk, and resident in a process that has only loaded it.

use std::process::Command;

use allocation_counter::measure;
use map::{MapContents, store};
use recognition::LoadedMap;

/// What a map inherently holds: for each observation its descriptor, its pixel (two `f32`) and two ids of 4 bytes; for each
/// landmark its id, its anchor and its position (three `f64`); for each keyframe its id, stamp, pose (seven `f64`), the
/// triangle of its covariance (21 `f64`) and its camera (12 `f64`); for each pair of correlated keyframes 36 `f64` and two
/// ids.
fn payload_bytes(contents: &MapContents) -> usize {
    let width = usize::from(contents.info.descriptor_width);
    contents.observation_count() * (width + 8 + 8)
        + contents.landmarks.len() * (8 + 8 + 24)
        + contents.keyframes.len() * 8 * (2 + 7 + 21 + 12)
        + contents.cross_covariances.len() * 8 * (36 + 2)
}

/// Writes a map, loads it in a process of its own, and prints the bytes of each.
pub fn report(contents: &MapContents) {
    let payload = payload_bytes(contents) as f64;
    println!(
        "map: {} keyframes, {} landmarks, {} observations; payload {:.0} MB",
        contents.keyframes.len(),
        contents.landmarks.len(),
        contents.observation_count(),
        payload * 1e-6
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map");
    let start = std::time::Instant::now();
    store::save_map(&path, contents, false).unwrap();
    println!("saved in {:.1} s", start.elapsed().as_secs_f64());
    let output = Command::new(std::env::current_exe().unwrap()).arg("--load").arg(&path).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let numbers: Vec<f64> = text.split_whitespace().map(|number| number.parse().unwrap()).collect();
    let [disk, before, after, peak, seconds] = numbers[..] else { panic!("{text:?}") };
    println!("on disk: {:.0} MB, {:.2} times the payload", disk * 1e-6, disk / payload);
    let held = bytes_held(contents) as f64;
    println!("held by the loaded map: {:.0} MB, {:.2} times the payload", held * 1e-6, held / payload);
    println!(
        "loaded in {seconds:.1} s: {:.0} MB resident, {:.2} times the payload; {:.0} MB at the peak",
        (after - before) * 1e-6,
        (after - before) / payload,
        peak * 1e-6
    );
}

/// Bytes that a loaded map has allocated and not freed.
fn bytes_held(contents: &MapContents) -> i64 {
    let (mut copy, mut map) = (None, None);
    let of_contents = measure(|| copy = Some(contents.clone())).bytes_current;
    let beyond_contents = measure(|| map = copy.take().map(|copy| LoadedMap::from_contents(copy).unwrap()));
    of_contents + beyond_contents.bytes_current
}

/// Loads a map and prints: bytes on disk; bytes resident before, after, and at most; seconds.
pub fn load(path: &str) {
    let before = resident("VmRSS:");
    let start = std::time::Instant::now();
    let (stored, landmarks) = store::open_map(path).unwrap();
    let disk = stored.bytes_on_disk;
    let map = LoadedMap::load(stored, landmarks).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    println!("{disk} {before} {} {} {seconds}", resident("VmRSS:"), resident("VmHWM:"));
    assert!(map.keyframe_count() > 0);
}

/// A line of this process's memory statistics in bytes, 0 where the system does not say.
fn resident(name: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(name));
    let kilobytes = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kilobytes.unwrap_or(0) * 1024
}
