//! `driftless import-colmap`: a map from a COLMAP model and its images.

use std::path::{Path, PathBuf};

use anyhow::bail;
use map::store::MapTarget;
use map_io::colmap::{ColmapModel, read_model};
use mapping::{ColmapFrame, Extraction, import_colmap, stamp_images};
use nalgebra::Vector3;
use onboard::arguments::{DEFAULT_MAX_FEATURES, FeatureArguments};
use sensors::{CalibrationFiles, Sequence};
use serde_json::json;
use vision::GrayImage;

use super::import_map::parse_direction;
use crate::stage_bar::StageBar;
use mapping::odometry_config;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless import-colmap sparse/0 --images my_run --map my.db\n  \
    driftless import-colmap sparse/0 --images photos --map hall.db --scale 0.42 --gravity 0,1,0\n\n\
    MODEL holds cameras, images and points3D, as .bin or .txt. Its poses, points and pixels become those of the map;\n\
    descriptors come from the images, and the covariance from the model's reprojection errors.\n\n\
    A model has no unit of length and no direction of gravity. Where the images are those of a recording with an IMU,\n\
    it gives both, the scale by the stereo baseline where there is one: images belong to it by their names, which are\n\
    time stamps in folders cam0 and cam1. Otherwise --scale and --gravity state them.")]
pub struct Args {
    /// Folder of the model
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Folder of the images that the model names, or the recording that they are of
    #[arg(long, value_name = "DIR")]
    pub images: PathBuf,
    /// Database to create
    #[arg(long, value_name = "DB")]
    pub map: PathBuf,
    /// The recording that gives scale and gravity [default: DIR, where it is a recording]
    #[arg(long, value_name = "REC", conflicts_with = "gravity")]
    pub recording: Option<PathBuf>,
    /// Metres in the model's unit of length [default: by the recording]
    #[arg(long, value_name = "M")]
    pub scale: Option<f64>,
    /// Standard deviation of --scale, relative
    #[arg(long, value_name = "PART", default_value_t = 0.01, requires = "scale")]
    pub sigma_scale: f64,
    /// Direction in which gravity points in the model's frame, for example 0,1,0; the map has z up [default: by the IMU of the
    /// recording]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_direction, allow_hyphen_values = true)]
    pub gravity: Option<Vector3<f64>>,
    /// Extractor of features for place recognition: sift-1, edgepoint2-1 (learned), or one with weights to fetch (see
    /// `driftless weights`) [default: sift-1]
    #[arg(long, value_name = "NAME")]
    pub extractor: Option<String>,
    /// Folder with the weights of learned extractors [default: where `driftless weights` puts them]
    #[arg(long, value_name = "DIR")]
    pub weights: Option<PathBuf>,
    /// Maximum number of features per image
    #[arg(long, value_name = "N", default_value_t = DEFAULT_MAX_FEATURES)]
    pub max_features: usize,
    /// Replace an existing map: the new one is its next version, with the same identity
    #[arg(long)]
    pub force: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// A model that cannot be read, a scale that is not known, readings that contradict it, a database that exists already.
#[expect(clippy::needless_pass_by_value, reason = "every command owns its arguments")]
pub fn run(args: Args) -> anyhow::Result<()> {
    let target = MapTarget::new(&args.map, args.force)?;
    let mut model = read_model(&args.model)?;
    let frame = frame(&args, &mut model)?;
    let features = FeatureArguments {
        extractor: args.extractor.clone(),
        weights: args.weights.clone(),
        max_features: args.max_features,
        // Of a robot that sees itself. The pixels are those that the model has.
        mask: Vec::new(),
    };
    let mut extractor = features.open()?;
    let mut extraction = Extraction {
        extractor: extractor.as_mut(),
        others: &mut [],
        max_features: args.max_features,
        masks: &[],
        cameras: 1,
    };
    let mut bar = StageBar::new(args.json);
    let name = args.map.file_stem().unwrap_or(args.map.as_os_str()).to_string_lossy();
    let created_by = format!("driftless import-colmap {}", args.model.display());
    let read = |name: &str| GrayImage::read(&path_of(&args.images, name));
    let imported = import_colmap(
        &model,
        &frame,
        read,
        &mut extraction,
        [&name, &created_by],
        &mut |stage, done, all| {
            bar.show(stage, done, all);
        },
    );
    bar.finish();
    let (contents, report) = imported?;
    let saved = target.save(&contents)?;
    if args.json {
        println!(
            "{:#}",
            json!({ "map": args.map, "version": saved.version, "identity": saved.identity, "report": report })
        );
        return Ok(());
    }
    println!("{}: version {} of map {}", args.map.display(), saved.version, saved.identity);
    println!("  keyframes                 {} of {} images", report.keyframes, model.images.len());
    println!("  landmarks                 {} of {} points", report.landmarks, model.points.len());
    println!(
        "  observations              {} with a descriptor, {} without, which are left out",
        report.observations, report.undescribed_observations
    );
    println!(
        "  scale                     {:.5} m in the model's unit, sigma {:.1} %",
        report.scale,
        100.0 * report.sigma_scale
    );
    println!("  sigma of a pixel          {:.2} px", report.sigma_px);
    match &frame.gravity {
        Some(gravity) => {
            let [x, y, z] = gravity.in_global.into();
            println!(
                "  gravity                   {x:.3}, {y:.3}, {z:.3}, sigma {:.2} deg",
                gravity.sigma_rad.to_degrees()
            );
        }
        None => {
            println!("  gravity                   not known");
        }
    }
    for image in &report.unreadable_images {
        eprintln!("left out: {image}");
    }
    Ok(())
}

/// Scale and gravity, by the switches or the recording, which also says when its images were taken by the clock of its IMU.
fn frame(args: &Args, model: &mut ColmapModel) -> anyhow::Result<ColmapFrame> {
    let positive = |value: f64| value.is_finite() && value > 0.0;
    if let Some(scale) = args.scale.filter(|scale| !positive(*scale)) {
        bail!("--scale {scale}: give a positive number of metres");
    }
    if !positive(args.sigma_scale) {
        bail!("--sigma-scale {}: give a positive number, for example 0.01", args.sigma_scale);
    }
    let scale = args.scale.map(|scale| (scale, args.sigma_scale));
    let is_recording = args.images.join("mav0").is_dir();
    let recording = args.recording.as_ref().or(is_recording.then_some(&args.images));
    match (recording, scale, args.gravity) {
        (Some(recording), scale, None) => {
            let (sequence, time_offset_ns) =
                Sequence::open_with_offset(recording, &CalibrationFiles::default())?;
            stamp_images(model, &sequence, time_offset_ns);
            Ok(ColmapFrame::of_recording(model, &sequence, scale, &odometry_config(&sequence)?)?)
        }
        (_, Some((scale, sigma)), gravity) => Ok(ColmapFrame::given(scale, sigma, gravity)),
        (Some(recording), None, Some(_)) => bail!(
            "{} is a recording, which gives scale and gravity: leave --gravity out, or give the scale with --scale, too",
            recording.display()
        ),
        (None, None, _) => bail!(
            "a COLMAP model has no unit of length: give the metres in it with --scale, or the recording of its images with \
             --recording REC"
        ),
    }
}

/// The file of an image: below the folder, or where a recording in the EuRoC layout has it.
fn path_of(folder: &Path, name: &str) -> PathBuf {
    let direct = folder.join(name);
    let parts = Path::new(name).parent().zip(Path::new(name).file_name());
    match parts {
        Some((camera, file)) if !direct.exists() => folder.join("mav0").join(camera).join("data").join(file),
        _ => direct,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser as _;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn switches_that_would_have_no_effect_are_errors() {
        let parsed = |switches: &str| {
            let line = ["import-colmap", "MODEL", "--images", "photos", "--map", "m.db"];
            Line::try_parse_from(line.into_iter().chain(switches.split_whitespace()))
        };
        assert!(parsed("--sigma-scale 0.02").is_err() && parsed("--mask hood.png").is_err());
        let args = parsed("--scale 0.4 --sigma-scale 0.02 --extractor edgepoint2-1").map(|line| line.args);
        assert_eq!(args.map(|args| args.extractor).ok().flatten().as_deref(), Some("edgepoint2-1"));
        assert!(parsed("").is_ok());
    }
}
