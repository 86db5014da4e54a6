//! A keyframe before any matching: its features, their bearings, and its prior pose.

use std::borrow::Cow;

pub(super) use adjustment::FeatureId;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Vector2, Vector3};
use protocol::FeatureSet;
use vision::metric_of;
use vision::{DescriptorError, DescriptorView};

/// An image that becomes a keyframe, or, without features of its own, ties keyframes together by the tracks of the odometry.
///
/// Its features are counted first those with descriptors, then the points that the odometry tracks.
#[derive(Debug)]
pub(super) struct KeyframeView<'a> {
    /// When it was taken (ns).
    pub(super) stamp_ns: i64,
    /// Its features with descriptors.
    pub(super) features: Cow<'a, FeatureSet>,
    /// Pixels of the points that the odometry tracks.
    pub(super) tracked: Vec<Vector2<f64>>,
    /// Pixel of each feature in the image of the second camera, where it was matched there.
    pub(super) stereo: Vec<Option<Vector2<f64>>>,
    /// Normalized coordinates of each feature, `None` where the pixel cannot be unprojected.
    pub(super) rays: Vec<Option<Vector2<f64>>>,
    /// The reference pose of the camera, with its covariance.
    pub(super) prior: PoseWithCovariance,
}

impl KeyframeView<'_> {
    /// With features of its own.
    pub(super) fn into_owned(self) -> KeyframeView<'static> {
        KeyframeView { features: Cow::Owned(self.features.into_owned()), ..self }
    }

    /// The same view with another prior pose.
    pub(super) fn borrowed(&self, prior: &PoseWithCovariance) -> KeyframeView<'_> {
        KeyframeView {
            stamp_ns: self.stamp_ns,
            features: Cow::Borrowed(self.features.as_ref()),
            tracked: self.tracked.clone(),
            stereo: self.stereo.clone(),
            rays: self.rays.clone(),
            prior: *prior,
        }
    }

    /// Pixel of a feature.
    pub(super) fn pixel(&self, feature: usize) -> Vector2<f64> {
        match self.features.pixels.get(feature) {
            Some(&[u, v]) => Vector2::new(f64::from(u), f64::from(v)),
            None => self.tracked[feature - self.features.len()],
        }
    }

    /// Whether it becomes a keyframe of the map.
    pub(super) fn is_keyframe(&self) -> bool {
        !self.features.is_empty()
    }

    /// Pixel of a feature in the image of the second camera.
    pub(super) fn stereo_pixel(&self, feature: usize) -> Option<Vector2<f64>> {
        self.stereo.get(feature).copied().flatten()
    }

    /// Number of features that are matched in the image of the second camera.
    pub(super) fn stereo_count(&self) -> usize {
        self.stereo.iter().flatten().count()
    }

    /// The descriptors of all features.
    pub(super) fn descriptors(&self) -> Result<DescriptorView<'_>, DescriptorError> {
        descriptors(&self.features)
    }

    /// Direction of the optical axis in G.
    pub(super) fn axis(&self) -> Vector3<f64> {
        self.prior.pose.rotation * Vector3::z()
    }
}

/// Indices of the views that become keyframes.
pub(super) fn keyframes(views: &[KeyframeView<'_>]) -> Vec<usize> {
    (0..views.len()).filter(|&view| views[view].is_keyframe()).collect()
}

/// The descriptors of some features.
pub(super) fn descriptors(features: &FeatureSet) -> Result<DescriptorView<'_>, DescriptorError> {
    let descriptors = &features.descriptors;
    DescriptorView::new(metric_of(descriptors.kind), usize::from(descriptors.width), &descriptors.bytes)
}
