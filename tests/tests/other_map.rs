//! Another map is served under the name of the one that a robot uses, with a version of the same number.

use estimator::Localization;
use onboard::run_robot;
use recognition::LoadedMap;
use std::sync::Arc;
use tests::robot::{arguments, assert_every_frame_has_a_state};
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};

/// Frame before which the server ends and another one starts with another map.
const OTHER: usize = 120;

#[test]
fn a_robot_refuses_answers_of_another_map_and_says_so() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let folder = tempfile::tempdir().unwrap();
    let mut server = Some(Server::start("ring", scenario.loaded()));
    let endpoint = server.as_ref().unwrap().endpoint().to_owned();
    let client = Client::connect(&endpoint);
    let mut contents = scenario.map.clone();
    for keyframe in &mut contents.keyframes {
        keyframe.global_from_keyframe.pose.translation.x += 5.0;
    }
    contents.info.identity = Some(contents.digest());
    let other = Arc::new(LoadedMap::from_contents(contents).unwrap());
    assert_eq!(other.info().version, scenario.map.info.version);

    let switches = arguments(folder.path(), "--robot ada");
    let outcome = run_robot(live, &switches, Some(client.link("ring")), |frame| {
        if frame == OTHER {
            server.take().unwrap().stop();
            client.wait_for_server(false);
            server = Some(Server::start_on(&endpoint, "ring", Arc::clone(&other)));
            client.wait_for_server(true);
        }
    })
    .unwrap();

    assert_every_frame_has_a_state(&outcome, live);
    let since_ns = live.frames[OTHER].stamp_ns;
    let events = outcome.events().unwrap();
    assert!(events.iter().any(|event| event.accepted && event.stamp_ns < since_ns));
    let later = || events.iter().filter(|event| event.stamp_ns >= since_ns);
    let refused = later().filter(|event| event.reason.contains("another map is served under this name"));
    assert!(refused.clone().count() > 5, "{events:?}");
    assert!(refused.clone().all(|event| event.reason.contains(&other.identity().to_string())));
    assert!(later().all(|event| !event.accepted));

    // The pose is still that in the map that the robot began with, and the status says why it is not corrected.
    let states = outcome.states().unwrap();
    let last = states.last().unwrap();
    let row = live.groundtruth.as_ref().unwrap();
    let truth = row.iter().min_by_key(|row| (row.stamp_ns - last.stamp_ns).abs()).unwrap();
    let error = last.global_from_imu.as_ref().unwrap().pose.translation - truth.pose.translation;
    assert!(error.norm() < 2.5, "{error}");
    let status = outcome.summary.final_status.as_ref().unwrap();
    assert_eq!(status.localization, Localization::Localized);
    assert!(status.reason.contains("another map"), "{}", status.reason);
    server.take().unwrap().stop();
}
