//! A way to a server on which packets get lost.

use std::time::Duration;

use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};

/// How long TCP waits before it sends the last packet of a burst again: nothing follows whose receipt would tell that it got lost.
const REPEAT: Duration = Duration::from_millis(200);
/// Bytes that are forwarded at a time: a query is one burst.
const BURST_BYTES: usize = 64 << 10;

/// Forwards connections to an endpoint; each burst is late with this probability.
///
/// # Returns
/// The endpoint to connect to instead.
pub async fn lossy(endpoint: &str, probability: f64, seed: u64) -> String {
    let target = endpoint.trim_start_matches("tcp/").to_owned();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let near_endpoint = format!("tcp/{}", listener.local_addr().unwrap());
    tokio::spawn(async move {
        let mut rng = StdRng::seed_from_u64(seed);
        loop {
            let Ok((near, _)) = listener.accept().await else { continue };
            let Ok(far) = TcpStream::connect(&target).await else { continue };
            for stream in [&near, &far] {
                stream.set_nodelay(true).unwrap();
            }
            let ((from_near, to_near), (from_far, to_far)) = (near.into_split(), far.into_split());
            for (from, to) in [(from_near, to_far), (from_far, to_near)] {
                tokio::spawn(forward(from, to, probability, StdRng::seed_from_u64(rng.random())));
            }
        }
    });
    near_endpoint
}

async fn forward(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, probability: f64, mut rng: StdRng) {
    let mut burst = vec![0; BURST_BYTES];
    while let Ok(read @ 1..) = from.read(&mut burst).await {
        if rng.random_bool(probability) {
            tokio::time::sleep(REPEAT).await;
        }
        if to.write_all(&burst[..read]).await.is_err() {
            return;
        }
    }
}
