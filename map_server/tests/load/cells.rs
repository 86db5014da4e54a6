//! What a query costs where a large map is served by cells, beside a map of two cells' size in one piece.

use std::collections::BTreeMap;
use std::time::Duration;

use map::MapContents;
use map_server::routing::CellDirectory;
use nalgebra::Vector3;
use protocol::{MatchOutcome, MatchReply, MatchRequest};
use recognition::{LoadedMap, RecognitionOptions};
use releases::{CellId, PublishOptions, ReleaseStore, fetch_cell, fetch_coarse, publish};
use testing::{Place, PlaceOptions};

use super::town::{quantile_ms, requests, setting};

/// Distance between two places, metres: no cell has keyframes of both.
const APART: f64 = 1e4;

#[derive(Default)]
struct Cost {
    durations: Vec<Duration>,
    matched: usize,
}

impl Cost {
    /// Runs a query and notes the processor time that it took.
    fn measure(&mut self, query: impl FnOnce() -> Vec<MatchReply>) -> Vec<MatchReply> {
        let begin = processor_time();
        let replies = query();
        self.durations.push(processor_time().saturating_sub(begin));
        self.matched += usize::from(has_match(&replies));
        replies
    }

    fn print(mut self, what: &str) {
        let mean = self.durations.iter().sum::<Duration>().as_secs_f64() * 1e3 / self.durations.len() as f64;
        self.durations.sort();
        let (median, most) = (quantile_ms(&self.durations, 0.5), quantile_ms(&self.durations, 0.95));
        let (matched, all) = (self.matched, self.durations.len());
        println!(
            "{what}: {matched} of {all} matched; mean {mean:.1} ms, median {median:.1}, 95 % below {most:.1}"
        );
    }
}

/// Processor time of this thread: other programs on the machine do not count.
fn processor_time() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    Duration::from_nanos(text.split_whitespace().next().unwrap().parse().unwrap())
}

fn has_match(replies: &[MatchReply]) -> bool {
    let is_matched = |reply: &MatchReply| matches!(reply, MatchReply::Done(status) if status.outcome == MatchOutcome::Matched);
    replies.iter().any(is_matched)
}

/// Places of a town, side by side in one map, each with the ids of its keyframes and landmarks.
pub fn town(
    places: usize,
    keyframes: usize,
) -> (MapContents, Vec<Vec<MatchRequest>>, Vec<Vec<MatchRequest>>) {
    let (mut all, mut without, mut with) = (None::<MapContents>, Vec::new(), Vec::new());
    for number in 0..places {
        let options = PlaceOptions {
            seed: 100 + number as u64,
            keyframes,
            landmarks: 50 * keyframes,
            turned: false,
            ..PlaceOptions::default()
        };
        let place = Place::new(&options);
        let shift = Vector3::new(0.0, APART * number as f64, 0.0);
        without.push(requests(&place, false, number as u64));
        let mut near = requests(&place, true, number as u64);
        for request in &mut near {
            if let Some(prior) = &mut request.prior {
                prior.global_from_camera.pose.translation += shift;
            }
        }
        with.push(near);
        let mut map = place.map;
        let first = number as u64 * 10_000_000;
        for keyframe in &mut map.keyframes {
            keyframe.id += first;
            keyframe.global_from_keyframe.pose.translation += shift;
        }
        for landmark in &mut map.landmarks {
            (landmark.id, landmark.anchor) = (landmark.id + first, landmark.anchor + first);
            landmark.observations.iter_mut().for_each(|seen| seen.keyframe += first);
        }
        map.cross_covariances
            .iter_mut()
            .for_each(|cross| (cross.a, cross.b) = (cross.a + first, cross.b + first));
        let joined = all.get_or_insert_with(|| MapContents::empty(map.info.clone()));
        joined.keyframes.append(&mut map.keyframes);
        joined.landmarks.append(&mut map.landmarks);
        joined.cross_covariances.append(&mut map.cross_covariances);
    }
    let mut all = all.unwrap();
    all.info.identity = None;
    (all, without, with)
}

/// The first cells, and where none of these matches the next ones, as a server asks them.
fn ask(
    directory: &CellDirectory,
    cells: &BTreeMap<CellId, LoadedMap>,
    request: &MatchRequest,
    asked: &mut usize,
) -> Vec<MatchReply> {
    let options = RecognitionOptions::default();
    let search = directory.search(&request.features, request.prior.as_ref()).unwrap();
    let answer = |cell: &CellId| cells[cell].answer(request, &options).unwrap();
    *asked += search.first.len();
    let replies: Vec<MatchReply> = search.first.iter().flat_map(answer).collect();
    if has_match(&replies) {
        return replies;
    }
    let then = directory.then(&request.features, search).unwrap();
    *asked += then.len();
    then.iter().flat_map(answer).collect()
}

#[tokio::test]
#[ignore = "a measurement of some minutes"]
async fn a_query_in_cells_beside_one_in_a_map_of_two_cells() {
    let (places, keyframes) = (setting("PLACES", 16), setting("KEYFRAMES", 1000));
    let (map, without, with) = town(places, keyframes);
    let folder = tempfile::tempdir().unwrap();
    let store = ReleaseStore::open(folder.path().to_str().unwrap()).unwrap();
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = keyframes;
    let (all_keyframes, all_landmarks) = (map.keyframes.len(), map.landmarks.len());
    publish(&store, map, &options, |_| {}).await.unwrap();
    let release = store.newest().await.unwrap().unwrap();
    let coarse = fetch_coarse(&store, &release, None).await.unwrap();
    let coarse_landmarks: usize = coarse.values().map(|cell| cell.landmarks.len()).sum();
    let directory = CellDirectory::new(&release, coarse).unwrap();
    let mut cells = BTreeMap::new();
    for cell in directory.cells() {
        let fetched = fetch_cell(&store, &release, cell, None).await.unwrap();
        cells.insert(
            cell,
            LoadedMap::from_part(fetched.contents, fetched.far_cross_covariances, &fetched.aliases).unwrap(),
        );
    }
    println!(
        "{all_keyframes} keyframes, {all_landmarks} landmarks in {} cells; {coarse_landmarks} coarse landmarks",
        cells.len()
    );
    let (two, ..) = town(2, keyframes);
    let two = LoadedMap::from_contents(two).unwrap();
    for (what, requests) in [("without prior", without), ("with prior", with)] {
        let (mut in_two, mut in_cells, mut asked) = (Cost::default(), Cost::default(), 0);
        // Queries that a cell would have answered that was not asked.
        let mut missed = 0;
        let recognition = RecognitionOptions::default();
        for round in 0..requests[0].len() {
            for (number, of_place) in requests.iter().enumerate() {
                let request = &of_place[round];
                // As many of both, one after the other.
                let in_first = &requests[number % 2][round];
                in_two.measure(|| two.answer(in_first, &recognition).unwrap());
                let replies = in_cells.measure(|| ask(&directory, &cells, request, &mut asked));
                if !has_match(&replies) {
                    let all = cells.values().map(|cell| cell.answer(request, &recognition).unwrap());
                    missed += usize::from(all.into_iter().any(|replies| has_match(&replies)));
                }
            }
        }
        let cells_a_query = asked as f64 / in_cells.durations.len() as f64;
        in_two.print(&format!("{what}, {} keyframes in one piece", 2 * keyframes));
        in_cells.print(&format!(
            "{what}, {all_keyframes} in cells, {cells_a_query:.2} cells a query, {missed} missed by their choice"
        ));
    }
}
