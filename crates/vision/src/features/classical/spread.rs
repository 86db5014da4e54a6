//! The best points of an image, but not all of them in one corner.
//!
//! The largest distance is searched at which a greedy choice (the best point first, none within the distance of one
//! already taken) still fills the quota.
//!
//! Source: Brown, Szeliski & Winder, CVPR 2005 (non-maximal suppression by distance); Bailo et al., PRL 2018 (search
//! over the distance).

/// Steps of the search; each halves the interval.
const SEARCH_STEPS: usize = 8;

/// Chooses up to `wanted` points.
///
/// # Arguments
/// * `points`: pixels, best first.
/// * `size`: columns and rows of the image.
/// * `spacing`: points are not asked to be farther apart than this (pixels).
///
/// # Returns
/// Indices, rising.
pub(super) fn spread(points: &[[f32; 2]], wanted: usize, size: [f32; 2], spacing: f32) -> Vec<usize> {
    let mut best: Vec<usize> = (0..points.len().min(wanted)).collect();
    if points.len() <= wanted {
        return best;
    }
    let (mut fills, mut too_far) = (0.0, 2.0 * spacing);
    for _ in 0..SEARCH_STEPS {
        let distance = 0.5 * (fills + too_far);
        let mut chosen = apart(points, distance, size);
        if chosen.len() < wanted {
            too_far = distance;
            continue;
        }
        chosen.truncate(wanted);
        best = chosen;
        fills = distance;
        if distance >= spacing {
            break;
        }
    }
    best
}

/// The points, best first, that have no better one within `distance`.
fn apart(points: &[[f32; 2]], distance: f32, size: [f32; 2]) -> Vec<usize> {
    // Of less than a pixel the cells would be too many, and points are hardly ever so close.
    let distance = distance.max(1.0);
    // In a cell of this side only one point has room, and those within the distance are at most two cells away.
    let side = distance / std::f32::consts::SQRT_2;
    let [columns, rows] = size.map(|pixels| (pixels / side) as usize + 1);
    let mut cells: Vec<Option<[f32; 2]>> = vec![None; columns * rows];
    let mut chosen = Vec::new();
    for (index, point) in points.iter().enumerate() {
        let [column, row] = point.map(|coordinate| (coordinate.max(0.0) / side) as usize);
        let (column, row) = (column.min(columns - 1), row.min(rows - 1));
        let (left, right) = (column.saturating_sub(2), (column + 3).min(columns));
        let near = (row.saturating_sub(2)..(row + 3).min(rows))
            .flat_map(|r| cells[r * columns + left..r * columns + right].iter().flatten());
        if near.into_iter().all(|other| squared_distance(*other, *point) >= distance * distance) {
            cells[row * columns + column] = Some(*point);
            chosen.push(index);
        }
    }
    chosen
}

fn squared_distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crowd_of_strong_points_leaves_room_for_weaker_ones() {
        let crowd = (0..400).map(|k| [10.0 + (k % 20) as f32, 10.0 + (k / 20) as f32]);
        let lone = (0..12).map(|k| [50.0 * (k % 4) as f32 + 40.0, 50.0 * (k / 4) as f32 + 60.0]);
        let points: Vec<[f32; 2]> = crowd.chain(lone).collect();
        let chosen = spread(&points, 20, [256.0, 256.0], 8.0);
        assert!(chosen.len() == 20 && chosen.is_sorted(), "{chosen:?}");
        assert!(chosen.iter().filter(|&&index| index >= 400).count() >= 10, "{chosen:?}");
        for (k, &a) in chosen.iter().enumerate() {
            assert!(chosen[..k].iter().all(|&b| squared_distance(points[a], points[b]) >= 4.0));
        }
    }

    #[test]
    fn without_spacing_the_best_are_taken() {
        let points: Vec<[f32; 2]> = (0..50).map(|k| [2.0 * k as f32, 3.0]).collect();
        assert_eq!(spread(&points, 7, [256.0, 256.0], 0.0), (0..7).collect::<Vec<_>>());
        assert_eq!(spread(&points, 90, [256.0, 256.0], 5.0), (0..50).collect::<Vec<_>>());
    }
}
