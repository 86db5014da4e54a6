//! How a run is stopped from outside: the first Ctrl-C (or SIGTERM) ends it in good order, the second at once.

use anyhow::{Context as _, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio::runtime::Builder;

/// How long a sleeping run may take to notice that it is to stop.
const NOTICE: Duration = Duration::from_millis(20);
/// Exit status of a program that an interrupt killed, as shells report it.
const KILLED_BY_INTERRUPT: i32 = 130;

/// Tells a run to stop. Clones tell the same run.
#[derive(Clone, Debug, Default)]
pub struct StopSignal {
    stopped: Arc<AtomicBool>,
}

impl StopSignal {
    /// A signal that comes with SIGINT (Ctrl-C) or SIGTERM. The second one ends the program without further ado.
    ///
    /// # Errors
    /// The system lets nobody listen to signals.
    pub fn on_interrupt() -> Result<Self> {
        let signal = Self::default();
        let told = signal.clone();
        let runtime =
            Builder::new_current_thread().enable_io().build().context("signals cannot be listened to")?;
        let mut interrupts = {
            let _entered = runtime.enter();
            Interrupts::listen().context("signals cannot be listened to")?
        };
        let listen = move || {
            runtime.block_on(async {
                interrupts.next().await;
                told.stop();
                eprintln!("stopping; press Ctrl-C again to end at once");
                interrupts.next().await;
                std::process::exit(KILLED_BY_INTERRUPT);
            });
        };
        std::thread::Builder::new()
            .name("signals".into())
            .spawn(listen)
            .context("no thread to listen to signals")?;
        Ok(signal)
    }

    /// Tells the run to stop.
    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    /// Whether the run is to stop.
    pub fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    /// Sleeps until `due`, or until the run is to stop.
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
