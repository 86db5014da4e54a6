//! Consistency (NEES) of all outputs over several scenarios; the filter that takes the map for exact is inconsistent.

use evaluation::{RunScore, nees_bounds};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use tests::robot::run;
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};

/// Scenarios, each with its own trajectories, noise, landmarks and errors of the map: independent samples.
const PLACES: u64 = 4;
/// Confidence of the bounds. Generous: a mean over a run varies less than the single sample that it counts as.
const CONFIDENCE: f64 = 0.999;

/// Takes the NEES per degree of freedom of one output from a score.
type Nees<'a> = &'a dyn Fn(&RunScore) -> f64;

/// Scores of the default filter and of `mapconst` in one scenario.
fn scores(seed: u64) -> [RunScore; 2] {
    let scenario = MappedScenario::new(seed);
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start("ring", scenario.loaded());
    let client = Client::connect(server.endpoint());
    let scores = ["multi", "mapconst"].map(|mode| {
        let switches = format!("--mode {mode}");
        run(&scenario.recordings.live, folder.path(), &switches, Some(client.link("ring")))
            .summary
            .score
            .unwrap()
    });
    client.close();
    server.stop();
    scores
}

#[test]
fn the_errors_of_pose_transform_and_odometry_are_what_their_covariances_say() {
    let (next, all) = (AtomicU64::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= PLACES {
                        break;
                    }
                    let scores = scores(100 + seed);
                    all.lock().unwrap().push(scores);
                }
            });
        }
    });
    let all = all.into_inner().unwrap();
    assert_eq!(all.len(), PLACES as usize);
    let mean = |variant: usize, nees: Nees| {
        all.iter().map(|scores| nees(&scores[variant])).sum::<f64>() / all.len() as f64
    };
    let pose = |score: &RunScore| score.pose.as_ref().unwrap().nees_pose.unwrap();
    let transform = |score: &RunScore| score.transform.as_ref().unwrap().nees_pose.unwrap();
    let local = |score: &RunScore| score.local.nees_pose.unwrap();
    let (low, high) = nees_bounds(6, PLACES as usize, CONFIDENCE).unwrap();
    let outputs: [(&str, Nees); 3] =
        [("pose in G", &pose), ("global_from_local", &transform), ("local pose", &local)];
    for (name, nees) in outputs {
        let each: Vec<f64> = all.iter().map(|scores| nees(&scores[0])).collect();
        let average = mean(0, nees);
        println!("NEES of the {name}: {average:.2} of {each:.2?}, mapconst {:.1}", mean(1, nees));
        assert!(
            (low..high).contains(&average),
            "NEES of the {name}: {average} is not in {low}..{high}: {each:?}"
        );
    }
    let exact = mean(1, &pose);
    assert!(
        exact > 10.0 * mean(0, &pose),
        "mapconst has a NEES of {exact}: does it still take the map for exact?"
    );
}
