//! Which release of which store, in one word of a command line.

use crate::candidates::{newest_open, read_with_candidates};
use crate::error::ReleaseError;
use crate::release::Release;
use crate::stage::Stage;
use crate::store::{ReadRelease, ReleaseStore};
use std::fmt;
use std::path::Path;
use std::str::FromStr;

const CANDIDATE: &str = "candidate";
const LIVE: &str = "live";

/// Which release of a store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReleaseChoice {
    /// The newest live one.
    #[default]
    Newest,
    /// The live one of this number.
    Number(u64),
    /// The newest candidate that nothing was decided about.
    NewestCandidate,
    /// The candidate of this number.
    Candidate(u64),
}

/// A word that names no release.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} names no release: write its number, live, candidate, or candidate-3")]
pub struct ReleaseChoiceError {
    text: String,
}

impl FromStr for ReleaseChoice {
    type Err = ReleaseChoiceError;

    fn from_str(text: &str) -> Result<Self, ReleaseChoiceError> {
        let number = |text: &str| text.parse().ok().filter(|number: &u64| *number > 0);
        let of_candidate = || text.strip_prefix(CANDIDATE)?.strip_prefix('-').and_then(number);
        match text {
            LIVE => Ok(Self::Newest),
            CANDIDATE => Ok(Self::NewestCandidate),
            _ => number(text)
                .map(Self::Number)
                .or_else(|| of_candidate().map(Self::Candidate))
                .ok_or_else(|| ReleaseChoiceError { text: text.to_owned() }),
        }
    }
}

impl fmt::Display for ReleaseChoice {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Newest => formatter.write_str(LIVE),
            Self::Number(number) => write!(formatter, "{number}"),
            Self::NewestCandidate => formatter.write_str(CANDIDATE),
            Self::Candidate(number) => write!(formatter, "{CANDIDATE}-{number}"),
        }
    }
}

impl ReleaseChoice {
    /// Reads the release.
    ///
    /// # Errors
    /// [`ReleaseError::Empty`], [`ReleaseError::NoRelease`], [`ReleaseError::NoCandidate`], and as [`ReleaseStore::release`].
    pub async fn of(self, store: &ReleaseStore) -> Result<Release, ReleaseError> {
        match self {
            Self::Newest => {
                let newest = store.newest().await?;
                newest.ok_or_else(|| ReleaseError::Empty { place: store.place().to_owned() })
            }
            Self::Number(number) => store.release(number).await,
            Self::NewestCandidate => newest_open(store).await,
            Self::Candidate(number) => store.candidate(number).await,
        }
    }

    /// What a server serves that is told to follow this choice; `None` where there is nothing yet. The newest candidate gives way to
    /// the live release where nothing is proposed.
    ///
    /// # Errors
    /// As [`ReleaseChoice::of`].
    pub async fn followed(self, store: &ReleaseStore) -> Result<Option<Release>, ReleaseError> {
        Ok(self.read_followed(store).await?.map(|read| read.release))
    }

    /// As [`ReleaseChoice::followed`], with its file.
    pub(crate) async fn read_followed(
        self,
        store: &ReleaseStore,
    ) -> Result<Option<ReadRelease>, ReleaseError> {
        match self {
            Self::Newest => store.read_newest().await,
            Self::NewestCandidate => read_with_candidates(store).await,
            Self::Number(number) => store.read_release(number).await.map(Some),
            Self::Candidate(number) => store.read_candidate(number).await.map(Some),
        }
    }

    /// Whether a server that follows this choice may have served a release.
    pub(crate) fn is_of(self, release: &Release) -> bool {
        let is_live = release.stage == Stage::Live;
        match self {
            Self::Newest => is_live,
            Self::Number(number) => is_live && release.number == number,
            Self::NewestCandidate => true,
            Self::Candidate(number) => !is_live && release.candidate == Some(number),
        }
    }
}

/// A store of releases and which of them: `s3://bucket/city`, `/srv/city@7`, `/srv/city@candidate`.
///
/// ```
/// use releases::{ReleaseChoice, ReleasePlace};
///
/// let place = ReleasePlace::from("s3://bucket/city@candidate-3");
/// assert_eq!((place.url.as_str(), place.choice), ("s3://bucket/city", ReleaseChoice::Candidate(3)));
/// assert_eq!(ReleasePlace::from("s3://me@host/city").choice, ReleaseChoice::Newest);
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReleasePlace {
    /// Folder or URL of the store.
    pub url: String,
    /// Which release.
    pub choice: ReleaseChoice,
}

impl From<&str> for ReleasePlace {
    /// What follows the last `@` counts where it names a release, and no folder is called so.
    fn from(text: &str) -> Self {
        let chosen = text.rsplit_once('@').filter(|_| !Path::new(text).exists());
        let chosen = chosen.and_then(|(url, choice)| Some((url, choice.parse().ok()?)));
        let (url, choice) = chosen.unwrap_or((text, ReleaseChoice::Newest));
        Self { url: url.to_owned(), choice }
    }
}

impl fmt::Display for ReleasePlace {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.choice {
            ReleaseChoice::Newest => formatter.write_str(&self.url),
            choice => write!(formatter, "{}@{choice}", self.url),
        }
    }
}

impl ReleasePlace {
    /// Whether it is one of releases: a URL, or a folder that was published to.
    pub fn is_released(&self) -> bool {
        self.url.contains("://") || ReleaseStore::is_published(Path::new(&self.url))
    }
}
