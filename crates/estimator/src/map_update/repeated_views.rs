//! Answers to images from one place.
//!
//! The pixels of a map are measured once, and those of images from the same place are nearly the same ones. A robot that stands in a dock asks
//! twice a second for hours, and its answers are not independent: with pixels of noise `c^2` that all of them have in common and `q^2` of each,
//! `N` answers know as much as one with the variance `c^2 + q^2 / N`, and so at most twice as much as the first where both are alike. The answer
//! number `n` from a place counts `1 / n^2` times: all of them count 1.64 times.
//!
//! That holds for what the state still knows of them: where it has become much less certain since, by drift or by a failure of odometry, the next
//! answer is a first one again. With steps of [`FORGOTTEN`] a standing robot is as uncertain as one or two answers leave it, however long it stands.

use crate::KeyframeId;
use geometry::Pose;
use smallvec::SmallVec;

/// Images are from one place if the camera has moved less than this in between, in parts of the distance of what it sees.
const NEAR: f64 = 0.02;
/// And turned by less than this, rad.
const TURNED_RAD: f64 = 0.05;
/// Places that are remembered: one for each camera, and for keyframes that no answer has in common.
const MOST: usize = 64;
/// Growth of a standard deviation with which the state has forgotten the answers from a place.
const FORGOTTEN: f64 = 1.5;

/// What tells the views of one place from each other.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct View {
    /// Camera of the image.
    pub(crate) camera: usize,
    /// The keyframes that the answer is used with.
    pub(crate) keyframes: SmallVec<[KeyframeId; 8]>,
    /// IMU pose in L at the image.
    pub(crate) local_from_imu: Pose,
    /// Distance of what it sees, metres.
    pub(crate) depth_m: f64,
}

impl View {
    fn is_near(&self, other: &Self) -> bool {
        let apart = self.local_from_imu.local(&other.local_from_imu);
        let (turned, moved) = (apart.fixed_rows::<3>(0).norm(), apart.fixed_rows::<3>(3).norm());
        turned < TURNED_RAD && moved < NEAR * self.depth_m
    }

    /// Whether pixels of both, of the image and of the map, may be the same ones.
    fn is_alike(&self, other: &Self) -> bool {
        self.camera == other.camera
            && self.keyframes.iter().any(|keyframe| other.keyframes.contains(keyframe))
    }
}

/// A view, and the answers to it.
#[derive(Clone, Debug)]
struct AnsweredView {
    /// The first of them, with the keyframes of all.
    first: View,
    answers: u32,
    /// The least standard deviations of the pose in G after any of them: rad, metres.
    sigmas: (f64, f64),
}

impl AnsweredView {
    /// Both as one: seen from where the older one was.
    fn together(self, older: Self) -> Self {
        let mut first = older.first;
        for keyframe in self.first.keyframes {
            if !first.keyframes.contains(&keyframe) {
                first.keyframes.push(keyframe);
            }
        }
        Self {
            first,
            answers: self.answers.max(older.answers),
            sigmas: (self.sigmas.0.min(older.sigmas.0), self.sigmas.1.min(older.sigmas.1)),
        }
    }

    /// Whether a state with these standard deviations knows less than the answers told.
    fn is_forgotten(&self, sigmas: (f64, f64)) -> bool {
        sigmas.0 > FORGOTTEN * self.sigmas.0 || sigmas.1 > FORGOTTEN * self.sigmas.1
    }
}

/// The views of the answers that were used, as long as the robot is where it was. The newest one is the last.
#[derive(Clone, Debug, Default)]
pub(crate) struct RepeatedViews {
    views: Vec<AnsweredView>,
}

impl RepeatedViews {
    /// How much an answer counts; views of other places are forgotten, and those of which the state knows less than they told.
    ///
    /// # Arguments
    /// * `sigmas`: standard deviations of the pose in G before it: rad, metres.
    pub(crate) fn weight(&mut self, view: &View, sigmas: (f64, f64)) -> f64 {
        self.views.retain(|known| known.first.is_near(view) && !known.is_forgotten(sigmas));
        let alike = self.views.iter().filter(|known| known.first.is_alike(view));
        let answers = alike.map(|known| known.answers).max().unwrap_or(0);
        f64::from(answers.saturating_add(1)).powi(-2)
    }

    /// Notes an answer that was used.
    ///
    /// # Arguments
    /// * `sigmas`: standard deviations of the pose in G after it.
    pub(crate) fn note(&mut self, view: &View, sigmas: (f64, f64)) {
        // An answer with keyframes of several makes them one.
        let (alike, others): (Vec<_>, Vec<_>) =
            self.views.drain(..).partition(|known| known.first.is_alike(view));
        self.views = others;
        let new = AnsweredView { first: view.clone(), answers: 0, sigmas };
        let mut answered = alike.into_iter().fold(new, AnsweredView::together);
        answered.answers = answered.answers.saturating_add(1);
        if self.views.len() == MOST {
            self.views.remove(0);
        }
        self.views.push(answered);
    }

    /// What the answers told holds no longer.
    pub(crate) fn clear(&mut self) {
        self.views.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    const SIGMAS: (f64, f64) = (0.01, 0.05);

    fn view(camera: usize, keyframe: u64, x: f64) -> View {
        let local_from_imu = Pose { translation: Vector3::x() * x, ..Pose::identity() };
        View { camera, keyframes: SmallVec::from_slice(&[keyframe]), local_from_imu, depth_m: 3.0 }
    }

    fn answered(views: &mut RepeatedViews, view: &View) -> f64 {
        let weight = views.weight(view, SIGMAS);
        views.note(view, SIGMAS);
        weight
    }

    #[test]
    fn answers_from_one_place_count_for_less_than_two() {
        let mut views = RepeatedViews::default();
        let all: f64 =
            (0..1000).map(|step| answered(&mut views, &view(0, 7, 1e-3 * f64::from(step % 5)))).sum();
        assert!((1.6..1.65).contains(&all), "{all}");
    }

    #[test]
    fn other_keyframes_cameras_and_places_count_by_themselves() {
        let mut views = RepeatedViews::default();
        answered(&mut views, &view(0, 7, 0.0));
        for other in [view(1, 7, 0.0), view(0, 8, 0.0)] {
            assert!(answered(&mut views, &other) >= 1.0);
        }
        assert!((views.weight(&view(0, 7, 0.01), SIGMAS) - 0.25).abs() < 1e-12);
        assert!(answered(&mut views, &view(0, 7, 0.1)) >= 1.0);
        // It is not where it was, also when it comes back: the next images differ from the first ones.
        assert!(answered(&mut views, &view(0, 7, 0.0)) >= 1.0);
    }

    /// The keyframes of a dock: each answer is used with some of them, and another one shows most of it.
    #[test]
    fn answers_that_share_a_keyframe_count_for_less_than_two_whichever_is_the_best() {
        let mut views = RepeatedViews::default();
        let used = [[7, 8, 9], [8, 9, 10], [9, 10, 7], [10, 7, 8]];
        let all: f64 = (0..400)
            .map(|step| {
                let keyframes = SmallVec::from_slice(&used[step % 4]);
                answered(&mut views, &View { keyframes, ..view(0, 0, 0.0) })
            })
            .sum();
        assert!((1.6..1.65).contains(&all), "{all}");
        assert!(answered(&mut views, &view(0, 11, 0.0)) >= 1.0);
    }

    #[test]
    fn keyframes_that_take_turns_are_remembered() {
        let mut views = RepeatedViews::default();
        let turns = (0..400).map(|step| answered(&mut views, &view(step % 4, (step % 5) as u64, 0.0)));
        assert!(turns.sum::<f64>() < 20.0 * 1.65);
    }

    /// A random walk of the state between answers of 5 cm, for an hour: it stays within what two answers leave and what is forgotten.
    #[test]
    fn a_robot_that_stands_for_an_hour_is_corrected_all_the_time() {
        let (of_answer, walk) = (0.05_f64, 0.004_f64);
        let mut views = RepeatedViews::default();
        let mut variance = of_answer.powi(2);
        let place = view(0, 7, 0.0);
        views.note(&place, (0.01, variance.sqrt()));
        for _ in 0..7200 {
            variance += walk.powi(2);
            let weight = views.weight(&place, (0.01, variance.sqrt()));
            variance = (variance.recip() + weight / of_answer.powi(2)).recip();
            views.note(&place, (0.01, variance.sqrt()));
            let sigma = variance.sqrt();
            assert!((0.55 * of_answer..FORGOTTEN * of_answer).contains(&sigma), "{sigma}");
        }
    }
}
