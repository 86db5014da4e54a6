//! Liveliness tokens of the servers of a map.

use std::collections::BTreeSet;

use tokio::sync::watch;
use zenoh::Session;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

/// The tokens that are alive below a key expression.
pub(crate) struct Tokens {
    alive: watch::Receiver<BTreeSet<String>>,
    _subscriber: Subscriber<()>,
}

impl Tokens {
    /// Follows the tokens of a key expression, those of this session among them.
    pub(crate) async fn follow(session: &Session, key: String) -> Result<Tokens, zenoh::Error> {
        let (sender, alive) = watch::channel(BTreeSet::new());
        let note = move |sample: Sample| {
            let key = sample.key_expr().as_str().to_owned();
            sender.send_if_modified(|tokens| match sample.kind() {
                SampleKind::Put => tokens.insert(key),
                SampleKind::Delete => tokens.remove(&key),
            });
        };
        let subscriber = session.liveliness().declare_subscriber(key).history(true).callback(note).await?;
        Ok(Tokens { alive, _subscriber: subscriber })
    }

    /// The last chunks of all keys: names of servers.
    pub(crate) fn names(&self) -> BTreeSet<String> {
        let alive = self.alive.borrow();
        alive.iter().filter_map(|key| key.rsplit('/').next()).map(str::to_owned).collect()
    }

    /// How many keys satisfy a condition.
    pub(crate) fn count(&self, is_counted: impl Fn(&str) -> bool) -> usize {
        self.alive.borrow().iter().filter(|key| is_counted(key)).count()
    }

    /// Completes at the next change after the last call.
    pub(crate) async fn changed(&mut self) {
        if self.alive.changed().await.is_err() {
            // The session is closed: nothing will ever change.
            std::future::pending::<()>().await;
        }
    }
}
