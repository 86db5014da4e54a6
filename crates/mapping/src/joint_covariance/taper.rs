//! A correlation function of the distance that is exactly zero beyond some distance.
//!
//! Source: Gaspari & Cohn, "Construction of correlation functions in two and three dimensions", QJRMS 1999, eq. 4.10.

use nalgebra::Vector3;

/// How much of a covariance of two keyframes is kept, by their distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Taper {
    /// Distance from which on nothing is kept (m).
    support: f64,
}

impl Taper {
    /// The taper that leaves a keyframe so many others on average.
    ///
    /// # Arguments
    /// * `positions`: at least two (m).
    pub(super) fn with_mean_neighbours(positions: &[Vector3<f64>], neighbours: usize) -> Taper {
        let mut distances: Vec<f64> = Vec::new();
        for (index, position) in positions.iter().enumerate() {
            distances.extend(positions[..index].iter().map(|other| (position - other).norm()));
        }
        let wanted = (positions.len() * neighbours / 2).min(distances.len() - 1);
        let (_, support, _) = distances.select_nth_unstable_by(wanted, f64::total_cmp);
        Taper { support: support.max(f64::MIN_POSITIVE) }
    }

    /// The part that is kept: 1 at distance 0, with slope 0 there.
    pub(super) fn kept(self, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        gaspari_cohn(2.0 * (a - b).norm() / self.support)
    }
}

/// A correlation function in three dimensions: 1 at 0, falling, exactly 0 from 2 on.
fn gaspari_cohn(z: f64) -> f64 {
    let polynomial = |coefficients: [f64; 6]| coefficients.iter().rev().fold(0.0, |sum, c| sum * z + c);
    if z < 1.0 {
        polynomial([1.0, 0.0, -5.0 / 3.0, 5.0 / 8.0, 1.0 / 2.0, -1.0 / 4.0])
    } else if z < 2.0 {
        (polynomial([4.0, -5.0, 5.0 / 3.0, 5.0 / 8.0, -1.0 / 2.0, 1.0 / 12.0]) - 2.0 / (3.0 * z)).max(0.0)
    } else {
        0.0
    }
}
