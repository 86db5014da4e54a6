//! Publishing is interrupted, by a full disk or by a kill: nothing is half-published, and the next one succeeds.

use map::MapContents;
use releases::{Outcome, PublishOptions, ReleaseStore, fetch, publish};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::time::Duration;
use testing::{Place, PlaceOptions};

const CHILD_STORE: &str = "RELEASES_TEST_CHILD";

/// A version of a map; the second differs from the first in all of its cells.
fn version(number: u64) -> MapContents {
    static FIRST: LazyLock<MapContents> = LazyLock::new(|| {
        let mut map = Place::new(&PlaceOptions { landmarks: 3000, ..PlaceOptions::default() }).map;
        map.sort();
        map
    });
    let mut map = FIRST.clone();
    map.info.version = number;
    for keyframe in &mut map.keyframes {
        keyframe.stamp_ns += number as i64;
    }
    map
}

async fn publish_version(store: &ReleaseStore, number: u64) -> Result<u64, releases::ReleaseError> {
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = 6;
    Ok(match publish(store, version(number), &options, |_| {}).await? {
        Outcome::Published(published) => published.release.number,
        Outcome::Unchanged { number } => number,
    })
}

/// A child process that publishes the second version; `before` is a shell command that is run first.
fn child(before: &str, store: &Path) -> Command {
    let mut command = Command::new("sh");
    let program = std::env::current_exe().unwrap();
    let run = format!(
        "{before} exec '{}' interrupted::child_that_publishes --exact --nocapture",
        program.display()
    );
    command.args(["-c", &run]).env(CHILD_STORE, store).stdin(Stdio::null());
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Not a law by itself: what the child processes of the others do.
#[tokio::test]
async fn child_that_publishes() {
    let Ok(store) = std::env::var(CHILD_STORE) else { return };
    println!("begins");
    match publish_version(&ReleaseStore::open(&store).unwrap(), 2).await {
        Ok(number) => println!("published {number}"),
        Err(error) => println!("refused: {:#}", chain(&error)),
    }
}

fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

/// A store with the first version, in a folder.
async fn first(folder: &Path) -> ReleaseStore {
    let store = ReleaseStore::open(folder.to_str().unwrap()).unwrap();
    assert_eq!(publish_version(&store, 1).await.unwrap(), 1);
    store
}

/// Only the first release is there, and whole.
async fn assert_only_the_first(store: &ReleaseStore) {
    assert_eq!(store.numbers().await.unwrap(), [1]);
    let newest = store.newest().await.unwrap().unwrap();
    let fetched = fetch(store, &newest, None).await.unwrap();
    assert_eq!(fetched.keyframes, version(1).keyframes);
}

/// The second version is published, and whole.
async fn assert_the_second_follows(store: &ReleaseStore) {
    assert_eq!(publish_version(store, 2).await.unwrap(), 2);
    let newest = store.newest().await.unwrap().unwrap();
    assert_eq!(fetch(store, &newest, None).await.unwrap().keyframes, version(2).keyframes);
}

#[tokio::test]
async fn on_a_full_disk_nothing_is_published_and_it_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let (mut refused, mut published) = (0, 0);
    // Files may grow to so many blocks of 512 bytes; beyond, writing fails as on a full disk.
    for blocks in [0, 1, 4, 100, 400, 100_000] {
        let place = folder.path().join(blocks.to_string());
        let store = first(&place).await;
        let output = child(&format!("trap '' XFSZ; ulimit -f {blocks};"), &place).output().unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        if said.contains("published 2") {
            published += 1;
        } else {
            let expected = format!("refused: {}", place.display());
            assert!(
                said.contains(&expected) && said.contains("cannot be written"),
                "{blocks} blocks: {said}"
            );
            assert_only_the_first(&store).await;
            refused += 1;
        }
        assert_the_second_follows(&store).await;
    }
    assert!(refused >= 3 && published >= 1, "{refused} refused, {published} published");
}

#[tokio::test]
async fn a_publisher_that_is_killed_leaves_the_former_release() {
    let folder = tempfile::tempdir().unwrap();
    let mut interrupted = 0;
    for step in 0..8_u64 {
        let place = folder.path().join(step.to_string());
        let store = first(&place).await;
        let mut publishing = child("", &place).spawn().unwrap();
        let mut lines = std::io::BufRead::lines(std::io::BufReader::new(publishing.stdout.take().unwrap()));
        lines.find(|line| line.as_ref().unwrap().contains("begins")).unwrap().unwrap();
        std::thread::sleep(Duration::from_millis(12 * step));
        publishing.kill().unwrap(); // SIGKILL
        publishing.wait().unwrap();
        let is_published = lines.any(|line| line.unwrap_or_default().contains("published"));
        if store.numbers().await.unwrap().len() == 1 {
            assert!(!is_published, "what was acknowledged is gone");
            assert_only_the_first(&store).await;
            interrupted += 1;
        }
        assert_the_second_follows(&store).await;
    }
    assert!(interrupted > 0);
}
