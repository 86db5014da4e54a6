//! Work that must not keep queries waiting.

use std::io;
use std::thread;

use tokio::runtime::Handle;
use tokio::sync::oneshot;

/// Niceness of a thread that yields to others: where all processors are busy, it gets a third of the share of another one (Linux, the
/// weights of its scheduler), so that it ends, too.
#[cfg(target_os = "linux")]
const NICENESS: i32 = 5;

/// Runs a job on a thread of its own, in the tokio runtime of the caller, that yields to the threads that answer queries (on Linux;
/// elsewhere it has the same share).
///
/// # Errors
/// That of the system if it has no thread to give; the job panicked.
pub async fn in_background<T: Send + 'static>(job: impl FnOnce() -> T + Send + 'static) -> io::Result<T> {
    let (ended, result) = oneshot::channel();
    let runtime = Handle::current();
    thread::Builder::new().name("background".into()).spawn(move || {
        let _entered = runtime.enter();
        yield_to_others();
        // Nobody waits any more where the program ends.
        let _ = ended.send(job());
    })?;
    result.await.map_err(|_| io::Error::other("the thread that worked on it failed; the log says more"))
}

/// On Linux a niceness is that of a thread, whatever POSIX says.
#[cfg(target_os = "linux")]
fn yield_to_others() {
    if let Err(error) = rustix::process::setpriority_process(None, NICENESS) {
        tracing::debug!("the thread keeps its priority: {error}");
    }
}

#[cfg(not(target_os = "linux"))]
fn yield_to_others() {}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[tokio::test]
    async fn a_job_yields_to_others_and_nobody_else_does() {
        let niceness = || rustix::process::getpriority_process(None).unwrap();
        let before = niceness();
        assert_eq!(in_background(niceness).await.unwrap(), NICENESS.max(before));
        assert_eq!(niceness(), before);
    }

    #[tokio::test]
    async fn a_panic_is_an_error() {
        assert!(in_background(|| panic!("on purpose")).await.is_err());
        assert_eq!(in_background(|| 7).await.unwrap(), 7);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_job_may_wait_for_tasks_of_the_runtime() {
        let waited = in_background(|| Handle::current().block_on(async { tokio::spawn(async { 7 }).await }));
        assert_eq!(waited.await.unwrap().unwrap(), 7);
    }
}
