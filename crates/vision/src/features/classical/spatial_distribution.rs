//! Selection of strong keypoints distributed over the image.
//!
//! Bisection on the suppression distance: the largest one at which greedy selection (best point first, none within the
//! distance of one already selected) still fills the quota.
//!
//! Source: Brown, Szeliski & Winder, CVPR 2005 (non-maximal suppression by distance); Bailo et al., PRL 2018 (search
//! over the distance).

/// Steps of the bisection.
const SEARCH_STEPS: usize = 8;

/// Selects up to `wanted` points.
///
/// # Arguments
/// * `points`: pixels, best first.
/// * `size`: columns and rows of the image.
/// * `spacing`: maximum suppression distance, pixels.
///
/// # Returns
/// Indices in ascending order.
pub(super) fn select_distributed(
    points: &[[f32; 2]],
    wanted: usize,
    size: [f32; 2],
    spacing: f32,
) -> Vec<usize> {
    let mut best: Vec<usize> = (0..points.len().min(wanted)).collect();
    if points.len() <= wanted {
        return best;
    }
    let (mut fills, mut too_far) = (0.0, 2.0 * spacing);
    for _ in 0..SEARCH_STEPS {
        let distance = 0.5 * (fills + too_far);
        let mut selected = suppress_within(points, distance, size);
        if selected.len() < wanted {
            too_far = distance;
            continue;
        }
        selected.truncate(wanted);
        best = selected;
        fills = distance;
        if distance >= spacing {
            break;
        }
    }
    best
}

/// Indices of the points, best first, without a better one within `distance`.
fn suppress_within(points: &[[f32; 2]], distance: f32, size: [f32; 2]) -> Vec<usize> {
    // Bounds the number of cells.
    let distance = distance.max(1.0);
    // A cell of this side holds at most one point, and points within the distance are at most two cells away.
    let side = distance / std::f32::consts::SQRT_2;
    let [columns, rows] = size.map(|pixels| (pixels / side) as usize + 1);
    let mut cells: Vec<Option<[f32; 2]>> = vec![None; columns * rows];
    let mut selected = Vec::new();
    for (index, point) in points.iter().enumerate() {
        let [column, row] = point.map(|coordinate| (coordinate.max(0.0) / side) as usize);
        let (column, row) = (column.min(columns - 1), row.min(rows - 1));
        let (left, right) = (column.saturating_sub(2), (column + 3).min(columns));
        let near = (row.saturating_sub(2)..(row + 3).min(rows))
            .flat_map(|r| cells[r * columns + left..r * columns + right].iter().flatten());
        if near.into_iter().all(|other| squared_distance(*other, *point) >= distance * distance) {
            cells[row * columns + column] = Some(*point);
            selected.push(index);
        }
    }
    selected
}

fn squared_distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cluster_of_strong_points_leaves_room_for_weaker_ones() {
        let crowd = (0..400).map(|k| [10.0 + (k % 20) as f32, 10.0 + (k / 20) as f32]);
        let lone = (0..12).map(|k| [50.0 * (k % 4) as f32 + 40.0, 50.0 * (k / 4) as f32 + 60.0]);
        let points: Vec<[f32; 2]> = crowd.chain(lone).collect();
        let selected = select_distributed(&points, 20, [256.0, 256.0], 8.0);
        assert!(selected.len() == 20 && selected.is_sorted(), "{selected:?}");
        assert!(selected.iter().filter(|&&index| index >= 400).count() >= 10, "{selected:?}");
        for (k, &a) in selected.iter().enumerate() {
            assert!(selected[..k].iter().all(|&b| squared_distance(points[a], points[b]) >= 4.0));
        }
    }

    #[test]
    fn without_spacing_the_best_are_taken() {
        let points: Vec<[f32; 2]> = (0..50).map(|k| [2.0 * k as f32, 3.0]).collect();
        assert_eq!(select_distributed(&points, 7, [256.0, 256.0], 0.0), (0..7).collect::<Vec<_>>());
        assert_eq!(select_distributed(&points, 90, [256.0, 256.0], 5.0), (0..50).collect::<Vec<_>>());
    }
}
