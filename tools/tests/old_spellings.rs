//! Spellings that are gone, as a program: one line that says the present one.

use std::process::Command;

#[test]
fn an_old_spelling_ends_with_one_line_and_exit_code_2() {
    let folder = tempfile::tempdir().unwrap();
    for (old, present) in [
        ("run --sequence place/live --map place.db --out out", "driftless run REC"),
        ("run --map place.db --out out --sequence=place/live", "driftless run REC"),
        ("inspect query.png --map room.db --sequence place/map", "--recording MAP_REC"),
        ("map-info place.db", "driftless map-info --map place.db"),
        ("view place.db --open", "driftless view --map place.db"),
        ("run REC --settings filter.yaml --out out", "--settings: the switch is --estimator-config"),
        ("build-map REC --map room.db --picture map.svg", "--picture: the switch is --svg"),
        ("build-map REC --map room.db --keep-poses", "--keep-poses: the switch is --no-refine-poses"),
        ("localize --config=zenoh.json5 --image query.png", "--config: the switch is --zenoh-config"),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_driftless"));
        let output = command.args(old.split(' ')).current_dir(folder.path()).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains(present), "{old}: {said}");
        assert_eq!((output.status.code(), said.lines().count()), (Some(2), 1), "{old}: {said}");
        assert!(output.stdout.is_empty(), "{old}");
    }
}
