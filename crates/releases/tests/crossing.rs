//! Programs that change one store at once.

use std::sync::Arc;
use std::time::Duration;

use map::MapContents;
use map::edit::remove_keyframes;
use object_store::memory::InMemory;
use object_store::throttle::{ThrottleConfig, ThrottledStore};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use releases::{CleanOptions, Note, PublishOptions, ReleaseStore, clean, fetch, publish, roll_back};
use testing::{Place, PlaceOptions};

const STORES: u64 = 100;
/// Longer than any publication here takes on a busy machine.
const GRACE: Duration = Duration::from_secs(5);

fn place(seed: u64) -> MapContents {
    let options = PlaceOptions { seed, keyframes: 4, landmarks: 60, ..PlaceOptions::default() };
    let mut contents = Place::new(&options).map;
    contents.sort();
    contents.info.identity = Some(contents.digest());
    contents
}

/// Every call takes a while of its own.
fn slow(seed: u64) -> ReleaseStore {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut wait = || Duration::from_micros(rng.random_range(0..3000));
    let config = ThrottleConfig {
        wait_get_per_call: wait(),
        wait_put_per_call: wait(),
        wait_delete_per_call: wait(),
        wait_list_per_call: wait(),
        ..ThrottleConfig::default()
    };
    ReleaseStore::over(Arc::new(ThrottledStore::new(InMemory::new(), config)), "memory")
}

/// A store with a release of each of two versions, whose segments are old by now, and the versions.
///
/// # Arguments
/// * `newest`: which of the two is released last.
async fn released(seed: u64, newest: usize) -> (ReleaseStore, [MapContents; 2]) {
    let store = slow(seed);
    let first = place(seed);
    let mut second = first.clone();
    remove_keyframes(&mut second, &std::iter::once(first.keyframes[0].id).collect());
    let versions = [first, second];
    for version in [1 - newest, newest] {
        publish(&store, versions[version].clone(), &PublishOptions::default(), |_| {}).await.unwrap();
    }
    tokio::time::sleep(GRACE + Duration::from_millis(1100)).await;
    (store, versions)
}

/// Up to a second, most of them short: on a busy machine a change takes hundreds of milliseconds.
fn pause_ms(seed: u64) -> u64 {
    seed * seed / 10
}

/// Cleans after some milliseconds; an error has words.
async fn clean_late(store: &ReleaseStore, pause_ms: u64) {
    let mut options = CleanOptions::default();
    (options.releases, options.grace) = (1, GRACE);
    tokio::time::sleep(Duration::from_millis(pause_ms)).await;
    if let Err(error) = clean(store, &options).await {
        assert!(!error.to_string().is_empty());
    }
}

/// In how many stores a change beside a clean succeeds.
async fn successes<F: Future<Output = bool> + Send + 'static>(change: impl Fn(u64) -> F) -> usize {
    let tasks: Vec<_> = (0..STORES).map(|seed| tokio::spawn(change(seed))).collect();
    let mut successes = 0;
    for task in tasks {
        successes += usize::from(task.await.unwrap());
    }
    successes
}

/// The segments of the former release are old when they are needed again.
async fn roll_back_beside_clean(seed: u64) -> bool {
    let (store, _) = released(seed, 1).await;
    let note = Note::default();
    let (rolled_back, ()) = tokio::join!(roll_back(&store, 1, &note), clean_late(&store, pause_ms(seed)));
    let newest = store.newest().await.unwrap().unwrap();
    let fetched = fetch(&store, &newest, None).await;
    assert!(fetched.is_ok(), "{seed}: the newest release lacks something: {:?}", fetched.err());
    assert!(rolled_back.is_ok() == (newest.number == 3), "{seed}: {rolled_back:?}");
    rolled_back.is_ok()
}

/// The segments of the new release are old, of a publication that was stopped before it had named them.
async fn publish_beside_clean(seed: u64) -> bool {
    let (store, [_, second]) = released(seed, 0).await;
    let settings = PublishOptions::default();
    let publishing = publish(&store, second, &settings, |_| {});
    let (published, ()) = tokio::join!(publishing, clean_late(&store, pause_ms(seed)));
    let listed = store.numbers().await.unwrap();
    for &number in &listed {
        let release = store.release(number).await.unwrap();
        let fetched = fetch(&store, &release, None).await;
        assert!(fetched.is_ok(), "{seed}: release {number} lacks something: {:?}", fetched.err());
    }
    assert!(published.is_ok() == listed.contains(&3), "{seed}: {published:?}, {listed:?}");
    if let Err(error) = &published {
        assert!(!error.to_string().is_empty());
    }
    published.is_ok()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_publication_beside_a_clean_is_refused_or_complete() {
    let published = successes(publish_beside_clean).await;
    println!("{published} of {STORES} were published, the others refused");
    assert!(published > 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollback_beside_a_clean_is_refused_or_complete() {
    let rolled_back = successes(roll_back_beside_clean).await;
    println!("{rolled_back} of {STORES} were rolled back, the others refused");
    assert!(rolled_back > 0);
}
