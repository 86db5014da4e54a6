//! A damaged map is read whole or refused in words, soon, and without growing memory.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use map::store::StoredImages;
use map::{MapContents, StoreError, store};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use testing::{Place, PlaceOptions, add_images, add_second_kind, copy_folder};

const DAMAGES: usize = 500;
/// A small map is read in milliseconds.
const SOON: Duration = Duration::from_secs(5);

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Damages one file in one way, and says how.
fn damage(folder: &Path, rng: &mut StdRng) -> String {
    let files = files(folder);
    // The segments have most of the bytes, the manifest most of the meaning.
    let file = &files[rng.random_range(0..files.len())];
    let mut bytes = std::fs::read(file).unwrap();
    let name = file.strip_prefix(folder).unwrap().display().to_string();
    let kind = rng.random_range(0..6);
    if bytes.is_empty() && kind != 3 {
        std::fs::write(file, [7]).unwrap();
        return format!("a byte in the empty {name}");
    }
    let at = if bytes.is_empty() { 0 } else { rng.random_range(0..bytes.len()) };
    let how = match kind {
        0 | 1 => {
            bytes[at] ^= 1 << rng.random_range(0..8);
            format!("bit flipped in byte {at} of {name}")
        }
        2 => {
            let cut = if rng.random_bool(0.5) { bytes.len() * 99 / 100 } else { at };
            bytes.truncate(cut);
            format!("{name} truncated to {cut} bytes")
        }
        3 => {
            std::fs::remove_file(file).unwrap();
            return format!("{name} removed");
        }
        4 => {
            let page = at / 4096 * 4096;
            let end = (page + 4096).min(bytes.len());
            bytes[page..end].fill(0);
            format!("page at {page} of {name} zeroed")
        }
        _ => {
            let end = (at + rng.random_range(1..64)).min(bytes.len());
            bytes[at..end].iter_mut().for_each(|byte| *byte = rng.random());
            format!("bytes {at} to {end} of {name} overwritten")
        }
    };
    std::fs::write(file, bytes).unwrap();
    how
}

/// Resident memory of this process, bytes.
#[cfg(target_os = "linux")]
fn memory() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm").unwrap();
    pages.split(' ').nth(1).unwrap().parse::<u64>().unwrap() * 4096
}

#[cfg(not(target_os = "linux"))]
fn memory() -> u64 {
    0
}

fn read_whole(path: &Path) -> Result<MapContents, StoreError> {
    Ok(store::load_map(path)?.contents)
}

fn read_by_landmark(path: &Path) -> Result<MapContents, StoreError> {
    let (mut stored, mut landmarks) = store::open_map(path)?;
    landmarks.read(0, |landmark| stored.contents.landmarks.push(landmark))?;
    landmarks.read(1, |landmark| stored.contents.added_features[0].landmarks.push(landmark))?;
    let mut images = StoredImages::open(path)?;
    let keyframes: Vec<u64> = images.keyframes().collect();
    for keyframe in keyframes {
        stored.contents.images.extend(images.read(keyframe)?);
    }
    Ok(stored.contents)
}

#[test]
fn every_damage_is_noticed_or_harmless() {
    let directory = tempfile::tempdir().unwrap();
    let (whole, damaged) = (directory.path().join("whole"), directory.path().join("damaged"));
    let place = Place::new(&PlaceOptions { keyframes: 6, landmarks: 80, ..PlaceOptions::default() });
    let mut contents = place.map.clone();
    add_second_kind(&mut contents, "other-1");
    add_images(&mut contents);
    store::save_map(&whole, &contents, false).unwrap();
    let original: MapContents = store::load_map(&whole).unwrap().contents;
    let mut rng = StdRng::seed_from_u64(11);
    let (mut refused, mut started_with) = (0, 0);
    for round in 0..DAMAGES {
        let _ = std::fs::remove_dir_all(&damaged);
        copy_folder(&whole, &damaged);
        let how = damage(&damaged, &mut rng);
        let started = Instant::now();
        let read = if round % 2 == 0 { read_whole } else { read_by_landmark };
        match read(&damaged) {
            Ok(contents) => assert_eq!(contents, original, "{how}"),
            Err(error) => {
                refused += 1;
                let said = error.to_string();
                assert!(said.contains("damaged/") || said.contains("damaged "), "{how}: {said}");
                let in_words = matches!(
                    error,
                    StoreError::Damaged { .. } | StoreError::Unfinished { .. } | StoreError::Schema { .. }
                );
                assert!(in_words, "{how}: {said}");
            }
        }
        assert!(started.elapsed() < SOON, "{how}: {:?}", started.elapsed());
        if round == DAMAGES / 10 {
            started_with = memory();
        }
    }
    // Flipped bits in the manifest's names and numbers, and in files that nothing is read from, are few.
    assert!(refused > DAMAGES / 2, "{refused} of {DAMAGES} refused");
    let grown = memory().saturating_sub(started_with);
    assert!(grown < 64 << 20, "{grown} bytes more after {DAMAGES} damaged maps");
    // The map can be made anew over any damage.
    let saved = store::save_map(&damaged, &place.map, true).unwrap();
    assert!(saved.version >= 1);
    assert_eq!(store::load_map(&damaged).unwrap().contents.keyframes, original.keyframes);
}

#[test]
fn a_damaged_map_says_what_and_what_to_do() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("hall.db");
    let place = Place::new(&PlaceOptions { keyframes: 4, landmarks: 40, ..PlaceOptions::default() });
    store::save_map(&path, &place.map, false).unwrap();
    let file = path.join("version-1.segments");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() * 99 / 100]).unwrap();
    let said = store::load_map(&path).unwrap_err().to_string();
    for part in ["hall.db", "version-1.segments", "bytes", "backup", "again"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    // A damaged map is replaced by the next version of the same map.
    let saved = store::save_map(&path, &place.map, true).unwrap();
    assert_eq!((saved.version, saved.identity), (2, place.map.digest()));
}
