//! Odometry at the rate of the IMU: predicted from the newest state, on a thread of its own.
//!
//! The estimator's thread leaves its newest state behind and goes on; the reader of the sensors hands each reading to the
//! tap and goes on. Neither waits for this thread, nor for the network.

use super::output::PublishMotion;
use estimator::{ImuSample, MotionPredictor};
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Longest prediction: without a newer state nothing is published after it, nanoseconds. A second without images is a
/// decimetre.
pub(crate) const HORIZON_NS: i64 = 1_000_000_000;
/// Readings are kept for a state that is computed late, nanoseconds.
const KEPT_NS: i64 = 2 * HORIZON_NS;
/// How soon the thread notices the end where no readings come.
const NOTICE: Duration = Duration::from_millis(50);

/// What is predicted from, and where that is published.
pub(crate) struct Basis {
    pub(crate) predictor: MotionPredictor,
    pub(crate) publish: Vec<PublishMotion>,
}

/// What the estimator says.
enum PredictorMessage {
    /// There is a newer state.
    State(Box<Basis>),
    /// There is no state any more.
    Lost,
    End,
}

/// The thread that predicts. It ends when this is dropped.
pub(crate) struct Prediction {
    news: Arc<Mutex<Option<PredictorMessage>>>,
    thread: Option<JoinHandle<()>>,
}

impl Prediction {
    /// Starts the thread.
    ///
    /// # Errors
    /// The operating system has no thread.
    pub(crate) fn start(readings: Receiver<ImuSample>) -> std::io::Result<Self> {
        let news = Arc::new(Mutex::new(None));
        let heard = Arc::clone(&news);
        let thread = std::thread::Builder::new().name("prediction".into());
        let thread = thread.spawn(move || Predicting::default().run(&readings, &heard))?;
        Ok(Self { news, thread: Some(thread) })
    }

    /// Predicts from a newer state.
    pub(crate) fn update(&self, basis: Basis) {
        self.tell(PredictorMessage::State(Box::new(basis)));
    }

    /// Nothing is published until the next state.
    pub(crate) fn lost(&self) {
        self.tell(PredictorMessage::Lost);
    }

    fn tell(&self, news: PredictorMessage) {
        *self.news.lock().unwrap_or_else(PoisonError::into_inner) = Some(news);
    }
}

impl Drop for Prediction {
    fn drop(&mut self) {
        self.tell(PredictorMessage::End);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of the prediction panicked");
        }
    }
}

/// The thread's state.
#[derive(Default)]
struct Predicting {
    basis: Option<Box<Basis>>,
    /// The newest readings.
    readings: VecDeque<ImuSample>,
}

impl Predicting {
    fn run(mut self, readings: &Receiver<ImuSample>, news: &Mutex<Option<PredictorMessage>>) {
        loop {
            let reading = match readings.recv_timeout(NOTICE) {
                Ok(reading) => Some(reading),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return,
            };
            // Taken in a statement of its own, so that the lock is not held any longer.
            let heard = news.lock().unwrap_or_else(PoisonError::into_inner).take();
            match heard {
                Some(PredictorMessage::State(basis)) => self.replace(basis),
                Some(PredictorMessage::Lost) => self.basis = None,
                Some(PredictorMessage::End) => return,
                None => {}
            }
            if let Some(reading) = reading {
                self.add(reading);
            }
        }
    }

    /// Brings a newer state up to the newest reading.
    fn replace(&mut self, mut basis: Box<Basis>) {
        let state_ns = basis.predictor.state_ns();
        // The last reading at or before the state belongs to it.
        let first = self.readings.partition_point(|reading| reading.stamp_ns <= state_ns).saturating_sub(1);
        for reading in self.readings.range(first..) {
            basis.predictor.add(*reading);
        }
        self.basis = Some(basis);
    }

    /// Publishes the motion at a reading.
    fn add(&mut self, reading: ImuSample) {
        self.readings.push_back(reading);
        while self.readings.front().is_some_and(|oldest| oldest.stamp_ns < reading.stamp_ns - KEPT_NS) {
            self.readings.pop_front();
        }
        let Some(basis) = &mut self.basis else { return };
        let Some(motion) = basis.predictor.add(reading) else { return };
        if motion.stamp_ns - basis.predictor.state_ns() > HORIZON_NS {
            return;
        }
        basis.publish.iter().for_each(|publish| publish(&motion));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use estimator::{Estimator, EstimatorConfig, InitialSigmas, InitialState, Motion};
    use geometry::{Camera, Distortion, Pose};
    use nalgebra::Vector3;
    use std::sync::mpsc::{Sender, channel};

    const PERIOD_NS: i64 = 5_000_000;
    const PATIENCE: Duration = Duration::from_secs(20);

    /// A body that accelerates with 1 m/s^2 along x.
    fn reading(at: i64) -> ImuSample {
        let accelerometer = Vector3::new(1.0, 0.0, EstimatorConfig::default().gravity);
        ImuSample { stamp_ns: at * PERIOD_NS, gyroscope: Vector3::zeros(), accelerometer }
    }

    fn basis(sent: &Sender<Motion>) -> Basis {
        let distortion = Distortion::None;
        let camera =
            Camera { width: 640, height: 480, focal: [400.0; 2], centre: [320.0, 240.0], distortion };
        let cameras = vec![estimator::CalibratedCamera::new(camera, Pose::identity())];
        let sigmas = InitialSigmas::default();
        let start = InitialState::from_truth(0, &Pose::identity(), &Vector3::zeros(), &-Vector3::z(), sigmas);
        let estimator = Estimator::new(EstimatorConfig::default(), cameras, &start).unwrap();
        let sent = sent.clone();
        let publish: PublishMotion = Box::new(move |motion| sent.send(*motion).unwrap());
        Basis { predictor: estimator.predictor(), publish: vec![publish] }
    }

    #[test]
    fn every_reading_behind_a_state_is_a_pose_and_none_where_there_is_no_state() {
        let mut predicting = Predicting::default();
        let (sent, motions) = channel();
        let stamps = || motions.try_iter().map(|motion: Motion| motion.stamp_ns).collect::<Vec<_>>();
        (0..10).for_each(|at| predicting.add(reading(at)));
        predicting.replace(Box::new(basis(&sent)));
        assert_eq!(stamps().len(), 0, "what was read before the state is not published again");
        predicting.add(reading(10));
        let motion = motions.try_recv().unwrap();
        let seconds = 10.0 * PERIOD_NS as f64 * 1e-9;
        let position = motion.state.local_from_imu.translation;
        assert!((position - Vector3::x() * (0.5 * seconds * seconds)).norm() < 1e-9, "{position}");
        // A second without a newer state is the end of it.
        (11..1000).for_each(|at| predicting.add(reading(at)));
        assert_eq!(stamps(), (11..=200).map(|at| at * PERIOD_NS).collect::<Vec<_>>());
        predicting.basis = None;
        predicting.add(reading(1000));
        assert_eq!(stamps().len(), 0);
    }

    #[test]
    fn the_thread_follows_what_it_is_told_and_ends() {
        let (readings, tap) = std::sync::mpsc::sync_channel(10);
        let (sent, motions) = channel();
        let prediction = Prediction::start(tap).unwrap();
        prediction.update(basis(&sent));
        let first = (0..1000).find_map(|at| {
            readings.send(reading(at)).unwrap();
            motions.recv_timeout(Duration::from_millis(10)).ok()
        });
        let at = first.unwrap().stamp_ns / PERIOD_NS;
        prediction.lost();
        while prediction.news.lock().unwrap().is_some() {
            std::thread::yield_now();
        }
        readings.send(reading(at + 1)).unwrap();
        assert!(motions.recv_timeout(3 * NOTICE).is_err(), "nothing is published without a state");
        prediction.update(basis(&sent));
        let next = (at + 2..at + 1000).find_map(|at| {
            readings.send(reading(at)).unwrap();
            motions.recv_timeout(Duration::from_millis(10)).ok()
        });
        assert!(next.is_some());
        drop(prediction);
        assert!(readings.send(reading(0)).is_err(), "the thread is gone");
        drop(sent);
        assert!(motions.recv_timeout(PATIENCE).is_err());
    }
}
