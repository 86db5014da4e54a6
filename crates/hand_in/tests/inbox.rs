//! Laws of the inbox.

use crate::example_session::{chunk, header, write};
use hand_in::inbox::{digest_of, is_in_inbox};
use hand_in::{HandInError, Inbox, InboxError, InboxSettings, Session, SessionWriter};
use proptest::prelude::*;
use protocol::SessionPart;
use signing::SecretKey;
use std::path::{Path, PathBuf};

const PART: usize = 4000;

fn settings(folder: &Path) -> InboxSettings {
    InboxSettings { folder: folder.join("inbox"), bytes_of_robot: 1 << 30, bytes_in_all: 1 << 30, keys: None }
}

fn session(folder: &Path, seconds: i64) -> Vec<u8> {
    let path = folder.join(format!("{seconds}.session"));
    write(&path, seconds);
    std::fs::read(&path).unwrap()
}

fn part(bytes: &[u8], offset: u64, length: usize) -> SessionPart {
    let from = (offset as usize).min(bytes.len());
    SessionPart {
        total_bytes: bytes.len() as u64,
        digest: digest_of(bytes),
        offset,
        bytes: bytes[from..(from + length).min(bytes.len())].to_vec(),
    }
}

/// Hands a file in from where the inbox has it.
fn hand_in(inbox: &mut Inbox, robot: &str, bytes: &[u8]) -> Result<(), InboxError> {
    let mut received = inbox.take(robot, &part(bytes, 0, 0))?;
    for _ in 0..10 * bytes.len().div_ceil(PART) {
        if received.is_complete {
            return Ok(());
        }
        received = inbox.take(robot, &part(bytes, received.bytes, PART))?;
    }
    panic!("it does not end");
}

/// All files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else if path.extension().is_some() {
            found.push(path);
        }
    }
    found
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// The server is killed after any part, and its file is as long as the disk has it by then; parts come twice, and out of order.
    #[test]
    fn a_session_is_whole_however_its_parts_come_and_whatever_a_killed_server_has(
        kills in prop::collection::vec((0..8_usize, 0..5000_u64, any::<bool>()), 0..4),
        strays in prop::collection::vec(0..60_000_u64, 0..4),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let bytes = session(folder.path(), 4);
        for (parts, lost, is_torn) in kills {
            let mut inbox = Inbox::open(settings(folder.path())).unwrap();
            let mut received = inbox.take("ada", &part(&bytes, 0, 0)).unwrap();
            for _ in 0..parts {
                for &stray in &strays {
                    inbox.take("ada", &part(&bytes, stray, PART)).ok();
                }
                received = inbox.take("ada", &part(&bytes, received.bytes, PART)).unwrap();
            }
            for path in files(folder.path().join("inbox").as_path()) {
                if path.extension().is_some_and(|of| of == "part") {
                    let length = path.metadata().unwrap().len();
                    let file = std::fs::File::options().write(true).open(&path).unwrap();
                    file.set_len(length.saturating_sub(lost)).unwrap();
                    if is_torn {
                        // The length is on the disk, the bytes are not.
                        file.set_len(length).unwrap();
                    }
                }
            }
        }
        let mut inbox = Inbox::open(settings(folder.path())).unwrap();
        hand_in(&mut inbox, "ada", &bytes).unwrap();
        let found = files(folder.path().join("inbox").as_path());
        prop_assert_eq!(found.len(), 1);
        prop_assert_eq!(std::fs::read(&found[0]).unwrap(), &bytes[..]);
        prop_assert_eq!(found[0].extension().unwrap(), "session");
        // Again: nothing is written.
        let again = inbox.take("ada", &part(&bytes, 0, PART)).unwrap();
        prop_assert!(again.is_complete);
        prop_assert_eq!(files(folder.path().join("inbox").as_path()), found);
    }
}

#[test]
fn the_place_of_a_session_in_an_inbox_is_known_from_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = session(folder.path(), 2);
    let mut inbox = Inbox::open(settings(folder.path())).unwrap();
    hand_in(&mut inbox, "ada", &bytes).unwrap();
    let taken = &files(folder.path().join("inbox").as_path())[0];
    assert!(is_in_inbox(taken, "ada", &bytes));
    assert!(!is_in_inbox(taken, "bob", &bytes) && !is_in_inbox(taken, "ada", &bytes[1..]));
    assert!(!is_in_inbox(&folder.path().join("2.session"), "ada", &bytes));
    // A copy under that name in another folder is none of an inbox.
    let copy = folder.path().join(taken.file_name().unwrap());
    std::fs::copy(taken, &copy).unwrap();
    assert!(!is_in_inbox(&copy, "ada", &bytes));
}

/// A server that is killed, or cannot read its disk, between the last part and the name of the session.
#[test]
fn a_session_that_had_come_as_a_whole_when_its_server_was_killed_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = session(folder.path(), 2);
    let mut inbox = Inbox::open(settings(folder.path())).unwrap();
    let all_but_one = bytes.len() - 1;
    assert!(!inbox.take("ada", &part(&bytes, 0, all_but_one)).unwrap().is_complete);
    let begun = files(folder.path().join("inbox").as_path());
    for content in [bytes.clone(), vec![7; bytes.len()]] {
        std::fs::write(&begun[0], content).unwrap();
        hand_in(&mut inbox, "ada", &bytes).unwrap();
        let taken = files(folder.path().join("inbox").as_path());
        assert_eq!(std::fs::read(&taken[0]).unwrap(), bytes);
        std::fs::remove_file(&taken[0]).unwrap();
    }
}

#[test]
fn what_is_no_session_or_of_another_robot_is_refused_and_removed() {
    let folder = tempfile::tempdir().unwrap();
    let mut inbox = Inbox::open(settings(folder.path())).unwrap();
    let bytes = session(folder.path(), 2);
    let other = hand_in(&mut inbox, "bob", &bytes).unwrap_err();
    assert!(matches!(other, InboxError::OtherRobot { .. }), "{other}");
    let none = hand_in(&mut inbox, "ada", &vec![7; 9000]).unwrap_err();
    assert!(matches!(none, InboxError::Session(HandInError::OtherFormat { .. })), "{none}");
    for name in ["", "..", ".hidden", "a/b", "*"] {
        assert!(matches!(hand_in(&mut inbox, name, &bytes), Err(InboxError::Invalid(_))), "{name}");
    }
    assert_eq!(files(folder.path().join("inbox").as_path()), Vec::<PathBuf>::new());
    // Nor do names stay.
    let folders = std::fs::read_dir(folder.path().join("inbox")).unwrap();
    assert_eq!(folders.filter(|entry| entry.as_ref().unwrap().path().is_dir()).count(), 0);
}

#[test]
fn robots_have_their_limits_and_all_together_have_one() {
    let folder = tempfile::tempdir().unwrap();
    let [small, large] = [1, 2].map(|seconds| session(folder.path(), seconds));
    let of_robot = small.len() as u64 + large.len() as u64 - 1;
    let mut inbox =
        Inbox::open(InboxSettings { bytes_of_robot: of_robot, ..settings(folder.path()) }).unwrap();
    hand_in(&mut inbox, "ada", &small).unwrap();
    let error = hand_in(&mut inbox, "ada", &large).unwrap_err();
    assert!(error.to_string().contains("--inbox-robot-limit"), "{error}");
    let second = Inbox::open(settings(folder.path())).unwrap_err();
    assert!(matches!(second, InboxError::InUse { .. }), "{second}");
    drop(inbox);
    let mut inbox = Inbox::open(InboxSettings { bytes_in_all: of_robot, ..settings(folder.path()) }).unwrap();
    let error = hand_in(&mut inbox, "bob", &large).unwrap_err();
    assert!(error.to_string().contains("--inbox-limit"), "{error}");
    drop(inbox);
    // What is announced counts, not what has come.
    let announced = SessionPart { total_bytes: 200 << 20, ..part(&large, 0, PART) };
    let mut inbox =
        Inbox::open(InboxSettings { bytes_of_robot: 300 << 20, ..settings(folder.path()) }).unwrap();
    inbox.take("ada", &announced).unwrap();
    let second = SessionPart { total_bytes: 201 << 20, ..announced };
    assert!(matches!(inbox.take("ada", &second), Err(InboxError::Full { .. })));
}

#[test]
fn files_that_were_begun_and_never_ended_do_not_pile_up() {
    let folder = tempfile::tempdir().unwrap();
    let mut inbox = Inbox::open(settings(folder.path())).unwrap();
    let bytes = session(folder.path(), 1);
    for total_bytes in 20_000..20_050 {
        let begun = SessionPart { total_bytes, ..part(&bytes, 0, PART) };
        assert_eq!(inbox.take("ada", &begun).unwrap().bytes, PART as u64);
    }
    assert!(files(folder.path().join("inbox").as_path()).len() <= 4);
}

#[test]
fn files_that_nobody_goes_on_with_keep_no_room_for_ever() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = session(folder.path(), 1);
    let settings = InboxSettings { bytes_in_all: 30_000, ..settings(folder.path()) };
    let mut inbox = Inbox::open(settings).unwrap();
    let begun = |total_bytes: u64| SessionPart { total_bytes, ..part(&bytes, 0, 400) };
    inbox.take("ada", &begun(20_000)).unwrap();
    let full = inbox.take("bob", &begun(20_001)).unwrap_err();
    assert!(matches!(full, InboxError::Full { used: 40_001, unfinished: 20_000, .. }), "{full}");
    assert!(full.to_string().contains("20000 of them for files that have only begun"), "{full}");
    let path = &files(&folder.path().join("inbox"))[0];
    let week_ago = std::time::SystemTime::now() - std::time::Duration::from_hours(8 * 24);
    std::fs::File::options().write(true).open(path).unwrap().set_modified(week_ago).unwrap();
    inbox.take("bob", &begun(20_001)).unwrap();
    assert!(!path.exists());
}

#[test]
fn a_session_without_a_whole_chunk_has_nothing_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty");
    drop(SessionWriter::create(&path, &header()).unwrap());
    let mut inbox = Inbox::open(settings(folder.path())).unwrap();
    let refused = hand_in(&mut inbox, "ada", &std::fs::read(&path).unwrap()).unwrap_err();
    assert!(matches!(refused, InboxError::Session(HandInError::NothingRecorded { .. })), "{refused}");
}

#[test]
fn signed_sessions_are_those_of_the_key_and_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let keys = folder.path().join("keys");
    std::fs::create_dir(&keys).unwrap();
    for name in ["ada", "eve"] {
        let public = SecretKey::generate(&folder.path().join(name)).unwrap();
        std::fs::copy(public, keys.join(format!("{name}.pub"))).unwrap();
    }
    let key = |name: &str| SecretKey::read(&folder.path().join(name), None).unwrap();
    let made = |name: &str, signer: Option<&str>| {
        let path = folder.path().join(name);
        let mut writer = SessionWriter::create(&path, &header()).unwrap();
        writer.append(&chunk(0)).unwrap();
        writer.finish().unwrap();
        // What was being written when the robot was stopped.
        std::fs::File::options()
            .append(true)
            .open(&path)
            .unwrap()
            .set_len(path.metadata().unwrap().len() + 5)
            .unwrap();
        if let Some(signer) = signer {
            hand_in::sign(&path, &key(signer)).unwrap();
            let once = std::fs::read(&path).unwrap();
            hand_in::sign(&path, &key(signer)).unwrap();
            assert_eq!(std::fs::read(&path).unwrap(), once, "it was signed twice");
            let session = Session::open(&path).unwrap();
            assert!(session.signature.is_some() && session.is_ended && session.frames.len() == 5);
        }
        std::fs::read(&path).unwrap()
    };
    let mut inbox =
        Inbox::open(InboxSettings { keys: Some(keys.clone()), ..settings(folder.path()) }).unwrap();
    let unsigned = hand_in(&mut inbox, "ada", &made("unsigned", None)).unwrap_err();
    assert!(unsigned.to_string().contains("no signature"), "{unsigned}");
    let of_other = hand_in(&mut inbox, "ada", &made("of_eve", Some("eve"))).unwrap_err();
    assert!(matches!(of_other, InboxError::Session(HandInError::Signature { .. })), "{of_other}");
    let signed = made("signed", Some("ada"));
    let longer = [&signed[..], &[0]].concat();
    assert!(hand_in(&mut inbox, "ada", &longer).is_err());
    hand_in(&mut inbox, "ada", &signed).unwrap();
    std::fs::remove_file(keys.join("ada.pub")).unwrap();
    let mut changed = signed;
    changed.pop();
    let keyless = hand_in(&mut inbox, "ada", &changed).unwrap_err();
    assert!(matches!(keyless, InboxError::Key { .. }), "{keyless}");
    // Nor is anything kept for it.
    let begun = inbox.take("ada", &SessionPart { total_bytes: 20_000, ..part(&changed, 0, PART) });
    assert!(matches!(begun, Err(InboxError::Key { .. })), "{begun:?}");
    assert_eq!(files(&folder.path().join("inbox")).len(), 1);
}
