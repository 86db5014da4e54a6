//! The threads that answer queries.
//!
//! Each is a thread of its own as long as the server serves. Tokio's threads for blocking work take turns, and each of them would keep
//! the memory of the costliest query that it ever had. A panic ends one query with an error reply, not the thread.

use std::convert::Infallible;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread;
use std::time::Instant;

use recognition::{LoadedMap, RecognitionOptions};
use tokio::runtime::Handle;
use tokio::sync::mpsc;

use crate::handlers::{self, Progress, ReceivedQuery};
use crate::kind::{Kind, Subject};
use crate::queue::{Job, Queue, Target};
use crate::routing::RoutedMap;

/// The workers of a server. They end with this value, as soon as they have answered what is in the queue.
pub(crate) struct Workers {
    queue: Arc<Queue>,
    /// Closed when the last of them has ended.
    ended: mpsc::Receiver<Infallible>,
}

impl Workers {
    /// Starts so many, at least one, in the tokio runtime of the caller.
    ///
    /// # Errors
    /// That of the system, if it has no thread to give.
    pub(crate) fn start(queue: &Arc<Queue>, count: usize, options: &RecognitionOptions) -> io::Result<Self> {
        let (is_working, ended) = mpsc::channel(1);
        let workers = Self { queue: Arc::clone(queue), ended };
        let options = Arc::new(options.clone());
        for k in 0..count.max(1) {
            let (queue, options, runtime) = (Arc::clone(queue), Arc::clone(&options), Handle::current());
            let is_working = is_working.clone();
            thread::Builder::new().name(format!("worker-{k}")).spawn(move || {
                let _entered = runtime.enter();
                work(&queue, &options);
                drop(is_working);
            })?;
        }
        Ok(workers)
    }

    /// Waits until all queries are answered that the queue has; it takes no more.
    pub(crate) async fn end(mut self) {
        self.queue.close();
        self.ended.recv().await;
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        self.queue.close();
    }
}

fn work(queue: &Arc<Queue>, options: &RecognitionOptions) {
    while let Some(mut job) = queue.take() {
        if job.is_expired() {
            queue.refuse(&job);
            continue;
        }
        let begun = job.begun.take();
        match job.target.clone() {
            Target::Map(kind, slot) => {
                let begun = begun.unwrap_or_else(|| (slot.current(), 0));
                answer(queue, job, Subject::Map(kind), begun, options);
            }
            Target::Cell(kind, slot) => {
                let cell = slot.current();
                match begun.or_else(|| Some((cell.if_in_memory()?, 0))) {
                    Some(begun) => {
                        answer(queue, job, Subject::Cell(kind, slot.cell), begun, options);
                        cell.memory().trim();
                    }
                    None => queue.await_cell(job, cell),
                }
            }
            Target::Routed(kind, routed) => route(queue, job, kind, routed),
        }
    }
}

/// Answers a query with a map that is in memory.
fn answer(
    queue: &Queue,
    job: Job,
    subject: Subject,
    (loaded, sent): (Arc<LoadedMap>, usize),
    options: &RecognitionOptions,
) {
    let (bytes, begin) = (job.bytes(), Instant::now());
    let Job { query, target, client, received, .. } = job;
    let name = target.name().to_owned();
    let asked = ReceivedQuery { query: query.clone(), subject, name, received, sent };
    let answered = catch_panic(|| handlers::answer(&asked, &loaded, options, &queue.reports));
    queue.charge(&client, bytes, begin.elapsed());
    match answered {
        Ok(Ok(Progress::Keyframes { sent, bytes })) => {
            queue.enqueue(
                Job { query, target, client, received, expires: None, begun: Some((loaded, sent)) },
                bytes,
            );
        }
        Ok(Ok(Progress::Done)) => queue.note_end(&query, &target, received, Ok(())),
        Ok(Err(failure)) => queue.note_end(&query, &target, received, Err(failure)),
        Err(panic) => queue.note_end(&query, &target, received, Err(queue.panicked(&query, &panic))),
    }
}

/// Plans with a worker, and asks cells without one.
fn route(queue: &Arc<Queue>, job: Job, kind: Kind, routed: Arc<RoutedMap>) {
    let (bytes, begin) = (job.bytes(), Instant::now());
    let Job { query, target, client, received, .. } = job;
    let planned = catch_panic(|| routed.plan(&query, kind, received));
    queue.charge(&client, bytes, begin.elapsed());
    let plan = match planned {
        Ok(Ok(plan)) => plan,
        Ok(Err(failure)) => return queue.note_end(&query, &target, received, Err(failure)),
        Err(panic) => {
            let failure = queue.panicked(&query, &panic);
            return queue.note_end(&query, &target, received, Err(failure));
        }
    };
    let queue = Arc::clone(queue);
    tokio::spawn(async move {
        let answered = routed.answer(plan).await;
        queue.note_end(&query, &target, received, answered);
    });
}

/// Runs a job; where it panics, the message of the panic.
fn catch_panic<T>(job: impl FnOnce() -> T) -> Result<T, String> {
    // What a query changes (metrics, caches) is behind locks that survive a panic.
    catch_unwind(AssertUnwindSafe(job)).map_err(|panic| {
        let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
        text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "a panic".to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::catch_panic;

    #[test]
    fn a_panic_is_an_error_and_the_next_job_runs() {
        assert_eq!(catch_panic(|| -> u32 { panic!("job {}", 7) }), Err("job 7".to_owned()));
        assert_eq!(catch_panic(|| 8), Ok(8));
    }
}
