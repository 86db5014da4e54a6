//! `driftless list-sessions`: what robots recorded for the map.

use crate::session_files;
use hand_in::Session;
use map::sessions::{SessionId, utc_time};
use serde::Serialize;
use std::path::PathBuf;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  driftless list-sessions robot7_sessions\n  driftless list-sessions inbox --json\n\n\
    A session that a robot could not end (it was switched off, its disk was full) has what was written until then."
)]
pub struct Args {
    /// Session files, or folders of them
    #[arg(value_name = "FILE|DIR", required = true)]
    paths: Vec<PathBuf>,
    /// Print the list as JSON
    #[arg(long)]
    json: bool,
}

/// A session in the list.
#[derive(Serialize)]
struct Listed {
    file: PathBuf,
    /// As in the ledger of a map.
    id: Option<SessionId>,
    robot: String,
    name: String,
    program: String,
    started_unix_s: u64,
    seconds: f64,
    bytes: u64,
    readings: usize,
    images: usize,
    candidates: usize,
    answers: usize,
    /// Of answers that the robot's state took.
    accepted_answers: usize,
    /// Landmarks of maps that were matched, in all answers.
    matched_landmarks: usize,
    /// The robot ended it.
    ended: bool,
    signed: bool,
}

impl From<Session> for Listed {
    fn from(session: Session) -> Self {
        let (seconds, candidates) = (session.seconds(), session.candidates());
        Self {
            id: session.recorded.as_ref().map(|recorded| SessionId::from_bytes(recorded.id)),
            robot: session.header.robot,
            name: session.header.name,
            program: session.header.program,
            started_unix_s: session.header.started_unix_s,
            seconds,
            bytes: session.whole_bytes,
            readings: session.readings.len(),
            images: session.frames.len(),
            candidates,
            answers: session.answers.len(),
            accepted_answers: session.answers.iter().filter(|answer| answer.accepted).count(),
            matched_landmarks: session.answers.iter().map(|answer| answer.matches.len()).sum(),
            ended: session.is_ended,
            signed: session.signature.is_some(),
            file: session.path,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A path that cannot be read. A file that is no session is named, and the others are listed.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let mut listed = Vec::new();
    let mut unreadable = 0;
    for path in session_files::find(&args.paths)? {
        match Session::open(&path) {
            Ok(session) => listed.push(Listed::from(session)),
            Err(error) => {
                eprintln!("{error}");
                unreadable += 1;
            }
        }
    }
    if args.json {
        println!("{:#}", serde_json::to_string_pretty(&listed)?);
    } else {
        for session in &listed {
            let id = session.id.map_or_else(|| "empty".to_owned(), |id| format!("{:.8}", id.to_string()));
            println!(
                "{id}  {}  {}  {:.0} s, {:.2} MB ({:.2} MB/min), {} candidates, {} landmarks matched{}{}  {}",
                session.robot,
                utc_time(session.started_unix_s),
                session.seconds,
                session.bytes as f64 * 1e-6,
                session.bytes as f64 * 60e-6 / session.seconds.max(1.0),
                session.candidates,
                session.matched_landmarks,
                if session.ended { "" } else { ", cut off" },
                if session.signed { ", signed" } else { "" },
                session.file.display(),
            );
        }
    }
    anyhow::ensure!(unreadable == 0, "{unreadable} files are no session files that can be read");
    Ok(())
}
