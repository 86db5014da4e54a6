//! Hears when the map changes: `map/{map}/changes`.
//!
//! News are decoded where they arrive and wait in a short queue for the estimator's thread, which never waits for them.
//! Whatever gets lost (a full queue, a message that cannot be read, one that was sent before the robot came) costs the
//! robot its pose in the map until the next answer, which is what a change without news costs.

use estimator::{ChangeSize, MapRevision};
use protocol::{Format, MapChange, keys};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use tokio::runtime::Handle;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

/// News that may wait: a map changes every few minutes at most.
const QUEUE: usize = 16;

/// The subscription, and what it heard.
#[derive(Debug)]
pub struct MapChangeSubscriber {
    receiver: Receiver<MapRevision>,
    _subscriber: Subscriber<()>,
}

impl MapChangeSubscriber {
    /// Listens from now on.
    ///
    /// # Errors
    /// A sentence: a map name that no key can hold, or a closed session.
    pub fn subscribe(session: &zenoh::Session, runtime: &Handle, map: &str) -> Result<Self, String> {
        let key = keys::map_changes(map).map_err(|error| error.to_string())?;
        let (sender, receiver) = sync_channel(QUEUE);
        let name = map.to_owned();
        let hear = move |sample: Sample| hear(&name, &sample, &sender);
        let subscriber = runtime
            .block_on(async { session.declare_subscriber(key).callback(hear).await })
            .map_err(|error| format!("the robot cannot hear of changes of the map {map}: {error}"))?;
        Ok(Self { receiver, _subscriber: subscriber })
    }

    /// The next news that are already here.
    pub fn poll(&self) -> Option<MapRevision> {
        self.receiver.try_recv().ok()
    }
}

fn hear(map: &str, sample: &Sample, queue: &SyncSender<MapRevision>) {
    let format = Format::from_encoding(&sample.encoding().to_string()).unwrap_or_default();
    match read(map, format, &sample.payload().to_bytes()) {
        // A robot that takes nothing in any more misses nothing.
        Ok(revision) => drop(queue.try_send(revision)),
        Err(reason) => tracing::warn!(map, reason, "news of the map are left out"),
    }
}

/// From the wire to the estimator's terms.
fn read(map: &str, format: Format, payload: &[u8]) -> Result<MapRevision, String> {
    let change: MapChange = protocol::decode(format, payload).map_err(|error| error.to_string())?;
    if change.map != map {
        return Err(format!("they are of the map {}", change.map));
    }
    let size = change.stated_change.map(|size| ChangeSize {
        sigma_rotation_rad: size.sigma_theta_rad,
        sigma_position_m: size.sigma_p_m,
    });
    let mut changed_keyframes = change.moved;
    changed_keyframes.extend(change.removed);
    Ok(MapRevision { from_version: change.from_version, version: change.version, changed_keyframes, size })
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::StatedChange;

    fn change() -> MapChange {
        MapChange {
            map: "hall".to_owned(),
            from_version: 3,
            version: 4,
            changed: vec![1, 2, 5],
            moved: vec![2, 5],
            removed: vec![9],
            stated_change: Some(StatedChange { sigma_theta_rad: 0.01, sigma_p_m: 0.2 }),
        }
    }

    #[test]
    fn news_say_which_errors_are_others_and_how_far_the_map_moved() {
        for format in [Format::Bincode, Format::Json] {
            let payload = protocol::encode(format, &change()).unwrap();
            let revision = read("hall", format, &payload).unwrap();
            assert_eq!((revision.from_version, revision.version), (3, 4));
            assert_eq!(revision.changed_keyframes, [2, 5, 9]);
            assert_eq!(revision.size, Some(ChangeSize { sigma_rotation_rad: 0.01, sigma_position_m: 0.2 }));
        }
    }

    #[test]
    fn damaged_foreign_and_impossible_news_are_refused() {
        let payload = protocol::encode(Format::Bincode, &change()).unwrap();
        assert!(read("yard", Format::Bincode, &payload).unwrap_err().contains("hall"));
        for damaged in [&payload[..payload.len() / 2], b"", b"{}"] {
            assert!(read("hall", Format::Bincode, damaged).is_err());
        }
        let json = String::from_utf8(protocol::encode(Format::Json, &change()).unwrap()).unwrap();
        let negative = json.replace("0.01", "-0.01");
        assert!(read("hall", Format::Json, negative.as_bytes()).unwrap_err().contains("sigma_theta_rad"));
    }
}
