//! Joining pairwise matches into tracks over many keyframes.

use std::collections::HashSet;

use super::keyframe_view::{FeatureId, KeyframeView};
use super::matching::FeatureMatch;

/// Joins matched features into tracks with at most one feature an image, matches of smallest distance first.
///
/// A match that would put two features of one image into a track contradicts the matches of smaller distance before it, and is
/// dropped.
///
/// # Arguments
/// * `feature_counts`: number of features of each image of each view.
///
/// # Returns
/// Tracks of at least two features, each ordered by view, in the order of their first feature.
pub(super) fn chain(feature_counts: &[Vec<usize>], mut matches: Vec<FeatureMatch>) -> Vec<Vec<FeatureId>> {
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

/// Features in no track that are matched in the second camera: landmarks of one image each.
pub(super) fn stereo_singles(views: &[KeyframeView<'_>], tracks: &[Vec<FeatureId>]) -> Vec<Vec<FeatureId>> {
    let tracked: HashSet<FeatureId> = tracks.iter().flatten().copied().collect();
    let of_view = |(index, view): (usize, &KeyframeView<'_>)| -> Vec<FeatureId> {
        let alone =
            |feature: &FeatureId| view.stereo_pixel(feature.1).is_some() && !tracked.contains(feature);
        (0..view.described()).map(|feature| (index, feature)).filter(alone).collect()
    };
    views.iter().enumerate().flat_map(of_view).map(|feature| vec![feature]).collect()
}

/// Disjoint sets of features.
struct Forest {
    /// Number of features before each view.
    offsets: Vec<usize>,
    /// Number of the image of each feature, counted over all views.
    images: Vec<usize>,
    /// Parent of each feature; a root is its own parent.
    parent: Vec<usize>,
    /// The features of each root, ordered by view and image; empty for all that are no roots.
    members: Vec<Vec<FeatureId>>,
}

impl Forest {
    fn new(feature_counts: &[Vec<usize>]) -> Forest {
        let mut offsets = Vec::with_capacity(feature_counts.len());
        let (mut members, mut images) = (Vec::new(), Vec::new());
        let mut image = 0;
        for (view, counts) in feature_counts.iter().enumerate() {
            offsets.push(members.len());
            members.extend((0..counts.iter().sum()).map(|feature| vec![(view, feature)]));
            for &count in counts {
                images.extend(std::iter::repeat_n(image, count));
                image += 1;
            }
        }
        Forest { offsets, images, parent: (0..members.len()).collect(), members }
    }

    /// The image of a feature.
    fn image(&self, (view, feature): FeatureId) -> usize {
        self.images[self.offsets[view] + feature]
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
        if a == b || self.share_an_image(a, b) {
            return;
        }
        let (large, small) = if self.members[a].len() >= self.members[b].len() { (a, b) } else { (b, a) };
        let joined = std::mem::take(&mut self.members[small]);
        self.members[large].extend(joined);
        self.members[large].sort_unstable();
        self.parent[small] = large;
    }

    /// Whether two sets have features of the same image. Features are ordered by image.
    fn share_an_image(&self, a: usize, b: usize) -> bool {
        let (a, b) = (&self.members[a], &self.members[b]);
        let (mut i, mut j) = (0, 0);
        while i < a.len() && j < b.len() {
            match self.image(a[i]).cmp(&self.image(b[j])) {
                std::cmp::Ordering::Less => i += 1,
                std::cmp::Ordering::Greater => j += 1,
                std::cmp::Ordering::Equal => return true,
            }
        }
        false
    }
}
