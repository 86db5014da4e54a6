//! Readers that let large answers wait hold no memory of the server for each of them.

use crate::common::Shown;
use map::MapMetadata;
use nalgebra::Vector3;
use protocol::DescriptorKind;
use testing::resident_mb;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use viewer::{MAX_LANDMARKS, ViewedMap};

/// More than the buffers of the operating system take, and less than the limit of connections.
const READERS: usize = 100;

#[tokio::test(flavor = "multi_thread")]
async fn a_hundred_readers_share_one_answer() {
    let shown = Shown::start().await;
    let points = (0..MAX_LANDMARKS).map(|at| Vector3::new(at as f64, 0.0, 0.0));
    let info = MapMetadata::new("city", "test", DescriptorKind::Binary, 32);
    shown.viewer.set_map(ViewedMap::new("city", &info, std::iter::empty(), points));
    let length = shown.body("/api/maps/city/landmarks").await.len();
    assert_eq!(length, 12 * MAX_LANDMARKS);

    let before = resident_mb(std::process::id()).unwrap();
    let mut readers = Vec::new();
    for _ in 0..READERS {
        let mut stream = TcpStream::connect(shown.address()).await.unwrap();
        let request = format!("GET /api/maps/city/landmarks HTTP/1.1\r\nHost: {}\r\n\r\n", shown.address());
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut first = [0; 12];
        stream.read_exact(&mut first).await.unwrap();
        assert_eq!(&first, b"HTTP/1.1 200");
        readers.push(stream);
    }
    // All of them are being answered.
    shown.body("/api/maps").await;
    let grown = resident_mb(std::process::id()).unwrap() - before;
    assert!(grown < 100.0, "{grown} MB for {READERS} readers of {} MB each", length / 1_000_000);
    drop(readers);
}
