//! A view before any matching: the images of one instant, their features with bearings, and the prior pose.

use std::borrow::Cow;

pub(super) use adjustment::FeatureId;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Vector2;
use protocol::FeatureSet;
use vision::metric_of;
use vision::{DescriptorError, DescriptorView};

/// One instant of a recording: each of its images becomes a keyframe, or, without features of its own, it ties keyframes together by
/// the tracks of the odometry.
///
/// Its features are counted first those with descriptors, image by image, then the points that the odometry tracks.
#[derive(Debug)]
pub(super) struct KeyframeView<'a> {
    /// When it was taken (ns).
    pub(super) stamp_ns: i64,
    /// Its images with features, in the order of the groups.
    pub(super) images: Vec<KeyframeImage<'a>>,
    /// The points that the odometry tracks.
    pub(super) tracked: Vec<TrackedPoint>,
    /// Pixel of each feature in the image of the second camera, where it was matched there.
    pub(super) stereo: Vec<Option<Vector2<f64>>>,
    /// Normalized coordinates of each feature, `None` where the pixel cannot be unprojected.
    pub(super) rays: Vec<Option<Vector2<f64>>>,
    /// The reference pose of camera 0, with its covariance.
    pub(super) prior: PoseWithCovariance,
}

/// The image of a stereo pair's first camera or of a single camera.
#[derive(Clone, Debug)]
pub(super) struct KeyframeImage<'a> {
    /// The pair or single camera.
    pub(super) group: usize,
    /// Its features with descriptors, at least one.
    pub(super) features: Cow<'a, FeatureSet>,
}

/// A point without descriptor.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrackedPoint {
    /// The stereo pair or single camera that sees it.
    pub(super) group: usize,
    /// In the image of its first camera (px).
    pub(super) pixel: Vector2<f64>,
}

impl<'a> KeyframeView<'a> {
    /// With features of its own.
    pub(super) fn into_owned(self) -> KeyframeView<'static> {
        let owned = |image: KeyframeImage<'_>| KeyframeImage {
            group: image.group,
            features: Cow::Owned(image.features.into_owned()),
        };
        KeyframeView { images: self.images.into_iter().map(owned).collect(), ..self }
    }

    /// The same view with another prior pose.
    pub(super) fn borrowed(&self, prior: &PoseWithCovariance) -> KeyframeView<'_> {
        KeyframeView {
            stamp_ns: self.stamp_ns,
            images: self.images.iter().map(KeyframeImage::borrowed).collect(),
            tracked: self.tracked.clone(),
            stereo: self.stereo.clone(),
            rays: self.rays.clone(),
            prior: *prior,
        }
    }

    /// Number of features with descriptors.
    pub(super) fn described(&self) -> usize {
        self.images.iter().map(|image| image.features.len()).sum()
    }

    /// Number of the first feature of an image.
    pub(super) fn first_feature(&self, image: usize) -> usize {
        self.images[..image].iter().map(|image| image.features.len()).sum()
    }

    /// The image of a feature, and the number of the feature in it; `None` for points that the odometry tracks.
    pub(super) fn in_image(&self, feature: usize) -> Option<(&KeyframeImage<'a>, usize)> {
        let mut number = feature;
        for image in &self.images {
            if number < image.features.len() {
                return Some((image, number));
            }
            number -= image.features.len();
        }
        None
    }

    /// The stereo pair or single camera that sees a feature.
    pub(super) fn group(&self, feature: usize) -> usize {
        match self.in_image(feature) {
            Some((image, _)) => image.group,
            None => self.tracked[feature - self.described()].group,
        }
    }

    /// Pixel of a feature.
    pub(super) fn pixel(&self, feature: usize) -> Vector2<f64> {
        match self.in_image(feature) {
            Some((image, number)) => Vector2::from(image.features.pixels[number].map(f64::from)),
            None => self.tracked[feature - self.described()].pixel,
        }
    }

    /// Whether its images become keyframes of the map.
    pub(super) fn is_keyframe(&self) -> bool {
        !self.images.is_empty()
    }

    /// The image of a stereo pair or single camera.
    pub(super) fn image_of(&self, group: usize) -> Option<&KeyframeImage<'a>> {
        self.images.iter().find(|image| image.group == group)
    }

    /// Pixel of a feature in the image of the second camera.
    pub(super) fn stereo_pixel(&self, feature: usize) -> Option<Vector2<f64>> {
        self.stereo.get(feature).copied().flatten()
    }

    /// Number of features that are matched in the image of the second camera.
    pub(super) fn stereo_count(&self) -> usize {
        self.stereo.iter().flatten().count()
    }
}

impl KeyframeImage<'_> {
    /// The same image, whose features are not copied.
    fn borrowed(&self) -> KeyframeImage<'_> {
        KeyframeImage { group: self.group, features: Cow::Borrowed(self.features.as_ref()) }
    }

    /// The descriptors of all features.
    pub(super) fn descriptors(&self) -> Result<DescriptorView<'_>, DescriptorError> {
        descriptors(&self.features)
    }
}

/// Indices of the views that become keyframes.
pub(super) fn keyframes(views: &[KeyframeView<'_>]) -> Vec<usize> {
    (0..views.len()).filter(|&view| views[view].is_keyframe()).collect()
}

/// Number of all images that become keyframes.
pub(super) fn image_count(views: &[KeyframeView<'_>]) -> usize {
    views.iter().map(|view| view.images.len()).sum()
}

/// The descriptors of some features.
pub(super) fn descriptors(features: &FeatureSet) -> Result<DescriptorView<'_>, DescriptorError> {
    let descriptors = &features.descriptors;
    DescriptorView::new(metric_of(descriptors.kind), usize::from(descriptors.width), &descriptors.bytes)
}
