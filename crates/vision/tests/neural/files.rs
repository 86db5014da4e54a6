//! Files of weights that are damaged, foreign or hostile are errors.

use super::reference::Tensors;
use super::{engines, random_xfeat, state, weights_file};
use sha2::{Digest as _, Sha256};
use std::fmt::Write as _;
use std::path::Path;
use vision::features::neural::{Network, StateDict, StateDictError, WeightsError, write_xfeat};
use vision::features::weights::WeightsFile;
use vision::features::{OpenError, open};

fn small() -> Tensors {
    let tensor = |name: &str, shape: &[usize]| {
        let count: usize = shape.iter().product();
        (name.to_owned(), (shape.to_vec(), (0..count).map(|i| i as f32 * 0.5 - 1.0).collect()))
    };
    [tensor("a.weight", &[2, 3, 1, 1]), tensor("a.bias", &[2]), tensor("scalar", &[])].into()
}

#[test]
fn what_is_written_is_read_back() {
    let tensors = small();
    let read = StateDict::read(&weights_file::write(&tensors)).unwrap();
    for (name, (shape, data)) in &tensors {
        assert_eq!(read.get(name, shape).unwrap(), data, "{name}");
    }
    assert!(matches!(read.get("b", &[1]), Err(StateDictError::Missing(_))));
    assert!(matches!(read.get("a.bias", &[1, 2]), Err(StateDictError::Shape { .. })));
}

#[test]
fn a_file_cut_anywhere_is_an_error_and_a_flipped_byte_never_a_panic() {
    let bytes = weights_file::write(&small());
    for end in 0..bytes.len() {
        assert!(StateDict::read(&bytes[..end]).is_err(), "{end} of {} bytes", bytes.len());
    }
    let header_end = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let mut errors = 0;
    for position in 0..header_end {
        let mut damaged = bytes.clone();
        damaged[position] ^= 0x41;
        errors += usize::from(StateDict::read(&damaged).is_err());
    }
    // What is left are names, which the network misses, and the padding.
    assert!(errors > header_end / 2, "{errors} of {header_end}");
}

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
fn tensors_beyond_the_data_are_errors() {
    let header = |shape: &str, end: u64| {
        format!(r#"{{"a":{{"dtype":"F32","shape":[{shape}],"data_offsets":[0,{end}]}}}}"#)
    };
    let read = |header: &str| StateDict::read(&weights_file::assemble(header, &[0; 16]));
    assert!(read(&header("4", 16)).is_ok());
    // More or fewer numbers than the data, a shape whose size overflows, offsets beyond the file.
    for (shape, end) in [("5", 16), ("3", 16), ("2", 8), ("4", 20), ("5", 20), ("4611686018427387904,4", 16)]
    {
        let error = read(&header(shape, end)).err();
        assert!(matches!(error, Some(StateDictError::Format(_))), "{shape} {end}: {error:?}");
    }
}

#[test]
fn a_header_longer_than_the_file_is_refused_without_memory_for_it() {
    for length in [u64::MAX, 1 << 62, 1 << 40, 90 << 20, 17] {
        let bytes = [&length.to_le_bytes()[..], &[b' '; 16]].concat();
        assert!(matches!(StateDict::read(&bytes), Err(StateDictError::Format(_))), "{length}");
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
