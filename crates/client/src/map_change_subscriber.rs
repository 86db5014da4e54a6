//! Subscription to the changes of a map: `map/{map}/changes`.
//!
//! Notices are decoded where they arrive and wait in a short queue for the receiving thread, which never blocks. If a
//! notice is lost (full queue, unreadable message, published before the subscription), a robot loses its pose in the map
//! until the next answer, as after any change without a notice.

use crate::error::ClientError;
use protocol::{CodecError, Format, MapChangeNotice, keys};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

/// Notices that may wait: a map changes every few minutes at most.
const QUEUE_LENGTH: usize = 16;
/// Notices that may come at once after a pause; then one each [`REFILL`].
const BURST: u32 = 8;
/// Time after which one more notice is taken: each may cost a robot its pose in the map for a moment.
const REFILL: Duration = Duration::from_secs(10);

/// A subscription and the notices that it received.
///
/// # Example
/// ```
/// use client::{MapChangeSubscriber, SessionOptions, open_session};
/// use protocol::Format;
///
/// # #[tokio::main]
/// # async fn main() -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
/// let session = open_session(&SessionOptions::default()).await?;
/// let mut changes = MapChangeSubscriber::subscribe(&session, "hall").await?;
///
/// // What a map server publishes when it replaces a map:
/// let notice = r#"{"schema": 10, "map": "hall", "identity": "8f3c1e0a5b7d4926a1c04be2d97f6350",
///     "from_version": 4, "version": 5, "moved": [41]}"#;
/// session.put("map/hall/changes", notice).encoding(Format::Json.encoding()).await?;
///
/// let notice = loop {
///     if let Some(notice) = changes.poll() {
///         break notice;
///     }
///     tokio::task::yield_now().await;
/// };
/// assert_eq!((notice.from_version, notice.version), (4, 5));
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct MapChangeSubscriber {
    receiver: Receiver<MapChangeNotice>,
    _subscriber: Subscriber<()>,
}

impl MapChangeSubscriber {
    /// Subscribes to the changes of a map.
    ///
    /// # Errors
    /// [`ClientError::Subscribe`]: a name that cannot be part of a key, or a closed session.
    pub async fn subscribe(session: &zenoh::Session, map: &str) -> Result<Self, ClientError> {
        let failed = |problem: String| ClientError::Subscribe { map: map.to_owned(), problem };
        let key = keys::map_changes(map).map_err(|error| failed(error.to_string()))?;
        let (sender, receiver) = sync_channel(QUEUE_LENGTH);
        let name = map.to_owned();
        let rate = Mutex::new(Rate { left: BURST, since: Instant::now() });
        let callback = move |sample: Sample| enqueue(&name, &sample, &sender, &rate);
        let declared = session.declare_subscriber(key).callback(callback).await;
        let subscriber = declared.map_err(|error| failed(error.to_string()))?;
        Ok(Self { receiver, _subscriber: subscriber })
    }

    /// The next notice that is available now.
    pub fn poll(&mut self) -> Option<MapChangeNotice> {
        self.receiver.try_recv().ok()
    }
}

/// Why a notice is ignored.
#[derive(Debug, thiserror::Error)]
enum NoticeError {
    #[error(transparent)]
    Codec(#[from] CodecError),
    #[error("the notice is about map {0}")]
    OtherMap(String),
}

/// How many notices are still taken: a token bucket.
#[derive(Debug)]
struct Rate {
    left: u32,
    /// From when on the next one is counted.
    since: Instant,
}

impl Rate {
    fn allows(&mut self, now: Instant) -> bool {
        let more = now.saturating_duration_since(self.since).as_secs() / REFILL.as_secs();
        let more = u32::try_from(more).unwrap_or(u32::MAX).min(BURST);
        if more > 0 {
            self.left = (self.left + more).min(BURST);
            self.since = now;
        }
        let allowed = self.left > 0;
        self.left = self.left.saturating_sub(1);
        allowed
    }
}

fn enqueue(map: &str, sample: &Sample, queue: &SyncSender<MapChangeNotice>, rate: &Mutex<Rate>) {
    if !rate.lock().unwrap_or_else(PoisonError::into_inner).allows(Instant::now()) {
        tracing::debug!(map, "ignored a notice of a map change: they come too often; who publishes them?");
        return;
    }
    let format = Format::from_encoding(&sample.encoding().to_string()).unwrap_or_default();
    match read(map, format, &sample.payload().to_bytes()) {
        // A full queue drops the notice.
        Ok(notice) => drop(queue.try_send(notice)),
        Err(reason) => tracing::warn!(map, %reason, "ignored a notice of a map change"),
    }
}

fn read(map: &str, format: Format, payload: &[u8]) -> Result<MapChangeNotice, NoticeError> {
    let notice: MapChangeNotice = protocol::decode(format, payload)?;
    if notice.map != map {
        return Err(NoticeError::OtherMap(notice.map));
    }
    Ok(notice)
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{MapIdentity, StatedChange};

    fn notice() -> MapChangeNotice {
        MapChangeNotice {
            map: "hall".to_owned(),
            identity: MapIdentity::from_bytes([7; 16]),
            from_version: 3,
            version: 4,
            changed: vec![1, 2, 5],
            moved: vec![2, 5],
            removed: vec![9],
            stated_change: Some(StatedChange { sigma_theta_rad: 0.01, sigma_p_m: 0.2 }),
            keyframe_motions: Vec::new(),
        }
    }

    #[test]
    fn notices_are_read_in_both_formats() {
        for format in [Format::Bincode, Format::Json] {
            let payload = protocol::encode(format, &notice()).unwrap();
            assert_eq!(read("hall", format, &payload).unwrap(), notice());
        }
    }

    #[test]
    fn damaged_foreign_and_invalid_notices_are_refused() {
        let payload = protocol::encode(Format::Bincode, &notice()).unwrap();
        assert!(read("yard", Format::Bincode, &payload).unwrap_err().to_string().contains("hall"));
        for damaged in [&payload[..payload.len() / 2], b"", b"{}"] {
            assert!(read("hall", Format::Bincode, damaged).is_err());
        }
        let json = String::from_utf8(protocol::encode(Format::Json, &notice()).unwrap()).unwrap();
        let negative = json.replace("0.01", "-0.01");
        let error = read("hall", Format::Json, negative.as_bytes()).unwrap_err().to_string();
        assert!(error.contains("sigma_theta_rad"), "{error}");
        for (from, to, field) in [
            ("0.2", "1e160", "sigma_p_m"),
            ("0.01", "4", "sigma_theta_rad"),
            ("\"version\":4", "\"version\":3", "version"),
        ] {
            assert!(json.contains(from), "{json}");
            let error =
                read("hall", Format::Json, json.replace(from, to).as_bytes()).unwrap_err().to_string();
            assert!(error.contains(field), "{error}");
        }
    }

    #[test]
    fn notices_are_taken_in_bursts_and_then_at_a_rate() {
        let begin = Instant::now();
        let mut rate = Rate { left: BURST, since: begin };
        let taken = |rate: &mut Rate, at: Duration| (0..100).filter(|_| rate.allows(begin + at)).count();
        assert_eq!(taken(&mut rate, Duration::ZERO), BURST as usize);
        assert_eq!(taken(&mut rate, REFILL / 2), 0);
        assert_eq!(taken(&mut rate, REFILL), 1);
        assert_eq!(taken(&mut rate, 1000 * REFILL), BURST as usize);
    }
}
