//! Which cells are asked.

use std::collections::BTreeMap;

use map_server::routing::CellDirectory;
use protocol::{MatchOutcome, MatchReply, MatchRequest};
use recognition::{LoadedMap, RecognitionOptions};
use releases::{fetch_cell, fetch_coarse};

use super::town::{Town, requests};

fn is_matched(map: &LoadedMap, request: &MatchRequest) -> bool {
    let replies = map.answer(request, &RecognitionOptions::default()).unwrap();
    let Some(MatchReply::Done(status)) = replies.last() else { panic!("no end") };
    status.outcome == MatchOutcome::Matched
}

#[tokio::test]
async fn one_cell_is_asked_for_one_place_and_finds_what_the_whole_map_finds() {
    let town = Town::new().await;
    let whole = LoadedMap::from_contents(town.place.map.clone()).unwrap();
    let coarse = fetch_coarse(&town.store, &town.release, None).await.unwrap();
    let directory = CellDirectory::new(&town.release, coarse).unwrap();
    let mut cells = BTreeMap::new();
    for id in directory.cells() {
        let cell = fetch_cell(&town.store, &town.release, id, None).await.unwrap();
        cells.insert(
            id,
            LoadedMap::from_part(cell.contents, cell.far_cross_covariances, &cell.aliases).unwrap(),
        );
    }
    let (mut asked, mut missed, mut matched) = (0, 0, 0);
    let requests = requests(&town.place);
    for request in &requests {
        let first = directory.search(&request.features, request.prior.as_ref()).unwrap().first;
        asked += first.len();
        let found = first.iter().any(|cell| is_matched(&cells[cell], request));
        let expected = is_matched(&whole, request);
        matched += usize::from(expected);
        missed += usize::from(expected && !found);
    }
    println!(
        "{asked} cells for {} queries, {matched} matched, {missed} of them by other cells",
        requests.len()
    );
    assert!(matched * 4 > requests.len() * 3 && missed * 20 <= matched, "{missed} of {matched}");
    assert!(asked * 10 <= requests.len() * 11, "{asked} cells for {} queries", requests.len());
}
