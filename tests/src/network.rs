//! Sessions, tokens and raw queries.

use protocol::{ErrorReply, Format, Message};
use std::time::Duration;
use tokio::runtime::Runtime;
use zenoh::query::ConsolidationMode;
use zenoh::sample::SampleKind;

/// A reply's payload, or that of an error reply.
pub type Answer = Result<Vec<u8>, Vec<u8>>;

/// Zenoh needs a multi-threaded runtime.
pub fn runtime() -> Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

/// Waits until a liveliness token is there, or gone.
pub async fn wait_for(session: &zenoh::Session, token: &str, there: bool) {
    let tokens = session.liveliness().declare_subscriber(token).history(true).await.unwrap();
    if !there {
        // A token that is gone already is never announced.
        let alive = session.liveliness().get(token).await.unwrap();
        if alive.recv_async().await.is_err() {
            return;
        }
    }
    let wanted = if there { SampleKind::Put } else { SampleKind::Delete };
    while tokens.recv_async().await.unwrap().kind() != wanted {}
}

/// Asks, and waits for the end of the answer.
pub async fn ask(session: &zenoh::Session, selector: &str, payload: Option<Vec<u8>>) -> Vec<Answer> {
    let mut query =
        session.get(selector).consolidation(ConsolidationMode::None).timeout(Duration::from_mins(1));
    if let Some(payload) = payload {
        query = query.payload(payload).encoding(Format::Bincode.encoding());
    }
    let replies = query.await.unwrap();
    let mut answers = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        answers.push(match reply.into_result() {
            Ok(sample) => Ok(sample.payload().to_bytes().into_owned()),
            Err(error) => Err(error.payload().to_bytes().into_owned()),
        });
    }
    answers
}

/// All replies as messages; none may be an error.
pub fn messages<M: Message>(answers: Vec<Answer>) -> Vec<M> {
    let decoded = |answer: Answer| protocol::decode(Format::Bincode, &answer.unwrap()).unwrap();
    answers.into_iter().map(decoded).collect()
}

/// The one error that was answered.
pub fn only_error(answers: &[Answer]) -> ErrorReply {
    let [Err(payload)] = answers else { panic!("one error reply was expected: {answers:?}") };
    protocol::decode(Format::Bincode, payload).unwrap()
}
