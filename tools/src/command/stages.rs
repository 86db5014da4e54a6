//! `driftless promote-release`, `reject-release`: what becomes of a candidate.

use super::publish_map::{NoteArgs, SigningArgs};
use super::releases::in_store;
use releases::{Decision, Release, ReleaseChoice, ReleaseError, ReleaseStore};
use serde_json::json;

/// Arguments of `promote-release`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  driftless publish-map --map city.db --to s3://bucket/city --stage candidate\n  \
    driftless review-release s3://bucket/city --drive monday --out review\n  \
    driftless promote-release s3://bucket/city --author ada\n\n\
    The candidate becomes the newest release, if no other release came since it was published. One that was rejected is not\n\
    promoted: publish the map again."
)]
pub struct PromoteArgs {
    #[command(flatten)]
    decided: DecidedArgs,
}

/// Arguments of `reject-release`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  \
    driftless reject-release s3://bucket/city --author ada --comment 'aisle 4 is 0.3 m off'\n\n\
    Servers that follow candidates go back to the live release. Nothing is removed; clean-releases does that.")]
pub struct RejectArgs {
    #[command(flatten)]
    decided: DecidedArgs,
}

/// What is decided about, by whom, and why.
#[derive(Clone, Debug, clap::Args)]
struct DecidedArgs {
    /// Where the releases are
    #[arg(value_name = "URL")]
    url: String,
    /// Number of the candidate [default: the newest that is open]
    #[arg(value_name = "CANDIDATE", value_parser = clap::value_parser!(u64).range(1..))]
    candidate: Option<u64>,
    #[command(flatten)]
    note: NoteArgs,
    #[command(flatten)]
    signing: SigningArgs,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `promote-release`.
///
/// # Errors
/// No such candidate, one that was overtaken or rejected, a store that cannot be written, another publisher that was faster.
pub fn promote(args: &PromoteArgs) -> anyhow::Result<()> {
    let args = &args.decided;
    let note = args.note.read()?;
    let release = in_store(&args.url, async |store| {
        let store = args.signing.apply(store)?;
        releases::promote(&store, args.number(&store).await?, &note).await
    })?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&json!({ "release": release }))?);
    } else {
        let Release { number, candidate, map, .. } = &release;
        let candidate =
            candidate.map_or_else(String::new, |candidate| format!(", which was candidate {candidate}"));
        println!("release {number}: version {} of {}{candidate}", map.version, map.name);
    }
    Ok(())
}

/// Runs `reject-release`.
///
/// # Errors
/// No such candidate, one that was decided about before, a store that cannot be written.
pub fn reject(args: &RejectArgs) -> anyhow::Result<()> {
    let args = &args.decided;
    let note = args.note.read()?;
    let decision = in_store(&args.url, async |store| {
        let store = args.signing.apply(store)?;
        releases::reject(&store, args.number(&store).await?, &note).await
    })?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&decision)?);
    } else {
        let Decision { candidate, verdict, .. } = decision;
        println!("candidate {candidate} is {verdict}");
    }
    Ok(())
}

impl DecidedArgs {
    async fn number(&self, store: &ReleaseStore) -> Result<u64, ReleaseError> {
        let choice = self.candidate.map_or(ReleaseChoice::NewestCandidate, ReleaseChoice::Candidate);
        let proposed = choice.of(store).await?;
        let missing = || ReleaseError::NoCandidate { place: store.place().to_owned(), candidate: None };
        proposed.candidate.ok_or_else(missing)
    }
}
