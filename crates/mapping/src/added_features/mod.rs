//! Features of a further kind for a map whose images were kept.
//!
//! 1. Features are extracted in the kept images (`extraction`), whichever cameras took them.
//! 2. Keyframes are matched that see landmarks of the map together, and neighbours in time and space, with the epipolar constraint of
//!    their poses (`covisibility`, `matching`).
//! 3. Matches are joined into tracks, and each is triangulated with the poses held. An observation is taken where it agrees with the
//!    others within the noise of pixels and the covariance of the two poses relative to each other, which the joint covariance of the
//!    map gives.
//!
//! Poses and covariances stay as they are: the map's own features have told them, and those of the new kind are not used a second time
//! for the same. Their pixels are as independent of the poses' errors as a robot's are. A filter that uses them linearizes at the
//! landmarks and weights with the covariance of the poses, as with the map's own.
//!
//! Where a map is extended or merged, its poses move, and the landmarks of added kinds are placed anew (`moved`).

mod covisibility;
mod error;
mod extraction;
mod moved;
mod views;

use std::collections::BTreeSet;
use std::time::Instant;

use adjustment::{InverseDepthLandmark, ViewPose};
use map::{AddedFeatures, FeatureKind, Landmark, MapContents, Observation};
use protocol::LandmarkId;
use serde::Serialize;
use vision::FeatureExtractor;

use crate::correlations::{Correlations, MapCorrelations};
use crate::matching::{self, ImageId};
use crate::options::{BuildOptions, FIRST_SIGMA_PX};
use crate::pipeline::{match_all, triangulate_all};
use crate::progress::Progress;
use crate::refinement::median_sigma_px;
use crate::report::BuildReport;
use covisibility::covisible_pairs;
pub use error::AddFeaturesError;
pub(crate) use moved::place_added;
use views::{ImageViews, image_views};

/// What is added to a map.
pub struct AddOptions<'a> {
    /// Detects and describes features.
    pub extractor: &'a mut dyn FeatureExtractor,
    /// More extractors of the same kind: as many images more are extracted at the same time.
    pub others: &'a mut [Box<dyn FeatureExtractor>],
    /// Most features an image.
    pub max_features: usize,
    /// Whether features of this kind that the map has already are computed again; else they are an error.
    pub replace: bool,
}

/// What was added.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct AddedReport {
    /// The extractor.
    pub extractor: String,
    /// Images in which features were extracted.
    pub images: usize,
    /// Keyframes without an image, which have no features of this kind.
    pub without_image: usize,
    /// Features of all images.
    pub features: usize,
    /// Pairs of keyframes that were matched.
    pub pairs: usize,
    /// Matches that satisfy the epipolar constraint.
    pub matches: usize,
    /// Landmarks.
    pub landmarks: usize,
    /// Observations over all landmarks.
    pub observations: usize,
    /// Observations that were dropped as outliers.
    pub dropped_observations: usize,
    /// Standard deviation of a pixel, as measured with the poses held (px).
    pub sigma_px: f64,
    /// Time taken (s).
    pub seconds: f64,
}

/// Adds features of a further kind to a map whose images were kept.
///
/// # Arguments
/// * `contents`: valid; unchanged where an error is returned.
///
/// # Errors
/// [`AddFeaturesError`], with what to do.
pub fn add_features(
    contents: &mut MapContents,
    options: AddOptions<'_>,
    progress: Progress<'_>,
) -> Result<AddedReport, AddFeaturesError> {
    let start = Instant::now();
    let extractor = options.extractor.name().to_owned();
    check(contents, &extractor, options.replace)?;
    let images = image_views(contents, options, progress)?;
    let ImageViews { rig, views, keyframes, descriptors } = &images;
    let mut settings = BuildOptions::default();
    let mut report = BuildReport::of_views(views, Vec::new());
    let pairs: BTreeSet<(ImageId, ImageId)> = matching::pairs(rig, views, &settings)
        .into_iter()
        .chain(covisible_pairs(contents, keyframes))
        .collect();
    let pairs: Vec<(ImageId, ImageId)> = pairs.into_iter().collect();
    let correlations = Correlations::OfMap(MapCorrelations::new(contents, keyframes));
    settings.sigma_px = Some(FIRST_SIGMA_PX);
    let matches = match_all(rig, views, &pairs, &correlations, &settings, &mut report, progress)?;
    let mut triangulated = |settings: &BuildOptions| {
        let (views, matches) = ((&views[..], &correlations), matches.clone());
        triangulate_all(rig, views, matches, Vec::new(), settings, &mut report, progress)
    };
    // What the first noise admits tells the noise that is stated and used.
    let poses: Vec<ViewPose> = views.iter().map(|view| ViewPose::from(&view.prior.pose)).collect();
    let first = triangulated(&settings);
    let errors = first.iter().map(|landmark| landmark.errors(&rig.cameras, &poses));
    let sigma_px = median_sigma_px(errors).ok_or(AddFeaturesError::NothingMatched { images: views.len() })?;
    settings.sigma_px = Some(sigma_px);
    let found = triangulated(&settings);

    let last = contents.landmarks_of_kinds().flat_map(|(_, landmarks)| landmarks).map(|of| of.id).max();
    let landmarks: Vec<Landmark> = (last.map_or(1, |last| last + 1)..)
        .zip(&found)
        .map(|(id, landmark)| images.landmark(id, landmark))
        .collect();
    let added = AddedReport {
        extractor: extractor.clone(),
        images: views.len(),
        without_image: contents.keyframes.len() - contents.images.len(),
        features: views.iter().map(crate::keyframe_view::KeyframeView::described).sum(),
        pairs: report.pairs,
        matches: report.matches,
        landmarks: landmarks.len(),
        observations: landmarks.iter().map(|landmark| landmark.observations.len()).sum(),
        dropped_observations: report.dropped_observations,
        sigma_px,
        seconds: start.elapsed().as_secs_f64(),
    };
    let kind = FeatureKind {
        extractor: extractor.clone(),
        descriptor_kind: descriptors.kind,
        descriptor_width: descriptors.width,
        sigma_px,
    };
    let mut with_added = contents.clone();
    with_added.added_features.retain(|added| added.kind.extractor != extractor);
    with_added.added_features.push(AddedFeatures { kind, landmarks });
    with_added.sort();
    with_added.validate()?;
    *contents = with_added;
    Ok(added)
}

/// Refuses what cannot be added, before anything is extracted.
fn check(contents: &MapContents, extractor: &str, replace: bool) -> Result<(), AddFeaturesError> {
    if contents.images.is_empty() {
        return Err(AddFeaturesError::NoImages);
    }
    if contents.info.extractor == extractor {
        return Err(AddFeaturesError::Primary { extractor: extractor.to_owned() });
    }
    let present = contents.added_features.iter().any(|added| added.kind.extractor == extractor);
    if present && !replace {
        return Err(AddFeaturesError::Present { extractor: extractor.to_owned() });
    }
    Ok(())
}

impl ImageViews {
    /// A landmark as a map states it.
    fn landmark(&self, id: LandmarkId, landmark: &InverseDepthLandmark) -> Landmark {
        let (anchor, _) = landmark.observations[landmark.anchor].feature;
        let observation = |(view, feature): (usize, usize)| {
            let (image, number) = self.views[view].in_image(feature)?;
            Some(Observation {
                keyframe: self.keyframes[view],
                pixel: *image.features.pixels.get(number)?,
                descriptor: image.features.descriptors.get(number)?.to_vec(),
            })
        };
        let observations = landmark.observations.iter().filter_map(|seen| observation(seen.feature));
        Landmark {
            id,
            anchor: self.keyframes[anchor],
            position_in_anchor: landmark.ray.push(1.0) / landmark.inverse_depth,
            observations: observations.collect(),
        }
    }
}
