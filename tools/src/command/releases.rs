//! `driftless list-releases`, `diff-releases`, `rollback`, `clean-releases`, `release-key`.

use super::publish_map::{NoteArgs, SigningArgs, megabytes, print_outcome};
use crate::map_difference::{print_difference, print_sessions};
use anyhow::ensure;
use map::sessions::{SessionDifference, utc_time};
use releases::{
    CandidateState, CellId, CleanOptions, Note, Release, ReleaseChoice, ReleaseError, ReleaseStore,
    SigningKey, candidate_state,
};
use serde_json::json;
use std::path::PathBuf;
use std::time::Duration;

/// Arguments of `list-releases`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  driftless list-releases s3://bucket/city")]
pub struct ListArgs {
    /// Where the releases are
    #[arg(value_name = "URL")]
    url: String,
    /// Print the cells of each: number, size, extent of its keyframes
    #[arg(long)]
    cells: bool,
    /// Print them as JSON, cells included
    #[arg(long)]
    json: bool,
}

/// Arguments of `diff-releases`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  driftless diff-releases s3://bucket/city 6 7\n  \
    driftless diff-releases s3://bucket/city live candidate\n\n\
    Counts keyframes and landmarks that are new, gone or moved, and how far they moved, in all and by place: cubes of 10 m,\n\
    the one with the largest motion first. The cells that differ are fetched for it.")]
pub struct DiffArgs {
    /// Where the releases are
    #[arg(value_name = "URL")]
    url: String,
    /// The earlier release: its number, live, candidate, or candidate-3
    #[arg(value_name = "FROM")]
    from: ReleaseChoice,
    /// The later release
    #[arg(value_name = "TO", default_value_t)]
    to: ReleaseChoice,
    /// Print the difference as JSON
    #[arg(long)]
    json: bool,
}

/// Arguments of `rollback`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  driftless rollback s3://bucket/city 6\n\n\
    The map of release 6 becomes the newest release, with a new version. Nothing is removed.")]
pub struct RollbackArgs {
    /// Where the releases are
    #[arg(value_name = "URL")]
    url: String,
    /// Number of the release to go back to
    #[arg(value_name = "RELEASE")]
    release: u64,
    #[command(flatten)]
    note: NoteArgs,
    #[command(flatten)]
    signing: SigningArgs,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Arguments of `release-key`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  driftless release-key city.key\n  \
    driftless publish-map --map city.db --to s3://bucket/city --sign city.key\n  \
    map_server --map city=s3://bucket/city --release-key city.key.pub\n\n\
    Keys and signatures are those of minisign.")]
pub struct KeyArgs {
    /// File of the new secret key; the public one is written beside it, with .pub
    #[arg(value_name = "KEY")]
    key: PathBuf,
}

/// Arguments of `clean-releases`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  driftless clean-releases s3://bucket/city --dry-run\n  \
    driftless clean-releases s3://bucket/city --keep 5\n\n\
    Segments that were put within the grace time stay, for a release that names them may be about to come.")]
pub struct CleanArgs {
    /// Where the releases are
    #[arg(value_name = "URL")]
    url: String,
    /// Keep so many of the newest releases
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    keep: u64,
    /// Keep segments that were put within this time, hours
    #[arg(long, value_name = "HOURS", default_value_t = 24.0)]
    grace: f64,
    /// Remove nothing, only say what would be
    #[arg(long)]
    dry_run: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `list-releases`.
///
/// # Errors
/// A store that cannot be read.
pub fn list(args: &ListArgs) -> anyhow::Result<()> {
    let all = in_store(&args.url, listed)?;
    if args.json {
        let value: Vec<_> = all.iter().map(Listed::as_json).collect();
        println!("{}", serde_json::to_string_pretty(&value)?);
        return Ok(());
    }
    if all.is_empty() {
        println!("{} has no releases", args.url);
    }
    for Listed { title, sessions, release } in all {
        match release {
            Ok((release, state)) => {
                print_release(&title, &release, state.as_ref());
                if let Some((since, change)) = sessions {
                    println!("{:>12}  {} sessions, since {since}:", "", release.map.sessions.len());
                    print_sessions("              ", &change);
                }
                if args.cells {
                    print_cells(&release);
                }
            }
            Err(error) => println!("{title:>12}  {error}"),
        }
    }
    Ok(())
}

/// A release or a candidate in the list.
struct Listed {
    title: String,
    /// What sessions it has that the release before it has not, of which it has the title, and the reverse.
    sessions: Option<(String, SessionDifference)>,
    /// With the state of a candidate.
    release: Result<(Release, Option<CandidateState>), ReleaseError>,
}

impl Listed {
    fn as_json(&self) -> serde_json::Value {
        let sessions =
            self.sessions.as_ref().map(|(since, change)| json!({"since": since, "change": change}));
        match &self.release {
            Ok((release, None)) => {
                let mut value = json!(release);
                value["sessions"] = json!(sessions);
                value
            }
            Ok((release, Some(state))) => {
                json!({"candidate": release, "decision": state, "sessions": sessions})
            }
            Err(error) => json!({"title": self.title, "error": error.to_string()}),
        }
    }
}

/// All releases of a store, then all candidates. What is damaged is listed as such.
async fn listed(store: ReleaseStore) -> Result<Vec<Listed>, ReleaseError> {
    let mut all = Vec::new();
    let mut newest = None;
    for number in store.numbers().await? {
        let release = store.release(number).await;
        let sessions = release.as_ref().ok().and_then(|release| sessions_since(newest.as_ref(), release));
        newest = release.as_ref().ok().cloned();
        let release = release.map(|release| (release, None));
        all.push(Listed { title: number.to_string(), sessions, release });
    }
    for number in store.candidate_numbers().await? {
        let with_state = async {
            let candidate = store.candidate(number).await?;
            let state = candidate_state(&store, &candidate, newest.as_ref()).await?;
            Ok((candidate, Some(state)))
        };
        let title = ReleaseChoice::Candidate(number).to_string();
        let release = with_state.await;
        let sessions =
            release.as_ref().ok().and_then(|(release, _)| sessions_since(newest.as_ref(), release));
        all.push(Listed { title, sessions, release });
    }
    Ok(all)
}

/// What sessions came and went since an earlier release, with its title; `None` without one, and where they are the same.
fn sessions_since(before: Option<&Release>, release: &Release) -> Option<(String, SessionDifference)> {
    let before = before?;
    let change = SessionDifference::between(&before.map.sessions, &release.map.sessions);
    Some((before.title(), change)).filter(|(_, change)| !change.is_empty())
}

fn print_release(title: &str, release: &Release, state: Option<&CandidateState>) {
    let again = release.rolled_back_to.map(|to| format!(", the map of release {to} again"));
    let was = release.candidate.filter(|_| state.is_none()).map(|number| format!(", was candidate {number}"));
    println!(
        "{title:>12}  {}  version {}, {} keyframes and {} landmarks in {} cells, {}{}{}{}",
        utc_time(release.published_unix_s),
        release.map.version,
        release.keyframes(),
        release.landmarks(),
        release.cells.len(),
        megabytes(release.bytes()),
        again.unwrap_or_default(),
        was.unwrap_or_default(),
        state.map_or_else(String::new, |state| format!(", for release {}: {state}", release.number)),
    );
    print_note("published", &release.note);
    if let Some(promotion) = &release.promotion {
        print_note("promoted", promotion);
    }
    if let Some(CandidateState::Rejected(decision)) = state {
        print_note("rejected", &decision.note);
    }
}

/// Who did something, and why; nothing where neither is known.
fn print_note(done: &str, note: &Note) {
    let by = note.author.as_ref().map(|author| format!(" by {author}"));
    let why = note.comment.as_ref().map(|comment| format!(": {comment}"));
    if by.is_some() || why.is_some() {
        println!("{:>12}  {done}{}{}", "", by.unwrap_or_default(), why.unwrap_or_default());
    }
}

fn print_cells(release: &Release) {
    for cell in &release.cells {
        let [low, high] = cell.extent;
        println!(
            "        cell {:>4}: {} keyframes, {} landmarks, {}; x {:.1} to {:.1} m, y {:.1} to {:.1} m, z {:.1} to {:.1} m",
            cell.cell,
            cell.keyframes,
            cell.landmarks,
            megabytes(cell.segment.bytes),
            low[0],
            high[0],
            low[1],
            high[1],
            low[2],
            high[2]
        );
    }
}

/// Runs `diff-releases`.
///
/// # Errors
/// A store or a release that cannot be read.
pub fn diff(args: &DiffArgs) -> anyhow::Result<()> {
    let (from, to, map) = in_store(&args.url, async |store| {
        let (from, to) = (args.from.of(&store).await?, args.to.of(&store).await?);
        let map = releases::difference(&store, &from, &to).await?;
        Ok((from, to, map))
    })?;
    let cells = from.difference(&to);
    if args.json {
        let value = json!({"from": from.title(), "to": to.title(), "map": map, "cells": cells});
        println!("{}", serde_json::to_string_pretty(&value)?);
        return Ok(());
    }
    println!("{} to {}", from.title(), to.title());
    print_difference(&map);
    print_sessions("", &cells.sessions);
    println!("{} cells unchanged, {} to fetch", cells.unchanged, megabytes(cells.bytes));
    for (what, cells) in [("changed", &cells.changed), ("added", &cells.added), ("removed", &cells.removed)] {
        if !cells.is_empty() {
            let numbers: Vec<String> = cells.iter().map(CellId::to_string).collect();
            println!("  {what}: {}", numbers.join(", "));
        }
    }
    Ok(())
}

/// Runs `rollback`.
///
/// # Errors
/// A release that is not there, a store that cannot be written, another publisher that was faster.
pub fn roll_back(args: &RollbackArgs) -> anyhow::Result<()> {
    let note = args.note.read()?;
    let outcome = in_store(&args.url, async |store| {
        releases::roll_back(&args.signing.apply(store)?, args.release, &note).await
    })?;
    print_outcome(&outcome, args.json)
}

/// Runs `release-key`.
///
/// # Errors
/// A file that exists or cannot be written.
pub fn generate_key(args: &KeyArgs) -> anyhow::Result<()> {
    let public = SigningKey::generate(&args.key)?;
    println!("wrote {} (secret) and {} (for map servers)", args.key.display(), public.display());
    Ok(())
}

/// Runs `clean-releases`.
///
/// # Errors
/// A store that cannot be read or written.
pub fn clean(args: &CleanArgs) -> anyhow::Result<()> {
    ensure!(args.grace.is_finite() && args.grace >= 0.0, "--grace {}: give a number of hours", args.grace);
    let mut options = CleanOptions::default();
    options.releases = usize::try_from(args.keep)?;
    options.grace = Duration::from_secs_f64(args.grace * 3600.0);
    options.dry_run = args.dry_run;
    let cleaned = in_store(&args.url, async |store| releases::clean(&store, &options).await)?;
    if args.json {
        let value = json!({
            "releases": cleaned.releases, "candidates": cleaned.candidates, "segments": cleaned.segments, "bytes": cleaned.bytes, "dry_run": args.dry_run,
        });
        println!("{}", serde_json::to_string_pretty(&value)?);
    } else {
        println!(
            "{} {} releases, {} candidates and {} segments, {}",
            if args.dry_run { "would remove" } else { "removed" },
            cleaned.releases.len(),
            cleaned.candidates.len(),
            cleaned.segments.len(),
            megabytes(cleaned.bytes)
        );
    }
    Ok(())
}

/// Does something with the releases at a place.
pub(crate) fn in_store<T>(
    url: &str,
    work: impl AsyncFnOnce(ReleaseStore) -> Result<T, ReleaseError>,
) -> anyhow::Result<T> {
    let store = ReleaseStore::open(url)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    Ok(runtime.block_on(work(store))?)
}
