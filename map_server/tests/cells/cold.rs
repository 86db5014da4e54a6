//! Cells beyond `--memory` are on disk, and answer as those in memory.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use client::MapClient;
use map_server::{CellChoice, MapServer, ServedMap, ServerOptions};
use protocol::{KeyframeId, MatchOutcome, MatchReply};
use recognition::{LoadedMap, RecognitionOptions};
use releases::{CellId, fetch_cell, publish};

use super::servers::{CellServer, hub, session, wait_for_cells};
use super::town::{Town, requests, small_cells, soon};

/// Bytes of the largest cell in memory, and the ids of each cell's own keyframes.
async fn cells(town: &Town) -> (usize, Vec<(CellId, Vec<KeyframeId>)>) {
    let (mut largest, mut own) = (0, Vec::new());
    for released in &town.release.cells {
        let cell = fetch_cell(&town.store, &town.release, released.cell, None).await.unwrap();
        own.push((released.cell, cell.own));
        let loaded = LoadedMap::from_part(cell.contents, cell.far_cross_covariances, &cell.aliases).unwrap();
        largest = largest.max(loaded.bytes_in_memory());
    }
    (largest, own)
}

/// The files of cells that are kept on disk.
fn cold_files(folder: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(folder.join("cold/0")).unwrap();
    files.map(|file| file.unwrap().path()).filter(|file| !file.ends_with("lock")).collect()
}

fn all_cells() -> CellChoice {
    "0-100".parse().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn cells_beyond_the_memory_are_on_disk_and_answer_as_the_whole_map() {
    let town = Town::new().await;
    let (largest, own) = cells(&town).await;
    let bound = largest * 5 / 2;
    let (_hub, endpoint) = hub().await;
    let server =
        CellServer::with_memory(&endpoint, "only", &town.store, town.folder.path(), all_cells(), Some(bound))
            .await;
    let robot = session(&endpoint).await;
    wait_for_cells(&robot, own.len()).await;
    let statistics = || server.server.statistics();
    assert_eq!(statistics().cells, own.len() as u64);
    assert!((2..own.len() as u64).contains(&statistics().cells_in_memory), "{:?}", statistics());

    let whole = LoadedMap::from_contents(town.place.map.clone()).unwrap();
    let city = MapClient::new(robot.clone(), "city").unwrap();
    let mut matched = 0;
    for request in requests(&town.place) {
        let answer = city.match_image(&request, soon()).await.unwrap();
        let expected = whole.answer(&request, &RecognitionOptions::default()).unwrap();
        let Some(MatchReply::Done(expected)) = expected.last() else { panic!("no end") };
        assert_eq!(answer.status.outcome, expected.outcome);
        matched += usize::from(answer.status.outcome == MatchOutcome::Matched);
        assert!(statistics().cell_bytes <= bound as u64);
    }
    assert!(matched >= 18, "{matched} of 20");
    assert!(statistics().cold_loads >= 4, "{:?}", statistics());
    assert_eq!((statistics().cold_loads_failed, statistics().failed), (0, 0));

    // A new version: those that were in memory are there again, the others on disk, and nothing of the former one is left.
    let mut next = town.place.map.clone();
    next.keyframes[30].global_from_keyframe.pose.translation.x += 0.2;
    let notices = robot.declare_subscriber("map/city/changes").await.unwrap();
    publish(&town.store, next, &small_cells(), |_| {}).await.unwrap();
    notices.recv_async().await.unwrap();
    for request in requests(&town.place).iter().take(8) {
        let answer = city.match_image(request, soon()).await.unwrap();
        assert_eq!(answer.status.outcome, MatchOutcome::Matched);
        assert_eq!(answer.status.map_version, town.release.map.version + 1);
        assert!(statistics().cell_bytes <= bound as u64);
    }
    let folder = town.folder.path().join("only");
    assert_eq!(cold_files(&folder).len(), own.len());
    assert_eq!(statistics().cells, own.len() as u64);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cold_cell_is_loaded_once_for_all_who_ask_and_survives_damage() {
    let town = Town::new().await;
    let (largest, own) = cells(&town).await;
    let (_hub, endpoint) = hub().await;
    let memory = Some(largest * 11 / 10);
    let server =
        CellServer::with_memory(&endpoint, "only", &town.store, town.folder.path(), all_cells(), memory)
            .await;
    let robot = session(&endpoint).await;
    wait_for_cells(&robot, own.len()).await;
    let city = MapClient::new(robot.clone(), "city").unwrap();
    let loads = || server.server.statistics().cold_loads;

    for (at, (_, keyframes)) in own.iter().enumerate() {
        let before = loads();
        let asking: Vec<_> = (0..16)
            .map(|ask| {
                let (city, id) = (city.clone(), keyframes[ask % keyframes.len()]);
                tokio::spawn(
                    async move { city.keyframe(id, soon()).await.map(|reply| reply.keyframe.id == id) },
                )
            })
            .collect();
        for asked in asking {
            assert!(asked.await.unwrap().unwrap());
        }
        // The first one may be in memory since the start.
        let loaded = loads() - before;
        assert!(loaded == 1 || at == 0 && loaded == 0, "cell {at} was loaded {loaded} times");
    }

    // Files that are damaged or gone: the cells are made of their segments again, also without the store.
    let away = town.folder.path().join("away");
    std::fs::rename(&town.city, &away).unwrap();
    let folder = town.folder.path().join("only");
    for (at, file) in cold_files(&folder).into_iter().enumerate() {
        if at % 2 == 0 {
            std::fs::write(&file, "something else").unwrap();
        } else {
            std::fs::remove_file(&file).unwrap();
        }
    }
    for (_, keyframes) in &own {
        assert_eq!(city.keyframe(keyframes[0], soon()).await.unwrap().keyframe.id, keyframes[0]);
    }
    assert_eq!(server.server.statistics().cold_loads_failed, 0);
    // From now on they come from the disk again.
    assert_eq!(cold_files(&folder).len(), own.len());
    server.stop().await;
    assert_eq!(cold_files(&folder).len(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bound_below_one_cell_still_answers() {
    let town = Town::new().await;
    let (_hub, endpoint) = hub().await;
    let server =
        CellServer::with_memory(&endpoint, "only", &town.store, town.folder.path(), all_cells(), Some(1))
            .await;
    let robot = session(&endpoint).await;
    wait_for_cells(&robot, town.release.cells.len()).await;
    let city = MapClient::new(robot.clone(), "city").unwrap();
    for request in requests(&town.place).iter().take(8) {
        let answer = city.match_image(request, soon()).await.unwrap();
        assert_eq!(answer.status.outcome, MatchOutcome::Matched);
    }
    server.stop().await;
}

/// A map that has all of its keyframes at one server beside the cells of another map is not affected by the bound.
#[tokio::test(flavor = "multi_thread")]
async fn a_whole_map_stays_in_memory() {
    let town = Town::new().await;
    let (_hub, endpoint) = hub().await;
    let mut options = ServerOptions::default();
    options.cell_memory = Some(1);
    let map = Arc::new(LoadedMap::from_contents(town.place.map.clone()).unwrap());
    let maps = vec![ServedMap { name: "whole".to_owned(), map }];
    let server = MapServer::start(session(&endpoint).await, maps, options).await.unwrap();
    let robot = session(&endpoint).await;
    let whole = MapClient::new(robot, "whole").unwrap();
    let answer = whole.match_image(&requests(&town.place)[0], soon()).await.unwrap();
    assert_eq!(answer.status.outcome, MatchOutcome::Matched);
    server.stop().await.unwrap();
}
