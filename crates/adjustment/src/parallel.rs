//! Work on many items on all processors, with results that do not depend on their number.

use std::collections::BTreeMap;
use std::num::NonZero;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Condvar, Mutex, MutexGuard, OnceLock, PoisonError};

/// Items that are begun before their turn, for each thread: so many results are in memory at once.
const AHEAD: usize = 2;

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

/// How many results were taken. Threads that are too far ahead wait for it.
#[derive(Default)]
struct TakenCount {
    count: Mutex<usize>,
    changed: Condvar,
}

impl TakenCount {
    /// The count after a panic: nobody waits any more, and no further item is begun.
    const STOPPED: usize = usize::MAX;

    fn lock(&self) -> MutexGuard<'_, usize> {
        self.count.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the count, which only grows.
    fn set(&self, count: usize) {
        let mut known = self.lock();
        *known = count.max(*known);
        self.changed.notify_all();
    }

    /// Waits until an item is one of the next `ahead`.
    ///
    /// # Returns
    /// Whether it is to be begun.
    fn wait_for(&self, index: usize, ahead: usize) -> bool {
        let mut count = self.lock();
        while index >= count.saturating_add(ahead) {
            count = self.changed.wait(count).unwrap_or_else(PoisonError::into_inner);
        }
        *count != Self::STOPPED
    }
}

/// Stops all threads where one of them panics: an item that is missing would be waited for without end.
struct StopOnPanic<'a>(&'a TakenCount);

impl Drop for StopOnPanic<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.set(TakenCount::STOPPED);
        }
    }
}

/// Does `work` for `0..count` on some threads, and gives the results to `take` on this thread, in this order. At most [`AHEAD`] results
/// for each thread are in memory at once.
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
    let (next, taken_count) = (AtomicUsize::new(0), TakenCount::default());
    let (outbox, inbox) = sync_channel(threads);
    // A thread that panics makes the scope panic, so none is missing after it.
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let (outbox, next, taken_count, work) = (outbox.clone(), &next, &taken_count, &work);
            scope.spawn(move || {
                let _stop = StopOnPanic(taken_count);
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= count || !taken_count.wait_for(index, AHEAD * threads) {
                        break;
                    }
                    if outbox.send((index, work(index))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(outbox);
        let _stop = StopOnPanic(&taken_count);
        let mut early = BTreeMap::new();
        let mut taken = 0;
        for (index, result) in inbox {
            early.insert(index, result);
            while let Some(result) = early.remove(&taken) {
                take(result);
                taken += 1;
                taken_count.set(taken);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::time::Duration;

    #[test]
    fn few_results_are_in_memory_where_one_of_them_takes_long() {
        const THREADS: usize = 3;
        let taken = AtomicUsize::new(0);
        let work = |index: usize| {
            let begun_at = taken.load(Ordering::SeqCst);
            assert!(index < begun_at + AHEAD * THREADS, "{index} is begun when {begun_at} are taken");
            std::thread::sleep(Duration::from_millis(if index.is_multiple_of(20) { 10 } else { 0 }));
        };
        for_each_in_order(THREADS, 100, work, |()| {
            taken.fetch_add(1, Ordering::SeqCst);
        });
        assert_eq!(taken.load(Ordering::SeqCst), 100);
    }

    #[test]
    fn a_panic_ends_the_work_of_all_threads() {
        let fails = |index: usize| {
            std::thread::sleep(Duration::from_millis(if index == 0 { 20 } else { 0 }));
            assert_ne!(index, 0, "the item that the others wait for");
        };
        let of_work = catch_unwind(AssertUnwindSafe(|| for_each_in_order(3, 100, fails, |()| {})));
        assert!(of_work.is_err());
        let refuses = |index: usize| assert_ne!(index, 5, "the result is not taken");
        let of_take = catch_unwind(AssertUnwindSafe(|| for_each_in_order(3, 100, |index| index, refuses)));
        assert!(of_take.is_err());
    }

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
