//! A session with a broker: MQTT 3.1.1 over TCP or TLS, for a client that only publishes.

use bytes::BytesMut;
use rumqttc::mqttbytes;
use rumqttc::{Connect, ConnectReturnCode, Packet, Publish, QoS};
use rustls::ClientConfig;
use rustls::pki_types::ServerName;
use std::io;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::sync::mpsc::Receiver;
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_rustls::TlsConnector;

/// Time within which a broker must have a sign of life, as the standard suggests: after one and a half of it it publishes the last will.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// How long the broker may take to answer, or to take a message.
const PATIENCE: Duration = Duration::from_secs(5);
/// Longest packet, bytes: brokers send a client that subscribes to nothing a few bytes at a time.
const MAX_PACKET: usize = 64 * 1024;

/// Why a session cannot begin, or ended.
#[derive(Debug, Error)]
pub(crate) enum SessionError {
    #[error("{0}")]
    Network(#[from] io::Error),
    #[error("no connection by TLS: {0}")]
    Tls(io::Error),
    #[error("it does not answer")]
    Silent,
    #[error("it refuses the connection: {0:?}")]
    Refused(ConnectReturnCode),
    #[error("what it sends, or is to be sent, is not MQTT 3.1.1: {0}")]
    Malformed(mqttbytes::Error),
    #[error("it ended the connection")]
    Ended,
}

/// Where the broker is.
#[derive(Clone, Debug)]
pub(crate) struct Endpoint {
    pub(crate) host: String,
    pub(crate) port: u16,
    /// Where it is reached by TLS: the configuration, and the name for which the broker's certificate must be valid.
    pub(crate) tls: Option<(Arc<ClientConfig>, ServerName<'static>)>,
}

trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}
impl<S: AsyncRead + AsyncWrite + Send + Unpin> Stream for S {}

/// A session that the broker accepted.
pub(crate) struct Session {
    stream: Box<dyn Stream>,
    unread: BytesMut,
    packet_id: u16,
    /// Messages that the broker has not acknowledged.
    unacknowledged: usize,
}

impl Session {
    /// Connects, and waits until the broker accepts the session.
    pub(crate) async fn open(endpoint: &Endpoint, connect: Connect) -> Result<Self, SessionError> {
        let stream = within(stream_to(endpoint)).await?;
        let mut session = Self { stream, unread: BytesMut::new(), packet_id: 0, unacknowledged: 0 };
        let keep_alive = KEEP_ALIVE.as_secs() as u16;
        session.send(&Packet::Connect(Connect { keep_alive, ..connect })).await?;
        match within(session.next()).await? {
            Packet::ConnAck(answer) if answer.code == ConnectReturnCode::Success => Ok(session),
            Packet::ConnAck(answer) => Err(SessionError::Refused(answer.code)),
            _ => Err(SessionError::Malformed(mqttbytes::Error::IncorrectPacketFormat)),
        }
    }

    /// Publishes messages until their sender is gone; then waits until those that the broker acknowledges were, and ends in good order. An
    /// acknowledgement that is not read resets the connection, and the broker publishes the last will.
    ///
    /// # Errors
    /// What broke the session.
    pub(crate) async fn run(mut self, mut messages: Receiver<Publish>) -> Result<(), SessionError> {
        let mut pings = interval(KEEP_ALIVE / 2);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        pings.reset();
        let (mut is_answered, mut is_over) = (true, false);
        while !is_over || self.unacknowledged > 0 {
            tokio::select! {
                packet = self.next() => match packet? {
                    Packet::PubAck(_) => self.unacknowledged = self.unacknowledged.saturating_sub(1),
                    Packet::PingResp => is_answered = true,
                    _ => {}
                },
                message = messages.recv(), if !is_over => match message {
                    Some(message) => self.publish(message).await?,
                    None => is_over = true,
                },
                _ = pings.tick() => {
                    if !is_answered {
                        return Err(SessionError::Silent);
                    }
                    is_answered = false;
                    self.send(&Packet::PingReq).await?;
                }
            }
        }
        self.send(&Packet::Disconnect).await?;
        within(async { Ok(self.stream.shutdown().await?) }).await
    }

    async fn publish(&mut self, mut message: Publish) -> Result<(), SessionError> {
        if message.qos != QoS::AtMostOnce {
            // 0 is no id.
            self.packet_id = self.packet_id.checked_add(1).unwrap_or(1);
            message.pkid = self.packet_id;
            self.unacknowledged += 1;
        }
        self.send(&Packet::Publish(message)).await
    }

    async fn send(&mut self, packet: &Packet) -> Result<(), SessionError> {
        let mut bytes = BytesMut::new();
        packet.write(&mut bytes, MAX_PACKET).map_err(SessionError::Malformed)?;
        within(async {
            self.stream.write_all(&bytes).await?;
            Ok(self.stream.flush().await?)
        })
        .await
    }

    /// The next packet. It may be cancelled: nothing is lost.
    async fn next(&mut self) -> Result<Packet, SessionError> {
        loop {
            match Packet::read(&mut self.unread, MAX_PACKET) {
                Ok(packet) => return Ok(packet),
                Err(mqttbytes::Error::InsufficientBytes(_)) => {}
                Err(error) => return Err(SessionError::Malformed(error)),
            }
            if self.stream.read_buf(&mut self.unread).await? == 0 {
                return Err(SessionError::Ended);
            }
        }
    }
}

async fn stream_to(endpoint: &Endpoint) -> Result<Box<dyn Stream>, SessionError> {
    let stream = TcpStream::connect((endpoint.host.as_str(), endpoint.port)).await?;
    stream.set_nodelay(true)?;
    match &endpoint.tls {
        None => Ok(Box::new(stream)),
        Some((config, name)) => {
            let connector = TlsConnector::from(Arc::clone(config));
            Ok(Box::new(connector.connect(name.clone(), stream).await.map_err(SessionError::Tls)?))
        }
    }
}

async fn within<T>(doing: impl Future<Output = Result<T, SessionError>>) -> Result<T, SessionError> {
    timeout(PATIENCE, doing).await.unwrap_or(Err(SessionError::Silent))
}
