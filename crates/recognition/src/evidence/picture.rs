//! What one picture that repeats could explain of the matches of a place.

use nalgebra::Vector3;

/// Distance of the corners of a thing that a building has more than once from its middle, metres: of a door, a poster, the face of a
/// shelf.
const RADIUS_M: f64 = 1.3;
/// Error of the position of a landmark in a map, as a part of its distance from the camera.
const DEPTH_ERROR: f64 = 0.05;
/// Inliers that are tried as the middle, at most, evenly among all.
const MAX_TRIED: usize = 64;

/// The picture that explains most inliers of a place.
pub(super) struct Picture {
    centre: Vector3<f64>,
    radius: f64,
}

impl Picture {
    /// The picture around one of the inliers in which most of them are. `None` without inliers.
    ///
    /// # Arguments
    /// * `inliers`: their landmarks in G, metres.
    /// * `camera_in_global`: metres.
    pub fn of_most(inliers: &[Vector3<f64>], camera_in_global: &Vector3<f64>) -> Option<Self> {
        let step = inliers.len().div_ceil(MAX_TRIED).max(1);
        let around = |centre: &Vector3<f64>| {
            let radius = RADIUS_M + DEPTH_ERROR * (centre - camera_in_global).norm();
            let picture = Self { centre: *centre, radius };
            (inliers.iter().filter(|inlier| picture.contains(inlier)).count(), picture)
        };
        let pictures = inliers.iter().step_by(step).map(around);
        // Of equal ones the first.
        let best = pictures.reduce(|best, next| if next.0 > best.0 { next } else { best });
        best.map(|(_, picture)| picture)
    }

    /// Whether a point in G (metres) may be of it.
    pub fn contains(&self, in_global: &Vector3<f64>) -> bool {
        (in_global - self.centre).norm() <= self.radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_is_where_most_inliers_are() {
        let wall =
            |x: f64, count: usize| (0..count).map(move |k| Vector3::new(x + 0.01 * k as f64, 4.0, 0.0));
        let inliers: Vec<Vector3<f64>> = wall(0.0, 20).chain(wall(5.0, 60)).chain(wall(9.0, 30)).collect();
        let picture = Picture::of_most(&inliers, &Vector3::zeros()).unwrap();
        assert!(inliers.iter().enumerate().all(|(k, at)| picture.contains(at) == (20..80).contains(&k)));
        assert!(Picture::of_most(&[], &Vector3::zeros()).is_none());
    }

    #[test]
    fn farther_landmarks_may_be_off_by_more() {
        let size_at = |depth: f64| {
            let at = |x: f64| Vector3::new(x, depth, 0.0);
            let picture = Picture::of_most(&[at(0.0)], &Vector3::zeros()).unwrap();
            (0..1000).filter(|k| picture.contains(&at(0.01 * f64::from(*k)))).count()
        };
        assert!(size_at(20.0) > size_at(2.0) + 80);
    }
}
