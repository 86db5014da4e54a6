//! Whether a body that shows no motion from image to image shows none since it came to rest.
//!
//! A robot that creeps by 4 cm/s among points twenty metres away shifts their pixels by less than what counts as none in half a second. Each
//! half of a second then states the same wrong displacement, and a minute of them, taken for independent, states a few
//! decimetres for a way of two metres. Over some seconds the shift adds up: pixels are compared with those of the image with
//! which the rest began. Where they have moved, the body is *doubted* to rest: it may creep as before, and what the zero-velocity update
//! states is so uncertain that [`DOUBTED_SIGMAS`]` ^ 2` of them count as one. The doubt ends where the image has not moved for
//! [`PROOF_NS`], or has moved clearly: what follows is another rest.

use super::zero_velocity::{MIN_TRACKS, PixelPair, Shown, is_still};
use crate::camera_vote::most_are_still;
use nalgebra::Vector2;
use smallvec::SmallVec;
use types::TrackObservation;

/// Factor on the standard deviation of a displacement of a body that may creep: updates of half a minute count as one.
const DOUBTED_SIGMAS: f64 = 8.0;
/// Time in which the image must not move until a body that has crept rests again, nanoseconds.
const PROOF_NS: i64 = 5_000_000_000;
/// Images one after the other that must have moved: the noise of a single one is no motion.
const MOVED_IMAGES: usize = 3;

/// Features of a camera for which there is memory from the begin.
const USUAL_FEATURES: usize = 512;

/// Pixels of the features that one camera saw.
type Pixels = Vec<(u64, Vector2<f64>)>;

/// What one camera showed.
#[derive(Clone, Debug)]
struct CameraPixels {
    camera: u8,
    /// In the first image of the rest in which it showed enough of the features that it sees now; empty before.
    then: Pixels,
    /// In the newest image.
    now: Pixels,
}

impl CameraPixels {
    /// Whether the image is the one with which the rest began; `None` where too few features of then are left: those of now are kept, and
    /// nothing before says that the body rests.
    fn compare(&mut self, limit_px: f64) -> Option<bool> {
        let mut pairs = SmallVec::<[PixelPair; 400]>::new();
        for (feature_id, pixel) in &self.now {
            if let Ok(index) = self.then.binary_search_by_key(feature_id, |(id, _)| *id) {
                pairs.push(PixelPair { then: self.then[index].1, now: *pixel });
            }
        }
        if pairs.len() < MIN_TRACKS {
            std::mem::swap(&mut self.then, &mut self.now);
            self.then.sort_unstable_by_key(|(id, _)| *id);
            return None;
        }
        Some(is_still(&pairs, limit_px))
    }
}

/// The watch over the rests of a body.
#[derive(Clone, Debug, Default)]
pub struct RestWatch {
    /// Since when no camera began anew to compare, nanoseconds; `None` in motion.
    since_ns: Option<i64>,
    /// Of each camera that was seen; their memory is kept.
    cameras: Vec<CameraPixels>,
    /// It moved while it seemed to rest.
    is_doubted: bool,
    moved_in_a_row: usize,
}

impl RestWatch {
    /// Takes in an image.
    ///
    /// # Arguments
    /// * `shown`: what its tracks show of the last half of a second.
    /// * `observations`: all features of it.
    /// * `limit_px`: largest median displacement of a pixel at rest, px.
    ///
    /// # Returns
    /// Factor on the standard deviation of a displacement of a body that rests.
    pub fn note(
        &mut self,
        now_ns: i64,
        shown: Shown,
        observations: &[TrackObservation],
        limit_px: f64,
    ) -> f64 {
        self.keep(observations);
        match shown {
            Shown::Motion { is_clear: true } => {
                self.end();
                (self.is_doubted, self.moved_in_a_row) = (false, 0);
            }
            Shown::Motion { is_clear: false } => self.is_doubted |= self.end(),
            Shown::Turn | Shown::Nothing => _ = self.end(),
            Shown::Rest => self.note_rest(now_ns, limit_px),
        }
        if self.is_doubted { DOUBTED_SIGMAS } else { 1.0 }
    }

    /// Keeps the pixels of the newest image.
    fn keep(&mut self, observations: &[TrackObservation]) {
        for of in &mut self.cameras {
            of.now.clear();
        }
        for observation in observations {
            let feature = (observation.feature_id, observation.pixel);
            if let Some(of) = self.cameras.iter_mut().find(|of| of.camera == observation.camera) {
                of.now.push(feature);
            } else {
                let [then, mut now] = [(); 2].map(|()| Vec::with_capacity(USUAL_FEATURES));
                now.push(feature);
                self.cameras.push(CameraPixels { camera: observation.camera, then, now });
            }
        }
    }

    /// Ends a rest.
    ///
    /// # Returns
    /// Whether there was one.
    fn end(&mut self) -> bool {
        for of in &mut self.cameras {
            of.then.clear();
        }
        self.since_ns.take().is_some()
    }

    fn note_rest(&mut self, now_ns: i64, limit_px: f64) {
        let mut since_ns = self.since_ns.unwrap_or(now_ns);
        let compared = self.cameras.iter_mut().map(|of| {
            let can_be_compared = of.now.len() >= MIN_TRACKS;
            let is_still = of.compare(limit_px);
            if is_still.is_none() && can_be_compared {
                since_ns = now_ns;
            }
            is_still
        });
        let is_still = most_are_still(compared);
        self.moved_in_a_row = if is_still == Some(false) { self.moved_in_a_row + 1 } else { 0 };
        if self.moved_in_a_row >= MOVED_IMAGES {
            // Another one begins with the next image.
            self.end();
            (self.is_doubted, self.moved_in_a_row) = (true, 0);
            return;
        }
        self.is_doubted &= now_ns - since_ns < PROOF_NS;
        self.since_ns = Some(since_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};

    const FRAME_NS: i64 = 50_000_000;

    /// Images of 60 features with a pixel of noise.
    struct Scene {
        rng: StdRng,
        watch: RestWatch,
        now_ns: i64,
        shift_px: f64,
    }

    impl Scene {
        fn new(seed: u64) -> Self {
            let rng = StdRng::seed_from_u64(seed);
            Self { rng, watch: RestWatch::default(), now_ns: 0, shift_px: 0.0 }
        }

        /// Plays some seconds in which the image moves by `speed`, px/s, and `shown` is what half a second shows of it.
        ///
        /// # Returns
        /// Part of the images at which the body is doubted to rest.
        fn play(&mut self, seconds: f64, speed: f64, shown: Shown) -> f64 {
            let count = (seconds * 1e9) as i64 / FRAME_NS;
            let mut doubted = 0.0;
            for _ in 0..count {
                self.now_ns += FRAME_NS;
                self.shift_px += speed * FRAME_NS as f64 * 1e-9;
                let mut noise = || (0..12).map(|_| self.rng.random::<f64>()).sum::<f64>() - 6.0;
                let seen: Vec<TrackObservation> = (0..60)
                    .map(|feature_id| {
                        let (x, y) = (10.0 * feature_id as f64, 400.0 * (feature_id as f64).sin().abs());
                        let pixel = Vector2::new(x + self.shift_px + noise(), y + noise());
                        TrackObservation { camera: 0, feature_id, pixel }
                    })
                    .collect();
                let factor = self.watch.note(self.now_ns, shown, &seen, 2.0);
                doubted += f64::from(u8::from(factor > 1.0)) / count as f64;
            }
            doubted
        }
    }

    #[test]
    fn who_rests_is_hardly_ever_doubted() {
        let mut most: f64 = 0.0;
        for seed in 0..5 {
            most = most.max(Scene::new(seed).play(300.0, 0.0, Shown::Rest));
        }
        assert!(most < 0.05, "{most}");
    }

    #[test]
    fn who_creeps_is_doubted_after_a_moment_and_until_it_stands() {
        for speed in [0.3, 0.6] {
            let mut scene = Scene::new(1);
            let at_once = scene.play(0.5, speed, Shown::Rest);
            assert!(at_once < 1e-9, "half a second does not tell");
            scene.play(4.0, speed, Shown::Rest);
            let creeping = scene.play(60.0, speed, Shown::Rest);
            assert!(creeping > 0.99, "{speed} px/s: {creeping}");
            scene.play(9.0, 0.0, Shown::Rest);
            let standing = scene.play(30.0, 0.0, Shown::Rest);
            assert!(standing < 0.01, "{standing}");
        }
    }

    #[test]
    fn a_nudge_is_doubt_and_a_drive_ends_it() {
        let mut scene = Scene::new(2);
        scene.play(5.0, 0.0, Shown::Rest);
        scene.play(0.1, 5.0, Shown::Motion { is_clear: false });
        assert!(scene.play(4.0, 0.0, Shown::Rest) > 0.99);
        scene.play(1.0, 50.0, Shown::Motion { is_clear: true });
        assert!(scene.play(4.0, 0.0, Shown::Rest) < 0.01);
        // One that brakes has not rested.
        scene.play(1.0, 50.0, Shown::Motion { is_clear: true });
        scene.play(0.4, 2.0, Shown::Motion { is_clear: false });
        assert!(scene.play(4.0, 0.0, Shown::Rest) < 0.01);
    }
}
