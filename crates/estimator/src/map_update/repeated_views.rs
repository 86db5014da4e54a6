//! Answers to images from one place.
//!
//! The pixels of a map are measured once, and those of images from the same place are nearly the same ones. A robot that stands in a dock asks
//! twice a second for hours, and its answers are not independent: with pixels of noise `c^2` that all of them have in common and `q^2` of each,
//! `N` answers know as much as one with the variance `c^2 + q^2 / N`, and so at most twice as much as the first where both are alike. The answer
//! number `n` from a place counts `1 / n^2` times: all of them count 1.64 times.

use crate::KeyframeId;
use geometry::Pose;

/// Images are from one place if the camera has moved less than this in between, in parts of the distance of what it sees.
const NEAR: f64 = 0.02;
/// And turned by less than this, rad.
const TURNED_RAD: f64 = 0.05;
/// Places that are remembered: one for each camera and keyframe.
const MOST: usize = 16;

/// What tells the views of one place from each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct View {
    /// Camera of the image.
    pub(crate) camera: usize,
    /// The keyframe that shows most of it.
    pub(crate) keyframe: KeyframeId,
    /// IMU pose in L at the image.
    pub(crate) local_from_imu: Pose,
    /// Distance of what it sees, metres.
    pub(crate) depth_m: f64,
}

impl View {
    fn is_repeated_by(&self, other: &Self) -> bool {
        let apart = self.local_from_imu.local(&other.local_from_imu);
        let (turned, moved) = (apart.fixed_rows::<3>(0).norm(), apart.fixed_rows::<3>(3).norm());
        turned < TURNED_RAD && moved < NEAR * other.depth_m
    }

    fn is_alike(&self, other: &Self) -> bool {
        (self.camera, self.keyframe) == (other.camera, other.keyframe)
    }
}

/// The views of the answers that were used, as long as the robot is where it was.
#[derive(Clone, Debug, Default)]
pub(crate) struct RepeatedViews {
    /// The first view of each place, and how many answers there were since.
    views: Vec<(View, u32)>,
}

impl RepeatedViews {
    /// How much an answer counts.
    pub(crate) fn weight(&self, view: &View) -> f64 {
        let before = self.views.iter().find(|(known, _)| known.is_alike(view) && known.is_repeated_by(view));
        before.map_or(1.0, |(_, answers)| f64::from(answers.saturating_add(1)).powi(-2))
    }

    /// What the answers told holds no longer, or is less certain.
    pub(crate) fn clear(&mut self) {
        self.views.clear();
    }

    /// Notes an answer that was used.
    pub(crate) fn note(&mut self, view: &View) {
        self.views.retain(|(known, _)| known.is_repeated_by(view));
        if let Some((_, answers)) = self.views.iter_mut().find(|(known, _)| known.is_alike(view)) {
            *answers = answers.saturating_add(1);
        } else {
            if self.views.len() == MOST {
                self.views.remove(0);
            }
            self.views.push((*view, 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn view(camera: usize, keyframe: u64, x: f64) -> View {
        let local_from_imu = Pose { translation: Vector3::x() * x, ..Pose::identity() };
        View { camera, keyframe, local_from_imu, depth_m: 3.0 }
    }

    #[test]
    fn answers_from_one_place_count_for_less_than_two() {
        let (mut views, mut all) = (RepeatedViews::default(), 0.0);
        for step in 0..1000 {
            let view = view(0, 7, 1e-3 * f64::from(step % 5));
            all += views.weight(&view);
            views.note(&view);
        }
        assert!((1.6..1.65).contains(&all), "{all}");
    }

    #[test]
    fn other_keyframes_cameras_and_places_count_by_themselves() {
        let mut views = RepeatedViews::default();
        views.note(&view(0, 7, 0.0));
        assert!((views.weight(&view(0, 7, 0.01)) - 0.25).abs() < 1e-12);
        for other in [view(1, 7, 0.0), view(0, 8, 0.0), view(0, 7, 0.1)] {
            assert!(views.weight(&other) >= 1.0);
        }
        // It is not where it was, also when it comes back: the next images differ from the first ones.
        views.note(&view(0, 7, 1.0));
        assert!(views.weight(&view(0, 7, 0.0)) >= 1.0);
    }
}
