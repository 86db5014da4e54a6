//! Files of weights that are damaged, foreign or hostile are errors.

use super::{engines, random_xfeat, state};
use sha2::{Digest as _, Sha256};
use std::fmt::Write as _;
use std::path::Path;
use vision::features::neural::{Network, WeightsError, write_xfeat};
use vision::features::weights::WeightsFile;
use vision::features::{OpenError, StateDictError, open};

#[test]
fn a_flipped_byte_of_a_stored_file_is_refused_by_its_checksum() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r2d2-1.onnx");
    let onnx = super::extractors::blob_network();
    let mut checksum = String::new();
    for byte in Sha256::digest(&onnx) {
        write!(checksum, "{byte:02x}").unwrap();
    }
    std::fs::write(WeightsFile::checksum_path(&path), format!("{checksum}  r2d2-1.onnx\n")).unwrap();
    std::fs::write(&path, &onnx).unwrap();
    assert!(open("r2d2-1", Some(folder.path())).is_ok());
    for position in (0..onnx.len()).step_by(97) {
        let mut damaged = onnx.clone();
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
fn a_network_needs_every_tensor_in_its_shape_and_finite() {
    let tensors = random_xfeat(1);
    for name in
        ["skip1.1.bias", "block5.3.layer.0.weight", "keypoint_head.3.bias", "block2.1.layer.1.running_var"]
    {
        let mut missing = tensors.clone();
        missing.remove(name);
        assert!(matches!(write_xfeat(&state(&missing)), Err(StateDictError::Missing(what)) if what == name));
        let mut wrong = tensors.clone();
        let (shape, data) = wrong.get_mut(name).unwrap();
        shape[0] -= 1;
        data.truncate(shape.iter().product());
        assert!(
            matches!(write_xfeat(&state(&wrong)), Err(StateDictError::Shape { name: what, .. }) if what == name)
        );
        let mut infinite = tensors.clone();
        infinite.get_mut(name).unwrap().1[0] = f32::NAN;
        assert!(
            matches!(write_xfeat(&state(&infinite)), Err(StateDictError::NotFinite(what)) if what == name)
        );
    }
    let mut negative = tensors;
    negative.get_mut("block2.1.layer.1.running_var").unwrap().1[3] = -1.0;
    assert!(matches!(write_xfeat(&state(&negative)), Err(StateDictError::NotFinite(_))));
}

#[test]
fn a_damaged_network_is_an_error_or_runs_but_never_a_panic() {
    let onnx = super::extractors::blob_network();
    for engine in engines() {
        for end in (0..onnx.len()).step_by(97) {
            let _ = Network::load(onnx[..end].to_vec(), "image", &["descriptors"], engine);
        }
        let mut refused = 0;
        for position in 0..200.min(onnx.len()) {
            let mut damaged = onnx.clone();
            damaged[position] ^= 0x2a;
            match Network::load(damaged, "image", &["descriptors"], engine) {
                Ok(mut network) => {
                    let _ = network.run([1, 3, 32, 32], vec![0.5; 3 * 32 * 32]);
                }
                Err(_) => refused += 1,
            }
        }
        assert!(refused > 10, "{engine:?}");
    }
}

#[test]
fn errors_name_the_file_and_how_to_get_it() {
    let folder = tempfile::tempdir().unwrap();
    let message = |name: &str, folder: &Path| open(name, Some(folder)).err().unwrap().to_string();
    for (name, file, command) in [
        ("xfeat-1", "xfeat.safetensors", "driftless weights xfeat"),
        ("r2d2-1", "r2d2-1.onnx", "driftless weights r2d2"),
    ] {
        let path = folder.path().join(file);
        let missing = message(name, folder.path());
        assert!(missing.contains(path.to_str().unwrap()) && missing.contains(command), "{missing}");
        std::fs::write(&path, b"no weights").unwrap();
        let foreign = message(name, folder.path());
        assert!(foreign.contains(path.to_str().unwrap()) && foreign.contains(command), "{foreign}");
    }
    // A network of the user's with another checksum than when it was stored.
    std::fs::write(folder.path().join("r2d2-1.onnx"), super::extractors::blob_network()).unwrap();
    assert!(open("r2d2-1", Some(folder.path())).is_ok());
    std::fs::write(folder.path().join("r2d2-1.onnx.sha256"), "00ff  r2d2-1.onnx\n").unwrap();
    assert!(message("r2d2-1", folder.path()).contains("SHA-256"));
    assert!(matches!(open("superb-7", None), Err(OpenError::UnknownExtractor(name)) if name == "superb-7"));
}

#[test]
fn a_torch_file_of_an_earlier_version_is_an_error_that_says_how_to_convert_it() {
    let folder = tempfile::tempdir().unwrap();
    let old = folder.path().join("xfeat.pt");
    std::fs::write(&old, b"torch").unwrap();
    let message = open("xfeat-1", Some(folder.path())).err().unwrap().to_string();
    let command = format!("driftless weights xfeat --from {}", old.display());
    assert!(message.contains("xfeat.safetensors") && message.contains(&command), "{message}");
}
