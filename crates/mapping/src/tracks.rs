//! Joining pairwise matches into tracks over many keyframes.

use std::collections::HashSet;

use super::keyframe_view::{FeatureId, KeyframeView};
use super::matching::FeatureMatch;

/// Joins matched features into tracks with at most one feature a view, matches of smallest distance first.
///
/// A match that would put two features of one view into a track contradicts the matches of smaller distance before it, and is
/// dropped.
///
/// # Arguments
/// * `feature_counts`: number of features of each view.
///
/// # Returns
/// Tracks of at least two features, each ordered by view, in the order of their first feature.
pub(super) fn chain(feature_counts: &[usize], mut matches: Vec<FeatureMatch>) -> Vec<Vec<FeatureId>> {
    matches.sort_by(|a, b| {
        a.distance.total_cmp(&b.distance).then(a.first.cmp(&b.first)).then(a.second.cmp(&b.second))
    });
    let mut forest = Forest::new(feature_counts);
    for found in &matches {
        forest.join(found.first, found.second);
    }
    let mut tracks: Vec<Vec<FeatureId>> =
        forest.members.into_iter().filter(|members| members.len() >= 2).collect();
    tracks.sort();
    tracks
}

/// Features in no track that are matched in the second camera: landmarks of one view each.
pub(super) fn stereo_singles(views: &[KeyframeView<'_>], tracks: &[Vec<FeatureId>]) -> Vec<Vec<FeatureId>> {
    let tracked: HashSet<FeatureId> = tracks.iter().flatten().copied().collect();
    let of_view = |(index, view): (usize, &KeyframeView<'_>)| -> Vec<FeatureId> {
        let alone =
            |feature: &FeatureId| view.stereo_pixel(feature.1).is_some() && !tracked.contains(feature);
        (0..view.features.len()).map(|feature| (index, feature)).filter(alone).collect()
    };
    views.iter().enumerate().flat_map(of_view).map(|feature| vec![feature]).collect()
}

/// Disjoint sets of features.
struct Forest {
    /// Number of features before each view.
    offsets: Vec<usize>,
    /// Parent of each feature; a root is its own parent.
    parent: Vec<usize>,
    /// The features of each root, ordered by view; empty for all that are no roots.
    members: Vec<Vec<FeatureId>>,
}

impl Forest {
    fn new(feature_counts: &[usize]) -> Forest {
        let mut offsets = Vec::with_capacity(feature_counts.len());
        let mut members = Vec::new();
        for (view, &count) in feature_counts.iter().enumerate() {
            offsets.push(members.len());
            members.extend((0..count).map(|feature| vec![(view, feature)]));
        }
        Forest { offsets, parent: (0..members.len()).collect(), members }
    }

    fn root(&mut self, (view, feature): FeatureId) -> usize {
        let mut node = self.offsets[view] + feature;
        while self.parent[node] != node {
            self.parent[node] = self.parent[self.parent[node]];
            node = self.parent[node];
        }
        node
    }

    fn join(&mut self, a: FeatureId, b: FeatureId) {
        let (a, b) = (self.root(a), self.root(b));
        if a == b || share_a_view(&self.members[a], &self.members[b]) {
            return;
        }
        let (large, small) = if self.members[a].len() >= self.members[b].len() { (a, b) } else { (b, a) };
        let joined = std::mem::take(&mut self.members[small]);
        self.members[large].extend(joined);
        self.members[large].sort_unstable();
        self.parent[small] = large;
    }
}

/// Whether two lists, ordered by view, name the same view.
fn share_a_view(a: &[FeatureId], b: &[FeatureId]) -> bool {
    let (mut i, mut j) = (0, 0);
    while i < a.len() && j < b.len() {
        match a[i].0.cmp(&b[j].0) {
            std::cmp::Ordering::Less => i += 1,
            std::cmp::Ordering::Greater => j += 1,
            std::cmp::Ordering::Equal => return true,
        }
    }
    false
}
