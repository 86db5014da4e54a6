//! Poses that an operator sets: where the map is searched, and never what the filter measures.

use evaluation::trajectory::StateRow;
use geometry::rotation;
use geometry::uncertain_pose::isotropic_covariance;
use geometry::{Pose, PoseWithCovariance};
use map::contents::MapContents;
use nalgebra::{Matrix6, Vector3};
use onboard::{Outcome, run_robot};
use recognition::LoadedMap;
use robot::initial_pose::{InitialPoseError, InitialPoses};
use sensors::{Recording, Sequence, TruthTrack};
use std::sync::Arc;
use tests::robot::arguments;
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};

/// Length of the stretch that is played, nanoseconds.
const STRETCH_NS: i64 = 10_000_000_000;
/// Longest gap of the truth, nanoseconds.
const MAX_GAP_NS: i64 = 50_000_000;
/// From a place to the one that looks like it, metres.
const TWIN: Vector3<f64> = Vector3::new(0.0, 500.0, 0.0);

/// The ring, and one that looks like it.
fn twins(ring: &MapContents) -> MapContents {
    let mut both = ring.clone();
    // What the ring states of itself does not hold for both: the server measures it.
    both.aliases.clear();
    // Nobody drove through both.
    both.info.sessions.clear();
    for mut keyframe in ring.keyframes.clone() {
        keyframe.id += 100_000;
        keyframe.global_from_keyframe.pose.translation += TWIN;
        both.keyframes.push(keyframe);
    }
    for mut landmark in ring.landmarks.clone() {
        landmark.id += 10_000_000;
        landmark.anchor += 100_000;
        for observation in &mut landmark.observations {
            observation.keyframe += 100_000;
        }
        both.landmarks.push(landmark);
    }
    both
}

fn truth(sequence: &Sequence, stamp_ns: i64) -> Pose {
    TruthTrack::new(sequence.groundtruth.as_deref().unwrap()).pose(stamp_ns, MAX_GAP_NS).unwrap()
}

/// What RViz's tool sends for a pose: in the plane, beside it, with standard deviations of 0.5 m and 15 deg.
fn set_in_the_plane(poses: &InitialPoses, at: &Pose) {
    let (_, _, yaw) = at.rotation.euler_angles();
    let turned = rotation::exp(&(Vector3::z() * (yaw + 0.15)));
    let beside = Vector3::new(at.translation.x + 0.4, at.translation.y - 0.3, 0.0);
    let mut covariance = Matrix6::zeros();
    for (index, variance) in [(3, 0.25), (4, 0.25), (2, 0.0685)] {
        covariance[(index, index)] = variance;
    }
    poses.set(PoseWithCovariance::new(Pose::new(turned, beside), covariance), &Pose::identity()).unwrap();
}

/// Plays the beginning of the recording as fast as possible.
///
/// # Arguments
/// * `at`: called with each frame's time before it is processed.
fn play(server: &Server, switches: &str, mut at: impl FnMut(&InitialPoses, i64)) -> Outcome {
    let sequence = &MappedScenario::shared().recordings.live;
    let first_ns = sequence.frames[0].stamp_ns;
    let recording = Recording::from(sequence).between(first_ns, first_ns + STRETCH_NS);
    let folder = tempfile::tempdir().unwrap();
    let client = Client::connect(server.endpoint());
    let arguments = arguments(folder.path(), switches);
    let poses = arguments.initial_poses.clone();
    let each = |frame: usize| at(&poses, sequence.frames[frame].stamp_ns);
    let mut outcome = run_robot(recording, &arguments, Some(client.link("ring")), each).unwrap();
    client.close();
    // States are read while the folder is there.
    outcome.out = folder.keep();
    outcome
}

/// The states in the map, and how far from the truth the last one is.
fn localized(outcome: &Outcome, offset: Vector3<f64>) -> (Vec<StateRow>, Option<f64>) {
    let sequence = &MappedScenario::shared().recordings.live;
    let mut states = outcome.states().unwrap();
    std::fs::remove_dir_all(&outcome.out).unwrap();
    states.retain(|state| state.global_from_imu.is_some());
    let error = states.last().map(|last| {
        let found = last.global_from_imu.unwrap().pose.translation;
        (found - truth(sequence, last.stamp_ns).translation - offset).norm()
    });
    (states, error)
}

#[test]
fn the_operator_decides_between_places_that_look_alike() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let map = LoadedMap::from_contents(twins(&scenario.map)).unwrap();
    let server = Server::start("ring", Arc::new(map));

    let alone = play(&server, "", |_, _| {});
    assert!(alone.summary.queries.sent > 10, "{:?}", alone.summary.queries);
    assert!(localized(&alone, Vector3::zeros()).0.is_empty(), "nothing tells the places apart");

    let first_ns = live.frames[0].stamp_ns;
    for offset in [Vector3::zeros(), TWIN] {
        // Set while the robot stands still, before the estimator is initialized.
        let outcome = play(&server, "", |poses, stamp_ns| {
            if stamp_ns == first_ns {
                let there = truth(live, live.frames[1].stamp_ns);
                set_in_the_plane(poses, &Pose::new(there.rotation, there.translation + offset));
            }
        });
        let (states, error) = localized(&outcome, offset);
        assert!(error.unwrap() < 0.3, "{offset}: {error:?}");
        assert!(states[0].stamp_ns - first_ns < 3_000_000_000, "late");
    }
}

#[test]
fn the_operator_moves_a_robot_out_of_the_wrong_place() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let map = LoadedMap::from_contents(twins(&scenario.map)).unwrap();
    let server = Server::start("ring", Arc::new(map));
    let first_ns = live.frames[0].stamp_ns;
    let changed_ns = first_ns + 5_000_000_000;
    let mut changed = false;
    let outcome = play(&server, "", |poses, stamp_ns| {
        if stamp_ns == first_ns {
            set_in_the_plane(poses, &truth(live, live.frames[1].stamp_ns));
        } else if stamp_ns >= changed_ns && !changed {
            changed = true;
            let there = truth(live, stamp_ns);
            set_in_the_plane(poses, &Pose::new(there.rotation, there.translation + TWIN));
        }
    });
    let (states, error) = localized(&outcome, TWIN);
    let before = states.iter().rfind(|state| state.stamp_ns < changed_ns).unwrap();
    let expected = truth(live, before.stamp_ns).translation;
    let wrong = (before.global_from_imu.unwrap().pose.translation - expected).norm();
    assert!(wrong < 0.3, "in the first place before: {wrong}");
    assert!(error.unwrap() < 0.3, "in the second place after: {error:?}");
    assert!(outcome.summary.divergences.is_empty());
}

#[test]
fn a_wrong_pose_moves_nothing_and_a_confident_one_makes_nothing_more_certain() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let server = Server::start("ring", scenario.loaded());
    let first_ns = live.frames[0].stamp_ns;
    let (plain, error) = localized(&play(&server, "", |_, _| {}), Vector3::zeros());
    assert!(error.unwrap() < 0.3, "{error:?}");

    // Stated to be known to 0.1 mm, and right.
    let confident = play(&server, "", |poses, stamp_ns| {
        if stamp_ns == first_ns {
            let exact = PoseWithCovariance::new(
                truth(live, live.frames[1].stamp_ns),
                isotropic_covariance(1e-4, 1e-4),
            );
            poses.set(exact, &Pose::identity()).unwrap();
        }
    });
    let (confident, error) = localized(&confident, Vector3::zeros());
    assert!(error.unwrap() < 0.3, "{error:?}");
    let sigma = |states: &[StateRow]| states[0].global_from_imu.unwrap().sigma_p_m();
    let (with, without) = (sigma(&confident), sigma(&plain));
    assert!(with > 0.8 * without, "sigma {with} m with the pose, {without} m without");

    // On the other side of the ring, and far outside of the map.
    for wrong in [Vector3::new(0.0, 28.0, 0.0), Vector3::new(3000.0, 0.0, 0.0)] {
        let mut set = 0;
        let outcome = play(&server, "", |poses, stamp_ns| {
            // At the start, and again while the robot is localized.
            if stamp_ns == first_ns || (set == 1 && stamp_ns > first_ns + 5_000_000_000) {
                set += 1;
                let there = truth(live, stamp_ns.max(live.frames[1].stamp_ns));
                set_in_the_plane(poses, &Pose::new(there.rotation, there.translation + wrong));
            }
        });
        assert_eq!(set, 2);
        let (states, error) = localized(&outcome, Vector3::zeros());
        assert!(error.unwrap() < 0.3, "{wrong}: {error:?}");
        for state in &states {
            let pose = state.global_from_imu.unwrap();
            let apart = (pose.pose.translation - truth(live, state.stamp_ns).translation).norm();
            assert!(apart < 0.5, "{wrong}: {apart} m at {}", state.stamp_ns);
        }
    }
}

#[test]
fn what_is_refused_is_named_in_the_status() {
    let scenario = MappedScenario::shared();
    let server = Server::start("ring", scenario.loaded());
    let mut frames = 0;
    let outcome = play(&server, "", |poses, _| {
        frames += 1;
        // All the time, so that the last status is about it.
        poses.refuse(InitialPoseError::Frame { given: "odom".to_owned(), wanted: "map".to_owned() });
    });
    std::fs::remove_dir_all(&outcome.out).unwrap();
    let reason = outcome.summary.final_status.unwrap().reason;
    assert!(frames > 100 && reason.contains("operator's pose is refused"), "{reason}");
    assert!(reason.contains("\"odom\""), "{reason}");
}
