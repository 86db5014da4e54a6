//! When the notice of a new version leaves: robots wait for it for 2 s after the first answer of that version.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use map::difference::VersionChange;
use map_server::ServerState;
use map_server::state::{StateError, StateStore};
use tokio::runtime::Handle;

use super::*;

/// The next version of a map, of which a keyframe has moved.
fn next_version(place: &Place) -> Arc<LoadedMap> {
    let mut contents = place.map.clone();
    contents.info.version += 1;
    contents.keyframes[3].global_from_keyframe.pose.translation.x += 0.02;
    Arc::new(LoadedMap::from_contents(contents).unwrap())
}

/// Subscribes, and waits until the server knows of it.
async fn changes(
    scene: &Scene,
) -> zenoh::pubsub::Subscriber<zenoh::handlers::FifoChannelHandler<zenoh::sample::Sample>> {
    let news = scene.client.declare_subscriber("map/hall/changes").await.unwrap();
    let publisher = scene.serving.declare_publisher("map/hall/changes").await.unwrap();
    while !publisher.matching_status().await.unwrap().matching() {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    news
}

/// A disk that takes its time.
#[derive(Default)]
struct Disk {
    begun: AtomicUsize,
    done: AtomicUsize,
}

impl Disk {
    const WRITING: Duration = Duration::from_secs(1);
}

/// A database on that disk.
struct OnDisk(Arc<Disk>);

impl StateStore for OnDisk {
    fn get(&self, _: &str) -> Result<Option<Vec<u8>>, StateError> {
        Ok(None)
    }

    fn set(&self, _: &str, _: &[u8]) -> Result<(), StateError> {
        let OnDisk(disk) = self;
        // What is served from the start is told to nobody.
        if disk.begun.fetch_add(1, Ordering::SeqCst) > 0 {
            std::thread::sleep(Disk::WRITING);
        }
        disk.done.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

/// Replaces the map of a scene.
///
/// # Arguments
/// * `answers`: called as soon as the next version answers.
///
/// # Returns
/// How long after that the notice came, and what was returned then.
async fn replaced<T: Send>(
    scene: &Scene,
    next: Arc<LoadedMap>,
    answers: impl FnOnce() -> T + Send,
) -> (Duration, T) {
    let news = changes(scene).await;
    let version = next.info().version;
    let told = tokio::spawn(async move {
        news.recv_async().await.unwrap();
        Instant::now()
    });
    let server = &scene.server;
    let (since, answered) = tokio::task::block_in_place(|| {
        std::thread::scope(|scope| {
            let answering = scope.spawn(move || {
                while server.served("hall").unwrap().info().version != version {
                    std::thread::sleep(Duration::from_millis(1));
                }
                (Instant::now(), answers())
            });
            Handle::current().block_on(server.replace("hall", next, None)).unwrap();
            answering.join().unwrap()
        })
    });
    (told.await.unwrap().saturating_duration_since(since), answered)
}

/// A server that is killed serves the version again that has answered, and robots do not wait for the disk.
#[tokio::test(flavor = "multi_thread")]
async fn a_version_is_noted_on_the_disk_before_it_answers() {
    let disk = Arc::new(Disk::default());
    let mut options = ServerOptions::default();
    options.state = Some(Arc::new(ServerState::new(OnDisk(Arc::clone(&disk)))));
    let scene = Scene::with(options).await;
    let next = next_version(&scene.place);
    let (waited, noted) = replaced(&scene, next, || disk.done.load(Ordering::SeqCst)).await;
    assert_eq!(noted, 2);
    assert!(waited < Disk::WRITING, "{waited:?} after the first answer");
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_notice_does_not_wait_for_the_comparison_of_the_versions() {
    let mut scene = Scene::new().await;
    scene.server.stop().await.unwrap();
    scene.place = Place::new(&PlaceOptions { keyframes: 300, landmarks: 20_000, ..PlaceOptions::default() });
    let maps = vec![served("hall", &scene.place)];
    scene.server = MapServer::start(scene.serving.clone(), maps, ServerOptions::default()).await.unwrap();
    let (former, next) = (scene.server.served("hall").unwrap(), next_version(&scene.place));
    let begun = Instant::now();
    VersionChange::between(&former.compared(), &next.compared(), 0);
    let comparing = begun.elapsed();
    let (waited, ()) = replaced(&scene, next, || {}).await;
    println!("compared in {comparing:?}, told after {waited:?}");
    assert!(waited < comparing / 2, "{waited:?} after the first answer; comparing takes {comparing:?}");
    scene.end().await;
}
