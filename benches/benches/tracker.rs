//! Times the tracker and the features on recorded images, one thread, without reading them:
//! `cargo bench -p driftless-benches --bench tracker`.
//!
//! Takes a folder of images as an argument; without one, EuRoC's `mh_01_handheld_16s` where `target/data` has it.
//! Prints the median over the frames, milliseconds.

use geometry::{Camera, Distortion};
use std::path::{Path, PathBuf};
use std::time::Instant;
use vision::features::open;
use vision::tracking::{Tracker, TrackerFrame, TrackerOptions};
use vision::{CornerOptions, Equalization, GrayImage, LocalEqualization, Pyramid, detect_corners};

/// Images held in memory at once.
const MAX_IMAGES: usize = 320;
/// Time between two images, nanoseconds.
const PERIOD_NS: i64 = 50_000_000;
/// Features are extracted from every so many images.
const FEATURE_STRIDE: usize = 10;
const MAX_FEATURES: usize = 1000;

fn main() {
    let given = std::env::args().skip(1).find(|argument| !argument.starts_with("--"));
    let recorded = "../target/data/images/mh_01_handheld_16s/mav0/cam0/data";
    let folder = given.unwrap_or_else(|| recorded.to_owned());
    let images = read_images(Path::new(&folder));
    if images.len() < 2 {
        println!("{folder} holds no two images; give a folder that does");
        return;
    }
    println!("{} images of {} x {}", images.len(), images[0].width(), images[0].height());
    time("pyramid", &images, |image| Pyramid::new(image.clone(), 4).levels());
    time("200 corners", &images, |image| {
        detect_corners(image, &[], None, 200, &CornerOptions::default()).len()
    });
    time("equalization", &images, |image| Equalization::Global.apply(image.clone()).width());
    let local = Equalization::Local(LocalEqualization::default());
    time("local equalization", &images, |image| local.apply(image.clone()).width());
    let equalizations = [
        ("tracker", Equalization::Off),
        ("tracker with global equalization", Equalization::Global),
        ("tracker with local equalization", local),
    ];
    for (name, equalization) in equalizations {
        let options = TrackerOptions::default().points(200).equalization(equalization);
        let Ok(mut tracker) = Tracker::new(camera(&images[0]), None, options) else { return };
        let mut stamp_ns = 0;
        time(name, &images, |image| {
            stamp_ns += PERIOD_NS;
            let frame = TrackerFrame {
                stamp_ns,
                image: image.clone(),
                second_image: None,
                rotation: None,
                sigma_rotation_rad: 0.0,
            };
            tracker.track(frame).map_or(0, |tracks| tracks.len())
        });
    }
    let some: Vec<GrayImage> = images.iter().step_by(FEATURE_STRIDE).cloned().collect();
    for name in ["sift-1", "edgepoint2-1"] {
        let Ok(mut extractor) = open(name, None) else { return };
        time(name, &some, |image| {
            extractor.extract(image, None, MAX_FEATURES).map_or(0, |features| features.keypoints.len())
        });
    }
}

/// Runs something on every image and prints the median of its time and of its result.
fn time(name: &str, images: &[GrayImage], mut run: impl FnMut(&GrayImage) -> usize) {
    let before = processor_seconds();
    let mut runs: Vec<(f64, usize)> = images
        .iter()
        .map(|image| {
            let begin = Instant::now();
            let result = run(image);
            (begin.elapsed().as_secs_f64() * 1e3, result)
        })
        .collect();
    let middle = runs.len() / 2;
    runs.sort_by_key(|run| run.1);
    let result = runs[middle].1;
    runs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (median, slow) = (runs[middle].0, runs[runs.len() * 95 / 100].0);
    let processor = (processor_seconds() - before) * 1e3 / images.len() as f64;
    println!(
        "{name:32} median {median:6.2} ms   95 % below {slow:6.2} ms   mean processor time {processor:6.2} ms   \
         result {result}"
    );
}

/// Time that this thread has had a processor, where the system tells: other programs do not count.
fn processor_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text.split_whitespace().next().and_then(|word| word.parse::<f64>().ok());
    nanoseconds.unwrap_or(f64::NAN) * 1e-9
}

fn read_images(folder: &Path) -> Vec<GrayImage> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.sort();
    files.iter().take(MAX_IMAGES).filter_map(|file| GrayImage::read(file).ok()).collect()
}

/// EuRoC's left camera, or one with as wide a view for images of another size.
fn camera(image: &GrayImage) -> Camera {
    let (width, height) = (image.width() as u32, image.height() as u32);
    if (width, height) == (752, 480) {
        let coefficients = [-0.283_408_11, 0.073_959_07, 0.000_193_59, 1.761_871_14e-05];
        let distortion = Distortion::RadialTangential(coefficients);
        return Camera { width, height, focal: [458.654, 457.296], centre: [367.215, 248.375], distortion };
    }
    let focal = 0.6 * f64::from(width);
    let centre = [f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0];
    Camera { width, height, focal: [focal; 2], centre, distortion: Distortion::None }
}
