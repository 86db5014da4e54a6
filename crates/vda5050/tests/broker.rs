//! A broker of MQTT 3.1.1 that takes what clients publish, and shows it.

use rustls::ServerConfig;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::TcpListener;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::{JoinHandle, JoinSet};
use tokio_rustls::TlsAcceptor;

/// A message, or a last will.
#[derive(Clone, Debug, PartialEq)]
pub struct Message {
    pub topic: String,
    pub payload: serde_json::Value,
    pub qos: u8,
    pub is_retained: bool,
}

/// What came from a client.
#[derive(Clone, Debug, PartialEq)]
pub enum Received {
    Connect {
        id: String,
        will: Option<Message>,
        user: Option<(String, String)>,
    },
    Publish(Message),
    Disconnect,
    /// The connection ended without a `Disconnect`.
    Broken,
    /// A connection that was to be by TLS.
    NoTls(String),
}

/// The broker; it ends with all its connections when it is dropped.
pub struct Broker {
    pub address: SocketAddr,
    received: UnboundedReceiver<Received>,
    serving: JoinHandle<()>,
}

impl Broker {
    /// Listens on a port of the loopback; 0 takes any.
    ///
    /// # Arguments
    /// * `code`: the answer to each connection: 0 accepts it.
    pub async fn start(port: u16, code: u8) -> Self {
        Self::start_with(port, code, None).await
    }

    /// The same, by TLS where there is a configuration of it.
    pub async fn start_with(port: u16, code: u8, tls: Option<ServerConfig>) -> Self {
        let tls = tls.map(|config| TlsAcceptor::from(Arc::new(config)));
        let listener = TcpListener::bind(("127.0.0.1", port)).await.unwrap();
        let address = listener.local_addr().unwrap();
        let (sender, received) = unbounded_channel();
        let serving = tokio::spawn(async move {
            let mut connections = JoinSet::new();
            loop {
                let (stream, _) = listener.accept().await.unwrap();
                let (tls, sender) = (tls.clone(), sender.clone());
                connections.spawn(async move {
                    match tls {
                        None => serve(stream, code, sender).await,
                        Some(tls) => match tls.accept(stream).await {
                            Ok(stream) => serve(stream, code, sender).await,
                            Err(error) => {
                                let _ = sender.send(Received::NoTls(error.to_string()));
                            }
                        },
                    }
                });
            }
        });
        Self { address, received, serving }
    }

    pub fn url(&self) -> String {
        format!("mqtt://{}", self.address)
    }

    pub async fn next(&mut self) -> Received {
        tokio::time::timeout(Duration::from_secs(20), self.received.recv()).await.unwrap().unwrap()
    }

    /// The next message of a topic that satisfies a condition.
    pub async fn message(&mut self, topic: &str, is_wanted: impl Fn(&serde_json::Value) -> bool) -> Message {
        loop {
            match self.next().await {
                Received::Publish(message)
                    if message.topic.ends_with(topic) && is_wanted(&message.payload) =>
                {
                    return message;
                }
                _ => {}
            }
        }
    }

    /// Whether nothing came that was not looked at.
    pub fn is_idle(&mut self) -> bool {
        self.received.try_recv().is_err()
    }

    /// Ends the broker and all its connections, and waits until its port is free.
    pub async fn stop(mut self) {
        self.serving.abort();
        let _ = (&mut self.serving).await;
    }
}

impl Drop for Broker {
    fn drop(&mut self) {
        self.serving.abort();
    }
}

/// The bytes of a packet that were not read yet.
struct Body<'a>(&'a [u8]);

impl<'a> Body<'a> {
    fn take(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.0.split_at(count);
        self.0 = rest;
        taken
    }

    fn number(&mut self) -> usize {
        usize::from(u16::from_be_bytes(self.take(2).try_into().unwrap()))
    }

    fn bytes(&mut self) -> &'a [u8] {
        let count = self.number();
        self.take(count)
    }

    fn text(&mut self) -> String {
        String::from_utf8(self.bytes().to_vec()).unwrap()
    }
}

/// First byte and body of the next packet; `None` at the end of the stream.
async fn packet(stream: &mut (impl AsyncRead + Unpin)) -> Option<(u8, Vec<u8>)> {
    let first = stream.read_u8().await.ok()?;
    let (mut length, mut shift) = (0_usize, 0);
    loop {
        let byte = stream.read_u8().await.ok()?;
        length |= usize::from(byte & 0x7f) << shift;
        shift += 7;
        if byte & 0x80 == 0 {
            break;
        }
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body).await.ok()?;
    Some((first, body))
}

fn connect(body: &[u8]) -> Received {
    let mut body = Body(body);
    assert_eq!((body.text().as_str(), body.take(1)), ("MQTT", &[4_u8][..]));
    let flags = body.take(1)[0];
    let keep_alive = body.number();
    assert_eq!(keep_alive, 15);
    let id = body.text();
    let will = (flags & 0x04 != 0).then(|| Message {
        topic: body.text(),
        payload: serde_json::from_slice(body.bytes()).unwrap(),
        qos: flags >> 3 & 3,
        is_retained: flags & 0x20 != 0,
    });
    let user = (flags & 0x80 != 0).then(|| (body.text(), body.text()));
    Received::Connect { id, will, user }
}

async fn serve(mut stream: impl AsyncRead + AsyncWrite + Unpin, code: u8, sender: UnboundedSender<Received>) {
    let mut has_ended = false;
    while let Some((first, body)) = packet(&mut stream).await {
        let (received, answer) = match first >> 4 {
            1 => (Some(connect(&body)), vec![0x20, 2, 0, code]),
            3 => {
                let (qos, mut body) = (first >> 1 & 3, Body(&body));
                let topic = body.text();
                let answer = if qos > 0 { [&[0x40, 2], body.take(2)].concat() } else { Vec::new() };
                let payload = serde_json::from_slice(body.0).unwrap();
                let message = Message { topic, payload, qos, is_retained: first & 1 != 0 };
                (Some(Received::Publish(message)), answer)
            }
            12 => (None, vec![0xd0, 0]),
            14 => {
                has_ended = true;
                (Some(Received::Disconnect), Vec::new())
            }
            other => panic!("a packet of type {other}"),
        };
        if let Some(received) = received {
            let _ = sender.send(received);
        }
        let _ = stream.write_all(&answer).await;
    }
    if !has_ended {
        let _ = sender.send(Received::Broken);
    }
}
