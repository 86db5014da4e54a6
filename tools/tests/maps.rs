//! The commands about maps, run as programs.

use std::path::Path;

use map_io::text::write_map;
use testing::{Place, PlaceOptions};

use crate::program::{complaint_of, driftless, json_of, text};

fn text_map(folder: &Path, seed: u64) {
    let options = PlaceOptions { seed, keyframes: 5, landmarks: 100, ..PlaceOptions::default() };
    write_map(folder, &Place::new(&options).map).unwrap();
}

#[test]
fn two_imports_of_different_maps_are_both_version_1_and_have_different_identities() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = [1, 2].map(|seed| {
        let (from, to) =
            (folder.path().join(format!("text_{seed}")), folder.path().join(format!("{seed}.db")));
        text_map(&from, seed);
        let imported = json_of(&["import-map", text(&from), "--map", text(&to)]);
        let info = json_of(&["map-info", "--map", text(&to)]);
        assert_eq!((&imported["version"], &imported["identity"]), (&info["version"], &info["identity"]));
        assert_eq!((&info["version"], &info["schema"]), (&1.into(), &map::STORE_SCHEMA.into()));
        info["identity"].as_str().unwrap().to_owned()
    });
    assert!(one != two && one.len() == 32, "{one} {two}");
    // A map that replaces another is its next version.
    let (from, to) = (folder.path().join("text_2"), folder.path().join("1.db"));
    let replaced = json_of(&["import-map", text(&from), "--map", text(&to), "--force"]);
    assert_eq!((&replaced["version"], &replaced["identity"]), (&2.into(), &one.as_str().into()));
    let shown = driftless(&["map-info", "--map", text(&to)]);
    let shown = String::from_utf8(shown.stdout).unwrap();
    assert!(shown.contains(&format!("identity               {one}")), "{shown}");
    assert!(shown.contains("sigma per axis, deg"), "{shown}");
}

#[test]
fn damaged_and_unfinished_maps_are_refused_in_words_and_made_anew() {
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (folder.path().join("text"), folder.path().join("hall.db"));
    text_map(&from, 1);
    let import = ["import-map", text(&from), "--map", text(&to)];
    json_of(&import);
    let again = complaint_of(&import);
    assert!(again.contains("hall.db exists already") && again.contains("--force"), "{again}");

    let database = to.join("version-1.segments");
    let mut bytes = std::fs::read(&database).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    std::fs::write(&database, bytes).unwrap();
    let exported = folder.path().join("exported");
    for command in [
        vec!["map-info", "--map", text(&to)],
        vec!["export-map", "--map", text(&to), "--to", text(&exported)],
    ] {
        let said = complaint_of(&command);
        assert!(said.contains("version-1.segments") && said.contains("backup"), "{said}");
        assert!(!said.contains("panicked"), "{said}");
    }
    assert!(!exported.exists());
    json_of(&[&import[..], &["--force"]].concat());

    std::fs::remove_file(to.join("manifest.json")).unwrap();
    let said = complaint_of(&["map-info", "--map", text(&to)]);
    assert!(said.contains("hall.db is unfinished"), "{said}");
    assert_eq!(json_of(&import)["version"], 1);
}

#[test]
fn a_position_beyond_the_bound_is_refused_with_its_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (folder.path().join("text"), folder.path().join("hall.db"));
    text_map(&from, 1);
    let landmarks = from.join("landmarks.csv");
    let mut lines = std::fs::read_to_string(&landmarks).unwrap();
    lines.push_str("99999,10,1e300,0,1\n");
    std::fs::write(&landmarks, lines).unwrap();
    let said = complaint_of(&["import-map", text(&from), "--map", text(&to)]);
    assert!(said.contains("landmarks.csv, line ") && said.contains("1e300"), "{said}");
    assert!(!to.exists());
}

#[test]
fn an_edited_map_is_the_next_version_without_what_was_taken_out() {
    let folder = tempfile::tempdir().unwrap();
    let (from, map, other) =
        (folder.path().join("text"), folder.path().join("place.db"), folder.path().join("other.db"));
    text_map(&from, 3);
    json_of(&["import-map", text(&from), "--map", text(&map)]);
    let dry = json_of(&["edit-map", "--map", text(&map), "--remove", "11,13-14", "--dry-run"]);
    assert_eq!((&dry["before"]["keyframes"], &dry["after"]["keyframes"]), (&5.into(), &2.into()));
    assert!(dry["version"].is_null());
    assert_eq!(json_of(&["map-info", "--map", text(&map)])["version"], 1);
    json_of(&["edit-map", "--map", text(&map), "--remove", "10", "--to", text(&other)]);
    assert_eq!(json_of(&["map-info", "--map", text(&other)])["keyframes"], 4);
    let edited = json_of(&["edit-map", "--map", text(&map), "--remove", "11,13-14"]);
    assert_eq!(edited["version"], 2);
    let info = json_of(&["map-info", "--map", text(&map)]);
    assert_eq!((&info["version"], &info["keyframes"]), (&2.into(), &2.into()));

    let none = complaint_of(&["edit-map", "--map", text(&map), "--remove", "9"]);
    assert!(none.contains("no keyframe 9"), "{none}");
    let all = complaint_of(&["edit-map", "--map", text(&map), "--remove-box=-1e6,-1e6,-1e6,1e6,1e6,1e6"]);
    assert!(all.contains("no keyframe would be left"), "{all}");
    let nothing = complaint_of(&["edit-map", "--map", text(&map), "--remove-time", "-5,-3"]);
    assert!(nothing.contains("--remove-time: no keyframe was taken then"), "{nothing}");
    let edit = ["edit-map", "--map", text(&map), "--remove", "10"];
    for (switch, said) in [
        ("--remove-box=1e5,1e5,1e5,1e6,1e6,1e6", "--remove-box: no keyframe is in that box"),
        ("--crop-landmarks=-1e6,-1e6,-1e6,1e6,1e6,1e6", "--crop-landmarks: every landmark is in that box"),
        ("--crop-landmarks=1e5,1e5,1e5,1e6,1e6,1e6", "no landmark would be left"),
        ("--drop-images", "--drop-images: the map has no images"),
    ] {
        let refused = complaint_of(&[&edit[..], &[switch]].concat());
        assert!(refused.contains(said), "{switch}: {refused}");
    }
    assert_eq!(json_of(&["map-info", "--map", text(&map)])["version"], 2);
    let odd = complaint_of(&["edit-map", "--map", text(&map), "--remove", "5-2"]);
    assert!(odd.contains("3,17,20-35"), "{odd}");
}

#[cfg(feature = "releases")]
#[test]
fn a_candidate_is_proposed_compared_promoted_and_listed() {
    let folder = tempfile::tempdir().unwrap();
    let (from, map, city) =
        (folder.path().join("text"), folder.path().join("place.db"), folder.path().join("city"));
    text_map(&from, 3);
    json_of(&["import-map", text(&from), "--map", text(&map)]);
    let publish = ["publish-map", "--map", text(&map), "--to", text(&city)];
    json_of(&publish);
    json_of(&["edit-map", "--map", text(&map), "--remove", "11"]);
    let note = ["--author", "ada", "--comment", "rack moved"];
    let proposed = json_of(&[&publish[..], &["--stage", "candidate"], &note].concat());
    assert_eq!(
        (&proposed["release"]["stage"], &proposed["release"]["candidate"]),
        (&"candidate".into(), &1.into())
    );
    let difference = json_of(&["diff-releases", text(&city), "live", "candidate"]);
    assert_eq!(difference["map"]["keyframes"]["removed"], 1);
    let shown = driftless(&["diff-releases", text(&city), "1", "candidate-1"]);
    let shown = String::from_utf8(shown.stdout).unwrap();
    assert!(shown.contains("release 1 to candidate 1") && shown.contains("by place"), "{shown}");

    let list = || String::from_utf8(driftless(&["list-releases", text(&city)]).stdout).unwrap();
    assert!(
        list().contains("for release 2: open") && list().contains("published by ada: rack moved"),
        "{}",
        list()
    );
    let promoted = json_of(&["promote-release", text(&city), "--author", "bob"]);
    assert_eq!((&promoted["release"]["number"], &promoted["release"]["stage"]), (&2.into(), &"live".into()));
    assert!(list().contains("was candidate 1") && list().contains("promoted by bob"), "{}", list());
    let none = complaint_of(&["reject-release", text(&city)]);
    assert!(none.contains("has no candidate"), "{none}");
    let late = complaint_of(&["reject-release", text(&city), "1"]);
    assert!(late.contains("promoted before by bob"), "{late}");
    let bell = complaint_of(&[&publish[..], &["--comment", "a\u{7}b"]].concat());
    assert!(bell.contains("control characters"), "{bell}");
}

#[cfg(feature = "releases")]
#[test]
fn a_checkout_is_a_release_and_loses_no_unpublished_work() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (map, copy, city) = (path("place.db"), path("copy.db"), path("city"));
    text_map(&folder.path().join("text"), 3);
    json_of(&["import-map", &path("text"), "--map", &map]);
    let publish = ["publish-map", "--map", &map, "--to", &city];
    json_of(&publish);
    let drop_a_keyframe = |id: &str| json_of(&["edit-map", "--map", &map, "--remove", id]);
    drop_a_keyframe("11");
    json_of(&publish);
    json_of(&["rollback", &city, "1"]);
    let info = |map: &str| json_of(&["map-info", "--map", map]);
    let [first, bad, live] = ["1", "2", "live"].map(|release| info(&format!("{city}@{release}")));
    assert_eq!(
        (&first["keyframes"], &bad["keyframes"], &live["keyframes"]),
        (&5.into(), &4.into(), &5.into())
    );
    assert_eq!((&bad["release"], &live["version"]), (&"release 2".into(), &3.into()));

    // The working copy still has what was rolled back; it was published, so it may go.
    let back = json_of(&["checkout", &city, "--map", &map]);
    assert_eq!((&back["changed"], &back["release"]), (&true.into(), &3.into()));
    assert_eq!((&info(&map)["keyframes"], &info(&map)["identity"]), (&5.into(), &first["identity"]));
    assert_eq!(json_of(&["checkout", &city, "--map", &map])["changed"], false);
    assert_eq!(json_of(&publish)["unchanged"], 3);
    // What was not published stays.
    drop_a_keyframe("12");
    let edited = info(&map);
    let refused = complaint_of(&["checkout", &format!("{city}@2"), "--map", &map]);
    assert!(refused.contains("in no release") && refused.contains("--force"), "{refused}");
    assert_eq!(info(&map), edited);
    json_of(&["checkout", &format!("{city}@2"), "--map", &map, "--force"]);
    assert_eq!(info(&map)["keyframes"], 4);
    // A new database is a version of the same map, and another map is not overwritten.
    json_of(&["checkout", &city, "--map", &copy]);
    assert_eq!((&info(&copy)["identity"], &info(&copy)["version"]), (&first["identity"], &3.into()));
    text_map(&folder.path().join("other"), 4);
    json_of(&["import-map", &path("other"), "--map", &path("other.db")]);
    let other = complaint_of(&["checkout", &city, "--map", &path("other.db"), "--force"]);
    assert!(other.contains("choose another path"), "{other}");
    let none = complaint_of(&["map-info", "--map", &format!("{city}@candidate")]);
    assert!(none.contains("has no candidate"), "{none}");
}
