//! `driftless fleet`, as people type it.

use client::session::{Member, Role};
use std::path::Path;
use std::process::Command;

/// Runs `driftless fleet ...` in a folder.
fn fleet(folder: &Path, line: &str) -> Result<String, String> {
    let program = env!("CARGO_BIN_EXE_driftless");
    let output =
        Command::new(program).arg("fleet").args(line.split(' ')).current_dir(folder).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    if output.status.success() { Ok(text(&output.stdout)) } else { Err(text(&output.stderr)) }
}

fn certificate(folder: &Path, member: &str) -> String {
    std::fs::read_to_string(folder.join("fleet").join(member).join("certificate.pem")).unwrap()
}

#[test]
fn a_fleet_is_made_grows_and_is_renewed() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    let said =
        fleet(folder, "init fleet --servers s1 --robots r1,r2 --operators ann --map hall --router").unwrap();
    for words in ["robot", "r2", "operator", "ann", "--secure", "authority"] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let router = folder.join("fleet/router/zenoh.json5");
    let knows = |common_name: &str| std::fs::read_to_string(&router).unwrap().contains(common_name);
    assert!(knows("\"robot/r1\"") && knows("\"map_server/s1\"") && !knows("\"robot/r3\""));

    let said = fleet(folder, "add-robot fleet r3").unwrap();
    assert!(said.contains("router/zenoh.json5") && knows("\"robot/r3\""), "{said}");
    // An addition that was killed before the fleet had the member: the router knows it, and it is added again.
    let state = folder.join("fleet/authority/fleet.json");
    let before = std::fs::read(&state).unwrap();
    fleet(folder, "add-robot fleet r4").unwrap();
    std::fs::write(&state, before).unwrap();
    fleet(folder, "add-robot fleet r4").unwrap();
    assert!(knows("\"robot/r4\""));
    fleet(folder, "add-server fleet s2").unwrap();
    assert!(knows("\"map_server/s2\""));
    let member = Member::read(&folder.join("fleet/r3")).unwrap();
    assert_eq!(member, Member { name: "r3".to_owned(), role: Role::Robot });

    let (first, second) = (certificate(folder, "r1"), certificate(folder, "r2"));
    fleet(folder, "renew fleet r1").unwrap();
    assert_ne!(certificate(folder, "r1"), first);
    assert_eq!(certificate(folder, "r2"), second);
    // A configuration that is not that of the fleet is written anew.
    let config = std::fs::read_to_string(&router).unwrap();
    std::fs::write(&router, config.replace("robot/r4", "robot/none")).unwrap();
    fleet(folder, "renew fleet").unwrap();
    assert_ne!(certificate(folder, "r2"), second);
    assert_eq!(std::fs::read_to_string(&router).unwrap(), config);
    assert_keys_are_private(&folder.join("fleet"));
}

#[cfg(unix)]
fn assert_keys_are_private(folder: &Path) {
    use std::os::unix::fs::PermissionsExt as _;
    let members = ["authority", "router", "s1", "s2", "r1", "r2", "r3", "r4", "ann"];
    for member in members {
        let name = if member == "authority" { "ca-key.pem" } else { "key.pem" };
        let mode = std::fs::metadata(folder.join(member).join(name)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{member}");
        let left = std::fs::read_dir(folder.join(member)).unwrap().count();
        assert_eq!(left, if member == "authority" { 3 } else { 4 }, "{member}");
    }
}

#[cfg(not(unix))]
fn assert_keys_are_private(_folder: &Path) {}

#[test]
fn what_cannot_be_done_is_refused_in_words_and_nothing_is_overwritten() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    for (line, words) in [
        ("init a --servers s1,s1", "already"),
        ("init a --servers s1 --robots a/b", "a/b"),
        ("init a --servers authority", "authority"),
        ("init a --servers s1 --robots s1", "already"),
        ("init a --servers s1 --address 10.0.0.1:7447", "without port"),
        ("init a --servers s1 --namespace a/*", "a/*"),
        ("init a --robots r1", "--servers"),
        ("add-robot a r1", "driftless fleet init"),
        ("renew a", "driftless fleet init"),
    ] {
        let error = fleet(folder, line).expect_err(line);
        assert!(error.contains(words), "{line}: {error}");
        assert!(!folder.join("a").exists(), "{line}");
    }
    fleet(folder, "init fleet --servers s1 --robots r1").unwrap();
    let before = certificate(folder, "r1");
    for (line, words) in [
        ("init fleet --servers s1", "not overwritten"),
        ("add-robot fleet r1", "already"),
        ("add-server fleet s2", "--router"),
        ("renew fleet r9", "r9"),
    ] {
        let error = fleet(folder, line).expect_err(line);
        assert!(error.contains(words), "{line}: {error}");
    }
    assert_eq!(certificate(folder, "r1"), before);
}
