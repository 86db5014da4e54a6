//! Names of servers: no two at once.
//!
//! Servers share the cells of a map by their names, so two of one name would take each other for themselves, and each cell that both have
//! would be at one server less.

use std::time::{Duration, Instant};

use zenoh::Session;

use crate::error::ServeError;

/// A server that lost its machine is missed after ten seconds, and one that takes its place waits for that.
const PATIENCE: Duration = Duration::from_secs(15);
/// Where nobody may be asked, as in a fleet that was secured by an older program, the name counts as free.
const ANSWERED: Duration = Duration::from_secs(2);
/// Time between two looks.
const PAUSE: Duration = Duration::from_millis(500);

/// Whether another server has the name.
enum Look {
    Taken,
    Free,
    /// Nobody answered in time.
    Unanswered,
}

/// Waits until no other server of this name is alive.
pub(crate) async fn wait_until_free(session: &Session, name: &str, token: &str) -> Result<(), ServeError> {
    let begin = Instant::now();
    let mut was_taken = false;
    loop {
        match look(session, token).await? {
            Look::Free => return Ok(()),
            Look::Unanswered if !was_taken => return Ok(()),
            Look::Taken if !was_taken => {
                tracing::warn!(name, "another map server of this name is alive; waiting for its end");
                was_taken = true;
            }
            // On a busy network an answer may come too late: the name is as it was.
            Look::Taken | Look::Unanswered => {}
        }
        if begin.elapsed() > PATIENCE {
            return Err(ServeError::NameTaken { name: name.to_owned() });
        }
        tokio::time::sleep(PAUSE).await;
    }
}

async fn look(session: &Session, token: &str) -> Result<Look, ServeError> {
    let begin = Instant::now();
    let replies = session.liveliness().get(token).timeout(ANSWERED).await?;
    while let Ok(reply) = replies.recv_async().await {
        if reply.result().is_ok() {
            return Ok(Look::Taken);
        }
    }
    Ok(if begin.elapsed() < ANSWERED { Look::Free } else { Look::Unanswered })
}
