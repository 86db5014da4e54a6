//! Runs every target on its seeds and on seeded mutations of them, on a stable toolchain: the same inputs in the same order,
//! for `FUZZ_SECONDS` each.
#![allow(clippy::unwrap_used)]

#[allow(dead_code)]
#[path = "../../crates/hand_in/tests/example_session.rs"]
mod example_session;

use bags::{BagWriter, Format, MessageType, OfferedQos};
use driftless_fuzz::{TARGETS, bincode_payloads, colmap_files};
use map::file::SegmentWriter;
use map::file::record::{Element as _, seal};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};
use testing::{Place, PlaceOptions};

/// How long one input may take.
const LONGEST: Duration = Duration::from_secs(10);

/// How long each target runs; its seeds are always tried.
fn time_of_a_target() -> Duration {
    let given = std::env::var("FUZZ_SECONDS").map_or(1.0, |text| text.parse().unwrap());
    Duration::from_secs_f64(given)
}

/// Hands an input over; where the target does not stand it, the input is kept.
fn try_input(name: &str, target: fn(&[u8]), input: &[u8]) {
    let begin = Instant::now();
    let ended = catch_unwind(AssertUnwindSafe(|| target(input)));
    if ended.is_err() || begin.elapsed() > LONGEST {
        let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-input"));
        std::fs::write(&kept, input).unwrap();
        panic!("{name} does not stand {}, after {:?}", kept.display(), begin.elapsed());
    }
}

/// Runs a target on the mutations of its seeds.
fn run(name: &str) {
    let (_, target) = TARGETS.iter().find(|(other, _)| *other == name).unwrap();
    let seeds = seeds(name);
    assert!(!seeds.is_empty(), "{name} has no seeds in corpus/{name}");
    let mut rng = StdRng::seed_from_u64(1);
    for seed in &seeds {
        try_input(name, *target, seed);
    }
    let (begin, mut inputs) = (Instant::now(), 0);
    while begin.elapsed() < time_of_a_target() {
        for seed in &seeds {
            try_input(name, *target, &mutated(seed, &seeds, &mut rng));
            inputs += 1;
        }
    }
    println!("{name}: {inputs} inputs");
    assert!(inputs > 0);
}

/// One test a target.
macro_rules! targets {
    ($($name:ident),* $(,)?) => {
        const TESTED: &[&str] = &[$(stringify!($name)),*];
        $(
            #[test]
            fn $name() {
                run(stringify!($name));
            }
        )*
    };
}

targets! {
    protocol_bincode, protocol_json, sensor_yaml, csv_tables, images, sqlite_bags, mcap_bags, rosbag1_bags, colmap_models, http_heads,
    store_records, sensor_messages, ros_messages, session_files, weights,
}

#[test]
fn every_target_is_run() {
    let names = TARGETS.iter().map(|(name, _)| *name);
    let missing: Vec<_> = names.filter(|name| !TESTED.contains(name)).collect();
    assert!(missing.is_empty(), "{missing:?}");
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
        "images" => pictures(),
        "sqlite_bags" => recordings(Format::Rosbag2),
        "mcap_bags" => [recordings(Format::Mcap), files(&root.join("corpus/mcap_bags"))].concat(),
        "colmap_models" => models(&root.join("../crates/map_io/tests/data")),
        "session_files" => vec![session()],
        "weights" => vec![tensors()],
        other => files(&root.join("corpus").join(other)),
    }
}

/// A PNG image, one with a profile, and a JPEG image with three scans where there is one.
fn pictures() -> Vec<Vec<u8>> {
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

/// Two tensors as safetensors: the length of the header, the header, the numbers.
fn tensors() -> Vec<u8> {
    let header = br#"{"a":{"dtype":"F32","shape":[2,3],"data_offsets":[0,24]},"b":{"dtype":"F32","shape":[1],"data_offsets":[24,28]}}"#;
    [&(header.len() as u64).to_le_bytes()[..], header, &[0x3f; 28]].concat()
}

/// A recording as this project writes it.
fn recordings(format: Format) -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let recorded = folder.path().join("recorded.mcap");
    let of = MessageType { name: "std_msgs/msg/String", hash: "", definition: "string data".to_owned() };
    let mut writer = BagWriter::create(&recorded, format).unwrap();
    let topic = writer.topic("/words", &of, OfferedQos::default()).unwrap();
    for at in 0..5 {
        writer.write(topic, 1000 * at, &[0, 1, 0, 0, 2, 0, 0, 0, b'a', 0]).unwrap();
    }
    writer.finish().unwrap();
    if format == Format::Mcap {
        return vec![std::fs::read(&recorded).unwrap()];
    }
    of_kind(&recorded, |path| path.extension().is_some_and(|end| end == "db3"))
}

/// Models that COLMAP wrote, binary and text: the three files of each, as `colmap_files` divides them.
fn models(data: &Path) -> Vec<Vec<u8>> {
    let kinds =
        ["colmap_model", "colmap_lenses"].iter().flat_map(|model| ["bin", "txt"].map(|kind| (model, kind)));
    let joined = kinds.map(|(model, kind)| {
        let parts = ["cameras", "images", "points3D"]
            .map(|name| std::fs::read(data.join(model).join(name).with_extension(kind)).unwrap());
        let lengths = [&parts[0], &parts[1]].map(|part| u16::try_from(part.len()).unwrap().to_le_bytes());
        let seed = [&kind.as_bytes()[..1], &lengths.concat(), &parts.concat()].concat();
        assert_eq!(colmap_files(&seed), (kind, [&*parts[0], &*parts[1], &*parts[2]]));
        seed
    });
    joined.collect()
}

/// A session file of two chunks.
fn session() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.session");
    example_session::write(&path, 2);
    std::fs::read(&path).unwrap()
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

/// Records, each its version and its payload without the checksum between them, and a segment.
fn records() -> Vec<Vec<u8>> {
    let options = PlaceOptions { keyframes: 3, landmarks: 60, ..PlaceOptions::default() };
    let place = Place::new(&options);
    let map = &place.map;
    let sealed = [
        seal("keyframes", &[], &map.keyframes[0].to_record()).unwrap(),
        seal("landmarks", &[], &map.landmarks[0].to_record()).unwrap(),
        seal("cross_covariances", &[], &map.cross_covariances[0].to_record()).unwrap(),
    ];
    let mut segment = SegmentWriter::default();
    segment.add(&map.keyframes[0]).unwrap();
    segment.add(&map.landmarks[0]).unwrap();
    let records = sealed.iter().map(|bytes| [&bytes[..1], &bytes[5..]].concat());
    records.chain([segment.finish()]).collect()
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
