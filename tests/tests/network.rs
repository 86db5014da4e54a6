//! Servers that start and stop, several robots, and third-party subscribers.

use client::SessionOptions;
use estimator::Localization;
use geometry::uncertain_pose::PoseWithCovariance;
use onboard::{OpeningLink, RobotLink, StopSignal, run_robot, run_robot_until};
use protocol::{Format, Message, RobotOdometry, RobotPose, RobotState, RobotStatus};
use std::collections::BTreeSet;
use std::sync::Barrier;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tests::network::{messages, runtime};
use tests::robot::{arguments, assert_every_frame_has_a_state};
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};
use tools::in_process::free_endpoint;
use zenoh::sample::{Sample, SampleKind};

/// Frames from which on the server is gone, and from which on it is there again.
const OUTAGE: std::ops::Range<usize> = 100..180;

#[test]
fn a_robot_keeps_its_odometry_without_the_server_and_is_corrected_when_it_is_back() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let folder = tempfile::tempdir().unwrap();
    let map = scenario.loaded();
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
    for event in &outcome.events().unwrap() {
        if (gone..back).contains(&event.stamp_ns) {
            assert_eq!(event.outcome, "failed", "{event:?}");
            assert!(event.reason.contains("no map server answers"), "{event:?}");
            during += 1;
        } else if event.accepted {
            *if event.stamp_ns < gone { &mut before } else { &mut after } += 1;
        }
    }
    assert!(before > 5 && during > 3 && after > 5, "{before} before, {during} during, {after} after");

    // Odometry carried the pose in G through the outage; the map reduced its uncertainty again.
    let sigma_m = |frame: usize| {
        let mut states = outcome.states().unwrap().into_iter();
        let state = states.find(|state| state.stamp_ns == stamp(frame)).unwrap();
        let covariance = state.global_from_imu.as_ref().unwrap().covariance;
        covariance.fixed_view::<3, 3>(3, 3).trace().sqrt()
    };
    assert!(sigma_m(OUTAGE.end) > sigma_m(OUTAGE.start), "uncertainty must grow without a map");
    assert!(sigma_m(OUTAGE.end + 40) < sigma_m(OUTAGE.end), "the map must correct the pose again");
    let pose = outcome.summary.score.unwrap().pose.unwrap();
    assert!(pose.rmse_m < 0.25 && pose.max_m < 1.0, "{pose:?}");
    assert_eq!(outcome.summary.final_status.unwrap().localization, Localization::Localized);
    client.close();
    server.unwrap().stop();
}

#[test]
fn a_robot_whose_server_is_never_there_runs_to_the_end() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let folder = tempfile::tempdir().unwrap();
    let runtime = runtime();
    let options = SessionOptions { connect: vec![free_endpoint().unwrap()], ..SessionOptions::default() };
    let link = OpeningLink::open(options, runtime.handle().clone(), "ring").unwrap();
    let (stop, link) = (StopSignal::default(), Some(RobotLink::Opening(link)));
    let outcome = run_robot_until(&stop, live, &arguments(folder.path(), ""), link, |_| {}).unwrap();
    assert_eq!(outcome.summary.ended_early, None);
    assert_every_frame_has_a_state(&outcome, live);
    assert_eq!(outcome.summary.queries.sent, 0);
    let status = outcome.summary.final_status.unwrap();
    assert_eq!(status.localization, Localization::OdometryOnly);
    assert!(status.reason.contains("not connected"), "the status must say so: {}", status.reason);
    assert!(outcome.summary.score.unwrap().odometry_yaw_aligned_m.rmse < 0.5);
}

#[test]
fn a_robot_that_starts_before_its_router_is_localized_when_it_is_there() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let folder = tempfile::tempdir().unwrap();
    let (runtime, endpoint) = (runtime(), free_endpoint().unwrap());
    let options = SessionOptions { connect: vec![endpoint.clone()], ..SessionOptions::default() };
    let link = OpeningLink::open(options, runtime.handle().clone(), "ring").unwrap();
    let (stop, link) = (StopSignal::default(), Some(RobotLink::Opening(link)));
    let mut server = None;
    let outcome = run_robot_until(&stop, live, &arguments(folder.path(), ""), link, |frame| {
        if frame == OUTAGE.start {
            server = Some(Server::start_on(&endpoint, "ring", scenario.loaded()));
        }
        // The recording waits for the session, frame by frame.
        if server.as_ref().is_some_and(|server| server.statistics().answered == 0) {
            std::thread::sleep(Duration::from_millis(50));
        }
    })
    .unwrap();
    let events = outcome.events().unwrap();
    let first_ns = live.frames[OUTAGE.start].stamp_ns;
    assert!(events.iter().all(|event| event.stamp_ns >= first_ns));
    assert!(events.iter().filter(|event| event.accepted).count() > 5, "{events:?}");
    assert_eq!(outcome.summary.final_status.unwrap().localization, Localization::Localized);
    server.unwrap().stop();
}

/// The messages that a subscriber received from one robot.
#[derive(Default)]
struct Heard {
    poses: Vec<RobotPose>,
    odometry: Vec<RobotOdometry>,
    statuses: Vec<RobotStatus>,
}

impl Heard {
    fn note(&mut self, topic: &str, sample: &Sample) {
        fn read<M: Message>(sample: &Sample) -> M {
            let format = Format::from_encoding(&sample.encoding().to_string()).unwrap();
            protocol::decode(format, &sample.payload().to_bytes()).unwrap()
        }
        match topic {
            "pose" => self.poses.push(read(sample)),
            "odometry" => self.odometry.push(read(sample)),
            "status" => self.statuses.push(read(sample)),
            other => panic!("a robot published {other}"),
        }
    }
}

#[test]
fn two_robots_share_a_server_and_a_third_party_follows_both() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start("ring", scenario.loaded());
    let watching = free_endpoint().unwrap();
    let watcher = Client::open(&[&watching], &[server.endpoint()]);

    let names = ["ada", "bo"];
    let tokens = watcher
        .runtime
        .block_on(async { watcher.session.liveliness().declare_subscriber("robot/*").history(true).await })
        .unwrap();
    // A channel that nobody empties would fill, and block the tokens behind it: a callback takes everything.
    let heard = Arc::new(Mutex::new(names.map(|_| Heard::default())));
    let (all, session) = (Arc::clone(&heard), watcher.session.clone());
    let note = move |sample: Sample| {
        let parts: Vec<&str> = sample.key_expr().as_str().split('/').collect();
        let robot = names.iter().position(|name| *name == parts[1]).unwrap();
        all.lock().unwrap()[robot].note(parts[2], &sample);
    };
    let published = watcher
        .runtime
        .block_on(async { session.declare_subscriber("robot/*/*").callback(note).await })
        .unwrap();

    let clients = names.map(|_| Client::open(&[], &[server.endpoint(), &watching]));
    for client in &clients {
        client.wait_for_server(true);
    }
    // A publication that nobody has subscribed to yet is lost: the robots go on from their first frame when the
    // watcher has seen both their tokens.
    let both_are_seen = Barrier::new(3);
    let mut seen = BTreeSet::new();
    let outcomes = std::thread::scope(|scope| {
        let robots = names.iter().zip(&clients).map(|(name, client)| {
            let (out, link, both_are_seen) = (folder.path().join(name), client.link("ring"), &both_are_seen);
            scope.spawn(move || {
                let wait = |frame| {
                    if frame == 0 {
                        both_are_seen.wait();
                    }
                };
                let topics = if *name == "bo" { "bincode" } else { "json" };
                let switches = arguments(&out, &format!("--robot {name} --topics {topics}"));
                run_robot(live, &switches, Some(link), wait).unwrap()
            })
        });
        let robots: Vec<_> = robots.collect();
        while seen.len() < 2 {
            let token = tokens.recv().unwrap();
            assert_eq!(token.kind(), SampleKind::Put);
            seen.insert(token.key_expr().to_string());
        }
        both_are_seen.wait();
        robots.into_iter().map(|robot| robot.join().unwrap()).collect::<Vec<_>>()
    });
    assert_eq!(seen.iter().collect::<Vec<_>>(), ["robot/ada", "robot/bo"]);
    for outcome in &outcomes {
        assert_eq!(outcome.summary.final_status.as_ref().unwrap().localization, Localization::Localized);
        let pose = outcome.summary.score.as_ref().unwrap().pose.as_ref().unwrap();
        assert!(pose.rmse_m < 0.15, "{pose:?}");
        assert_eq!(outcome.summary.queries.failed, 0);
    }
    // As fast as possible a run does not depend on who else is there.
    let ends: Vec<_> =
        outcomes.iter().map(|outcome| outcome.states().unwrap().last().unwrap().clone()).collect();
    assert_eq!(ends[0].global_from_imu, ends[1].global_from_imu);
    for client in clients {
        client.close();
    }

    // The tokens go with the robots.
    while !seen.is_empty() {
        let token = tokens.recv().unwrap();
        assert_eq!(token.kind(), SampleKind::Delete);
        assert!(seen.remove(token.key_expr().as_str()));
    }
    let heard = heard.lock().unwrap();
    for (heard, outcome) in heard.iter().zip(&outcomes) {
        let states = &outcome.states().unwrap();
        let state_at = |stamp_ns| states.iter().find(|state| state.stamp_ns == stamp_ns).unwrap();
        // A full queue drops messages, and the end of a run may cut off the last ones; what comes is right.
        for count in [heard.poses.len(), heard.odometry.len()] {
            assert!(count > 50 && count <= states.len(), "{count} messages of {} frames", states.len());
        }
        // A robot publishes its status from the first image on, before it has a pose, and when it is shut down.
        let (statuses, images) = (heard.statuses.len(), live.frames.len());
        assert!(statuses > 50 && statuses <= images + 1, "{statuses} statuses of {images} images");
        for pose in &heard.poses {
            assert_eq!(pose.map, "ring");
            assert_same(&pose.global_from_imu, state_at(pose.stamp_ns).global_from_imu.as_ref().unwrap());
        }
        for odometry in &heard.odometry {
            assert_same(&odometry.local_from_imu, &state_at(odometry.stamp_ns).local_from_imu);
        }
        let [.., last, end] = &heard.statuses[..] else { panic!("no statuses") };
        assert_eq!((last.state, last.map.as_deref()), (RobotState::Localized, Some("ring")));
        assert!(end.state == RobotState::Off && end.queries_answered >= last.queries_answered, "{end:?}");
        assert!(last.queries_answered > 5);
    }
    let info: Vec<protocol::MapInfoReply> = messages(watcher.ask("map/ring/info", None));
    assert_eq!(info.len(), 1);
    assert!(server.statistics().failed == 0);
    drop((heard, published));
    watcher.close();
    server.stop();
}

/// Files hold nine decimals.
fn assert_same(published: &PoseWithCovariance, written: &PoseWithCovariance) {
    assert!(published.pose.local(&written.pose).amax() < 1e-8);
    assert!((published.covariance - written.covariance).amax() < 1e-8 * published.covariance.amax());
}
