//! What a frame allocates once a run has warmed up: without a map nothing.
//!
//! Memory from the heap costs time that varies, and a robot has other programs on its machine. The counter replaces
//! the allocator of this test binary and counts by thread. To find out where an allocation comes from, replace it by
//! `dhat`.

use crate::common::{FRAME_NS, World};
use allocation_counter::measure;
use estimator::{Estimator, EstimatorConfig, TrackObservation};

/// Frames until every buffer has grown to its size: several times around the window.
const WARM_UP: i64 = 100;
const FRAMES: usize = 100;

/// Allocations of one frame.
#[derive(Clone, Copy, Debug)]
struct Counts {
    readings: u64,
    time_update: u64,
    track_update: u64,
}

fn counts(estimator: &mut Estimator, frame: i64, tracks: &[TrackObservation]) -> Counts {
    Counts {
        readings: measure(|| World::feed_imu(estimator, frame)).count_total,
        time_update: measure(|| _ = estimator.time_update(frame * FRAME_NS).unwrap()).count_total,
        track_update: measure(|| _ = estimator.track_update(tracks).unwrap()).count_total,
    }
}

fn steady_state(slam_features: usize) -> Vec<Counts> {
    let world = World::new();
    let mut config = EstimatorConfig::default();
    (config.slam_features, config.window) = (slam_features, 8);
    let mut estimator = world.estimator(config);
    for frame in 1..=WARM_UP {
        world.frame(&mut estimator, frame);
    }
    (WARM_UP + 1..).take(FRAMES).map(|frame| counts(&mut estimator, frame, &world.tracks(frame))).collect()
}

/// The middle of what the frames allocated, and the most.
fn median_and_most(counts: &[Counts], of: impl Fn(&Counts) -> u64) -> (u64, u64) {
    let mut sorted: Vec<u64> = counts.iter().map(of).collect();
    sorted.sort_unstable();
    (sorted[sorted.len() / 2], sorted[sorted.len() - 1])
}

#[test]
fn the_counter_counts() {
    assert_eq!(measure(|| drop(std::hint::black_box(vec![0_u8; 64]))).count_total, 1);
}

#[test]
fn propagating_and_cloning_allocate_nothing() {
    for slam_features in [0, 15] {
        let counts = steady_state(slam_features);
        assert_eq!(median_and_most(&counts, |frame| frame.readings), (0, 0), "{counts:?}");
        assert_eq!(median_and_most(&counts, |frame| frame.time_update), (0, 0), "{counts:?}");
    }
}

#[test]
fn an_update_from_tracks_allocates_nothing() {
    // A clone leaves the window with every frame.
    let counts = steady_state(0);
    assert_eq!(median_and_most(&counts, |frame| frame.track_update), (0, 0), "{counts:?}");
    // Now and then landmarks leave the state or enter it.
    let counts = steady_state(15);
    let (median, most) = median_and_most(&counts, |frame| frame.track_update);
    assert!(median == 0 && most <= 12, "median {median}, most {most}: {counts:?}");
}
