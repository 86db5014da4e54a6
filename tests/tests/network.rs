//! Servers that come and go, several robots, and whoever listens to them.
#![allow(clippy::unwrap_used)]

use onboard::robot::run_robot;
use protocol::session::{SessionOptions, close_session, open_session};
use protocol::{Format, Message, RobotOdometry, RobotPose, RobotState, RobotStatus};
use std::collections::BTreeSet;
use tests::network::{messages, runtime, wait_for};
use tests::place::Place;
use tests::robot::{arguments, assert_every_frame_has_a_state, run};
use tests::server::{Client, Server};
use tools::in_process::free_endpoint;

/// Frames from which on the server is gone, and from which on it is there again.
const OUTAGE: std::ops::Range<usize> = 100..180;

#[test]
fn a_robot_keeps_its_odometry_without_the_server_and_is_corrected_when_it_is_back() {
    let place = Place::shared();
    let live = &place.recordings.live;
    let folder = tempfile::tempdir().unwrap();
    let map = place.loaded();
    let mut server = Some(Server::start("ring", map.clone()));
    let endpoint = server.as_ref().unwrap().endpoint().to_owned();
    let client = Client::connect(&endpoint);

    let switches = arguments(folder.path(), "--deadline 1");
    let outcome = run_robot(live, &switches, Some(client.link("ring")), |frame| {
        if frame == OUTAGE.start {
            server.take().unwrap().stop();
            client.wait_for_server(false);
        }
        if frame == OUTAGE.end {
            server = Some(Server::start_on(&endpoint, "ring", map.clone()));
            client.wait_for_server(true);
        }
    })
    .unwrap();

    assert_eq!(outcome.summary.ended_early, None);
    assert_every_frame_has_a_state(&outcome, live);
    let stamp = |frame: usize| live.frames[frame].stamp_ns;
    let (gone, back) = (stamp(OUTAGE.start), stamp(OUTAGE.end));
    let (mut before, mut during, mut after) = (0, 0, 0);
    for event in &outcome.recorder.events {
        if (gone..back).contains(&event.stamp_ns) {
            assert_eq!(event.outcome, "failed", "{event:?}");
            assert!(event.reason.contains("no map server answers"), "{event:?}");
            during += 1;
        } else if event.accepted {
            *if event.stamp_ns < gone { &mut before } else { &mut after } += 1;
        }
    }
    assert!(before > 5 && during > 3 && after > 5, "{before} before, {during} during, {after} after");

    // Its odometry carried the pose in G through the outage; the map made it sure again.
    let sigma_m = |frame: usize| {
        let state = outcome.recorder.states.iter().find(|state| state.stamp_ns == stamp(frame)).unwrap();
        let covariance = state.global_from_imu.as_ref().unwrap().covariance;
        covariance.fixed_view::<3, 3>(3, 3).trace().sqrt()
    };
    assert!(sigma_m(OUTAGE.end) > sigma_m(OUTAGE.start), "uncertainty must grow without a map");
    assert!(sigma_m(OUTAGE.end + 40) < sigma_m(OUTAGE.end), "the map must correct the pose again");
    let pose = outcome.summary.score.unwrap().pose.unwrap();
    assert!(pose.rmse_m < 0.25 && pose.max_m < 1.0, "{pose:?}");
    assert_eq!(outcome.summary.final_status.unwrap().localization, RobotState::Localized);
    client.close();
    server.unwrap().stop();
}

#[test]
fn a_robot_whose_server_is_never_there_runs_to_the_end() {
    let place = Place::shared();
    let live = &place.recordings.live;
    let folder = tempfile::tempdir().unwrap();
    let nobody = Client::open(&free_endpoint().unwrap());
    let outcome = run(live, folder.path(), "--deadline 0.2", Some(nobody.link("ring")));
    assert_every_frame_has_a_state(&outcome, live);
    assert!(outcome.summary.queries.sent > 30);
    assert_eq!(outcome.summary.queries.failed, outcome.summary.queries.sent);
    assert!(outcome.recorder.events.iter().all(|event| event.reason.contains("no map server answers")));
    assert_eq!(outcome.summary.final_status.unwrap().localization, RobotState::OdometryOnly);
    assert!(outcome.summary.score.unwrap().odometry_yaw_aligned_m.rmse < 0.5);
    nobody.close();
}

/// What somebody heard of one robot.
#[derive(Default)]
struct Heard {
    poses: Vec<RobotPose>,
    odometry: Vec<RobotOdometry>,
    statuses: Vec<RobotStatus>,
}

impl Heard {
    fn note(&mut self, topic: &str, payload: &[u8]) {
        fn read<M: Message>(payload: &[u8]) -> M {
            protocol::decode(Format::Bincode, payload).unwrap()
        }
        match topic {
            "pose" => self.poses.push(read(payload)),
            "odometry" => self.odometry.push(read(payload)),
            "status" => self.statuses.push(read(payload)),
            other => panic!("a robot published {other}"),
        }
    }
}

#[test]
fn two_robots_share_a_server_and_a_third_party_follows_both() {
    let place = Place::shared();
    let live = &place.recordings.live;
    let folder = tempfile::tempdir().unwrap();
    let network = runtime();
    let router_endpoint = free_endpoint().unwrap();
    let options =
        SessionOptions { listen: vec![router_endpoint.clone()], router: true, ..SessionOptions::default() };
    let router = network.block_on(open_session(&options)).unwrap();
    let server = Server::start_behind(&router_endpoint, vec![("ring", place.loaded())]);
    let watcher = Client::connect(&router_endpoint);

    let names = ["ada", "bo"];
    let tokens = watcher
        .runtime
        .block_on(async { watcher.session.liveliness().declare_subscriber("robot/*").history(true).await })
        .unwrap();
    let published =
        watcher.runtime.block_on(async { watcher.session.declare_subscriber("robot/*/*").await }).unwrap();

    let clients = names.map(|_| Client::connect(&router_endpoint));
    let outcomes = std::thread::scope(|scope| {
        let robots: Vec<_> = names
            .iter()
            .zip(&clients)
            .map(|(name, client)| {
                let (out, link) = (folder.path().join(name), client.link("ring"));
                let (watched, runtime) = (watcher.session.clone(), watcher.runtime.handle().clone());
                scope.spawn(move || {
                    let switches = arguments(&out, &format!("--robot {name}"));
                    // A publication that nobody has subscribed to yet is lost: both robots go on from their first
                    // frame only when the watcher sees their tokens.
                    run_robot(live, &switches, Some(link), |frame| {
                        if frame == 0 {
                            for name in names {
                                runtime.block_on(wait_for(&watched, &format!("robot/{name}"), true));
                            }
                        }
                    })
                    .unwrap()
                })
            })
            .collect();
        robots.into_iter().map(|robot| robot.join().unwrap()).collect::<Vec<_>>()
    });
    for outcome in &outcomes {
        assert_eq!(outcome.summary.final_status.as_ref().unwrap().localization, RobotState::Localized);
        let pose = outcome.summary.score.as_ref().unwrap().pose.as_ref().unwrap();
        assert!(pose.rmse_m < 0.15, "{pose:?}");
        assert_eq!(outcome.summary.queries.failed, 0);
    }
    // As fast as possible a run does not depend on who else is there.
    let ends: Vec<_> =
        outcomes.iter().map(|outcome| outcome.recorder.states.last().unwrap().clone()).collect();
    assert_eq!(ends[0].global_from_imu, ends[1].global_from_imu);
    for client in clients {
        client.close();
    }

    // Tokens came and went with the robots; what they published before has then arrived too.
    let (mut seen, mut left) = (BTreeSet::new(), BTreeSet::new());
    while left.len() < 2 {
        let token = tokens.recv().unwrap();
        let name = token.key_expr().as_str().strip_prefix("robot/").unwrap().to_owned();
        match token.kind() {
            zenoh::sample::SampleKind::Put => seen.insert(name),
            zenoh::sample::SampleKind::Delete => left.insert(name),
        };
    }
    assert_eq!(seen.iter().collect::<Vec<_>>(), ["ada", "bo"]);
    let mut heard = names.map(|_| Heard::default());
    while let Ok(Some(sample)) = published.try_recv() {
        let parts: Vec<&str> = sample.key_expr().as_str().split('/').collect();
        let robot = names.iter().position(|name| *name == parts[1]).unwrap();
        heard[robot].note(parts[2], &sample.payload().to_bytes());
    }
    for (heard, outcome) in heard.iter().zip(&outcomes) {
        let last = outcome.recorder.states.last().unwrap();
        // A full queue drops messages, by design; that most arrive is the law here.
        let frames = outcome.recorder.states.len();
        for count in [heard.poses.len(), heard.odometry.len(), heard.statuses.len()] {
            assert!(count * 2 > frames && count <= frames, "{count} messages of {frames} frames");
        }
        let pose = heard.poses.last().unwrap();
        assert_eq!((pose.map.as_str(), pose.stamp_ns), ("ring", last.stamp_ns));
        assert_eq!(Some(&pose.global_from_imu), last.global_from_imu.as_ref());
        assert_eq!(heard.odometry.last().unwrap().local_from_imu, last.local_from_imu);
        let states: Vec<RobotState> = heard.statuses.iter().map(|status| status.state).collect();
        assert_eq!(states.last(), Some(&RobotState::Localized));
        assert!(heard.statuses.last().unwrap().queries_answered > 20);
    }
    let info: Vec<protocol::MapInfo> = messages(watcher.ask("map/ring/info", None));
    assert_eq!(info.len(), 1);
    assert!(server.statistics().failed == 0);
    watcher.close();
    server.stop();
    network.block_on(close_session(&router));
}
