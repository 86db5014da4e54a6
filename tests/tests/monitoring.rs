//! Metrics of server and robot against what both report otherwise.

use std::collections::BTreeSet;
use std::path::Path;

use onboard::run_robot;
use prometheus_client::encoding::text::encode;
use prometheus_client::registry::Registry;
use tests::robot::arguments;
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};

/// The value of a metric, its labels included in the name.
fn value(metrics: &str, name: &str) -> u64 {
    let line = metrics.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    line.unwrap_or_else(|| panic!("{name} is missing in\n{metrics}")).parse().unwrap()
}

#[test]
fn metrics_count_what_the_summary_and_the_statistics_count() {
    let scenario = MappedScenario::shared();
    let folder = tempfile::tempdir().unwrap();
    let map = scenario.loaded();
    let keyframes = map.keyframe_count();
    let server = Server::start("ring", map);
    let client = Client::connect(server.endpoint());

    let switches = arguments(folder.path(), "");
    assert!(!switches.metrics.health().is_well, "before the first image");
    let outcome = run_robot(&scenario.recordings.live, &switches, Some(client.link("ring")), |_| {}).unwrap();
    client.close();

    let of_server = server.metrics();
    let statistics = server.statistics();
    assert_eq!(value(&of_server, "map_server_queries_answered_total"), statistics.answered);
    assert_eq!(value(&of_server, "map_server_queries_waiting"), 0);
    assert_eq!(value(&of_server, r#"map_server_map_keyframes{map="ring"}"#), keyframes as u64);
    let matches = r#"map_server_query_duration_seconds_count{map="ring",kind="match"}"#;
    assert!(value(&of_server, matches) >= outcome.summary.queries.answered);
    server.stop();

    let mut registry = Registry::default();
    switches.metrics.register(&mut registry);
    let mut of_robot = String::new();
    encode(&mut of_robot, &registry).unwrap();
    let queries = outcome.summary.queries;
    assert!(queries.accepted > 0);
    assert_eq!(value(&of_robot, "robot_frames_total"), outcome.summary.frames as u64);
    assert_eq!(value(&of_robot, "robot_answers_accepted_total"), queries.accepted);
    assert_eq!(value(&of_robot, "robot_queries_sent_total"), queries.sent);
    assert_eq!(value(&of_robot, r#"robot_localization{state="localized"}"#), 1);
    assert_eq!(value(&of_robot, r#"robot_localization{state="lost"}"#), 0);
    assert_eq!(value(&of_robot, "robot_healthy"), 1);
    let health = switches.metrics.health();
    assert!(health.is_well && health.reason.contains("the map corrected"), "{health:?}");

    for (file, least) in [("prometheus/alerts.yml", 6), ("grafana/driftless.json", 10)] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy").join(file);
        let names = names_in(&std::fs::read_to_string(path).unwrap());
        assert!(names.len() >= least, "{file}: {names:?}");
        for name in names {
            let is_given_out = |line: &str| {
                line.strip_prefix(name.as_str()).is_some_and(|rest| rest.starts_with(['{', ' ']))
            };
            assert!(of_server.lines().chain(of_robot.lines()).any(is_given_out), "{file}: {name}");
        }
    }
}

/// Names of metrics, without the prefix of all.
fn names_in(text: &str) -> BTreeSet<String> {
    let is_part = |letter: char| letter.is_ascii_lowercase() || letter == '_';
    let names = text.split("driftless_").skip(1);
    names.map(|rest| rest[..rest.find(|letter| !is_part(letter)).unwrap_or(rest.len())].to_owned()).collect()
}
