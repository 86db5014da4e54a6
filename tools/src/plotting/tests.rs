//! Pictures hold what is known, and say what is not.

use super::run_files::read_events;
use super::*;
use crate::plotting::comparison::{ComparedRun, Comparison};
use evaluation::ErrorSample;
use evaluation::trajectory::{StampedPose, StateRow, states};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use sensors::TruthRow;

const START_NS: i64 = 1_503_911_171_749_927_282;

fn truth_rows() -> Vec<TruthRow> {
    (0..400)
        .map(|index| {
            let t = f64::from(index) * 0.1;
            let position =
                Vector3::new(20.0 * (0.15 * t).cos(), 12.0 * (0.3 * t).sin(), 1.0 + (0.4 * t).sin());
            TruthRow {
                stamp_ns: START_NS + i64::from(index) * 100_000_000,
                pose: Pose::new(UnitQuaternion::from_euler_angles(0.02, 0.01, 0.15 * t), position),
                velocity: None,
                gyroscope_bias: None,
                accelerometer_bias: None,
            }
        })
        .collect()
}

/// A run with a wobbling error, localized from the 50th frame on.
fn states() -> Vec<StateRow> {
    let sigma = [0.003, 0.003, 0.004, 0.05, 0.05, 0.04];
    let covariance = Matrix6::from_diagonal(&Vector6::from(sigma.map(|sigma| sigma * sigma)));
    let sure = |pose| PoseWithCovariance::new(pose, covariance);
    truth_rows()
        .iter()
        .enumerate()
        .map(|(index, row)| {
            let t = index as f64 * 0.1;
            let error = Vector6::from_fn(|axis, _| sigma[axis] * 1.5 * (t * (0.7 + 0.2 * axis as f64)).sin());
            let estimate = row.pose.retract(&error);
            StateRow {
                stamp_ns: row.stamp_ns,
                local_from_imu: sure(estimate),
                global_from_local: (index > 50).then(|| sure(Pose::identity().retract(&(error * 0.3)))),
                global_from_imu: (index > 50).then(|| sure(estimate)),
            }
        })
        .collect()
}

const EVENTS: &str = "stamp_ns,queried_at_s,applied_at_s,outcome,keyframes,matches,inliers,used,mean_reprojection_px,\
    relinearized,accepted,reason\n\
    1503911176749927282,5.0,5.1,matched,1,45,40,38,25.5,true,true,\n\
    1503911181749927282,10.0,10.1,no_match,0,0,0,0,,false,false,\"the map does not know the place, yet\"\n\
    1503911186749927282,15.0,15.1,matched,2,60,20,0,14.2,false,false,gate\n\
    1503911191749927282,20.0,20.1,matched,2,70,66,60,1.2,false,true,\n";

fn run_folder(with_events: bool) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    states::write(&folder.path().join("states.csv"), &states()).unwrap();
    if with_events {
        std::fs::write(folder.path().join("events.csv"), EVENTS).unwrap();
    }
    folder
}

#[test]
fn a_run_with_truth_and_events_gives_all_pictures() {
    let folder = run_folder(true);
    let mut run = RunFiles::read(folder.path(), None, None).unwrap();
    run.truth = Some(Truth { rows: truth_rows(), gravity: -Vector3::z() });
    run.keyframes = vec![Vector3::new(19.0, 1.0, 1.0), Vector3::new(0.0, 11.0, 1.0)];
    let out = folder.path().join("pictures");
    let drawn = draw_run(&run, &out).unwrap();
    assert_eq!(drawn.pictures.len(), 6);
    for picture in &drawn.pictures {
        let svg = std::fs::read_to_string(picture).unwrap();
        assert!(svg.contains("<svg") && svg.trim_end().ends_with("</svg>"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{}", picture.display());
    }
    let errors = std::fs::read_to_string(out.join("error_pose.svg")).unwrap();
    for shown in ["no answer used", "answer used", "answer refused"] {
        assert!(errors.contains(shown), "{shown}");
    }
    if let Ok(keep) = std::env::var("KEEP_PICTURES") {
        for picture in &drawn.pictures {
            std::fs::copy(picture, Path::new(&keep).join(picture.file_name().unwrap())).unwrap();
        }
    }
}

#[test]
fn a_picture_in_pixels_has_the_colours_and_letters_of_the_drawing() {
    let folder = run_folder(true);
    let mut run = RunFiles::read(folder.path(), None, None).unwrap();
    run.truth = Some(Truth { rows: truth_rows(), gravity: -Vector3::z() });
    let drawn = draw_run(&run, folder.path()).unwrap();
    let svg = drawn.pictures.iter().find(|path| path.ends_with("error_pose.svg")).unwrap();
    let pixels = |scale: f32| {
        let png = draw_png(svg, scale).unwrap();
        assert_eq!(png, folder.path().join("error_pose.png"));
        image::open(png).unwrap().into_rgb8()
    };
    let (once, twice) = (pixels(1.0), pixels(2.0));
    assert_eq!((once.width() * 2, once.height() * 2), (twice.width(), twice.height()));
    let count = |colour: plotters::style::RGBColor| {
        twice.pixels().filter(|pixel| pixel.0 == [colour.0, colour.1, colour.2]).count()
    };
    assert!(count(canvas::BAND) > 10_000 && count(canvas::SHADE) > 10_000 && count(canvas::ESTIMATE) > 500);
    let title = (0..twice.width()).flat_map(|x| (20..70).map(move |y| (x, y)));
    let dark = title.filter(|(x, y)| twice.get_pixel(*x, *y).0.iter().all(|part| *part < 90)).count();
    assert!(dark > 500, "the title is written: {dark} dark pixels");
    let missing = draw_png(&folder.path().join("nothing.svg"), 1.0).unwrap_err();
    assert!(format!("{missing:#}").contains("nothing.svg"));
}

#[test]
fn what_is_missing_is_said_and_not_drawn() {
    let folder = run_folder(false);
    let run = RunFiles::read(folder.path(), None, None).unwrap();
    let drawn = draw_run(&run, folder.path()).unwrap();
    let names: Vec<_> =
        drawn.pictures.iter().map(|path| path.file_name().unwrap().to_str().unwrap()).collect();
    assert_eq!(names, ["trajectory.svg", "over_time.svg"]);
    assert!(drawn.missing.iter().any(|sentence| sentence.contains("events.csv")));
    assert!(drawn.missing.iter().any(|sentence| sentence.contains("no truth")));
    let svg = std::fs::read_to_string(folder.path().join("trajectory.svg")).unwrap();
    assert!(!svg.contains("truth"));
}

#[test]
fn a_run_without_states_cannot_be_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let error = format!("{:#}", RunFiles::read(folder.path(), None, None).unwrap_err());
    assert!(error.contains("states.csv") && error.contains("missing"), "{error}");
}

#[test]
fn a_run_that_was_killed_is_drawn_up_to_its_last_whole_row() {
    let folder = run_folder(true);
    let path = folder.path().join("events.csv");
    for cut in [1, 20] {
        std::fs::write(&path, &EVENTS[..EVENTS.len() - cut]).unwrap();
        assert_eq!(read_events(&path).unwrap().len(), 3);
    }
    let states_path = folder.path().join("states.csv");
    let text = std::fs::read_to_string(&states_path).unwrap();
    std::fs::write(&states_path, &text[..text.len() - 30]).unwrap();
    let run = RunFiles::read(folder.path(), None, None).unwrap();
    assert_eq!((run.states.len(), run.events.unwrap().len()), (states().len(), 3));
}

#[test]
fn an_event_that_is_cut_off_in_the_middle_is_an_error_with_the_line() {
    let folder = run_folder(true);
    let path = folder.path().join("events.csv");
    std::fs::write(&path, EVENTS.replacen(",40,38,25.5,true,true,", "", 1)).unwrap();
    let error = format!("{:#}", read_events(&path).unwrap_err());
    assert!(error.contains("events.csv") && error.contains("line: 2"), "{error}");
}

#[test]
fn runs_are_compared_in_one_picture() {
    let folder = tempfile::tempdir().unwrap();
    let poses = |drift: f64| -> Vec<StampedPose> {
        let rows = truth_rows().into_iter().enumerate();
        rows.map(|(index, row)| {
            let moved = row.pose.translation + Vector3::new(drift * index as f64, 0.1, 0.0);
            StampedPose { stamp_ns: row.stamp_ns, pose: Pose::new(row.pose.rotation, moved) }
        })
        .collect()
    };
    let run = |name: &str, drift: f64| {
        let poses = poses(drift);
        let errors = truth_rows().into_iter().zip(&poses).map(|(truth, pose)| ErrorSample {
            stamp_ns: pose.stamp_ns,
            error: pose.pose.local(&truth.pose),
            sigma: nalgebra::Vector6::repeat(0.05),
            nees: None,
        });
        ComparedRun {
            name: name.to_owned(),
            figures: "NEES 1.0".to_owned(),
            errors: errors.collect(),
            poses: poses.clone(),
        }
    };
    let comparison = Comparison {
        title: "Two runs".to_owned(),
        caption: vec!["An imperfect map.".to_owned()],
        truth: Truth { rows: truth_rows(), gravity: -Vector3::z() },
        keyframes: truth_rows().iter().step_by(20).map(|row| row.pose.translation).collect(),
        dropouts: [5, 25].map(|s| START_NS + s * 1_000_000_000..START_NS + (s + 4) * 1_000_000_000).to_vec(),
        runs: vec![run("odometry", 0.005), run("with the map", 0.0)],
    };
    let path = comparison::draw(&comparison, &folder.path().join("comparison.svg")).unwrap();
    let svg = std::fs::read_to_string(path).unwrap();
    assert!(svg.contains("odometry") && svg.contains("no matches") && !svg.contains("NaN"));
    assert!(svg.contains("An imperfect map.") && svg.contains("with the map. NEES 1.0"));
    if let Ok(keep) = std::env::var("KEEP_PICTURES") {
        std::fs::write(Path::new(&keep).join("comparison.svg"), svg).unwrap();
    }
}

#[test]
fn gaps_without_features_are_found_at_the_ends_too() {
    let format = protocol::DescriptorFormat { kind: protocol::DescriptorKind::Binary, width: 32 };
    let frame = |index: i64| {
        let has_features = index > 4 && index % 2 == 0 && index != 8;
        let features = has_features.then(|| (0, protocol::FeatureSet::empty(format)));
        sensors::Frame {
            stamp_ns: index,
            features: features.into_iter().collect(),
            ..sensors::Frame::default()
        }
    };
    let frames: Vec<_> = (0..20).map(frame).collect();
    assert_eq!(comparison::stretches_without_features(&frames, 2), [0..6, 6..10]);
    assert!(comparison::stretches_without_features(&[], 2).is_empty());
}

#[test]
fn an_ensemble_has_a_panel_an_output_and_what_is_beyond_its_top_stays_inside() {
    use evaluation::TimePoint;
    let folder = tempfile::tempdir().unwrap();
    let line = |name: &str, nees: f64| EnsembleLine {
        name: name.to_owned(),
        points: (0..50)
            .map(|k| TimePoint { seconds: f64::from(k), mean: nees, interval: (0.7, 1.4), runs: 20 })
            .collect(),
    };
    let empty = EnsembleLine { name: "odometry".to_owned(), points: Vec::new() };
    let panels = [("local pose", vec![line("good", 1.0), line("bad", 200.0)]), ("pose in G", vec![empty])];
    let path = draw_ensemble(&folder.path().join("nees.svg"), "NEES", &panels).unwrap();
    let picture = std::fs::read_to_string(path).unwrap();
    assert!(picture.contains("NEES, local pose") && picture.contains("bad"));
    assert!(!picture.contains("NEES, pose in G"), "nobody has it");
    assert!(!picture.lines().any(|line| line.trim() == "200"), "the axis ends where it can still be read");
}
