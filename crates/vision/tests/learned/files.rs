//! Files of weights that are damaged, foreign or hostile are errors.

use super::dots::blobs;
use crate::weights_file;
use sha2::{Digest as _, Sha256};
use std::fmt::Write as _;
use std::path::Path;
use vision::features::weights::{WeightsError, WeightsFile};
use vision::features::{OpenError, open};

#[test]
fn a_flipped_byte_of_a_stored_file_is_refused_by_its_checksum() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r2d2-1.safetensors");
    let weights = weights_file::write(&blobs());
    let mut checksum = String::new();
    for byte in Sha256::digest(&weights) {
        write!(checksum, "{byte:02x}").unwrap();
    }
    std::fs::write(WeightsFile::checksum_path(&path), format!("{checksum}  r2d2-1.safetensors\n")).unwrap();
    std::fs::write(&path, &weights).unwrap();
    assert!(open("r2d2-1", Some(folder.path())).is_ok());
    for position in (0..weights.len()).step_by(40_001) {
        let mut damaged = weights.clone();
        damaged[position] ^= 0x41;
        std::fs::write(&path, damaged).unwrap();
        let error = open("r2d2-1", Some(folder.path())).err().unwrap();
        assert!(
            matches!(error, OpenError::Weights(WeightsError::Checksum { .. })),
            "byte {position}: {error}"
        );
    }
}

#[test]
fn errors_name_the_file_and_how_to_get_it() {
    let folder = tempfile::tempdir().unwrap();
    let message = |name: &str, folder: &Path| open(name, Some(folder)).err().unwrap().to_string();
    for (name, file, command) in [
        ("xfeat-1", "xfeat.safetensors", "driftless weights xfeat"),
        ("r2d2-1", "r2d2-1.safetensors", "driftless weights r2d2"),
    ] {
        let path = folder.path().join(file);
        let missing = message(name, folder.path());
        assert!(missing.contains(path.to_str().unwrap()) && missing.contains(command), "{missing}");
        std::fs::write(&path, b"no weights").unwrap();
        let foreign = message(name, folder.path());
        assert!(foreign.contains(path.to_str().unwrap()) && foreign.contains(command), "{foreign}");
    }
    // A network of the user's with another checksum than when it was stored.
    std::fs::write(folder.path().join("r2d2-1.safetensors"), weights_file::write(&blobs())).unwrap();
    assert!(open("r2d2-1", Some(folder.path())).is_ok());
    std::fs::write(folder.path().join("r2d2-1.safetensors.sha256"), "00ff  r2d2-1.safetensors\n").unwrap();
    assert!(message("r2d2-1", folder.path()).contains("SHA-256"));
    assert!(matches!(open("superb-7", None), Err(OpenError::UnknownExtractor(name)) if name == "superb-7"));
}

#[test]
fn a_file_of_an_earlier_version_is_an_error_that_says_how_to_make_the_new_one() {
    let folder = tempfile::tempdir().unwrap();
    for (name, old, new, command) in [
        ("xfeat-1", "xfeat.pt", "xfeat.safetensors", "driftless weights xfeat"),
        ("r2d2-1", "r2d2-1.onnx", "r2d2-1.safetensors", "driftless weights r2d2 --from r2d2_WASF_N16.pt"),
    ] {
        std::fs::write(folder.path().join(old), b"old").unwrap();
        let message = open(name, Some(folder.path())).err().unwrap().to_string();
        assert!([old, new, command].iter().all(|part| message.contains(part)), "{message}");
    }
}
