//! Assembles the map and the report from the refined bundle.

use std::collections::BTreeMap;

use adjustment::{Bundle, InverseDepthLandmark, MountedCamera, ViewPose};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use map::contents::MapContents;
use map::model::{CommonError, Keyframe, KeyframeCrossCovariance, Landmark, MapMetadata, Observation};
use nalgebra::{DVector, Matrix6, Vector3};
use protocol::KeyframeId;

use super::camera::Rig;
use super::error::BuildError;
use super::joint_covariance::{JointCovariance, StatedKeyframe};
use super::keyframe_view::{FeatureId, KeyframeImage, KeyframeView, keyframes};
use super::options::BuildOptions;
use super::report::{BuildReport, Spread};

/// Ids count from 1, as in the recorded maps, image by image of each view; [`Rig::group_of_keyframe`] is its inverse.
pub(super) fn keyframe_id(rig: &Rig, view: usize, group: usize) -> KeyframeId {
    (view * rig.groups.len() + group) as KeyframeId + 1
}

/// The keyframes of a view.
///
/// # Arguments
/// * `pose`: of camera 0.
/// * `offset`: added to the ids.
pub(super) fn stated_keyframes(
    rig: &Rig,
    (view, content): (usize, &KeyframeView<'_>),
    pose: &Pose,
    offset: KeyframeId,
) -> Vec<StatedKeyframe> {
    let stated = |image: &KeyframeImage<'_>| StatedKeyframe {
        id: offset + keyframe_id(rig, view, image.group),
        mounting: rig.mounting(image.group, pose),
    };
    content.images.iter().map(stated).collect()
}

/// The map: poses with their covariances, refined landmarks in their anchors, raw pixels.
///
/// # Arguments
/// * `joint`: covariance of the bundle's poses; `None` to state the reference poses.
/// * `sigma_px`: px.
pub(super) fn map_contents(
    rig: &Rig,
    views: &[KeyframeView<'_>],
    bundle: &Bundle,
    joint: Option<&JointCovariance>,
    sigma_px: f64,
    options: &BuildOptions,
) -> Result<MapContents, BuildError> {
    let Some(first) = views.iter().find_map(|view| view.images.first()) else {
        return Err(BuildError::NoKeyframes);
    };
    let descriptors = &first.features.descriptors;
    let mut info = MapMetadata::new(
        options.name.clone(),
        options.created_by.clone(),
        descriptors.kind,
        descriptors.width,
    );
    info.gravity_in_global = options.gravity_in_global;
    info.sigma_px = sigma_px;
    info.extractor.clone_from(&first.features.extractor);
    let mut contents = MapContents::empty(info);
    let given;
    let (joint, poses) = if let Some(joint) = joint {
        (joint, bundle.poses.clone())
    } else {
        let own = keyframes(views).into_iter().map(|view| (view, views[view].prior.covariance)).collect();
        given = JointCovariance::of_independent(own);
        (&given, views.iter().map(|view| view.prior.pose).collect())
    };
    for (view, content) in views.iter().enumerate() {
        let pose = &poses[view];
        let keyframe = |image: &KeyframeImage<'_>| {
            let covariance = joint.own[&view];
            let mounting = rig.mounting(image.group, pose);
            let covariance = mounting.map_or(covariance, |mounting| mounting.covariance(&covariance));
            Keyframe {
                id: keyframe_id(rig, view, image.group),
                stamp_ns: content.stamp_ns,
                global_from_keyframe: PoseWithCovariance::new(rig.camera_pose(image.group, pose), covariance),
                camera: rig.camera(image.group).clone(),
                features: None,
            }
        };
        contents.keyframes.extend(content.images.iter().map(keyframe));
    }
    (contents.cross_covariances, contents.common_errors) =
        joint.of_keyframes(|view| stated_keyframes(rig, (view, &views[view]), &poses[view], 0));
    let with_descriptors = bundle.landmarks.iter().filter_map(|landmark| map_landmark(rig, landmark, views));
    contents.landmarks =
        (1..).zip(with_descriptors).map(|(id, landmark)| Landmark { id, ..landmark }).collect();
    contents.sort();
    contents.validate()?;
    Ok(contents)
}

/// An observation as a map states it; `None` of a point without descriptor.
pub(super) fn map_observation(
    rig: &Rig,
    (view, feature): FeatureId,
    views: &[KeyframeView<'_>],
) -> Option<Observation> {
    let (image, number) = views[view].in_image(feature)?;
    Some(Observation {
        keyframe: keyframe_id(rig, view, image.group),
        pixel: *image.features.pixels.get(number)?,
        descriptor: image.features.descriptors.get(number).unwrap_or_default().to_vec(),
    })
}

/// A landmark without its id; `None` of a point without descriptors.
fn map_landmark(rig: &Rig, landmark: &InverseDepthLandmark, views: &[KeyframeView<'_>]) -> Option<Landmark> {
    let (anchor_view, anchor_feature) = landmark.observations[landmark.anchor].feature;
    let observed = landmark.observations.iter().filter(|observation| !observation.is_second);
    Some(Landmark {
        id: 0,
        anchor: keyframe_id(rig, anchor_view, views[anchor_view].group(anchor_feature)),
        position_in_anchor: landmark.ray.push(1.0) / landmark.inverse_depth,
        observations: observed
            .map(|observation| map_observation(rig, observation.feature, views))
            .collect::<Option<_>>()?,
    })
}

/// Fills in the statistics of the finished map.
pub(super) fn fill_report(
    report: &mut BuildReport,
    cameras: &[MountedCamera],
    views: &[KeyframeView<'_>],
    bundle: &Bundle,
    contents: &MapContents,
) {
    report.cross_covariances = contents.cross_covariances.len();
    let poses = || contents.keyframes.iter().map(|keyframe| &keyframe.global_from_keyframe);
    report.sigma_pose_m = Spread::of(poses().map(PoseWithCovariance::sigma_p_m));
    report.sigma_pose_deg = Spread::of(poses().map(|pose| pose.sigma_theta_rad().to_degrees()));
    report.sigma_scale = sigma_scale(contents);
    report.sigma_tilt_deg = sigma_tilt(contents).map(f64::to_degrees);
    report.landmarks = contents.landmarks.len();
    report.observations = contents.observation_count();
    let longest = contents.landmarks.iter().map(|landmark| landmark.observations.len()).max().unwrap_or(1);
    report.track_lengths = vec![0; longest];
    let mut seen: BTreeMap<KeyframeId, usize> =
        contents.keyframes.iter().map(|keyframe| (keyframe.id, 0)).collect();
    for landmark in &contents.landmarks {
        report.track_lengths[landmark.observations.len() - 1] += 1;
        for observation in &landmark.observations {
            *seen.entry(observation.keyframe).or_default() += 1;
        }
    }
    report.landmarks_per_keyframe = Spread::of(seen.values().map(|&count| count as f64));
    report.poor_keyframes =
        seen.iter().filter(|(_, count)| **count < BuildReport::FEW_LANDMARKS).map(|(&id, _)| id).collect();
    let priors: Vec<ViewPose> = views.iter().map(|view| ViewPose::from(&view.prior.pose)).collect();
    report.reprojection_px = reprojection(cameras, &bundle.landmarks, &bundle.view_poses());
    report.reprojection_through_given_px = reprojection(cameras, &bundle.landmarks, &priors);
    let corrections = || views.iter().zip(&bundle.poses).map(|(view, pose)| view.prior.pose.local(pose));
    let norm = |vector: Vector3<f64>| vector.norm();
    report.pose_correction_deg =
        Spread::of(corrections().map(|error| norm(error.fixed_rows::<3>(0).into()).to_degrees()));
    report.pose_correction_m = Spread::of(corrections().map(|error| norm(error.fixed_rows::<3>(3).into())));
}

/// Standard deviation of the first keyframe's rotation about a horizontal axis (rad).
fn sigma_tilt(contents: &MapContents) -> Option<f64> {
    let gravity = contents.info.gravity_in_global?;
    let rotation =
        contents.keyframes.first()?.global_from_keyframe.covariance.fixed_view::<3, 3>(0, 0).into_owned();
    Some((0.5 * (rotation.trace() - gravity.dot(&(rotation * gravity)))).max(0.0).sqrt())
}

/// Standard deviation of the scale that fits the stated positions to the true ones best, in the sense of least squares.
pub(super) fn sigma_scale(contents: &MapContents) -> Option<f64> {
    let keyframes = &contents.keyframes;
    let position = |keyframe: &Keyframe| keyframe.global_from_keyframe.pose.translation;
    let mean = keyframes.iter().map(position).sum::<Vector3<f64>>() / keyframes.len() as f64;
    let moment: f64 = keyframes.iter().map(|keyframe| (position(keyframe) - mean).norm_squared()).sum();
    let weights: BTreeMap<KeyframeId, Vector3<f64>> =
        keyframes.iter().map(|keyframe| (keyframe.id, (position(keyframe) - mean) / moment)).collect();
    let term = |a: KeyframeId, b: KeyframeId, block: &Matrix6<f64>| {
        weights[&a].dot(&(block.fixed_view::<3, 3>(3, 3) * weights[&b]))
    };
    let own = |keyframe: &Keyframe| term(keyframe.id, keyframe.id, &keyframe.global_from_keyframe.covariance);
    let cross = |cross: &KeyframeCrossCovariance| 2.0 * term(cross.a, cross.b, &cross.block);
    // The errors common to keyframes, of each with the others but not with itself.
    let weighted = |common: &CommonError| common.factor.fixed_rows::<3>(3).tr_mul(&weights[&common.keyframe]);
    let columns = contents.common_errors.first().map_or(0, |common| common.factor.ncols());
    let together =
        contents.common_errors.iter().fold(DVector::zeros(columns), |sum, common| sum + weighted(common));
    let with_itself =
        contents.common_errors.iter().map(|common| weighted(common).norm_squared()).sum::<f64>();
    let variance = keyframes.iter().map(own).sum::<f64>()
        + contents.cross_covariances.iter().map(cross).sum::<f64>()
        + (together.norm_squared() - with_itself);
    Some(variance.max(0.0).sqrt()).filter(|sigma| sigma.is_finite())
}

fn reprojection(cameras: &[MountedCamera], landmarks: &[InverseDepthLandmark], poses: &[ViewPose]) -> Spread {
    let errors = landmarks.iter().flat_map(|landmark| landmark.errors(cameras, poses));
    Spread::of(errors.filter(|error| error.is_finite()))
}
