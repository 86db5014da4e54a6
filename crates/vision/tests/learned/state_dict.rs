//! Files of weights that are damaged, foreign or hostile are errors.

use crate::reference::Tensors;
use crate::weights_file;
use vision::features::{StateDict, StateDictError};

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
