//! Stopping a run from outside: the first Ctrl-C (or SIGTERM) ends it in good order, the second at once.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Handle, Runtime};

/// How long a run that sleeps or waits may take to notice the signal.
pub(super) const NOTICE: Duration = Duration::from_millis(20);
/// How long the end of a program waits for threads that are still busy.
const END: Duration = Duration::from_millis(500);
/// Exit status of a program that an interrupt killed, as shells report it.
const KILLED_BY_INTERRUPT: i32 = 130;

/// Stops a run. Clones share the signal.
#[derive(Clone, Debug, Default)]
pub struct StopSignal {
    stopped: Arc<AtomicBool>,
}

impl StopSignal {
    /// A signal that is raised by SIGINT (Ctrl-C) or SIGTERM. The second one ends the program at once.
    ///
    /// # Errors
    /// The operating system refuses a signal handler or a thread.
    pub fn on_interrupt() -> std::io::Result<Self> {
        let signal = Self::default();
        let raised = signal.clone();
        let runtime = Builder::new_current_thread().enable_io().build()?;
        let mut interrupts = {
            let _entered = runtime.enter();
            Interrupts::listen()?
        };
        let listen = move || {
            runtime.block_on(async {
                interrupts.next().await;
                raised.stop();
                eprintln!("stopping; press Ctrl-C again to end at once");
                interrupts.next().await;
                std::process::exit(KILLED_BY_INTERRUPT);
            });
        };
        std::thread::Builder::new().name("signals".into()).spawn(listen)?;
        Ok(signal)
    }

    /// Stops the run.
    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    /// Whether the signal was raised.
    pub fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    /// The result of a future; `None` where the signal is raised before.
    pub async fn until<T>(&self, future: impl Future<Output = T>) -> Option<T> {
        let stopped = async {
            while !self.is_stopped() {
                tokio::time::sleep(NOTICE).await;
            }
        };
        tokio::select! {
            result = future => Some(result),
            () = stopped => None,
        }
    }

    /// Sleeps until the signal is raised.
    pub fn wait(&self) {
        while !self.is_stopped() {
            std::thread::sleep(NOTICE);
        }
    }

    /// Sleeps until `due`, or until the signal is raised.
    pub fn sleep_until(&self, due: Instant) {
        while !self.is_stopped() {
            let left = due.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            std::thread::sleep(left.min(NOTICE));
        }
    }
}

/// A runtime whose end does not wait for what still blocks its threads, as an attempt to connect does for seconds.
#[derive(Debug)]
pub struct NetworkRuntime {
    handle: Handle,
    /// Until it is dropped.
    runtime: Option<Runtime>,
}

impl NetworkRuntime {
    /// With two threads.
    ///
    /// # Errors
    /// The operating system refuses a thread.
    pub fn new() -> std::io::Result<Self> {
        let runtime = Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
        Ok(Self { handle: runtime.handle().clone(), runtime: Some(runtime) })
    }

    /// Runs a future to its end.
    pub fn block_on<F: Future>(&self, future: F) -> F::Output {
        self.handle.block_on(future)
    }

    /// For those who start tasks.
    pub fn handle(&self) -> &Handle {
        &self.handle
    }
}

impl Drop for NetworkRuntime {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(END);
        }
    }
}

#[cfg(unix)]
struct Interrupts {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Interrupts {
    fn listen() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self { interrupt: signal(SignalKind::interrupt())?, terminate: signal(SignalKind::terminate())? })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

#[cfg(not(unix))]
struct Interrupts;

#[cfg(not(unix))]
impl Interrupts {
    fn listen() -> std::io::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}
