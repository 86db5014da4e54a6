//! Who sends a query: the sessions that are connected to this one, and the subjects of their certificates.
//!
//! Zenoh does not say which session a query came from; the query's selector states it. A statement counts where it is the id of
//! a session that is connected to this server: then all queries of that session, and in a secured fleet all queries of that
//! certificate, have one share of the server. Sessions behind a router are not seen from here; they, and whoever states
//! anything else, have one share together (see `fair_queue`).

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock, Weak};
use std::time::{Duration, Instant};

use serde::Deserialize;
use tokio::sync::mpsc::unbounded_channel;
use zenoh::Session;
use zenoh::query::ConsolidationMode;
use zenoh::sample::Locality;

use crate::fair_queue::Client;

/// Time between two looks at who is connected: so long a new session may share with those that are not known.
const PERIOD: Duration = Duration::from_millis(500);
/// A look at a thousand sessions takes half a second where the processor is busy.
const ANSWERED: Duration = Duration::from_secs(10);
/// Looks pause so many times as long as the last one took.
const PAUSE: u32 = 19;
/// Longest name that is kept of a client, bytes: the id of a session has 32.
const MAX_NAME_BYTES: usize = 64;

/// The sessions that are connected.
#[derive(Default)]
pub(crate) struct Senders {
    /// By id: the subject of the certificate, or the id itself.
    known: RwLock<BTreeMap<String, String>>,
}

/// A link as Zenoh describes it in its admin space.
#[derive(Deserialize)]
struct Link {
    auth_identifier: Option<String>,
}

impl Senders {
    /// Follows who is connected to a session, until it is closed or nobody wants to know.
    pub(crate) async fn follow(session: &Session) -> Arc<Senders> {
        let senders = Arc::new(Senders::default());
        senders.look(session).await;
        tokio::spawn(look_again(session.clone(), Arc::downgrade(&senders)));
        senders
    }

    /// The client that states this name.
    pub(crate) fn client(&self, stated: &str) -> Client {
        let known = self.known.read().unwrap_or_else(PoisonError::into_inner);
        match known.get(stated) {
            Some(subject) => Client::Known(subject.clone()),
            None => Client::Stated(stated[..stated.floor_char_boundary(MAX_NAME_BYTES)].to_owned()),
        }
    }

    async fn look(&self, session: &Session) {
        let own = session.zid().to_string();
        let key = format!("@/{own}/session/transport/unicast/*/link/*");
        // The replies come on the thread that asks, and their end on the one that lets sessions in: neither may wait for room.
        let (tell, mut replies) = unbounded_channel();
        let asked = session
            .get(key)
            .allowed_destination(Locality::SessionLocal)
            .consolidation(ConsolidationMode::None)
            .timeout(ANSWERED)
            .callback(move |reply| _ = tell.send(reply))
            .await;
        if let Err(error) = asked {
            return tracing::debug!("cannot see who is connected: {error}");
        }
        let mut known = BTreeMap::from([(own.clone(), own)]);
        while let Some(reply) = replies.recv().await {
            let Ok(sample) = reply.result() else { continue };
            let mut chunks =
                sample.key_expr().as_str().split('/').skip_while(|chunk| *chunk != "unicast").skip(1);
            let Some(id) = chunks.next().map(str::to_owned) else { continue };
            let subject = || {
                let link: Link = serde_json::from_slice(&sample.payload().to_bytes()).ok()?;
                link.auth_identifier
            };
            match subject() {
                Some(subject) => drop(known.insert(id, subject)),
                None => drop(known.entry(id.clone()).or_insert(id)),
            }
        }
        *self.known.write().unwrap_or_else(PoisonError::into_inner) = known;
    }
}

async fn look_again(session: Session, senders: Weak<Senders>) {
    let mut took = Duration::ZERO;
    while !session.is_closed() {
        tokio::time::sleep(PERIOD.max(PAUSE * took)).await;
        let Some(senders) = senders.upgrade() else { return };
        let begin = Instant::now();
        senders.look(&session).await;
        took = begin.elapsed();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use client::{SessionMode, SessionOptions, close_session, open_session};

    async fn is_known_in(namespace: Option<&str>) {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let endpoint = vec![format!("tcp/127.0.0.1:{port}")];
        let mut listening = SessionOptions { listen: endpoint.clone(), ..SessionOptions::default() };
        listening.namespace = namespace.map(str::to_owned);
        let server = open_session(&listening).await.unwrap();
        let senders = Senders::follow(&server).await;
        for mode in [SessionMode::Client, SessionMode::Peer] {
            let mut connecting =
                SessionOptions { connect: endpoint.clone(), mode: Some(mode), ..SessionOptions::default() };
            connecting.namespace = namespace.map(str::to_owned);
            let robot = open_session(&connecting).await.unwrap();
            let id = robot.zid().to_string();
            let begin = Instant::now();
            while senders.client(&id) != Client::Known(id.clone()) {
                assert!(begin.elapsed() < Duration::from_secs(5), "{mode:?} is not seen");
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            close_session(&robot).await;
            while matches!(senders.client(&id), Client::Known(_)) {
                assert!(begin.elapsed() < Duration::from_secs(10), "{mode:?} is not forgotten");
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        }
        assert_eq!(senders.client(&server.zid().to_string()), Client::Known(server.zid().to_string()));
        assert_eq!(senders.client("made up"), Client::Stated("made up".to_owned()));
        let long = "\u{e9}".repeat(100);
        assert_eq!(senders.client(&long), Client::Stated("\u{e9}".repeat(32)));
        close_session(&server).await;
    }

    /// More of them than a channel of Zenoh has room for, with the links of each.
    #[tokio::test(flavor = "multi_thread")]
    async fn many_sessions_are_all_known_and_another_one_is_let_in() {
        const MANY: usize = 150;
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let endpoint = vec![format!("tcp/127.0.0.1:{port}")];
        let listening = SessionOptions { listen: endpoint.clone(), ..SessionOptions::default() };
        let server = open_session(&listening).await.unwrap();
        let senders = Senders::follow(&server).await;
        let connecting = SessionOptions { connect: endpoint, ..SessionOptions::default() };
        let mut sessions = Vec::new();
        for _ in 0..MANY {
            let opened = tokio::time::timeout(Duration::from_secs(30), open_session(&connecting)).await;
            sessions.push(opened.expect("it is let in").unwrap());
        }
        let begin = Instant::now();
        let is_known = |session: &Session| {
            let id = session.zid().to_string();
            senders.client(&id) == Client::Known(id)
        };
        while !sessions.iter().all(is_known) {
            assert!(begin.elapsed() < Duration::from_secs(30), "not all are seen");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        for session in sessions {
            close_session(&session).await;
        }
        close_session(&server).await;
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_session_that_is_connected_is_known_and_a_name_is_not() {
        is_known_in(None).await;
        is_known_in(Some("fleet")).await;
    }
}
