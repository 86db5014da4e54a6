//! `sessions.json`: the ledger of the map, written where it has one.

use std::path::Path;

use map::sessions::Session;

use super::error::MapFileError;

/// Reads the ledger; a missing file states none.
pub(super) fn read_sessions(path: &Path) -> Result<Vec<Session>, MapFileError> {
    let text = match files::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(reason) => {
            let remedy = "make it readable, or remove it: the map then counts as one session".to_owned();
            return Err(MapFileError::Read { path: path.to_owned(), reason, remedy });
        }
    };
    let sessions: Vec<Session> = serde_json::from_str(&text).map_err(|error| {
        MapFileError::file(
            path,
            error.to_string(),
            "it is a list of sessions as `driftless export-map` writes it; without the file the map counts as one session",
        )
    })?;
    for (at, session) in sessions.iter().enumerate() {
        if let Some(overlap) = sessions[..at].iter().find_map(|known| session.overlap(known)) {
            let remedy = "what both have would count twice: take one of the two out of the list, and its keyframes out of the map";
            return Err(MapFileError::file(path, overlap.to_string(), remedy));
        }
    }
    Ok(sessions)
}

/// The text of the file, or `None` for a map without a ledger.
pub(super) fn sessions_text(sessions: &[Session]) -> Option<String> {
    let text = serde_json::to_string_pretty(sessions).ok()?;
    (!sessions.is_empty()).then(|| text + "\n")
}
