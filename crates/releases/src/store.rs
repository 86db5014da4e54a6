//! The object store of releases.

mod marks;
mod signed;

use crate::change::ReleasedChange;
use crate::damage::Damage;
use crate::error::ReleaseError;
use crate::release::Release;
use crate::stage::Decision;
use bytes::Bytes;
use futures_util::TryStreamExt as _;
use map::file::SegmentName;
use map::file::segment::sha256;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt as _, PutMode, PutOptions, PutPayload};
pub(crate) use signed::{ReadRelease, SignedFile};
use signing::PublicKey as ReleaseKey;
#[cfg(feature = "signing")]
use signing::SecretKey as SigningKey;
use std::sync::Arc;
use url::Url;

/// The file of a release names its segments: a few hundred bytes a cell.
const MAX_RELEASE_BYTES: u64 = 64 << 20;
/// Digits of a number in a name, so that names sort as numbers do.
const DIGITS: usize = 20;
const RELEASES: &str = "releases";
const CANDIDATES: &str = "candidates";
const DECISIONS: &str = "decisions";
const SEGMENTS: &str = "segments";
const SIGNATURES: &str = "signatures";
/// A signature is a few lines.
const MAX_SIGNATURE_BYTES: u64 = 4096;
const EXTENSION: &str = ".json";

/// The releases of one map in an object store.
#[derive(Clone, Debug)]
pub struct ReleaseStore {
    store: Arc<dyn ObjectStore>,
    root: Path,
    place: String,
    /// Releases must be signed with it.
    key: Option<ReleaseKey>,
    #[cfg(feature = "signing")]
    signing: Option<Arc<SigningKey>>,
}

impl ReleaseStore {
    /// Opens a store; nothing is read or written yet.
    ///
    /// # Arguments
    /// * `place`: a folder, or a URL: `file:///srv/city`, and with the feature `cloud` `s3://bucket/city`, `gs://bucket/city`,
    ///   `az://container/city`. Credentials, region and endpoint of a cloud are taken from the environment, from the variables
    ///   of its own tools (`AWS_ACCESS_KEY_ID`, `AWS_REGION`, `AWS_ENDPOINT`, `GOOGLE_SERVICE_ACCOUNT`, `AZURE_STORAGE_ACCOUNT_NAME`, ...).
    ///
    /// # Errors
    /// [`ReleaseError::Place`].
    pub fn open(place: &str) -> Result<Self, ReleaseError> {
        let refused = |reason: String| ReleaseError::Place { place: place.to_owned(), reason };
        let url = if place.contains("://") {
            Url::parse(place).map_err(|error| refused(error.to_string()))?
        } else {
            let folder = std::path::absolute(place).map_err(|error| refused(error.to_string()))?;
            Url::from_directory_path(folder).map_err(|()| refused("it is no folder".to_owned()))?
        };
        #[cfg(feature = "cloud")]
        {
            // Somebody else may have installed a provider before; any is good enough.
            let _ = rustls::crypto::ring::default_provider().install_default();
        }
        let variables = std::env::vars_os().filter_map(|(name, value)| {
            let name = name.into_string().ok()?.to_ascii_lowercase();
            let is_ours = ["aws_", "google_", "azure_"].iter().any(|prefix| name.starts_with(prefix));
            is_ours.then_some((name, value.into_string().ok()?))
        });
        let (store, root) =
            object_store::parse_url_opts(&url, variables).map_err(|error| refused(error.to_string()))?;
        let store: Arc<dyn ObjectStore> = if url.scheme() == "file" {
            // What was acknowledged survives a failure of the power.
            Arc::new(LocalFileSystem::new().with_fsync(true))
        } else {
            Arc::from(store)
        };
        Ok(Self {
            store,
            root,
            place: place.to_owned(),
            key: None,
            #[cfg(feature = "signing")]
            signing: None,
        })
    }

    /// Whether a folder on this machine holds releases, so that [`ReleaseStore::open`] takes it for a store that was published to.
    pub fn is_published(folder: &std::path::Path) -> bool {
        [RELEASES, CANDIDATES].iter().any(|stage| {
            let Ok(files) = std::fs::read_dir(folder.join(stage)) else { return false };
            files.flatten().any(|file| file.file_name().to_str().and_then(number_of).is_some())
        })
    }

    /// A store that the caller has opened, with the releases at its root.
    ///
    /// # Arguments
    /// * `place`: its name in messages.
    pub fn over(store: Arc<dyn ObjectStore>, place: &str) -> Self {
        Self {
            store,
            root: Path::default(),
            place: place.to_owned(),
            key: None,
            #[cfg(feature = "signing")]
            signing: None,
        }
    }

    /// The same store, whose releases are read only if they are signed with a key.
    #[must_use]
    pub fn signed_with(self, key: ReleaseKey) -> Self {
        Self { key: Some(key), ..self }
    }

    /// The same store, to which releases are put with a signature.
    #[cfg(feature = "signing")]
    #[must_use]
    pub fn signing_with(self, key: SigningKey) -> Self {
        Self { signing: Some(Arc::new(key)), ..self }
    }

    /// The place as it was given.
    pub fn place(&self) -> &str {
        &self.place
    }

    /// The numbers of all releases, ascending.
    ///
    /// # Errors
    /// [`ReleaseError::Store`].
    pub async fn numbers(&self) -> Result<Vec<u64>, ReleaseError> {
        self.numbers_in(RELEASES).await
    }

    async fn numbers_in(&self, folder: &str) -> Result<Vec<u64>, ReleaseError> {
        let objects = self.list(folder).await?;
        let number = |object: ObjectMeta| number_of(object.location.filename()?);
        let mut numbers: Vec<u64> = objects.into_iter().filter_map(number).collect();
        numbers.sort_unstable();
        Ok(numbers)
    }

    /// A release.
    ///
    /// # Errors
    /// [`ReleaseError::NoRelease`], [`ReleaseError::Store`], [`ReleaseError::Damaged`].
    pub async fn release(&self, number: u64) -> Result<Release, ReleaseError> {
        Ok(self.read_release(number).await?.release)
    }

    /// A release with its file.
    pub(crate) async fn read_release(&self, number: u64) -> Result<ReadRelease, ReleaseError> {
        let object = release_name(number);
        let missing = || ReleaseError::NoRelease { place: self.place.clone(), number };
        let file = self.read_with_signature(&object).await?.ok_or_else(missing)?;
        let release = Release::decode(&file.text, number).map_err(|reason| self.damaged(object, reason))?;
        Ok(ReadRelease { release, file })
    }

    /// The numbers of all candidates, ascending.
    ///
    /// # Errors
    /// [`ReleaseError::Store`].
    pub async fn candidate_numbers(&self) -> Result<Vec<u64>, ReleaseError> {
        self.numbers_in(CANDIDATES).await
    }

    /// A candidate.
    ///
    /// # Errors
    /// [`ReleaseError::NoCandidate`], [`ReleaseError::Store`], [`ReleaseError::Damaged`].
    pub async fn candidate(&self, number: u64) -> Result<Release, ReleaseError> {
        Ok(self.read_candidate(number).await?.release)
    }

    /// A candidate with its file.
    pub(crate) async fn read_candidate(&self, number: u64) -> Result<ReadRelease, ReleaseError> {
        let object = name_in(CANDIDATES, number);
        let missing = || ReleaseError::NoCandidate { place: self.place.clone(), candidate: Some(number) };
        let file = self.read_with_signature(&object).await?.ok_or_else(missing)?;
        let release =
            Release::decode_candidate(&file.text, number).map_err(|reason| self.damaged(object, reason))?;
        Ok(ReadRelease { release, file })
    }

    /// A release whose map is put under this store's signature again.
    ///
    /// # Errors
    /// As [`ReleaseStore::release`], and [`ReleaseError::SourceNotSigned`] where there is a key to sign with that did
    /// not sign it.
    pub(crate) async fn release_to_sign(&self, number: u64) -> Result<Release, ReleaseError> {
        let read = self.trusting_own_key().release(number).await;
        read.map_err(|error| self.of_source(error, number.to_string()))
    }

    /// A candidate that is put under this store's signature as a release.
    ///
    /// # Errors
    /// As [`ReleaseStore::candidate`], and [`ReleaseError::SourceNotSigned`] where there is a key to sign with that did
    /// not sign it.
    pub(crate) async fn candidate_to_sign(&self, number: u64) -> Result<Release, ReleaseError> {
        let read = self.trusting_own_key().candidate(number).await;
        read.map_err(|error| self.of_source(error, format!("candidate-{number}")))
    }

    /// The same store, of which only what its own key signed is read, unless it verifies with another key or signs
    /// nothing.
    fn trusting_own_key(&self) -> Self {
        #[cfg(feature = "signing")]
        if let (None, Some(signing)) = (&self.key, &self.signing) {
            return self.clone().signed_with(signing.public().clone());
        }
        self.clone()
    }

    /// An error of reading what is signed anew, of which `choice` is the word after `@`.
    fn of_source(&self, error: ReleaseError, choice: String) -> ReleaseError {
        match error {
            ReleaseError::NotSigned { place, object, reason } if self.key.is_none() => {
                ReleaseError::SourceNotSigned { place, object, choice, reason }
            }
            error => error,
        }
    }

    /// What was decided about a candidate; `None` where nothing was.
    ///
    /// # Errors
    /// [`ReleaseError::Store`], [`ReleaseError::Damaged`].
    pub async fn decision(&self, proposed: &Release) -> Result<Option<Decision>, ReleaseError> {
        let Some(candidate) = proposed.candidate else { return Ok(None) };
        let object = name_in(DECISIONS, candidate);
        let Some(text) = self.read_signed(&object).await? else { return Ok(None) };
        let decision: Decision =
            serde_json::from_slice(&text).map_err(|error| self.damaged(object.clone(), error.into()))?;
        let Decision { candidate: of, digest, .. } = decision;
        if (of, digest) != (candidate, proposed.digest) {
            return Err(self.damaged(object, Damage::OtherCandidate { candidate: of, digest }));
        }
        match decision.note.check() {
            Ok(()) => Ok(Some(decision)),
            Err((what, at_most)) => Err(self.damaged(object, Damage::Note { what, at_most })),
        }
    }

    /// The newest release; `None` where nothing was published.
    ///
    /// # Errors
    /// As [`ReleaseStore::release`].
    pub async fn newest(&self) -> Result<Option<Release>, ReleaseError> {
        Ok(self.read_newest().await?.map(|read| read.release))
    }

    /// The newest release with its file.
    pub(crate) async fn read_newest(&self) -> Result<Option<ReadRelease>, ReleaseError> {
        match self.numbers().await?.last() {
            Some(number) => self.read_release(*number).await.map(Some),
            None => Ok(None),
        }
    }

    /// What changed from an earlier version to a release; `None` where releases in between are gone or do not say.
    ///
    /// # Errors
    /// As [`ReleaseStore::release`].
    pub async fn change_since(
        &self,
        version: u64,
        release: &Release,
    ) -> Result<Option<ReleasedChange>, ReleaseError> {
        let Some(mut change) = release.change.clone() else { return Ok(None) };
        let mut number = release.number;
        while change.from_version > version {
            number -= 1;
            let between = match self.release(number).await {
                Ok(between) => between.change,
                Err(ReleaseError::NoRelease { .. }) => None,
                Err(error) => return Err(error),
            };
            let Some(between) = between else { return Ok(None) };
            change = between.then(&change);
        }
        Ok(Some(change).filter(|change| change.from_version == version))
    }

    /// The bytes of a segment, verified.
    pub(crate) async fn segment(&self, name: &SegmentName) -> Result<Bytes, ReleaseError> {
        let object = segment_name(name);
        let bytes = self.read(&object, name.bytes).await?;
        let found = SegmentName::of(&bytes);
        if found == *name {
            return Ok(bytes);
        }
        let SegmentName { sha256, bytes } = found;
        Err(self.damaged(object, Damage::Checksum { bytes, sha256 }))
    }

    /// Puts a segment; one that is there already has the same bytes, and becomes young again.
    pub(crate) async fn put_segment(&self, name: &SegmentName, bytes: Vec<u8>) -> Result<(), ReleaseError> {
        let object = segment_name(name);
        self.put(&object, bytes, PutMode::Overwrite)
            .await
            .map_err(|source| self.failed(object, "written", source))
    }

    /// Puts a release under its number, if that is free.
    pub(crate) async fn put_release(&self, release: &Release) -> Result<(), ReleaseError> {
        let number = release.number;
        let was_free = self.put_signed(release_name(number), release).await?;
        if was_free { Ok(()) } else { Err(ReleaseError::Conflict { number }) }
    }

    /// Puts a candidate under its number, if that is free.
    pub(crate) async fn put_candidate(&self, release: &Release, number: u64) -> Result<(), ReleaseError> {
        let was_free = self.put_signed(name_in(CANDIDATES, number), release).await?;
        if was_free { Ok(()) } else { Err(ReleaseError::CandidateConflict { candidate: number }) }
    }

    /// Puts a decision, if there is none about its candidate; returns whether there was none.
    pub(crate) async fn put_decision(&self, decision: &Decision) -> Result<bool, ReleaseError> {
        self.put_signed(name_in(DECISIONS, decision.candidate), decision).await
    }

    async fn read_if_there(&self, object: &str, at_most: u64) -> Result<Option<Bytes>, ReleaseError> {
        match self.read(object, at_most).await {
            Ok(bytes) => Ok(Some(bytes)),
            Err(ReleaseError::Store { reason, .. })
                if matches!(*reason, object_store::Error::NotFound { .. }) =>
            {
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// All segments with the times when they were last put.
    pub(crate) async fn segments(&self) -> Result<Vec<(String, ObjectMeta)>, ReleaseError> {
        let objects = self.list(SEGMENTS).await?;
        let named = |object: ObjectMeta| Some((object.location.filename()?.to_owned(), object));
        Ok(objects.into_iter().filter_map(named).collect())
    }

    /// What is known of a segment; `None` where it is gone.
    pub(crate) async fn segment_found(&self, sha256: &str) -> Result<Option<ObjectMeta>, ReleaseError> {
        self.head(&format!("{SEGMENTS}/{sha256}")).await
    }

    /// Puts an empty object; returns when that was, s since 1970.
    async fn put_dated(&self, object: String) -> Result<u64, ReleaseError> {
        let put = self.put(&object, Vec::new(), PutMode::Overwrite).await;
        put.map_err(|source| self.failed(object.clone(), "written", source))?;
        let found = self.store.head(&self.at(&object)).await;
        let found = found.map_err(|source| self.failed(object, "read", source))?;
        Ok(put_s(&found))
    }

    /// What a folder has, and when it was put, s since 1970.
    async fn dated(&self, folder: &str) -> Result<Vec<(String, u64)>, ReleaseError> {
        let named = |object: ObjectMeta| Some((object.location.filename()?.to_owned(), put_s(&object)));
        Ok(self.list(folder).await?.into_iter().filter_map(named).collect())
    }

    pub(crate) async fn remove_release(&self, number: u64) -> Result<(), ReleaseError> {
        self.remove_signed(release_name(number)).await
    }

    /// Removes a candidate, then what was decided about it.
    pub(crate) async fn remove_candidate(&self, number: u64) -> Result<(), ReleaseError> {
        self.remove_signed(name_in(CANDIDATES, number)).await?;
        self.remove_signed(name_in(DECISIONS, number)).await
    }

    async fn remove_signed(&self, object: String) -> Result<(), ReleaseError> {
        if let Ok(text) = self.read(&object, MAX_RELEASE_BYTES).await {
            self.remove(signature_name(&text)).await?;
        }
        self.remove(object).await
    }

    pub(crate) async fn remove_segment(&self, sha256: &str) -> Result<(), ReleaseError> {
        self.remove(format!("{SEGMENTS}/{sha256}")).await
    }

    async fn remove(&self, object: String) -> Result<(), ReleaseError> {
        match self.store.delete(&self.at(&object)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(source) => Err(self.failed(object, "removed", source)),
        }
    }

    async fn put(&self, object: &str, bytes: Vec<u8>, mode: PutMode) -> Result<(), object_store::Error> {
        let options = PutOptions { mode, ..PutOptions::default() };
        self.store.put_opts(&self.at(object), PutPayload::from(bytes), options).await.map(drop)
    }

    async fn read(&self, object: &str, at_most: u64) -> Result<Bytes, ReleaseError> {
        let failed = |source| self.failed(object.to_owned(), "read", source);
        let found = self.store.get(&self.at(object)).await.map_err(failed)?;
        if found.meta.size > at_most {
            return Err(self.damaged(object.to_owned(), Damage::Length { found: found.meta.size, at_most }));
        }
        found.bytes().await.map_err(failed)
    }

    /// What is known of an object; `None` where there is none.
    async fn head(&self, object: &str) -> Result<Option<ObjectMeta>, ReleaseError> {
        match self.store.head(&self.at(object)).await {
            Ok(found) => Ok(Some(found)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(source) => Err(self.failed(object.to_owned(), "read", source)),
        }
    }

    async fn list(&self, folder: &str) -> Result<Vec<ObjectMeta>, ReleaseError> {
        match self.store.list(Some(&self.at(folder))).try_collect().await {
            Ok(objects) => Ok(objects),
            Err(object_store::Error::NotFound { .. }) => Ok(Vec::new()),
            Err(source) => Err(self.failed(folder.to_owned(), "listed", source)),
        }
    }

    fn at(&self, object: &str) -> Path {
        self.root.parts().chain(Path::from(object).parts()).collect()
    }

    fn failed(&self, object: String, done: &'static str, reason: object_store::Error) -> ReleaseError {
        ReleaseError::Store { place: self.place.clone(), object, done, reason: Box::new(reason) }
    }

    pub(crate) fn damaged(&self, object: String, reason: Damage) -> ReleaseError {
        ReleaseError::Damaged { place: self.place.clone(), object, reason }
    }
}

fn release_name(number: u64) -> String {
    name_in(RELEASES, number)
}

fn name_in(folder: &str, number: u64) -> String {
    format!("{folder}/{number:0DIGITS$}{EXTENSION}")
}

/// The number of the release or candidate whose file has a name.
fn number_of(filename: &str) -> Option<u64> {
    filename.strip_suffix(EXTENSION)?.parse().ok().filter(|number| *number > 0)
}

/// When an object was put, s since 1970.
pub(crate) fn put_s(object: &ObjectMeta) -> u64 {
    u64::try_from(object.last_modified.timestamp()).unwrap_or(0)
}

/// That of the signature of a release's file.
fn signature_name(text: &[u8]) -> String {
    format!("{SIGNATURES}/{}", sha256(text))
}

fn segment_name(segment: &SegmentName) -> String {
    format!("{SEGMENTS}/{}", segment.sha256)
}
