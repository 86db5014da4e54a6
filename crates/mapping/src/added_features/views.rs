//! The keyframes of a map as views with features of another kind.

use std::borrow::Cow;
use std::collections::BTreeMap;

use geometry::Camera;
use map::{KeptImage, Keyframe, MapContents};
use protocol::{DescriptorFormat, KeyframeId};
use vision::feature_set;

use super::AddOptions;
use super::error::AddFeaturesError;
use super::extraction::extract;
use crate::camera::Rig;
use crate::keyframe_selection::rays;
use crate::keyframe_view::{KeyframeImage, KeyframeView};
use crate::progress::Progress;

/// Views of one image each, in order of time.
pub(super) struct ImageViews {
    /// The different cameras of the map, each a group of its own.
    pub(super) rig: Rig,
    pub(super) views: Vec<KeyframeView<'static>>,
    /// The keyframe of each view.
    pub(super) keyframes: Vec<KeyframeId>,
    /// Of all descriptors.
    pub(super) descriptors: DescriptorFormat,
}

/// Extracts the features of all images that a map keeps.
pub(super) fn image_views(
    contents: &MapContents,
    options: AddOptions<'_>,
    progress: Progress<'_>,
) -> Result<ImageViews, AddFeaturesError> {
    let images: BTreeMap<KeyframeId, &KeptImage> =
        contents.images.iter().map(|image| (image.keyframe, image)).collect();
    let mut imaged: Vec<(&Keyframe, &KeptImage)> = contents
        .keyframes
        .iter()
        .filter_map(|keyframe| Some((keyframe, *images.get(&keyframe.id)?)))
        .collect();
    imaged.sort_by_key(|(keyframe, _)| (keyframe.stamp_ns, keyframe.id));
    let mut cameras: Vec<Camera> = Vec::new();
    for (keyframe, _) in &imaged {
        if !cameras.contains(&keyframe.camera) {
            cameras.push(keyframe.camera.clone());
        }
    }
    let name = options.extractor.name().to_owned();
    let with_cameras: Vec<(&KeptImage, &Camera)> =
        imaged.iter().map(|(keyframe, image)| (*image, &keyframe.camera)).collect();
    let extracted = extract(&with_cameras, options, progress)?;
    let view = |((keyframe, _), features): (&(&Keyframe, &KeptImage), _)| {
        let features = feature_set(&name, features);
        let group = cameras.iter().position(|camera| *camera == keyframe.camera).unwrap_or_default();
        KeyframeView {
            stamp_ns: keyframe.stamp_ns,
            tracked: Vec::new(),
            stereo: vec![None; features.len()],
            rays: rays(&keyframe.camera, &features),
            images: vec![KeyframeImage { group, features: Cow::Owned(features) }],
            prior: keyframe.global_from_keyframe,
        }
    };
    let views: Vec<KeyframeView<'static>> = imaged.iter().zip(extracted).map(view).collect();
    let Some(first) = views.first().and_then(|view| view.images.first()) else {
        return Err(AddFeaturesError::NoImages);
    };
    Ok(ImageViews {
        descriptors: first.features.descriptors.format(),
        keyframes: imaged.iter().map(|(keyframe, _)| keyframe.id).collect(),
        rig: Rig::of_single(cameras),
        views,
    })
}
