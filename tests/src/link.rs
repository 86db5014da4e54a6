//! A network link between two programs that can be slowed down, silenced and cut.

use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::Handle;
use tokio::sync::watch;

/// Bytes that are forwarded at a time.
const CHUNK_BYTES: usize = 16 << 10;

/// How a link does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Condition {
    /// Nothing is held back.
    Good,
    /// Each chunk is late, and there are so many bytes a second.
    Slow {
        /// Bytes a second.
        bytes_per_s: u32,
        /// Delay of a chunk.
        delay: Duration,
    },
    /// Connections stay, nothing arrives: out of range.
    Silent,
    /// Connections are closed, new ones too.
    Cut,
}

/// A forwarder of TCP connections.
#[derive(Debug)]
pub struct Link {
    endpoint: String,
    condition: watch::Sender<Condition>,
}

impl Link {
    /// Forwards connections to an endpoint, `tcp/127.0.0.1:port`, where there may be nobody yet.
    pub fn to(endpoint: &str, runtime: &Handle) -> Self {
        let target = endpoint.trim_start_matches("tcp/").to_owned();
        let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
        let (condition, watched) = watch::channel(Condition::Good);
        let link = Self { endpoint: format!("tcp/{}", listener.local_addr().unwrap()), condition };
        runtime.spawn(accept(listener, target, watched));
        link
    }

    /// What to connect to instead.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Changes how it does, at once.
    pub fn set(&self, condition: Condition) {
        self.condition.send_replace(condition);
    }
}

async fn accept(listener: TcpListener, target: String, condition: watch::Receiver<Condition>) {
    loop {
        let Ok((near, _)) = listener.accept().await else { continue };
        if *condition.borrow() == Condition::Cut {
            continue;
        }
        let Ok(far) = TcpStream::connect(&target).await else { continue };
        let ((from_near, to_near), (from_far, to_far)) = (near.into_split(), far.into_split());
        tokio::spawn(forward(from_near, to_far, condition.clone()));
        tokio::spawn(forward(from_far, to_near, condition.clone()));
    }
}

/// Forwards until one side ends or the link is cut; dropping the halves closes the connection.
async fn forward(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, mut condition: watch::Receiver<Condition>) {
    let mut chunk = vec![0; CHUNK_BYTES];
    loop {
        let read = tokio::select! {
            read = from.read(&mut chunk) => read.unwrap_or(0),
            cut = condition.wait_for(|condition| *condition == Condition::Cut) => {
                drop(cut);
                0
            }
        };
        let Ok(open) = condition.wait_for(|condition| *condition != Condition::Silent).await.map(|now| *now)
        else {
            return;
        };
        if read == 0 || open == Condition::Cut {
            return;
        }
        if let Condition::Slow { bytes_per_s, delay } = open {
            let sending = Duration::from_secs_f64(read as f64 / f64::from(bytes_per_s.max(1)));
            tokio::time::sleep(delay + sending).await;
        }
        if to.write_all(&chunk[..read]).await.is_err() {
            return;
        }
    }
}
