//! Places: groups of keyframes that are near each other and look the same way.
//!
//! Some keyframes are the middles of places, no two of them within the radius of a place, and each keyframe belongs to the middle that is
//! nearest. So there are as many places as fit into what was visited, however often it is, and next to none is new once robots have come
//! there: a grid has cells at the borders of what is visited that a robot enters now and then. The oldest keyframes are middles, so that
//! places stay what they are while their middles stay.

use std::collections::BTreeMap;

use geometry::Viewpoint;
use map::Keyframe;

use crate::position_grid::PositionGrid;
use crate::settings::Settings;

/// A place, by positions of keyframes in the map.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) middle: usize,
    /// All of its keyframes, in order.
    pub(crate) keyframes: Vec<usize>,
}

/// The places of a map.
///
/// # Arguments
/// * `keyframes`: in the order of their ids, by which they entered the map.
pub(crate) fn places(keyframes: &[Keyframe], settings: &Settings) -> Vec<Place> {
    let views: Vec<Viewpoint> = keyframes.iter().map(Keyframe::viewpoint).collect();
    let mut middles = Middles { settings, views: &views, grid: PositionGrid::new(settings.place_m) };
    for (at, view) in views.iter().enumerate() {
        if middles.around(view).next().is_none() {
            middles.insert(at);
        }
    }
    let mut places: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (at, view) in views.iter().enumerate() {
        let nearest = middles.around(view).min_by(|a, b| a.1.total_cmp(&b.1));
        places.entry(nearest.map_or(at, |(middle, _)| middle)).or_default().push(at);
    }
    places.into_iter().map(|(middle, keyframes)| Place { middle, keyframes }).collect()
}

/// The middles of places, by cubes with the radius of a place as their side.
struct Middles<'a> {
    settings: &'a Settings,
    views: &'a [Viewpoint],
    grid: PositionGrid<usize>,
}

impl Middles<'_> {
    fn insert(&mut self, view: usize) {
        self.grid.insert(&self.views[view].position, view);
    }

    /// Those within the radius of a place, with their distance in radii: the larger one of distance and angle.
    fn around(&self, view: &Viewpoint) -> impl Iterator<Item = (usize, f64)> {
        let (position, axis) = (view.position, view.axis);
        self.grid.around(&position).filter_map(move |&other| {
            let of = &self.views[other];
            let distance = (of.position - position).norm() / self.settings.place_m;
            let radii = distance.max(of.axis.angle(&axis) / self.settings.place_rad);
            (radii <= 1.0).then_some((other, radii))
        })
    }
}
