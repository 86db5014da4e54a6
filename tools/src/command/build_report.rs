//! What `build-map` prints.

use std::collections::BTreeSet;

use map::MapContents;
use mapping::{BuildReport, ExtensionReport, KeptImages, Spread};
use protocol::KeyframeId;

/// Real sensors have two to four times the noise that their calibration states, from a sensor at rest.
const MAX_PLAUSIBLE_NOISE_SCALE: f64 = 6.0;

/// Prints the report of a map of one recording.
pub(super) fn print_report(report: &BuildReport) {
    let spread = |spread: &Spread, digits: usize| {
        let Spread { mean, median, p95 } = spread;
        format!("mean {mean:.digits$}, median {median:.digits$}, 95 % below {p95:.digits$}")
    };
    let mean_length = report.observations as f64 / report.landmarks.max(1) as f64;
    println!("keyframes                   {}", report.keyframes);
    println!("landmarks                   {}", report.landmarks);
    println!("observations                {} ({mean_length:.1} a landmark)", report.observations);
    println!("  landmarks with 1, 2, ...  {}", histogram(&report.track_lengths));
    println!("landmarks a keyframe        {}", spread(&report.landmarks_per_keyframe, 0));
    if report.stereo_features > 0 {
        println!("features seen in stereo     {}", report.stereo_features);
    }
    for image in &report.unreadable_images {
        println!("left out                    {image}");
    }
    println!("pairs matched               {} with {} matches", report.pairs, report.matches);
    print_imu_noise(report.imu_noise_scale);
    if let Some(untracked) = &report.untracked_images {
        println!(
            "images without tracks       {} of {}, up to {:.1} s in a row that the IMU alone bridges: dark or covered?",
            untracked.images, untracked.of, untracked.longest_s
        );
    }
    if report.loops > 0 {
        println!(
            "loops                       {} found, {} of them refused",
            report.loops, report.refused_loops
        );
    }
    if report.pose_priors > 0 {
        println!(
            "pose priors                 {}, {} outside of the recording, {} refused",
            report.pose_priors, report.pose_priors_outside, report.refused_pose_priors
        );
    }
    println!("observations dropped        {}", report.dropped_observations);
    println!("reprojection error, px      {}", spread(&report.reprojection_px, 2));
    println!("  through the given poses   {}", spread(&report.reprojection_through_given_px, 2));
    println!("pixel sigma, px             {:.2}", report.sigma_px);
    println!("poses corrected by, deg     {}", spread(&report.pose_correction_deg, 2));
    println!("                    m       {}", spread(&report.pose_correction_m, 3));
    println!("sigma of poses per axis, deg {}", spread(&report.sigma_pose_deg, 3));
    println!("                         m   {}", spread(&report.sigma_pose_m, 3));
    if let Some(sigma) = report.sigma_scale {
        println!("sigma of scale, %           {:.3}", 100.0 * sigma);
    }
    if let Some(sigma) = report.sigma_tilt_deg {
        println!("sigma of tilt, deg          {sigma:.3}");
    }
    println!("correlated pairs            {}", report.cross_covariances);
    let few = BuildReport::FEW_LANDMARKS;
    println!("keyframes below {few} landmarks {}", report.poor_keyframes.len());
    if !report.poor_keyframes.is_empty() {
        let shown: Vec<String> = report.poor_keyframes.iter().take(20).map(ToString::to_string).collect();
        let more = if report.poor_keyframes.len() > 20 { ", ..." } else { "" };
        println!("  ids                       {}{more}", shown.join(", "));
    }
    println!("time                        {:.1} s", report.seconds);
}

/// The first counts, and the sum of the rest.
fn histogram(counts: &[usize]) -> String {
    const SHOWN: usize = 9;
    let mut text: Vec<String> = counts.iter().take(SHOWN).map(ToString::to_string).collect();
    if counts.len() > SHOWN {
        text.push(format!("and more: {}", counts[SHOWN..].iter().sum::<usize>()));
    }
    text.join(", ")
}

/// Prints the factor on the stated noise of the IMU, where one was learned.
fn print_imu_noise(scale: f64) {
    if scale > 0.0 {
        println!("noise of the IMU            {scale:.1} times the stated");
        if scale > MAX_PLAUSIBLE_NOISE_SCALE {
            println!(
                "                            images and IMU hardly agree: check the time offset between them, the extrinsics, and the \
                 noise that the calibration states"
            );
        }
    }
}

/// Prints what an extension did to the map.
pub(super) fn print_extension(report: &ExtensionReport) {
    println!("keyframes of the recording  {}", report.new_keyframes);
    for image in &report.unreadable_images {
        println!("left out                    {image}");
    }
    print_imu_noise(report.imu_noise_scale);
    println!("loops within it             {}", report.loops);
    println!("pixel sigma, px             {:.2}", report.sigma_px);
    println!(
        "places of the map           {} keyframes of the recording show one, {} agree",
        report.places, report.agreeing_places
    );
    println!(
        "  tied to the recording     {} of {} keyframes; the others follow",
        report.tied_keyframes, report.stored_keyframes
    );
    println!(
        "landmarks seen again        {} with {} observations",
        report.landmarks_seen_again, report.observations_of_them
    );
    println!(
        "keyframes of the map        {} moved by {:.3} deg, {:.3} m (RMS per axis)",
        report.stored_keyframes, report.moved_deg, report.moved_m
    );
    println!(
        "  sigma of their positions  {:.3} m before, {:.3} m now (RMS per axis)",
        report.sigma_before_m, report.sigma_after_m
    );
    println!("the map now                 {} keyframes, {} landmarks", report.keyframes, report.landmarks);
    println!("time                        {:.1} s", report.seconds);
}

/// Prints which images were kept.
pub(super) fn print_kept(kept: &KeptImages) {
    println!("images kept                 {}, {:.2} MB", kept.images, kept.bytes as f64 * 1e-6);
    for image in &kept.unreadable {
        println!("  not kept                  {image}");
    }
}

/// Says which added kinds of features a part of the keyframes has only.
pub(super) fn print_partial_kinds(contents: &MapContents) {
    let all = contents.keyframes.len();
    for added in &contents.added_features {
        let observations = added.landmarks.iter().flat_map(|landmark| &landmark.observations);
        let with: BTreeSet<KeyframeId> = observations.map(|seen| seen.keyframe).collect();
        if with.len() < all {
            let name = &added.kind.extractor;
            println!(
                "{name:<27} in {} of {all} keyframes: `driftless add-features --force` computes them where images are kept",
                with.len()
            );
        }
    }
}
