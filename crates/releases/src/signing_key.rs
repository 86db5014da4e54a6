//! Secret keys that sign releases, each with its public half: what is signed anew must have been signed with it before.

use signing::{KeyError, PublicKey, SecretKey, SignError};
use std::path::{Path, PathBuf};

/// A secret key that signs releases.
#[derive(Debug)]
pub struct SigningKey {
    secret: SecretKey,
    public: PublicKey,
}

impl SigningKey {
    /// Reads a key that minisign or [`SigningKey::generate`] wrote.
    ///
    /// # Arguments
    /// * `password`: of a key that is encrypted.
    ///
    /// # Errors
    /// [`KeyError`].
    pub fn read(file: &Path, password: Option<String>) -> Result<Self, KeyError> {
        let public = public_half(file, password.clone());
        let public = public.map_err(|reason| KeyError { file: file.to_owned(), reason })?;
        Ok(Self { secret: SecretKey::read(file, password)?, public })
    }

    /// Writes a new key to `file`, readable by its owner only, and the public one beside it, with `.pub`.
    ///
    /// # Errors
    /// [`KeyError`]: files that exist, or cannot be written.
    pub fn generate(file: &Path) -> Result<PathBuf, KeyError> {
        SecretKey::generate(file)
    }

    /// The key that verifies what this one signs.
    pub fn public(&self) -> &PublicKey {
        &self.public
    }

    /// The signature of some bytes.
    ///
    /// # Errors
    /// [`SignError`]: a fault of minisign.
    pub fn sign(&self, bytes: &[u8]) -> Result<Vec<u8>, SignError> {
        self.secret.sign(bytes)
    }
}

/// The public half of the key in a file.
fn public_half(
    file: &Path,
    password: Option<String>,
) -> Result<PublicKey, Box<dyn std::error::Error + Send + Sync>> {
    let sealed = minisign::SecretKeyBox::from_string(&files::read_to_string(file)?)?;
    let secret = match password {
        Some(password) => sealed.into_secret_key(Some(password))?,
        None => sealed.into_unencrypted_secret_key()?,
    };
    Ok(minisign::PublicKey::from_secret_key(&secret)?.to_base64().parse()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_public_half_is_that_of_the_file_beside_the_key() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("city.key");
        let beside: PublicKey = SigningKey::generate(&file).unwrap().to_str().unwrap().parse().unwrap();
        let key = SigningKey::read(&file, None).unwrap();
        let signature = key.sign(b"a release").unwrap();
        for public in [key.public(), &beside] {
            public.verify(b"a release", &signature).unwrap();
            assert!(public.verify(b"another", &signature).is_err());
        }
        assert!(SigningKey::read(&folder.path().join("none.key"), None).is_err());
    }
}
