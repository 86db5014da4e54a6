//! Files that announce much in few bytes: they are refused, and what ends the program in a check is not tried again.

use crate::example_session::{block, header};
use hand_in::inbox::digest_of;
use hand_in::{
    ChunkError, HandInError, Inbox, InboxError, InboxSettings, MAX_MEMORY_PER_BYTE, Session, SessionWriter,
};
use protocol::SessionPart;
use signing::SecretKey;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Says to a test in a program of its own where its inbox is.
const INBOX: &str = "DRIFTLESS_TEST_INBOX";
/// Nanoseconds from image to image, one byte each: with two more, an image takes 56 bytes of memory.
const STEP_NS: u64 = 100;

fn unsigned(mut value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}

/// A file whose chunks have images of a few bytes each: a time step, and what is in `rest`.
fn session_of_images(folder: &Path, chunks: usize, images: u64, step_ns: u64, rest: &[u8]) -> Vec<u8> {
    let path = folder.join("images.session");
    SessionWriter::create(&path, &header()).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    std::fs::remove_file(path).unwrap();
    let name = "n".repeat(256);
    for chunk in 0..chunks {
        // The identity, no readings, an extractor with a long name.
        let mut payload = [&[0; 16][..], &[0, 0, 1, 1, 0], &[0], &[1, 1]].concat();
        payload.extend(unsigned(name.len() as u64));
        payload.extend(name.as_bytes());
        payload.extend(unsigned(images));
        // The first time of a chunk is signed.
        payload.extend(unsigned(2 * chunk as u64 * images * step_ns));
        payload.extend(rest);
        let image = [&unsigned(step_ns)[..], rest].concat();
        (1..images).for_each(|_| payload.extend(&image));
        payload.push(0);
        bytes.extend(block(2, &payload));
    }
    bytes
}

fn settings(folder: &Path, keys: Option<PathBuf>) -> InboxSettings {
    InboxSettings { folder: folder.to_owned(), bytes_of_robot: 1 << 30, bytes_in_all: 1 << 30, keys }
}

fn hand_in(inbox: &mut Inbox, bytes: &[u8]) -> Result<bool, InboxError> {
    let (total_bytes, digest) = (bytes.len() as u64, digest_of(bytes));
    for (at, part) in bytes.chunks(64 << 10).enumerate() {
        let part = SessionPart { total_bytes, digest, offset: (at << 16) as u64, bytes: part.to_vec() };
        if inbox.take("ada", &part)?.is_complete {
            return Ok(true);
        }
    }
    Ok(false)
}

#[test]
fn a_file_that_unpacks_to_much_more_than_its_size_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    // No points and a set of no features: three bytes, which take a hundred times as many.
    let bytes = session_of_images(folder.path(), 1, 1 << 20, 1, &[0, 1]);
    let error = Session::of_bytes(Path::new("a.session"), &bytes).unwrap_err();
    let HandInError::Chunk { source: ChunkError::Memory { most }, .. } = error else { panic!("{error}") };
    assert!(most < MAX_MEMORY_PER_BYTE * bytes.len() as u64);
    let mut inbox = Inbox::open(settings(&folder.path().join("inbox"), None)).unwrap();
    let error = hand_in(&mut inbox, &bytes).unwrap_err();
    assert!(error.to_string().contains("bytes of memory, 20 for each of its own"), "{error}");
}

#[test]
fn a_robot_in_the_dark_is_not_refused() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = session_of_images(folder.path(), 3, 1000, STEP_NS, &[0, 0]);
    assert_eq!(Session::of_bytes(Path::new("a.session"), &bytes).unwrap().frames.len(), 3000);
}

#[test]
fn nothing_is_decoded_before_the_signature_is_verified() {
    let folder = tempfile::tempdir().unwrap();
    let keys = folder.path().join("keys");
    std::fs::create_dir(&keys).unwrap();
    let public = SecretKey::generate(&folder.path().join("ada")).unwrap();
    std::fs::copy(public, keys.join("ada.pub")).unwrap();
    let mut inbox = Inbox::open(settings(&folder.path().join("inbox"), Some(keys))).unwrap();
    for bytes in [
        session_of_images(folder.path(), 1, 1000, 1, &[0, 1]),
        [&session_of_images(folder.path(), 0, 0, 1, &[])[..], &block(9, b"no such kind")].concat(),
    ] {
        let error = hand_in(&mut inbox, &bytes).unwrap_err();
        assert!(error.to_string().contains("no signature"), "{error}");
    }
}

/// Takes a file that was received as a whole, with too little memory to decode it.
#[test]
#[ignore = "run by a_file_whose_check_ended_the_program_is_removed_at_the_next_start"]
fn checks_with_little_memory() {
    let Some(folder) = std::env::var_os(INBOX).map(PathBuf::from) else { return };
    let bytes = std::fs::read(folder.with_extension("session")).unwrap();
    let part = SessionPart {
        total_bytes: bytes.len() as u64,
        digest: digest_of(&bytes),
        offset: bytes.len() as u64,
        bytes: Vec::new(),
    };
    let mut inbox = Inbox::open(settings(&folder, None)).unwrap();
    assert!(inbox.take("ada", &part).unwrap().is_complete);
}

#[test]
#[cfg(target_os = "linux")]
fn a_file_whose_check_ended_the_program_is_removed_at_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("inbox");
    // 12 MB whose images take 235 MB, within the limits.
    let bytes = session_of_images(folder.path(), 1, 4_200_000, STEP_NS, &[0, 0]);
    std::fs::write(folder.path().join("inbox.session"), &bytes).unwrap();
    let of_robot = root.join("ada");
    std::fs::create_dir_all(&of_robot).unwrap();
    let name = format!("{}_{}.part", types::hexadecimal::encode(&digest_of(&bytes)), bytes.len());
    let received = of_robot.join(name);
    let run = |kilobytes: u32| {
        let test = std::env::current_exe().unwrap();
        let script =
            format!("ulimit -v {kilobytes} && exec \"$0\" --exact \"$1\" --ignored --test-threads 1");
        let mut command = Command::new("sh");
        command.args(["-c", &script]).arg(test).arg("memory::checks_with_little_memory");
        command.env(INBOX, &root).output().unwrap()
    };
    let files = || -> Vec<PathBuf> {
        let entries = std::fs::read_dir(&of_robot).into_iter().flatten();
        entries.map(|entry| entry.unwrap().path()).collect()
    };
    std::fs::write(&received, &bytes).unwrap();
    let killed = run(220_000);
    assert!(!killed.status.success(), "{killed:?}");
    assert!(String::from_utf8_lossy(&killed.stderr).contains("memory allocation of"), "{killed:?}");
    assert_eq!(files().len(), 1, "nothing was received");
    drop(Inbox::open(settings(&root, None)).unwrap());
    assert_eq!(files(), Vec::<PathBuf>::new());
    // With enough memory it is a session.
    std::fs::write(&received, &bytes).unwrap();
    let taken = run(2_000_000);
    assert!(taken.status.success(), "{taken:?}");
    assert!(files()[0].extension().is_some_and(|of| of == "session"));
}
