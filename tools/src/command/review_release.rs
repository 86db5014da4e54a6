//! `driftless review-release`: whether a candidate may be promoted.

use super::publish_map::VerifyingArgs;
use super::releases::in_store;
use crate::review::{Drive, Gates, Review, Side, write_page};
use anyhow::{Context as _, Result, ensure};
use onboard::RobotArguments;
use onboard::arguments::CalibrationArguments;
use recognition::LoadedMap;
use releases::{ReleaseChoice, fetch};
use std::path::PathBuf;
use std::sync::Arc;

/// Exit code where a gate refuses the candidate.
const REFUSED: i32 = 3;

/// Arguments.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  driftless review-release s3://bucket/city --drive monday.mcap --out review\n  \
    driftless review-release s3://bucket/city candidate-3 --drive monday --drive tuesday --against 6 --out review\n\n\
    Localizes the drives in the candidate and in the live release, as a robot and image by image from cold, and compares.\n\
    Writes DIR/review.html and DIR/review.json, and the runs of both. Then: driftless promote-release, or reject-release.\n\n\
    Exit code: 0 where every gate passes, 3 where one refuses, with the reason; 1 for an error, 2 for wrong switches"
)]
pub struct Args {
    /// Where the releases are
    #[arg(value_name = "URL")]
    url: String,
    /// What is reviewed: candidate, candidate-3, or the number of a release
    #[arg(value_name = "CANDIDATE", default_value_t = ReleaseChoice::NewestCandidate)]
    candidate: ReleaseChoice,
    /// What it is compared with
    #[arg(long, value_name = "RELEASE", default_value_t)]
    against: ReleaseChoice,
    /// A drive through the place, best one that the candidate was not made of: a folder in the EuRoC layout, or a bag; may be given
    /// several times
    #[arg(long = "drive", value_name = "REC", required = true)]
    drives: Vec<PathBuf>,
    /// Localize images of the drives from cold at this distance, s
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0)]
    cold_every: f64,
    #[command(flatten)]
    verifying: VerifyingArgs,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    gates: Gates,
    #[command(flatten)]
    calibration: CalibrationArguments,
    #[command(flatten)]
    robot: RobotArguments,
}

/// Runs the command.
///
/// # Errors
/// A store, a release or a drive that cannot be read, a folder that cannot be written.
pub fn run(args: &Args) -> Result<()> {
    let [live, candidate] = read_sides(args)?;
    let drives: Result<Vec<Drive>> = args
        .drives
        .iter()
        .map(|drive| Drive::read(drive, &args.calibration, &args.robot, &live.map, args.cold_every))
        .collect();
    let out = &args.robot.out;
    std::fs::create_dir_all(out).with_context(|| format!("{} cannot be made", out.display()))?;
    let review = Review::of(&live, &candidate, &drives?, &args.gates, out)?;
    let (page, json) = (out.join("review.html"), out.join("review.json"));
    write_page(&review, &page)?;
    let text = serde_json::to_string_pretty(&review)?;
    files::write_whole(&json, text.as_bytes())
        .with_context(|| format!("{} cannot be written", json.display()))?;
    if args.json {
        println!("{text}");
    } else {
        print(&review);
        println!("written to {}", page.display());
    }
    if !review.refusals.is_empty() {
        std::process::exit(REFUSED);
    }
    Ok(())
}

/// The live release and the candidate.
fn read_sides(args: &Args) -> Result<[Side; 2]> {
    let maps = in_store(&args.url, async |store| {
        let store = args.verifying.apply(store);
        let mut maps = Vec::new();
        for choice in [args.against, args.candidate] {
            let release = choice.of(&store).await?;
            maps.push((release.title(), fetch(&store, &release, None).await?));
        }
        Ok(maps)
    })?;
    if let [(live, _), (candidate, _)] = maps.as_slice() {
        ensure!(live != candidate, "{live} would be compared with itself: give another with --against");
    }
    let mut sides = Vec::new();
    for (title, contents) in maps {
        let map = LoadedMap::from_contents(contents).with_context(|| title.clone())?;
        sides.push(Side { title, map: Arc::new(map) });
    }
    sides.try_into().map_err(|_| anyhow::anyhow!("two releases are compared"))
}

fn print(review: &Review) {
    println!("{} against {}", review.candidate, review.live);
    crate::map_difference::print_difference(&review.structure.difference);
    for drive in &review.drives {
        println!("{}", drive.recording);
        for (title, figures) in [(&review.live, &drive.live), (&review.candidate, &drive.candidate)] {
            let errors = figures.errors.as_ref().map(|errors| {
                let to = if errors.is_to_truth { "off the truth" } else { "off the live map" };
                format!("; {:.3} m RMS and {:.3} m at most {to}", errors.rmse_m, errors.largest_m)
            });
            println!(
                "  {title}: {} of {} answers used{}; from cold {} of {} images, {} in a wrong place, within {:.1} s (95 %)",
                figures.accepted,
                figures.queries,
                errors.unwrap_or_default(),
                figures.cold.localized,
                figures.cold.images,
                figures.cold.wrong,
                figures.cold.map_initialization_p95_s
            );
        }
    }
    if review.refusals.is_empty() {
        println!("every gate passes");
    } else {
        println!("{} should not be promoted:", review.candidate);
    }
    for refusal in &review.refusals {
        let drive = refusal.drive.as_ref().map_or_else(String::new, |drive| format!("{drive}: "));
        println!("  {drive}{} ({})", refusal.reason, refusal.gate);
    }
}
