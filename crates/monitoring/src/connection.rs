//! A connection that ends where nothing moves, or where its reader is too slow.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::OwnedSemaphorePermit;
use tokio::time::{Instant, Sleep, sleep};

use crate::activity::Activity;

/// A connection on which nothing was received or sent for this long is closed. Viewers answer pings more often.
const IDLE: Duration = Duration::from_mins(1);

/// A reader that lets data wait must take so many bytes ...
const PACE_BYTES: usize = 480 << 10;
/// ... in this time, or is disconnected: 16 KiB a second.
const PACE_PERIOD: Duration = Duration::from_secs(30);

/// A connection that counts.
pub(crate) struct LimitedConnection {
    stream: TcpStream,
    idle: Pin<Box<Sleep>>,
    pace: Pace,
    activity: Arc<Activity>,
    _permit: OwnedSemaphorePermit,
}

/// How fast a reader takes what waits for it.
struct Pace {
    period: Duration,
    /// The end of the period; `None` while nothing waits.
    end: Option<Pin<Box<Sleep>>>,
    taken: usize,
}

impl Pace {
    fn new(period: Duration) -> Self {
        Self { period, end: None, taken: 0 }
    }

    /// Notes a write, or ends the connection where the reader took too little.
    fn watch(
        &mut self,
        polled: Poll<io::Result<usize>>,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<usize>> {
        match polled {
            Poll::Ready(Ok(bytes)) => {
                self.taken += bytes;
                if self.taken >= PACE_BYTES {
                    self.end = None;
                }
                polled
            }
            Poll::Ready(Err(_)) => polled,
            Poll::Pending => {
                let end = self.end.get_or_insert_with(|| {
                    self.taken = 0;
                    Box::pin(sleep(self.period))
                });
                match end.as_mut().poll(context) {
                    Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
                    Poll::Pending => Poll::Pending,
                }
            }
        }
    }

    /// Everything was taken.
    fn rest(&mut self) {
        self.end = None;
    }
}

impl LimitedConnection {
    pub(crate) fn new(stream: TcpStream, activity: Arc<Activity>, permit: OwnedSemaphorePermit) -> Self {
        let idle = Box::pin(sleep(IDLE));
        Self { stream, idle, pace: Pace::new(PACE_PERIOD), activity, _permit: permit }
    }

    /// Restarts the time without progress, or ends the connection after it.
    fn watch<T>(&mut self, polled: Poll<io::Result<T>>, context: &mut Context<'_>) -> Poll<io::Result<T>> {
        if polled.is_ready() {
            let now = Instant::now();
            self.idle.as_mut().reset(now + IDLE);
            self.activity.note(now);
            return polled;
        }
        match self.idle.as_mut().poll(context) {
            Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
    }
}

impl AsyncRead for LimitedConnection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_read(context, buffer);
        self.watch(polled, context)
    }
}

impl AsyncWrite for LimitedConnection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write(context, bytes);
        let polled = self.pace.watch(polled, context);
        if polled.is_ready() {
            self.activity.note_answer();
        }
        self.watch(polled, context)
    }

    // Without vectored writes, hyper copies each body into a buffer of the connection.
    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write_vectored(context, parts);
        let polled = self.pace.watch(polled, context);
        if polled.is_ready() {
            self.activity.note_answer();
        }
        self.watch(polled, context)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.pace.rest();
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::future::poll_fn;

    const PERIOD: Duration = Duration::from_millis(100);

    /// Writes to a reader that takes `bytes` each 10 ms; whether it is still connected after several periods.
    async fn is_kept(bytes: usize) -> bool {
        let mut pace = Pace::new(PERIOD);
        let end = Instant::now() + 5 * PERIOD;
        while Instant::now() < end {
            let mut taking = Box::pin(sleep(Duration::from_millis(10)));
            let written = poll_fn(|context| {
                let polled = taking.as_mut().poll(context).map(|()| Ok(bytes));
                pace.watch(polled, context)
            });
            if written.await.is_err() {
                return false;
            }
        }
        true
    }

    #[tokio::test]
    async fn a_reader_that_takes_next_to_nothing_is_disconnected() {
        assert!(is_kept(PACE_BYTES).await);
        assert!(!is_kept(1).await);
        assert!(!is_kept(PACE_BYTES / 100).await);
    }

    #[tokio::test]
    async fn a_reader_for_whom_nothing_waits_may_take_its_time() {
        let mut pace = Pace::new(PERIOD);
        for _ in 0..3 {
            let waits = poll_fn(|context| Poll::Ready(pace.watch(Poll::Pending, context).is_pending()));
            assert!(waits.await);
            pace.rest();
            sleep(2 * PERIOD).await;
        }
    }
}
