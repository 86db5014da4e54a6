//! A match query against a large synthetic map: time, recall, memory, disk.
//!
//! `cargo bench -p driftless-benches --bench match_query [-- KEYFRAMES [FEATURES [PERCENT]]]`: 10,000 keyframes, of which each
//! observes 60 % of the landmarks in its view, some 300, and 300 of the 500 features of a query are of the place, unless said
//! otherwise; the others are clutter of the same kinds of texture. Times are of the processor, in milliseconds.
#![allow(clippy::unwrap_used)]

mod map;
mod size;

use std::hash::{DefaultHasher, Hasher as _};

use geometry::{Pose, PoseWithCovariance};
use map::World;
use nalgebra::{Matrix6, Vector6};
use protocol::{Format, LocalizeRequest, MatchOutcome, MatchReply, MatchRequest, PosePrior};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use recognition::{LoadedMap, RecognitionOptions};
use vision::{DescriptorView, MatchOptions, Metric, match_descriptors};

const QUERIES: usize = 60;
/// Standard deviations of a localized robot's prior: rotation (rad), position (m).
const PRIOR_SIGMAS: [f64; 2] = [0.02, 0.1];

fn main() {
    if let Some(path) = std::env::args().skip_while(|argument| argument != "--load").nth(1) {
        size::load(&path);
        return;
    }
    let mut numbers = std::env::args().filter_map(|argument| argument.parse::<usize>().ok());
    let keyframes = numbers.next().unwrap_or(10_000);
    let of_the_place = numbers.next().unwrap_or(300);
    let percent_observed = numbers.next().unwrap_or(60);
    let mut world = World::new(keyframes, percent_observed as f64 / 100.0);
    let contents = world.map.take().unwrap();
    size::report(&contents);
    let map = LoadedMap::from_contents(contents).unwrap();

    let mut rng = StdRng::seed_from_u64(3);
    let mut queries = Queries::default();
    for _ in 0..QUERIES {
        let street = rng.random_range(0..keyframes.div_ceil(500));
        let along = rng.random_range(5.0..(keyframes - street * 500).min(500) as f64 - 5.0);
        let truth = World::camera_at(street, along, rng.random_range(-1.0..1.0), rng.random_range(-0.3..0.3));
        let request = world.query(street, &truth, of_the_place, &mut rng);
        let right = |id: u64| id as usize / 500 == street && ((id % 500) as f64 - along).abs() < 5.0;

        let voted = queries.vote.run(|| map.rank_keyframes(&request.features, 40).unwrap());
        queries.ranks.push(voted.iter().position(|&id| right(id)).unwrap_or(usize::MAX));
        let query = DescriptorView::new(Metric::CosineInt8, 64, &request.features.descriptors.bytes).unwrap();
        let train = DescriptorView::new(Metric::CosineInt8, 64, &query.bytes()[..300 * 64]).unwrap();
        let options = MatchOptions::for_metric(Metric::CosineInt8);
        queries.matching.run(|| match_descriptors(query, train, &options).unwrap());

        queries.unknown.ask(&map, &request, None, right);
        queries.known.ask(&map, &request, Some(prior(&truth, &mut rng)), right);
        let elsewhere = World::camera_at((street + 1) % keyframes.div_ceil(500), along, 0.0, 0.0);
        queries.wrong.ask(&map, &request, Some(prior(&elsewhere, &mut rng)), right);
        queries.localize(&map, request, &truth);
    }
    queries.print();
}

/// A prior pose as a localized robot sends it.
fn prior(truth: &Pose, rng: &mut StdRng) -> PosePrior {
    let [theta, p] = PRIOR_SIGMAS;
    let sigmas = Vector6::new(theta, theta, theta, p, p, p);
    let error = Vector6::from_fn(|row, _| map::normal(rng) * sigmas[row]);
    let covariance = Matrix6::from_diagonal(&sigmas.component_mul(&sigmas));
    PosePrior { global_from_camera: PoseWithCovariance::new(truth.retract(&error), covariance) }
}

#[derive(Default)]
struct Times(Vec<f64>);

impl Times {
    fn run<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let start = cpu_s();
        let result = work();
        self.0.push((cpu_s() - start) * 1e3);
        result
    }
}

/// Match queries of one kind.
#[derive(Default)]
struct MatchQueries {
    times: Times,
    answered: usize,
    /// Whose first keyframe is of the place.
    right: usize,
    inliers: usize,
    /// Of all bytes of the answers: equal for equal answers.
    digest: DefaultHasher,
}

impl MatchQueries {
    fn ask(
        &mut self,
        map: &LoadedMap,
        request: &MatchRequest,
        prior: Option<PosePrior>,
        right: impl Fn(u64) -> bool,
    ) {
        let request = MatchRequest { prior, ..request.clone() };
        let mut replies = self.times.run(|| map.answer(&request, &RecognitionOptions::default()).unwrap());
        let Some(MatchReply::Done(status)) = replies.last_mut() else { panic!("no status") };
        status.elapsed_us = 0;
        self.answered += usize::from(status.outcome == MatchOutcome::Matched);
        if let Some(MatchReply::Keyframe(first)) = replies.first() {
            self.right += usize::from(right(first.keyframe.id));
            self.inliers += first.matches.len();
        }
        for reply in &replies {
            self.digest.write(&protocol::encode(Format::Bincode, reply).unwrap());
        }
    }

    fn print(self, name: &str) {
        println!(
            "{name}: {}; answered {} of {QUERIES}, recall@1 {:.3}, {} matches in the first keyframe, digest {:016x}",
            spread(self.times.0),
            self.answered,
            self.right as f64 / QUERIES as f64,
            self.inliers / QUERIES,
            self.digest.finish()
        );
    }
}

#[derive(Default)]
struct Queries {
    vote: Times,
    matching: Times,
    ranks: Vec<usize>,
    unknown: MatchQueries,
    known: MatchQueries,
    wrong: MatchQueries,
    localize: Times,
    /// Position error (m), NEES over 6, inliers.
    fixes: Vec<[f64; 3]>,
    /// Of the bytes of their replies.
    digest: DefaultHasher,
}

impl Queries {
    fn localize(&mut self, map: &LoadedMap, request: MatchRequest, truth: &Pose) {
        let MatchRequest { camera, features, .. } = request;
        let request = LocalizeRequest { camera, features, prior: None, gravity_in_camera: None };
        let reply = self.localize.run(|| map.localize(&request, &RecognitionOptions::default()).unwrap());
        self.digest.write(&protocol::encode(Format::Bincode, &reply).unwrap());
        if let Some(fix) = reply.fix {
            let error = truth.local(&fix.global_from_camera.pose);
            let nees = fix.global_from_camera.nees(truth).unwrap() / 6.0;
            self.fixes.push([error.fixed_rows::<3>(3).norm(), nees, f64::from(fix.inliers)]);
        }
    }

    fn print(self) {
        for k in [1, 5, 10] {
            let found = self.ranks.iter().filter(|&&rank| rank < k).count();
            println!("votes: recall@{k} {:.3}", found as f64 / QUERIES as f64);
        }
        println!("votes: {}", spread(self.vote.0));
        println!("match 500 x 300: {}", spread(self.matching.0));
        self.unknown.print("answer without prior");
        self.known.print("answer with prior");
        self.wrong.print("answer with a prior 100 m off");
        println!("localize: {}, digest {:016x}", spread(self.localize.0), self.digest.finish());
        for (at, name) in ["error m", "NEES/6", "inliers"].into_iter().enumerate() {
            println!("localize {name}: {}", spread(self.fixes.iter().map(|fix| fix[at]).collect()));
        }
    }
}

fn spread(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    let at = |part: f64| values[((values.len() - 1) as f64 * part) as usize];
    format!("min {:.3}, median {:.3}, 90 % {:.3}, max {:.3}", at(0.0), at(0.5), at(0.9), at(1.0))
}

/// Seconds for which this thread was on a processor: other programs do not count.
fn cpu_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
