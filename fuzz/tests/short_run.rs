//! Runs every target on its seeds and on seeded mutations of them, on a stable toolchain.
#![allow(clippy::unwrap_used)]

use driftless_fuzz::{TARGETS, bincode_payloads};
use map::store::record::{InfoRecord, KeyframeRecord, LandmarkRecord, seal};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::path::Path;
use testing::{Place, PlaceOptions};

/// Mutations of each seed.
const MUTATIONS: usize = 300;

#[test]
fn no_target_panics_on_mutated_seeds() {
    for &(name, target) in TARGETS {
        let seeds = seeds(name);
        assert!(!seeds.is_empty(), "{name} has no seeds in corpus/{name}");
        let mut rng = StdRng::seed_from_u64(1);
        for seed in &seeds {
            target(seed);
            for _ in 0..MUTATIONS {
                target(&mutated(seed, &seeds, &mut rng));
            }
        }
    }
}

fn seeds(name: &str) -> Vec<Vec<u8>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let json = || files(&root.join("../protocol/examples/json"));
    match name {
        "protocol_json" => json(),
        "protocol_bincode" => json().iter().flat_map(|example| bincode_payloads(example)).collect(),
        "store_records" => records(),
        "ros_messages" => of_kind(&root.join("../crates/ros_messages/tests/goldens"), |path| {
            path.extension().is_some_and(|end| end == "cdr")
        }),
        "images" => images(),
        other => files(&root.join("corpus").join(other)),
    }
}

/// A PNG image, one with a profile, and a JPEG image with three scans where there is one.
fn images() -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let image = vision::GrayImage::from_fn(24, 16, |x, y| (x * y + 7 * x) as u8);
    let png = image.to_png().unwrap();
    let path = folder.path().join("image.jpg");
    image.write(&path).unwrap();
    let jpeg = std::fs::read(&path).unwrap();
    // Behind the header; its checksum is wrong, as most are of mutated files.
    let profile = [&9_u32.to_be_bytes()[..], b"iCCP", b"p\0\0zzzzzz", &[0; 4]].concat();
    let with_profile = [&png[..33], &profile, &png[33..]].concat();
    let at = jpeg.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap();
    let scan = &jpeg[at..jpeg.len() - 2];
    let with_scans = [&jpeg[..at], &scan.repeat(3), &jpeg[jpeg.len() - 2..]].concat();
    vec![png, with_profile, jpeg, with_scans]
}

fn files(folder: &Path) -> Vec<Vec<u8>> {
    of_kind(folder, |_| true)
}

fn of_kind(folder: &Path, is_kind: impl Fn(&Path) -> bool) -> Vec<Vec<u8>> {
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| is_kind(path));
    files.sort();
    files.iter().map(|file| std::fs::read(file).unwrap()).collect()
}

/// One record of each table: its version and its payload, without the checksum between them.
fn records() -> Vec<Vec<u8>> {
    let options = PlaceOptions { keyframes: 3, landmarks: 60, ..PlaceOptions::default() };
    let place = Place::new(&options);
    let map = &place.map;
    let key = [0; 8];
    let sealed = [
        seal("info", &key, &InfoRecord::new(&map.info)).unwrap(),
        seal("keyframes", &key, &KeyframeRecord::new(&map.keyframes[0])).unwrap(),
        seal("landmarks", &key, &LandmarkRecord::new(&map.landmarks[0])).unwrap(),
    ];
    sealed.iter().map(|bytes| [&bytes[..1], &bytes[5..]].concat()).collect()
}

/// One to four changes: a flipped bit, a cut, a repeated part, an overwritten number, a piece of another seed.
fn mutated(seed: &[u8], seeds: &[Vec<u8>], rng: &mut StdRng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..rng.random_range(1..=4) {
        if bytes.is_empty() {
            break;
        }
        let at = rng.random_range(0..bytes.len());
        let end = (at + rng.random_range(1..=16)).min(bytes.len());
        match rng.random_range(0..6) {
            0 => bytes[at] ^= 1 << rng.random_range(0..8),
            1 => bytes.truncate(at),
            2 => bytes.extend_from_within(at..end),
            3 => bytes[at..end].fill(*[0_u8, 0xff, 0x7f, b'-', b'9'].get(rng.random_range(0..5)).unwrap()),
            4 => {
                bytes.drain(at..end);
            }
            _ => {
                let other = &seeds[rng.random_range(0..seeds.len())];
                let piece = other[rng.random_range(0..=other.len())..].iter().take(32);
                bytes.splice(at..at, piece.copied().collect::<Vec<u8>>());
            }
        }
    }
    bytes
}
