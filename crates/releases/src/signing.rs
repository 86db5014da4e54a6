//! Signatures of releases, in the format of [minisign](https://jedisct1.github.io/minisign/).
//!
//! What is signed are the bytes of a release's file, which names the SHA-256 of every segment, its own number and its stage: who can
//! write to the store but has no key can take releases away, and cannot make or change one, nor make a candidate live. A decision
//! about a candidate is signed too, and names the digest of its map.

#[cfg(feature = "signing")]
use crate::error::ReleaseError;
use minisign_verify::{PublicKey, Signature};
use std::path::Path;
use std::str::FromStr;

/// The public key of releases.
#[derive(Clone, Debug)]
pub struct ReleaseKey(PublicKey);

impl FromStr for ReleaseKey {
    type Err = ReleaseKeyError;

    /// Reads a key: its base64 text, or the file of it.
    fn from_str(text: &str) -> Result<Self, ReleaseKeyError> {
        let path = Path::new(text);
        let key = if path.is_file() { PublicKey::from_file(path) } else { PublicKey::from_base64(text) };
        key.map(Self).map_err(|source| ReleaseKeyError { text: text.to_owned(), source })
    }
}

impl ReleaseKey {
    /// Verifies the signature of some bytes.
    pub(crate) fn verify(&self, bytes: &[u8], signature: &[u8]) -> Result<(), SignatureError> {
        let signature = Signature::decode(std::str::from_utf8(signature)?)?;
        Ok(self.0.verify(bytes, &signature, false)?)
    }
}

/// A text that is no public key.
#[derive(Debug, thiserror::Error)]
#[error(
    "{text} is no public key ({source}): give the file of one, like city.pub, or its line that begins with RW"
)]
pub struct ReleaseKeyError {
    text: String,
    source: minisign_verify::Error,
}

/// What is wrong with the signature of a release.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SignatureError {
    /// There is none.
    #[error("it has no signature")]
    Missing,
    /// Its file is no text.
    #[error("{0}")]
    Text(#[from] std::str::Utf8Error),
    /// It is none of minisign, or of another key or other bytes.
    #[error("{0}")]
    Invalid(#[from] minisign_verify::Error),
}

/// The secret key of releases.
#[cfg(feature = "signing")]
pub struct SigningKey(minisign::SecretKey);

#[cfg(feature = "signing")]
impl std::fmt::Debug for SigningKey {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("SigningKey(..)")
    }
}

#[cfg(feature = "signing")]
impl SigningKey {
    /// Reads a key that minisign or [`SigningKey::generate`] wrote.
    ///
    /// # Arguments
    /// * `password`: of a key that is encrypted.
    ///
    /// # Errors
    /// [`ReleaseError::Key`].
    pub fn read(file: &Path, password: Option<String>) -> Result<Self, ReleaseError> {
        let failed = |reason: String| ReleaseError::Key { file: file.to_owned(), reason };
        let text = files::read_to_string(file).map_err(|error| failed(error.to_string()))?;
        let sealed = || minisign::SecretKeyBox::from_string(&text).map_err(|error| failed(error.to_string()));
        let key = match password {
            Some(password) => sealed()?.into_secret_key(Some(password)),
            None => sealed()?.into_unencrypted_secret_key(),
        };
        key.map(Self).map_err(|error| failed(error.to_string()))
    }

    /// Writes a new key to `file`, readable by its owner only, and the public one beside it, with `.pub`.
    ///
    /// # Errors
    /// [`ReleaseError::Key`]: files that exist, or cannot be written.
    pub fn generate(file: &Path) -> Result<std::path::PathBuf, ReleaseError> {
        use std::io::Write as _;
        let public_file = file.with_added_extension("pub");
        let pair = minisign::KeyPair::generate_unencrypted_keypair()
            .map_err(|error| ReleaseError::Key { file: file.to_owned(), reason: error.to_string() })?;
        let boxed = |failed: &Path, error: minisign::PError| ReleaseError::Key {
            file: failed.to_owned(),
            reason: error.to_string(),
        };
        let secret = pair.sk.to_box(None).map_err(|error| boxed(file, error))?.to_bytes();
        let public = pair.pk.to_box().map_err(|error| boxed(&public_file, error))?.to_bytes();
        for (path, bytes, mode) in [(file, secret, 0o600), (public_file.as_path(), public, 0o644)] {
            let mut options = std::fs::File::options();
            options.write(true).create_new(true);
            #[cfg(unix)]
            std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
            #[cfg(not(unix))]
            let _ = mode;
            let written = options.open(path).and_then(|mut opened| opened.write_all(&bytes));
            written
                .map_err(|error| ReleaseError::Key { file: path.to_owned(), reason: error.to_string() })?;
        }
        Ok(public_file)
    }

    /// The signature of the file of a release, a candidate or a decision.
    pub(crate) fn sign(&self, bytes: &[u8], object: &str) -> Result<Vec<u8>, ReleaseError> {
        let signature = minisign::sign(None, &self.0, bytes, None, None);
        let failed = |error| ReleaseError::Sign { object: object.to_owned(), reason: Box::new(error) };
        signature.map(|signature| signature.to_bytes()).map_err(failed)
    }
}
