//! `driftless add-features`: computes features of a further kind for a map whose images were kept.

use std::path::PathBuf;

use anyhow::bail;
use map::store::{MapTarget, load_map};
use mapping::{AddOptions, AddedReport, add_features};
use onboard::arguments::FeatureArguments;
use serde_json::json;

use crate::stage_bar::StageBar;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless build-map my_run --map my.db --keep-images\n  \
    driftless add-features --map my.db --features edgepoint2-1\n  \
    driftless add-features --map my.db --features xfeat-1 --to my_with_xfeat.db\n\n\
    The features are triangulated from the map's keyframes, whose poses and covariances stay as they are: robots stay\n\
    localized. DB becomes its next version, and a server is told as after a build. A server answers a query with the kind\n\
    of features that it has. `driftless edit-map --drop-images` then takes the images out, `--drop-features` a kind.")]
pub struct Args {
    /// Database of the map
    #[arg(long, value_name = "DB")]
    pub map: PathBuf,
    /// Extractor: sift-1, edgepoint2-1, or one with weights to fetch (see `driftless weights`); without its version, edgepoint2, the
    /// newest one
    #[arg(long, value_name = "NAME")]
    pub features: String,
    /// Write another map instead of the next version of DB
    #[arg(long, value_name = "DB")]
    pub to: Option<PathBuf>,
    /// Folder with the weights of learned extractors [default: where `driftless weights` puts them]
    #[arg(long, value_name = "DIR")]
    pub weights: Option<PathBuf>,
    /// Maximum number of features per image
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub max_features: usize,
    /// Compute features again that the map has already
    #[arg(long)]
    pub force: bool,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// A map that cannot be read or written, that keeps no images, or that has the features already; an extractor that is not known.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let target = MapTarget::new(args.to.as_ref().unwrap_or(&args.map), args.to.is_none())?;
    let mut contents = load_map(&args.map)?.contents;
    let features = FeatureArguments {
        extractor: Some(full_name(&args.features)),
        weights: args.weights.clone(),
        max_features: args.max_features,
        mask: Vec::new(),
    };
    let mut extractors = features.open_several()?;
    let Some((extractor, others)) = extractors.split_first_mut() else {
        bail!("no extractor was opened");
    };
    let options = AddOptions {
        extractor: extractor.as_mut(),
        others,
        max_features: args.max_features,
        replace: args.force,
    };
    let mut bar = StageBar::new(args.json);
    let report = add_features(&mut contents, options, &mut |stage, done, all| bar.show(stage, done, all))?;
    bar.finish();
    let saved = target.save(&contents)?;
    if args.json {
        println!(
            "{:#}",
            json!({ "map": target.path(), "version": saved.version, "identity": saved.identity, "report": report })
        );
    } else {
        println!("{}: version {} of map {}", target.path().display(), saved.version, saved.identity);
        print(&report);
    }
    Ok(())
}

/// The name of an extractor with its version, which may be left out: of each there is one.
fn full_name(name: &str) -> String {
    match name {
        "sift" | "edgepoint2" | "xfeat" | "r2d2" => format!("{name}-1"),
        "edgepoint" => "edgepoint2-1".to_owned(),
        other => other.to_owned(),
    }
}

fn print(report: &AddedReport) {
    println!("features of                 {}", report.extractor);
    println!("images                      {}, {} features in all", report.images, report.features);
    if report.without_image > 0 {
        println!("keyframes without image     {}: they have no features of this kind", report.without_image);
    }
    println!("pairs matched               {} with {} matches", report.pairs, report.matches);
    let mean_length = report.observations as f64 / report.landmarks.max(1) as f64;
    println!("landmarks                   {}", report.landmarks);
    println!("observations                {} ({mean_length:.1} a landmark)", report.observations);
    println!("observations dropped        {}", report.dropped_observations);
    println!("pixel sigma, px             {:.2}", report.sigma_px);
    println!("time                        {:.1} s", report.seconds);
}
