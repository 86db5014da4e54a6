//! When the notice of a new version leaves: robots wait for it for 2 s after the first answer of that version.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
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

/// A disk that is done when the notice has come, or after 5 s.
#[derive(Default)]
struct Disk {
    set: AtomicUsize,
    is_told: AtomicBool,
    was_told_first: AtomicBool,
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
        if disk.set.fetch_add(1, Ordering::SeqCst) == 0 {
            return Ok(());
        }
        let deadline = Instant::now() + Duration::from_secs(5);
        while !disk.is_told.load(Ordering::SeqCst) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(5));
        }
        disk.was_told_first.store(disk.is_told.load(Ordering::SeqCst), Ordering::SeqCst);
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_notice_does_not_wait_for_the_disk() {
    let disk = Arc::new(Disk::default());
    let mut options = ServerOptions::default();
    options.state = Some(Arc::new(ServerState::new(OnDisk(Arc::clone(&disk)))));
    let scene = Scene::with(options).await;
    let news = changes(&scene).await;
    let told = {
        let disk = Arc::clone(&disk);
        tokio::spawn(async move {
            news.recv_async().await.unwrap();
            disk.is_told.store(true, Ordering::SeqCst);
        })
    };
    scene.server.replace("hall", next_version(&scene.place), None).await.unwrap();
    told.await.unwrap();
    assert_eq!(disk.set.load(Ordering::SeqCst), 2, "the version is noted when this returns");
    assert!(disk.was_told_first.load(Ordering::SeqCst));
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_notice_does_not_wait_for_the_comparison_of_the_versions() {
    let mut scene = Scene::new().await;
    scene.server.stop().await.unwrap();
    scene.place = Place::new(&PlaceOptions { keyframes: 300, landmarks: 20_000, ..PlaceOptions::default() });
    let maps = vec![served("hall", &scene.place)];
    scene.server = MapServer::start(scene.serving.clone(), maps, ServerOptions::default()).await.unwrap();
    let news = changes(&scene).await;
    let (former, next) = (scene.server.served("hall").unwrap(), next_version(&scene.place));
    let version = next.info().version;
    let begun = Instant::now();
    VersionChange::between(&former.compared(), &next.compared(), 0);
    let comparing = begun.elapsed();
    let told = tokio::spawn(async move {
        news.recv_async().await.unwrap();
        Instant::now()
    });
    let server = &scene.server;
    let answers_since = tokio::task::block_in_place(|| {
        std::thread::scope(|scope| {
            let answering = scope.spawn(|| {
                while server.served("hall").unwrap().info().version != version {
                    std::thread::sleep(Duration::from_millis(1));
                }
                Instant::now()
            });
            Handle::current().block_on(server.replace("hall", next, None)).unwrap();
            answering.join().unwrap()
        })
    });
    let waited = told.await.unwrap().saturating_duration_since(answers_since);
    println!("compared in {comparing:?}, told after {waited:?}");
    assert!(waited < comparing / 2, "{waited:?} after the first answer; comparing takes {comparing:?}");
    scene.end().await;
}
