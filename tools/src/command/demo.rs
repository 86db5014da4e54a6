//! `driftless demo`: the whole system in a minute.

use crate::demo::figures::Figures;
use crate::demo::flight::conditions::FlightConditions;
use crate::demo::flight::{FlightDemo, run_flight};
use crate::demo::rows::Row;
use crate::demo::towns::conditions::Conditions;
use crate::demo::towns::{TownsDemo, run_towns};
use crate::open_page::stay;
use indicatif::ProgressBar;
use onboard::StopSignal;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  driftless demo --out demo\n  driftless demo --open\n  driftless demo --tracks --seeds 5\n\n\
    Renders two flights through a room, builds a map from the images and the IMU of the first, serves it over Zenoh on the\n\
    loopback interface, and localizes the second, whose images are recognized: from pixels to poses.\n\n\
    --tracks simulates tracks and features instead of images: for each seed a town, a surveyed map that is off by what it\n\
    states, and a robot in it, once for each variant of the paper's table.\n\n\
    The conditions are printed with the table, and with the same sentences in OUT/comparison.svg; OUT/demo.json has all\n\
    figures, also by seed.\n\n\
    RMSE    root mean square error of the pose in the map's frame G, not aligned\n\
    claims  root mean square of the standard deviation that the filter's own covariance states; should equal RMSE\n\
    NEES    squared error in units of that covariance, per degree of freedom: 1 is consistent, above is overconfident"
)]
pub struct Args {
    /// Folder for the map, the runs and the plots
    #[arg(long, value_name = "DIR", default_value = "target/demo")]
    out: PathBuf,
    /// Seed; with --tracks the first one. Each seed is another place
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Simulate tracks and features in several towns instead of images in a room
    #[arg(long)]
    tracks: bool,
    /// With --tracks: number of seeds behind each figure
    #[arg(long, value_name = "N", default_value_t = 4, requires = "tracks", value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    /// Show map and robot in the system's browser from when the robot starts, and its whole run at the end, until Ctrl-C
    #[arg(long, conflicts_with_all = ["tracks", "json"])]
    open: bool,
}

/// Runs the command.
///
/// # Errors
/// A folder that cannot be written, or no free port for the server.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let spinner = if args.json { ProgressBar::hidden() } else { ProgressBar::new_spinner() };
    spinner.enable_steady_tick(Duration::from_millis(100));
    let mut show = |step: &str| spinner.set_message(step.to_owned());
    if args.tracks {
        let demo = run_towns(&args.out, &Conditions::new(args.seed, args.seeds), &mut show)?;
        spinner.finish_and_clear();
        if args.json {
            println!("{}", serde_json::to_string_pretty(&demo)?);
        } else {
            print_towns(&demo);
        }
    } else {
        let conditions = FlightConditions::new(args.seed);
        let (demo, server) = run_flight(&args.out, &conditions, args.open, &mut show)?;
        spinner.finish_and_clear();
        if args.json {
            println!("{}", serde_json::to_string_pretty(&demo)?);
        } else {
            print_flight(&demo);
        }
        if args.open {
            stay(&server, &demo.run, &StopSignal::on_interrupt()?);
        }
        server.stop()?;
    }
    Ok(())
}

fn print_towns(demo: &TownsDemo) {
    print_lines(&demo.conditions_text);
    println!(
        "{:.0} m in maps of {:.0} keyframes and {:.0} landmarks\n",
        demo.distance_m, demo.keyframes, demo.landmarks
    );
    print_table(&demo.rows);
    print_pictures(&demo.pictures);
}

fn print_flight(demo: &FlightDemo) {
    let map = &demo.map;
    print_lines(&demo.conditions_text);
    println!(
        "{:.0} m in a map of {} keyframes and {} landmarks; {} places seen again; its keyframes are off by {:.3} m and claim \
         {:.3} m\n",
        demo.distance_m, map.keyframes, map.landmarks, map.loops, map.rmse_m, map.sigma_m
    );
    print_table(&demo.rows);
    print_pictures(&demo.pictures);
    println!("\nin the browser:\n  driftless view {} --map {}", shown(&demo.run), shown(&demo.map_database));
}

fn shown(path: &Path) -> std::path::Display<'_> {
    path.display()
}

fn print_lines(lines: &[String]) {
    for line in lines {
        println!("{line}");
    }
}

fn print_pictures(pictures: &[PathBuf]) {
    println!("\nplots:");
    for picture in pictures {
        println!("  {}", picture.display());
    }
}

fn print_table(rows: &[Row]) {
    println!(
        "{:10}{:^16}{:^16}{:^8}{:^16}{:^16}{:^11}",
        "", "pose in G: RMSE", "claims", "", "local pose", "G_T_L", "queries"
    );
    println!(
        "{:10}{:>7}{:>7}  {:>7}{:>7}  {:>7} {:>7}{:>7}  {:>7}{:>7}  {:>11}",
        "", "m", "deg", "m", "deg", "NEES", "m", "deg", "m", "deg", "used"
    );
    for row in rows {
        println!("{}", line(row));
    }
    println!();
    for row in rows {
        println!("{:10}{}", row.name, row.description);
    }
    println!("(odometry in G: its local pose, as if L had been placed where it truly is)");
}

fn line(row: &Row) -> String {
    let pair = |values: Option<(f64, f64)>| {
        values.map_or_else(
            || format!("{:>7}{:>7}  ", "-", "-"),
            |(metres, degrees)| format!("{metres:>7.3}{degrees:>7.3}  "),
        )
    };
    let rmse = |figures: &Option<Figures>| pair(figures.map(|figures| (figures.rmse_m, figures.rmse_deg)));
    let claimed = pair(row.pose.map(|figures| (figures.sigma_m, figures.sigma_deg)));
    let nees = row.pose.and_then(|figures| figures.nees_pose);
    let nees = nees.map_or_else(|| "-".to_owned(), |nees| format!("{nees:.2}"));
    format!(
        "{:10}{}{claimed}{nees:>7} {}{}{:>4} of {}",
        row.name,
        rmse(&row.pose),
        rmse(&row.local),
        rmse(&row.transform),
        row.used,
        row.sent
    )
}
