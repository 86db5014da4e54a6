//! A recorded run as the live view shows it.

use crate::plotting::RunFiles;
use evaluation::trajectory::StateKind;
use geometry::PoseWithCovariance;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use viewer::{RunTracks, TrackPoint};

/// Points of a track; of longer ones an even part is taken.
const MAX_POINTS: usize = 10_000;

/// The tracks of a run, with its errors where it has a ground truth.
///
/// # Arguments
/// * `up`: upwards in G, for a run without a ground truth.
pub fn run_tracks(run: &RunFiles, up: Vector3<f64>) -> RunTracks {
    let errors: BTreeMap<i64, [f64; 3]> = match run.errors() {
        Some(Ok(errors)) => errors
            .pose
            .iter()
            .map(|sample| (sample.stamp_ns, [3, 4, 5].map(|axis| sample.error[axis])))
            .collect(),
        _ => BTreeMap::new(),
    };
    let track = |kind: StateKind| {
        let rows = run.states.iter().filter_map(|row| Some((row.stamp_ns, row.get(kind)?)));
        let points = rows.map(|(stamp_ns, pose)| {
            let error = errors.get(&stamp_ns).filter(|_| kind == StateKind::GlobalFromImu);
            TrackPoint::new(run.seconds(stamp_ns), pose, error.copied())
        });
        thinned(points.collect())
    };
    let truth = run.truth_rows().iter();
    let truth = truth
        .map(|row| TrackPoint::new(run.seconds(row.stamp_ns), &PoseWithCovariance::exact(row.pose), None));
    let queries =
        run.events.iter().flatten().map(|event| (run.seconds(event.stamp_ns), event.accepted)).collect();
    RunTracks {
        name: run.name.clone(),
        global: track(StateKind::GlobalFromImu),
        local: track(StateKind::LocalFromImu),
        global_from_local: track(StateKind::GlobalFromLocal),
        truth: thinned(truth.collect()),
        queries,
        up: run.truth.as_ref().map_or(up, |truth| -truth.gravity).into(),
    }
}

fn thinned(points: Vec<TrackPoint>) -> Vec<TrackPoint> {
    let every = points.len().div_ceil(MAX_POINTS).max(1);
    points.into_iter().step_by(every).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pose;
    use geometry::uncertain_pose::isotropic_covariance;
    use nalgebra::UnitQuaternion;

    #[test]
    fn a_run_keeps_its_bounds_and_states_its_errors_where_the_truth_is_known() {
        let pose = |x: f64| Pose::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0));
        let sigma_m = 0.2;
        let estimated = |x| PoseWithCovariance::new(pose(x), isotropic_covariance(0.01, sigma_m));
        let states = (0..100_i64).map(|at| evaluation::trajectory::StateRow {
            stamp_ns: at * 100_000_000,
            local_from_imu: estimated(at as f64 * 0.1),
            global_from_local: Some(estimated(0.0)),
            global_from_imu: Some(estimated(at as f64 * 0.1)),
        });
        let truth_rows =
            (0..50_i64).map(|at| sensors::TruthRow::of_pose(at * 100_000_000, pose(at as f64 * 0.1 + 0.3)));
        let run = RunFiles {
            name: "run".to_owned(),
            states: states.collect(),
            events: None,
            truth: Some(crate::plotting::Truth { rows: truth_rows.collect(), gravity: -Vector3::y() }),
            keyframes: Vec::new(),
            map_identity: None,
            truth_is_aligned: false,
            missing: Vec::new(),
        };
        let tracks = run_tracks(&run, Vector3::z());
        assert_eq!((tracks.global.len(), tracks.local.len(), tracks.truth.len()), (100, 100, 50));
        assert!((Vector3::from(tracks.up) - Vector3::y()).norm() < 1e-12);
        let [x, y, z] = tracks.global[20].error_m.unwrap();
        assert!((x - 0.3).abs() < 1e-9 && y.abs() < 1e-9 && z.abs() < 1e-9, "{x} {y} {z}");
        assert!((tracks.global[20].position_covariance[0][0] - sigma_m * sigma_m).abs() < 1e-12);
        assert!(tracks.global[90].error_m.is_none() && tracks.local[20].error_m.is_none());
    }
}
