//! A correlation function of the distance that is exactly zero beyond some distance.
//!
//! Source: Gaspari & Cohn, "Construction of correlation functions in two and three dimensions", QJRMS 1999, eq. 4.10.

use nalgebra::Vector3;

/// Distances of pairs that are compared, at most: 16 MB.
const MOST_DISTANCES: usize = 1 << 21;
/// Of more pairs, those of so many positions are taken, evenly among all, each with as many others as that leaves.
const MOST_SOURCES: usize = 1 << 11;

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
        let mut distances = distances(positions, MOST_DISTANCES);
        // Of each position with the others.
        let part = neighbours as f64 / (positions.len() - 1) as f64;
        let wanted = ((part * distances.len() as f64).round() as usize).min(distances.len() - 1);
        let (_, support, _) = distances.select_nth_unstable_by(wanted, f64::total_cmp);
        Taper { support: support.max(f64::MIN_POSITIVE) }
    }

    /// The part that is kept: 1 at distance 0, with slope 0 there.
    pub(super) fn kept(self, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        gaspari_cohn(2.0 * (a - b).norm() / self.support)
    }
}

/// Distances of pairs of positions (m): all, or of too many a part that stands for all.
///
/// # Arguments
/// * `most`: how many, at most.
fn distances(positions: &[Vector3<f64>], most: usize) -> Vec<f64> {
    let count = positions.len();
    let mut distances = Vec::new();
    if count.saturating_mul(count - 1) / 2 <= most {
        for (index, position) in positions.iter().enumerate() {
            distances.extend(positions[..index].iter().map(|other| (position - other).norm()));
        }
        return distances;
    }
    let sources = count.min(MOST_SOURCES).min(most);
    let step = count.div_ceil(most / sources);
    for source in 0..sources {
        let own = source * count / sources;
        // Each begins with another one, at random, so that no distance along a trajectory is left out.
        let begin = source.wrapping_mul(2_654_435_761) / 65_536 % step;
        let others = (begin..count).step_by(step).filter(|other| *other != own);
        distances.extend(others.map(|other| (positions[own] - positions[other]).norm()));
    }
    distances
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive up and down the aisles of a hall, one keyframe each half a metre, 3 m between aisles of 60 m.
    fn drive(count: usize) -> Vec<Vector3<f64>> {
        let position = |at: usize| {
            let (aisle, along) = (at / 120, at % 120);
            let along = if aisle.is_multiple_of(2) { along } else { 119 - along };
            Vector3::new(0.5 * along as f64, 3.0 * aisle as f64, 0.0)
        };
        (0..count).map(position).collect()
    }

    fn mean_neighbours(positions: &[Vector3<f64>], taper: Taper) -> f64 {
        let near = |position: &Vector3<f64>| {
            positions.iter().filter(|other| (position - *other).norm() < taper.support).count() - 1
        };
        // Every 13th: there are 120 in an aisle.
        let counts: Vec<usize> = positions.iter().step_by(13).map(near).collect();
        counts.iter().sum::<usize>() as f64 / counts.len() as f64
    }

    #[test]
    fn a_keyframe_of_a_large_map_has_as_many_neighbours_with_a_bounded_sample_of_distances() {
        for (count, wanted) in [(300, 40), (3000, 40), (20_000, 60)] {
            let positions = drive(count);
            let sampled = distances(&positions, MOST_DISTANCES).len();
            assert!(sampled <= MOST_DISTANCES && sampled > MOST_DISTANCES.min(count * (count - 1) / 2) / 2);
            let found = mean_neighbours(&positions, Taper::with_mean_neighbours(&positions, wanted));
            // Distances in a grid come in steps.
            assert!((found / wanted as f64 - 1.0).abs() < 0.12, "{found} of {wanted}, {count} keyframes");
        }
    }
}
