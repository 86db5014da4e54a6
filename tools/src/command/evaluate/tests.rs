use super::*;
use clap::Parser;
use evaluation::score_run;
use evaluation::trajectory::states::{self, StateRow};
use evaluation::trajectory::{StampedPose, tum};
use geometry::pose::Pose;
use geometry::uncertain_pose::isotropic_covariance;
use nalgebra::UnitQuaternion;
use sensors::TruthRow;

#[derive(Parser)]
struct CommandLine {
    #[command(flatten)]
    args: Args,
}

fn report(truth: &std::path::Path, estimate: &std::path::Path, switches: &str) -> Report {
    let paths =
        ["evaluate", "--groundtruth", truth.to_str().unwrap(), "--estimate", estimate.to_str().unwrap()];
    let line = paths.into_iter().chain(switches.split_whitespace());
    evaluate(&CommandLine::try_parse_from(line).unwrap().args).unwrap()
}

/// A curve; `t` in seconds.
fn pose(t: f64) -> Pose {
    Pose::new(
        UnitQuaternion::from_scaled_axis(Vector3::new(0.1 * t.sin(), 0.0, 0.3 * t)),
        Vector3::new((0.9 * t).sin(), (0.7 * t).cos(), 0.1 * t),
    )
}

/// A run of 20 s that is localized after 3 s, with errors that shrink, and truth at other times.
fn files(folder: &std::path::Path) -> (Vec<StateRow>, Vec<TruthRow>) {
    let rows = (0..400).map(|index| {
        let t = f64::from(index) * 0.05;
        let error = Vector3::new(0.3, -0.2, 0.1) * (-0.2 * t).exp();
        let wrong = Pose::new(pose(t).rotation, pose(t).translation + error);
        let with = |pose| PoseWithCovariance::new(pose, isotropic_covariance(0.01, 0.1));
        StateRow {
            stamp_ns: i64::from(index) * 50_000_000,
            local_from_imu: with(wrong),
            global_from_local: (index >= 60).then(|| with(Pose::identity())),
            global_from_imu: (index >= 60).then(|| with(wrong)),
        }
    });
    let rows: Vec<StateRow> = rows.collect();
    let truth: Vec<TruthRow> = (0..2000)
        .map(|index| TruthRow::of_pose(index * 11_000_000 - 7_000_000, pose(index as f64 * 0.011 - 0.007)))
        .collect();
    states::write(&folder.join("states.csv"), &rows).unwrap();
    let stamped = |stamp_ns, pose| StampedPose { stamp_ns, pose };
    let global = rows.iter().filter_map(|row| Some(stamped(row.stamp_ns, row.global_from_imu?.pose)));
    tum::write(&folder.join("pose.tum"), &global.collect::<Vec<_>>()).unwrap();
    let local: Vec<_> = rows.iter().map(|row| stamped(row.stamp_ns, row.local_from_imu.pose)).collect();
    tum::write(&folder.join("odometry.tum"), &local).unwrap();
    let reference: Vec<_> = truth.iter().map(|row| stamped(row.stamp_ns, row.pose)).collect();
    tum::write(&folder.join("truth.tum"), &reference).unwrap();
    (rows, truth)
}

#[test]
fn the_figures_of_a_run_are_those_of_its_summary() {
    let folder = tempfile::tempdir().unwrap();
    let (rows, truth) = files(folder.path());
    let summary = score_run(&rows, &truth, -Vector3::z(), &ScoreOptions::default()).unwrap();
    let pose = summary.pose.unwrap();
    let truth = folder.path().join("truth.tum");
    for file in ["states.csv", "pose.tum"] {
        let report = report(&truth, &folder.path().join(file), "");
        assert_eq!(report.pairs, pose.samples);
        assert!((report.ate_m.unwrap().rmse - pose.rmse_m).abs() < 1e-7, "{file}");
        assert!((report.ate_deg.unwrap().rmse - pose.rmse_deg).abs() < 1e-4, "{file}");
        assert!(report.scored.contains("from 5 s") && report.scored.contains("interpolated"));
    }
    let odometry = report(&truth, &folder.path().join("odometry.tum"), "--align yaw");
    assert!((odometry.ate_m.unwrap().rmse - summary.odometry_yaw_aligned_m.rmse).abs() < 1e-7);
    assert!(odometry.scored.starts_with("all poses"));
    // As evo compares: other frames, other partners, other figures.
    let evo = report(&truth, &folder.path().join("pose.tum"), "--skip 0 --max-difference 0.01");
    assert!(evo.pairs == 340 && evo.ate_m.unwrap().rmse > 1.5 * pose.rmse_m);
}
#[test]
fn kitti_is_paired_by_row_and_a_camera_without_scale_is_scaled() {
    let folder = tempfile::tempdir().unwrap();
    let rows = |scale: f64| -> String {
        let row = |index: u32| {
            let pose = pose(f64::from(index));
            let (r, p) = (pose.rotation.to_rotation_matrix(), scale * pose.translation);
            let line = |k: usize| format!("{} {} {} {}", r[(k, 0)], r[(k, 1)], r[(k, 2)], p[k]);
            format!("{} {} {}\n", line(0), line(1), line(2))
        };
        (0..30).map(row).collect()
    };
    let (truth, half) = (folder.path().join("truth.txt"), folder.path().join("half.txt"));
    std::fs::write(&truth, rows(1.0)).unwrap();
    std::fs::write(&half, rows(0.5)).unwrap();
    assert!(report(&truth, &half, "").ate_m.unwrap().rmse > 0.3);
    let scaled = report(&truth, &half, "--align sim3");
    assert!((scaled.scale.unwrap() - 2.0).abs() < 1e-6 && scaled.ate_m.unwrap().max < 1e-6);
    assert_eq!(scaled.pairs, 30);

    files(folder.path());
    let line = |estimate: &str| {
        let estimate = folder.path().join(estimate);
        let paths =
            ["evaluate", "--groundtruth", truth.to_str().unwrap(), "--estimate", estimate.to_str().unwrap()];
        evaluate(&CommandLine::try_parse_from(paths).unwrap().args).unwrap_err().to_string()
    };
    assert!(line("odometry.tum").contains("no times"));
    let short: Vec<String> = rows(1.0).lines().take(29).map(str::to_owned).collect();
    std::fs::write(folder.path().join("short.txt"), short.join("\n")).unwrap();
    assert!(line("short.txt").contains("30 rows and the estimate 29"));
}

#[test]
fn an_aligned_estimate_has_no_nees_and_the_bounds_are_those_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    files(folder.path());
    let (truth, states) = (folder.path().join("truth.tum"), folder.path().join("states.csv"));
    for align in ["yaw", "se3", "sim3"] {
        let aligned = report(&truth, &states, &format!("--state local_from_imu --align {align}"));
        assert!(aligned.nees.is_none() && aligned.no_nees.is_some(), "{align}");
    }
    let whole = report(&truth, &states, "");
    assert!(whole.no_nees.is_none());
    let nees = whole.nees.unwrap();
    assert!(nees.samples > 100);
    // The quantiles of chi-square with 6 degrees of freedom are 1.237 and 14.449.
    let (low, high) = nees.bounds_6.unwrap();
    assert!((low - 1.237 / 6.0).abs() < 1e-3 && (high - 14.449 / 6.0).abs() < 1e-3, "{low} to {high}");
    // Without covariances there is nothing to explain.
    assert!(report(&truth, &folder.path().join("odometry.tum"), "--align yaw").no_nees.is_none());
}

#[test]
fn poses_whose_covariance_cannot_be_used_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (mut rows, _) = files(folder.path());
    let (truth, path) = (folder.path().join("truth.tum"), folder.path().join("states.csv"));
    let whole = report(&truth, &path, "");
    assert_eq!(whole.nees_left_out, 0);
    for pose in rows[300..310].iter_mut().filter_map(|row| row.global_from_imu.as_mut()) {
        pose.covariance.fill(0.0);
    }
    states::write(&path, &rows).unwrap();
    let less = report(&truth, &path, "");
    assert_eq!((less.pairs, less.nees_left_out), (whole.pairs, 10));
    assert_eq!(serde_json::to_value(&less).unwrap()["nees_left_out"], 10);
    assert_eq!(less.nees.unwrap().samples, whole.nees.unwrap().samples - 10);
}
