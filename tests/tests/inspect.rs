//! The inspection of a query agrees with the reply, and the plot shows it.

use clap::Parser;
use protocol::{LocalizeRequest, MatchOutcome};
use recognition::{InspectedKeyframe, Inspection, KeyframeVerdict, RecognitionOptions};
use sensors::writer;
use std::collections::HashSet;
use std::path::Path;
use tests::robot::{images, request};
use tests::scenario::MappedScenario;
use tools::command::inspect::{Args, Report, inspect};
use vision::GrayImage;

/// Squared distance in units of its covariance that a candidate's own pose may have to the answer's; 99.9 % of
/// consistent poses have less (chi-square, 6 degrees of freedom), and most candidates share landmarks with the answer.
const CONSISTENT: f64 = 22.5;

#[derive(Parser)]
struct CommandLine {
    #[command(flatten)]
    args: Args,
}

fn args(words: &[&str]) -> Args {
    CommandLine::try_parse_from([&["inspect"], words].concat()).unwrap().args
}

fn question(frame: usize) -> LocalizeRequest {
    let asked = request(&MappedScenario::shared().recordings.live, frame);
    LocalizeRequest { camera: asked.camera, features: asked.features, prior: None, gravity_in_camera: None }
}

fn ask(request: &LocalizeRequest) -> Inspection {
    MappedScenario::shared().loaded().inspect(request, &RecognitionOptions::default()).unwrap()
}

/// Inliers are within the gate, all other matches beyond it, and the mean is that of the inliers.
fn check_errors(keyframe: &InspectedKeyframe) {
    let mut sum = 0.0;
    for found in &keyframe.matches {
        let within = found.error_px().is_some_and(|error| error <= keyframe.gate_px);
        assert_eq!(found.inlier, within, "{found:?}");
        sum += if found.inlier { found.error_px().unwrap() } else { 0.0 };
    }
    let mean = sum / keyframe.inliers() as f64;
    assert!((mean - keyframe.mean_error_px.unwrap()).abs() < 1e-6, "{mean} {:?}", keyframe.mean_error_px);
}

#[test]
fn an_inspection_agrees_with_the_answer() {
    let (scenario, options) = (MappedScenario::shared(), RecognitionOptions::default());
    let map = scenario.loaded();
    for &frame in images(&scenario.recordings.live).iter().step_by(12) {
        let request = question(frame);
        let inspection = map.inspect(&request, &options).unwrap();
        assert_eq!(inspection.reply, map.localize(&request, &options).unwrap());
        let fix = inspection.reply.fix.as_ref().unwrap();
        let best = &inspection.keyframes[0];
        assert_eq!((best.id, best.verdict, best.in_answer), (fix.keyframe, KeyframeVerdict::Verified, true));
        assert!(best.inliers() > 0 && best.inliers() <= best.matches.len());
        for keyframe in inspection.keyframes.iter().filter(|keyframe| keyframe.in_answer) {
            check_errors(keyframe);
            let pose = keyframe.global_from_camera.unwrap();
            let difference = fix.global_from_camera.pose.local(&pose.pose);
            let covariance = pose.covariance + fix.global_from_camera.covariance;
            let squared = difference.dot(&covariance.cholesky().unwrap().solve(&difference));
            assert!(squared < CONSISTENT, "frame {frame}, keyframe {}: {squared}", keyframe.id);
        }
        let alone = map.inspect_keyframe(&request, best.id, &options).unwrap().unwrap();
        assert_eq!(alone, InspectedKeyframe { in_answer: false, ..best.clone() });
    }
}

#[test]
fn a_feature_that_was_moved_is_an_outlier() {
    let mut request = question(images(&MappedScenario::shared().recordings.live)[20]);
    let before = ask(&request).keyframes[0].clone();
    let moved: HashSet<usize> =
        before.matches.iter().filter(|found| found.inlier).map(|found| found.feature).take(9).collect();
    for &feature in &moved {
        request.features.pixels[feature][1] += 6.0 * before.gate_px as f32;
    }
    let after = ask(&request).keyframes.into_iter().find(|keyframe| keyframe.id == before.id).unwrap();
    check_errors(&after);
    let matched: Vec<_> = after.matches.iter().filter(|found| moved.contains(&found.feature)).collect();
    assert_eq!(matched.len(), 9);
    assert!(matched.iter().all(|found| !found.inlier), "{matched:?}");
}

#[test]
fn a_query_that_is_not_recognized_has_a_reason() {
    let full = question(images(&MappedScenario::shared().recordings.live)[20]);
    // The same features at permuted pixels: everything matches, and no pose fits.
    let mut shuffled = full.clone();
    let count = shuffled.features.pixels.len();
    shuffled.features.pixels = (0..count).map(|at| full.features.pixels[(at * 37 + 11) % count]).collect();
    let inspection = ask(&shuffled);
    assert_eq!((inspection.reply.outcome, &inspection.reply.fix), (MatchOutcome::NotVerified, &None));
    let best = &inspection.keyframes[0];
    assert_eq!((best.verdict, best.inliers(), best.global_from_camera), (KeyframeVerdict::NoPose, 0, None));
    assert!(best.matches.len() > 20 && best.matches.iter().all(|found| found.error_px().is_none()));

    let mut few = full.clone();
    few.features.pixels.truncate(3);
    few.features.descriptors.bytes.truncate(3 * usize::from(few.features.descriptors.width));
    let inspection = ask(&few);
    assert_eq!(inspection.reply.outcome, MatchOutcome::TooFewFeatures);
    assert!(inspection.keyframes.is_empty());
}

/// Writes the scenario's live run and its map, and inspects the run at `at`.
fn inspect_in(folder: &Path, at: &str, more: &[&str]) -> anyhow::Result<Report> {
    let (live, map, out) = (folder.join("live <&>"), folder.join("ring.db"), folder.join("picture.svg"));
    if !map.exists() {
        writer::write(&MappedScenario::shared().recordings.live, &live).unwrap();
        MappedScenario::shared().database(folder);
    }
    let words =
        [live.to_str().unwrap(), "--at", at, "--map", map.to_str().unwrap(), "--out", out.to_str().unwrap()];
    inspect(&args(&[&words, more].concat()))
}

#[test]
fn the_picture_is_xml_with_a_line_for_every_match() {
    let folder = tempfile::tempdir().unwrap();
    let report = inspect_in(folder.path(), "12.2", &[]).unwrap();
    let shown = report.shown.unwrap();
    assert_eq!(Some(shown.id), report.inspection.reply.fix.map(|fix| fix.keyframe));
    let text = std::fs::read_to_string(&report.picture).unwrap();
    let drawing = roxmltree::Document::parse(&text).unwrap();
    let of_class = |class: &str| {
        drawing
            .descendants()
            .filter(|node| node.has_tag_name("line") && node.attribute("class") == Some(class))
            .count()
    };
    let lines = ["inlier", "outlier", "unposed"].map(of_class);
    assert_eq!(lines, [shown.inliers(), shown.matches.len() - shown.inliers(), 0]);
    let hovers = drawing.descendants().filter(|node| node.has_tag_name("title")).count();
    assert_eq!(hovers, shown.matches.len());
}

#[test]
fn images_are_inside_the_picture() {
    // Grey images of the right size stand in for real ones: the features come from the recording.
    let scenario = MappedScenario::shared();
    let folder = tempfile::tempdir().unwrap();
    let sequence = folder.path().join("map");
    let mut keyframes = scenario.recordings.map.clone();
    let stamps: HashSet<i64> = scenario.map.keyframes.iter().map(|keyframe| keyframe.stamp_ns).collect();
    keyframes.frames.retain(|frame| stamps.contains(&frame.stamp_ns));
    writer::write(&keyframes, &sequence).unwrap();
    let camera = &scenario.recordings.map.cameras[0].camera;
    let grey = GrayImage::from_fn(camera.width as usize, camera.height as usize, |x, y| (x + y) as u8);
    let data = sequence.join("mav0/cam0/data");
    std::fs::create_dir(&data).unwrap();
    let list = std::fs::read_to_string(sequence.join("mav0/cam0/data.csv")).unwrap();
    for row in list.lines().skip(1) {
        grey.write(&data.join(row.split(',').nth(1).unwrap())).unwrap();
    }
    let report = inspect_in(folder.path(), "12.2", &["--recording", sequence.to_str().unwrap()]).unwrap();
    let text = std::fs::read_to_string(&report.picture).unwrap();
    let drawing = roxmltree::Document::parse(&text).unwrap();
    let images: Vec<_> = drawing.descendants().filter(|node| node.has_tag_name("image")).collect();
    assert_eq!(images.len(), 1, "the live run has no images, the map's has");
    assert!(images[0].attribute("href").unwrap().starts_with("data:image/png;base64,iVBORw0KGgo"));
}

#[test]
fn errors_name_what_cannot_be_inspected() {
    let folder = tempfile::tempdir().unwrap();
    let error = |at: &str, more: &[&str]| format!("{:#}", inspect_in(folder.path(), at, more).unwrap_err());
    let said = error("99", &[]);
    assert!(said.contains("--at 99") && said.contains("live <&>") && said.contains("29.5"), "{said}");
    let said = error("12", &["--keyframe", "987654"]);
    assert!(said.contains("987654") && said.contains("ring.db"), "{said}");
    let live = folder.path().join("live <&>");
    let said = error("12", &["--recording", folder.path().to_str().unwrap()]);
    assert!(said.contains("--recording") && said.contains("mav0 is missing"), "{said}");
    let camera = live.join("mav0/cam0/sensor.yaml");
    let said = error("12", &["--camera", camera.to_str().unwrap()]);
    assert!(said.contains("--camera"), "{said}");

    let (file, map) = (folder.path().join("small.png"), folder.path().join("ring.db"));
    let [file_name, map, camera] = [&file, &map, &camera].map(|path| path.to_str().unwrap());
    let image = |words: &[&str]| {
        let words = [&[file_name, "--map", map], words].concat();
        format!("{:#}", inspect(&args(&words)).unwrap_err())
    };
    let said = image(&["--camera", camera]);
    assert!(said.contains("small.png") && said.contains("PNG or JPEG"), "{said}");
    GrayImage::from_fn(20, 10, |_, _| 0).write(&file).unwrap();
    let said = image(&["--camera", camera]);
    assert!(said.contains("small.png has 20 x 10") && said.contains("sensor.yaml"), "{said}");
    assert!(image(&[]).contains("--camera"), "no camera");
    assert!(image(&["--camera", camera, "--at", "3"]).contains("--at"), "no recording");
}
