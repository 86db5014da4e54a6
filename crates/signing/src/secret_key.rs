//! Secret keys.

use crate::{PublicKey, PublicKeyError};
use std::path::{Path, PathBuf};

/// A secret key cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("the key {} cannot be used: {reason}", file.display())]
pub struct KeyError {
    /// File of the key.
    pub file: PathBuf,
    /// Why not.
    pub reason: Box<dyn std::error::Error + Send + Sync>,
}

/// Something cannot be signed: the error of minisign.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SignError(Box<dyn std::error::Error + Send + Sync>);

/// A secret key, with its public half.
pub struct SecretKey {
    secret: minisign::SecretKey,
    public: PublicKey,
}

impl std::fmt::Debug for SecretKey {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("SecretKey(..)")
    }
}

impl SecretKey {
    /// Reads a key that minisign or [`SecretKey::generate`] wrote.
    ///
    /// # Arguments
    /// * `password`: of a key that is encrypted.
    ///
    /// # Errors
    /// [`KeyError`].
    pub fn read(file: &Path, password: Option<String>) -> Result<Self, KeyError> {
        let failed = |reason| KeyError { file: file.to_owned(), reason };
        let text = files::read_to_string(file).map_err(|error| failed(error.into()))?;
        let sealed = || minisign::SecretKeyBox::from_string(&text).map_err(|error| failed(error.into()));
        let secret = match password {
            Some(password) => sealed()?.into_secret_key(Some(password)),
            None => sealed()?.into_unencrypted_secret_key(),
        };
        let secret = secret.map_err(|error| failed(error.into()))?;
        let public = minisign::PublicKey::from_secret_key(&secret).map_err(|error| failed(error.into()))?;
        let public = public.to_base64().parse().map_err(|error: PublicKeyError| failed(error.into()))?;
        Ok(Self { secret, public })
    }

    /// The key that verifies what this one signs.
    pub fn public(&self) -> &PublicKey {
        &self.public
    }

    /// Writes a new key to `file`, readable by its owner only, and the public one beside it, with `.pub`.
    ///
    /// # Errors
    /// [`KeyError`]: files that exist, or cannot be written. Neither file is written then.
    pub fn generate(file: &Path) -> Result<PathBuf, KeyError> {
        let public_file = file.with_added_extension("pub");
        let failed = |failed: &Path, error: minisign::PError| KeyError {
            file: failed.to_owned(),
            reason: error.into(),
        };
        let pair = minisign::KeyPair::generate_unencrypted_keypair().map_err(|error| failed(file, error))?;
        let secret = pair.sk.to_box(None).map_err(|error| failed(file, error))?.to_bytes();
        let public = pair.pk.to_box().map_err(|error| failed(&public_file, error))?.to_bytes();
        let unwritten = |path: &Path, error: std::io::Error| {
            let reason = match error.kind() {
                std::io::ErrorKind::AlreadyExists => "it is there already: give another name".into(),
                _ => error.into(),
            };
            KeyError { file: path.to_owned(), reason }
        };
        // Nobody signs with a key whose public half is another one's, or lost.
        files::write_new(&public_file, &public).map_err(|error| unwritten(&public_file, error))?;
        files::write_new_secret(file, &secret).map_err(|error| {
            let _ = std::fs::remove_file(&public_file);
            unwritten(file, error)
        })?;
        Ok(public_file)
    }

    /// The signature of some bytes.
    ///
    /// # Errors
    /// [`SignError`]: a fault of minisign.
    ///
    /// ```
    /// let folder = tempfile::tempdir()?;
    /// let public = signing::SecretKey::generate(&folder.path().join("robot.key"))?;
    /// let secret = signing::SecretKey::read(&folder.path().join("robot.key"), None)?;
    /// let key: signing::PublicKey = std::fs::read_to_string(public)?.lines().nth(1).unwrap_or_default().parse()?;
    /// let signature = secret.sign(b"a session")?;
    /// assert!(key.verify(b"a session", &signature).is_ok());
    /// assert!(key.verify(b"another session", &signature).is_err());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn sign(&self, bytes: &[u8]) -> Result<Vec<u8>, SignError> {
        let signature = minisign::sign(None, &self.secret, bytes, None, None);
        signature.map(|signature| signature.to_bytes()).map_err(|error| SignError(error.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_public_half_is_that_of_the_file_beside_the_key() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("city.key");
        let beside: PublicKey = SecretKey::generate(&file).unwrap().to_str().unwrap().parse().unwrap();
        let key = SecretKey::read(&file, None).unwrap();
        let signature = key.sign(b"a release").unwrap();
        for public in [key.public(), &beside] {
            public.verify(b"a release", &signature).unwrap();
            assert!(public.verify(b"another", &signature).is_err());
        }
        assert!(SecretKey::read(&folder.path().join("none.key"), None).is_err());
    }

    #[test]
    fn a_file_that_is_there_is_kept_and_no_half_of_a_pair_is_left() {
        for occupied in ["city.key", "city.key.pub"] {
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join(occupied), "of another pair").unwrap();
            let error = SecretKey::generate(&folder.path().join("city.key")).unwrap_err();
            assert_eq!(error.file, folder.path().join(occupied));
            assert!(error.to_string().ends_with("it is there already: give another name"), "{error}");
            assert_eq!(std::fs::read_to_string(&error.file).unwrap(), "of another pair");
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "{occupied}");
        }
    }
}
