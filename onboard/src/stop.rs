//! Stopping a run from outside: the first Ctrl-C (or SIGTERM) ends it in good order, the second at once.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio::runtime::Builder;

/// How long a sleeping run may take to notice the signal.
const NOTICE: Duration = Duration::from_millis(20);
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
