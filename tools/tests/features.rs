//! Several kinds of features in one map, with the programs: images are kept, features are added, robots with either kind are localized.

use std::path::Path;

use sensors::writer;
use simulation::SimulationOptions;
use simulation::images::{ImageOptions, simulate_images, write_images};

use crate::program::{complaint_of, json_of, text};

/// Two flights through a room, at half of the usual rate, and the first of them at a sixth: a map takes few of its images.
fn write_flights(map: &Path, live: &Path) {
    let options =
        SimulationOptions { duration_s: Some(6.0), frame_rate_hz: 10.0, ..ImageOptions::simulation() };
    let mut flights = simulate_images(&options, &ImageOptions::default()).unwrap();
    let mut count = 0;
    flights.map.frames.retain(|_| {
        count += 1;
        count % 3 == 0
    });
    for (sequence, folder) in [(&flights.map, map), (&flights.live, live)] {
        writer::write(sequence, folder).unwrap();
        write_images(sequence, folder, |_, _| {}).unwrap();
    }
}

#[test]
fn features_are_added_to_a_map_that_keeps_images_and_robots_of_either_kind_are_localized() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (recording, live) = (path("map"), path("live"));
    let (both, plain) = (path("both.db"), path("plain.db"));
    write_flights(&recording, &live);
    let few = ["--max-features", "400"];
    let map = ["build-map", text(&recording), "--map", text(&both), "--keep-images=85"];
    let sparse = ["--min-distance", "0.4", "--min-rotation", "15"];
    let built = json_of(&[&map[..], &sparse, &few].concat());
    let info = |map: &Path| json_of(&["map-info", "--map", text(map)]);
    let before = info(&both);
    let keyframes = before["keyframes"].as_u64().unwrap();
    assert_eq!(before["images"]["count"].as_u64().unwrap(), keyframes);
    assert_eq!(built["report"]["kept_images"]["images"].as_u64().unwrap(), keyframes);
    assert_eq!(before["feature_kinds"].as_array().unwrap().len(), 1);

    // Nothing of it without images, or where the features are there.
    json_of(&["edit-map", "--map", text(&both), "--to", text(&plain), "--drop-images"]);
    let without = info(&plain);
    assert_eq!((&without["schema"], &without["images"]["count"]), (&map::STORE_SCHEMA.into(), &0.into()));
    let refused = complaint_of(&["add-features", "--map", text(&plain), "--features", "edgepoint2"]);
    assert!(refused.contains("--keep-images"), "{refused}");
    let refused = complaint_of(&["add-features", "--map", text(&both), "--features", "sift-1"]);
    assert!(refused.contains("nothing to add"), "{refused}");

    let added =
        json_of(&[&["add-features", "--map", text(&both), "--features", "edgepoint2"], &few[..]].concat());
    println!("{added:#}");
    assert_eq!(added["version"], 2);
    let after = info(&both);
    println!("{after:#}");
    let kinds = after["feature_kinds"].as_array().unwrap();
    assert_eq!((&kinds[0]["extractor"], &kinds[1]["extractor"]), (&"sift-1".into(), &"edgepoint2-1".into()));
    assert_eq!((&kinds[0], &after["sigma_p_m"]), (&before["feature_kinds"][0], &before["sigma_p_m"]));
    assert!(kinds[1]["landmarks"].as_u64().unwrap() > 200, "{after:#}");
    let refused = complaint_of(&["add-features", "--map", text(&both), "--features", "edgepoint2"]);
    assert!(refused.contains("--force"), "{refused}");

    for extractor in ["sift-1", "edgepoint2-1"] {
        let out = path(extractor);
        let robot = json_of(&[
            "run",
            text(&live),
            "--map",
            text(&both),
            "--extractor",
            extractor,
            "--out",
            text(&out),
        ]);
        println!("{extractor}: {robot:#}");
        let pose = &robot["score"]["pose"];
        let number = |key: &str| pose[key].as_f64().unwrap_or_else(|| panic!("{key}: {robot:#}"));
        assert!(number("rmse_m") < 0.05 && number("nees_pose") < 3.0, "{robot:#}");
    }

    // What takes them out leaves the map as it was before.
    json_of(&["edit-map", "--map", text(&both), "--drop-images", "--drop-features", "edgepoint2-1"]);
    let left = info(&both);
    assert_eq!((&left["schema"], &left["images"]["count"]), (&map::STORE_SCHEMA.into(), &0.into()));
    assert_eq!(left["feature_kinds"], before["feature_kinds"]);
}
