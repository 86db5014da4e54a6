//! `driftless publish-map`: makes a map a release in an object store.

use super::releases::in_store;
use indicatif::{ProgressBar, ProgressStyle};
use map::sessions::SessionId;
use map::store::load_map;
use releases::{
    Note, Outcome, PublishOptions, Published, Release, ReleaseError, ReleaseKey, ReleaseStore, SigningKey,
    Stage, publish,
};
use serde_json::json;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless publish-map --map city.db --to s3://bucket/city\n  \
    driftless publish-map --map city.db --to /srv/releases/city\n  \
    driftless publish-map --map city.db --to s3://bucket/city --sign city.key      (of driftless release-key)\n  \
    driftless publish-map --map city.db --to s3://bucket/city --stage candidate --author ada --comment 'racks moved'\n  \
    map_server --map city=s3://bucket/city\n\n\
    The map is cut into cells, one segment each; segments that the newest release has are not sent again. A release never\n\
    changes. Of two that publish at once, one is told that the other was first. Credentials, region and endpoint come from the\n\
    environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION, AWS_ENDPOINT, GOOGLE_SERVICE_ACCOUNT,\n\
    AZURE_STORAGE_ACCOUNT_NAME, ...).")]
pub struct Args {
    /// Database of the map
    #[arg(long, value_name = "DB")]
    map: PathBuf,
    /// Where its releases are: a folder, file:///..., s3://..., gs://..., az://...
    #[arg(long, value_name = "URL")]
    to: String,
    /// Cut cells with more keyframes than these
    #[arg(long, value_name = "N", default_value_t = PublishOptions::default().keyframes_a_cell as u64, value_parser = clap::value_parser!(u64).range(1..))]
    keyframes_per_cell: u64,
    /// live: servers take it. candidate: it is proposed, and servers take it where they are told to (URL@candidate)
    #[arg(long, value_name = "STAGE", value_enum, default_value_t)]
    stage: StageArg,
    /// Publish a map that was built anew, although the newest release has sessions that it lacks
    #[arg(long)]
    replace: bool,
    #[command(flatten)]
    note: NoteArgs,
    #[command(flatten)]
    signing: SigningArgs,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Where a release is put.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum StageArg {
    /// Among those that servers take.
    #[default]
    Live,
    /// Beside them.
    Candidate,
}

/// Who does something to a release, and why.
#[derive(Clone, Debug, clap::Args)]
pub struct NoteArgs {
    /// Who does it, for the list of releases
    #[arg(long, value_name = "NAME")]
    author: Option<String>,
    /// Why, for the list of releases
    #[arg(long, value_name = "TEXT")]
    comment: Option<String>,
}

impl NoteArgs {
    pub(super) fn is_given(&self) -> bool {
        self.author.is_some() || self.comment.is_some()
    }

    /// # Errors
    /// A text that cannot be stored.
    pub(super) fn read(&self) -> Result<Note, ReleaseError> {
        Note::new(self.author.clone(), self.comment.clone())
    }
}

/// How a release is signed.
#[derive(Clone, Debug, clap::Args)]
pub struct SigningArgs {
    /// Sign the release with this secret key of driftless release-key or minisign; the password of an encrypted one is taken
    /// from DRIFTLESS_KEY_PASSWORD
    #[arg(long, value_name = "KEY")]
    sign: Option<PathBuf>,
}

impl SigningArgs {
    pub(super) fn is_given(&self) -> bool {
        self.sign.is_some()
    }

    /// # Errors
    /// A key that cannot be read.
    pub(super) fn check(&self) -> Result<(), ReleaseError> {
        self.key().map(drop)
    }

    fn key(&self) -> Result<Option<SigningKey>, ReleaseError> {
        let Some(file) = &self.sign else { return Ok(None) };
        let password = std::env::var("DRIFTLESS_KEY_PASSWORD").ok();
        Ok(Some(SigningKey::read(file, password)?))
    }

    /// The store, to which releases are put with a signature if a key was given.
    pub(super) fn apply(&self, store: ReleaseStore) -> Result<ReleaseStore, ReleaseError> {
        Ok(match self.key()? {
            Some(key) => store.signing_with(key),
            None => store,
        })
    }
}

/// With which key releases are verified.
#[derive(Clone, Debug, clap::Args)]
pub struct VerifyingArgs {
    /// Take only releases that are signed with this key: a file of driftless release-key or minisign, or its line
    #[arg(long, value_name = "FILE|KEY")]
    release_key: Option<ReleaseKey>,
}

impl VerifyingArgs {
    /// The store, of which only signed releases are read if a key was given.
    pub(super) fn apply(&self, store: ReleaseStore) -> ReleaseStore {
        match &self.release_key {
            Some(key) => store.signed_with(key.clone()),
            None => store,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A map that cannot be read, a store that cannot be written or has another map, another publisher that was faster.
pub fn run(args: &Args) -> anyhow::Result<()> {
    print_outcome(&publish_map(args)?, args.json)
}

/// Publishes a map as a candidate.
///
/// # Errors
/// As of [`run`].
pub(super) fn propose(
    map: &Path,
    to: &str,
    note: &NoteArgs,
    signing: &SigningArgs,
) -> anyhow::Result<Outcome> {
    publish_map(&Args {
        map: map.to_owned(),
        to: to.to_owned(),
        keyframes_per_cell: PublishOptions::default().keyframes_a_cell as u64,
        stage: StageArg::Candidate,
        replace: false,
        note: note.clone(),
        signing: signing.clone(),
        json: true,
    })
}

/// Whether a map has sessions that neither the newest release nor any candidate has.
///
/// # Errors
/// A store that cannot be read.
pub(super) fn lacks_sessions(to: &str, sessions: &[SessionId]) -> anyhow::Result<bool> {
    in_store(to, async |store| {
        let mut proposed: BTreeSet<SessionId> = BTreeSet::new();
        let sessions_of = |release: Release| release.map.sessions.into_iter().map(|session| session.id);
        proposed.extend(store.newest().await?.into_iter().flat_map(sessions_of));
        for number in store.candidate_numbers().await? {
            proposed.extend(sessions_of(store.candidate(number).await?));
        }
        Ok(sessions.iter().any(|session| !proposed.contains(session)))
    })
}

fn publish_map(args: &Args) -> anyhow::Result<Outcome> {
    let contents = load_map(&args.map)?.contents;
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = usize::try_from(args.keyframes_per_cell)?;
    options.note = args.note.read()?;
    options.may_lose_sessions = args.replace;
    options.stage = match args.stage {
        StageArg::Live => Stage::Live,
        StageArg::Candidate => Stage::Candidate,
    };
    let bar = if args.json { ProgressBar::hidden() } else { ProgressBar::new(0) };
    bar.set_style(ProgressStyle::with_template("{wide_bar} {pos}/{len} cells {elapsed_precise}")?);
    let outcome = in_store(&args.to, async |store| {
        let store = args.signing.apply(store)?;
        publish(&store, contents, &options, |progress| {
            bar.set_length(progress.of as u64);
            bar.set_position(progress.cells as u64);
        })
        .await
    })?;
    bar.finish_and_clear();
    Ok(outcome)
}

/// Prints what became of a release.
pub(super) fn print_outcome(outcome: &Outcome, as_json: bool) -> anyhow::Result<()> {
    match outcome {
        Outcome::Published(published) => {
            let Published { release, sent, bytes_sent } = published.as_ref();
            if as_json {
                let value = json!({"release": release, "segments_sent": sent, "bytes_sent": bytes_sent});
                println!("{}", serde_json::to_string_pretty(&value)?);
                return Ok(());
            }
            println!(
                "{}: version {} of {}, {} keyframes in {} cells; {sent} segments sent, {}",
                release.title(),
                release.map.version,
                release.map.name,
                release.keyframes(),
                release.cells.len(),
                megabytes(*bytes_sent)
            );
        }
        Outcome::Unchanged { number } if as_json => println!("{}", json!({ "unchanged": number })),
        Outcome::Unchanged { number } => {
            println!("release {number} has this map already; nothing was published");
        }
    }
    Ok(())
}

/// Bytes for a person.
pub(super) fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 * 1e-6)
}
