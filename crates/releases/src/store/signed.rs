//! Files with signatures: of releases, candidates and decisions.

use super::{
    CANDIDATES, MAX_RELEASE_BYTES, MAX_SIGNATURE_BYTES, ReleaseStore, name_in, release_name, signature_name,
};
use crate::change::ReleasedChange;
use crate::error::ReleaseError;
use crate::release::Release;
use crate::stage::Stage;
use bytes::Bytes;
use object_store::PutMode;
use serde::Serialize;
use signing::SignatureError;

/// A release or a candidate with its file.
pub(crate) struct ReadRelease {
    pub(crate) release: Release,
    pub(crate) file: SignedFile,
}

/// A file of the store.
pub(crate) struct SignedFile {
    pub(crate) text: Bytes,
    /// Its signature, which was verified; `None` where there is no key to verify it with.
    pub(crate) signature: Option<Bytes>,
}

impl ReleaseStore {
    /// Puts a file with its signature, if its name is free; returns whether it was.
    pub(super) async fn put_signed(&self, object: String, of: &impl Serialize) -> Result<bool, ReleaseError> {
        let text = written(of).map_err(|error| self.damaged(object.clone(), error.into()))?;
        let (bytes, most) = (text.len() as u64, MAX_RELEASE_BYTES);
        if bytes > most {
            return Err(ReleaseError::TooLong { object, bytes, most });
        }
        #[cfg(feature = "signing")]
        if let Some(key) = &self.signing {
            // Before its file, so that none is ever without.
            let signature = key.sign(&text);
            let signature =
                signature.map_err(|source| ReleaseError::Sign { object: object.clone(), source })?;
            let name = signature_name(&text);
            let put = self.put(&name, signature, PutMode::Overwrite).await;
            put.map_err(|source| self.failed(name, "written", source))?;
        }
        match self.put(&object, text, PutMode::Create).await {
            Ok(()) => Ok(true),
            Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
            Err(source) => Err(self.failed(object, "written", source)),
        }
    }

    /// A release whose file can be read: where it would be too long, without the motions of single keyframes.
    ///
    /// # Errors
    /// [`ReleaseError::TooLong`] where it is too long without them, too; [`ReleaseError::LongLedger`] where most of it is the ledger.
    pub(crate) fn fitted(&self, release: Release) -> Result<Release, ReleaseError> {
        self.fitted_to(release, MAX_RELEASE_BYTES)
    }

    fn fitted_to(&self, mut release: Release, most: u64) -> Result<Release, ReleaseError> {
        let object = object_of(&release);
        let bytes_of = |release: &Release| match written(release) {
            Ok(text) => Ok(text.len() as u64),
            Err(error) => Err(self.damaged(object.clone(), error.into())),
        };
        let whole = bytes_of(&release)?;
        if whole <= most {
            return Ok(release);
        }
        release.change = release.change.map(ReleasedChange::without_motions);
        let bytes = bytes_of(&release)?;
        if bytes > most {
            let sessions = &release.map.sessions;
            let of_ledger = written(sessions).map_or(0, |text| text.len() as u64);
            return Err(if of_ledger > bytes / 2 {
                ReleaseError::LongLedger { object, sessions: sessions.len(), bytes, most }
            } else {
                ReleaseError::TooLong { object, bytes, most }
            });
        }
        tracing::warn!(
            object,
            bytes = whole,
            most,
            "the file of the release would be too long: robots are told only the largest motion of a keyframe"
        );
        Ok(release)
    }

    /// The file of a release or candidate that was read before.
    ///
    /// # Errors
    /// As [`ReleaseStore::release`].
    pub(crate) async fn file_of(&self, release: &Release) -> Result<SignedFile, ReleaseError> {
        let place = || self.place.clone();
        let missing = || match release.stage {
            Stage::Live => ReleaseError::NoRelease { place: place(), number: release.number },
            Stage::Candidate => ReleaseError::NoCandidate { place: place(), candidate: release.candidate },
        };
        self.read_with_signature(&object_of(release)).await?.ok_or_else(missing)
    }

    /// Reads a file whose signature is verified where there is a key; `None` where there is no such file.
    pub(super) async fn read_signed(&self, object: &str) -> Result<Option<Bytes>, ReleaseError> {
        Ok(self.read_with_signature(object).await?.map(|file| file.text))
    }

    /// As [`ReleaseStore::read_signed`], with the signature.
    pub(super) async fn read_with_signature(&self, object: &str) -> Result<Option<SignedFile>, ReleaseError> {
        let Some(text) = self.read_if_there(object, MAX_RELEASE_BYTES).await? else { return Ok(None) };
        if self.key.is_none() {
            return Ok(Some(SignedFile { text, signature: None }));
        }
        let signature = self.read_if_there(&signature_name(&text), MAX_SIGNATURE_BYTES).await?;
        self.verify(&text, signature.as_deref()).map_err(|reason| ReleaseError::NotSigned {
            place: self.place.clone(),
            object: object.to_owned(),
            reason,
        })?;
        Ok(Some(SignedFile { text, signature }))
    }

    /// Verifies a file of this store; anything where there is no key.
    pub(crate) fn verify(&self, text: &[u8], signature: Option<&[u8]>) -> Result<(), SignatureError> {
        let Some(key) = &self.key else { return Ok(()) };
        key.verify(text, signature.ok_or(SignatureError::Missing)?)
    }
}

/// A file as it is put.
fn written(of: &impl Serialize) -> Result<Vec<u8>, serde_json::Error> {
    let mut text = serde_json::to_vec_pretty(of)?;
    text.push(b'\n');
    Ok(text)
}

/// The file of a release or candidate.
fn object_of(release: &Release) -> String {
    match (release.stage, release.candidate) {
        (Stage::Candidate, Some(candidate)) => name_in(CANDIDATES, candidate),
        _ => release_name(release.number),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_release_whose_file_would_be_too_long_goes_without_motions_or_is_refused() {
        let file = "tests/data/release_9/releases/00000000000000000002.json";
        let text = std::fs::read(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
        let release = Release::decode(&text, 2).unwrap();
        let store = ReleaseStore::open("nowhere").unwrap();
        let bytes = written(&release).unwrap().len() as u64;
        assert_eq!(store.fitted_to(release.clone(), bytes).unwrap(), release);
        let change = release.change.clone().unwrap();
        assert!(!change.keyframe_motions.is_empty());
        let shorter = store.fitted_to(release.clone(), bytes - 1).unwrap();
        let fitted = shorter.change.clone().unwrap();
        assert!(fitted.keyframe_motions.is_empty() && fitted.moved == change.moved);
        // The keyframe that moved by 0.25 m.
        assert!(fitted.stated_change.unwrap().sigma_p_m >= 0.25);
        assert_eq!(Release { change: release.change.clone(), ..shorter }, release);
        let error = store.fitted_to(release.clone(), 1000).unwrap_err();
        assert!(matches!(error, ReleaseError::TooLong { most: 1000, .. }), "{error}");
        // Larger cells would not help where there are many sessions.
        let mut many = release;
        many.map.sessions = vec![many.map.sessions[0].clone(); 500];
        let error = store.fitted_to(many, 1000).unwrap_err();
        assert!(matches!(error, ReleaseError::LongLedger { sessions: 500, .. }), "{error}");
        assert!(error.to_string().contains("ledger of its 500 sessions"), "{error}");
    }
}
