//! Public keys.

use minisign_verify::Signature;
use std::path::Path;
use std::str::FromStr;

/// A public key.
#[derive(Clone, Debug)]
pub struct PublicKey(minisign_verify::PublicKey);

impl FromStr for PublicKey {
    type Err = PublicKeyError;

    /// Reads a key: its base64 text, or the file of it.
    fn from_str(text: &str) -> Result<Self, PublicKeyError> {
        let path = Path::new(text);
        let key = if path.is_file() {
            minisign_verify::PublicKey::from_file(path)
        } else {
            minisign_verify::PublicKey::from_base64(text)
        };
        key.map(Self).map_err(|source| PublicKeyError { text: text.to_owned(), source })
    }
}

impl PublicKey {
    /// Verifies the signature of some bytes.
    ///
    /// # Errors
    /// [`SignatureError`]: it is none, or of another key or other bytes.
    pub fn verify(&self, bytes: &[u8], signature: &[u8]) -> Result<(), SignatureError> {
        let signature = Signature::decode(std::str::from_utf8(signature)?)?;
        Ok(self.0.verify(bytes, &signature, false)?)
    }
}

/// A text that is no public key.
#[derive(Debug, thiserror::Error)]
#[error(
    "{text} is no public key ({source}): give the file of one, like city.pub, or its line that begins with RW"
)]
pub struct PublicKeyError {
    text: String,
    source: minisign_verify::Error,
}

/// What is wrong with a signature.
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
