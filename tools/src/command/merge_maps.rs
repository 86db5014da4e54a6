//! `driftless merge-maps`: makes one map of two that overlap.

use std::path::PathBuf;

use anyhow::bail;
use map::store::{MapTarget, load_map};
use mapping::{MergeReport, merge_maps};
use serde_json::json;

use super::build_report::print_partial_kinds;
use crate::stage_bar::StageBar;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless merge-maps hall.db yard.db --map site.db\n  \
    driftless merge-maps hall.db yard.db --map hall.db --force\n\n\
    The maps must show at least three places in common, be of the same feature extractor, and have z up. The result is in\n\
    the first one's frame and keeps its ids; keyframes and landmarks of the second one get ids beyond them. With --map\n\
    FIRST --force it is the next version of the first map, and robots in it stay localized.")]
pub struct Args {
    /// Database of the map whose frame and ids stay
    #[arg(value_name = "FIRST")]
    pub first: PathBuf,
    /// Database of the map that is added to it
    #[arg(value_name = "SECOND")]
    pub second: PathBuf,
    /// Database to create
    #[arg(long, value_name = "DB")]
    pub map: PathBuf,
    /// Replace an existing map: the new one is its next version, with the same identity
    #[arg(long)]
    pub force: bool,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// A map that cannot be read or written, maps that cannot be merged.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let target = MapTarget::new(&args.map, args.force)?;
    let first = load_map(&args.first)?.contents;
    let second = load_map(&args.second)?.contents;
    if first.info.identity.is_some() && first.info.identity == second.info.identity {
        bail!(
            "{} and {} are versions of one map: merged, everything would be counted twice",
            args.first.display(),
            args.second.display()
        );
    }
    let mut bar = StageBar::new(args.json);
    let (mut contents, report) =
        merge_maps(&first, &second, &mut |stage, done, all| bar.show(stage, done, all))?;
    bar.finish();
    if args.map != args.first {
        contents.info.name =
            args.map.file_stem().unwrap_or(args.map.as_os_str()).to_string_lossy().into_owned();
    }
    contents.info.created_by =
        format!("driftless merge-maps {} {}", args.first.display(), args.second.display());
    let saved = target.save(&contents)?;
    if args.json {
        println!(
            "{:#}",
            json!({ "map": args.map, "version": saved.version, "identity": saved.identity, "report": report })
        );
    } else {
        println!("{}: version {} of map {}", args.map.display(), saved.version, saved.identity);
        print(&report);
        print_partial_kinds(&contents);
    }
    Ok(())
}

fn print(report: &MergeReport) {
    let [first, second] = report.keyframes;
    println!("keyframes                   {first} + {second}");
    let [landmarks, others] = report.landmarks;
    println!(
        "landmarks                   {landmarks} + {others}, {} of them common",
        report.common_landmarks
    );
    println!("  alike, but elsewhere      {}", report.refused_landmarks);
    println!(
        "places of the first map     {} keyframes of the second show one, {} of them agree",
        report.places, report.agreeing_places
    );
    let [tied, others] = report.tied_keyframes;
    println!("  keyframes tied by them    {tied} + {others}; the others follow");
    let [yaw, x, y, z] = report.first_from_second;
    println!("second in the first frame   {yaw:.3} deg about z, then {x:.3}, {y:.3}, {z:.3} m");
    println!("first map moved by, an axis {:.4} m, {:.4} deg", report.moved_m, report.moved_deg);
    println!("its sigma per axis, m       {:.4} -> {:.4}", report.sigma_before_m, report.sigma_after_m);
    println!("time                        {:.1} s", report.seconds);
}
