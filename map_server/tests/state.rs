//! Laws of the state of a server: what was acknowledged is there again, whatever ended the program.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use map_server::state::{MapVersion, ServerState, SledStore, StateError, StateStore};
use proptest::prelude::*;
use protocol::MapIdentity;

const CHILD_PATH: &str = "SERVER_STATE_TEST_CHILD";
/// Set to write the database of the present format again, for one that was not released.
const UPDATE: &str = "UPDATE";

fn identity(byte: u8) -> MapIdentity {
    MapIdentity::from_bytes([byte; 16])
}

fn version(map: u8, version: u64) -> MapVersion {
    MapVersion { identity: identity(map), version, digest: None }
}

/// Opens a database that another program has just let go of.
fn open(folder: &Path) -> SledStore {
    for _ in 0..500 {
        match SledStore::open(folder) {
            Ok(store) => return store,
            Err(_) => std::thread::sleep(Duration::from_millis(10)),
        }
    }
    SledStore::open(folder).unwrap()
}

/// Not a law by itself: what the child process of the next one does.
#[test]
fn child_that_notes() {
    let Ok(path) = std::env::var(CHILD_PATH) else { return };
    let state = ServerState::new(open(Path::new(&path)));
    let last = state.last_served("hall").unwrap().map_or(0, |served| served.version);
    for number in last + 1.. {
        state.note_served("hall", &version(1, number)).unwrap();
        println!("acknowledged {number}");
    }
}

#[test]
fn what_was_acknowledged_survives_a_kill() {
    let folder = tempfile::tempdir().unwrap();
    let mut newest = 0;
    for round in 0..10_u64 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["state::child_that_notes", "--exact", "--nocapture"])
            .env(CHILD_PATH, folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().unwrap()));
        let number =
            |line: std::io::Result<String>| line.unwrap().strip_prefix("acknowledged ")?.parse().ok();
        newest = lines.by_ref().find_map(number).unwrap();
        std::thread::sleep(Duration::from_millis(3 * round));
        child.kill().unwrap(); // SIGKILL
        child.wait().unwrap();
        newest = lines.filter_map(number).last().unwrap_or(newest);
        let state = ServerState::new(open(folder.path()));
        let found = state.last_served("hall").unwrap().unwrap();
        assert!([newest, newest + 1].contains(&found.version), "{found:?} after {newest}");
    }
    assert!(newest > 10, "{newest} in all");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_was_set_last_is_there_after_the_database_was_opened_again(
        steps in prop::collection::vec((0..4_u8, prop::collection::vec(any::<u8>(), 0..200), any::<bool>()), 1..30),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut store = open(folder.path());
        let mut model = BTreeMap::new();
        for (key, value, opens_again) in steps {
            let key = format!("key {key}");
            store.set(&key, &value).unwrap();
            model.insert(key, value);
            if opens_again {
                drop(store);
                store = open(folder.path());
            }
            for key in (0..5_u8).map(|key| format!("key {key}")) {
                prop_assert_eq!(store.get(&key).unwrap(), model.get(&key).cloned());
            }
        }
    }
}

#[test]
fn the_version_that_was_served_before_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let state = ServerState::new(open(folder.path()));
    assert_eq!(state.note_served("hall", &version(1, 3)).unwrap(), None);
    let same = state.note_served("hall", &version(1, 3)).unwrap().unwrap();
    assert_eq!((same.identity, same.version), (identity(1), 3));
    assert_eq!(state.note_served("hall", &version(2, 1)).unwrap().unwrap(), same);
    assert_eq!(state.last_served("hall").unwrap().unwrap().identity, identity(2));
    assert_eq!(state.last_served("yard").unwrap(), None);
    // Other contents are another version, whatever its number.
    let changed = MapVersion { digest: Some(identity(9)), ..version(2, 1) };
    state.note_served("hall", &changed).unwrap();
    assert_eq!(state.last_served("hall").unwrap().unwrap().map_version(), changed);
    // One folder, one server.
    let said = SledStore::open(folder.path()).err().unwrap().to_string();
    assert!(said.contains("--state"), "{said}");
}

#[test]
fn what_it_does_not_understand_is_refused_or_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    store.set("served/hall", b"version 7").unwrap();
    let state = ServerState::new(store);
    assert!(matches!(state.last_served("hall"), Err(StateError::Value { .. })));
    assert_eq!(state.note_served("hall", &version(1, 8)).unwrap(), None);
    assert_eq!(state.last_served("hall").unwrap().unwrap().version, 8);
    drop(state);
    open(folder.path()).set("schema", &9_u16.to_le_bytes()).unwrap();
    // Until the database that was just written is let go of.
    let mut refused = SledStore::open(folder.path()).err().unwrap();
    for _ in 0..500 {
        if matches!(refused, StateError::Schema { .. }) {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
        refused = SledStore::open(folder.path()).err().unwrap();
    }
    assert!(refused.to_string().contains("schema 1"), "{refused}");
}

#[test]
fn a_database_of_schema_1_is_read() {
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/state_1");
    if std::env::var_os(UPDATE).is_some() {
        let _ = std::fs::remove_dir_all(&kept);
        ServerState::new(open(&kept)).note_served("hall", &version(7, 5)).unwrap();
    }
    // sled writes to what it reads.
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("state");
    testing::copy_folder(&kept, &copy);
    let served = ServerState::new(open(&copy)).last_served("hall").unwrap().unwrap();
    assert_eq!((served.identity, served.version), (identity(7), 5));
    assert!(served.since_unix_s > 1_700_000_000);
}

#[test]
fn a_version_is_served_under_a_number_that_tells_it_from_the_one_before() {
    let of = |version: u64, contents: u8| MapVersion {
        identity: identity(1),
        version,
        digest: Some(identity(contents)),
    };
    let cases = [
        // The next version, an older one, the same one.
        (of(7, 2), of(6, 1), 7),
        (of(5, 2), of(6, 1), 5),
        (of(6, 1), of(6, 1), 6),
        // Of the same number, and other contents.
        (of(6, 2), of(6, 1), 7),
        // The same contents, which were served under the next number, or were written again.
        (of(6, 2), of(7, 2), 7),
        (of(8, 2), of(7, 2), 8),
        // Where contents are not known, or of another map, the number stays.
        (version(1, 6), of(6, 1), 6),
        (of(6, 2), version(1, 6), 6),
        (of(6, 2), MapVersion { identity: identity(3), ..of(6, 1) }, 6),
    ];
    for (new, served, number) in cases {
        assert_eq!(new.number_after(&served), number, "{new:?} after {served:?}");
    }
}
