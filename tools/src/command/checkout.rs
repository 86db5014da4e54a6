//! `driftless checkout`: makes a database the map of a release.

use super::publish_map::VerifyingArgs;
use super::releases::in_store;
use anyhow::{Context as _, bail};
use map::MapContents;
use map::store::{MapTarget, StoreError, load_map};
use protocol::MapIdentity;
use releases::{Release, ReleaseChoice, ReleaseError, ReleasePlace, ReleaseStore, fetch};
use serde_json::json;
use std::path::PathBuf;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  driftless checkout s3://bucket/city --map city.db              the newest release\n  \
    driftless checkout s3://bucket/city@6 --map city.db            release 6\n  \
    driftless checkout s3://bucket/city@candidate --map next.db    the newest candidate\n\n\
    What is built, edited or extended next begins with that map: after a rollback, what was wrong does not come again. A\n\
    database whose map was never published is not replaced without --force. It keeps the identity of the releases, so it can\n\
    be published there again."
)]
pub struct Args {
    /// Where the releases are, and after @ which of them: its number, live, candidate, or candidate-3
    #[arg(value_name = "URL[@RELEASE]")]
    release: String,
    /// Database that gets the map
    #[arg(long, value_name = "DB")]
    map: PathBuf,
    /// Replace a map that was not published, too
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    verifying: VerifyingArgs,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// What became of the database.
enum Outcome {
    Written {
        version: u64,
    },
    /// It has this map.
    Unchanged {
        version: u64,
    },
}

/// Runs the command.
///
/// # Errors
/// A store or a release that cannot be read, a database that holds another map or one that was not published, or that cannot be
/// written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let place = ReleasePlace::from(args.release.as_str());
    let present = present(&args.map)?;
    let target = MapTarget::new(&args.map, present.is_some() || args.force)?;
    let (release, contents, is_published) = in_store(&place.url, async |store| {
        let store = args.verifying.apply(store);
        read(&store, place.choice, present.as_ref().map(|present| present.0)).await
    })?;
    let outcome = match present {
        Some((digest, version)) if digest == release.digest => Outcome::Unchanged { version },
        Some(_) if !is_published && !args.force => bail!(
            "{} has changes that are in no release of {}: publish them (driftless publish-map --map {} --to {} --stage candidate), \
             write to another path, or give them up with --force",
            args.map.display(),
            place.url,
            args.map.display(),
            place.url
        ),
        _ => Outcome::Written { version: target.save_copy(&contents)?.version },
    };
    print(args, &release, &outcome)
}

/// Digest and version of the map that is there; `None` where none is. A damaged one is an error: whether it was published is not known.
fn present(database: &std::path::Path) -> anyhow::Result<Option<(MapIdentity, u64)>> {
    match load_map(database) {
        Ok(stored) => Ok(Some((stored.contents.digest(), stored.contents.info.version))),
        Err(StoreError::Missing { .. } | StoreError::Unfinished { .. }) => Ok(None),
        Err(error) => Err(error).context("nothing was written"),
    }
}

/// The release, its map, and whether any release or candidate has the map of this digest.
async fn read(
    store: &ReleaseStore,
    choice: ReleaseChoice,
    present: Option<MapIdentity>,
) -> Result<(Release, MapContents, bool), ReleaseError> {
    let release = choice.of(store).await?;
    let mut is_published = Some(release.digest) == present;
    for number in store.numbers().await?.into_iter().rev() {
        is_published = is_published || has(store.release(number).await, present)?;
    }
    for number in store.candidate_numbers().await?.into_iter().rev() {
        is_published = is_published || has(store.candidate(number).await, present)?;
    }
    let contents = fetch(store, &release, None).await?;
    Ok((release, contents, is_published))
}

/// Whether a release has the map of this digest; one that cannot be read has not.
fn has(release: Result<Release, ReleaseError>, digest: Option<MapIdentity>) -> Result<bool, ReleaseError> {
    match release {
        Ok(release) => Ok(Some(release.digest) == digest),
        Err(error @ ReleaseError::Store { .. }) => Err(error),
        Err(_) => Ok(false),
    }
}

fn print(args: &Args, release: &Release, outcome: &Outcome) -> anyhow::Result<()> {
    let (version, is_changed) = match outcome {
        Outcome::Written { version } => (version, true),
        Outcome::Unchanged { version } => (version, false),
    };
    let database = args.map.display();
    if args.json {
        let value = json!({
            "map": args.map, "version": version, "changed": is_changed, "stage": release.stage, "release": release.number,
            "candidate": release.candidate,
        });
        println!("{}", serde_json::to_string_pretty(&value)?);
    } else if is_changed {
        println!("{database}: version {version}, the map of {}", release.title());
    } else {
        println!("{database} has the map of {} already (version {version})", release.title());
    }
    Ok(())
}
