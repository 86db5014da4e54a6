//! Times a map update beside many held keyframes, one thread: `cargo bench -p benches --bench schmidt`.
//!
//! | benchmark | what |
//! |---|---|
//! | `map update/N` | an answer with 3 of the N keyframes that the estimator holds: verification, rows, gates, update |
//! | `frame between/N` | propagation, cloning and marginalization beside N held keyframes |
//! | `dense/N` | the same update in a filter that keeps everything in one matrix; no verification, no rows |
//!
//! Those 3 are any of the N, so that most have to be brought up to date first. Measurements are exact: what is timed does
//! not depend on the numbers, and no gate ever closes.
#![allow(clippy::unwrap_used)]

mod dense;
mod held;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use dense::DenseSchmidt;
use held::Holder;
use std::time::{Duration, Instant};

fn schmidt(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("schmidt");
    for count in [10, 100, 1_000, 10_000] {
        let mut holder = Holder::new(count);
        group.bench_function(BenchmarkId::new("map update", count), |bencher| {
            bencher.iter_custom(|rounds| timed(rounds, &mut holder, Holder::frame, Holder::map_update));
        });
        group.bench_function(BenchmarkId::new("frame between", count), |bencher| {
            bencher.iter_custom(|rounds| timed(rounds, &mut holder, Holder::map_update, Holder::frame));
        });
    }
    for count in [10, 100, 1_000] {
        let mut filter = DenseSchmidt::new(count);
        group
            .bench_function(BenchmarkId::new("dense", count), |bencher| bencher.iter(|| filter.map_update()));
    }
    group.finish();
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
