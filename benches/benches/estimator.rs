//! Times what the estimator does with an image, one thread: `cargo bench -p benches --bench estimator`.
//!
//! On the simulator's street, in motion, with the window full of clones and some 100 tracks alive. `whole frame` is the
//! mean over successive images, with the IMU's readings handed over; the others repeat one image's step on a copy.
#![allow(clippy::unwrap_used)]

use criterion::{BatchSize, BenchmarkId, Criterion, criterion_group, criterion_main};
use estimator::{
    CalibratedCamera, Estimator, EstimatorConfig, ImuSample, InitialSigmas, InitialState, MapMode,
    TrackObservation,
};
use sensors::{Frame, Sequence};
use simulation::{SimulationOptions, simulate};
use std::hint::black_box;
use std::time::{Duration, Instant};

/// Images before the timing begins: the body moves by then, and the window is full.
const WARM_UP: usize = 100;
/// Images whose mean is taken.
const FRAMES: usize = 100;

/// A recording, played to an estimator image by image.
struct Player<'a> {
    sequence: &'a Sequence,
    cameras: usize,
    estimator: Estimator,
    next_imu: usize,
}

impl<'a> Player<'a> {
    /// At the first image to be timed.
    fn new(sequence: &'a Sequence, cameras: usize) -> Self {
        let mut config = EstimatorConfig::default();
        config.mode = MapMode::Odometry;
        let row = &sequence.groundtruth.as_ref().unwrap()[0];
        let gravity = sequence.truth_gravity().unwrap();
        let initial = InitialState::from_truth(
            row.stamp_ns,
            &row.pose,
            &row.velocity.unwrap(),
            &gravity,
            InitialSigmas::default(),
        );
        let eyes = sequence.cameras.iter().take(cameras);
        let rig: Vec<CalibratedCamera> = eyes
            .map(|sensor| CalibratedCamera {
                camera: sensor.camera.clone(),
                imu_from_camera: sensor.imu_from_camera,
                readout_s: sensor.readout_s,
                delay_s: sensor.delay_s(),
            })
            .collect();
        let estimator = Estimator::new(config, rig, &initial).unwrap();
        let mut player = Self { sequence, cameras, estimator, next_imu: 0 };
        for frame in &sequence.frames[..WARM_UP] {
            player.whole_frame(frame, &player.tracks(frame));
        }
        player
    }

    fn tracks(&self, frame: &Frame) -> Vec<TrackObservation> {
        let used = |track: &&TrackObservation| usize::from(track.camera) < self.cameras;
        frame.tracks.iter().filter(used).copied().collect()
    }

    fn feed_imu(&mut self, stamp_ns: i64) {
        let samples: &[ImuSample] = &self.sequence.imu_samples;
        while self.next_imu == 0 || samples[self.next_imu - 1].stamp_ns < stamp_ns {
            self.estimator.imu(samples[self.next_imu]).unwrap();
            self.next_imu += 1;
        }
    }

    fn whole_frame(&mut self, frame: &Frame, tracks: &[TrackObservation]) {
        self.feed_imu(frame.stamp_ns);
        self.estimator.time_update(frame.stamp_ns).unwrap();
        self.estimator.track_update(tracks).unwrap();
    }
}

fn recording(imu_rate_hz: f64) -> Sequence {
    simulate(&SimulationOptions { imu_rate_hz, ..SimulationOptions::default() }).unwrap().live
}

fn estimator(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("estimator");
    for imu_rate_hz in [200.0, 400.0] {
        let live = recording(imu_rate_hz);
        let mut player = Player::new(&live, 2);
        let frame = &live.frames[WARM_UP];
        player.feed_imu(frame.stamp_ns);
        // Images come at 10 Hz.
        let name = BenchmarkId::new("propagation, readings", imu_rate_hz / 10.0);
        group.bench_function(name, |bencher| {
            bencher.iter_batched(
                || player.estimator.clone(),
                |mut estimator| {
                    estimator.time_update(frame.stamp_ns).unwrap();
                    estimator
                },
                BatchSize::SmallInput,
            );
        });
    }
    let live = recording(200.0);
    for (cameras, rig) in [(1, "mono"), (2, "stereo")] {
        let mut player = Player::new(&live, cameras);
        let frame = &live.frames[WARM_UP];
        player.feed_imu(frame.stamp_ns);
        player.estimator.time_update(frame.stamp_ns).unwrap();
        let tracks = player.tracks(frame);
        group.bench_function(BenchmarkId::new("track update", rig), |bencher| {
            bencher.iter_batched(
                || player.estimator.clone(),
                |mut estimator| {
                    black_box(estimator.track_update(&tracks).unwrap());
                    estimator
                },
                BatchSize::SmallInput,
            );
        });
        group.bench_function(BenchmarkId::new("whole frame", rig), |bencher| {
            bencher.iter_custom(|rounds| {
                let round = |_| mean_frame(Player::new(&live, cameras));
                (0..rounds).map(round).sum()
            });
        });
    }
    group.finish();
}

/// Time of an image, as the mean over many.
fn mean_frame(mut player: Player<'_>) -> Duration {
    let frames = &player.sequence.frames[WARM_UP..WARM_UP + FRAMES];
    let tracks: Vec<_> = frames.iter().map(|frame| player.tracks(frame)).collect();
    let begin = Instant::now();
    for (frame, tracks) in frames.iter().zip(&tracks) {
        player.whole_frame(frame, tracks);
    }
    begin.elapsed() / FRAMES as u32
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = estimator
}
criterion_main!(benches);
