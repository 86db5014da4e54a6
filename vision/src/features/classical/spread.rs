//! The best points of an image, but not all of them in one corner.
//!
//! The largest distance is searched at which a greedy choice (the best point first, none within the distance of one
//! already taken) still fills the quota.
//!
//! Source: Brown, Szeliski & Winder, CVPR 2005 (non-maximal suppression by distance); Bailo et al., PRL 2018 (search
//! over the distance).

/// Steps of the search; each halves the interval.
const SEARCH_STEPS: usize = 12;

/// Chooses up to `wanted` points.
///
/// # Arguments
/// * `points`: pixels, best first, all within `width` and `height`.
/// * `largest`: no distance beyond this (pixels) is asked for.
///
/// # Returns
/// Indices, rising.
pub(super) fn spread(points: &[[f32; 2]], wanted: usize, width: f32, height: f32, largest: f32) -> Vec<usize> {
    if points.len() <= wanted {
        return (0..points.len()).collect();
    }
    let (mut low, mut high) = (0.0, largest);
    let mut best: Vec<usize> = (0..wanted).collect();
    for _ in 0..SEARCH_STEPS {
        let distance = 0.5 * (low + high);
        let mut chosen = apart(points, distance, width, height);
        if chosen.len() >= wanted {
            chosen.truncate(wanted);
            best = chosen;
            low = distance;
        } else {
            high = distance;
        }
    }
    best
}

/// The points, best first, that have no better one within `distance`.
fn apart(points: &[[f32; 2]], distance: f32, width: f32, height: f32) -> Vec<usize> {
    // In a cell of this side only one point has room.
    let side = (distance / std::f32::consts::SQRT_2).max(1e-3);
    let columns = (width / side) as usize + 1;
    let rows = (height / side) as usize + 1;
    if distance < 1.0 {
        return (0..points.len()).collect();
    }
    let mut cells = vec![usize::MAX; columns * rows];
    let mut chosen = Vec::new();
    for (index, &[x, y]) in points.iter().enumerate() {
        let column = ((x.max(0.0) / side) as usize).min(columns - 1);
        let row = ((y.max(0.0) / side) as usize).min(rows - 1);
        let taken = (row.saturating_sub(2)..(row + 3).min(rows)).any(|r| {
            cells[r * columns + column.saturating_sub(2)..r * columns + (column + 3).min(columns)]
                .iter()
                .filter_map(|&other| points.get(other))
                .any(|other| (other[0] - x).powi(2) + (other[1] - y).powi(2) < distance * distance)
        });
        if !taken {
            cells[row * columns + column] = index;
            chosen.push(index);
        }
    }
    chosen
}
