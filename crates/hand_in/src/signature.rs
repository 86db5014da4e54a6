//! Signatures: the last block of a session file signs all bytes before it.

use std::fs::File;
use std::io::Write as _;
use std::path::Path;

use protocol::MAX_SESSION_BYTES;
use signing::{PublicKey, SecretKey, SignatureError};

use crate::block::{self, kind};
use crate::blocks::Blocks;
use crate::error::HandInError;
use crate::reading::Session;

/// Signs a session that has ended. What was being written when the robot was stopped is cut off first; a session that has a
/// signature stays as it is.
///
/// # Errors
/// [`HandInError`]: the file cannot be read or written, or is no session.
pub fn sign(path: &Path, key: &SecretKey) -> Result<(), HandInError> {
    let failed = |source| HandInError::Io { path: path.to_owned(), source };
    let mut bytes = files::read(path, MAX_SESSION_BYTES).map_err(failed)?;
    let session = Session::check(path, &bytes)?;
    if session.signature.is_some() {
        return Ok(());
    }
    bytes.truncate(usize::try_from(session.whole_bytes).unwrap_or(bytes.len()));
    let signature = key.sign(&bytes).map_err(|source| HandInError::Sign { path: path.to_owned(), source })?;
    let Some(block) = block::encode(kind::SIGNATURE, &signature) else { return Ok(()) };
    let append = || {
        let mut file = File::options().append(true).open(path)?;
        file.set_len(session.whole_bytes)?;
        file.write_all(&block)?;
        file.sync_data()
    };
    append().map_err(failed)
}

/// Verifies that a session was signed with a key, up to its end. Of its content nothing is decoded.
///
/// # Arguments
/// * `path`: what the file is called in errors.
/// * `bytes`: those of the file.
///
/// # Errors
/// [`HandInError::Signature`], [`HandInError::OtherFormat`], [`HandInError::Schema`], [`HandInError::NoHeader`].
pub fn verify(path: &Path, bytes: &[u8], key: &PublicKey) -> Result<(), HandInError> {
    let wrong = |source| HandInError::Signature { path: path.to_owned(), source };
    let (_, mut blocks) = Blocks::of_file(path, bytes)?;
    let signature = blocks.find(|(_, block)| block.kind == kind::SIGNATURE);
    let signature = signature.filter(|_| blocks.whole_bytes() == bytes.len());
    let (covered, block) = signature.ok_or(SignatureError::Missing).map_err(wrong)?;
    key.verify(&bytes[..covered], block.payload).map_err(wrong)
}
