//! Files that are cut off or damaged: what is there is read, what is missing is told.

use bags::Bag;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::collections::HashSet;
use std::path::Path;

const FILES: [&str; 7] = [
    "excerpt_mcap/excerpt_mcap.mcap",
    "excerpt_zstd.mcap",
    "excerpt_ros1.mcap",
    "excerpt.bag",
    "excerpt_bz2.bag",
    "excerpt_db3/excerpt_db3.db3",
    "excerpt_packed/excerpt_packed.db3",
];
/// Cut files of each format; with seven files together 203.
const CUTS: usize = 29;

fn file(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)).unwrap()
}

/// Every message that can be read, with its topic and time, and whether damage was told.
fn read_all(bytes: &[u8]) -> (HashSet<(String, i64, Vec<u8>)>, bool) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    std::fs::write(&path, bytes).unwrap();
    let mut found = HashSet::new();
    let Ok(bag) = Bag::open(&path) else { return (found, true) };
    let mut told = !bag.damage().is_empty();
    for topic in bag.topics() {
        for message in &topic.messages {
            match bag.read(message.place) {
                Ok(bytes) => drop(found.insert((topic.name.clone(), message.log_ns, bytes))),
                Err(_) => told = true,
            }
        }
    }
    (found, told)
}

#[test]
fn a_file_that_is_cut_off_is_read_up_to_there() {
    let mut random = StdRng::seed_from_u64(14);
    for name in FILES {
        let whole = file(name);
        let (all, damaged) = read_all(&whole);
        assert!(!damaged, "{name}");
        let mut cuts: Vec<usize> = (0..CUTS).map(|_| random.random_range(0..whole.len() - 8)).collect();
        cuts.sort_unstable();
        let mut before = 0;
        for cut in cuts {
            let (found, told) = read_all(&whole[..cut]);
            assert!(told, "{name}, {cut} bytes: nothing is said");
            assert!(found.is_subset(&all), "{name}, {cut} bytes: a message that is not in the file");
            assert!(found.len() >= before || name.ends_with("db3"), "{name}, {cut} bytes: fewer messages");
            before = found.len();
        }
        // SQLite keeps its own bookkeeping; the others are written in order, and lose a compressed block (zstd: 128 KB).
        let (found, _) = read_all(&whole[..whole.len() * 9 / 10]);
        assert!(name.ends_with("db3") || found.len() * 2 > all.len(), "{name}: {}", found.len());
    }
}

#[test]
fn damaged_bytes_do_not_end_the_program() {
    let mut random = StdRng::seed_from_u64(15);
    for name in FILES {
        let whole = file(name);
        for _ in 0..CUTS {
            let mut damaged = whole.clone();
            let at = random.random_range(0..damaged.len());
            let end = (at + random.random_range(1..200)).min(damaged.len());
            damaged[at..end].fill_with(|| random.random());
            read_all(&damaged);
        }
    }
}

#[test]
fn a_chunk_that_is_missing_costs_its_messages_only() {
    for name in ["excerpt_ros1.mcap", "excerpt_bz2.bag"] {
        let whole = file(name);
        let (all, _) = read_all(&whole);
        let mut damaged = whole.clone();
        // In the middle of the first chunk, which is compressed and has a checksum.
        damaged[15_000..17_000].fill(0);
        let (found, told) = read_all(&damaged);
        assert!(told && found.is_subset(&all) && found.len() < all.len(), "{name}");
        assert!(found.len() * 4 > all.len(), "{name}: {} of {}", found.len(), all.len());
    }
}
