//! A map whose direction of gravity is wrong or missing.

use estimator::Localization;
use nalgebra::Vector3;
use onboard::Outcome;
use onboard::progress::report;
use recognition::LoadedMap;
use std::sync::Arc;
use tests::robot::run;
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};

/// Runs a robot in the map with another direction of gravity, and asserts what it says of it everywhere.
fn assert_named(gravity: Option<Vector3<f64>>, expected: &str) {
    let scenario = MappedScenario::shared();
    let mut map = scenario.map.clone();
    map.info.gravity_in_global = gravity;
    let server = Server::start("ring", Arc::new(LoadedMap::from_contents(map).unwrap()));
    let client = Client::connect(server.endpoint());
    let folder = tempfile::tempdir().unwrap();
    let Outcome { summary, .. } =
        run(&scenario.recordings.live, folder.path(), "", Some(client.link("ring")));
    client.close();
    server.stop();

    let status = summary.final_status.as_ref().unwrap();
    let written = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    for text in [&status.reason, &summary.alarms[0].reason, &report(&summary), &written] {
        assert!(text.contains(expected) && text.contains("the images and the IMU say (0.0"), "{text}");
        assert!(text.contains(", -1.00): ") && text.contains("--gravity of build-map"), "{text}");
    }
    // Once, and not for every answer; and as nothing else is wrong with the map, it is used.
    assert_eq!((summary.alarms.len(), summary.alarms[0].ended_s), (1, None));
    assert_eq!(status.localization, Localization::Localized);
    let waited = summary.queries.kept_waiting;
    assert!(waited < 3, "{waited}");
    assert!(summary.queries.accepted + waited + 2 > summary.queries.matched && summary.queries.matched > 20);
    assert!(summary.score.unwrap().pose.unwrap().rmse_m < 0.1);
}

#[test]
fn a_map_whose_gravity_has_the_wrong_sign_is_named() {
    assert_named(Some(Vector3::z()), "the map says that gravity points to (0.00, 0.00, 1.00)");
}

#[test]
fn a_map_without_gravity_is_named() {
    assert_named(None, "the map does not say where gravity points");
}
