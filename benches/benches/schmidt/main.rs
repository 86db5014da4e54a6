//! Times a map update beside many held keyframes, one thread: `cargo bench -p driftless-benches --bench schmidt`.
//!
//! | benchmark | what |
//! |---|---|
//! | `map update/N` | a query result with 3 of the N held keyframes: verification, linearization, gates, update |
//! | `frame between/N` | a step of the odometry beside N held keyframes: propagation, 100 tracks, 30 SLAM features |
//! | `invalidate/N` | a map change that replaces all N keyframes, while the estimator waits |
//! | `dense/N` | the same update in a filter that keeps everything in one matrix; no verification, no rows |
//!
//! The 3 keyframes are drawn at random: of 10,000 nearly all are inactive and must be activated first. Four images lie
//! between two updates; each includes a part of the compaction of inactive keyframes. Measurements are exact, no gate
//! rejects any. First comes a table of steps that all estimators make in turn, with the bytes for each held keyframe. The
//! dense filter ends at 1,000 keyframes: with 10,000 its matrix takes 29 GB.
#![allow(clippy::unwrap_used)]

mod dense;
mod held;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use dense::DenseSchmidt;
use held::{FRAMES_BETWEEN, Holder};
use std::time::{Duration, Instant};

fn schmidt(criterion: &mut Criterion) {
    let mut holders: Vec<(usize, Holder)> =
        [10, 100, 1_000, 10_000].map(|count| (count, Holder::new(count))).into();
    side_by_side(&mut holders);
    let mut group = criterion.benchmark_group("schmidt");
    for (count, holder) in &mut holders {
        group.bench_function(BenchmarkId::new("map update", *count), |bencher| {
            bencher.iter_custom(|rounds| timed(rounds, holder, Holder::frames, Holder::map_update));
        });
        group.bench_function(BenchmarkId::new("frame between", *count), |bencher| {
            bencher.iter_custom(|rounds| timed(rounds, holder, Holder::map_update, Holder::frame));
        });
        group.bench_function(BenchmarkId::new("invalidate", *count), |bencher| {
            bencher.iter_custom(|rounds| (0..rounds).map(|_| holder.invalidate_all()).sum());
        });
    }
    for count in [10, 100, 1_000] {
        let mut filter = DenseSchmidt::new(count);
        group
            .bench_function(BenchmarkId::new("dense", count), |bencher| bencher.iter(|| filter.map_update()));
    }
    group.finish();
}

/// Steps of the table.
const STEPS: usize = 500;

/// Prints a table of medians and extremes, from steps that the holders make in turn: whatever else the machine does
/// slows all of them down.
fn side_by_side(holders: &mut [(usize, Holder)]) {
    let mut times = vec![[Vec::new(), Vec::new()]; holders.len()];
    for _ in 0..STEPS {
        for ((_, holder), [updates, frames]) in holders.iter_mut().zip(&mut times) {
            for _ in 0..FRAMES_BETWEEN {
                frames.push(timed(1, holder, |_| {}, Holder::frame));
            }
            updates.push(timed(1, holder, |_| {}, Holder::map_update));
        }
    }
    println!(
        "held     map update: median  mean  99 %  longest     frame: median  mean  99 %  longest [us]   bytes each"
    );
    for ((count, holder), [updates, frames]) in holders.iter().zip(&mut times) {
        let [updates, frames] = [updates, frames].map(|times| statistics(times));
        println!("{count:<8} {updates}     {frames}   {}", holder.bytes_each());
    }
}

fn statistics(times: &mut [Duration]) -> String {
    times.sort_unstable();
    let mean = times.iter().sum::<Duration>() / times.len() as u32;
    let of = |part: usize| times[(times.len() - 1) * part / 100];
    [of(50), mean, of(99), of(100)].map(|time| format!("{:>7}", time.as_micros())).join(" ")
}

/// Time of `what`, with `between` before each.
fn timed(rounds: u64, holder: &mut Holder, between: fn(&mut Holder), what: fn(&mut Holder)) -> Duration {
    let once = |_| {
        between(holder);
        let begin = Instant::now();
        what(holder);
        begin.elapsed()
    };
    (0..rounds).map(once).sum()
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10);
    targets = schmidt
}
criterion_main!(benches);
