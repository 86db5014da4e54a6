//! A match query against a large synthetic map: time of each stage, recall, time to load, memory.
//!
//! `cargo bench -p benches --bench match_query [-- KEYFRAMES [FEATURES]]`: 10,000 keyframes, and 300 of the 500 features of a
//! query are of
//! the place, unless said otherwise; the others are clutter of the same kinds of texture. Times are of the processor, in
//! milliseconds.
#![allow(clippy::unwrap_used)]

mod map;

use std::sync::LazyLock;
use std::time::Instant;

use map::World;
use protocol::{LocalizeRequest, MatchOutcome, MatchReply};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use recognition::{LoadedMap, RecognitionOptions};
use vision::{DescriptorView, MatchOptions, Metric, match_descriptors};

const QUERIES: usize = 40;
static START: LazyLock<Instant> = LazyLock::new(Instant::now);

fn main() {
    let mut numbers = std::env::args().filter_map(|argument| argument.parse::<usize>().ok());
    let keyframes = numbers.next().unwrap_or(10_000);
    let of_the_place = numbers.next().unwrap_or(300);
    let mut world = World::new(keyframes);
    let contents = world.map.take().unwrap();
    println!(
        "map: {} keyframes, {} landmarks, {} observations; {} MB resident with the map's contents",
        contents.keyframes.len(),
        contents.landmarks.len(),
        contents.observation_count(),
        resident_mb()
    );
    let start = cpu_s();
    let map = LoadedMap::from_contents(contents).unwrap();
    println!("loaded in {:.1} s, {} MB resident", (cpu_s() - start), resident_mb());

    let mut rng = StdRng::seed_from_u64(3);
    let options = RecognitionOptions::default();
    let (mut times, mut vote_times, mut match_times, mut localize_times) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut errors, mut ranks) = (Vec::new(), Vec::new());
    let mut matched = 0;
    for _ in 0..QUERIES {
        let street = rng.random_range(0..keyframes.div_ceil(500));
        let along = rng.random_range(5.0..(keyframes - street * 500).min(500) as f64 - 5.0);
        let truth = World::camera_at(street, along, rng.random_range(-1.0..1.0), rng.random_range(-0.3..0.3));
        let request = world.query(street, &truth, of_the_place, &mut rng);
        let start = cpu_s();
        let replies = map.answer(&request, &options).unwrap();
        times.push((cpu_s() - start) * 1e3);
        let Some(MatchReply::Done(status)) = replies.last() else { panic!() };
        matched += usize::from(status.outcome == MatchOutcome::Matched);

        let start = cpu_s();
        let voted = map.rank_keyframes(&request.features, 40).unwrap();
        vote_times.push((cpu_s() - start) * 1e3);
        let train = &request.features.descriptors.bytes[..400 * 64];
        let train = DescriptorView::new(Metric::CosineInt8, 64, train).unwrap();
        let query = DescriptorView::new(Metric::CosineInt8, 64, &request.features.descriptors.bytes).unwrap();
        let start = cpu_s();
        let matches = match_descriptors(query, train, &MatchOptions::for_metric(Metric::CosineInt8)).unwrap();
        match_times.push((cpu_s() - start) * 1e3);
        assert_eq!(matches.len(), 400);
        let right = |id: &u64| *id as usize / 500 == street && ((*id % 500) as f64 - along).abs() < 5.0;
        ranks.push(voted.iter().position(right).unwrap_or(usize::MAX));

        let localize = LocalizeRequest {
            camera: request.camera,
            features: request.features,
            prior: None,
            gravity_in_camera: None,
        };
        let start = cpu_s();
        let reply = map.localize(&localize, &options).unwrap();
        localize_times.push((cpu_s() - start) * 1e3);
        if let Some(fix) = reply.fix {
            let error = truth.local(&fix.global_from_camera.pose);
            let nees = fix.global_from_camera.nees(&truth).unwrap() / 6.0;
            errors.push((error.fixed_rows::<3>(3).norm(), nees, f64::from(fix.inliers)));
        }
    }
    for k in [1, 5, 10, 20, 40] {
        let found = ranks.iter().filter(|&&rank| rank < k).count();
        println!("recall@{k}: {:.3}", found as f64 / QUERIES as f64);
    }
    println!("answered: {matched} of {QUERIES}");
    println!("vote: {}", spread(vote_times));
    println!("match 500 x 400: {}", spread(match_times));
    println!("answer: {}", spread(times));
    println!("localize: {}", spread(localize_times));
    println!("localize error m: {}", spread(errors.iter().map(|error| error.0).collect()));
    println!("localize NEES/6: {}", spread(errors.iter().map(|error| error.1).collect()));
    println!("localize inliers: {}", spread(errors.iter().map(|error| error.2).collect()));
}

fn spread(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    let at = |part: f64| values[((values.len() - 1) as f64 * part) as usize];
    format!("min {:.3}, median {:.3}, 90 % {:.3}, max {:.3}", at(0.0), at(0.5), at(0.9), at(1.0))
}

/// Seconds for which this thread was on a processor: other programs do not count. Where the system does not say, the
/// time of the clock.
fn cpu_s() -> f64 {
    let statistics = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    match statistics.split(' ').next().and_then(|nanoseconds| nanoseconds.parse::<f64>().ok()) {
        Some(nanoseconds) => nanoseconds * 1e-9,
        None => START.elapsed().as_secs_f64(),
    }
}

/// Resident memory of this process, 0 where the system does not say.
fn resident_mb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kilobytes.unwrap_or(0) / 1024
}
