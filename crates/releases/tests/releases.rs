//! Releases in a local folder: nothing is lost, nothing is sent twice, one publisher wins, damage is named.

use map::MapContents;
use map::edit::{keyframes_where, remove_keyframes};
use releases::{
    CleanOptions, Note, Outcome, PublishOptions, Published, Release, ReleaseCache, ReleaseChoice,
    ReleaseError, ReleaseSource, ReleaseStore, ReleasedCell, SegmentName, clean, fetch, fetch_cell, publish,
    roll_back,
};
#[cfg(feature = "signing")]
use releases::{ReleaseKey, SigningKey};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tempfile::TempDir;
use testing::{Place, PlaceOptions, add_images, add_second_kind};

struct Scratch {
    folder: TempDir,
    store: ReleaseStore,
}

impl Scratch {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = ReleaseStore::open(folder.path().join("city").to_str().unwrap()).unwrap();
        Self { folder, store }
    }

    fn files(&self, of: &str) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(self.folder.path().join("city").join(of)).unwrap();
        let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
        files.sort();
        files
    }
}

/// A map as a store returns it: sorted, with identity and version.
fn place(seed: u64) -> MapContents {
    let mut contents = Place::new(&PlaceOptions { seed, ..PlaceOptions::default() }).map;
    contents.sort();
    contents.info.identity = Some(contents.digest());
    contents.info.version = 1;
    contents
}

fn small_cells() -> PublishOptions {
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = 6;
    options
}

async fn published(store: &ReleaseStore, contents: &MapContents) -> Published {
    match publish(store, contents.clone(), &small_cells(), |_| {}).await.unwrap() {
        Outcome::Published(published) => *published,
        Outcome::Unchanged { number } => panic!("release {number} has it already"),
    }
}

/// Without the keyframes of the highest id, as after an edit.
fn without_the_last(contents: &MapContents) -> MapContents {
    let last = contents.keyframes.last().unwrap().id;
    let mut less = contents.clone();
    let removed = keyframes_where(&less, |keyframe| keyframe.id == last);
    remove_keyframes(&mut less, &removed);
    less.sort();
    less.info.version += 1;
    less
}

fn causes(error: &ReleaseError) -> String {
    let error: &dyn std::error::Error = error;
    let all: Vec<_> =
        std::iter::successors(Some(error), |error| error.source()).map(ToString::to_string).collect();
    all.join(": ")
}

#[tokio::test]
async fn a_map_comes_back_whole() {
    let scratch = Scratch::new();
    let contents = place(1);
    let Published { release, sent, bytes_sent } = published(&scratch.store, &contents).await;
    // Each with its border and its coarse landmarks.
    assert_eq!((release.number, release.map.version, sent), (1, 1, 3 * release.cells.len()));
    assert!(release.cells.len() >= 5 && bytes_sent > release.bytes());
    assert!(release.cells.iter().all(|cell| cell.keyframes <= 6));
    assert_eq!(scratch.store.newest().await.unwrap().unwrap(), release);
    assert_eq!(fetch(&scratch.store, &release, None).await.unwrap(), contents);
    let again = publish(&scratch.store, contents.clone(), &small_cells(), |_| {}).await.unwrap();
    assert_eq!(again, Outcome::Unchanged { number: 1 });
}

#[tokio::test]
async fn added_features_and_images_come_back_and_are_sent_once() {
    let scratch = Scratch::new();
    let plain = place(1);
    let first = published(&scratch.store, &plain).await;
    let mut contents = plain.clone();
    add_second_kind(&mut contents, "other-1");
    add_images(&mut contents);
    contents.info.version = 2;
    let second = published(&scratch.store, &contents).await;
    let cells = second.release.cells.len();
    // What the primary kind has is there already, and so is what serves a cell by itself.
    assert_eq!((first.release.schema, second.release.schema, second.sent), (9, 10, 2 * cells));
    assert_eq!(second.release.bytes(), first.release.bytes() + second.bytes_sent);
    assert_eq!(fetch(&scratch.store, &second.release, None).await.unwrap(), contents);
    let difference = first.release.difference(&second.release);
    assert_eq!((difference.changed.len(), difference.bytes), (cells, second.bytes_sent));
    // Nothing of it concerns what a robot holds.
    let change = second.release.change.as_ref().unwrap();
    assert!(change.changed.is_empty() && change.moved.is_empty() && change.removed.is_empty(), "{change:?}");
    // A cell by itself is the one of the map without them.
    for cell in &second.release.cells {
        let [former, now] = [&first.release, &second.release]
            .map(|release| fetch_cell(&scratch.store, release, cell.cell, None));
        let (former, mut now) = (former.await.unwrap(), now.await.unwrap());
        now.contents.info.version = former.contents.info.version;
        assert_eq!(former, now);
    }
    // Back to the map without them, and forward again.
    for (number, map) in [(1, &plain), (2, &contents)] {
        let Outcome::Published(back) = roll_back(&scratch.store, number, &Note::default()).await.unwrap()
        else {
            panic!("release {number} is the newest")
        };
        let mut fetched = fetch(&scratch.store, &back.release, None).await.unwrap();
        fetched.info.version = map.info.version;
        assert_eq!(fetched, *map);
    }
}

#[tokio::test]
async fn only_cells_that_changed_are_sent() {
    let scratch = Scratch::new();
    let contents = place(2);
    let first = published(&scratch.store, &contents).await.release;
    let less = without_the_last(&contents);
    let second = published(&scratch.store, &less).await;
    let difference = first.difference(&second.release);
    let differing = difference.changed.len() + difference.added.len();
    assert!(differing >= 1 && second.sent >= differing && second.sent < 3 * second.release.cells.len());
    assert!(difference.bytes <= second.bytes_sent);
    assert!(difference.unchanged > 0);
    assert_eq!((second.release.number, second.release.map.version), (2, 2));
    assert_eq!(fetch(&scratch.store, &second.release, None).await.unwrap(), less);
}

#[tokio::test]
async fn a_rollback_is_a_new_release_with_a_new_version() {
    let scratch = Scratch::new();
    let contents = place(3);
    published(&scratch.store, &contents).await;
    published(&scratch.store, &without_the_last(&contents)).await;
    let Outcome::Published(back) = roll_back(&scratch.store, 1, &Note::default()).await.unwrap() else {
        panic!("nothing changed")
    };
    assert_eq!((back.release.number, back.release.map.version, back.release.rolled_back_to), (3, 3, Some(1)));
    let mut fetched = fetch(&scratch.store, &back.release, None).await.unwrap();
    assert_eq!(fetched.info.version, 3);
    fetched.info.version = 1;
    assert_eq!(fetched, contents);
    assert_eq!(
        roll_back(&scratch.store, 1, &Note::default()).await.unwrap(),
        Outcome::Unchanged { number: 3 }
    );
    assert!(matches!(
        roll_back(&scratch.store, 9, &Note::default()).await,
        Err(ReleaseError::NoRelease { number: 9, .. })
    ));
    // What is published next comes after it, though its own version is older.
    let next = published(&scratch.store, &without_the_last(&contents)).await.release;
    assert_eq!((next.number, next.map.version), (4, 4));
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_publishers_exactly_one_is_first() {
    race(&Scratch::new().store, 15).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "more rounds"]
async fn of_two_publishers_exactly_one_is_first_in_forty_rounds() {
    race(&Scratch::new().store, 40).await;
}

/// Against an S3 store, for example moto: `RELEASES_PLACE=s3://bucket/race AWS_ENDPOINT=http://127.0.0.1:5000 AWS_ALLOW_HTTP=true
/// AWS_REGION=us-east-1 AWS_ACCESS_KEY_ID=a AWS_SECRET_ACCESS_KEY=b cargo test -p driftless-releases --features cloud -- --ignored`
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs an object store in RELEASES_PLACE"]
async fn of_two_publishers_in_a_cloud_exactly_one_is_first() {
    let place = std::env::var("RELEASES_PLACE").expect("RELEASES_PLACE is not set");
    race(&ReleaseStore::open(&place).unwrap(), 100).await;
}

/// Two publishers at once, so many rounds.
async fn race(store: &ReleaseStore, rounds: usize) {
    let contents = place(4);
    let mut versions = vec![contents.clone()];
    for _ in 0..2 {
        versions.push(without_the_last(versions.last().unwrap()));
    }
    published(store, &contents).await;
    let mut conflicts = 0;
    for round in 0..rounds {
        let tasks = [1, 2].map(|version| {
            // Both differ from the present release and from each other.
            let (store, mut map) = (store.clone(), versions[version].clone());
            map.info.sigma_px = 1.0 + round as f64 * 1e-3;
            tokio::spawn(async move { publish(&store, map, &small_cells(), |_| {}).await })
        });
        let mut numbers = Vec::new();
        for task in tasks {
            match task.await.unwrap() {
                Ok(Outcome::Published(published)) => numbers.push(published.release.number),
                Ok(Outcome::Unchanged { number }) => panic!("{number} is no other map"),
                Err(ReleaseError::Conflict { .. }) => conflicts += 1,
                Err(error) => panic!("{}", causes(&error)),
            }
        }
        assert!(!numbers.is_empty(), "round {round}: nobody won");
        assert!(numbers.len() == 1 || numbers[0] != numbers[1], "round {round}: both won");
        let newest = store.newest().await.unwrap().unwrap();
        assert_eq!(numbers.iter().max(), Some(&newest.number));
        fetch(store, &newest, None).await.unwrap();
    }
    let numbers = store.numbers().await.unwrap();
    assert_eq!(numbers, (1..=numbers.len() as u64).collect::<Vec<_>>(), "no number is left out");
    assert_eq!(numbers.len() + conflicts, 2 * rounds + 1);
    println!("{conflicts} of {} were told that another was first", 2 * rounds);
}

#[tokio::test]
async fn another_map_is_refused() {
    let scratch = Scratch::new();
    published(&scratch.store, &place(5)).await;
    let error = publish(&scratch.store, place(6), &small_cells(), |_| {}).await.unwrap_err();
    assert!(
        matches!(error, ReleaseError::OtherMap { .. }) && error.to_string().contains("publish it elsewhere")
    );
}

#[tokio::test]
async fn damage_is_named_and_a_torn_upload_changes_nothing() {
    let scratch = Scratch::new();
    let contents = place(7);
    let release = published(&scratch.store, &contents).await.release;
    // An upload that was stopped before its release was put.
    let second = published(&scratch.store, &without_the_last(&contents)).await.release;
    std::fs::remove_file(&scratch.files("releases")[1]).unwrap();
    assert_eq!(scratch.store.newest().await.unwrap().unwrap(), release);
    assert_eq!(fetch(&scratch.store, &release, None).await.unwrap(), contents);
    assert!(matches!(scratch.store.release(2).await, Err(ReleaseError::NoRelease { number: 2, .. })));
    drop(second);

    let path = scratch.folder.path().join("city/segments").join(&release.cells[1].segment.sha256);
    let bytes = std::fs::read(&path).unwrap();
    let fetched = || async { causes(&fetch(&scratch.store, &release, None).await.unwrap_err()) };
    for at in [0, 40, bytes.len() / 2, bytes.len() - 1] {
        let mut flipped = bytes.clone();
        flipped[at] ^= 4;
        std::fs::write(&path, flipped).unwrap();
        let said = fetched().await;
        assert!(said.contains("is damaged") && said.contains(&release.cells[1].segment.sha256), "{said}");
    }
    std::fs::write(&path, &bytes[..bytes.len() - 7]).unwrap();
    assert!(fetched().await.contains("is damaged"));
    std::fs::write(&path, [bytes.as_slice(), &[0; 9]].concat()).unwrap();
    assert!(fetched().await.contains("is damaged"));
    std::fs::remove_file(&path).unwrap();
    assert!(fetched().await.contains("cannot be read"));
    std::fs::write(&path, &bytes).unwrap();

    let manifest = &scratch.files("releases")[0];
    let text = std::fs::read_to_string(manifest).unwrap();
    for (from, to, says) in [
        ("\"schema\": 9", "\"schema\": 6", "it has schema 6, this program reads 8 to 10"),
        ("\"number\": 1", "\"number\": 3", "it says that it is release 3"),
        ("\"sha256\": \"", "\"sha256\": \"../", "has the segment"),
        ("\"keyframes\"", "\"frames\"", "unknown field"),
    ] {
        std::fs::write(manifest, text.replacen(from, to, 1)).unwrap();
        let said = causes(&scratch.store.newest().await.unwrap_err());
        assert!(said.contains(says), "{said}");
    }
    let other = text.replacen("\"sigma_px\": 1.0", "\"sigma_px\": 2.0", 1);
    assert_ne!(other, text);
    std::fs::write(manifest, other).unwrap();
    let forged = scratch.store.newest().await.unwrap().unwrap();
    assert!(causes(&fetch(&scratch.store, &forged, None).await.unwrap_err()).contains("give the digest"));
}

#[tokio::test]
async fn what_no_release_needs_is_removed_after_the_grace_time() {
    let scratch = Scratch::new();
    let contents = place(8);
    let first = published(&scratch.store, &contents).await.release;
    let second = published(&scratch.store, &without_the_last(&contents)).await.release;
    let mut options = CleanOptions::default();
    options.releases = 1;
    options.dry_run = true;
    let young = clean(&scratch.store, &options).await.unwrap();
    options.dry_run = false;
    assert_eq!((young.releases, young.segments.len()), (vec![1], 0), "they are within the grace time");
    options.grace = Duration::ZERO;
    let cleaned = clean(&scratch.store, &options).await.unwrap();
    let named = |release: &Release| -> BTreeSet<SegmentName> {
        let of_cell = |cell: &ReleasedCell| {
            let serving = cell.serving.clone();
            [cell.segment.clone(), serving.border, serving.coarse]
        };
        release.cells.iter().flat_map(of_cell).collect()
    };
    let kept = named(&second);
    let only_first: Vec<_> = named(&first).into_iter().filter(|segment| !kept.contains(segment)).collect();
    assert_eq!(cleaned.segments.len(), only_first.len());
    assert_eq!(cleaned.bytes, only_first.iter().map(|segment| segment.bytes).sum::<u64>());
    assert_eq!(scratch.store.numbers().await.unwrap(), [2]);
    fetch(&scratch.store, &second, None).await.unwrap();
    assert_eq!(clean(&scratch.store, &options).await.unwrap(), releases::Cleaned::default());
}

#[tokio::test]
async fn a_cache_serves_without_the_store_and_heals() {
    let scratch = Scratch::new();
    let contents = place(9);
    let first = published(&scratch.store, &contents).await.release;
    let folder = scratch.folder.path().join("cache");
    let source = ReleaseSource::open(scratch.store.clone(), &folder).unwrap();
    let cache = source.cache.clone();
    assert!(cache.release().is_none());
    fetch(&scratch.store, &first, Some(&cache)).await.unwrap();
    source.keep(&first).await;

    let away = |is_away: bool| {
        let (here, there) = (scratch.folder.path().join("city"), scratch.folder.path().join("away"));
        let (from, to): (&Path, &Path) = if is_away { (&here, &there) } else { (&there, &here) };
        std::fs::rename(from, to).unwrap();
    };
    away(true);
    assert_eq!(cache.release().unwrap(), first);
    assert!(source.note(&first).await, "it is noted already");
    assert_eq!(fetch(&scratch.store, &first, Some(&cache)).await.unwrap(), contents);
    let damaged = folder.join("segments").join(&first.cells[0].segment.sha256);
    std::fs::write(&damaged, b"something else").unwrap();
    assert!(fetch(&scratch.store, &first, Some(&cache)).await.is_err());
    away(false);
    assert_eq!(fetch(&scratch.store, &first, Some(&cache)).await.unwrap(), contents);
    assert!(std::fs::read(&damaged).unwrap().starts_with(b"driftless segment"), "it was fetched again");

    // The next release leaves nothing of the former one behind.
    let second = published(&scratch.store, &without_the_last(&contents)).await.release;
    fetch(&scratch.store, &second, Some(&cache)).await.unwrap();
    source.keep(&second).await;
    assert_eq!(std::fs::read_dir(folder.join("segments")).unwrap().count(), second.cells.len());
    std::fs::write(folder.join("release.json"), "{}").unwrap();
    assert!(cache.release().is_none());
}

#[cfg(feature = "signing")]
#[tokio::test]
async fn a_release_without_the_right_signature_is_refused() {
    let scratch = Scratch::new();
    let keys = ["ours", "theirs"].map(|name| {
        let file = scratch.folder.path().join(name);
        let public = SigningKey::generate(&file).unwrap();
        assert!(SigningKey::generate(&file).is_err(), "a key was written over");
        let key: ReleaseKey = public.to_str().unwrap().parse().unwrap();
        (file, key)
    });
    let [(ours, our_key), (theirs, _)] = keys;
    let reading = scratch.store.clone().signed_with(our_key);
    let signing = |file: &Path| scratch.store.clone().signing_with(SigningKey::read(file, None).unwrap());
    let contents = place(10);
    let release = published(&signing(&ours), &contents).await.release;
    assert_eq!(reading.newest().await.unwrap().unwrap(), release);
    assert_eq!(scratch.store.newest().await.unwrap().unwrap(), release, "others need no key");

    // Not signed, signed by others, the signature of another release, a changed release.
    let less = without_the_last(&contents);
    let refused = async || causes(&reading.newest().await.unwrap_err());
    published(&scratch.store, &less).await;
    assert!(refused().await.contains("it has no signature"));
    let second = scratch.files("releases")[1].clone();
    std::fs::remove_file(&second).unwrap();
    published(&signing(&theirs), &less).await;
    assert!(refused().await.contains("is not signed with the key"));
    std::fs::remove_file(&second).unwrap();
    published(&signing(&ours), &less).await;
    assert_eq!(reading.newest().await.unwrap().unwrap().number, 2);
    let signed = std::fs::read(&second).unwrap();
    std::fs::write(
        &second,
        String::from_utf8(signed.clone()).unwrap().replace("\"version\": 2", "\"version\": 9"),
    )
    .unwrap();
    assert!(refused().await.contains("it has no signature"));
    // A release under another number is the file of its own number.
    std::fs::write(scratch.folder.path().join("city/releases/00000000000000000003.json"), &signed).unwrap();
    assert!(refused().await.contains("it says that it is release 2"));
    std::fs::remove_file(scratch.folder.path().join("city/releases/00000000000000000003.json")).unwrap();
    std::fs::write(&second, &signed).unwrap();
    assert_eq!(reading.newest().await.unwrap().unwrap().number, 2);

    // Signatures go with their releases.
    let mut options = CleanOptions::default();
    options.releases = 1;
    options.grace = Duration::ZERO;
    let before = scratch.files("signatures").len();
    clean(&scratch.store, &options).await.unwrap();
    assert_eq!(scratch.files("signatures").len(), before - 1);
    assert!("nonsense".parse::<ReleaseKey>().is_err());
}

#[test]
fn places_are_understood_or_named() {
    for place in ["city", "/srv/city", "file:///srv/city"] {
        assert_eq!(ReleaseStore::open(place).unwrap().place(), place);
    }
    for place in ["http//x", "ftp://host/city", "nonsense://x"] {
        if let Err(error) = ReleaseStore::open(place) {
            assert!(error.to_string().contains(place), "{error}");
        }
    }
    assert!(ReleaseStore::open("ftp://host/city").is_err());
}

#[cfg(unix)]
#[test]
fn a_pipe_in_the_cache_is_no_release() {
    let folder = tempfile::tempdir().unwrap();
    let cache = ReleaseCache::open(folder.path()).unwrap();
    let pipe = folder.path().join("release.json");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    // Opened, it would block until somebody writes.
    assert!(cache.release().is_none());
}

#[tokio::test]
async fn a_release_that_was_read_is_noted_without_the_store() {
    let scratch = Scratch::new();
    let contents = place(11);
    published(&scratch.store, &contents).await;
    let second = published(&scratch.store, &without_the_last(&contents)).await.release;
    let source = ReleaseSource::open(scratch.store.clone(), &scratch.folder.path().join("cache")).unwrap();
    assert_eq!(source.newest().await.unwrap().unwrap(), second);
    // What else is read of the store is not what is noted.
    let first = source.store.release(1).await.unwrap();
    std::fs::rename(scratch.folder.path().join("city"), scratch.folder.path().join("away")).unwrap();
    assert!(source.clone().note(&second).await && !source.note(&first).await);
    assert_eq!(source.cache.release().unwrap(), second);

    // A server that starts with what is in the cache needs the store for nothing either.
    let restarted = ReleaseSource::open(scratch.store.clone(), &scratch.folder.path().join("cache")).unwrap();
    assert_eq!(restarted.newest_or_cached().await.unwrap(), second);
    assert!(restarted.note(&second).await);
    assert_eq!(restarted.cache.release().unwrap(), second);
}

/// A server that was told to serve one release serves no other one that it happens to have.
#[tokio::test]
async fn a_cached_release_is_served_where_it_is_the_one_that_was_chosen() {
    let scratch = Scratch::new();
    let release = published(&scratch.store, &place(1)).await.release;
    let cache = scratch.folder.path().join("cache");
    let source = ReleaseSource::open(scratch.store.clone(), &cache).unwrap();
    source.keep(&release).await;
    let missing = source.clone().following(ReleaseChoice::Number(9)).newest_or_cached().await;
    assert!(matches!(missing, Err(ReleaseError::NoRelease { .. })), "{missing:?}");
    // The store is away: its folder is a file now.
    let city = scratch.folder.path().join("city");
    std::fs::rename(&city, scratch.folder.path().join("away")).unwrap();
    std::fs::write(&city, "").unwrap();
    for (choice, is_served) in [
        (ReleaseChoice::Newest, true),
        (ReleaseChoice::Number(1), true),
        (ReleaseChoice::NewestCandidate, true),
        (ReleaseChoice::Number(2), false),
        (ReleaseChoice::Candidate(1), false),
    ] {
        let served = source.clone().following(choice).newest_or_cached().await;
        assert_eq!(served.is_ok(), is_served, "{choice}: {served:?}");
    }
}

/// What was noted without a key, or of another store, is served only where nothing has to be signed, and by that store.
#[cfg(feature = "signing")]
#[tokio::test]
async fn a_cached_release_is_of_the_store_and_signed_where_it_must_be() {
    let scratch = Scratch::new();
    let secret = scratch.folder.path().join("city.key");
    let public = SigningKey::generate(&secret).unwrap();
    let key: ReleaseKey = public.to_str().unwrap().parse().unwrap();
    let signing = scratch.store.clone().signing_with(SigningKey::read(&secret, None).unwrap());
    let contents = place(1);
    let release = published(&signing, &contents).await.release;
    let cache = scratch.folder.path().join("cache");
    let open = |store: ReleaseStore| ReleaseSource::open(store, &cache).unwrap();
    let (plain, verifying) = (open(scratch.store.clone()), open(scratch.store.clone().signed_with(key)));

    // A newer one without a signature does not bring the cached one back.
    verifying.keep(&release).await;
    published(&scratch.store, &without_the_last(&contents)).await;
    let refused = verifying.newest_or_cached().await;
    assert!(matches!(refused, Err(ReleaseError::NotSigned { .. })), "{refused:?}");

    // The store is away.
    let city = scratch.folder.path().join("city");
    let away = |is_away: bool| {
        let there = scratch.folder.path().join("away");
        if is_away {
            std::fs::rename(&city, &there).unwrap();
            std::fs::write(&city, "").unwrap();
        } else {
            std::fs::remove_file(&city).unwrap();
            std::fs::rename(&there, &city).unwrap();
        }
    };
    away(true);
    assert_eq!(verifying.newest_or_cached().await.unwrap(), release);
    let noted = std::fs::read_to_string(cache.join("release.json")).unwrap();
    let changed = noted.replace("\\\"sigma_px\\\": 1.0", "\\\"sigma_px\\\": 2.0");
    assert_ne!(changed, noted);
    std::fs::write(cache.join("release.json"), changed).unwrap();
    assert!(verifying.newest_or_cached().await.is_err(), "its file was changed");
    assert!(plain.newest_or_cached().await.is_ok());
    away(false);
    plain.keep(&release).await;
    away(true);
    assert!(plain.newest_or_cached().await.is_ok());
    assert!(verifying.newest_or_cached().await.is_err(), "it was noted without its signature");
    let elsewhere = ReleaseStore::open(city.join("elsewhere").to_str().unwrap()).unwrap();
    assert!(open(elsewhere).newest_or_cached().await.is_err());

    // A cache of an earlier program has the release alone.
    let text = serde_json::to_vec_pretty(&release).unwrap();
    std::fs::write(cache.join("release.json"), text).unwrap();
    assert_eq!(plain.newest_or_cached().await.unwrap().digest, release.digest);
    assert!(verifying.newest_or_cached().await.is_err(), "it has no signature");
}
