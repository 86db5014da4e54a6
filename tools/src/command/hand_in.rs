//! `driftless hand-in`: hands in sessions that a robot recorded, to a map server or into a folder.

use crate::server_query::ServerArguments;
use crate::session_files;
use anyhow::{Context as _, bail, ensure};
use client::SessionUpload;
use hand_in::inbox::{digest_of, is_in_inbox};
use hand_in::{Inbox, InboxSettings, Session};
use indicatif::ProgressBar;
use protocol::{MAX_SESSION_BYTES, MAX_SESSION_PART_BYTES, SessionPart};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What --inbox does not go with: it has no effect without a server.
const OF_A_SERVER: [&str; 10] = [
    "map",
    "rate",
    "timeout",
    "connect",
    "listen",
    "scout",
    "secure",
    "zenoh_config",
    "namespace",
    "session_mode",
];

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  driftless hand-in robot7_sessions --map hall --connect tcp/192.168.1.2:7447\n  \
    driftless hand-in robot7_sessions --map hall --rate 40 --remove\n  \
    driftless hand-in a.session b.session --inbox /srv/inbox\n\n\
    A session that was handed in before is not sent again, and one that was interrupted goes on where it ended. The server\n\
    needs --inbox DIR. Sessions that the robot still records are left out."
)]
pub struct Args {
    /// Session files, or folders of them
    #[arg(value_name = "FILE|DIR", required = true)]
    paths: Vec<PathBuf>,
    /// Name under which a server serves the map
    #[arg(long, value_name = "NAME", required_unless_present = "inbox")]
    map: Option<String>,
    /// Put the sessions into this folder of a server that is not running, with the checks that it makes
    #[arg(long, value_name = "DIR", conflicts_with_all = OF_A_SERVER)]
    inbox: Option<PathBuf>,
    /// With --inbox, take only sessions that are signed: folder with the public key NAME.pub of each robot
    #[arg(long, value_name = "DIR", requires = "inbox")]
    robot_keys: Option<PathBuf>,
    /// Kilobits a second to send at most
    #[arg(long, value_name = "KBIT/S", default_value_t = 90.0)]
    rate: f64,
    /// Remove each file once it is on the disk of the server; one that lies in an inbox itself stays
    #[arg(long)]
    remove: bool,
    /// Where the server is; --timeout is that of a part
    #[command(flatten)]
    server: ServerArguments,
    /// Print what was handed in as JSON
    #[arg(long)]
    json: bool,
}

/// A file that was handed in.
#[derive(Serialize)]
struct HandedIn {
    file: PathBuf,
    robot: String,
    bytes: usize,
    removed: bool,
}

/// Runs the command.
///
/// # Errors
/// A file that is no session, no server that takes sessions of the map, a session that is refused, each with the reason; the other
/// files are handed in.
pub fn run(args: &Args) -> anyhow::Result<()> {
    ensure!(
        args.rate.is_finite() && args.rate >= 4.0,
        "--rate {}: give four kilobits a second or more",
        args.rate
    );
    let (mut done, mut failed) = (Vec::new(), Vec::new());
    let paths = session_files::find(&args.paths)?;
    for path in &paths {
        match hand_in_file(args, path) {
            Ok(handed_in) => done.push(handed_in),
            Err(error) => failed.push(error),
        }
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&done)?);
    } else {
        for HandedIn { file, robot, bytes, removed } in &done {
            let removed = if *removed { ", removed here" } else { "" };
            println!("{} of {robot}: {:.2} MB handed in{removed}", file.display(), *bytes as f64 * 1e-6);
        }
    }
    match failed.len() {
        0 => Ok(()),
        1 => Err(failed.remove(0)),
        count => {
            let reasons: Vec<String> = failed.iter().map(|error| format!("{error:#}")).collect();
            bail!("{count} of {} files were not handed in:\n  {}", paths.len(), reasons.join("\n  "))
        }
    }
}

fn hand_in_file(args: &Args, path: &Path) -> anyhow::Result<HandedIn> {
    let in_file = || format!("{}", path.display());
    if let Some(folder) = &args.inbox {
        refuse_own_file(path, folder)?;
    }
    let bytes = files::read(path, MAX_SESSION_BYTES).with_context(in_file)?;
    let robot = Session::of_bytes(path, &bytes)?.header.robot;
    match (&args.map, &args.inbox) {
        (_, Some(folder)) => put(args, folder, &robot, &bytes).with_context(in_file)?,
        (Some(map), None) => send(args, map, &robot, &bytes).with_context(in_file)?,
        (None, None) => bail!("--map NAME or --inbox DIR is missing"),
    }
    // Which folder a server has its inbox in is not known here. A file that --inbox takes from another inbox is moved.
    let stays = args.inbox.is_none() && is_in_inbox(path, &robot, &bytes);
    if args.remove && stays {
        eprintln!(
            "warning: {} is the file of an inbox, maybe of this server, and is not removed",
            path.display()
        );
    }
    let removed = args.remove && !stays;
    if removed {
        std::fs::remove_file(path).with_context(in_file)?;
    }
    Ok(HandedIn { file: path.to_owned(), robot, bytes: bytes.len(), removed })
}

/// Refuses a file that lies in the inbox already: removed after it was found there, it would be gone.
fn refuse_own_file(path: &Path, inbox: &Path) -> anyhow::Result<()> {
    // An inbox or a file that is not there has nothing in common with the other.
    let Some((file, folder)) = path.canonicalize().ok().zip(inbox.canonicalize().ok()) else { return Ok(()) };
    ensure!(
        !file.starts_with(&folder),
        "{} lies in the inbox {} itself: hand in the files of another folder",
        path.display(),
        inbox.display()
    );
    Ok(())
}

/// Sends a file to a map server.
fn send(args: &Args, map: &str, robot: &str, bytes: &[u8]) -> anyhow::Result<()> {
    let bar = if args.json { ProgressBar::hidden() } else { ProgressBar::new(bytes.len() as u64) };
    let upload = SessionUpload {
        robot,
        digest: digest_of(bytes),
        bytes,
        bytes_per_second: args.rate * 125.0,
        patience: Duration::from_secs_f64(args.server.timeout),
    };
    let sent = args.server.query_in_session(map, async |client, _| {
        client.hand_in(&upload, |received| bar.set_position(received)).await
    });
    bar.finish_and_clear();
    sent.context(
        "was not handed in; does the server have --inbox? Handing it in again goes on where it ended",
    )
}

/// Puts a file into the folder of an inbox.
fn put(args: &Args, folder: &Path, robot: &str, bytes: &[u8]) -> anyhow::Result<()> {
    let (folder, keys) = (folder.to_owned(), args.robot_keys.clone());
    // Who can write there sees how full it is.
    let settings = InboxSettings { folder, bytes_of_robot: u64::MAX, bytes_in_all: u64::MAX, keys };
    let mut inbox = Inbox::open(settings)?;
    let digest = digest_of(bytes);
    let part = |offset: u64, bytes: &[u8], total_bytes: usize| SessionPart {
        total_bytes: total_bytes as u64,
        digest,
        offset,
        bytes: bytes.to_vec(),
    };
    let mut received = inbox.take(robot, &part(0, &[], bytes.len()))?;
    while !received.is_complete {
        let from = usize::try_from(received.bytes)?.min(bytes.len());
        let to = (from + MAX_SESSION_PART_BYTES).min(bytes.len());
        let next = inbox.take(robot, &part(from as u64, &bytes[from..to], bytes.len()))?;
        ensure!(next.is_complete || next.bytes > received.bytes, "the file was damaged on its way");
        received = next;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Args as _, Parser as _};

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn a_folder_refuses_each_switch_of_a_server_by_name() {
        let line = ["hand-in", "a.session", "--inbox", "/srv/inbox"];
        assert!(Line::try_parse_from(line).is_ok());
        let of_server = ServerArguments::augment_args(clap::Command::new("server"));
        let mut switches: Vec<String> = vec!["--map".to_owned(), "--rate".to_owned()];
        switches.extend(of_server.get_arguments().filter_map(|arg| Some(format!("--{}", arg.get_long()?))));
        assert!(switches.len() > 5, "{switches:?}");
        for switch in switches {
            let value = match switch.as_str() {
                "--scout" => None,
                "--session-mode" => Some("client"),
                _ => Some("7"),
            };
            let given = line.into_iter().chain([switch.as_str()]).chain(value);
            let refusal = Line::try_parse_from(given).map(|_| ()).unwrap_err().to_string();
            assert!(refusal.contains("--inbox <DIR>") && refusal.contains(&switch), "{switch}: {refusal}");
            assert!(refusal.contains("cannot be used with"), "{switch}: {refusal}");
        }
    }
}
