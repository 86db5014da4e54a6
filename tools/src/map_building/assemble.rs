//! From the refined bundle to a map, and the report on it.

use std::collections::BTreeMap;

use geometry::camera::Camera;
use map_server::contents::MapContents;
use map_server::model::{Keyframe, Landmark, MapInfo, Observation};
use nalgebra::Vector3;
use protocol::KeyframeId;

use super::adjustment::Bundle;
use super::options::{BuildError, BuildOptions};
use super::point::{CameraPose, Point};
use super::report::{BuildReport, Spread};
use super::views::View;

/// Ids count from 1, as in the recorded maps.
fn keyframe_id(view: usize) -> KeyframeId {
    view as KeyframeId + 1
}

/// The map: given poses with their covariances, refined landmarks in their anchors, raw pixels.
pub(super) fn map_contents(
    camera: &Camera,
    views: &[View<'_>],
    bundle: &Bundle,
    options: &BuildOptions,
) -> Result<MapContents, BuildError> {
    let descriptors = &views[0].features.descriptors;
    let mut info =
        MapInfo::new(options.name.clone(), options.created_by.clone(), descriptors.kind, descriptors.width);
    info.gravity_in_global = options.gravity_in_global;
    info.pixel_sigma = options.pixel_sigma;
    info.extractor.clone_from(&views[0].features.extractor);
    let mut contents = MapContents::empty(info);
    contents.keyframes = views
        .iter()
        .enumerate()
        .map(|(view, content)| Keyframe {
            id: keyframe_id(view),
            stamp_ns: content.stamp_ns,
            global_from_keyframe: content.prior,
            camera: camera.clone(),
            features: None,
        })
        .collect();
    contents.landmarks = (1..).zip(&bundle.points).map(|(id, point)| landmark(id, point, views)).collect();
    contents.sort();
    contents.validate()?;
    Ok(contents)
}

fn landmark(id: u64, point: &Point, views: &[View<'_>]) -> Landmark {
    let observation = |&(view, feature): &(usize, usize)| Observation {
        keyframe: keyframe_id(view),
        pixel: views[view].features.pixels[feature],
        descriptor: views[view].features.descriptors.get(feature).unwrap_or_default().to_vec(),
    };
    Landmark {
        id,
        anchor: keyframe_id(point.anchor_view()),
        position_in_anchor: point.ray.push(1.0) / point.inverse_depth,
        observations: point.sightings.iter().map(|sighting| observation(&sighting.feature)).collect(),
    }
}

/// Fills in what the finished map tells.
pub(super) fn fill_report(
    report: &mut BuildReport,
    camera: &Camera,
    views: &[View<'_>],
    bundle: &Bundle,
    contents: &MapContents,
) {
    report.landmarks = contents.landmarks.len();
    report.observations = contents.observation_count();
    let longest = contents.landmarks.iter().map(|landmark| landmark.observations.len()).max().unwrap_or(1);
    report.track_lengths = vec![0; longest - 1];
    let mut seen: BTreeMap<KeyframeId, usize> =
        contents.keyframes.iter().map(|keyframe| (keyframe.id, 0)).collect();
    for landmark in &contents.landmarks {
        report.track_lengths[landmark.observations.len() - 2] += 1;
        for observation in &landmark.observations {
            *seen.entry(observation.keyframe).or_default() += 1;
        }
    }
    report.landmarks_per_keyframe = Spread::of(seen.values().map(|&count| count as f64));
    report.poor_keyframes =
        seen.iter().filter(|(_, count)| **count < BuildReport::FEW_LANDMARKS).map(|(&id, _)| id).collect();
    let priors: Vec<CameraPose> = views.iter().map(|view| CameraPose::from(&view.prior.pose)).collect();
    report.reprojection_px = reprojection(camera, &bundle.points, &bundle.camera_poses());
    report.reprojection_through_map_px = reprojection(camera, &bundle.points, &priors);
    let corrections = || views.iter().zip(&bundle.poses).map(|(view, pose)| view.prior.pose.local(pose));
    let norm = |vector: Vector3<f64>| vector.norm();
    report.pose_correction_deg =
        Spread::of(corrections().map(|error| norm(error.fixed_rows::<3>(0).into()).to_degrees()));
    report.pose_correction_m = Spread::of(corrections().map(|error| norm(error.fixed_rows::<3>(3).into())));
}

fn reprojection(camera: &Camera, points: &[Point], poses: &[CameraPose]) -> Spread {
    let errors = points.iter().flat_map(|point| point.errors(camera, poses));
    Spread::of(errors.filter(|error| error.is_finite()))
}
