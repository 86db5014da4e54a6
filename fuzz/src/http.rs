//! What comes to the port of metrics and of the page.

use monitoring::{Health, MonitoringServer};
use prometheus_client::registry::Registry;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::sync::OnceLock;
use std::time::Duration;

/// A connection whose sender has ended is over within this time.
const END: Duration = Duration::from_secs(5);
/// A request that is answered.
const HEALTH: &[u8] = b"GET /health HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";

/// The head of a request, and whatever follows it.
///
/// # Panics
/// The answer is none of HTTP, the connection stays open, or the server no longer answers others.
pub fn http_heads(data: &[u8]) {
    let answer = answer_to(data, true);
    assert!(answer.is_empty() || answer.starts_with(b"HTTP/1."), "{}", String::from_utf8_lossy(&answer));
    assert!(answer_to(HEALTH, false).starts_with(b"HTTP/1.1 200"), "the next one is served");
}

/// `ends`: whether the sender says that nothing more follows, after which the server need not answer.
fn answer_to(request: &[u8], ends: bool) -> Vec<u8> {
    let mut stream = TcpStream::connect(server()).expect("the server listens");
    stream.set_read_timeout(Some(END)).expect("a time that is not zero");
    // The server may have answered and closed the connection before all was sent.
    let _ = stream.write_all(request);
    if ends {
        let _ = stream.shutdown(Shutdown::Write);
    }
    let mut answer = Vec::new();
    match stream.read_to_end(&mut answer) {
        Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => {}
        ended => drop(ended.expect("the connection ends")),
    }
    answer
}

/// One server for all inputs, on threads of its own.
fn server() -> SocketAddr {
    static ADDRESS: OnceLock<SocketAddr> = OnceLock::new();
    *ADDRESS.get_or_init(|| {
        let (tell, told) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
            runtime.expect("a runtime").block_on(async {
                let any = SocketAddr::from(([127, 0, 0, 1], 0));
                let started = MonitoringServer::start(any, Registry::default(), || Health::well("serving"));
                let server = started.await.expect("a free port");
                tell.send(server.address()).expect("somebody waits");
                std::future::pending::<()>().await;
            });
        });
        told.recv().expect("the server starts")
    })
}
