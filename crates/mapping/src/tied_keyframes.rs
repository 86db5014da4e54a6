//! Which keyframes of a stored map are tied to a recording or another map: those that it shows again.

use std::collections::BTreeSet;

use super::places::StoredPlace;

/// Keyframes of a map that are tied, at most: the covariance of their poses is a dense matrix that is inverted.
pub(super) const MOST_TIED: usize = 600;
/// The golden ratio's fractional part: multiples of it are spread evenly, however many there are.
const SPREAD: f64 = 0.618_033_988_749_895;

/// Chooses the places that are used: all, as long as the keyframes that they tie are not too many, else some of them along the
/// whole recording. The others are not used: the map stays less certain than it could be, and says so.
///
/// # Arguments
/// * `places`: the first one is kept in any case, as are those that tie no further keyframe.
/// * `views_of`: the views of the stored keyframes that a place ties.
///
/// # Returns
/// The places, in their order, and the views that they tie.
pub(super) fn choose_places(
    places: Vec<StoredPlace>,
    most: usize,
    views_of: impl Fn(&StoredPlace) -> BTreeSet<usize>,
) -> (Vec<StoredPlace>, BTreeSet<usize>) {
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_by(|a, b| (*a as f64 * SPREAD).fract().total_cmp(&(*b as f64 * SPREAD).fract()));
    let (mut tied, mut kept) = (BTreeSet::new(), BTreeSet::new());
    for at in order {
        let of_place = views_of(&places[at]);
        let new = of_place.difference(&tied).count();
        if at == 0 || new == 0 || tied.len() + new <= most {
            tied.extend(of_place);
            kept.insert(at);
        }
    }
    let is_kept = |(at, place)| kept.contains(&at).then_some(place);
    (places.into_iter().enumerate().filter_map(is_kept).collect(), tied)
}

#[cfg(test)]
mod tests {
    use adjustment::RelativePose;
    use geometry::pose::Pose;
    use nalgebra::Matrix6;

    use super::*;

    /// Places of consecutive views, each of which ties two keyframes that no other ties.
    fn places(count: usize) -> Vec<StoredPlace> {
        let relative = |view| RelativePose {
            views: [1000 + 2 * view, view],
            first_from_second: Pose::identity(),
            information: Matrix6::identity(),
        };
        (0..count)
            .map(|view| StoredPlace { relative: relative(view), matches: Vec::new(), is_told_apart: true })
            .collect()
    }

    fn pair_of(place: &StoredPlace) -> BTreeSet<usize> {
        let [stored, _] = place.relative.views;
        BTreeSet::from([stored, stored + 1])
    }

    #[test]
    fn all_places_are_used_where_they_tie_few_keyframes() {
        let (kept, tied) = choose_places(places(30), 60, pair_of);
        assert_eq!((kept.len(), tied.len()), (30, 60));
    }

    #[test]
    fn where_they_tie_too_many_some_along_the_whole_recording_are_used() {
        let (kept, tied) = choose_places(places(90), 60, pair_of);
        assert_eq!((kept.len(), tied.len()), (30, 60));
        let views: Vec<usize> = kept.iter().map(|place| place.relative.views[1]).collect();
        assert!(views[0] == 0 && views.is_sorted());
        let widest = views.windows(2).map(|pair| pair[1] - pair[0]).max();
        assert!(widest.is_some_and(|gap| gap <= 5), "{views:?}");
    }

    #[test]
    fn the_first_place_and_those_that_tie_no_further_keyframe_are_used_in_any_case() {
        let of_place = |place: &StoredPlace| BTreeSet::from([place.relative.views[1] / 10, 7, 8, 9]);
        let (kept, tied) = choose_places(places(50), 3, of_place);
        assert_eq!((kept.len(), tied.len()), (10, 4));
    }
}
