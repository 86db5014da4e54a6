//! Files of weights that are damaged, foreign or hostile are errors.

use super::reference::Tensors;
use super::{engines, random_xfeat, state, torch_file};
use std::io::{Cursor, Write as _};
use std::path::Path;
use vision::features::neural::state_dict::{StateDict, StateDictError};
use vision::features::neural::{Network, write_xfeat};
use vision::features::{OpenError, open};
use zip::write::{SimpleFileOptions, ZipWriter};

fn small() -> Tensors {
    let tensor = |name: &str, shape: &[usize]| {
        let count: usize = shape.iter().product();
        (name.to_owned(), (shape.to_vec(), (0..count).map(|i| i as f32 * 0.5 - 1.0).collect()))
    };
    [tensor("a.weight", &[2, 3, 1, 1]), tensor("a.bias", &[2]), tensor("scalar", &[])].into()
}

#[test]
fn what_torch_writes_is_read_back() {
    let tensors = small();
    let read = StateDict::read(&torch_file::write(&tensors)).unwrap();
    for (name, (shape, data)) in &tensors {
        assert_eq!(read.get(name, shape).unwrap(), data, "{name}");
    }
    assert!(matches!(read.get("b", &[1]), Err(StateDictError::Missing(_))));
    assert!(matches!(read.get("a.bias", &[1, 2]), Err(StateDictError::Shape { .. })));
}

#[test]
fn a_file_cut_anywhere_is_an_error_and_flipped_bytes_never_give_other_numbers() {
    let bytes = torch_file::write(&small());
    for end in 0..bytes.len() {
        assert!(StateDict::read(&bytes[..end]).is_err(), "{end} of {} bytes", bytes.len());
    }
    let whole = StateDict::read(&bytes).unwrap();
    let mut errors = 0;
    for position in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[position] ^= 0x41;
        // What is not used (dates, flags) may change; the zip checksums guard the rest.
        match StateDict::read(&damaged) {
            Ok(read) => assert_eq!(read, whole, "byte {position}"),
            Err(_) => errors += 1,
        }
    }
    assert!(errors > bytes.len() / 2);
}

#[test]
fn tensors_beyond_their_storage_are_errors() {
    let tensors = small();
    let pickle = torch_file::table(&tensors);
    for storages in [vec![], vec![vec![0; 4]; 3], vec![vec![]; 3]] {
        assert!(StateDict::read(&torch_file::archive(&pickle, &storages)).is_err());
    }
    // A shape of 2^62 numbers whose count overflows, and one larger than any file.
    for shape in [vec![1 << 30, 1 << 30, 1 << 30], vec![1 << 30, 1]] {
        let huge: Tensors = [("a".to_owned(), (shape, vec![1.0; 4]))].into();
        assert!(matches!(StateDict::read(&torch_file::write(&huge)), Err(StateDictError::Tensor { .. })));
    }
}

#[test]
fn an_archive_that_unpacks_to_too_much_is_refused() {
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    let mut bomb = ZipWriter::new(Cursor::new(Vec::new()));
    bomb.start_file("archive/data.pkl", options).unwrap();
    for _ in 0..65 {
        bomb.write_all(&vec![b'N'; 1 << 20]).unwrap();
    }
    let bytes = bomb.finish().unwrap().into_inner();
    assert!(bytes.len() < 1 << 20);
    assert!(matches!(StateDict::read(&bytes), Err(StateDictError::TooLarge)));
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
        ("xfeat-1", "xfeat.pt", "driftless weights xfeat"),
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
