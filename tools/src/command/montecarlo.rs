//! `driftless montecarlo`: many simulated runs, and the consistency of the filter.

use crate::plotting::{EnsembleLine, draw_ensemble};
use anyhow::{Context, bail};
use estimator::EstimatorConfig;
use evaluation::trajectory::{StateKind, tum};
use indicatif::{ProgressBar, ProgressStyle};
use onboard::arguments::{Cameras, Mode, read_settings};
use simulation::monte_carlo::score::{ScoreOptions, pose_nees_over_time};
use simulation::monte_carlo::{
    AnswerOptions, CalibrationErrors, EnsembleScore, FilterStart, MapOptions, MonteCarloOptions, Variant,
    VariantRuns, report, run as run_all, score,
};
use simulation::{Scenario, SimulationOptions};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Examples:
  driftless montecarlo --mode odometry --cameras mono,stereo
  driftless montecarlo --trajectory loops --seconds 400 --match-every 4 --mode multi,mapconst --svg nees.svg
  driftless montecarlo --seconds 120 --gap 30:90 --wrong-matches 0.3 --wrong-place 0.2 --runs 100
  driftless montecarlo --trajectory loops --speed 5.6 --seconds 203.3 --gap 20:201    # 1 km without the map, three answers
  driftless montecarlo --estimator-config paper.yaml --estimator-config ours.yaml --json

How to read the table: NEES is the squared error in units of the filter's own covariance, per degree of freedom. 1 is
consistent, above 1 overconfident, below 1 conservative. Errors of one run are correlated in time, so a run counts as ONE
sample: its NEES averaged over time (of G_T_L: its last estimate). The mean over the N runs is tested against
chi2(N n)/(N n) at 95 %, n = 3 or 6: \"ok\" inside, \"near\" outside but within 0.7..1.4, otherwise \"HIGH\" or \"LOW\". A
time average varies less than a single sample, so a failure is significant; the bracket is a confidence interval of the
true mean (Student's t over runs). The percentage is the fraction of instants at which the mean over runs is within the
interval: about 95 for a consistent filter. \"Ended within 3 sigma\" counts the runs whose last pose in G was within 3
sigma of the truth (99.73 % of 6 degrees of freedom): the figure for recovery after a gap.
(Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2.)

Every seed has its own trajectory, landmarks, noise, map and initial state. The initial state is the truth minus a sample
of the covariance that the filter starts from; all variants get the same samples.")]
pub struct Args {
    /// Number of runs of each variant, each with its own seed
    #[arg(long, default_value_t = 20)]
    runs: usize,
    /// Seed of the first run
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of parallel runs [default: one a processor]
    #[arg(long)]
    threads: Option<usize>,
    /// The trajectory: block (street, from rest), loops (10 x 126 m, in motion), room (hand-held, from rest), flight
    /// (indoors, from rest), or a TUM file
    #[arg(long, value_name = "NAME|TUM", default_value = "block")]
    trajectory: String,
    /// Length of a run, seconds
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
    /// Speed on block or loops, m/s [default: 4 on block, 3.14 on loops]
    #[arg(long, value_name = "M/S")]
    speed: Option<f64>,
    /// Cameras of the filter; several, separated by commas, are compared
    #[arg(long, value_enum, value_delimiter = ',', default_value = "stereo")]
    cameras: Vec<Cameras>,
    /// Use of the map; several, separated by commas, are compared
    #[arg(long, value_enum, value_delimiter = ',', default_value = "multi")]
    mode: Vec<Mode>,
    /// YAML file with estimator settings, as for `driftless run`; given several times, they are compared
    #[arg(long, value_name = "FILE")]
    estimator_config: Vec<PathBuf>,
    /// Time between two queries of the map, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0)]
    match_every: f64,
    /// Drop-out: no replies between these times, seconds; may be given several times
    #[arg(long, value_name = "FROM:TO", value_parser = interval)]
    gap: Vec<(f64, f64)>,
    /// Most matches in a reply
    #[arg(long, value_name = "N", default_value_t = AnswerOptions::default().max_matches)]
    matches: usize,
    /// Most keyframes in a reply
    #[arg(long, value_name = "N", default_value_t = AnswerOptions::default().max_keyframes)]
    max_keyframes: usize,
    /// Fraction of wrong matches in every reply
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0)]
    wrong_matches: f64,
    /// Fraction of replies of another place that looks the same (never the first, which nothing contradicts)
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0)]
    wrong_place: f64,
    /// Standard deviation of the map's keyframes an axis, as stated to the filter; the paper's by default
    #[arg(long, value_name = "DEG:M", value_parser = pair, default_value = "0.905:0.1")]
    map_noise: (f64, f64),
    /// Standard deviation of the error that the landmarks of a keyframe share, as a fraction of their distance; in the map
    /// and in the filter
    #[arg(long, value_name = "FRACTION", default_value_t = MapOptions::default().shift)]
    map_shift: f64,
    /// Distance between keyframes of the map, metres
    #[arg(long, value_name = "M", default_value_t = MapOptions::default().keyframe_distance_m)]
    keyframe_distance: f64,
    /// Initial standard deviations of the yaw and position in L [default: nearly exact]
    #[arg(long, value_name = "DEG:M", value_parser = pair)]
    sigma_start: Option<(f64, f64)>,
    /// Standard deviation of tracked pixels, px, in the images and in the filter
    #[arg(long, value_name = "PX", default_value_t = SimulationOptions::default().sigma_track_px)]
    pixel_noise: f64,
    /// White noise of the IMU as a multiple of what the filter is told
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    true_imu_noise: f64,
    /// Standard deviation of tracked pixels in the images, px [default: as the filter is told]
    #[arg(long, value_name = "PX")]
    true_track_noise: Option<f64>,
    /// Standard deviation of matched pixels in the images and in the map, px; the filter is told 1
    #[arg(long, value_name = "PX", default_value_t = SimulationOptions::default().sigma_feature_px)]
    true_match_noise: f64,
    /// Start with the error of unknown biases instead of a small one (0.1 rad/s and 0.2 m/s^2, unless the settings differ)
    #[arg(long)]
    unknown_biases: bool,
    /// Let the filter initialize itself, at rest or in motion, instead of starting near the truth
    #[arg(long, conflicts_with_all = ["unknown_biases", "sigma_start"])]
    own_start: bool,
    /// Fraction of tracked pixels that are 10 to 50 px off
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0)]
    outliers: f64,
    /// Most tracks in an image
    #[arg(long, value_name = "N", default_value_t = SimulationOptions::default().max_tracks)]
    tracks: usize,
    /// Error of the cameras' pose on the body as the filter is given it, in a random direction
    #[arg(long, value_name = "DEG:M", value_parser = pair)]
    extrinsic_error: Option<(f64, f64)>,
    /// Error of the stamps of images, seconds; the sign is random
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    time_offset: f64,
    /// Relative error of the focal lengths as the filter is given them; the sign is random
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0)]
    focal_error: f64,
    /// Score the local pose from this time after the begin on, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = ScoreOptions::default().skip_s)]
    skip: f64,
    /// Score G_T_L and the pose in G from this time after the map initialization on, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = ScoreOptions::default().skip_after_initialization_s)]
    skip_after_initialization: f64,
    /// Plot the NEES over time with its bounds
    #[arg(long, value_name = "SVG")]
    svg: Option<PathBuf>,
    /// Print the scores as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// Options out of range, settings or a trajectory that cannot be read, a plot that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let options = options(args)?;
    let variants = variants(args, &options.simulation)?;
    let bar = run_bar(options.runs);
    let all = run_all(&options, &variants, |done| bar.set_position(done as u64))
        .context("the simulation is impossible")?;
    bar.finish_and_clear();
    let scoring =
        ScoreOptions { skip_s: args.skip, skip_after_initialization_s: args.skip_after_initialization };
    let scores: Vec<EnsembleScore> = all.iter().map(|runs| score(runs, &scoring)).collect();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&scores)?);
    } else {
        let title = format!("{} runs of {:.0} s, {}", args.runs, args.seconds, args.trajectory);
        print!("{}", report::table(&title, &all, &scores));
    }
    if let Some(path) = &args.svg {
        draw(path, args, &all, &scoring)?;
    }
    Ok(())
}

fn run_bar(runs: usize) -> ProgressBar {
    let bar = ProgressBar::new(runs as u64);
    // The template is a constant that is known to parse.
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} runs  {elapsed_precise}") {
        bar.set_style(style);
    }
    bar
}

fn options(args: &Args) -> anyhow::Result<MonteCarloOptions> {
    if args.runs == 0 {
        bail!("--runs is 0; at least one is needed, and 20 for a verdict");
    }
    let fractions = [
        ("wrong-matches", args.wrong_matches),
        ("wrong-place", args.wrong_place),
        ("map-shift", args.map_shift),
    ];
    for (name, fraction) in fractions {
        if !(0.0..=1.0).contains(&fraction) {
            bail!("--{name} is {fraction}; a fraction lies between 0 and 1");
        }
    }
    let positive = [
        ("match-every", args.match_every),
        ("map-noise", args.map_noise.0.min(args.map_noise.1)),
        ("keyframe-distance", args.keyframe_distance),
    ];
    for (name, value) in positive {
        if !(value.is_finite() && value > 0.0) {
            bail!("--{name} is {value}; it must be positive");
        }
    }
    let (scenario, given) = trajectory(&args.trajectory)?;
    let (extrinsic_deg, extrinsic_m) = args.extrinsic_error.unwrap_or_default();
    Ok(MonteCarloOptions {
        runs: args.runs,
        first_seed: args.seed,
        threads: args.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from)),
        simulation: SimulationOptions {
            scenario,
            speed: args.speed.unwrap_or(scenario.usual_speed()),
            depth_m: scenario.depth_m(),
            duration_s: Some(args.seconds),
            map_trajectory: given,
            max_tracks: args.tracks,
            imu_noise_scale: args.true_imu_noise,
            sigma_track_px: args.true_track_noise.unwrap_or(args.pixel_noise),
            sigma_feature_px: args.true_match_noise,
            outlier_fraction: args.outliers,
            live_feature_period_s: 1e9,
            ..SimulationOptions::default()
        },
        map_change: None,
        wheels: None,
        gnss: None,
        map: MapOptions {
            sigma_theta_rad: args.map_noise.0.to_radians(),
            sigma_p_m: args.map_noise.1,
            shift: args.map_shift,
            keyframe_distance_m: args.keyframe_distance,
        },
        answers: AnswerOptions {
            every_s: args.match_every,
            gaps_s: args.gap.iter().map(|&(from, to)| Range { start: from, end: to }).collect(),
            wrong_matches: args.wrong_matches,
            wrong_place: args.wrong_place,
            max_keyframes: args.max_keyframes,
            max_matches: args.matches,
            ..AnswerOptions::default()
        },
        start: match (args.own_start, args.unknown_biases) {
            (true, _) => FilterStart::Initialization,
            (false, true) => FilterStart::UnknownBiases,
            (false, false) => FilterStart::KnownBiases,
        },
        disturbance: None,
        calibration: CalibrationErrors {
            rotation_rad: extrinsic_deg.to_radians(),
            translation_m: extrinsic_m,
            time_offset_s: args.time_offset,
            focal_fraction: args.focal_error,
        },
    })
}

/// A built-in trajectory by its name, or one from a file.
fn trajectory(name: &str) -> anyhow::Result<(Scenario, Option<Vec<evaluation::trajectory::StampedPose>>)> {
    Ok(match name {
        "block" => (Scenario::Block, None),
        "loops" => (Scenario::Loops, None),
        "room" => (Scenario::Room, None),
        "flight" => (Scenario::Flight, None),
        file => {
            let given = tum::read(Path::new(file));
            let problem =
                || format!("--trajectory {file} is neither block, loops, room, flight nor a TUM file");
            (Scenario::Block, Some(given.with_context(problem)?))
        }
    })
}

/// Stated to the filter where the map's landmarks are exact: it takes positive numbers only.
const EXACT: f64 = 1e-9;

/// Every mode with every number of cameras and every settings file.
fn variants(args: &Args, simulation: &SimulationOptions) -> anyhow::Result<Vec<Variant>> {
    let mut defaults = EstimatorConfig::default();
    defaults.imu_noise = simulation.imu_noise;
    defaults.sigma_track_px = args.pixel_noise;
    defaults.sigma_map_shift_fraction = args.map_shift.max(EXACT);
    if let Some((deg, metres)) = args.sigma_start {
        defaults.initial.sigma_yaw_rad = deg.to_radians();
        defaults.initial.sigma_position_m = metres;
    }
    let mut settings = Vec::new();
    for path in &args.estimator_config {
        let name = path.file_stem().map_or_else(String::new, |stem| format!(" {}", stem.to_string_lossy()));
        settings.push((name, read_settings(path, &defaults)?));
    }
    if settings.is_empty() {
        settings.push((String::new(), defaults));
    }
    let mut variants = Vec::new();
    for (file, config) in &settings {
        for cameras in &args.cameras {
            for mode in &args.mode {
                let (count, rig) = match cameras {
                    Cameras::Mono => (1, "mono"),
                    Cameras::Stereo => (2, "stereo"),
                    // The simulated robot has two.
                    Cameras::All => (2, "all"),
                };
                let mut config = config.clone();
                config.mode = (*mode).into();
                config.validate().map_err(|reason| anyhow::anyhow!("the estimator's settings: {reason}"))?;
                let mode = format!("{mode:?}").to_lowercase();
                variants.push(Variant { name: format!("{mode} {rig}{file}"), config, cameras: count });
            }
        }
    }
    Ok(variants)
}

fn draw(path: &Path, args: &Args, all: &[VariantRuns], scoring: &ScoreOptions) -> anyhow::Result<()> {
    let panels = StateKind::ALL.map(|kind| {
        let lines = all.iter().map(|runs| EnsembleLine {
            name: runs.variant.name.clone(),
            points: pose_nees_over_time(runs, kind, scoring),
        });
        (report::name_of(kind), lines.collect::<Vec<_>>())
    });
    let title = format!("NEES per degree of freedom, mean of {} runs, {}", args.runs, args.trajectory);
    draw_ensemble(path, &title, &panels)?;
    Ok(())
}

/// Two numbers separated by a colon.
fn pair(text: &str) -> Result<(f64, f64), String> {
    let parts = text.split_once(':').and_then(|(first, second)| {
        let number =
            |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.is_finite() && *value >= 0.0);
        Some((number(first)?, number(second)?))
    });
    parts.ok_or_else(|| "two numbers separated by a colon are needed, for example 2:0.03".to_owned())
}

/// Two times separated by a colon, the earlier first.
fn interval(text: &str) -> Result<(f64, f64), String> {
    let (from, to) = pair(text)?;
    if from >= to {
        return Err(format!("it ends at {to} s, and begins at {from} s: give the earlier time first"));
    }
    Ok((from, to))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_ends_after_it_begins() {
        assert_eq!(interval("30:90"), Ok((30.0, 90.0)));
        for wrong in ["90:30", "30:30", "30", "30:nan", "-1:3"] {
            assert!(interval(wrong).is_err(), "{wrong}");
        }
    }
}
