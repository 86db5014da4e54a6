//! Work on many items on all processors, with results that do not depend on their number.

use std::collections::BTreeMap;
use std::num::NonZero;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;

/// The results of `work` for `0..count`, in this order.
///
/// # Arguments
/// * `progress`: called on this thread with the number of items done, from 0 to `count`.
pub fn map<T: Send>(
    count: usize,
    work: impl Fn(usize) -> T + Sync,
    mut progress: impl FnMut(usize),
) -> Vec<T> {
    let mut results = Vec::with_capacity(count);
    progress(0);
    for_each_in_order(processors(), count, work, |result| {
        results.push(result);
        progress(results.len());
    });
    results
}

/// Does `work` for runs of `size` items, and gives the results to `take` on this thread, in their order: a sum over the runs is
/// the same on any number of processors. Few results are in memory at once.
pub fn for_each_run<I: Sync, T: Send>(
    items: &[I],
    size: usize,
    work: impl Fn(&[I]) -> T + Sync,
    take: impl FnMut(T),
) {
    let runs: Vec<&[I]> = items.chunks(size).collect();
    for_each_in_order(processors(), runs.len(), |run| work(runs[run]), take);
}

/// Does `work` for `0..count`, and gives the results to `take` on this thread, in this order. Few of them are in memory at once.
pub fn for_each<T: Send>(count: usize, work: impl Fn(usize) -> T + Sync, take: impl FnMut(T)) {
    for_each_in_order(processors(), count, work, take);
}

/// Asked for once: the system reads files for it, as often as an adjustment has steps.
fn processors() -> usize {
    static PROCESSORS: OnceLock<usize> = OnceLock::new();
    *PROCESSORS.get_or_init(|| std::thread::available_parallelism().map_or(1, NonZero::get))
}

/// Does `work` for `0..count` on some threads, and gives the results to `take` on this thread, in this order.
fn for_each_in_order<T: Send>(
    threads: usize,
    count: usize,
    work: impl Fn(usize) -> T + Sync,
    mut take: impl FnMut(T),
) {
    let threads = threads.min(count);
    if threads <= 1 {
        (0..count).map(work).for_each(take);
        return;
    }
    let next = AtomicUsize::new(0);
    let (outbox, inbox) = sync_channel(threads);
    // A thread that panics makes the scope panic, so none is missing after it.
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let (outbox, next, work) = (outbox.clone(), &next, &work);
            scope.spawn(move || {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= count || outbox.send((index, work(index))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(outbox);
        let mut early = BTreeMap::new();
        let mut taken = 0;
        for (index, result) in inbox {
            early.insert(index, result);
            while let Some(result) = early.remove(&taken) {
                take(result);
                taken += 1;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_on_any_number_of_threads() {
        for threads in [1, 2, 7, 200] {
            let mut squares = Vec::new();
            let square = |index: usize| {
                // The first of them take longest.
                std::thread::sleep(std::time::Duration::from_micros(100 - index as u64));
                index * index
            };
            for_each_in_order(threads, 100, square, |square| squares.push(square));
            assert!(squares.iter().copied().eq((0..100).map(|index| index * index)));
        }
    }

    #[test]
    fn every_item_is_counted() {
        let mut seen = Vec::new();
        assert_eq!(map(3, |index| 2 * index, |done| seen.push(done)), [0, 2, 4]);
        assert_eq!(seen, [0, 1, 2, 3]);
        assert!(map(0, |index| index, |_| ()).is_empty());
        let items: Vec<usize> = (0..10).collect();
        let mut sums = Vec::new();
        for_each_run(&items, 4, |run| run.iter().sum::<usize>(), |sum| sums.push(sum));
        assert_eq!(sums, [6, 22, 17]);
    }
}
