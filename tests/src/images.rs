//! Localization of single images of a recording in a map of others.

use geometry::pose::Pose;
use mapping::{BuildOptions, BuildReport, Extraction, build_map};
use protocol::LocalizeRequest;
use recognition::LoadedMap;
use recognition::RecognitionOptions;
use sensors::{Frame, ReferencePose, Sequence, TruthTrack};
use std::sync::Arc;
use vision::feature_set;
use vision::{FeatureExtractor, GrayImage};

/// Longest gap in the truth to interpolate over, nanoseconds.
const MAX_GAP_NS: i64 = 110_000_000;
/// A query has a map image near within this distance (m) ...
const NEAR: f64 = 1.0;
/// ... and this angle between the optical axes (degrees).
const NEAR_DEG: f64 = 35.0;

/// Result of one query.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    /// Index of the frame.
    pub frame: usize,
    /// Whether the map has an image near it.
    pub near: bool,
    /// Errors of position (m) and rotation (deg); `None` for a refusal.
    pub error: Option<(f64, f64)>,
    /// Normalized estimation error squared of the pose, over 6.
    pub nees: Option<f64>,
}

/// A recording with images, split into those of the map and those of the queries.
#[derive(Debug)]
pub struct Split {
    /// The whole recording.
    pub sequence: Sequence,
    /// Indices of the frames that the map is made of.
    pub map: Vec<usize>,
    /// Indices of the query frames.
    pub queries: Vec<usize>,
}

impl Split {
    /// Splits a recording.
    pub fn new(sequence: Sequence, is_map: impl Fn(usize, &Frame) -> bool) -> Self {
        let (map, queries) =
            (0..sequence.frames.len()).partition(|&index| is_map(index, &sequence.frames[index]));
        Self { sequence, map, queries }
    }

    /// True pose of the first camera.
    pub fn global_from_camera(&self, frame: usize) -> Option<Pose> {
        let truth = TruthTrack::new(self.sequence.groundtruth.as_deref()?);
        let global_from_imu = truth.pose(self.sequence.frames[frame].stamp_ns, MAX_GAP_NS)?;
        Some(global_from_imu * self.sequence.cameras[0].imu_from_camera)
    }

    /// Builds the map from the ground truth, stated with sigmas of 1 cm and 1 deg.
    pub fn build(
        &self,
        extractor: &mut dyn FeatureExtractor,
        max_features: usize,
    ) -> (Arc<LoadedMap>, BuildReport) {
        let mut sequence = self.sequence.clone();
        sequence.frames = self.map.iter().map(|&index| self.sequence.frames[index].clone()).collect();
        let reference = |row: &sensors::TruthRow| {
            ReferencePose::isotropic(row.stamp_ns, row.pose, 1_f64.to_radians(), 0.01)
        };
        let references: Vec<ReferencePose> = sequence.groundtruth.iter().flatten().map(reference).collect();
        let mut options = BuildOptions::default();
        options.gravity_in_global = self.sequence.truth_gravity();
        options.sigma_px = None;
        let extraction =
            Extraction { extractor, others: &mut [], max_features, masks: &[], cameras: usize::MAX };
        let (contents, report) =
            build_map(&sequence, &references, Some(extraction), &options, &mut |_, _, _| {}).unwrap();
        (Arc::new(LoadedMap::from_contents(contents).unwrap()), report)
    }

    /// Localizes every query in a map, each without a prior.
    ///
    /// # Arguments
    /// * `change`: applied to the image first.
    pub fn localize(
        &self,
        map: &LoadedMap,
        extractor: &mut dyn FeatureExtractor,
        max_features: usize,
        change: impl Fn(GrayImage) -> GrayImage,
    ) -> Vec<Found> {
        let localized = |&frame: &usize| {
            let truth = self.global_from_camera(frame)?;
            let file = self.sequence.frames[frame].images.get(&0)?;
            let image = change(file.read().unwrap().into_owned());
            let seen = extractor.extract(&image, None, max_features).unwrap();
            let request = LocalizeRequest {
                camera: self.sequence.cameras[0].camera.clone(),
                features: feature_set(extractor.name(), seen),
                prior: None,
                gravity_in_camera: None,
            };
            let fix = map.localize(&request, &RecognitionOptions::default()).unwrap().fix;
            let error = fix.as_ref().map(|fix| {
                let pose = &fix.global_from_camera.pose;
                let angle = pose.rotation.angle_to(&truth.rotation).to_degrees();
                ((pose.translation - truth.translation).norm(), angle)
            });
            let nees = fix.as_ref().map(|fix| {
                let error = fix.global_from_camera.pose.local(&truth);
                error.dot(&fix.global_from_camera.covariance.cholesky().unwrap().solve(&error)) / 6.0
            });
            Some(Found { frame, near: self.has_map_image_near(&truth), error, nees })
        };
        self.queries.iter().filter_map(localized).collect()
    }

    fn has_map_image_near(&self, pose: &Pose) -> bool {
        let axis = |pose: &Pose| pose.rotation * nalgebra::Vector3::z();
        self.map.iter().filter_map(|&frame| self.global_from_camera(frame)).any(|other| {
            (other.translation - pose.translation).norm() <= NEAR
                && axis(&other).angle(&axis(pose)).to_degrees() <= NEAR_DEG
        })
    }
}

/// How many queries were found within bounds (m, deg), of those that have a map image near.
pub fn within(found: &[Found], metres: f64, degrees: f64) -> usize {
    let good =
        |found: &&Found| found.near && found.error.is_some_and(|(p, theta)| p <= metres && theta <= degrees);
    found.iter().filter(good).count()
}

/// How many are wrong by more than so many metres.
pub fn wrong_by(found: &[Found], metres: f64) -> usize {
    found.iter().filter(|found| found.error.is_some_and(|(p, _)| p > metres)).count()
}
